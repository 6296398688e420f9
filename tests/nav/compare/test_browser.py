"""The page of a comparison in a browser: linked axes, methods switched, tables sorted and saved."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

from certnav.nav.compare.report import write_page
from certnav.nav.compare.runs import Comparison, Run
from certnav.nav.evaluation.accuracy import METRICS
from certnav.nav.spells.drift import SpellFigures

METHODS = ("gnss-only", "lc4", "lc+rows+vehicle+smooth")
DRIVES = ("north", "south")


def _run(rng: np.random.Generator, method: str, drive: str, scale: float) -> Run:
    spells = []
    for k in range(6):
        growth = scale * np.linspace(0.0, 1.0, 61) ** 2 * rng.uniform(0.5, 2.0)
        start = 2201 * 604800.0 + 300.0 * k
        spells.append(
            SpellFigures(start, start + 60.0, growth[-1], growth[-1], growth[-1], growth[-1], 0.1,
                         0.01, 3.0, 3.0, np.arange(61.0), growth)
        )  # fmt: skip
    track = np.array([114.0, 30.0]) + np.cumsum(rng.normal(0.0, 1e-5, (400, 2)), axis=0)
    return Run(
        method, drive, "", metrics=dict.fromkeys(METRICS, scale), consistency={"nees_in": scale},
        availability=1.0, near=0.5, spells=tuple(spells), track=track,
        used={"position": (90, 100, 1.1), "velocity": (50, 0, None)},
    )  # fmt: skip


@pytest.fixture
def comparison():
    rng = np.random.default_rng(3)
    runs = [_run(rng, m, d, 100.0 / 10**k) for k, m in enumerate(METHODS) for d in DRIVES]
    judged = {run.sequence: run.track for run in runs}
    return Comparison(tuple(runs), judged, "60/300", notes=("a <note>",))


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_cut_off_or_asked_of_the_network(comparison, look_at, plots_of, tmp_path, width):
    page = look_at(write_page(comparison, tmp_path / "out"), width)
    plots = plots_of(page)
    assert len(plots) == 1 + 1 + len(METHODS) + len(DRIVES)
    assert all(alt and w > 200 and h > 100 for alt, w, h in plots)
    assert page.locator("text=a <note>").count() == 1


def test_a_method_is_switched_off_everywhere(comparison, look_at, tmp_path):
    page = look_at(write_page(comparison, tmp_path / "out"))
    shown = (
        "name => [...Bokeh.documents[0]._all_models.values()]"
        ".filter(m => m.tags?.includes('series:' + name)).map(m => m.visible)"
    )
    # dots, bar and diamond; median; its own plot and what is in it; a track a drive
    assert len(page.evaluate(shown, "lc4")) >= 8 and all(page.evaluate(shown, "lc4"))
    page.locator("[data-series=lc4]").press("Enter")
    assert not any(page.evaluate(shown, "lc4")) and all(page.evaluate(shown, "gnss-only"))
    page.click("[data-all=false]")
    assert not any(page.evaluate(shown, "gnss-only"))
    page.click("[data-all=true]")
    assert all(page.evaluate(shown, "lc4"))


def test_a_zoom_changes_all_plots_over_time_since_loss(comparison, look_at, tmp_path):
    page = look_at(write_page(comparison, tmp_path / "out"))
    ends = (
        "() => [...Bokeh.documents[0]._all_models.values()].filter(m => m.type === 'Figure'"
        " && m.xaxis?.length !== 0 && m.below[0].axis_label === 'time since loss [s]')"
        ".map(m => [m.x_range.start, m.x_range.end])"
    )
    assert page.evaluate(ends) == [[0.0, 60.0]] * (1 + len(METHODS))
    plot = page.locator(".plot").nth(1)
    plot.press("+")
    assert page.evaluate(ends) == [[15.0, 45.0]] * (1 + len(METHODS))
    box = plot.locator(".bk-Figure").bounding_box()
    page.mouse.move(box["x"] + 400, box["y"] + 150)
    page.mouse.dblclick(box["x"] + 400, box["y"] + 150)
    page.wait_for_function(f"() => ({ends})().every(([a, b]) => a === 0 && b === 60)")


def test_tables_are_sorted_by_number_and_saved_with_all_digits(comparison, look_at, tmp_path):
    page = look_at(write_page(comparison, tmp_path / "out"))
    rows = "() => [...document.querySelector('table.sortable').tBodies[0].rows]" \
           ".map(r => [r.cells[0].textContent, +r.cells[2].dataset.value])"  # fmt: skip
    median = page.locator("table.sortable").first.locator("thead th").nth(2)
    median.click()
    first = page.evaluate(rows)
    assert [v for _, v in first] == sorted(v for _, v in first) and first[0][0] == METHODS[-1]
    median.press(" ")
    assert page.evaluate(rows) == first[::-1]
    with page.expect_download() as saved:
        page.locator("a[download$='.csv']").first.click()
    text = saved.value.path().read_text()
    written = {r["method"]: float(r["median [m]"]) for r in csv.DictReader(io.StringIO(text))}
    assert written == pytest.approx(dict(first), rel=1e-12)
