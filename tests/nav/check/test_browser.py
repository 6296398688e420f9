"""The page of a check in a browser: what was found, and the motion it was judged by."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.nav.check.findings import Report
from certnav.nav.check.page import build_page
from certnav.nav.check.recording import check_sequence, contents
from certnav.nav.commands.cli import main


@pytest.fixture(scope="module")
def drive():
    sim = simulate(SimulationConfig("a <drive>", 6, 110.0, density="suburb"))
    time = np.arange(np.ceil(sim.imu.time[1]), sim.imu.time[-1] - 1.0)
    lever, rng = sim.calibration.lever_antenna_b, np.random.default_rng(6)
    return sim.sequence(fixes=fixes_from_truth(sim.trajectory, time, lever, 1.0, 0.05, rng))


@pytest.fixture
def checked(look_at, tmp_path):
    def go(sequence, width: int = 1400):
        report = Report("some/folder", contents(sequence), tuple(check_sequence(sequence)))
        file = tmp_path / "check.html"
        file.write_text(build_page(report, sequence), encoding="utf-8")
        return look_at(file, width), report

    return go


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_cut_off_or_asked_of_the_network(drive, checked, plots_of, width):
    page, report = checked(drive, width)
    (plot,) = plots_of(page)
    assert plot[0] and plot[1] > 300 and plot[2] > 1000
    assert f"It {report.verdict}." in page.text_content(".verdict")
    said = page.text_content("main")
    assert all(f.found in said for f in report.findings)


def test_a_finding_has_a_link_to_its_span(drive, checked):
    gyro = drive.imu.gyro_b.copy()
    gyro[4000:4800] = gyro[4000]
    frozen = dataclasses.replace(drive, imu=dataclasses.replace(drive.imu, gyro_b=gyro))
    page, report = checked(frozen)
    assert any("frozen" in f.found for f in report.of("doubtful"))
    page.locator("li", has_text="frozen").locator("button[data-from]").click()
    page.wait_for_function(
        "() => { const t = Bokeh.documents[0].get_model_by_name('time');"
        " return t.end - t.start < 20 }"
    )
    low, high = page.evaluate(
        "() => { const t = Bokeh.documents[0].get_model_by_name('time'); return [t.start, t.end] }"
    )
    begin = drive.imu.time[4000] - drive.span[0]
    assert low < begin < high < low + 20.0


def test_lines_are_drawn_as_recorded(drive, checked):
    """An IMU that is late is late on the page, too: by what it is late, in the turn rate."""
    late = dataclasses.replace(
        drive, imu=dataclasses.replace(drive.imu, time=drive.imu.time + 1.5)
    )  # fmt: skip
    page, _ = checked(late)
    lines = page.evaluate(
        "() => { const plot = [...Bokeh.documents[0]._all_models.values()].find(m =>"
        " m.type === 'Plot' && m.title.text.startsWith('Turn rate'));"
        " const legend = plot.above.find(m => m.type === 'Legend');"
        " return Object.fromEntries(legend.items.map(i => [i.label.value ?? i.label,"
        " ['t', 'y'].map(c => Array.from(i.renderers[0].data_source.data[c]))])) }"
    )
    offset = drive.span[0] - late.span[0]
    t = np.arange(20.0, 90.0, 0.1)
    imu, reference = (seen(lines[name], t + offset) for name in ("IMU, z", "reference"))
    shifts = np.arange(-30, 31)
    best = shifts[np.argmax([np.corrcoef(np.roll(imu, -k)[40:-40], reference[40:-40])[0, 1]
                             for k in shifts])]  # fmt: skip
    assert 0.1 * best == pytest.approx(1.5, abs=0.35)  # the antenna leads the turn a little


def seen(line, at):
    """Return a drawn line's values at other times."""
    t, y = (np.array(values, float) for values in line)
    return np.interp(at, t[np.isfinite(y)], y[np.isfinite(y)])


def test_what_cannot_be_read_has_a_page(tmp_path, look_at, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["check", str(tmp_path / "empty"), "--html", str(tmp_path / "check.html")]) == 1
    assert "Fatal" in capsys.readouterr().out
    page = look_at(tmp_path / "check.html")
    assert "cannot be navigated" in page.text_content(".verdict")
    assert page.locator(".plot").count() == 0
