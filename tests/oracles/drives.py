"""One simulated drive in the forms that readers know: what `seeds` breaks later."""

from __future__ import annotations

import dataclasses
import gzip
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from certnav.datasets.gpstime import to_calendar, to_week_sow
from certnav.datasets.series import Reference
from certnav.datasets.simulation.simulator import Simulation, SimulationConfig, simulate
from certnav.filters.earth import C_en_of, ecef_to_lla
from certnav.filters.rotation import FloatArray, matrix_from_rpy
from certnav.filters.sensors import STANDARD_GRAVITY

WEEK = 2129


_RFU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # its own inverse


_NOISE = """\
imunoise:
  arw: [0.003, 0.004, 0.003]
  vrw: [0.03, 0.03, 0.03]
  gbstd: [0.027, 0.027, 0.027]
  abstd: [15.0, 15.0, 15.0]     # [mGal]
  gsstd: [300.0, 300.0, 300.0]
  asstd: [300.0, 300.0, 300.0]
  corrtime: 4.0                    # [hr]
antlever:  [ -0.65, -0.05, -0.15 ]
"""


@dataclass(frozen=True)
class Drive:
    """Arrays of a simulated drive in the forms files hold them."""

    simulation: Simulation
    sow: FloatArray
    gyro: FloatArray
    accel: FloatArray
    fixes: Reference

    @classmethod
    def of(
        cls, duration: float, imu_rate: float, fix_interval: float = 0.5, seed: int = 3
    ) -> Drive:
        """Simulate: open sky, moving from the start."""
        config = SimulationConfig(
            seed=seed, duration=duration, imu_rate=imu_rate, density="open", moving_start=True,
            base_distance_m=1000.0, reference_rate=2.0,
        )  # fmt: skip
        s = simulate(config)
        # stamps that are not the IMU's, on the grid that two decimals hold
        times = np.arange(s.imu.time[0] + 0.2, s.imu.time[-1], fix_interval)
        _, sow = to_week_sow(s.imu.time)
        return cls(s, sow, s.imu.gyro_b, s.imu.accel_b, s.trajectory.reference(times))


def write_table(path: Path, header: str, table: FloatArray, fmt: str | list[str], sep: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, table, fmt=fmt, delimiter=sep, header=header, comments="")


def geodetic_deg(pos_e: FloatArray) -> FloatArray:
    return ecef_to_lla(pos_e) * [180.0 / np.pi, 180.0 / np.pi, 1.0]


def velocity_n(record: Reference) -> FloatArray:

    return np.einsum("nji,nj->ni", C_en_of(record.pos_e), record.vel_e)


def seconds_of_week(record: Reference) -> FloatArray:
    return to_week_sow(record.time)[1]


def write_imu_csv(path: Path, d: Drive) -> None:
    table = np.column_stack([d.sow, np.degrees(d.gyro) @ _RFU, d.accel @ _RFU])
    write_table(path, "t,gx,gy,gz,ax,ay,az", table, "%.6f", ",")


def write_pos(path: Path, d: Drive, form: str = "llh") -> None:
    """Write RTKLIB solutions of several forms."""
    f, vel_n = d.fixes, velocity_n(d.fixes)
    n = len(f)
    tail = "%3d %3d" + " %8.4f" * 6 + " %6.2f %6.1f"
    fixed = np.tile([1, 12, 0.01, 0.01, 0.02, 0.001, -0.001, 0.002, 0.0, 99.0], (n, 1))
    deviations = "sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s) ratio"
    if form == "ecef":
        head = "% GPST x-ecef(m) y-ecef(m) z-ecef(m) Q ns sdx(m) sdy(m) sdz(m) sdxy(m) sdyz(m) "
        head += "sdzx(m) age(s) ratio"
        week, sow = to_week_sow(f.time)
        table = np.column_stack([week, sow, f.pos_e, fixed])
        write_table(path, head, table, f"%d %.3f %.4f %.4f %.4f {tail}", " ")
        return
    velocity = vel_n * [1.0, 1.0, -1.0]
    lla, rows = geodetic_deg(f.pos_e), []
    for k in range(n):
        t = to_calendar(round(float(f.time[k]), 3))
        stamp = f"{t:%Y/%m/%d %H:%M:%S}.{t.microsecond // 1000:03d}"
        place = "{:.9f} {:.9f} {:.4f}".format(*lla[k])
        if form == "dms":
            d_, m_ = divmod(lla[k, :2] * 60.0, 60.0)
            place = " ".join(
                f"{int(a)} {int(b)} {(b - int(b)) * 60:.5f}" for a, b in zip(d_, m_, strict=True)
            )
            place += f" {lla[k, 2]:.4f}"
        row = f"{stamp} {place} {tail % tuple(fixed[k])}"
        if form == "llh":
            row += " {:.5f} {:.5f} {:.5f} 0.02 0.02 0.03 0 0 0".format(*velocity[k])
        rows.append(row)
    names = "latitude(deg) longitude(deg)"
    if form == "dms":
        names = "latitude(d'\") longitude(d'\")"
    head = f"% program : certnav\n%  GPST {names} height(m) Q ns {deviations}"
    if form == "llh":
        head += " vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun"
    path.write_text(head + "\n" + "\n".join(rows) + "\n")


