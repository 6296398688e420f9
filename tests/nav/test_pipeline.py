"""The filter loop on simulated drives: exact data, noisy data, gaps, gates and recovery."""

import dataclasses
import re

import numpy as np
import pytest

from certnav.datasets.observations import GnssFixes
from certnav.datasets.sequence import Sequence
from certnav.datasets.series import ImuData, Odometer
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import AlignmentError, ConfigError, DataError
from certnav.nav.config_files import from_tables
from certnav.nav.engine.gnss import gnss_timeline, sources
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate


def carried_drive(seed=0, sigma_pos=0.5, sigma_vel=0.05, noise=True, duration=200.0, **config):
    """A simulated drive with white positions and velocities at 1 Hz, away from IMU epochs."""
    simulation = simulate(
        SimulationConfig(seed=seed, duration=duration, density="open", noise=noise, **config)
    )
    rng = np.random.default_rng([5, seed])
    calibration = simulation.calibration
    epochs = simulation.imu.time[0] + np.arange(0.5, duration - 1.0) + 0.0033
    fixes = fixes_from_truth(
        simulation.trajectory, epochs, calibration.lever_antenna_b, sigma_pos, sigma_vel, rng
    )
    return Sequence(
        "drive", simulation.imu, calibration, fixes=fixes, reference=simulation.reference
    )


NO_CONSTRAINTS = {"nhc": "off", "zupt": False, "zaru": False, "odometer": "off"}


#: Where a test makes errors that the declared noise does not have, which would be fitted to them.
DECLARED = {"position_noise": "declared", "velocity_noise": "declared"}


def config_with(**tables):
    return from_tables({"vehicle": NO_CONSTRAINTS, **tables})


def test_exact_data_give_the_exact_track():
    sequence = carried_drive(noise=False, sigma_pos=0.0, sigma_vel=0.0)
    metrics = evaluate(navigate(sequence, config_with()), sequence).metrics
    assert metrics["position_3d_rms_m"] < 0.02
    assert metrics["velocity_3d_rms_mps"] < 0.02
    assert metrics["horizontal_max_m"] < 0.1


def test_noisy_data_are_smoothed_and_claimed_honestly():
    nees, horizontal = [], []
    for seed in range(6):
        sequence = carried_drive(seed)
        result = evaluate(navigate(sequence, config_with(gnss=DECLARED)), sequence)
        nees.append(result.consistency["nees_position_mean"])
        horizontal.append(result.metrics["horizontal_rms_m"])
        assert result.consistency["nis_mean"] == pytest.approx(1.0, abs=0.15)
    assert np.mean(horizontal) < 0.5 * np.sqrt(2) * 0.5  # half of what a fix alone has
    assert 1.5 < np.mean(nees) < 5.0


def test_updates_fall_on_their_own_times():
    """Fixes lie 3.3 ms beside the IMU grid; without splitting the interval, 15 m/s are 5 cm off."""
    sequence = carried_drive(noise=False, sigma_pos=0.0, sigma_vel=0.0)
    solution = navigate(sequence, config_with())
    accepted = [u for u in solution.updates if u.accepted]
    assert {u.time for u in accepted} <= set(sequence.fixes.time)
    late = [u for u in accepted if u.time > accepted[0].time + 60.0 and u.kind == "position"]
    innovations = np.array([u.whitened for u in late]) * np.sqrt(2e-6 + 0.02**2)
    assert np.abs(innovations).max() < 0.01


def test_every_update_is_accounted_for():
    sequence = carried_drive()
    solution = navigate(sequence, config_with())
    assert len(solution.updates) == 2 * len(sequence.fixes)
    for update in solution.updates:
        assert update.accepted != bool(update.reason)
        assert np.isfinite(update.nis) == bool(update.whitened)


def test_a_jump_in_the_fix_is_refused_and_named():
    sequence = carried_drive()
    pos_e = sequence.fixes.pos_e.copy()
    pos_e[120] += [15.0, 0.0, 0.0]
    jumped = dataclasses.replace(sequence, fixes=dataclasses.replace(sequence.fixes, pos_e=pos_e))
    solution = navigate(jumped, config_with())
    refused = [u for u in solution.updates if u.reason.startswith("innovation test")]
    assert [u.time for u in refused] == [sequence.fixes.time[120]]
    metrics = evaluate(solution, jumped).metrics
    assert metrics["horizontal_max_m"] < 2.0


