"""Settings for a run: candidates are judged by the filter, and the default is an answer."""

from __future__ import annotations

import csv
import dataclasses
import json

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import ConfigError, DataError
from certnav.nav.commands.cli import main
from certnav.nav.config import Config, GnssConfig
from certnav.nav.config_files import from_tables, load_config
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from certnav.nav.spells.outages import parse_outages
from certnav.nav.tune import candidates as listed
from certnav.nav.tune import settings as tuning
from certnav.nav.tune import trials
from certnav.nav.tune.candidates import Candidate, Weights, candidates
from certnav.nav.tune.choice import best, of_candidate
from certnav.nav.tune.settings import decide, tune_settings
from certnav.nav.tune.settings_report import settings_toml, write_settings
from certnav.nav.tune.trials import prepare, try_out, weights_for
from certnav.velocity.range_rate import DopplerNoise

OUTAGES = parse_outages("20/40:2-3")


@pytest.fixture(scope="module")
def drive():
    sim = simulate(SimulationConfig("drive", 6, 110.0, density="suburb"))
    rng = np.random.default_rng(6)
    time = np.arange(np.ceil(sim.imu.time[1]), sim.imu.time[-1] - 1.0)
    fixes = fixes_from_truth(sim.trajectory, time, sim.calibration.lever_antenna_b, 1.0, 0.05, rng)
    return sim.sequence(fixes=fixes)


def tuned(drive, config=None):
    few = (
        Candidate("default"),
        Candidate("fitted", weights="rms"),
        Candidate("nothing below four", (("below_four", "off"),)),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "candidates", lambda *_: list(few))
        return tune_settings([drive], config=config, outages=OUTAGES, jobs=1)


@pytest.fixture(scope="module")
def found(drive):
    return tuned(drive)


def test_default_and_paper_are_always_tried_and_nothing_twice():
    tried = candidates(Config())
    assert tried[0].config(Config()) == Config()
    paper = tried[1].config(Config()).gnss
    assert (paper.below_four, paper.ddia_min_cn0_dbhz, paper.ddia_min_k) == ("ddia", 40.0, 0.2)
    weights = Weights(DopplerNoise(0.1, 0.05), (0.2, 0.1))
    configs = [(c.config(Config(), weights), c.weights) for c in tried]
    assert len(set(map(str, configs))) == len(tried)
    own = Config(gnss=GnssConfig(min_cn0_dbhz=30.0, below_four="off"))
    again = candidates(own)
    assert again[0].config(own) == own
    assert "C/N0 > 35 dB-Hz" in [c.name for c in again]
    assert "C/N0 > 30 dB-Hz" not in [c.name for c in again]
    with pytest.raises(ConfigError, match="DDIA-VE, -1 dB-Hz"):
        candidates(Config(), [-1.0], [0.1])
    assert listed.PAPER == (40.0, 0.2)


def test_errors_are_those_of_whole_runs(drive, found):
    solution = navigate(drive, Config())
    evaluation = evaluate(solution, drive)
    judged = evaluation.time >= evaluation.time[0] + 10.0
    error = evaluation.error_pos_n[judged, :2]
    assert found.rms(0, "as recorded") == pytest.approx(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    assert found.candidates[0].name == "default"
    assert {g.part for g in found.groups} == {"as recorded", "weak GNSS"}


def test_what_is_shared_changes_no_digit(drive, found):
    """The table of candidates is that of runs each by itself."""
    runs = []

    def alone(sequence, config, *, prepared=None):
        runs.append(config)
        return navigate(sequence, config)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trials, "navigate", alone)
        apart = tuned(drive)
    assert len(runs) == 9  # the default twice as recorded, the weights of two halves
    for one, two in zip(found.groups, apart.groups, strict=True):
        np.testing.assert_array_equal(one.square, two.square)
    assert found.changes == apart.changes and found.held == apart.held


def test_what_hurts_is_seen_to_hurt_and_the_default_stays(drive, found):
    """Without Doppler below four, spells of two or three satellites drift by far more, where the
    vehicle's constraints do not hold them.
    """
    free = from_tables({"vehicle": {"nhc": "off", "zupt": False, "zaru": False}})
    assert tuned(drive, free).change_in(2, "weak GNSS").value > 0.3
    assert found.held[2] < 0.5 * found.held[0]
    groups = [dataclasses.replace(g, square=g.square[[0, 2]]) for g in found.groups]
    changes = [of_candidate(groups, k) for k in range(2)]
    chosen, said = decide(groups, ["default", "off"], changes, best(groups), changes[0])
    assert (chosen, best(groups)) == (0, 0)
    assert "nothing tried has less error" in said


