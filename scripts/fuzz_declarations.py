"""Declarations and a configuration for `fuzz_seeds` to break."""

DECLARED = """\
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
lever_frd_m = [-0.65, -0.05, -0.15]

[vehicle]
mounting_rpy_deg = [0.0, 0.0, 0.0]
wheels_frd_m = [-0.5, 0.0, 1.4]

[gnss]
file = "gnss.csv"
time = ["date", "clock"]
time_scale = "gps-calendar"
position = ["lat", "lon", "h"]
position_frame = "lla"
angle_unit = "deg"
height = "ellipsoid"
position_sigma = ["sn", "se", "su"]
velocity = ["vn", "ve", "vd"]
velocity_frame = "ned"
velocity_unit = "m/s"
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

[reference]
file = "ref.csv.gz"
time = ["week", "sow"]
time_scale = "gps-week-sow"
position = ["x", "y", "z"]
position_frame = "ecef"
attitude = ["roll", "pitch", "yaw"]
attitude_unit = "deg"
attitude_convention = "frd-ned"
attitude_of = "imu"
point = "antenna"
source = "simulation"
"""


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
