"""Hook of mkdocs: links that leave docs/ are plain words on the site, which has no checkout."""

from __future__ import annotations

import re
from typing import Any


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page without its links to files beside docs/."""
    return re.sub(r"\[([^\]]+)\]\((?:\.\./)+(?!figures|tutorials|api)[^)]+\)", r"\1", markdown)