def write_flt(path: Path, d: Drive) -> None:
    """Write a GREAT-PVT solution."""
    n = len(d.fixes)
    spread = np.tile([0.01, 0.02, 0.03, 0.1, 0.1, 0.1], (n, 1))
    head = (
        "# SOW X Y Z Vx Vy Vz X-RMS Y-RMS Z-RMS Vx-RMS Vy-RMS Vz-RMS NSat PDOP sigma0 AmbStatus "
        "Ratio BL Quality\n# (s) (m) (m) (m)"
    )
    table = np.column_stack([seconds_of_week(d.fixes), d.fixes.pos_e, d.fixes.vel_e, spread])
    write_table(path, head, table, "%.3f " + "%.4f " * 12 + "15 1.2 0.5 Fixed 12.3 4500.1 1", " ")


def write_kfgins(folder: Path, d: Drive) -> None:
    """Write increments, positions with velocity, truth and options."""
    dt = np.diff(d.sow, prepend=2 * d.sow[0] - d.sow[1])[:, None]
    table = np.column_stack([d.sow, d.gyro * dt, d.accel * dt])
    write_table(folder / "imu.txt", "", table, "%.12f", " ")
    f = d.fixes
    lla, vel_n, sow, n = geodetic_deg(f.pos_e), velocity_n(f), seconds_of_week(f), len(f)
    spread = np.tile([0.01, 0.02, 0.03], (n, 1))
    table = np.column_stack([sow, lla, spread, vel_n, 0.1 + spread])
    write_table(folder / "gnss.txt", "", table, "%.10f", " ")
    table = np.column_stack([np.full(n, WEEK), sow, lla, vel_n, np.degrees(f.rpy)])
    write_table(folder / "truth.nav", "", table, "%.10f", " ")
    for file in ("imu.txt", "gnss.txt", "truth.nav"):
        (folder / file).write_text((folder / file).read_text().lstrip("\n"))
    (folder / "options.yaml").write_text(_NOISE)


def write_oakville(folder: Path, d: Drive) -> None:
    """Write a drive with relative time, forward-left-up."""
    start, flip = d.sow[0], np.array([1.0, -1.0, -1.0])
    table = np.column_stack([d.sow - start, d.gyro * flip, d.accel * flip])
    head = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    write_table(folder / "imu.csv", head, table, "%.8f", ",")
    f = d.fixes
    t, lla, vel_n = seconds_of_week(f) - start, geodetic_deg(f.pos_e), velocity_n(f)
    spread = np.tile([1.0, 1.0, 2.0, 0.1, 0.1, 0.2], (len(f), 1))
    place = "lat_deg,lon_deg,height_m,vn_mps,ve_mps,vd_mps"
    head = f"t_s,{place},pos_std_n_m,pos_std_e_m,pos_std_d_m,vel_std_n_mps,vel_std_e_mps,"
    head += "vel_std_d_mps,heading_rad"
    table = np.column_stack([t, lla, vel_n, spread, f.rpy[:, 2]])
    write_table(folder / "gnss.csv", head, table, "%.10f", ",")
    (folder / "gnss.csv.gz").write_bytes(gzip.compress((folder / "gnss.csv").read_bytes()))
    (folder / "gnss.csv").unlink()
    write_table(
        folder / "reference_position.csv", f"t_s,{place}", np.column_stack([t, lla, vel_n]),
        "%.10f", ",",
    )  # fmt: skip
    rpy = np.degrees(f.rpy) + np.array([0.01, 0.0, 0.0])  # roll 0 is before it has initialised
    head = "t_s,roll_deg,pitch_deg,yaw_deg"
    table = np.column_stack([t, rpy])
    write_table(folder / "reference_attitude.csv", head, table, "%.10f", ",")
    write_table(folder / "reference_mount.csv", head, np.column_stack([t, 0 * rpy]), "%.8f", ",")


