"""The comma2k19 segment: clocks, frames and signs against the camera pose."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from certnav.datasets.formats.comma2k19 import is_comma2k19, read_comma2k19
from certnav.datasets.physics import course_of
from certnav.filters.earth import EARTH_RATE, OMEGA_IE_E, SPEED_OF_LIGHT, C_en_of, gravity_e
from certnav.filters.errors import DataError
from certnav.filters.rotation import matrix_from_rpy


@pytest.fixture(scope="module")
def segment(data_dir):
    return read_comma2k19(data_dir / "comma2k19-example1")


def at(time, record, name):
    values = getattr(record, name)
    return np.column_stack([np.interp(time, record.time, v) for v in values.T])


def camera_attitude(reference):
    return C_en_of(reference.pos_e) @ matrix_from_rpy(reference.rpy)


def imu_mean(imu, values, start, end):
    total = np.zeros_like(values)
    total[1:] = np.cumsum(values[1:] * np.diff(imu.time)[:, None], axis=0)

    def upto(time):
        return np.column_stack([np.interp(time, imu.time, v) for v in total.T])

    return (upto(end) - upto(start)) / (end - start)[:, None]


def test_camera_axes_are_forward_right_down(segment):
    """Velocity in camera axes is forward; heading is the course to the mounting's degree."""
    reference = segment.reference
    vel_c = np.einsum("nji,nj->ni", camera_attitude(reference), reference.vel_e)
    assert vel_c[:, 0].mean() > 16.0
    assert np.abs(vel_c[:, 1:].mean(axis=0)).max() < 1.5
    course = course_of(reference.pos_e, reference.vel_e)
    assert np.degrees(np.abs(np.median(course - reference.rpy[:, 2]))) < 2.0


def test_gyro_and_accelerometer_are_those_of_the_camera_without_delay(segment):
    """Rates of the pose, and its acceleration minus gravity, in camera axes."""
    reference, imu = segment.reference, segment.imu
    C_ec, t = camera_attitude(reference), reference.time
    start, end = t[3:-9], t[9:-3]
    turn = np.einsum("nji,njk->nik", C_ec[3:-9], C_ec[9:-3])
    skew = 0.5 * (turn - np.swapaxes(turn, 1, 2)) / (end - start)[:, None, None]
    rate = np.column_stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]])
    gyro = imu_mean(imu, imu.gyro_b, start, end)
    for axis in range(3):
        assert np.corrcoef(gyro[:, axis], rate[:, axis])[0, 1] > 0.97
    for late in (-0.1, 0.1):  # so that 0.126 s, the frames' own stamps, would show
        shifted = imu_mean(imu, imu.gyro_b, start + late, end + late)
        assert np.corrcoef(shifted[:, 0], rate[:, 0])[0, 1] < 0.85

    accel_e = (reference.vel_e[9:-3] - reference.vel_e[3:-9]) / (end - start)[:, None]
    middle = slice(6, -6)
    force_e = accel_e + 2.0 * np.cross(OMEGA_IE_E, reference.vel_e[middle])
    force_e = force_e - gravity_e(reference.pos_e[middle])
    force_c = np.einsum("nji,nj->ni", C_ec[middle], force_e)
    error = imu_mean(imu, imu.accel_b, start, end) - force_c
    assert np.abs(error.mean(axis=0)).max() < 0.2
    assert error.std(axis=0).max() < 0.3


def doppler_velocity(segment, rows):
    """Return ECEF velocity and clock drift from the range rates of one epoch."""
    o = segment.observations.take(rows).take(segment.observations.has_range_rate[rows])
    pos_e = at(o.time[:1], segment.reference, "pos_e")[0]
    turn = EARTH_RATE * np.linalg.norm(o.sat_pos_e - pos_e, axis=1) / SPEED_OF_LIGHT
    c, s, zero = np.cos(turn), np.sin(turn), 0.0 * turn
    to_reception = np.array([[c, s, zero], [-s, c, zero], [zero, zero, zero + 1]])
    sat_pos, sat_vel = (
        np.einsum("ijn,nj->ni", to_reception, x) for x in (o.sat_pos_e, o.sat_vel_e)
    )
    line = sat_pos - pos_e
    line /= np.linalg.norm(line, axis=1)[:, None]
    weight = 10.0 ** (o.cn0 / 20.0)
    z = o.range_rate + o.sat_clock_drift - np.einsum("ni,ni->n", line, sat_vel)
    H = np.column_stack([-line, np.ones(len(o))])
    return np.linalg.lstsq(H * weight[:, None], z * weight, rcond=None)[0]


def test_range_rates_recede_positive_and_their_time_is_the_poses(segment):
    """Doppler velocity meets the pose at the converted time, and misses it 0.126 s later."""
    epochs = list(segment.observations.epochs())[10:-10:3]
    time = np.array([t for t, _ in epochs])
    vel_e = np.array([doppler_velocity(segment, rows)[:3] for _, rows in epochs])
    C_en = C_en_of(segment.reference.pos_e[0])

    def misfit(shift):
        error = (vel_e - at(time + shift, segment.reference, "vel_e")) @ C_en
        return np.median(np.abs(error - np.median(error, axis=0)), axis=0), error

    here, error = misfit(0.0)
    assert np.abs(np.median(error, axis=0)).max() < 0.15
    assert (here < [0.10, 0.09, 0.20]).all()
    assert misfit(-0.126)[0][0] > 1.3 * here[0]  # the frames' own stamps; the road leads north


