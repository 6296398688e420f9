"""The committed page of configuration keys is what the code says."""

import dataclasses

import pytest

from certnav.filters.errors import ConfigError
from certnav.nav.config import Config


def test_the_page_is_that_of_the_code(script):
    module = script("configuration_reference")
    assert module.PAGE.read_text(encoding="utf-8") == module.page(), (
        f"docs/configuration.md is stale: {module.COMMAND}"
    )


def test_every_key_has_its_row_and_its_default(script):
    page = script("configuration_reference").page()
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| `")]
    found = {row[0].strip("| `"): row for row in rows}
    for section in ("alignment", "filter", "gnss", "vehicle"):
        part = getattr(Config(), section)
        for field in dataclasses.fields(part):
            assert field.name in found
            assert len(found[field.name][3]) > 5
    assert found["sigma_heading_deg"][1] == "`2.0`" and found["smooth"][1] == "`false`"


def test_names_that_share_an_entry_share_its_text(script):
    @dataclasses.dataclass
    class Two:
        """Something.

        Parameters
        ----------
        a, b : float
            What they
            are.
        c : {'x', 'y'}
            Another.
        """

    told = script("configuration_reference").parameters(Two)
    assert told == {
        "a": ("float", "What they are."),
        "b": ("float", "What they are."),
        "c": ("{'x', 'y'}", "Another."),
    }


def test_an_undocumented_class_is_refused(script):
    class Bare:
        """Nothing."""

    with pytest.raises(ConfigError, match="Bare: its docstring has no Parameters"):
        script("configuration_reference").parameters(Bare)