def write_rtklibexplorer(folder: Path, d: Drive) -> None:
    """Write g and deg/s in the sensor's axes, the time tag and a solution."""
    from certnav.datasets.formats.rtklibexplorer import IMU_LAG

    axes = np.array([-1.0, 1.0, -1.0])
    accel = d.accel * axes / STANDARD_GRAVITY
    ms = np.round((d.sow - d.sow[0]) * 1e3) + 5000.0
    table = np.column_stack([accel, np.degrees(d.gyro) * axes, ms])
    write_table(folder / "imu_1.csv", "", table, ["%.8f"] * 6 + ["%d"], ",")
    text = (folder / "imu_1.csv").read_text().lstrip("\n")
    (folder / "imu_1.csv").write_text(text)
    gtime = d.simulation.imu.time[0] + IMU_LAG + 315964800.0
    tag = b"TIMETAG RTKLIB demo5".ljust(60, b"\0")
    tag += struct.pack("<IId", 7, int(gtime), gtime - int(gtime))
    (folder / "imu_1.csv.tag").write_bytes(tag)
    write_pos(folder / "gnss_1.pos", d)


def write_comma2k19(folder: Path, d: Drive) -> None:
    """Write a segment: boot time is GPS time minus a constant."""
    s, f = d.simulation, d.fixes
    boot = s.imu.time[0] - 100.0

    def save(name: str, value: object) -> None:
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("wb") as stream:
            np.save(stream, np.asarray(value))

    imu = "processed_log/IMU"
    for sensor, value in (("gyro", d.gyro), ("accelerometer", d.accel)):
        save(f"{imu}/{sensor}/t", s.imu.time - boot)
        save(f"{imu}/{sensor}/value", value)
    week, sow = to_week_sow(f.time)

    C_ec = C_en_of(f.pos_e) @ matrix_from_rpy(f.rpy)
    save("global_pose/frame_times", f.time - boot)
    save("global_pose/frame_gps_times", np.column_stack([week, sow]))
    save("global_pose/frame_positions", f.pos_e)
    save("global_pose/frame_velocities", f.vel_e)
    save("global_pose/frame_orientations", Rotation.from_matrix(C_ec).as_quat(scalar_first=True))
    o = s.observations
    week, sow = to_week_sow(o.time)
    prn = np.array([int(name[1:]) for name in o.sat])
    raw = np.column_stack(
        [prn, week, sow, np.full(len(o), np.nan), o.pseudorange, np.full(len(o), 5.0),
         o.range_rate, np.full(len(o), 0.2), o.cn0, o.carrier]
    )  # fmt: skip
    gnss = "processed_log/GNSS"
    save(f"{gnss}/raw_gnss_ublox/value", raw)
    save(f"{gnss}/raw_gnss_ublox/t", o.time - boot)
    lla = geodetic_deg(f.pos_e)
    speed = np.linalg.norm(f.vel_e, axis=1)
    utc_ms = (f.time + 315964800.0 - 18.0) * 1e3
    live = np.column_stack([lla[:, :2], speed, utc_ms, lla[:, 2], np.degrees(f.rpy[:, 2])])
    save(f"{gnss}/live_gnss_ublox/value", live)
    save("processed_log/CAN/speed/t", f.time - boot)
    save("processed_log/CAN/speed/value", speed[:, None])
    names = "tow_rx_s,prn,sat_x_m,sat_y_m,sat_z_m,sat_vx_mps,sat_vy_mps,sat_vz_mps,sat_clk_m"
    state = [sow, prn, o.sat_pos_e, o.sat_vel_e, o.sat_clock, o.sat_clock_drift]
    table = np.column_stack(state)
    file = folder / "derived/gps_ublox_with_satpv.csv"
    write_table(file, f"{names},sat_clkdrift_mps", table, "%.6f", ",")


