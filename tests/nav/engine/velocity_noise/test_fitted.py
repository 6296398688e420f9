"""What a run makes of its velocities: what is fitted, what it becomes, and what is said."""

import dataclasses

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import ConfigError
from certnav.filters.rotation import FloatArray
from certnav.nav.config_files import from_tables
from certnav.nav.engine.prepared import Prepared
from certnav.nav.pipeline import navigate
from certnav.nav.solution import Solution

START = {"method": "level+course"}


def drive(seed: int, sigma: float, duration: float = 120.0):
    """A drive whose velocities have errors of `sigma` and say 0.05 m/s."""
    config = SimulationConfig(
        seed=seed, duration=duration, density="open", moving_start=True, static_start=0.0
    )
    made = simulate(config)
    time = np.arange(config.start_time + 1.0, config.start_time + duration)
    fixes = fixes_from_truth(
        made.trajectory, time, config.lever_antenna_b, (1.0, 1.0, 2.0), sigma,
        np.random.default_rng([3, seed]),
    )  # fmt: skip
    cov = np.broadcast_to(0.05**2 * np.eye(3), fixes.vel_cov_e.shape)
    return dataclasses.replace(
        made.sequence(dataclasses.replace(fixes, vel_cov_e=cov)), observations=None
    )


def run(sequence, **gnss) -> Solution:
    gnss.setdefault("position_noise", "declared")
    return navigate(sequence, from_tables({"alignment": START, "gnss": gnss}))


def said(solution: Solution) -> str:
    (text,) = [n.text for n in solution.notes if n.text.startswith("noise of ")]
    return text


def size(solution: Solution) -> float:
    """Root mean NIS per degree of freedom of velocities."""
    white = np.array([u.whitened for u in solution.updates if u.kind == "velocity" and u.whitened])
    return float(np.sqrt(np.mean(white**2)))


def sigma(solution: Solution) -> FloatArray:
    return np.median(np.sqrt(np.einsum("nii->ni", solution.trajectory.cov_vel_n)), axis=0)


def test_velocities_noisier_than_they_say_are_weighed_for_what_they_are():
    sequence = drive(4, 0.15)
    fitted, declared = run(sequence), run(sequence, velocity_noise="declared")
    assert float(said(fitted).split(":")[1].split()[0]) == pytest.approx(2.8, abs=0.4)
    assert not [n for n in declared.notes if n.text.startswith("noise of velocities")]
    assert size(fitted) == pytest.approx(1.0, abs=0.12) and size(declared) > 2.0
    assert (sigma(fitted) > 1.3 * sigma(declared)).all()


def test_velocities_as_good_as_they_say_stay_as_they_are():
    text = said(run(drive(5, 0.05)))
    assert float(text.split(":")[1].split()[0]) == pytest.approx(1.0, abs=0.1)


def test_what_is_too_short_or_wrong_stays_as_declared_and_the_run_says_so():
    assert "are too few to fit it to" in said(run(drive(6, 0.05, duration=15.0)))
    wild = run(
        drive(6, 0.6, duration=90.0), velocity_sigma_floor_mps=1e-3, velocity_sigma_scale=0.5
    )
    assert "which is wrong units, time stamps or axes, not noise; as declared" in said(wild)
    assert wild.status == "doubtful"


def test_doppler_is_fitted_whatever_is_declared(city):
    """The simulator's own: 0.02 m/s, and 0.03 at 45 dB-Hz beside it."""
    texts = []
    for factor in (0.5, 1.0, 2.0):
        solution = run(
            city.sequence, doppler_sigma_mps=0.06 * factor, doppler_floor_mps=0.04 * factor
        )
        texts.append(said(solution))
    at_45 = [float(t.split("dB-Hz, ")[1].split()[0]) for t in texts]
    np.testing.assert_allclose(at_45, 0.036, rtol=0.2)


@pytest.fixture(scope="module")
def doppler():
    """A drive with raw Doppler, and what it shows by itself."""
    config = SimulationConfig(
        seed=8, duration=100.0, density="open", imu_rate=50.0, moving_start=True, static_start=0.0
    )
    made = simulate(config)
    time = np.arange(made.config.start_time + 1.0, made.config.start_time + 99.0)
    lever = made.config.lever_antenna_b
    rng = np.random.default_rng(8)
    drive = made.sequence(fixes_from_truth(made.trajectory, time, lever, 1.0, 0.05, rng))
    errors, _, _ = Prepared(drive, own_noise=True).noise(from_tables({}))
    return drive, errors


def _noise(drive, known):
    config = from_tables({"gnss": {"doppler_known_mps": list(known)}})
    errors, _, notes = Prepared(drive, own_noise=True).noise(config)
    return errors, " ".join(note.text for note in notes), config


def test_known_noise_is_in_force_where_a_recording_shows_the_same(doppler):
    drive, own = doppler
    assert own.shown == pytest.approx((0.097, 0.036), rel=0.2)  # the simulator's
    errors, said, _ = _noise(drive, (0.15, 0.02, 1.1 * own.shown[0], own.shown[1] / 1.1))
    assert errors.doppler == (0.15, 0.02, own.doppler[2])  # the clock is its own
    known = "in force instead, as known (gnss.doppler_known_mps): 0.47 m/s at 35 dB-Hz, 0.15 at 45"
    assert known in said


def test_where_it_shows_another_nothing_is_changed_and_it_is_said_how_to_insist(doppler):
    """Neither the fit nor its prior: the run is the default's to the last digit."""
    drive, own = doppler
    for shown in ((1.2 * own.shown[0], own.shown[1]), (own.shown[0], own.shown[1] / 1.2)):
        errors, said, config = _noise(drive, (0.15, 0.02, *shown))
        assert errors == own
        assert "gnss.doppler_known_mps is not used: it was found where range rates show" in said
        assert "velocity_noise = 'declared', gnss.doppler_sigma_mps = 0.15" in said
    there, plain = navigate(drive, config), navigate(drive, from_tables({}))
    assert [n.severity for n in there.notes if "doppler_known" in n.text] == ["unmet"]
    assert there.status == plain.status == "ok"  # it is the default's run, and as good
    np.testing.assert_array_equal(there.trajectory.pos_e, plain.trajectory.pos_e)
    seen = drive.observations
    few = dataclasses.replace(drive, observations=seen.take(seen.time < drive.span[0] + 12.0))
    errors, said, _ = _noise(few, (0.15, 0.02, *own.shown))
    assert errors is None and "nothing of this recording to hold it against" in said


def test_known_noise_is_four_numbers():
    for known in ([0.1, 0.02], [0.1, 0.02, 0.1, 0.0]):
        with pytest.raises(ConfigError, match="doppler_known_mps: expected 4 numbers > 0"):
            from_tables({"gnss": {"doppler_known_mps": known}})
