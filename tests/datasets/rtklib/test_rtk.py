"""Relative positions against the truth of a simulated drive with a simulated base station."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.great.reader import read_great
from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.rtklib import relative_positions
from certnav.datasets.rtklib.screened_rinex import write_screened
from certnav.datasets.simulation.base_station import base_position
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.filters.errors import ConfigError, DataError

CONFIG = SimulationConfig(duration=240.0, seed=3, density="open", base_distance_m=5000.0)


@pytest.fixture(scope="module")
def simulation():
    return simulate(CONFIG)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return read_great(simulate_folder(CONFIG, tmp_path_factory.mktemp("rtk") / "drive"))


@pytest.fixture(scope="module")
def found(drive):
    return relative_positions(drive.rover_file, drive.base, drive.navigation)


def errors(fixes, simulation, lever=CONFIG.lever_antenna_b):
    return fixes.pos_e - simulation.trajectory.kinematics(fixes.time, lever).pos_e


def edited(path, to, change):
    to.write_text(change(path.read_text()))
    return to


def test_fixed_positions_are_within_centimetres_and_say_so(found, simulation):
    fixes = found.fixes
    fixed = fixes.quality == "fixed"
    assert fixed.mean() > 0.8 and set(fixes.quality) <= {"fixed", "float"}
    error = errors(fixes, simulation)
    assert np.linalg.norm(error[fixed], axis=1).max() < 0.05
    assert np.linalg.norm(error[~fixed], axis=1).max() < 3.0
    whitened = np.linalg.solve(np.linalg.cholesky(fixes.pos_cov_e), error[:, :, None])
    assert np.mean(whitened**2) < 1.5
    sigma = np.sqrt(np.diagonal(fixes.pos_cov_e, axis1=1, axis2=2))
    assert sigma[fixed].min() > 0.015 and sigma[fixed].max() < 0.1
    assert sigma[~fixed].min() > 0.5
    assert np.isnan(fixes.vel_e).all() and not found.failed


def test_times_are_gps_times_not_the_receivers(found, simulation):
    """The simulated clock is up to 0.1 ms off; at 15 m/s that is 1.5 mm, in time it is seen."""
    epochs = np.unique(simulation.observations.time)
    expected = epochs - simulation.clock.bias(epochs)
    np.testing.assert_allclose(found.fixes.time, expected, rtol=0, atol=2e-6)
    assert np.abs(expected - epochs).max() > 1e-5


def test_the_base_position_moves_every_position(drive, found, simulation):
    truth = base_position(CONFIG.origin_deg, CONFIG.base_distance_m)
    np.testing.assert_allclose(found.base_pos_e, truth, atol=1e-4)
    assert found.base_source == f"APPROX POSITION of {drive.base[0].name}"
    shift = np.array([0.7, -0.4, 0.2])
    moved = relative_positions(
        drive.rover_file, drive.base, drive.navigation, base_pos_e=truth + shift
    )
    fixed = moved.fixes.quality == "fixed"
    error = errors(moved.fixes, simulation)[fixed]
    np.testing.assert_allclose(error.mean(0), shift, atol=0.03)
    assert moved.base_source == "declared"


def test_the_antenna_stands_above_the_marker(drive, found, tmp_path):
    line = f"{0.0:14.4f}{0.0:14.4f}{0.0:14.4f}"
    raised = f"{1.5:14.4f}{0.3:14.4f}{-0.2:14.4f}"
    base = edited(drive.base[0], tmp_path / "raised.20o", lambda t: t.replace(line, raised))
    moved = relative_positions(drive.rover_file, base, drive.navigation)
    up_east_north = C_en_of(found.base_pos_e).T @ (moved.base_pos_e - found.base_pos_e)
    np.testing.assert_allclose(up_east_north, [-0.2, 0.3, -1.5], atol=1e-6)


def test_a_base_in_pieces_is_one_base(drive, found, tmp_path):
    text = drive.base[0].read_text()
    cut = text.index("\n>", len(text) // 2) + 1
    header = text[: text.index("\n", text.index("END OF HEADER")) + 1]
    pieces = [tmp_path / "a.20o", tmp_path / "b.20o"]
    pieces[0].write_text(text[:cut])
    pieces[1].write_text(header + text[cut:])
    joined = relative_positions(drive.rover_file, pieces, drive.navigation).fixes
    np.testing.assert_array_equal(joined.pos_e, found.fixes.pos_e)
    alone = relative_positions(drive.rover_file, pieces[:1], drive.navigation)
    assert {reason for _, reason in alone.failed} == {"no base observations"}
    assert len(alone.fixes) + len(alone.failed) == len(found.fixes)


def test_a_screened_satellite_takes_no_part(drive, simulation):
    """Neither do epochs in which nothing was left; what remains is still fixed."""
    o = drive.observations
    keep = ~((o.sat == "G03") | (o.time % 60 < 5))
    fixes = relative_positions(
        drive.rover_file, drive.base, drive.navigation, screened=o.mark(~keep, "test")
    ).fixes
    assert len(fixes) == np.unique(o.time[keep]).size
    assert fixes.satellites.max() < np.unique(o.sat, return_counts=True)[0].size
    fixed = fixes.quality == "fixed"
    assert fixed.any()
    assert np.linalg.norm(errors(fixes, simulation)[fixed], axis=1).max() < 0.05


def test_screening_leaves_rows_whole_and_flags_reacquisition(drive, tmp_path):
    from certnav.datasets.rtklib import read_observations

    o = drive.observations
    gap = (o.sat == o.sat[0]) & (o.time > o.time[0] + 20) & (o.time < o.time[0] + 26)
    assert not (o.loss_of_lock[gap] & 1).any()
    write_screened(drive.rover_file, tmp_path / "screened.20O", o.mark(gap, "test"))
    read = read_observations(tmp_path / "screened.20O", drive.navigation)
    kept = o.take(~gap)
    assert len(read) == len(kept)
    np.testing.assert_array_equal(read.sat, kept.sat)
    np.testing.assert_array_equal(read.carrier, kept.carrier)
    new = np.flatnonzero((read.loss_of_lock & 1) > (kept.loss_of_lock & 1))
    assert new.size == 1 and read.sat[new[0]] == o.sat[0]
    assert read.time[new[0]] == o.time[0] + 26


def test_refusals_are_one_line(drive, tmp_path):
    rover, base, navigation = drive.rover_file, drive.base[0], drive.navigation

    def refused(match, *arguments, error=DataError, **options):
        with pytest.raises(error, match=match) as caught:
            relative_positions(*arguments, **options)
        assert "\n" not in str(caught.value)

    refused("observation file not found", rover, tmp_path / "none.20o", navigation)
    refused("no base station file", rover, (), navigation)
    refused("no APPROX POSITION XYZ.*declare", rover, rover, navigation)
    refused("not on the Earth", rover, base, navigation, base_pos_e=(30.5, 114.3, 20.0))
    refused("X, Y, Z", rover, base, navigation, base_pos_e=(1.0,), error=ConfigError)
    refused("ambiguities", rover, base, navigation, ambiguities="x", error=ConfigError)
    refused("expected letters", rover, base, navigation, systems="X", error=ConfigError)
    later = edited(
        base, tmp_path / "later.20o", lambda t: t.replace("> 2020 10 27", "> 2020 10 28")
    )
    refused("no time in common", rover, later, navigation)
    broken = edited(base, tmp_path / "b.20o", lambda t: t.replace("\n -2270513", "\n -227x513"))
    refused(":7: APPROX POSITION XYZ: expected three numbers", rover, broken, navigation)


def test_base_is_optional_and_changes_nothing_else(simulation):
    alone = simulate(SimulationConfig(duration=240.0, seed=3, density="open"))
    assert alone.base is None
    np.testing.assert_array_equal(alone.observations.carrier, simulation.observations.carrier)
    with pytest.raises(ConfigError, match="base_distance_m"):
        SimulationConfig(base_distance_m=-1.0)


def test_carrier_double_differences_are_whole_cycles():
    """Short baseline, no noise: geometry and clocks leave integers; the ionosphere cancels."""
    config = SimulationConfig(
        duration=60.0, seed=1, density="open", noise=False, base_distance_m=0.0,
        atmosphere=False, static_start=60.0,
    )  # fmt: skip
    simulation = simulate(config)
    rover, base = simulation.observations, simulation.base.observations

    def single_range(o, clock, position):
        """Carrier less geometry and clocks [cycles]; only whole numbers remain."""
        from certnav.filters.earth import EARTH_RATE, SPEED_OF_LIGHT

        sight = o.sat_pos_e - position
        for _ in range(4):
            angle = EARTH_RATE * np.linalg.norm(sight, axis=1) / SPEED_OF_LIGHT
            x, y, z = o.sat_pos_e.T
            c, s = np.cos(angle), np.sin(angle)
            sight = np.column_stack([c * x + s * y, c * y - s * x, z]) - position
        distance = np.linalg.norm(sight, axis=1)
        bias = SPEED_OF_LIGHT * clock
        return o.carrier - (distance + bias - o.sat_clock) / o.wavelength

    clock = simulation.clock.bias(rover.time)
    rover_e = simulation.trajectory.kinematics(rover.time, config.lever_antenna_b, -clock).pos_e
    cycles = single_range(rover, clock, rover_e)
    # ms-level rounding of GPS time is 1e-7 s: at 4 km/s, half a millimetre of orbit
    assert np.abs(cycles - np.round(cycles)).max() < 0.02
    free = single_range(base, 0.0, simulation.base.pos_e)
    for _, epoch in base.epochs():  # its clock is its own secret: differences between satellites
        part = free[epoch] - free[epoch][0]
        assert np.abs(part - np.round(part)).max() < 0.02