def write_smartloc(folder: Path, d: Drive) -> None:
    """Write the three files of a receiver with truth beside its rows."""
    s, f = d.simulation, d.fixes
    o = s.observations
    lla, sow = geodetic_deg(f.pos_e), seconds_of_week(f)
    heading = np.pi / 2 - f.rpy[:, 2]

    def truth(time: FloatArray) -> FloatArray:
        at = np.clip(np.searchsorted(f.time, time), 0, len(f) - 1)
        zero = np.zeros(time.size)
        return np.column_stack(
            [np.full(time.size, WEEK), sow[at], lla[at, 1], zero, lla[at, 0], zero, lla[at, 2],
             zero, heading[at], zero, zero, zero, zero + 5.0, zero, zero, zero]
        )  # fmt: skip

    week, tow = to_week_sow(o.time)
    head = truth(o.time)
    lines = [";".join(f"c{k + 1}" for k in range(34))]
    for k in range(len(o)):
        # a satellite of each kind of row: GLONASS, SBAS, unknown label
        name, number, slot = "GPS", int(o.sat[k][1:]), 0
        if k % 7 == 3:
            name, number, slot = "Glonass", 20, 9
        elif k % 11 == 5:
            name, number = "SBAS", 123
        row = [f"{v:.10g}" if abs(v) < 1e3 else f"{v:.4f}" for v in head[k]]
        row += [f"{tow[k]:.3f}", f"{week[k]}", "18", "9", "1", f"{o.pseudorange[k]:.3f}"]
        row += [f"{o.carrier[k]:.3f}", f"{-o.range_rate[k] / o.wavelength[k]:.3f}", name]
        row += [str(number), str(slot), "1000", f"{o.cn0[k]:.0f}", "5", "0.01", "0.2", "15"]
        lines.append(";".join([*row, "01#"[k % 3]]))
    (folder / "RXM-RAWX.csv").write_text("\n".join(lines) + "\n")
    n = len(f)
    speed = np.linalg.norm(f.vel_e, axis=1)
    imu = s.imu
    yaw = -np.interp(f.time, imu.time, np.convolve(imu.gyro_b[:, 2], np.ones(5) / 5, "same"))
    table = np.column_stack(
        [np.full(n, WEEK), sow, lla[:, 1], lla[:, 0], lla[:, 2], lla[:, 1], lla[:, 0], lla[:, 2],
         heading, np.zeros(n), sow, speed, sow, yaw]
    )  # fmt: skip
    names = ",".join(f"c{k + 1}" for k in range(14))
    write_table(folder / "MY_DATASET.csv", names, table, "%.9f", ",")
    head = truth(f.time)
    table = np.column_stack(
        [head, np.round(sow * 1e3), lla[:, 1], lla[:, 0], lla[:, 2], lla[:, 2] - 10.0,
         np.full(n, 0.5), np.full(n, -1.0)]
    )  # fmt: skip
    names = ";".join(f"c{k + 1}" for k in range(23))
    write_table(folder / "NAV-POSLLH.csv", names, table, "%.9f", ";")
    gps = np.array([name[0] == "G" for name in o.sat])
    number = np.array([int(name[1:]) for name in o.sat])
    table = np.column_stack([tow, number, o.sat_pos_e, o.sat_vel_e])[gps]
    names = "tow_s,prn,sat_x_m,sat_y_m,sat_z_m,sat_vx_mps,sat_vy_mps,sat_vz_mps"
    write_table(folder / "derived_gps_doppler_merged.csv", names, table, "%.6f", ",")


def write_spirent(folder: Path, d: Drive, rover: Path, navigation: Path) -> None:
    """Write a motion file of the simulator, observations and navigation."""
    r = d.simulation.trajectory.reference(np.arange(20) * 0.5 + d.simulation.imu.time[0])
    names = ["Time_ms", "Pos_X", "Pos_Y", "Pos_Z", "Vel_X", "Vel_Y", "Vel_Z"]
    names += ["Bank", "Elevation", "Heading"]
    table = np.column_stack([(r.time - r.time[0]) * 1e3, r.pos_e, r.vel_e, r.rpy])
    head = f"3,2,100,1,GDOP, {r.time[0]:.1f}\n" + ",".join(names)
    write_table(folder / "Rover-dynamic_motion_Spirent.csv", head, table, "%.9f", ",")
    variant = folder / "iono-Klob_tropo-Saast"
    variant.mkdir()
    (variant / "rover.obs").write_bytes(rover.read_bytes())
    (folder / "RINEX_GN_Spirent.20N").write_bytes(navigation.read_bytes())


