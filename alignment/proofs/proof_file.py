"""Proofs in a file, which is taken for an enemy's until it is read.

JSON with integers and text only: a JSON number with a point has been rounded by someone. The
file's size, the digits of its numbers and the length of its lists are limited before anything is
computed from them, keys stand once, names are printable, and what goes into the Lagrangian is over
powers of two, so that a common denominator is no longer than the longest.
"""

from __future__ import annotations

import json
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

from ...filters.errors import DataError
from .evidence import parsed
from .proof import Proof

#: First line of a file, so to speak.
FORMAT, VERSION = "certnav alignment proof", 3
#: Limits of a file: bytes, digits of a number, characters of a name, proofs.
MOST_BYTES, MOST_DIGITS, MOST_CHARACTERS, MOST_PROOFS = 16_000_000, 1_000, 200, 5_000
_FRACTION = re.compile(rf"-?[0-9]{{1,{MOST_DIGITS}}}(/[0-9]{{1,{MOST_DIGITS}}})?")


def write(
    path: Path, name: str, proofs: list[Proof], options: dict[str, Any] | None = None
) -> None:
    """Write proofs as JSON, with the options that the windows were cut with."""
    content = {"format": FORMAT, "version": VERSION, "name": name, "options": options or {}}
    content["proofs"] = [proof.as_dict() for proof in proofs]
    text = json.dumps(content, indent=1) + "\n"
    if len(text.encode()) > MOST_BYTES:
        raise DataError(
            f"{len(proofs)} proofs are more than the {MOST_BYTES / 1e6:.0f} MB of a file",
            file=path, remedy="align a shorter part, with a longer --step or --decimate",
        )  # fmt: skip
    path.write_text(text, encoding="utf-8")


def read(path: Path) -> list[Proof]:
    """Return the proofs of a file; see `read_with_options`."""
    return read_with_options(path)[0]


def read_with_options(path: Path) -> tuple[list[Proof], dict[str, Any]]:
    """Return the proofs of a file, and the options that the windows were cut with.

    Raises
    ------
    DataError
        If it is no proof file, larger than the limits, or an entry is missing or no exact number.
    """
    content = _loaded(path)
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT or content.get("version") != VERSION:
        raise DataError(
            f"expected '{FORMAT}' version {VERSION}", file=path,
            remedy="write one with certnav align PATH --proof FILE",
        )  # fmt: skip
    proofs, options = content.get("proofs"), content.get("options")
    if not isinstance(proofs, list) or not 0 < len(proofs) <= MOST_PROOFS:
        raise DataError(f"expected a list of 1 to {MOST_PROOFS} proofs", file=path)
    if not isinstance(options, dict):
        raise DataError("expected the options of the windows", file=path)
    return [_parsed(entry, number, path) for number, entry in enumerate(proofs, 1)], options


def _loaded(path: Path) -> Any:
    """Return the JSON of a file that may have been written to do harm."""
    if not path.is_file():
        problem = "expected a file, found a folder" if path.is_dir() else "no such file"
        raise DataError(problem, file=path, remedy="certnav align PATH --proof FILE writes one")
    with path.open("rb") as stream:
        raw = stream.read(MOST_BYTES + 1)
    if len(raw) > MOST_BYTES:
        raise DataError(f"expected a proof file of at most {MOST_BYTES / 1e6:.0f} MB", file=path)

    def refuse(text: str) -> Any:
        raise ValueError(f"{text[:20]} is no exact number")

    def whole(text: str) -> int:
        if len(text) > MOST_DIGITS:
            raise ValueError(f"a number of {len(text)} digits, {MOST_DIGITS} are allowed")
        return int(text)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            raise ValueError("a key is there twice")
        return found

    try:
        return json.loads(
            raw.decode("utf-8"), parse_float=refuse, parse_constant=refuse, parse_int=whole,
            object_pairs_hook=once,
        )  # fmt: skip
    except RecursionError as error:
        raise DataError("expected a proof file, found brackets without end", file=path) from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        line = error.lineno if isinstance(error, json.JSONDecodeError) else None
        raise DataError("expected a proof file, found no JSON", file=path, line=line) from error
    except ValueError as error:
        raise DataError(f"expected a proof file: {error}", file=path) from error


def _parsed(entry: Any, number: int, path: Path) -> Proof:
    try:
        proof = Proof(
            _label(entry["label"]),
            tuple(_binary(q) for q in _list(entry["Q"], 55)),
            tuple(_binary(m) for m in _list(entry["multipliers"], 20)),
            _binary(entry["bound"]),
            tuple(_list(entry["quaternion"], 4)),
            _exact(entry["cost"]),
            parsed(entry["evidence"]),
            entry["window"],
        )
        if not all(type(n) is int and abs(n) < 1 << 256 for n in (*proof.quaternion, proof.window)):
            raise ValueError("expected integers below 2**256 for the quaternion and the window")
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(f"proof {number}: {reason}", file=path) from error
    return proof


def _label(text: Any) -> str:
    """Return a name that may be printed."""
    if not isinstance(text, str) or len(text) > MOST_CHARACTERS or not text.isprintable():
        raise ValueError(f"expected a label of at most {MOST_CHARACTERS} printable characters")
    return text


def _list(found: Any, length: int) -> list[Any]:
    if not isinstance(found, list) or len(found) != length:
        raise ValueError("expected 55 entries of Q, 20 multipliers and 4 integers")
    return found


def _binary(text: Any) -> Fraction:
    """Return a fraction over a power of two: common denominators stay as short as the numbers."""
    value = _exact(text)
    if value.denominator & (value.denominator - 1):
        raise ValueError("expected Q, multipliers and bound over powers of two")
    return value


def _exact(text: Any) -> Fraction:
    """Return a fraction of integers written as text; a JSON number has been rounded by someone."""
    if not isinstance(text, str) or not _FRACTION.fullmatch(text):
        shown = repr(text)[:40]
        raise ValueError(
            f"expected a fraction of at most {MOST_DIGITS} digits as text, found {shown}"
        )
    return Fraction(text)
