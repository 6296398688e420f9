"""Precise orbits and clocks: files made of broadcasts give the broadcasts' positions back."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

from certnav.datasets.great.reader import read_great
from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.rtklib import read_observations, relative_positions, single_point
from certnav.datasets.rtklib.satellites import satellite_states
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.errors import DataError

CONFIG = SimulationConfig(duration=20.0, seed=7, density="open", base_distance_m=3000.0)
C = 299792458.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return read_great(simulate_folder(CONFIG, tmp_path_factory.mktemp("products") / "drive"))


def dated(time):
    at = datetime.datetime(1980, 1, 6) + datetime.timedelta(seconds=time)
    return f"{at:%Y %m %d %H %M} {at.second:11.8f}"


def broadcast(drive, names, at):
    """Return states, and clocks without the relativity of the orbit, as products have them [m]."""
    states = satellite_states(drive.navigation, names, np.full(len(names), at))
    vel_i = states.vel_e + np.cross([0.0, 0.0, 7.2921151467e-5], states.pos_e)
    return states, states.clock + 2.0 * np.sum(states.pos_e * vel_i, axis=1) / C


def products(folder, drive, shift=0.0):
    """Write orbits every 5 min and clocks every 30 s, as broadcast plus `shift` [m]."""
    start = np.floor(drive.observations.time[0] / 900.0) * 900.0
    names = np.unique(drive.observations.sat)
    week, sow = int(start // 604800), start % 604800.0
    orbits = [
        f"#cP{dated(start - 3000.0)}      21 ORBIT IGS14 FIT  TST",
        f"## {week:4d} {sow - 3000.0:15.8f}   300.00000000 59149 0.0",
        f"+   {len(names):2d}   " + "".join(names),
        "%c G  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
    ]
    clocks = [
        f"{3.0:9.2f}           C                   G                   RINEX VERSION / TYPE",
        f"{'':<60}END OF HEADER",
    ]
    for k in range(21):
        at = start + 300.0 * (k - 10)
        states, clock = broadcast(drive, names, at)
        orbits.append(f"*  {dated(at)}")
        for name, p, c in zip(names, states.pos_e, clock, strict=True):
            x = (p + shift) * 1e-3
            orbits.append(f"P{name}{x[0]:14.6f}{x[1]:14.6f}{x[2]:14.6f}{c / C * 1e6:14.6f}")
    for at in start + 30.0 * np.arange(-20, 60):
        for name, c in zip(names, broadcast(drive, names, at)[1], strict=True):
            clocks.append(f"AS {name}  {dated(at)[:-2]}  1   {c / C:19.12E}")
    (folder / "orbit.sp3").write_text("\n".join([*orbits, "EOF"]) + "\n")
    (folder / "clock.clk").write_text("\n".join(clocks) + "\n")
    return [folder / "orbit.sp3", folder / "clock.clk"]


def test_orbits_of_the_broadcasts_give_their_states_back(drive, tmp_path):
    """To what interpolation over 5 min leaves: centimetres, and half a millimetre a second."""
    files = [*drive.navigation, *products(tmp_path, drive)]
    broadcast = read_observations(drive.rover_file, drive.navigation)
    precise = read_observations(drive.rover_file, files)
    assert precise.usable.all()
    assert np.abs(precise.sat_pos_e - broadcast.sat_pos_e).max() < 0.05
    assert np.abs(precise.sat_vel_e - broadcast.sat_vel_e).max() < 1e-3
    assert np.abs(precise.sat_clock - broadcast.sat_clock).max() < 0.05
    assert np.abs(precise.sat_clock_drift - broadcast.sat_clock_drift).max() < 2e-3
    expected, found = (
        single_point(o, n).fixes for o, n in ((broadcast, drive.navigation), (precise, files))
    )
    assert len(found) == len(expected)
    assert np.abs(found.pos_e - expected.pos_e).max() < 1.5  # weights are other: no URA


def test_precise_orbits_are_those_that_are_used(drive, tmp_path):
    """Shifted by 100 m they shift the satellites; relative positions do without them."""
    files = [*drive.navigation, *products(tmp_path, drive, shift=100.0)]
    moved = read_observations(drive.rover_file, files)
    apart = moved.sat_pos_e - read_observations(drive.rover_file, drive.navigation).sat_pos_e
    np.testing.assert_allclose(apart, 100.0, atol=0.05)
    found = relative_positions(drive.rover_file, drive.base, files)
    assert len(found.fixes) == 21  # relative positions are the broadcasts'


def test_what_they_lack_and_damage_is_named(drive, tmp_path):
    orbit, clock = products(tmp_path, drive)
    with pytest.raises(DataError, match="without broadcast ephemerides"):
        read_observations(drive.rover_file, [orbit, clock])
    text = orbit.read_text()
    gone = str(drive.observations.sat[0])
    blank = f"P{gone}" + 3 * f"{0.0:14.6f}" + f"{999999.999999:14.6f}"
    rows = [blank if x.startswith(f"P{gone}") else x for x in text.split("\n")]
    orbit.write_text("\n".join(rows))
    found = read_observations(drive.rover_file, [*drive.navigation, orbit])
    assert set(found.rejected[found.sat == gone]) == {"no ephemeris"}
    orbit.write_text("\n".join(x for k, x in enumerate(text.split("\n")) if k != 8))
    with pytest.raises(DataError, match=r"orbit\.sp3:\d+: expected \d+ satellites in the epoch"):
        read_observations(drive.rover_file, [*drive.navigation, orbit])
    orbit.write_text(text.replace("PG", "PX", 1).replace(".", "x", 40))
    with pytest.raises(DataError, match=r"orbit\.sp3:\d+: expected"):
        read_observations(drive.rover_file, [*drive.navigation, orbit])
    orbit.write_text(text[: text.index("*", 800)])
    with pytest.raises(DataError, match="at least 11 epochs of orbits, found"):
        read_observations(drive.rover_file, [*drive.navigation, orbit])
    clock.write_text(clock.read_text().replace("  1   ", "  1 x ", 1))
    with pytest.raises(DataError, match=r"clock\.clk:3: expected a satellite"):
        read_observations(drive.rover_file, [*drive.navigation, clock])
