"""Declarations of own data and a configuration, whole; tests change what they look at.

`PLAIN` is the declaration of `bends`, written as a user would: every line of it is needed.
"""

from __future__ import annotations


def changed(text: str, *pairs: tuple[str, str]) -> str:
    """Return the text with the first of each pair, which must be there, become the second."""
    for old, new in pairs:
        assert old in text, f"{old!r} is not in the text"
        text = text.replace(old, new)
    return text


PLAIN = """\
name = "drive"

[time]
scale = "gps-sow"
week = 2129

[imu]
file = "imu.csv"
time = "t"
gyro = ["gx", "gy", "gz"]
accel = ["ax", "ay", "az"]
gyro_unit = "deg/s"
accel_unit = "m/s2"
axes = "RFU"

[imu.noise]
preset = "consumer"

[antenna]
lever_frd_m = [0.1, 0.2, -1.0]

[vehicle]
mounting_rpy_deg = [0.0, 0.0, 0.0]

[gnss]
file = "gnss.csv"
time = "t"
position = ["lat", "lon", "h"]
position_frame = "lla"
angle_unit = "deg"
height = "ellipsoid"
position_sigma = ["sn", "se", "su"]
velocity = ["vn", "ve", "vd"]
velocity_frame = "ned"
velocity_unit = "m/s"
velocity_sigma_mps = 0.1

[reference]
file = "ref.csv"
time = "t"
position = ["x", "y", "z"]
position_frame = "ecef"
attitude = ["roll", "pitch", "yaw"]
attitude_unit = "deg"
attitude_convention = "frd-ned"
attitude_of = "imu"
point = "antenna"
source = "the test"
"""
#: The same with all that can be declared of a table.
DECLARED = changed(
    PLAIN,
    ("[0.1, 0.2, -1.0]", "[-0.65, -0.05, -0.15]"),
    ("[0.0, 0.0, 0.0]\n", "[0.0, 0.0, 0.0]\nwheels_frd_m = [-0.5, 0.0, 1.4]\n"),
    (
        'file = "gnss.csv"\ntime = "t"\n',
        'file = "gnss.csv"\ntime = ["date", "clock"]\ntime_scale = "gps-calendar"\n',
    ),
    (
        "velocity_sigma_mps = 0.1\n",
        """\
velocity_sigma_mps = 0.1
satellites = "ns"
quality = "q"

[odometer]
file = "odometer.csv"
time = "t"
speed = "speed"
speed_unit = "km/h"
yaw_rate = "yaw"
yaw_rate_unit = "deg/s"
yaw_rate_axis = "up"
""",
    ),
    (
        'file = "ref.csv"\ntime = "t"\n',
        'file = "ref.csv.gz"\ntime = ["week", "sow"]\ntime_scale = "gps-week-sow"\n',
    ),
    ('source = "the test"', 'source = "simulation"'),
)
DECLARED_RINEX = """\
[time]
scale = "gps-sow"
week = 2129
[imu]
file = "imu.csv"
time = "t"
gyro = ["gx", "gy", "gz"]
accel = ["ax", "ay", "az"]
gyro_unit = "deg/s"
accel_unit = "m/s2"
axes = "RFU"
samples = "instant"
[imu.noise]
gyro_arw_deg_sqrth = 0.3
gyro_bias_instability_degph = 8.0
gyro_bias_turn_on_degph = 700.0
accel_noise_ug_sqrthz = 100.0
accel_bias_instability_mg = 0.1
accel_bias_turn_on_mg = 5.0
[antenna]
lever_frd_m = [-0.65, -0.05, -0.15]
lever_sigma_m = 0.1
[vehicle]
mounting_rpy_deg = [0.0, 0.0, 0.0]
[gnss]
file = "gnss.pos"
format = "rtklib"
[rinex]
observations = "rover.20o.gz"
navigation = ["brdc.rnx"]
systems = "GREC"
signals = "all"
[reference]
file = "groundtruth.txt"
format = "inertial-explorer"
attitude_of = "vehicle"
point = "imu"
source = "simulation"
"""


CONFIG = """\
[alignment]
method = "auto"
min_speed_mps = 3.0
[filter]
states = 21
bias_model = "gauss-markov"
gate_probability = 1e-4
smooth = true
output_rate_hz = 10.0
[gnss]
position = "rtk"
base_position_e_m = [1.0, 2.0, 3.0]
below_four = "ddia"
elevation_mask_deg = 15.0
raim = false
[vehicle]
nhc = "on"
sigma_lateral_mps = 0.2
zupt = true
[data]
lever = "figure"
week = 2129
"""
