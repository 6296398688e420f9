"""The pages of both tunings in a browser: nothing cut off, choices marked, axes shared."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.nav.config_files import load_config
from certnav.nav.spells.outages import parse_outages
from certnav.nav.tune import settings as tuning
from certnav.nav.tune.candidates import Candidate
from certnav.nav.tune.report import write_tuning
from certnav.nav.tune.settings import tune_settings
from certnav.nav.tune.settings_report import write_settings
from certnav.nav.tune.tuning import tune


@pytest.fixture(scope="module")
def drive():
    sim = simulate(SimulationConfig("drive", 6, 110.0, density="suburb"))
    time = np.arange(np.ceil(sim.imu.time[1]), sim.imu.time[-1] - 1.0)
    lever, rng = sim.calibration.lever_antenna_b, np.random.default_rng(1)
    return sim.sequence(fixes=fixes_from_truth(sim.trajectory, time, lever, 1.0, 0.05, rng))


@pytest.fixture(scope="module")
def thresholds(drive, tmp_path_factory):
    found = tune([drive], snr=np.arange(30.0, 51.0, 4.0), k=np.arange(0.1, 1.01, 0.1), jobs=1)
    return found, write_tuning(found, tmp_path_factory.mktemp("pairs") / "out") / "tuning.html"


@pytest.fixture(scope="module")
def settings(drive, tmp_path_factory):
    few = [
        Candidate("default"),
        Candidate("fitted", weights="rms"),
        Candidate("nothing below four", (("below_four", "off"),)),
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "candidates", lambda *_: few)
        found = tune_settings([drive], outages=parse_outages("20/40:2-3"), jobs=1)
    out = write_settings(found, tmp_path_factory.mktemp("settings") / "out")
    return found, out / "tuning.html"


@pytest.mark.parametrize("width", [1400, 390])
def test_thresholds_are_not_cut_off(thresholds, look_at, plots_of, width):
    _, file = thresholds
    plots = plots_of(look_at(file, width))
    assert len(plots) == 3 and all(alt and w > 200 and h > 100 for alt, w, h in plots)


def test_what_was_taken_is_where_it_is_drawn(thresholds, look_at):
    found, file = thresholds
    page = look_at(file)
    t = found.thresholds
    rms, kept = found.at(t.min_cn0_dbhz, t.min_k)
    marked = page.evaluate(
        "() => { const legend = [...Bokeh.documents[0]._all_models.values()]"
        ".find(m => m.type === 'Legend');"
        "const item = legend.items.find(i => (i.label.value ?? i.label) === 'taken');"
        "const data = item.renderers[0].data_source.data;"
        "return ['kept', 'rms', 'snr', 'k'].map(name => data[name][0]); }"
    )
    assert marked == pytest.approx([100.0 * kept, rms, t.min_cn0_dbhz, t.min_k])


def test_heat_maps_share_their_axes(thresholds, look_at):
    page = look_at(thresholds[1])
    page.locator(".plot").nth(1).press("+")
    ends = page.evaluate(
        "() => [...Bokeh.documents[0]._all_models.values()].filter(m => m.type === 'Figure'"
        " && m.below[0].axis_label.startsWith('k = ')).map(m => [m.x_range.start, m.x_range.end])"
    )
    assert len(ends) == 2 and ends[0] == ends[1] == pytest.approx([0.3, 0.8])


@pytest.mark.parametrize("width", [1400, 390])
def test_settings_are_not_cut_off_and_can_be_saved(settings, look_at, plots_of, width, tmp_path):
    found, file = settings
    page = look_at(file, width)
    plots = plots_of(page)
    assert plots and all(alt and w > 200 and h > 100 for alt, w, h in plots)
    with page.expect_download() as saved:
        page.click("text=Save as thresholds.toml")
    saved.value.save_as(tmp_path / "thresholds.toml")
    assert load_config(tmp_path / "thresholds.toml").gnss == found.config.gnss
