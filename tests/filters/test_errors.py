"""An error is one line that says where, what and what to do."""

from __future__ import annotations

import pytest

from certnav.filters.errors import AlignmentError, ConfigError, DataError, NavError


@pytest.mark.parametrize(
    ("where", "text"),
    [
        ({}, "expected a number"),
        ({"file": "a.txt"}, "a.txt: expected a number"),
        ({"file": "a.txt", "line": 0}, "a.txt:0: expected a number"),
        ({"file": "a.txt", "line": 7}, "a.txt:7: expected a number"),
        ({"line": 7}, "expected a number"),
        ({"remedy": "repair it"}, "expected a number — repair it"),
        (
            {"file": "a.txt", "line": 7, "remedy": "repair it"},
            "a.txt:7: expected a number — repair it",
        ),
    ],
)
def test_a_data_error_says_where_and_what_to_do(where, text):
    error = DataError("expected a number", **where)
    assert str(error) == text
    assert error.problem == "expected a number"
    assert (error.file, error.line, error.remedy) == tuple(
        where.get(key) for key in ("file", "line", "remedy")
    )


def test_of_long_messages_the_middle_is_left_out():
    """600 characters: the beginning says where, the end what to do."""
    whole = "x" * 600
    assert str(NavError(whole)) == whole
    long = "".join(chr(ord("a") + k % 26) for k in range(5000))
    text = str(NavError(long))
    assert len(text) == 603
    assert text.startswith(long[:400]) and text.endswith(long[-200:]) and " … " in text


def test_what_cannot_be_printed_is_spelled_out():
    assert str(NavError("a\nb\x00")) == r"a\nb\x00"
    assert str(NavError("2σ → ü")) == "2σ → ü"


def test_an_unknown_key_names_the_nearest_or_all():
    known = ["output_rate_hz", "states"]
    near = ConfigError.unknown_key("state", known, where="filter")
    assert str(near) == "filter: unknown key 'state' — did you mean 'states'?"
    far = ConfigError.unknown_key("qqq", known)
    assert str(far) == "unknown key 'qqq' — known: output_rate_hz, states"


def test_all_refusals_are_caught_as_one():
    for kind in (DataError, ConfigError, AlignmentError):
        assert issubclass(kind, NavError)
