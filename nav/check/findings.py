"""What a check found, in words a navigation engineer can act on, and the page made of it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

#: From worst to best. 'fatal': cannot be navigated as it stands. 'doubtful': can, but something
#: contradicts physics or could not be right. 'note': verified, or not testable, or to declare.
SEVERITIES = ("fatal", "doubtful", "note")
#: What each of them is, over a list of findings.
HEADINGS = {
    "fatal": "Fatal: the data cannot be navigated like this",
    "doubtful": "Doubtful",
    "note": "Found in order, or not testable here",
}
MEASURED = "Measured, and other than declared: lines to paste"
_WIDTH = 96


@dataclass(frozen=True)
class Finding:
    """One thing a check has to say.

    Parameters
    ----------
    severity : {'fatal', 'doubtful', 'note'}
    subject : str
        What it is about: 'gyro', 'time', 'Doppler' …
    found : str
        What was found, with its figures.
    remedy : str
        What to declare or do; '' when nothing.
    numbers : mapping of str to float
        The figures, for programs; units are in the names.
    declare : str
        Lines of TOML that declare what was measured; '' when it is what is declared already.
    """

    severity: str
    subject: str
    found: str
    remedy: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    declare: str = ""

    def __post_init__(self) -> None:
        if self.severity not in SEVERITIES:
            raise ValueError(f"severity: expected one of {SEVERITIES}, found {self.severity!r}")

    @property
    def line(self) -> str:
        """The finding in one line."""
        return f"{self.subject}: {self.found}" + (f" — {self.remedy}" if self.remedy else "")

    def as_dict(self) -> dict[str, Any]:
        """Return the finding in types of strict JSON: what is not finite becomes None."""
        return {
            "severity": self.severity,
            "subject": self.subject,
            "found": self.found,
            "remedy": self.remedy,
            "numbers": {k: _strict(v) for k, v in self.numbers.items()},
            "declare": self.declare,
        }


@dataclass(frozen=True)
class Report:
    """Everything `nav.check.recording.check` found about one recording.

    Parameters
    ----------
    path : str
        What was checked.
    contents : tuple of str
        What is in it, in lines; empty when it could not be read.
    findings : tuple of Finding
        In the order of severity.
    """

    path: str
    contents: tuple[str, ...]
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return f"<Report on {self.path}: {self.verdict}>"

    def of(self, severity: str) -> tuple[Finding, ...]:
        """Return the findings of one severity."""
        return tuple(f for f in self.findings if f.severity == severity)

    @property
    def navigable(self) -> bool:
        """Whether nothing fatal was found."""
        return not self.of("fatal")

    @property
    def verdict(self) -> str:
        """The outcome in one sentence."""
        fatal, doubtful = len(self.of("fatal")), len(self.of("doubtful"))
        if fatal:
            return f"cannot be navigated: {_count(fatal, 'fatal finding')}"
        if doubtful:
            return f"can be navigated; {_count(doubtful, 'doubtful finding')}"
        return "can be navigated; nothing doubtful"

    def text(self) -> str:
        """Return the page."""
        lines = [f"{self.path}: {self.verdict}", ""]
        if self.contents:
            lines += ["Contents", *_items(self.contents), ""]
        for severity in SEVERITIES:
            found = [f for f in self.of(severity) if severity != "note" or not f.declare]
            if found:
                lines += [HEADINGS[severity], *_items(f"{f.subject}: {f.found}" for f in found)]
                lines.append("")
        lines += self._measured()
        declare = [f"{f.subject}: {f.remedy}" for f in self.findings if f.remedy]
        if declare:
            lines += ["To declare or to do", *_items(declare), ""]
        return "\n".join(lines)

    def _measured(self) -> list[str]:
        """Return what was measured other than declared, each with the lines to paste."""
        lines = []
        for f in self.findings:
            if f.declare:
                said = f.subject if f.severity != "note" else f"{f.subject}: {f.found}"
                lines += _items([said]) + [f"      {line}" for line in f.declare.splitlines()]
        return [MEASURED, *lines, ""] if lines else []

    def as_dict(self) -> dict[str, Any]:
        """Return the report in types of strict JSON."""
        return {
            "path": self.path,
            "navigable": self.navigable,
            "verdict": self.verdict,
            "contents": list(self.contents),
            "findings": [f.as_dict() for f in self.findings],
        }


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings, worst first, otherwise in the order given."""
    return tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))


def _items(texts: Iterable[str]) -> list[str]:
    return [
        line
        for text in texts
        for line in textwrap.wrap(
            text, _WIDTH, initial_indent="  - ", subsequent_indent="    ",
            break_long_words=False, break_on_hyphens=False,
        )
    ]  # fmt: skip


def _count(n: int, what: str) -> str:
    return f"{n} {what}" + ("" if n == 1 else "s")


def _strict(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
