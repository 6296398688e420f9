"""Satellites that are wrong all the time: found, named with their error, and left out."""

import re

import numpy as np
import pytest

from certnav.datasets.great.writer import write_great
from certnav.datasets.loading import load
from certnav.datasets.rtklib import single_point
from certnav.datasets.rtklib.persistence import (
    Linearised,
    persistent_faults,
    variance_factor,
)
from certnav.datasets.simulation.simulator import SimulationConfig, simulate

SATELLITES = np.array([f"G{k:02d}" for k in range(1, 10)])


def sky(seed, n=9):
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False) + rng.uniform(-0.3, 0.3, n)
    elevation = rng.uniform(0.3, 1.4, n)
    e = np.column_stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return np.column_stack([-e, np.ones(n)]), np.sqrt(1.0 + 1.0 / np.sin(elevation))


def fixes(bias, epochs=240, seed=0, n=9, interval=1.0, systematic=0.0):
    """Return fixes of which one satellite's ranges are too long by `bias` of u, −1 … 1 [m]."""
    H, sigma = sky(seed, n)
    rng = np.random.default_rng(seed)
    staying = np.full(n, 1.5)
    common = systematic * staying * rng.standard_normal(n)
    w = 1.0 / sigma
    projector = np.eye(n) - H @ np.linalg.pinv(H * w[:, None]) * w
    out = []
    for k in range(epochs):
        error = 2.0 * sigma * rng.standard_normal(n) + common
        error[4] += bias(2.0 * k / (epochs - 1) - 1.0)
        residuals = projector @ error
        out.append(Linearised(k * interval, SATELLITES[:n], H, residuals, sigma, staying))
    return out


@pytest.mark.parametrize("metres", [20.0, -40.0, 6000.0])
def test_a_satellite_off_by_tens_of_metres_or_kilometres_is_found(metres):
    (fault,) = persistent_faults(fixes(lambda u: metres))
    assert fault.satellite == "G05" and fault.fixes == 240 and fault.suspects == ()
    assert fault.bias == pytest.approx(metres, abs=4.0)


def test_an_error_that_goes_through_zero_is_found():
    """An orbit shifted along itself, when the satellite is highest."""
    (fault,) = persistent_faults(fixes(lambda u: 40.0 * u))
    assert fault.satellite == "G05" and abs(fault.bias) < 4.0


def test_sound_satellites_are_not_accused():
    for seed in range(40):
        assert persistent_faults(fixes(lambda u: 0.0, systematic=1.0, seed=seed)) == ()


def test_few_fixes_and_no_redundancy_say_nothing():
    assert len(persistent_faults(fixes(lambda u: 50.0, epochs=61))) == 1
    assert persistent_faults(fixes(lambda u: 50.0, epochs=58)) == ()
    assert persistent_faults([]) == ()
    four = [Linearised(f.time, *(part[:4] for part in f[1:])) for f in fixes(lambda u: 50.0)]
    assert persistent_faults(four) == ()


def test_five_satellites_know_that_one_is_wrong_but_not_which():
    (fault,) = persistent_faults(fixes(lambda u: 400.0, n=5))
    assert {fault.satellite, *fault.suspects} == set(SATELLITES[:5])


def test_fixes_closer_than_a_second_say_the_same():
    (fault,) = persistent_faults(fixes(lambda u: 40.0, epochs=1200, interval=0.2))
    assert fault.fixes == 240


def test_wrong_for_a_while_is_said_of_that_while():
    """Twenty minutes in four stretches: in one of them, and in most of them."""
    late = fixes(lambda u: 60.0 * (u > 0.5), epochs=1200)
    (fault,) = persistent_faults(late)
    ((first, last),) = fault.spans
    assert first == pytest.approx(900.0, abs=2.0) and last == 1199.0
    assert fault.covers(np.array([500.0, 1000.0])).tolist() == [False, True]
    (fault,) = persistent_faults(fixes(lambda u: 60.0 * (u > -0.5), epochs=1200))
    assert fault.covers(np.array([0.0, 1e6])).all()


def test_what_is_too_little_to_accuse_anybody_is_told_from_what_sound_ones_show():
    sound = [variance_factor(fixes(lambda u: 0.0, systematic=1.0, seed=k)) for k in range(8)]
    wrong = [fixes(lambda u: 8.0, seed=k) for k in range(1, 5)]
    assert all(persistent_faults(w) == () for w in wrong)
    assert np.median(sound) < 1.3 and min(map(variance_factor, wrong)) > 2.0
    assert variance_factor([]) == 1.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    config = SimulationConfig(
        seed=1, duration=150.0, density="suburb", nlos_probability=0.0, static_start=5.0
    )
    write_great(simulate(config), folder)
    return folder, load(folder)


def shifted(drive, satellite, anomaly):
    """Return the drive read with one satellite shifted along its orbit [rad], and restore it."""
    folder, _ = drive
    (file,) = (folder / "GNSS" / "Product").iterdir()
    text = file.read_text()

    def moved(match):
        return f"{match[1]}{float(match[2]) + anomaly:19.12E}"

    try:
        file.write_text(re.sub(rf"(?m)^({satellite} .*\n.{{61}})(.{{19}})", moved, text))
        wrong = load(folder)
        return single_point(wrong.observations, wrong.navigation, elevation_mask=0.17)
    finally:
        file.write_text(text)


@pytest.mark.parametrize("metres", [2.6e3, 2.6e4, 1e5])
def test_a_wrong_ephemeris_is_named_and_does_no_harm(drive, metres):
    """Of any satellite: what the fixes say is what they say without it."""
    _, sound = drive
    right = single_point(sound.observations, sound.navigation, elevation_mask=0.17)
    assert right.persistent == () and right.left_out == ()
    for satellite in ("G09", "G20", "G29"):
        found = shifted(drive, satellite, metres / 26.56e6)
        (fault,) = found.persistent
        assert fault.satellite == satellite and fault.suspects == ()
        assert not any(satellite in names for names in found.satellites)
        assert set(sound.observations.sat[list(found.left_out)]) == {satellite}
        off = np.linalg.norm(found.fixes.pos_e - right.fixes.pos_e, axis=1)
        assert np.median(off) < 5.0 and len(found.fixes) == len(right.fixes)
