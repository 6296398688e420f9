"""One table, three ways: on a page, as CSV with all digits, and as LaTeX for a paper.

table = Table("table3", "Outliers", (Column("recording"), Column("RMS", "m/s", ".2f")), rows)
table.html(), table.csv(), table.latex()
"""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import document
from .quantities import quantity

#: What LaTeX wants otherwise; letters of any language stay as they are.
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "°": r"$^\circ$", "²": r"$^2$", "≤": r"$\le$", "≥": r"$\ge$", "<": r"$<$", ">": r"$>$",
    "|": r"$|$", "·": r"$\cdot$", "−": "$-$", "×": r"$\times$", "√": r"$\surd$", "…": r"\dots{}",
    "–": "--", "—": "---", "±": r"$\pm$", "≈": r"$\approx$", "σ": r"$\sigma$", "λ": r"$\lambda$",
    "→": r"$\rightarrow$", "∞": r"$\infty$", "Σ": r"$\Sigma$",
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """One column.

    Parameters
    ----------
    title : str
    unit : str
        '' for none; of shares, which a page gives in per cent, '%'.
    digits : str
        How a number is printed, as ``.2f``; '3' prints three digits and no exponents, '' prints
        values as they are.
    """

    title: str
    unit: str = ""
    digits: str = ""

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def text(self, value: object) -> str:
        """Return a value as it is printed; a dash for what is not known."""
        if value is None or (isinstance(value, float | np.floating) and not math.isfinite(value)):
            return "–"
        if isinstance(value, str) or not self.digits:
            return str(value)
        if self.digits == "3":
            return quantity(float(value), "").replace("-", "−")  # type: ignore[arg-type]
        return format(value, self.digits).replace("-", "−")


@dataclass(frozen=True)
class Table:
    """A table of a paper.

    Parameters
    ----------
    name : str
        Of its files, and its LaTeX label.
    caption : str
    columns : tuple of Column
    rows : tuple of tuple
        Numbers, words, or None.
    words : int
        How many columns, from the left, are words.
    """

    name: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[object, ...], ...]
    words: int = 1

    def html(self) -> str:
        """Return the table for a page: sortable, to be saved as CSV and LaTeX."""
        table = document.table(
            [c.heading for c in self.columns], self.texts(), self.words, sortable=True,
            values=[[_number(value) for value in row] for row in self.rows],
        )  # fmt: skip
        return f'{table}\n<p class="controls downloads">{self.links(latex=True)}</p>'

    def links(self, latex: bool = False) -> str:
        """Return links that save the table as CSV and, with `latex`, as LaTeX."""
        links = [document.download(f"{self.name}.csv", self.csv(), "CSV")]
        if latex:
            links.append(document.download(f"{self.name}.tex", self.latex(), "LaTeX"))
        return " ".join(links)

    def csv(self) -> str:
        """Return the table with every digit; nothing where nothing is known."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([column.heading for column in self.columns])
        writer.writerows([[_plain(value) for value in row] for row in self.rows])
        return out.getvalue()

    def latex(self) -> str:
        """Return the table as a float for LaTeX with booktabs."""
        kinds = "l" * self.words + "r" * (len(self.columns) - self.words)
        head = " & ".join(latex_text(column.heading) for column in self.columns)
        body = "\n".join(" & ".join(map(latex_text, row)) + r" \\" for row in self.texts())
        label = re.sub(r"[^A-Za-z0-9]+", "-", self.name)
        return (
            "\\begin{table}\n\\centering\n"
            f"\\caption{{{latex_text(self.caption)}}}\n\\label{{tab:{label}}}\n"
            f"\\begin{{tabular}}{{{kinds}}}\n\\toprule\n{head} \\\\\n\\midrule\n{body}\n"
            "\\bottomrule\n\\end{tabular}\n\\end{table}\n"
        )

    def write(self, folder: Path) -> None:
        """Write NAME.csv and NAME.tex."""
        (folder / f"{self.name}.csv").write_text(self.csv(), encoding="utf-8")
        (folder / f"{self.name}.tex").write_text(self.latex(), encoding="utf-8")

    def texts(self) -> list[list[str]]:
        """Return the rows as they are printed."""
        return [[c.text(v) for c, v in zip(self.columns, row, strict=True)] for row in self.rows]


def latex_text(text: str) -> str:
    """Return plain text as LaTeX sets it."""
    return "".join(_LATEX.get(letter, letter) for letter in text)


def _number(value: object) -> float | None:
    """Return what to sort by, where it is not what is shown."""
    known = isinstance(value, float | int | np.floating | np.integer) and math.isfinite(value)
    return float(value) if known else None  # type: ignore[arg-type]


def _plain(value: object) -> object:
    if value is None or (isinstance(value, float | np.floating) and not math.isfinite(value)):
        return ""
    if isinstance(value, float | np.floating):
        return repr(float(value))
    return value
