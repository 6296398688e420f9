"""Write the reference of all configuration keys from the code that defines them.

    python scripts/configuration_reference.py            # prints the page
    python scripts/configuration_reference.py --write    # rewrites docs/configuration.md

Keys, types and defaults come from the dataclasses of `nav.config`, their meaning from the parameter
sections of their docstrings. A key without a description ends with status 1.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import re
import sys
from pathlib import Path
from typing import Any

from certnav.filters.errors import ConfigError
from certnav.filters.sensors import PRESETS
from certnav.nav.config import Config
from certnav.nav.config_files import to_toml

PAGE = Path(__file__).resolve().parents[1] / "docs" / "configuration.md"
COMMAND = "python scripts/configuration_reference.py --write"
HEAD = f"""# Configuration

Made by `{COMMAND}` from the code; a test holds the two together.

```console
$ certnav run PATH --config run.toml --set gnss.min_cn0_dbhz=40 --set filter.smooth=true
```

A configuration is TOML; what is absent keeps its default, an unknown key is refused with the
nearest known one. Every run writes the whole configuration in force to `config.toml` of its result,
which can be given back with `--config`. Units are in the names.
"""


def parameters(cls: type) -> dict[str, tuple[str, str]]:
    """Return type and description of each parameter of a numpydoc docstring.

    Names that share an entry share its text.
    """
    doc = inspect.cleandoc(cls.__doc__ or "")
    body = re.split(r"\nParameters\n-+\n", doc)
    if len(body) < 2:
        raise ConfigError(f"{cls.__name__}: its docstring has no Parameters section")
    found: dict[str, tuple[str, str]] = {}
    names: list[str] = []
    for line in body[1].splitlines():
        if line and not line.startswith(" "):
            left, _, kind = line.partition(" : ")
            names = [name.strip() for name in left.split(",")]
            found |= dict.fromkeys(names, (kind, ""))
        else:
            for name in names:
                kind, text = found[name]
                found[name] = (kind, f"{text} {line.strip()}".strip())
    return found


def formatted(value: Any) -> str:
    """Return a default as it stands in TOML."""
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    if isinstance(value, tuple):
        return f"`{list(value)}`"
    return f"`{value!r}`"


def first_paragraph(cls: type) -> str:
    """Return what a class says before its parameters."""
    doc = inspect.cleandoc(cls.__doc__ or "")
    return " ".join(re.split(r"\nParameters\n-+\n", doc)[0].split())


def page() -> str:
    """Return the page.

    Raises
    ------
    ConfigError
        If a key has no description.
    """
    lines = [HEAD]
    for section in dataclasses.fields(Config):
        part = getattr(Config(), section.name)
        if not dataclasses.is_dataclass(part):
            continue
        cls = type(part)
        told = parameters(cls)
        lines += [
            f"## `[{section.name}]`", "", first_paragraph(cls), "",
            "| key | default | type | meaning |", "|---|---|---|---|",
        ]  # fmt: skip
        for field in dataclasses.fields(cls):
            kind, text = told.get(field.name, ("", ""))
            if not kind or not text:
                raise ConfigError(f"{cls.__name__}.{field.name}: not described in its docstring")
            value = formatted(getattr(part, field.name))
            cells = (f"`{field.name}`", value, kind.removesuffix(", optional"), text)
            lines.append("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |")
        lines.append("")
    lines += [
        "## `[data]`", "",
        "Options of the reader, such as `lever = \"figure\"` for GREAT; the reader refuses unknown "
        "ones and names those it has. Own files are declared in `sequence.toml` instead "
        "([own data](own_data.md)).", "",
        "## IMU presets", "",
        "For `filter.imu`, and for `preset` in a declaration. White noise and bias instability as "
        "the datasheets print them; `filters/sensors.py` says where each comes from.", "",
        "| preset | " + " | ".join(_preset_fields()) + " |",
        "|---|" + "---|" * len(_preset_fields()),
    ]  # fmt: skip
    for name, spec in PRESETS.items():
        values = (f"{getattr(spec, field):g}" for field in _preset_fields())
        lines.append(f"| `{name}` | " + " | ".join(values) + " |")
    lines += ["", "## All defaults", "", "```toml", to_toml(Config()).strip(), "```"]
    return "\n".join(lines) + "\n"


def _preset_fields() -> list[str]:
    spec = next(iter(PRESETS.values()))
    return [
        f.name for f in dataclasses.fields(spec) if isinstance(getattr(spec, f.name), int | float)
    ]


def main() -> int:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"rewrite {PAGE.name}")
    arguments = parser.parse_args()
    try:
        text = page()
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 1
    if arguments.write:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
