"""What all pages share: one style, tables and pictures, nothing loaded from outside."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

_STYLE = """
:root { --ink: #1f2933; --quiet: #5b6673; --rule: #dfe3e8; --accent: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff;
  font: 15px/1.5 "Source Sans 3", "Segoe UI", "Helvetica Neue", Helvetica, Arial, sans-serif; }
main { max-width: 1168px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { font-size: 30px; line-height: 1.2; margin: 0; letter-spacing: -0.01em; }
h2 { font-size: 19px; margin: 44px 0 6px; padding-top: 14px; border-top: 1px solid var(--rule); }
h3 { font-size: 15px; margin: 18px 0 4px; }
p { margin: 4px 0 10px; max-width: 90ch; }
.meta { max-width: none; }
.meta, .note { color: var(--quiet); font-size: 14px; }
.verdict { font-size: 17px; line-height: 1.5; margin: 18px 0; padding: 2px 0 2px 16px;
  border-left: 4px solid var(--accent); max-width: 92ch; }
.verdict strong { font-weight: 600; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 1px;
  background: var(--rule); border: 1px solid var(--rule); margin: 22px 0 8px; }
.cards div { background: #fff; padding: 10px 14px; }
.cards b { display: block; font-size: 24px; font-weight: 600; line-height: 1.25; }
.cards span { color: var(--quiet); font-size: 13px; }
.split { display: grid; grid-template-columns: minmax(0, 720px) minmax(0, 1fr); gap: 32px; }
.wide td.n { white-space: nowrap; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; }
th, td { padding: 4px 12px 4px 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--rule); }
thead th { color: var(--quiet); font-weight: 600; font-size: 13px; }
tbody th { font-weight: 400; }
td.n, th.n { text-align: right; padding: 4px 8px 4px 6px; }
.split table { width: 100%; }
.wide { overflow-x: auto; max-width: 100%;  /* a shadow where more is to the right or left */
  background: linear-gradient(90deg, #fff 30%, #fff0) 0 0, linear-gradient(270deg, #fff 30%, #fff0)
    100% 0, linear-gradient(90deg, #1f293326, #1f293300) 0 0, linear-gradient(270deg, #1f293326,
    #1f293300) 100% 0; background-repeat: no-repeat; background-size: 40px 100%, 40px 100%,
    14px 100%, 14px 100%; background-attachment: local, local, scroll, scroll; }
table.sortable thead th { cursor: pointer; }
table.sortable thead th[aria-sort="ascending"]::after { content: " ▲"; font-size: 9px; }
table.sortable thead th[aria-sort="descending"]::after { content: " ▼"; font-size: 9px; }
.two { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: 24px; }
.plot { margin: 6px 0 0; overflow: hidden; }
.cells { display: grid; gap: 10px 20px;
  grid-template-columns: repeat(var(--columns, 1), minmax(0, 1fr)); }
.switches { margin: 10px 0; position: sticky; top: 0; z-index: 20; background: #fffffff0;
  padding: 6px 0; }
.switches svg { margin-right: 6px; vertical-align: middle; }
button[data-series][aria-pressed="true"] { background: #fff; color: var(--ink); }
button[data-series][aria-pressed="false"] { color: var(--quiet); border-style: dashed;
  text-decoration: line-through; }
.downloads { gap: 4px 14px; font-size: 13px; margin: 4px 0 12px; }
.fatal, .doubtful { font-weight: 600; } .fatal { color: #a33f00; }
.controls { display: flex; flex-wrap: wrap; gap: 6px 10px; align-items: center; max-width: none; }
.span { position: sticky; top: 0; z-index: 20; background: #fffffff0; padding: 6px 0;
  border-bottom: 1px solid var(--rule); margin: 18px 0 6px; }
.span input { width: 6.5em; }
button, select, input { font: inherit; font-size: 14px; padding: 2px 8px; color: var(--ink);
  background: #fff; border: 1px solid #a7aeb8; border-radius: 4px; }
button { cursor: pointer; }
button[aria-pressed="true"] { background: var(--ink); color: #fff; }
:focus-visible { outline: 2px solid var(--accent); outline-offset: 1px; }
a { color: var(--accent); }
ul { margin: 4px 0 10px; padding-left: 20px; max-width: 90ch; }
pre { background: #f5f6f8; padding: 14px 16px; overflow-x: auto;
  font-size: 13px; line-height: 1.45; }
summary { cursor: pointer; }
@media (max-width: 900px) { .split { grid-template-columns: minmax(0, 1fr); }
  .two, .cells { grid-template-columns: minmax(0, 1fr); } }
@media (max-width: 600px) {
  main { padding: 16px 12px 40px; } h1 { font-size: 24px; overflow-wrap: anywhere; }
  .verdict { font-size: 16px; } .cards { grid-template-columns: 1fr 1fr; }
  .cards div:last-child:nth-child(odd) { grid-column: span 2; }
  th, td { padding-right: 8px; } .span, .switches { position: static; }
  .wide table tbody th { min-width: 7.5em; overflow-wrap: anywhere; }
}
@media print {
  main { max-width: none; padding: 0; } body { font-size: 10.5pt; }
  .controls, .bk-Toolbar { display: none; } .plot { break-inside: avoid; }
  table, .cards { break-inside: avoid; } h2 { break-after: avoid; }
}
"""


class Link(NamedTuple):
    """A cell of a table, or a word, that leads somewhere."""

    text: str
    address: str

    @property
    def html(self) -> str:
        """As it stands in a page."""
        return f'<a href="{escape(self.address, quote=True)}">{_name(self.text)}</a>'


def _name(text: str) -> str:
    """Return a name that a narrow page breaks behind underscore and plus, not within words."""
    return re.sub(r"(_|\+(?=[A-Za-z]))", r"\1<wbr>", escape(text))


def document(title: str, body: str, scripts: str = "") -> str:
    """Return one HTML page that loads nothing from anywhere; `title` is plain text."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n{scripts}\n</body>\n</html>\n"
    )


def table(
    headings: Sequence[str],
    rows: Iterable[Sequence[object]],
    numbers_from: int = 1,
    *,
    sortable: bool = False,
    values: Sequence[Sequence[object]] = (),
) -> str:
    """Return a table; columns from `numbers_from` on are set right.

    Parameters
    ----------
    headings : sequence of str
    rows : iterable of sequences
        What is shown.
    numbers_from : int
    sortable : bool
        By the column whose heading is clicked (`page.js`).
    values : sequence of sequences, optional
        What to sort by where it is a number: row by row, as `rows`.
    """

    def cell(tag: str, k: int, shown: object, value: object = None) -> str:
        kind = ' class="n"' if k >= numbers_from else ""
        by = f' data-value="{float(value)!r}"' if isinstance(value, float | int) else ""
        text = shown.html if isinstance(shown, Link) else _name(str(shown))
        return f"<{tag}{kind}{by}>{text}</{tag}>"

    def line(number: int, row: Sequence[object]) -> str:
        by = values[number] if values else (None,) * len(row)
        cells = (
            cell("th" if k == 0 else "td", k, shown, value)
            for k, (shown, value) in enumerate(zip(row, by, strict=True))
        )
        return f"<tr>{''.join(cells)}</tr>"

    head = "".join(cell("th", k, text) for k, text in enumerate(headings))
    lines = "".join(line(number, row) for number, row in enumerate(rows))
    kind = ' class="sortable"' if sortable else ""
    return (
        f'<div class="wide"><table{kind}><thead><tr>{head}</tr></thead>'
        f"<tbody>{lines}</tbody></table></div>"
    )


def download(name: str, content: str, label: str) -> str:
    """Return a link that saves `content` as a file of this name: it is in the page itself."""
    data = base64.b64encode(content.encode()).decode("ascii")
    kind = "text/csv" if name.endswith(".csv") else "text/plain"
    address = f"data:{kind};charset=utf-8;base64,{data}"
    return f'<a download="{escape(name)}" href="{address}">{escape(label)}</a>'


def files_beside(names: Iterable[str]) -> str:
    """Return links to files that lie beside the page."""
    links = " ".join(f'<a href="{escape(n)}" download>{escape(n)}</a>' for n in names)
    return f'<p class="controls downloads">Beside this page: {links}</p>'
