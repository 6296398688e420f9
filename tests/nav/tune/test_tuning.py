"""Tuning: what it chooses, that it is judged on other data, and that clusters change nothing."""

from __future__ import annotations

import argparse
import json
import warnings

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import OMEGA_IE_E
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ATT, VEL, ErrorModel
from certnav.filters.errors import ConfigError, DataError
from certnav.filters.measurements import antenna_velocity
from certnav.filters.rotation import matrix_from_rotvec
from certnav.filters.strapdown import InertialStream, NavState
from certnav.nav.commands import tune as tuning_command
from certnav.nav.config import Config
from certnav.nav.config_files import load_config
from certnav.nav.engine.ddia_update import filter_motion, measurement
from certnav.nav.tune.report import as_dict, write_tuning
from certnav.nav.tune.score import Score, choose, decided, knee, pareto_front
from certnav.nav.tune.tuning import Tuning, tune
from certnav.velocity.ddia import ddia_velocity
from certnav.velocity.range_rate import doppler_rows

SNR, K = np.arange(30.0, 51.0, 2.0), np.array([0.05, 0.1, 0.2, 0.3, 0.5, 0.8])


def drive(seed, duration=120.0, density="urban", **options):
    sim = simulate(SimulationConfig(f"drive-{seed}", seed, duration, density=density, **options))
    rng = np.random.default_rng(seed)
    time = np.arange(np.ceil(sim.imu.time[1]), sim.imu.time[-1] - 1.0)
    fixes = fixes_from_truth(sim.trajectory, time, sim.calibration.lever_antenna_b, 1.0, 0.05, rng)
    return sim, sim.sequence(fixes=fixes)


