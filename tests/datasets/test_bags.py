"""Bags written by rosbags: topics declared like columns give the drive they were written from."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.loading import load
from certnav.datasets.own.declare import draft_declaration
from certnav.datasets.receivers.bags import bag_table
from certnav.filters.earth import C_en_of, ecef_to_lla
from certnav.filters.errors import ConfigError, DataError
from oracles.seeds import seed_drive

UNIX = 315964800.0 - 18.0  # of the GPS epoch, leap seconds of 2020
DECLARED = """\
name = "bag"
[imu]
file = "{file}"
topic = "/imu/data"
time = "stamp"
time_scale = "unix"
gyro = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"]
accel = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"]
gyro_unit = "rad/s"
accel_unit = "m/s2"
axes = "FRD"
[imu.noise]
preset = "adis16470"
[antenna]
lever_frd_m = [-0.65, -0.05, -0.15]
[vehicle]
mounting_rpy_deg = [0.0, 0.0, 0.0]
[gnss]
file = "{file}"
topic = "/fix"
time = "stamp"
time_scale = "unix"
position = ["latitude", "longitude", "altitude"]
position_frame = "lla"
angle_unit = "deg"
height = "ellipsoid"
position_variance = ["position_covariance.4", "position_covariance.0", "position_covariance.8"]
"""


@pytest.fixture(scope="module")
def drive():
    return seed_drive()


def written(folder, kind, drive):
    """Write the drive as a bag of ROS 1 or 2 and return its path."""
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    types = store.types
    header = types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"]
    vector = types["geometry_msgs/msg/Vector3"]
    imu, fix = types["sensor_msgs/msg/Imu"], types["sensor_msgs/msg/NavSatFix"]
    status = types["sensor_msgs/msg/NavSatStatus"]
    still = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    more = {"seq": 0} if kind == "bag" else {}

    def head(time):
        ns = round((time + UNIX) * 1e9)
        return ns, header(stamp=stamp(ns // 10**9, ns % 10**9), frame_id="imu", **more)

    messages = []
    d = drive.simulation
    nine = np.zeros(9)
    for t, g, a in zip(d.imu.time, d.imu.gyro_b, d.imu.accel_b, strict=True):
        ns, h = head(t)
        message = imu(h, still, nine, vector(*map(float, g)), nine, vector(*map(float, a)), nine)
        messages.append((ns, "/imu/data", imu.__msgtype__, message))
    for t, p in zip(drive.fixes.time, drive.fixes.pos_e, strict=True):
        ns, h = head(t)
        lla = ecef_to_lla(p)
        covariance = np.diag([1.0, 4.0, 9.0]).ravel()
        message = fix(
            h, status(0, 1), *map(float, np.degrees(lla[:2])), float(lla[2]), covariance, 2
        )
        messages.append((ns, "/fix", fix.__msgtype__, message))
    messages.sort(key=lambda m: m[0])
    if kind == "bag":
        from rosbags.rosbag1 import Writer

        path = folder / "drive.bag"
        writer, serialize, options = Writer(path), store.serialize_ros1, {}
    else:
        from rosbags.rosbag2 import StoragePlugin, Writer

        path = folder / f"drive_{kind}"
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer(path, version=9, storage_plugin=plugin)
        serialize, options = store.serialize_cdr, {}
    with writer:
        kinds = {topic: name for _, topic, name, _ in messages}
        connections = {
            topic: writer.add_connection(topic, name, typestore=store, **options)
            for topic, name in kinds.items()
        }
        for ns, topic, name, message in messages:
            writer.write(connections[topic], ns, serialize(message, name))
    return path


def assert_enu(fixes):
    """The message's covariance is east, north, up: 1, 4 and 9 m²."""
    C_en = C_en_of(fixes.pos_e[0])
    cov_n = C_en.T @ fixes.pos_cov_e[0] @ C_en
    np.testing.assert_allclose(cov_n, np.diag([4.0, 1.0, 9.0]), atol=1e-6)


def test_a_draft_knows_what_standard_messages_hold(tmp_path, drive):
    """Of the declaration these tests use, the axes, the IMU and where it sits are left to say."""
    path = written(tmp_path, "bag", drive)
    draft = draft_declaration([path])
    blanks = [line.split(" ")[0] for line in draft.splitlines() if '= "?"' in line]
    assert blanks == ["axes", "preset", "lever_frd_m", "mounting_rpy_deg"]
    answers = {
        "axes": '"FRD"', "preset": '"adis16470"', "lever_frd_m": "[-0.65, -0.05, -0.15]",
        "mounting_rpy_deg": "[0, 0, 0]",
    }  # fmt: skip
    for key, value in answers.items():
        draft = draft.replace(f'{key} = "?"', f"{key} = {value}")
    (tmp_path / "sequence.toml").write_text(draft)
    found = load(tmp_path)
    np.testing.assert_allclose(found.imu.gyro_b, drive.simulation.imu.gyro_b, atol=1e-15)
    assert_enu(found.fixes)


@pytest.mark.parametrize("kind", ["bag", "sqlite", "mcap"])
def test_a_bag_gives_the_drive_it_was_written_from(tmp_path, drive, kind):
    path = written(tmp_path, kind, drive)
    (tmp_path / "sequence.toml").write_text(DECLARED.format(file=path.name))
    found = load(tmp_path)
    imu = drive.simulation.imu
    np.testing.assert_allclose(found.imu.time, imu.time, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.imu.gyro_b, imu.gyro_b, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.imu.accel_b, imu.accel_b, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.fixes.time, drive.fixes.time, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.fixes.pos_e, drive.fixes.pos_e, rtol=0, atol=1e-5)
    assert_enu(found.fixes)


def test_what_is_missing_or_broken_is_one_line(tmp_path, drive):
    path = written(tmp_path, "bag", drive)
    with pytest.raises(ConfigError, match=r"'/gps' is not in this bag — it holds /fix \(sensor_ms"):
        bag_table(path, "/gps")
    text = DECLARED.format(file=path.name)
    (tmp_path / "sequence.toml").write_text(text.replace('topic = "/imu/data"\n', ""))
    with pytest.raises(ConfigError, match=r"topic is not declared \(which one of drive\.bag\)"):
        load(tmp_path)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    for k in range(20):
        broken = bytearray(whole[: int(rng.integers(10, len(whole)))] if k % 2 else whole)
        for at in rng.integers(0, len(broken), 30):
            broken[at] ^= int(rng.integers(1, 256))
        other = tmp_path / f"broken{k}.bag"
        other.write_bytes(broken)
        try:
            bag_table(other, "/imu/data")
        except (DataError, ConfigError) as error:
            assert "\n" not in str(error)
    with pytest.raises(DataError, match="not found"):
        bag_table(tmp_path / "none.bag", "/imu/data")