def write_ubx(path: Path, d: Drive) -> None:
    """Write NAV-PVT messages."""
    import pyubx2

    f = d.fixes
    lla, vel_n, messages = geodetic_deg(f.pos_e), velocity_n(f), []
    for k in range(len(f)):
        utc = to_calendar(round(float(f.time[k]), 3) - 18.0)
        message = pyubx2.UBXMessage(
            "NAV", "NAV-PVT", pyubx2.GET, iTOW=round(seconds_of_week(f)[k] * 1e3), year=utc.year,
            month=utc.month, day=utc.day, hour=utc.hour, min=utc.minute, second=utc.second,
            validDate=1, validTime=1, fullyResolved=1, fixType=3, gnssFixOk=1, carrSoln=k % 3,
            numSV=17, lon=lla[k, 1], lat=lla[k, 0], height=round(lla[k, 2] * 1e3), hAcc=500,
            vAcc=900, velN=round(vel_n[k, 0] * 1e3), velE=round(vel_n[k, 1] * 1e3),
            velD=round(vel_n[k, 2] * 1e3), sAcc=250,
        )  # fmt: skip
        messages.append(message.serialize())
    path.write_bytes(b"".join(messages[:5]) + b"noise" + b"".join(messages[5:]))


def write_nmea(path: Path, d: Drive) -> None:
    """Write RMC, GGA and GST of some epochs, and a ZDA."""

    def sentence(body: str) -> str:
        check = 0
        for c in body:
            check ^= ord(c)
        return f"${body}*{check:02X}\r\n"

    f, out = d.fixes, []
    lla = geodetic_deg(f.pos_e)
    for k in range(0, len(f), 2):
        utc = to_calendar(round(float(f.time[k]), 3) - 18.0)
        clock = f"{utc:%H%M%S}.{utc.microsecond // 10000:02d}"
        lat, lon = lla[k, :2]
        place = f"{int(lat)}{(lat % 1) * 60:010.7f},N,{int(lon):03d}{(lon % 1) * 60:010.7f},E"
        out.append(sentence(f"GNRMC,{clock},A,{place},10.0,90.0,{utc:%d%m%y},,,A"))
        out.append(sentence(f"GNGGA,{clock},{place},4,12,0.8,{lla[k, 2]:.3f},M,-16.2,M,,"))
        out.append(sentence(f"GNGST,{clock},1.0,,,,0.5,0.6,0.9"))
    out.insert(3, sentence(f"GNZDA,{clock},{utc:%d,%m,%Y},00,00"))
    path.write_text("".join(out), newline="")


def rinex_2(observations: Path) -> str:
    """Return RINEX 3 GPS observations of the simulator as RINEX 2."""

    def label(content: str, name: str) -> str:
        return f"{content:<60}{name:<20}"

    lines = observations.read_text().splitlines()
    out = [
        label(f"{'2.11':>9}{'':11}{'OBSERVATION DATA':<20}{'G':<20}", "RINEX VERSION / TYPE"),
        label(f"{4:6d}{'C1':>6}{'L1':>6}{'D1':>6}{'S1':>6}", "# / TYPES OF OBSERV"),
        next(line for line in lines if "TIME OF FIRST OBS" in line),
        label("", "END OF HEADER"),
    ]
    k = next(i for i, line in enumerate(lines) if line.startswith(">"))
    while k < len(lines):
        head, count = lines[k], int(lines[k][32:35])
        rows = lines[k + 1 : k + 1 + count]
        names = [row[:3] for row in rows]
        first = f" {head[4:18].replace(' 0', '  ')}{head[18:29]}  0{count:3d}"
        out.append(first + "".join(names[:12]))
        out += ["".join([" " * 32, *names[i : i + 12]]) for i in range(12, count, 12)]
        out += [row[3:67] for row in rows]
        k += 1 + count
    return "\n".join(out) + "\n"


def scaled(d: Drive, gyro: float, accel: float) -> Drive:
    """Return a drive whose inertial numbers are of another unit."""
    return dataclasses.replace(d, gyro=d.gyro * gyro, accel=d.accel * accel)
