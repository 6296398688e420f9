"""Window-wise alignment: exact on simulated data, sane on real data, refusals in one line."""

import dataclasses
import json
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.simulation import simulate_window
from certnav.datasets.loading import load
from certnav.datasets.series import Odometer
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import AlignmentError, ConfigError
from certnav.nav.commands.cli import main
from certnav.nav.windows.noise import fit_window_noise
from certnav.nav.windows.options import WindowOptions
from certnav.nav.windows.recording import align_recording, align_windows, summary
from certnav.velocity.range_rate import DopplerNoise


class Labels(NamedTuple):
    """What the fit asks of observations."""

    time: np.ndarray
    sat: np.ndarray
    cn0: np.ndarray
    elevation: np.ndarray


@pytest.fixture(scope="module")
def exact():
    """A minute and a half of driving without noise, with an odometer made from the truth."""
    config = SimulationConfig(
        seed=5, duration=90.0, density="open", noise=False, atmosphere=False, static_start=5.0
    )
    simulation = simulate(config)
    trajectory, calibration = simulation.trajectory, simulation.calibration
    time = simulation.imu.time[5:-5]
    k = trajectory.kinematics(time, calibration.lever_vehicle_b)
    speed = np.einsum("ni,ni->n", k.vel_e, k.C_eb[:, :, 0])
    return dataclasses.replace(simulation.sequence(), odometer=Odometer(time, speed))


@pytest.mark.parametrize("method", ["certified", "sdp", "voba"])
def test_exact_data_give_the_heading(exact, method):
    results = align_windows(exact, WindowOptions(method=method, window=20.0, step=10.0))
    moving = [r for r in results if np.isfinite(r.error) and (r.passed or r.status == "BASELINE")]
    assert len(moving) >= 4
    # The Earth's rate is left out of the local attitude: 0.1° over a window.
    assert np.degrees(np.median([abs(r.error) for r in moving])) < 0.1
    assert np.degrees(max(abs(r.error) for r in moving)) < 0.5


def test_two_satellites_are_enough_or_said_not_to_be(exact):
    """A certified window is right; with two satellites a planar window may only be ambiguous."""
    options = WindowOptions(method="sdp", satellites=2.5, window=20.0, step=10.0)
    passed = [r for r in align_windows(exact, options) if r.passed]
    assert passed
    assert max(abs(np.degrees(r.error)) for r in passed) < 2.0


def test_real_car_in_san_francisco(data_dir):
    results = align_windows(load(data_dir / "comma2k19-example1"), WindowOptions(method="sdp"))
    numbers = summary(results)
    assert numbers["passed"] == numbers["windows"] == 9
    assert numbers["mae_deg"] < 1.5 and numbers["max_deg"] < 2.0


def test_labels_tell_reflected_signals_apart(data_dir):
    """Berlin: with reflected rows windows break outright, without them they do not."""
    sequence = load(data_dir / "smartloc-berlin1")
    every, clear = (
        summary(align_windows(sequence, WindowOptions(method="sdp", clock="linear", labels=labels)))
        for labels in ("all", "los")
    )
    assert clear["max_deg"] < 10.0 < 30.0 < every["max_deg"]


def test_no_wrong_window_passes_the_verdicts(data_dir):
    """The SDP certifies windows that reflections have made wrong by 100°; the verdicts do not."""
    sequence = load(data_dir / "smartloc-berlin1")
    for method, step in (("certified", 5.0), ("robust", 45.0)):
        results = align_windows(sequence, WindowOptions(method=method, step=step))
        assert results and not any(r.passed and abs(r.error) > r.bound for r in results)


def test_doppler_that_the_phase_contradicts_is_left_out_and_said(exact):
    """Three satellites whose Doppler follows something else: gone, by name, and the rest stands."""
    observations = exact.observations
    bad = np.isin(observations.sat, np.unique(observations.sat)[:3])
    rate = observations.range_rate + bad * 2.0
    broken = dataclasses.replace(exact, observations=observations.with_columns(range_rate=rate))
    options = WindowOptions(window=20.0, step=20.0)
    kept, believed = (
        align_windows(broken, dataclasses.replace(options, phase=phase))
        for phase in ("gate", "off")
    )
    moving = [k for k, r in enumerate(kept) if r.passed]
    assert moving and all(abs(kept[k].error) < kept[k].bound for k in moving)
    assert not any(believed[k].passed for k in moving)
    assert all(kept[k].left_out["phase contradicts Doppler"] > 10 for k in moving)
    assert "phase contradicts Doppler" not in believed[moving[0]].left_out