def test_recovery_from_a_persistent_shift():
    """A shift that stays is refused at first, then believed: no lock-out."""
    sequence = carried_drive()
    pos_e = sequence.fixes.pos_e.copy()
    pos_e[100:] += [30.0, 0.0, 0.0]
    shifted = dataclasses.replace(sequence, fixes=dataclasses.replace(sequence.fixes, pos_e=pos_e))
    solution = navigate(shifted, config_with(filter={"patience_s": 8.0}, gnss=DECLARED))
    overruled = [u for u in solution.updates if u.accepted and u.reason]
    assert overruled
    last = [u for u in solution.updates if u.kind == "position"][-20:]
    assert all(u.accepted for u in last)
    locked_out = navigate(shifted, config_with(filter={"patience_s": 0.0}, gnss=DECLARED))
    assert not any(
        u.accepted
        for u in locked_out.updates
        if u.kind == "position"
        and u.time > sequence.fixes.time[100] + 1.0
        and u.time < sequence.fixes.time[130]
    )


def test_an_outage_grows_the_covariance_and_the_error_stays_inside():
    sequence = carried_drive(seed=3)
    keep = np.ones(len(sequence.fixes), dtype=bool)
    keep[100:130] = False
    cut = dataclasses.replace(sequence, fixes=sequence.fixes.take(keep))
    solution = navigate(cut, config_with())
    result = evaluate(solution, cut)
    gap = (result.time > sequence.fixes.time[99]) & (result.time < sequence.fixes.time[130])
    sigma, error = result.sigma_pos_n[gap], np.abs(result.error_pos_n[gap])
    assert sigma[-2].max() > 4.0 * sigma[0].max()
    assert (error < 3.5 * sigma).all()


@pytest.mark.parametrize("method", ["auto", "given"])
def test_given_attitude_starts_at_the_first_fix(method):
    sequence = carried_drive(noise=False)
    first = int(np.searchsorted(sequence.reference.time, sequence.fixes.time[0]))
    roll, pitch, heading = np.degrees(sequence.reference.rpy[first])
    solution = navigate(
        sequence,
        config_with(alignment={
            "method": method, "roll_deg": roll, "pitch_deg": pitch, "heading_deg": heading,
        }),
    )  # fmt: skip
    assert solution.alignment.status == "given"
    assert solution.alignment.time == sequence.fixes.time[1] or (
        solution.alignment.time == sequence.fixes.time[0]
    )


def test_scale_factors_are_estimated_with_21_states():
    sequence = carried_drive(seed=2, scale_factors=True, duration=400.0)
    rms = {}
    for states in (15, 21):
        solution = navigate(sequence, config_with(filter={"states": states}))
        rms[states] = evaluate(solution, sequence).metrics["horizontal_rms_m"]
    assert rms[21] <= 1.05 * rms[15]


def test_no_velocity_means_no_alignment():
    sequence = carried_drive()
    nothing = np.full_like(sequence.fixes.vel_e, np.nan)
    silent = dataclasses.replace(sequence, fixes=dataclasses.replace(sequence.fixes, vel_e=nothing))
    with pytest.raises(AlignmentError, match="no usable GNSS velocity"):
        navigate(silent, config_with())


def test_sources_that_are_not_there_are_refused():
    sequence = carried_drive()
    assert sources(sequence, config_with().gnss) == ("carried", "carried")
    for key, value in (("position", "spp"), ("velocity", "doppler")):
        with pytest.raises(ConfigError, match=f"gnss.{key}: '{value}' needs"):
            gnss_timeline(sequence, config_with(gnss={key: value}).gnss)


def test_imu_gap_is_noted():
    sequence = carried_drive()
    keep = np.ones(len(sequence.imu), dtype=bool)
    keep[5000:5020] = False
    imu = ImuData(sequence.imu.time[keep], sequence.imu.gyro_b[keep], sequence.imu.accel_b[keep])
    solution = navigate(dataclasses.replace(sequence, imu=imu), config_with())
    assert any("IMU: 1 gaps, the longest 0.210 s" in note.text for note in solution.notes)


def test_window_of_a_sequence():
    sequence = carried_drive()
    start = float(sequence.imu.time[0])
    part = sequence.between(start + 50.0, start + 100.0)
    assert part.imu.time[0] >= start + 50.0 and part.fixes.time[-1] <= start + 100.0
    assert part.reference is not None and len(part.reference) == pytest.approx(501, abs=2)
    with pytest.raises(DataError, match="no IMU data between"):
        sequence.between(start + 1e5, start + 2e5)
    with pytest.raises(DataError, match="is not before"):
        sequence.between(start + 2.0, start + 1.0)


def test_fixes_without_velocity_rows_are_logged():
    sequence = carried_drive()
    vel_e = sequence.fixes.vel_e.copy()
    vel_e[50] = np.nan
    fixes: GnssFixes = dataclasses.replace(sequence.fixes, vel_e=vel_e)
    solution = navigate(dataclasses.replace(sequence, fixes=fixes), config_with())
    missing = [u for u in solution.updates if u.reason == "no velocity in the data"]
    assert [u.time for u in missing] == [fixes.time[50]]


def test_a_solution_that_diverges_ends_there_and_starts_again():
    sequence = carried_drive()
    accel_b = sequence.imu.accel_b.copy()
    accel_b[15000:15010] = 1e200  # finite; its square is not
    imu = ImuData(sequence.imu.time, sequence.imu.gyro_b, sequence.imu.accel_b)
    object.__setattr__(imu, "accel_b", accel_b)  # which a sequence would refuse
    with np.errstate(all="ignore"):
        solution = navigate(dataclasses.replace(sequence, imu=imu), config_with(gnss=DECLARED))
    sound = navigate(sequence, config_with(gnss=DECLARED))
    time = solution.trajectory.time
    before = time < sequence.imu.time[15000] - 1e-6
    np.testing.assert_array_equal(
        solution.trajectory.pos_e[before], sound.trajectory.pos_e[: before.sum()]
    )
    (note,) = [n for n in solution.notes if n.severity == "lost"]
    assert "diverged" in note.text and "started again at SOW" in note.text
    assert solution.status == "restarted"
    assert time[-1] == sound.trajectory.time[-1]
    off = solution.trajectory.pos_e[-1] - sound.trajectory.pos_e[-1]
    assert np.linalg.norm(off) < 3.0


def test_a_fix_a_little_beyond_the_gate_is_weighted_down_not_refused():
    sequence = carried_drive(3)
    fixes = sequence.fixes
    jump = np.zeros_like(fixes.pos_e)
    jump[80] = fixes.pos_e[80] / np.linalg.norm(fixes.pos_e[80]) * 4.0
    shifted = dataclasses.replace(fixes, pos_e=fixes.pos_e + jump)
    jumped = dataclasses.replace(sequence, fixes=shifted)
    soft = navigate(jumped, config_with(filter={"gate_width": 2.0}))
    hard = navigate(jumped, config_with(filter={"gate_width": 1.0}))
    at = fixes.time[80]
    said = {
        name: next(u for u in s.updates if u.kind == "position" and abs(u.time - at) < 1e-6)
        for name, s in (("soft", soft), ("hard", hard))
    }
    assert said["soft"].accepted and said["soft"].reason.startswith("weighted down")
    assert not said["hard"].accepted
    # Weighted down to the gate it moves the solution by a fraction of its jump.
    off = evaluate(soft, jumped).metrics["position_3d_rms_m"]
    assert off < 1.2 * evaluate(hard, jumped).metrics["position_3d_rms_m"]


def test_a_late_odometer_is_put_in_step_and_its_unit_found():
    """Half a second late and in pulses: the run finds both, says so, and then believes it."""
    sequence = carried_drive(4)
    reference = sequence.reference
    time = np.arange(reference.time[0], reference.time[-1], 0.05)
    speed = np.interp(time, reference.time, np.linalg.norm(reference.vel_e, axis=1))
    config = from_tables({"vehicle": {"odometer": "on"}})
    for late, scale, doubtful in ((0.0, 1.0, False), (0.5, 1.01, False), (0.5, 0.1966, True)):
        odometer = Odometer(time + late, speed / scale)
        found = navigate(dataclasses.replace(sequence, odometer=odometer), config)
        (note,) = [n for n in found.notes if n.text.startswith("odometer: stamps")]
        said = [float(v) for v in re.findall(r"\d+\.\d+", note.text)]
        assert said[0] == pytest.approx(late, abs=0.05) and note.doubtful is doubtful
        assert said[2] == pytest.approx(scale, rel=0.01)
        wheel = [u.accepted for u in found.updates if u.kind == "odometer"]
        assert np.mean(wheel) > 0.95 and len(wheel) > 50
