"""What all pages share: one style, tables and pictures, nothing loaded from outside."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import NamedTuple, TypeVar

from matplotlib.figure import Figure

from .pictures import render

T = TypeVar("T")

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
.meta, figcaption, .note { color: var(--quiet); font-size: 14px; }
.verdict { font-size: 17px; line-height: 1.5; margin: 18px 0; padding: 2px 0 2px 16px;
  border-left: 4px solid var(--accent); max-width: 92ch; }
.verdict strong { font-weight: 600; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 1px;
  background: var(--rule); border: 1px solid var(--rule); margin: 22px 0 8px; }
.cards div { background: #fff; padding: 10px 14px; }
.cards b { display: block; font-size: 24px; font-weight: 600; line-height: 1.25; }
.cards span { color: var(--quiet); font-size: 13px; }
.split { display: grid; grid-template-columns: minmax(0, 720px) minmax(0, 1fr); gap: 32px; }
figure { margin: 8px 0 0; }
figure img { display: block; width: 100%; height: auto; }
.wide { overflow-x: auto; }
.wide td.n { white-space: nowrap; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; }
th, td { padding: 4px 14px 4px 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--rule); }
thead th { color: var(--quiet); font-weight: 600; font-size: 13px; }
tbody th { font-weight: 400; }
td.n, th.n { text-align: right; padding-left: 10px; }
.split table { width: 100%; }
.wide { overflow-x: auto; max-width: 100%; }
table.sortable thead th { cursor: pointer; }
table.sortable thead th[aria-sort="ascending"]::after { content: " ▲"; font-size: 9px; }
table.sortable thead th[aria-sort="descending"]::after { content: " ▼"; font-size: 9px; }
.two { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: 24px; }
.plot { margin: 6px 0 0; overflow: hidden; }
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
  .two { grid-template-columns: minmax(0, 1fr); } }
@media (max-width: 600px) {
  main { padding: 16px 12px 40px; } h1 { font-size: 24px; overflow-wrap: anywhere; }
  .verdict { font-size: 16px; } .cards { grid-template-columns: 1fr 1fr; }
  th, td { padding-right: 8px; } .span { position: static; }
}
@media print {
  main { max-width: none; padding: 0; } body { font-size: 10.5pt; }
  .controls, .bk-Toolbar { display: none; } .plot { break-inside: avoid; }
  figure, table, .cards { break-inside: avoid; } h2 { break-after: avoid; }
}
"""


class Link(NamedTuple):
    """A cell of a table, or a word, that leads somewhere."""

    text: str
    address: str

    @property
    def html(self) -> str:
        """As it stands in a page."""
        return f'<a href="{escape(self.address, quote=True)}">{escape(self.text)}</a>'


def document(title: str, body: str, scripts: str = "") -> str:
    """Return one HTML page that loads nothing from anywhere; `title` is plain text."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n{scripts}\n</body>\n</html>\n"
    )


def image(draw: Callable[[T], Figure | None], shown: T, alt: str, caption: str) -> str:
    """Return what `draw` makes of `shown`, with a caption; '' where there is nothing to show."""
    address = render(draw, shown)
    if address is None:
        return ""
    text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><img src="{address}" alt="{escape(alt)}">{text}</figure>'


def table(
    headings: Sequence[str],
    rows: Iterable[Sequence[object]],
    numbers_from: int = 1,
    *,
    sortable: bool = False,
) -> str:
    """Return a table; columns from `numbers_from` on are set right.

    One that is `sortable` sorts by the column whose heading is clicked (`page.js`).
    """

    def cell(tag: str, k: int, value: object) -> str:
        kind = ' class="n"' if k >= numbers_from else ""
        shown = value.html if isinstance(value, Link) else escape(str(value))
        return f"<{tag}{kind}>{shown}</{tag}>"

    head = "".join(cell("th", k, text) for k, text in enumerate(headings))
    lines = (
        "<tr>" + "".join(cell("th" if k == 0 else "td", k, v) for k, v in enumerate(row)) + "</tr>"
        for row in rows
    )
    kind = ' class="sortable"' if sortable else ""
    return (
        f'<div class="wide"><table{kind}><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )
