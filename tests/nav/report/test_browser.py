"""The report in a browser: nothing from the network, nothing cut off, figures as numpy has them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.notes import Note
from certnav.nav.report.run import write_report
from certnav.nav.results.directory import read_result, write_result
from certnav.nav.signals import UNUSED, Signals


def _signals(time: np.ndarray) -> Signals:
    """Ten satellites of three systems, used, screened out and refused by turns."""
    rng = np.random.default_rng(5)
    sats = np.array([f"{s}{k:02d}" for s in "GEC" for k in (1, 2, 3)] + ["G31"])
    n = time.size * sats.size
    reason = rng.choice(np.array(["", UNUSED, "weak signal"]), n, p=[0.8, 0.1, 0.1])
    return Signals(
        np.repeat(time, sats.size), np.tile(sats, time.size), np.full(n, "1C"),
        rng.uniform(25.0, 50.0, n), np.tile(np.linspace(0.2, 1.4, sats.size), time.size),
        np.tile(np.linspace(0.0, 6.0, sats.size), time.size), rng.normal(0.0, 0.05, n), reason,
    )  # fmt: skip


@pytest.fixture
def opened(look_at, drive, tmp_path):
    """Open the report of a drive."""

    def go(width: int = 1400, **knobs):
        solution, sequence = drive(**knobs)
        sow = solution.trajectory.time[0] % 604800.0
        note = Note("doubtful", f"something is odd from SOW {sow + 20:.2f} to SOW {sow + 30:.2f}")
        solution = dataclasses.replace(
            solution, notes=(note,), signals=_signals(solution.epochs.time)
        )
        out = write_result(
            tmp_path / "run", solution, evaluate(solution, sequence), sequence, "",
            draw=write_report,
        )  # fmt: skip
        return look_at(out / "report.html", width), read_result(out)

    return go


def shown(page) -> dict[str, float]:
    """Return the figures of the selected span, unrounded."""
    return page.evaluate(
        "() => Object.fromEntries([...document.querySelectorAll('[data-span]')]"
        ".map(c => [c.dataset.span, +(c.dataset.value ?? c.textContent)]))"
    )


def ranges(page) -> list[list[float]]:
    """Return the time span of every panel over time."""
    return page.evaluate(
        "() => [...Bokeh.documents[0]._all_models.values()].filter(m => m.type === 'Plot'"
        " && m.x_range.name === 'time').map(m => [m.x_range.start, m.x_range.end])"
    )


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_cut_off_or_asked_of_the_network(opened, plots_of, width):
    page, _ = opened(width=width, duration=120.0)
    plots = plots_of(page)
    assert len(plots) > 10 and all(alt and w > 200 and h > 100 for alt, w, h in plots)


def test_the_keyboard_zooms_what_has_the_focus(opened):
    page, _ = opened(duration=120.0)
    (low, high), *_ = ranges(page)
    plot = page.locator(".plot").nth(1)  # after the map
    plot.focus()
    plot.press("+")
    page.wait_for_timeout(200)
    spans = ranges(page)
    assert all(b - a == pytest.approx((high - low) / 2) for a, b in spans)
    plot.press("ArrowRight")
    page.wait_for_timeout(200)
    assert ranges(page)[0][0] == pytest.approx(spans[0][0] + (high - low) / 8)
    plot.press("0")
    page.wait_for_timeout(200)
    assert ranges(page)[0] == pytest.approx([low, high])


@pytest.mark.parametrize("reference", [True, False])
def test_a_selected_span_has_the_figures_of_numpy(opened, reference):
    page, result = opened(duration=120.0, reference=reference)
    start = result.solution.alignment.time - result.solution.alignment.waited
    begin = result.solution.trajectory.time[0] - start
    low, high = begin + 31.05, begin + 41.05
    page.evaluate(f"certnav.select({high}, {low})")  # from right to left is the same span
    values = shown(page)
    if reference:
        e = result.evaluation
        inside = (e.time - start >= low) & (e.time - start <= high)
        horizontal = np.hypot(*e.error_pos_n[inside, :2].T)
        expected = {
            "count": inside.sum(),
            "horizontal_rms": np.sqrt(np.mean(horizontal**2)),
            "horizontal_p95": np.percentile(horizontal, 95),
            "horizontal_max": horizontal.max(),
            "up_rms": np.sqrt(np.mean(e.error_pos_n[inside, 2] ** 2)),
            "heading_rms": np.sqrt(np.mean(np.rad2deg(e.error_rpy[inside, 2]) ** 2)),
            "nees": e.nees_position[inside].mean(),
        }
    else:
        t = result.solution.trajectory
        inside = (t.time - start >= low) & (t.time - start <= high)
        sigma = np.sqrt(np.diagonal(t.cov_pos_n[inside], axis1=1, axis2=2))
        expected = {"count": inside.sum(), "north_sigma": np.median(sigma[:, 0]),
                    "largest_sigma": np.hypot(sigma[:, 0], sigma[:, 1]).max()}  # fmt: skip
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, rel=1e-5), name
    assert ranges(page)[0][1] > high + 30.0  # selecting does not zoom


def test_a_zoom_changes_all_panels_and_the_figures(opened):
    page, _ = opened(duration=120.0)
    before = shown(page)
    wide = page.evaluate(_ORDINATE)
    page.fill("#span-from", "40")
    page.fill("#span-to", "50")
    page.keyboard.press("Enter")
    page.wait_for_function(_COUNTED, arg=[0, before["count"] / 5])
    spans = ranges(page)
    assert len(spans) > 15 and all(span == pytest.approx([40.0, 50.0]) for span in spans)
    # On ten seconds the ordinate fits the error of ten seconds, not of the whole run.
    narrow = page.evaluate(_ORDINATE)
    assert narrow < wide
    page.click("#span-whole")
    page.wait_for_function(_COUNTED, arg=[before["count"] - 1, before["count"] + 1])


def test_ten_seconds_are_drawn_with_all_their_epochs(opened, monkeypatch):
    """Of the whole a few points are drawn, of a short span every epoch of the reference."""
    monkeypatch.setattr("certnav.nav.report.timeline._BINS", 20)
    page, result = opened(duration=120.0)
    drawn = (
        "() => { const source = [...Bokeh.documents[0]._all_models.values()]"
        ".find(m => m.tags?.includes?.('full:east'));"
        " return [source.data.t, source.data.y].map(v => Array.from(v)) }"
    )
    whole = page.evaluate(drawn)
    page.evaluate("certnav.zoom(40, 50)")
    page.wait_for_function(f"before => ({drawn})()[0].length > before", arg=len(whole[0]))
    t, y = (np.array(v) for v in page.evaluate(drawn))
    e = result.evaluation
    start = result.solution.alignment.time - result.solution.alignment.waited
    inside = (e.time - start >= 40.0) & (e.time - start <= 50.0)
    seen = (t >= 40.0) & (t <= 50.0)
    assert inside.sum() == seen.sum() > 3 * sum(40.0 <= x <= 50.0 for x in whole[0])
    assert y[seen] == pytest.approx(e.error_pos_n[inside, 1], rel=1e-6)
    page.click("#span-whole")
    page.wait_for_function(f"before => ({drawn})()[0].length === before", arg=len(whole[0]))
    assert page.evaluate(drawn) == whole


#: Whether the selected span has more epochs than one number, and fewer than another.
_COUNTED = (
    "([low, high]) => { const n = +document.querySelector('[data-span=count]').textContent;"
    " return low < n && n < high }"
)
_ORDINATE = (
    "() => Math.min(...[...Bokeh.documents[0]._all_models.values()].filter(m => m.type === 'Plot'"
    " && m.tags.includes('error')).map(m => m.y_range.end))"
)


def test_mouse_and_keyboard(opened):
    """A drag over a panel zooms; a doubt's button shows its span; a heading sorts its table."""
    page, _ = opened(duration=120.0)
    plot = page.locator(".plot").nth(1).locator(".bk-Plot").first  # after the map
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 90)
    page.mouse.down()
    page.mouse.move(box["x"] + 420, box["y"] + 100, steps=5)
    page.mouse.up()
    page.wait_for_timeout(300)
    low, high = ranges(page)[0]
    assert high - low < 100.0
    page.click("button[data-from]")
    page.wait_for_timeout(300)
    assert ranges(page)[0] == pytest.approx([27.5, 47.5], abs=10.0)
    rows = "document.querySelectorAll('table.sortable tbody tr')"
    counts = f"() => [...{rows}].map(r => r.cells[0].textContent)"
    before = page.evaluate(counts)
    page.locator("table.sortable thead th").first.press("Enter")
    assert page.evaluate(counts) == sorted(before)


def test_the_track_is_coloured_by_choice(opened, monkeypatch):
    """Thinned to a few points, its extremes are drawn all the same."""
    monkeypatch.setattr("certnav.nav.report.map._POINTS", 50)
    monkeypatch.setattr("certnav.nav.report.map._BINS", 20)
    page, result = opened(duration=60.0)
    page.select_option("#track-colour", "speed")
    shown = page.evaluate("() => Array.from(Bokeh.documents[0].get_model_by_name('track').data.c)")
    speed = np.linalg.norm(result.solution.trajectory.vel_e, axis=1)
    assert len(shown) < speed.size / 2
    assert [min(shown), max(shown)] == pytest.approx([speed.min(), speed.max()], rel=1e-4)
    title = page.evaluate("() => Bokeh.documents[0].get_model_by_name('track-bar').title")
    assert title == "speed [m/s]"
