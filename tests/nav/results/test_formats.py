"""Exports: each read back by a reader of its own gives the trajectory again."""

from __future__ import annotations

from datetime import datetime
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.datasets.gpstime import from_calendar, from_week_sow
from certnav.filters.earth import C_en_at, C_en_of, lla_to_ecef
from certnav.filters.errors import ConfigError
from certnav.filters.rotation import matrix_from_rpy
from certnav.nav.evaluation.interpolation import usable_at
from certnav.nav.results.formats import FORMATS, format_rows, parse_formats, write_formats

KML = {"k": "http://www.opengis.net/kml/2.2"}


@pytest.fixture
def exported(drive, tmp_path):
    solution, _ = drive(duration=100.0)
    write_formats(tmp_path, FORMATS, solution.trajectory, solution.epochs)
    return solution, tmp_path


def rotation_angle(C_a, C_b):
    return Rotation.from_matrix(np.swapaxes(C_a, 1, 2) @ C_b).magnitude().max()


def test_nav_round_trip(exported):
    solution, folder = exported
    week, sow, lat, lon, height, vn, ve, vd, *rpy = np.loadtxt(folder / "solution.nav").T
    track = solution.trajectory
    np.testing.assert_allclose(from_week_sow(week, sow), track.time, atol=1e-6)
    pos_e = lla_to_ecef(np.deg2rad(lat), np.deg2rad(lon), height)
    np.testing.assert_allclose(pos_e, track.pos_e, atol=1e-4)
    C_en = C_en_at(np.deg2rad(lat), np.deg2rad(lon))
    vel_e = (C_en @ np.stack([vn, ve, vd], -1)[:, :, None])[:, :, 0]
    np.testing.assert_allclose(vel_e, track.vel_e, atol=2e-5)
    assert rotation_angle(C_en @ matrix_from_rpy(np.deg2rad(rpy).T), track.C_eb) < 1e-8
    assert min(rpy[2]) >= 0.0 and max(rpy[2]) < 360.0


def test_tum_round_trip(exported):
    solution, folder = exported
    track = solution.trajectory
    header = (folder / "solution.tum").read_text().splitlines()[0].split()
    lat, lon, height = (float(header[header.index(k) + 1]) for k in ("lat", "lon", "height"))
    time, *values = np.loadtxt(folder / "solution.tum").T
    enu, quaternion = np.array(values[:3]), np.array(values[3:]).T
    up_first = C_en_at(np.deg2rad(lat), np.deg2rad(lon)) @ [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
    origin = lla_to_ecef(np.deg2rad(lat), np.deg2rad(lon), height)
    np.testing.assert_allclose(origin + (up_first @ enu).T, track.pos_e, atol=2e-4)
    C_eb = up_first @ Rotation.from_quat(quaternion).as_matrix()
    assert rotation_angle(C_eb, track.C_eb) < 1e-8
    np.testing.assert_allclose(time, track.time, atol=1e-6)


def test_pos_round_trip(exported):
    solution, folder = exported
    track = solution.trajectory
    rows = [line.split() for line in (folder / "solution.pos").read_text().splitlines()]
    rows = [row for row in rows if not row[0].startswith("%")]
    time = []
    for date, clock, *_ in rows:
        hour, minute, second = clock.split(":")
        day = datetime.strptime(date, "%Y/%m/%d")
        time.append(from_calendar(day.year, day.month, day.day, int(hour), int(minute), second))
    np.testing.assert_allclose(time, track.time, atol=1e-6)
    table = np.array([row[2:] for row in rows], dtype=float)
    assert table.shape[1] == 22
    pos_e = lla_to_ecef(*np.deg2rad(table[:, :2]).T, table[:, 2])
    np.testing.assert_allclose(pos_e, track.pos_e, atol=3e-4)
    C_en = C_en_of(track.pos_e)
    vel_e = (C_en @ (table[:, 13:16] * [1, 1, -1])[:, :, None])[:, :, 0]
    np.testing.assert_allclose(vel_e, track.vel_e, atol=2e-5)
    std = np.sqrt(np.diagonal(track.cov_pos_n, axis1=1, axis2=2))
    np.testing.assert_allclose(table[:, 5:8], std, atol=6e-5)
    np.testing.assert_array_equal(table[:, 4], usable_at(solution.epochs, track.time))
    np.testing.assert_array_equal(table[:, 3], np.where(table[:, 4] >= 4, 5, 7))
    assert set(table[:, 3]) == {5.0, 7.0}


def test_pos_signs_of_the_covariances(drive, tmp_path):
    solution, _ = drive(duration=1.0)
    solution.trajectory.cov_pos_n[:] = [[4.0, -0.25, 0.09], [-0.25, 9.0, 0.36], [0.09, 0.36, 1.0]]
    write_formats(tmp_path, ["pos"], solution.trajectory, solution.epochs)
    row = (tmp_path / "solution.pos").read_text().splitlines()[-1].split()
    # n, e, u, ne, eu, un: two of the correlations turn with down → up.
    assert [float(v) for v in row[7:13]] == [2.0, 3.0, 1.0, -0.5, -0.6, -0.3]


def test_kml_is_a_coloured_track_in_utc(exported):
    solution, folder = exported
    root = ElementTree.parse(folder / "solution.kml").getroot()
    lines = root.findall(".//k:LineString/k:coordinates", KML)
    pieces = [np.array([p.split(",") for p in e.text.split()], float) for e in lines]
    # usable falls to 3 and to 0 once each: five pieces, each starting where the last one ended.
    assert len(pieces) == 5
    for before, after in pairwise(pieces):
        np.testing.assert_array_equal(before[-1], after[0])
    styles = [e.text for e in root.findall(".//k:Placemark/k:styleUrl", KML)]
    assert styles == ["#s4", "#s2", "#s4", "#s0", "#s4"]
    points = np.concatenate(pieces)
    assert len(points) == 201 + 4 and points[:, 0].mean() == pytest.approx(114.36, abs=0.01)
    ends = lla_to_ecef(*np.deg2rad(points[[0, -1]][:, [1, 0]]).T, points[[0, -1], 2])
    np.testing.assert_allclose(ends, solution.trajectory.pos_e[[0, -1]], atol=0.01)
    # GPS 2022-03-17 00:00:00 is 18 s ahead of UTC.
    assert root.find(".//k:when", KML).text == "2022-03-16T23:59:42.000Z"


def test_kml_without_satellites_is_one_line(drive, tmp_path):
    solution, _ = drive(duration=30.0, observations=False)
    write_formats(tmp_path, ["kml"], solution.trajectory, solution.epochs)
    root = ElementTree.parse(tmp_path / "solution.kml").getroot()
    assert len(root.findall(".//k:LineString", KML)) == 1


@pytest.mark.parametrize("duration", [0.0, 0.1])
def test_very_short_solutions(drive, tmp_path, duration):
    solution, _ = drive(duration=duration, reference=False)
    for path in write_formats(tmp_path, FORMATS, solution.trajectory, solution.epochs):
        assert path.stat().st_size > 0


def test_format_rows_across_blocks():
    table = np.arange(30.0).reshape(10, 3)
    wanted = "".join(f"{int(a)} {b:.1f} {c:.2f}\n" for a, b, c in table)
    assert format_rows("%d %.1f %.2f", table, rows_at_once=4) == wanted
    assert format_rows("%d", np.zeros((0, 1))) == ""


def test_unknown_format_names_the_nearest():
    assert parse_formats("pos, kml,pos") == ("pos", "kml")
    with pytest.raises(ConfigError, match=r"'kmz'.*did you mean 'kml'"):
        parse_formats("pos,kmz")