@pytest.fixture(scope="module")
def kept(found):
    """The same, had the default been kept."""
    return dataclasses.replace(found, chosen=0, config=found.base, decided="it was kept")


def load_config_text(text):
    import tomllib

    from certnav.nav.config_files import from_tables

    return from_tables(tomllib.loads(text))


def test_weights_are_never_judged_on_what_they_were_fitted_to(drive, found):
    ready = prepare(drive, Config(), OUTAGES, 25.0, 5.0)
    first, second = weights_for(ready, [], "rms")
    assert first.noise == ready.fits["rms", "second"].noise
    assert second.noise == ready.fits["rms", "first"].noise
    assert first.shown == second.shown == ready.shown
    (pooled,) = weights_for(ready, [dataclasses.replace(ready), dataclasses.replace(ready)], "rms")
    assert pooled.noise.sigma_45 == pytest.approx(ready.fits["rms", "all"].noise.sigma_45)
    assert pooled.shown == pytest.approx(ready.shown)
    ready = dataclasses.replace(ready, spells=())
    configs = [Candidate("fitted", weights="rms").config(Config(), n) for n in (first, second)]
    both = try_out(drive, ready, tuple(configs))
    early = try_out(drive, ready, (configs[0],)).square["as recorded"]
    late = try_out(drive, ready, (configs[1],)).square["as recorded"]
    assert both.square["as recorded"][0] == early[0]
    assert both.square["as recorded"][-1] == late[-1]
    assert early[-1] != late[-1]


def test_fitted_weights_are_the_noise_that_was_simulated(drive, found):
    noise = found.fits["drive"]["mad"].noise
    level = np.array([40.0, 45.0, 50.0])
    truth = DopplerNoise().sigma(level)
    assert noise.decade_db == pytest.approx(20.0, abs=0.01)
    assert np.all(noise.sigma(level) / truth < 2.0)
    assert np.all(noise.sigma(level) / truth > 0.3)


def test_files_say_what_was_found_and_a_run_takes_them(kept, tmp_path):
    found = kept
    out = write_settings(found, tmp_path / "tuning")
    assert load_config(out / "thresholds.toml") == Config()
    text = (out / "thresholds.toml").read_text()
    assert text.count("# Doppler noise on drive") == 2  # written, though not recommended
    stored = json.loads((out / "tuning.json").read_text())
    assert stored["recommended"]["keep_default"] is True
    assert len(stored["candidates"]) == 3
    with (out / "candidates.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["as recorded, RMS [m]"]) == found.rms(0, "as recorded")
    assert r"\toprule" in (out / "candidates.tex").read_text()
    page = (out / "tuning.html").read_text()
    assert "Keep the settings as they are" in page
    assert {p.name for p in out.iterdir()} == {
        "thresholds.toml", "tuning.json", "tuning.html", "candidates.csv", "candidates.tex",
        "folds.csv", "folds.tex", "receivers.csv", "receivers.tex", "candidates.pdf",
    }  # fmt: skip
    write_settings(found, out)  # replaces its own


def test_recommended_weights_are_active_keys_and_nothing_else_changes(found):
    noise = found.fits["drive"]["rms"].noise
    known = Weights(noise, (0.1, 0.04))
    taken = dataclasses.replace(
        found, chosen=1, config=found.candidates[1].config(found.base, known)
    )
    gnss = load_config_text(settings_toml(taken)).gnss
    numbers = (noise.sigma_45, noise.floor, 0.1, 0.04)
    assert gnss.doppler_known_mps == pytest.approx(numbers, rel=0.01)
    assert dataclasses.replace(gnss, doppler_known_mps=()) == Config().gnss


def test_without_a_reference_only_spells_are_judged_and_it_is_said(drive):
    bare = dataclasses.replace(drive, reference=None)
    ready = prepare(bare, Config(), OUTAGES, 25.0, 5.0)
    assert "favours the default" in ready.notes[0]
    assert set(try_out(bare, ready, (Config(),)).square) == {"weak GNSS"}


def test_a_recording_without_doppler_is_refused(drive, tmp_path, capsys):
    observations = drive.observations
    silent = dataclasses.replace(
        drive,
        observations=dataclasses.replace(
            observations, range_rate=np.full(len(observations), np.nan)
        ),
    )
    with pytest.raises(DataError, match="no Doppler: nothing of what is tuned would be used"):
        prepare(silent, Config(), OUTAGES, 25.0, 5.0)
    for more in (["--objective", "speed"], ["--outages", "30/60"], ["--jobs", "0"], []):
        out = tmp_path / "t"
        assert main(["tune", str(tmp_path / "nothing"), "--out", str(out), *more]) == 1
        assert capsys.readouterr().err.count("\n") == 1
        assert not out.exists()