def test_the_same_draw_keeps_the_same_satellites(exact):
    options = WindowOptions(satellites=3.0, seed=4)
    one, two = (align_windows(exact, options) for _ in range(2))
    assert [r.heading for r in one] == [r.heading for r in two]
    assert all(r.satellites == pytest.approx(3.0) for r in one)


def test_mistakes_are_named(exact):
    with pytest.raises(ConfigError, match="did you mean 'voba'"):
        WindowOptions(method="vobba")
    with pytest.raises(ConfigError, match="expected 'all' or 'los'"):
        WindowOptions(labels="nlos")
    with pytest.raises(ConfigError, match="expected 'assumed' or 'fitted'"):
        WindowOptions(noise="guessed")
    with pytest.raises(ConfigError, match="expected 'gate', 'rates' or 'off'"):
        WindowOptions(phase="on")
    with pytest.raises(ConfigError, match="level"):
        WindowOptions(level_deg=0.0)
    alone = dataclasses.replace(exact, odometer=None)
    with pytest.raises(AlignmentError, match="neither odometer nor IMU"):
        align_windows(dataclasses.replace(alone, imu=None), WindowOptions())
    for asked in ({"method": "voba"}, {"noise": "fitted"}, {"level_deg": 2.0}):
        with pytest.raises(ConfigError, match="needs an odometer"):
            align_windows(alone, WindowOptions(**asked))
    with pytest.raises(AlignmentError, match="less than one window"):
        align_windows(exact, WindowOptions(window=500.0))


@pytest.mark.parametrize("turned", [0.0, 120.0])
def test_the_imu_alone_gives_the_heading_too(exact, turned):
    """However the IMU sits in the vehicle: the heading is the vehicle's, the error its own."""
    C_bv = Rotation.from_euler("z", -turned, degrees=True).as_matrix()
    alone = dataclasses.replace(exact, odometer=None)
    if turned:
        imu, calibration = exact.imu, exact.calibration
        alone = dataclasses.replace(
            alone,
            imu=dataclasses.replace(
                imu, gyro_b=imu.gyro_b @ C_bv.T, accel_b=imu.accel_b @ C_bv.T
            ),
            calibration=dataclasses.replace(
                calibration, C_bv=C_bv @ calibration.C_bv,
                lever_antenna_b=C_bv @ calibration.lever_antenna_b,
                lever_vehicle_b=C_bv @ calibration.lever_vehicle_b,
            ),
            reference=dataclasses.replace(exact.reference, attitude_frame="v"),
        )  # fmt: skip
    passed = [r for r in align_windows(alone, WindowOptions(window=20.0, step=5.0)) if r.passed]
    assert len(passed) >= 4
    assert all(abs(r.error) < min(r.bound, 4.0 * r.sigma_heading) for r in passed)
    assert np.degrees(np.median([abs(r.error) for r in passed])) < 1.0
    reference = alone.reference
    for r in passed:
        near = int(np.argmin(np.abs(reference.time - r.start)))
        off = np.angle(np.exp(1j * (r.heading - reference.rpy[near, 2])))
        assert abs(np.degrees(off)) < 6.0  # within half an epoch of a turn