@pytest.fixture(scope="module")
def drives():
    return [drive(seed)[1] for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def tuned(drives) -> Tuning:
    return tune(drives, snr=SNR, k=K, jobs=1)


def score(rms, kept, offered=100):
    rms, kept = np.atleast_2d(rms), np.atleast_2d(kept)
    return Score(np.square(rms) * kept, kept.astype(float), kept.astype(float), offered)


def test_least_error_among_those_that_keep_enough():
    trial = score([3.0, 2.0, 1.0, 0.5], [90, 60, 45, 10])
    assert choose([trial], 0.4) == (0, 2)
    assert choose([trial], 0.5) == (0, 1)
    assert choose([trial], 0.0) == (0, 3)
    assert choose([trial], 0.95) == (0, 0)


def test_a_drive_with_strong_signals_does_not_starve_the_others():
    strong, weak = (
        score([0.4, 0.3, 0.2, 0.1], [1000, 990, 980, 970], 1000),
        score([3.0, 2.0, 1.0, 0.5], [90, 60, 10, 0]),
    )
    assert choose([strong, weak], 0.4) == (0, 1)
    assert choose([strong, weak], 0.95) == (0, 0)


def test_the_constraint_that_decided_is_named():
    trial = score([3.0, 2.0, 1.0, 0.5], [90, 60, 45, 10])
    snr, k = np.array([30.0]), np.array([0.1, 0.2, 0.3, 0.4])
    said = decided([trial], snr, k, 0.4)
    assert said.startswith("the floor of 40% kept decided")
    assert "k > 0.4 has 0.5 m/s with 10% kept" in said
    assert decided([trial], snr, k, 0.95).startswith("nothing keeps 95%")
    assert decided([trial], snr, k, 0.0).startswith("the edge of the grid")
    inner = score([[3.0, 3.0, 3.0], [3.0, 1.0, 3.0], [3.0, 3.0, 3.0]], np.full((3, 3), 50))
    assert decided([inner], k[:3], k[:3], 0.4).startswith("the error decided")


def test_knee_is_where_the_trade_off_bends():
    # Straight in ln(RMS) from 10 % to 80 % kept, then ten times as steep: the bend is the knee.
    kept = np.arange(10.0, 101.0, 10.0)
    rms = np.exp(0.02 * kept + 0.2 * np.maximum(kept - 80.0, 0.0))
    assert knee(score(rms, kept)) == (0, 7)
    assert knee(score([1.0, 2.0], [10, 90])) is None


def test_pareto_front_is_what_nothing_beats():
    rng = np.random.default_rng(1)
    trial = score(rng.uniform(1, 5, (6, 7)), rng.integers(1, 100, (6, 7)))
    front = pareto_front(trial)
    rms, kept = trial.rms, trial.retention
    for i in np.ndindex(front.shape):
        better = (rms <= rms[i]) & (kept >= kept[i]) & ((rms < rms[i]) | (kept > kept[i]))
        assert front[i] == (not better.any())


def test_nothing_is_judged_by_what_it_was_tuned_on(drives, tuned):
    assert tuned.folds_by == "sequences"
    assert [fold.left_out for fold in tuned.folds] == ["drive-1", "drive-2", "drive-3"]
    for number, fold in enumerate(tuned.folds):
        others = [d for i, d in enumerate(drives) if i != number]
        again = tune(others, snr=SNR, k=K, jobs=1)
        t = again.thresholds
        assert (fold.snr, fold.k) == (t.min_cn0_dbhz, t.min_k)
        alone = tuned.at(fold.snr, fold.k, tuned.alone[fold.left_out])
        assert (fold.rms, fold.retention) == pytest.approx(alone)
    single = tune(drives[:1], snr=SNR, k=K, jobs=1)
    assert single.folds_by == "time blocks"
    assert len(single.folds) == 5


def test_thresholds_help_and_keep_what_was_asked(tuned):
    t = tuned.thresholds
    best, loosest = tuned.at(t.min_cn0_dbhz, t.min_k), tuned.at(30.0, 0.05)
    assert best[0] < loosest[0]
    for alone in tuned.alone.values():
        assert tuned.at(t.min_cn0_dbhz, t.min_k, alone)[1] >= 0.4
    assert tuned.score.offered == sum(s.offered for s in tuned.alone.values())
    assert set(tuned.statistics) == {"pooled", "drive-1", "drive-2", "drive-3"}
    assert tuned.statistics["pooled"]["pairs"] == sum(
        tuned.statistics[name]["pairs"] for name in tuned.alone
    )


def test_result_is_complete_and_reads_back(tuned, tmp_path):
    out = write_tuning(tuned, tmp_path / "tuning")
    # Thresholds of the mean C/N0 are not what the filter applies: the run stays as it is.
    assert load_config(out / "thresholds.toml") == Config()
    assert (out / "thresholds.toml").read_text().count("# Doppler noise on drive-") == 3
    assert (out / "folds.tex").read_text().count("drive-") == 3
    stored = json.loads((out / "tuning.json").read_text())
    assert stored == json.loads(json.dumps(as_dict(tuned), allow_nan=False))
    assert len(stored["grid"]) == SNR.size * K.size
    assert (out / "tuning.html").read_text().count('class="plot"') == 3
    write_tuning(tuned, out)  # replaces its own
    (out / "mine.txt").write_text("kept")
    with pytest.raises(DataError, match="exists and is not a tuning result"):
        write_tuning(tuned, out)
    assert (out / "mine.txt").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["tuning"]


def test_processes_and_a_dask_cluster_find_the_same(drives, tuned):
    distributed = pytest.importorskip("distributed")
    by_processes = tune(drives, snr=SNR, k=K, jobs=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Dask's own
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster:
            by_cluster = tune(drives, snr=SNR, k=K, scheduler=cluster.scheduler_address)
    for other in (by_processes, by_cluster):
        assert as_dict(other) == as_dict(tuned)


def test_a_scheduler_that_is_not_there_is_one_line(drives):
    pytest.importorskip("distributed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ConfigError, match=r"no Dask scheduler there") as caught:
            tune(drives, snr=SNR, k=K, scheduler="tcp://127.0.0.1:9")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options, named",
    [
        ({"snr": [40.0, 30.0]}, "snr: expected ascending"),
        ({"k": []}, "k: expected ascending"),
        ({"min_kept": 1.5}, "min_kept"),
        ({"blocks": 1}, "blocks"),
    ],
)
def test_impossible_wishes_are_refused(drives, options, named):
    with pytest.raises(ConfigError, match=named):
        tune(drives[:1], **({"snr": SNR, "k": K, "jobs": 1} | options))


def test_update_is_linearised_in_the_filter_s_own_attitude():
    """z of a perturbed filter is H δx: the velocity moves with the attitude it was made with."""
    sim, sequence = drive(4, 120.0, "open", noise=False, atmosphere=False, receiver_clock=False)
    epochs = np.unique(sim.observations.time)
    turning = np.abs(sim.trajectory.kinematics(epochs).omega_eb_b[:, 2])
    time = epochs[np.argmax(turning)]  # where levers and attitude matter most
    at = sim.trajectory.kinematics(time)
    rows_all = doppler_rows(sim.observations, at.pos_e[0])
    rows = rows_all.take(sim.observations.time[rows_all.row] == time)
    stream = InertialStream(sim.imu.time, sim.imu.gyro_b, sim.imu.accel_b)
    model = ErrorModel(sequence.calibration.imu)

    def innovation(phi_b, dv_e):
        C_eb = at.C_eb[0] @ matrix_from_rotvec(-phi_b)  # true = estimated (I + [φ×])
        state = NavState(time, at.pos_e[0], at.vel_e[0] - dv_e, C_eb)
        kalman = ErrorStateFilter(model, stream, state, np.eye(15) * 1e-4)
        kalman.omega_b = at.omega_ib_b[0]
        aided = ddia_velocity(rows, filter_motion(kalman, sequence.calibration), time,
                              significance=1e-300)  # fmt: skip
        assert aided.ok
        return measurement(kalman, aided, sequence.calibration), kalman

    m, kalman = innovation(np.zeros(3), np.zeros(3))
    h = 1e-5
    for axis in np.eye(3):
        up, down = innovation(h * axis, np.zeros(3))[0].z, innovation(-h * axis, np.zeros(3))[0].z
        np.testing.assert_allclose((up - down) / (2 * h), m.H[:, ATT] @ axis, atol=1e-3)
        up, down = innovation(np.zeros(3), axis)[0].z, innovation(np.zeros(3), -axis)[0].z
        np.testing.assert_allclose((up - down) / 2.0, m.H[:, VEL] @ axis, atol=1e-9)
    lever = sequence.calibration.lever_antenna_b
    omega_eb = kalman.omega_b - kalman.C_eb.T @ OMEGA_IE_E
    assert np.linalg.norm(omega_eb) > 0.1
    np.testing.assert_allclose(
        m.z + antenna_velocity(kalman.state, kalman.omega_b, lever),
        sim.trajectory.vel_e(time, lever)[0], atol=1e-4,
    )  # fmt: skip


def test_command_writes_and_prints(data_dir, tmp_path, capsys):
    folder = data_dir / "comma2k19-example1"
    if not folder.is_dir():
        pytest.skip("comma2k19-example1 not found")
    parser = argparse.ArgumentParser()
    tuning_command.add_arguments(parser)
    out = str(tmp_path / "t")
    pairs = [str(folder), "--out", out, "--objective", "velocity"]
    arguments = parser.parse_args([*pairs, "--snr", "35:45:5", "--json"])
    tuning_command.run(arguments)
    printed = json.loads(capsys.readouterr().out)
    assert printed["recommended"]["min_cn0_dbhz"] in (35.0, 40.0, 45.0)
    assert printed["statistics"]["comma2k19-example1"]["rms_k05_mps"] == pytest.approx(
        2.75, rel=0.05
    )
    tuning_command.run(parser.parse_args([*pairs, "--snr", "40", "--cn0-of", "min"]))
    assert "--config" in capsys.readouterr().out
    gnss = load_config(tmp_path / "t/thresholds.toml").gnss
    assert gnss.ddia_min_cn0_dbhz == 40.0
    assert gnss.below_four == Config().gnss.below_four  # the method stays what it is
    with pytest.raises(ConfigError, match="objective: expected run or velocity, found 'speed'"):
        tuning_command.run(parser.parse_args([str(folder), "--objective", "speed"]))


@pytest.mark.parametrize("text", ["a:b:c", "1,x", "30:50", "50:30:1", "30:50:0", "0:1:0.0001"])
def test_ranges_that_are_none_are_refused(text):
    with pytest.raises(ConfigError, match="--snr"):
        tuning_command.parse_range("--snr", text)
    assert tuning_command.parse_range("--k", "0.05:0.2:0.05") == [0.05, 0.1, 0.15, 0.2]
    assert tuning_command.parse_range("--k", "0.1,0.4") == [0.1, 0.4]
