"""The page of a study in a browser: shared axes, nothing cut off, numbers to save."""

from __future__ import annotations

import dataclasses

import pytest

from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.nav.study.recording import StudyOptions, study
from certnav.nav.study.report import PAGE, write_study


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    drive = simulate(SimulationConfig("a <drive>", 5, 90.0, density="suburb")).sequence()
    bare = dataclasses.replace(drive, reference=None, name="no reference")
    found = study([drive, drive, bare], StudyOptions(epochs=40), jobs=1)
    return write_study(found, tmp_path_factory.mktemp("study") / "out")


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_cut_off_or_asked_of_the_network(written, look_at, plots_of, width):
    plots = plots_of(look_at(written / PAGE, width))
    assert len(plots) == 2 * 5 + 4  # six figures of two recordings; one of them has two sides
    assert all(alt and w > 200 and h > 100 for alt, w, h in plots)


def test_recordings_share_their_axes(written, look_at):
    page = look_at(written / PAGE)
    page.locator(".plot").first.press("+")
    ends = page.evaluate(
        "() => [...Bokeh.documents[0]._all_models.values()].filter(m => m.type === 'Figure'"
        " && m.below[0].axis_label === '|k| = |SDV·RMD|')"
        ".map(m => [m.x_range.start, m.x_range.end])"
    )
    assert ends == [[0.25, 0.75]] * 2


def test_the_numbers_behind_a_figure_are_those_of_its_file(written, look_at):
    page = look_at(written / PAGE)
    with page.expect_download() as saved:
        page.click("a[download='fig3.csv']")
    assert saved.value.path().read_text() == (written / "fig3.csv").read_text()