def test_command_prints_table_and_json(data_dir, tmp_path, capsys):
    path = str(data_dir / "comma2k19-example1")
    picture = tmp_path / "windows.png"
    assert main(["align", path, "--plot", str(picture)]) == 0
    assert "passed" in capsys.readouterr().out
    assert picture.stat().st_size > 10_000
    assert main(["align", path, "--json", "--method", "gauss-newton"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["windows"]) == 9
    assert {"heading_deg", "error_deg", "status", "chi2_per_dof"} <= set(result["windows"][0])
    assert result["noise"]["source"] == "fitted" and result["level_deg"] == 2.0


def test_level_vehicle_and_fitted_noise_find_the_heading(exact):
    options = WindowOptions(
        method="robust", noise="fitted", level_deg=2.0, window=20.0, step=20.0, decimate=2
    )
    results, noise = align_recording(exact, options)
    passed = [r for r in results if r.passed]
    assert passed and all(abs(r.error) < r.bound for r in passed)
    assert noise.source == "fitted"
    # The only errors are those of the model: the Earth's rate in the gyros, hills.
    assert noise.doppler.sigma(45.0) < 0.05 and noise.clock_walk == 0.02


def test_noise_is_that_of_the_noisier_streets_and_not_of_the_stops():
    """Half of the windows three times as noisy, and a vehicle that stands half of the time."""
    windows = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        w = simulate_window(rng, 7, epochs=60, interval=0.5, speed=10.0)
        still = w.rows.epoch < 30
        own = np.where(still, 0.01, 0.3 if seed % 2 else 0.1)
        moves = np.where(still, 0.0, 1.0)
        vel_w = w.rows.vel_w * moves[:, None]
        z = w.rows.z - np.sum(w.rows.e_e * ((w.rows.vel_w - vel_w) @ w.C_ew.T), axis=1)
        rows = dataclasses.replace(w.rows, vel_w=vel_w, z=z + own * rng.standard_normal(own.size))
        sat = np.array([f"G{k % 7:02d}" for k in range(own.size)])
        level = np.full(own.size, 45.0)
        windows.append((rows, Labels(rows.time, sat, level, np.full(own.size, np.nan))))
    noise = fit_window_noise(windows, ClockModel("random-walk", 0.1))
    assert noise.doppler.sigma(45.0) == pytest.approx(0.3, rel=0.2)


def test_noise_of_one_recording_comes_back():
    """What was put into simulated windows: σ by C/N0 and elevation, a clock that walks."""
    true, windows = DopplerNoise(0.12, 0.03, decade_db=18.0, low=2.0), []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        w = simulate_window(rng, 7, epochs=60, interval=0.5, speed=10.0, clock_walk=0.05)
        cn0 = rng.uniform(32.0, 50.0, len(w.rows))
        up = rng.uniform(0.1, 1.5, cn0.size)
        z = w.rows.z + true.sigma(cn0, up) * rng.standard_normal(cn0.size)
        sat = np.array([f"G{k % 7:02d}" for k in range(cn0.size)])
        z[sat == "G03"] += 9.0 * (seed == 2)  # one reflection
        rows = dataclasses.replace(w.rows, z=z)
        windows.append((rows, Labels(rows.time, sat, cn0, up)))
    noise = fit_window_noise(windows, ClockModel("random-walk", 0.1))
    level = np.array([35.0, 40.0, 45.0])
    for up in np.radians([8.0, 20.0, 70.0]):
        found, expected = noise.doppler.sigma(level, up), true.sigma(level, up)
        np.testing.assert_allclose(found, expected, rtol=0.25)
    assert noise.correlated == pytest.approx(1.0, abs=0.4)
    assert 0.03 < noise.clock_walk < 0.08


def test_no_passed_window_of_either_city_is_wrong(data_dir):
    """Fitted noise and a level vehicle: windows pass, and none beyond its bound."""
    whole = load(data_dir / "smartloc-berlin1" / "full")
    begin = whole.span[0] + 60.0
    city, motorway = whole.between(begin, begin + 45.0), load(data_dir / "comma2k19-example1")
    for drive, how in ((city, {"step": 10.0}), (motorway, {"step": 15.0, "decimate": 10})):
        options = WindowOptions(method="robust", noise="fitted", level_deg=2.0, **how)
        results = align_windows(drive, options)
        passed = [r for r in results if r.passed]
        assert passed and all(abs(r.error) < r.bound for r in passed)
        assert max(abs(np.degrees(r.error)) for r in results) < 5.0


def test_proofs_are_written_verified_and_refused_when_tampered_with(data_dir, tmp_path, capsys):
    path, proof = str(data_dir / "smartloc-berlin1"), tmp_path / "proof.json"
    assert main(["align", path, "--step", "20", "--proof", str(proof)]) == 0
    table = capsys.readouterr().out
    assert "OUABCK" in table and "Doppler σ fitted" in table
    assert main(["verify", str(proof)]) == 0
    assert "3 of 3 proofs hold" in capsys.readouterr().out
    assert main(["verify", str(proof), "--rows", path]) == 0
    assert "3 of 3 proofs hold, in exact arithmetic; they are about the rows of" in (
        capsys.readouterr().out
    )
    content = json.loads(proof.read_text())
    # The proof of one window under the name of another: true, but not of this recording's rows.
    content["proofs"][0]["window"] = 1
    proof.write_text(json.dumps(content))
    assert main(["verify", str(proof)]) == 0
    assert main(["verify", str(proof), "--rows", path]) == 1
    assert "Q is not that of its rows" in capsys.readouterr().out
    content["proofs"][1]["multipliers"][4] = "7"
    proof.write_text(json.dumps(content))
    assert main(["verify", str(proof)]) == 1
    assert "2 of 3 proofs hold" in capsys.readouterr().out
    assert main(["align", path, "--method", "sdp", "--proof", str(proof)]) == 1
    assert "'sdp' proves nothing" in capsys.readouterr().err
    assert main(["verify", str(tmp_path / "nothing.json")]) == 1
    assert "nothing.json" in capsys.readouterr().err