def test_live_fixes_are_ellipsoidal_and_on_time(segment):
    fixes, reference = segment.fixes, segment.reference
    inside = (fixes.time > reference.time[0]) & (fixes.time < reference.time[-1])
    error = fixes.pos_e[inside] - at(fixes.time[inside], reference, "pos_e")
    C_en = C_en_of(reference.pos_e[0])
    vel_n = at(fixes.time[inside], reference, "vel_e") @ C_en
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    error_n = error @ C_en
    along = np.einsum("ni,ni->n", error_n[:, :2], vel_n[:, :2]) / speed
    assert abs(np.polyfit(speed, along, 1)[0]) < 0.05  # delay [s]; 0.14 with the frames' stamps
    assert np.hypot(error_n[:, 0], error_n[:, 1]).max() < 2.0
    assert abs(np.median(error_n[:, 2])) < 3.0  # the geoid is 32 m below the ellipsoid here


def test_odometer_is_the_speed(segment):
    odometer, reference = segment.odometer, segment.reference
    inside = (odometer.time > reference.time[0]) & (odometer.time < reference.time[-1])
    speed = np.interp(odometer.time, reference.time, np.linalg.norm(reference.vel_e, axis=1))
    error = (odometer.speed - speed)[inside]
    assert error.std() < 0.08
    assert abs(error.mean()) < 0.3


def test_rows_without_satellite_state_are_kept_and_marked(segment):
    o = segment.observations
    glonass = np.char.startswith(o.sat, "R")
    assert glonass.sum() == 3897
    assert (o.rejected[glonass] == "no ephemeris").all()
    assert (~glonass).sum() == 5331
    assert o.has_range_rate[~glonass].all()
    assert np.unique(o.wavelength[~glonass]) == pytest.approx(0.190293673, abs=1e-9)
    assert len(np.unique(o.wavelength[glonass])) > 3  # one per frequency channel
    assert segment.navigation == ()


def test_what_is_not_known_is_said(segment):
    assert segment.calibration.lever_antenna_sigma == 1.0
    assert "unknown" in segment.calibration.lever_antenna_source
    assert any("0.126 s later and not used" in note for note in segment.notes)
    assert "NOT independent" in segment.reference.source


def test_clocks_that_do_not_run_together_are_refused(tmp_path, data_dir):
    source, copy = data_dir / "comma2k19-example1", tmp_path / "segment"
    shutil.copytree(source, copy)
    (copy / "processed_log").chmod(0o755)
    file = copy / "processed_log/GNSS/raw_gnss_ublox/t"
    time = np.load(file)
    file.unlink()
    with pytest.raises(DataError, match=r"raw_gnss_ublox/t: array not found"):
        read_comma2k19(copy)
    with file.open("wb") as stream:
        np.save(stream, time * 1.0001)
    with pytest.raises(DataError, match="expected a constant, varies by"):
        read_comma2k19(copy)
    file.write_bytes(b"no array")
    with pytest.raises(DataError, match="not a numpy array"):
        read_comma2k19(copy)


def test_recognition(tmp_path, data_dir):
    assert is_comma2k19(data_dir / "comma2k19-example1")
    assert not is_comma2k19(tmp_path)


def neighbour(data_dir, folder, edits):
    """Copy the segment with some of its arrays changed."""
    shutil.copytree(data_dir / "comma2k19-example1", folder)
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    for name, edit in edits.items():
        value = edit(np.load(folder / name))
        with (folder / name).open("wb") as stream:
            np.save(stream, value)
    return folder


def test_satellites_of_other_systems_are_left_out_and_counted(data_dir, tmp_path, segment):
    """SBAS, Galileo, and GLONASS not yet named, in a neighbour's log."""

    def others(raw):
        raw = raw.copy()
        raw[[3, 8, 20], 0] = [46.0, 211.0, 255.0]
        return raw

    edits = {"processed_log/GNSS/raw_gnss_ublox/value": others}
    found = read_comma2k19(neighbour(data_dir, tmp_path / "d", edits))
    assert len(found.observations) == len(segment.observations) - 3
    assert any("rows (3 of other satellites left out)" in note for note in found.notes)


def test_stamps_that_repeat_on_the_bus_and_among_live_fixes(data_dir, tmp_path, segment):
    def twice(value):
        return np.concatenate([value[:10], value[9:]])

    edits = dict.fromkeys(
        ("processed_log/CAN/speed/t", "processed_log/CAN/speed/value",
         "processed_log/GNSS/live_gnss_ublox/value"), twice,
    )  # fmt: skip
    found = read_comma2k19(neighbour(data_dir, tmp_path / "d", edits))
    np.testing.assert_array_equal(found.odometer.time, segment.odometer.time)
    np.testing.assert_array_equal(found.fixes.time, segment.fixes.time)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("global_pose/frame_velocities", "frame_velocities: expected 1200 velocities"),
        ("global_pose/frame_positions", "frame_orientations: expected 1195 unit quaternions"),
        ("processed_log/IMU/gyro/value", "gyro/t: expected"),
        ("processed_log/CAN/speed/value", "speed/t: expected"),
    ],
)
def test_arrays_cut_short_are_named(data_dir, tmp_path, name, message):
    folder = neighbour(data_dir, tmp_path / "d", {name: lambda value: value[:-5]})
    with pytest.raises(DataError, match=message):
        read_comma2k19(folder)
