"""Take the README's picture: the head of the demo's report and its position errors, by Chromium.

certnav demo && python scripts/report_picture.py results/demo/report.html --out docs/demo.png
"""

from __future__ import annotations

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

WIDTH = 1216
#: Panels below the head: the plots of this section.
SECTION = "Position"


def picture(page: Path) -> Image.Image:
    """Return the head of a report, down to its track, with the position errors below."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        tab = browser.new_page(viewport={"width": WIDTH, "height": 1000}, device_scale_factor=1.25)
        tab.goto(page.resolve().as_uri())
        tab.wait_for_selector("body[data-ready=yes]", timeout=60_000)
        tab.wait_for_timeout(500)
        parts = [
            tab.screenshot(
                full_page=True,  # else what is below the window is cut off
                clip={"x": 0, "y": 0, "width": WIDTH, "height": _top(tab, "Satellites") - 30},
            ),
            _section(tab, SECTION),
        ]
        browser.close()
    images = [Image.open(io.BytesIO(part)).convert("RGB") for part in parts]
    out = Image.new("RGB", (images[0].width, sum(i.height for i in images)), "white")
    top = 0
    for image in images:
        out.paste(image, (0, top))
        top += image.height
    return out


def _top(tab, heading: str) -> float:
    return float(tab.evaluate(
        "name => [...document.querySelectorAll('h2')].find(h => h.textContent === name)"
        ".getBoundingClientRect().top + scrollY", heading,
    ))  # fmt: skip


def _section(tab, heading: str) -> bytes:
    """Return a screenshot of a section, from its heading to the end of its plots."""
    top = _top(tab, heading)
    end = tab.evaluate(
        "top => Math.min(...[...document.querySelectorAll('h2')]"
        ".map(h => h.getBoundingClientRect().top + scrollY).filter(y => y > top + 1))", top,
    )  # fmt: skip
    clip = {"x": 0, "y": top, "width": WIDTH, "height": end - top - 30}
    return bytes(tab.screenshot(full_page=True, clip=clip))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/demo.png"))
    arguments = parser.parse_args()
    # Colours near to each other stay apart: the track's are what the picture is about.
    image = picture(arguments.page).quantize(
        256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    )
    image.save(arguments.out, optimize=True)
    print(arguments.out, image.size)


if __name__ == "__main__":
    main()
