"""How often `certnav declare` is right: simulated drives, written as loggers write them.

Every file is rewritten with axes, units, clocks, column names and an order of columns drawn at
random; the draft's answers are held against what was drawn. A key is right, blank or wrong.

    python scripts/declare_variants.py --variants 60 --seed 0
"""

from __future__ import annotations

import argparse
import collections
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from certnav.datasets import gpstime
from certnav.datasets.axes import all_axes, axes_matrix, axes_name
from certnav.datasets.own.blanks import BLANK
from certnav.datasets.own.declaration import ACCEL_UNITS, GYRO_UNITS, SPEED_UNITS
from certnav.datasets.own.draft import Draft
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import Simulation, SimulationConfig, simulate
from certnav.filters.earth import C_en_of, ecef_to_lla
from certnav.filters.rotation import matrix_from_rpy
from certnav.nav.drafting import measured_draft

IMU_NAMES = {
    "plain": ("t", "gx gy gz", "ax ay az"),
    "made-up": ("Zeit", "Drehrate1 Drehrate2 Drehrate3", "Kraft1 Kraft2 Kraft3"),
    "apart": ("stempel", "spin_a spin_b spin_c", "q1 q2 q3"),
    "xsens": ("SampleTimeFine", "Gyr_X Gyr_Y Gyr_Z", "Acc_X Acc_Y Acc_Z"),
    "px4": ("timestamp", "gyro_rad[0] gyro_rad[1] gyro_rad[2]",
            "accelerometer_m_s2[0] accelerometer_m_s2[1] accelerometer_m_s2[2]"),
    "none": ("", "", ""),
}  # fmt: skip
GNSS_NAMES = {
    "plain": ("t", "lat lon height", "vn ve vd"),
    "made-up": ("Zeit", "Breite Laenge Hoehe", "Nordfahrt Ostfahrt Sinkfahrt"),
    "ublox": ("iTOW", "lat lon hMSL", "velN velE velD"),
    "septentrio": ("TOW", "Latitude Longitude Height", "Vn Ve Vu"),
    "novatel": ("GPS Seconds", "Latitude Longitude Height",
                "North Velocity,East Velocity,Up Velocity"),
    "sbg": ("timestamp", "latitude longitude altitude", "velocityNorth velocityEast velocityDown"),
}  # fmt: skip
SHOWN = (
    *(("imu", key) for key in ("time_scale", "time_offset_s", "axes", "gyro_unit")),
    ("gnss", "time_scale"),
)
CLOCKS = ("unix", "utc", "gps", "gps-sow", "gps-week-sow", "local", "unix-ms", "unix-us")
MOUNTINGS = ((0.0, 0.0, 0.0), (2.0, -3.0, 4.0), (0.0, 0.0, 25.0), (8.0, -12.0, -40.0))


@dataclass(frozen=True)
class Variant:
    """What was drawn, all of it the truth."""

    seed: int
    duration: float
    static: float
    mounting: tuple[float, float, float]
    C_bs: np.ndarray
    gyro_unit: str
    accel_unit: str
    imu_clock: str
    gnss_clock: str
    lag: float
    imu_names: str
    gnss_names: str
    angle_unit: str
    frame: str
    speed_unit: str
    rate: float
    gnss_rate: float
    sigma: float
    lever: tuple[float, float, float]

    def words(self) -> str:
        """Return it in a line."""
        return (
            f"{self.duration:.0f} s, {axes_name(self.C_bs)}, mounting {self.mounting}, "
            f"{self.gyro_unit}, {self.accel_unit}, IMU {self.imu_clock} ({self.imu_names}), GNSS "
            f"{self.gnss_clock} ({self.gnss_names}), lag {self.lag}, {self.angle_unit}, "
            f"{self.frame}, {self.speed_unit}, {self.rate:.0f} Hz, {self.gnss_rate:.0f} Hz, "
            f"σ {self.sigma} m, lever {self.lever}"
        )


def drawn(seed: int) -> Variant:
    """Draw a variant."""
    rng = np.random.default_rng([seed, 77])

    def one(of: Any) -> Any:
        return of[int(rng.integers(len(of)))]

    imu_clock = one(CLOCKS)
    together = rng.random() < 0.6
    # "the same logger": the same clock on both; else any two.
    gnss_clock = imu_clock if together else one(CLOCKS)
    increments = rng.random() < 0.15
    frame = one(("ned", "ned", "enu", "ecef"))
    return Variant(
        seed=seed,
        duration=float(one((60.0, 120.0, 300.0, 600.0))),
        static=float(one((0.0, 10.0, 30.0))),
        mounting=one(MOUNTINGS),
        C_bs=one(all_axes()),
        gyro_unit=one(("rad", "deg")) if increments else one(("rad/s", "deg/s", "deg/s")),
        accel_unit="m/s" if increments else one(("m/s2", "g", "mg")),
        imu_clock=imu_clock,
        gnss_clock=gnss_clock,
        lag=float(one((0.0, 0.0, 0.15, -0.4))),
        imu_names=one(tuple(IMU_NAMES)),
        gnss_names=one(tuple(GNSS_NAMES)) if frame != "ecef" else "plain",
        angle_unit=one(("deg", "deg", "rad", "1e-7deg")) if frame != "ecef" else "",
        frame=frame,
        speed_unit=one(("m/s", "m/s", "km/h", "knots", "mm/s")),
        rate=float(one((50.0, 100.0, 200.0))),
        gnss_rate=float(one((1.0, 5.0, 10.0))),
        sigma=float(one((1.0, 1.0, 0.02))),
        lever=_lever(seed),
    )


def _lever(seed: int) -> tuple[float, float, float]:
    """Draw where on the car the antenna is, seen from the IMU in its FRD axes [m]."""
    low, high = (-2.0, -0.8, -1.5), (1.5, 0.8, 0.2)
    forward, right, down = np.random.default_rng([seed, 79]).uniform(low, high).round(2)
    return float(forward), float(right), float(down)


def stamps(clock: str, time: np.ndarray, zero: float) -> dict[str, np.ndarray]:
    """Return columns of GPS times as a clock prints them."""
    if clock == "gps-week-sow":
        week, sow = gpstime.to_week_sow(time)
        return {"GPS week": week, "sow": np.round(sow, 6)}
    if clock == "utc":
        unix = time - gpstime.gps_minus_utc(float(time[0])) + 315964800.0
        text = pd.to_datetime(np.round(unix * 1e6).astype(np.int64), unit="us")
        return {"": text.strftime("%Y-%m-%d %H:%M:%S.%fZ").to_numpy()}
    base, unit = {
        "unix": (gpstime.gps_minus_utc(float(time[0])) - 315964800.0, 1.0),
        "gps": (0.0, 1.0),
        "gps-sow": (time[0] // 604800.0 * 604800.0, 1.0),
        "local": (zero, 1.0),
    }[clock.partition("-m")[0].partition("-u")[0]]
    unit = {"-ms": 1e3, "-us": 1e6}.get(clock[4:], unit) if clock.startswith("unix") else unit
    value = (time - base) * unit
    return {"": np.round(value).astype(np.int64) if unit > 1e3 else np.round(value, 6)}


def write(v: Variant, folder: Path) -> tuple[Simulation, list[Path]]:
    """Write the files of a variant; return the drive, too."""
    config = SimulationConfig(
        seed=v.seed, duration=v.duration, static_start=v.static, density="open",
        imu_rate=v.rate, mounting_rpy_deg=v.mounting, lever_antenna_b=v.lever,
    )  # fmt: skip
    drive = simulate(config)
    rng = np.random.default_rng([v.seed, 78])
    imu = drive.imu
    gyro, accel = imu.gyro_b @ v.C_bs, imu.accel_b @ v.C_bs  # x_s = C_bsᵀ x_b
    step = np.diff(imu.time, prepend=imu.time[0] - 1.0 / v.rate)[:, None]
    for unit, table in ((v.gyro_unit, GYRO_UNITS), (v.accel_unit, ACCEL_UNITS)):
        factor, summed = table[unit]
        scaled = (gyro if table is GYRO_UNITS else accel) / factor * (step if summed else 1.0)
        gyro, accel = (scaled, accel) if table is GYRO_UNITS else (gyro, scaled)
    files = []
    name, gyros, accels = IMU_NAMES[v.imu_names]
    columns = {
        k or name or "t": s
        for k, s in stamps(v.imu_clock, imu.time + v.lag, imu.time[0] - 3.7).items()
    }
    if v.imu_names == "xsens" and not {"utc", "gps-week-sow"} & {v.imu_clock}:
        columns = {name: np.round((imu.time - imu.time[0] + v.lag) * 1e4).astype(np.int64) + 123456}
    columns |= dict(zip(gyros.split() or ("a", "b", "c"), gyro.T, strict=True))
    if v.imu_names == "apart":
        columns["temp"] = 25.0 + 0.1 * rng.standard_normal(len(imu.time)).cumsum() / 50.0
    columns |= dict(zip(accels.split() or ("d", "e", "f"), accel.T, strict=True))
    files.append(folder / "imu.csv")
    pd.DataFrame(columns).to_csv(files[-1], index=False, header=v.imu_names != "none")
    times = config.start_time + np.arange(1.0, v.duration - 1.0, 1.0 / v.gnss_rate)
    fixes = fixes_from_truth(
        drive.trajectory,
        times,
        config.lever_antenna_b,
        (v.sigma, v.sigma, 2.0 * v.sigma),
        0.05,
        rng,
    )
    name, places, speeds = GNSS_NAMES[v.gnss_names]
    position, velocity = fixes.pos_e, fixes.vel_e
    if v.frame != "ecef":
        lla = ecef_to_lla(fixes.pos_e)
        scale = {"deg": np.degrees(1.0), "rad": 1.0, "1e-7deg": np.degrees(1e7)}[v.angle_unit]
        height = lla[:, 2] * (1e3 if v.angle_unit == "1e-7deg" else 1.0)
        position = np.column_stack([lla[:, :2] * scale, height])
        velocity = np.einsum("nij,ni->nj", C_en_of(fixes.pos_e), fixes.vel_e)
    velocity = velocity / SPEED_UNITS[v.speed_unit]
    place_names = places.split() if v.frame != "ecef" else ["x", "y", "z"]
    names = speeds.split(",") if "," in speeds else speeds.split()
    if v.frame == "ecef":
        names = ["vx", "vy", "vz"]
    if names[2].lower().startswith(("vu", "up")):
        velocity = velocity * [1.0, 1.0, -1.0]
    elif v.frame == "enu":
        velocity = velocity[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
        names = ["v_east", "v_north", "v_up"] if v.gnss_names != "made-up" else names
    columns = {
        k or name: s for k, s in stamps(v.gnss_clock, fixes.time, fixes.time[0] - 1.3).items()
    }
    columns |= dict(zip(place_names, position.T, strict=True))
    columns |= dict(zip(names, velocity.T, strict=True))
    files.append(folder / "gnss.csv")
    pd.DataFrame(columns).to_csv(files[-1], index=False, float_format="%.12g")
    return drive, files


def judged(v: Variant, drive: Simulation, draft: Draft) -> dict[str, str]:
    """Return for each key whether it is 'right', 'blank' or 'wrong'."""
    out = {}

    def judge(key: str, blank: bool, right: bool) -> None:
        out[key] = "blank" if blank else "right" if right else "wrong"

    def get(section: str, key: str) -> Any:
        return draft.get(section, key, BLANK)

    judge("gyro_unit", get("imu", "gyro_unit") == BLANK, get("imu", "gyro_unit") == v.gyro_unit)
    judge("accel_unit", get("imu", "accel_unit") == BLANK, get("imu", "accel_unit") == v.accel_unit)
    if get("imu", "axes") == BLANK:
        out["axes, mounting"] = "blank"
    else:
        C_bs = axes_matrix(get("imu", "axes"))
        C_bv = matrix_from_rpy(np.radians(get("vehicle", "mounting_rpy_deg"))).T
        # axes and mounting together turn the file's axes into the vehicle's
        found = C_bs.T @ C_bv
        true = v.C_bs.T @ drive.trajectory.C_bv
        off = Rotation.from_matrix(found.T @ true).as_rotvec(degrees=True)
        sigma = get("vehicle", "mounting_sigma_deg")
        # Roll about the direction of motion is gravity's alone: banked roads, biases.
        right = np.abs(off[1:]).max() < 2.0 * sigma and abs(off[0]) < 4.0
        judge("axes, mounting", False, bool(right))
        out["off_deg"] = " ".join(f"{v:+.1f}" for v in off)
    up_last = str(get("gnss", "velocity")[-1]).lower() in ("vu", "up velocity")
    frame = "enu" if up_last and v.frame == "ned" else v.frame
    for key, true in (("velocity_frame", frame), ("velocity_unit", v.speed_unit)):
        judge(key, get("gnss", key) == BLANK, get("gnss", key) == true)
    dated = v.imu_clock == "gps-week-sow"
    first = {"gyro": 2 + dated, "accel": 5 + dated + (v.imu_names == "apart")}
    header = [] if v.imu_names == "none" else IMU_NAMES[v.imu_names][1:]
    for key, names in zip(("gyro", "accel"), header or ("", ""), strict=True):
        true = names.split() or [first[key] + k for k in range(3)]
        judge(f"{key} columns", get("imu", key) == BLANK, get("imu", key) == true)
    if v.angle_unit:
        judge(
            "angle_unit",
            get("gnss", "angle_unit") == BLANK,
            get("gnss", "angle_unit") == v.angle_unit,
        )
    if v.angle_unit == "1e-7deg":
        judge(
            "height_unit", get("gnss", "height_unit") == BLANK, get("gnss", "height_unit") == "mm"
        )
    lever = get("antenna", "lever_frd_m")
    axes = [k for k in range(3) if lever != BLANK and lever[k] != BLANK]
    sigma = get("antenna", "lever_sigma_m")
    for k, name in enumerate(("forward", "right", "down")):
        off = lever[k] - v.lever[k] if k in axes else np.nan
        judge(f"lever {name}", k not in axes, bool(abs(off) < 3.0 * sigma))
    if axes:
        off = " ".join(f"{lever[k] - v.lever[k]:+.2f}" for k in axes)
        out["off_lever"] = f"{off} ± {sigma:.2f}"
    _judge_time(v, drive, draft, out)
    return out


def _judge_time(v: Variant, drive: Simulation, draft: Draft, out: dict[str, str]) -> None:
    """Both clocks as drafted: the same moment has to have the same time, and the right date."""
    from certnav.datasets.own.reader import read_imu
    from certnav.filters.errors import NavError
    from certnav.nav.drafting import trial

    needed = (("imu", "time_scale"), ("gnss", "time_scale"), ("imu", "gyro"), ("imu", "time"))
    if any(draft.get(section, key, BLANK) == BLANK for section, key in needed):
        out["time"] = "blank"
        return
    try:
        imu = read_imu(trial.declaration(draft))[0]
        fixes = trial.fixes_of(draft)
    except NavError as error:
        out["time"] = f"wrong: {error}"
        return
    if fixes is None:
        out["time"] = "blank"
        return
    true = drive.imu.time[0] - (drive.config.start_time + 1.0)
    off = (imu.time[0] - fixes.time[0]) - true
    dated = draft.get("gnss", "time_scale") != "relative"
    allowed = max(0.12, 2.5 * float(draft.get("imu", "time_offset_sigma_s", 0.0)))
    wrong = abs(off) > allowed or (
        dated and abs(fixes.time[0] - drive.config.start_time - 1.0) > 0.12
    )
    out["time"] = "wrong" if wrong else "right"
    out["off_s"] = f"{off:+.3f}"


def main() -> None:
    """Draw variants, draft them, and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--variants", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--navigated", type=int, default=4, help="every so many have mounting and lever measured"
    )
    arguments = parser.parse_args()
    count: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for seed in range(arguments.seed, arguments.seed + arguments.variants):
        v = drawn(seed)
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            drive, files = write(v, Path(folder))
            try:
                run = arguments.navigated and seed % arguments.navigated == 0
                draft = measured_draft(files, navigated=bool(run))
            except Exception as error:  # a script that counts goes on
                print(f"{seed}: {type(error).__name__}: {error}\n    {v.words()}", flush=True)
                count["refused"]["wrong"] += 1
                continue
            found = judged(v, drive, draft)
        said = {k: r for k, r in found.items() if r != "right"}
        print(f"{seed}: {time.perf_counter() - began:.1f} s {said}", flush=True)
        if any(r.startswith("wrong") for r in found.values()):
            print(f"    {v.words()}", flush=True)
            for section, key in SHOWN:
                print(f"      {section}.{key} = {draft.get(section, key)}")
                print(f"        # {draft.comment(section, key)}")
        for key, result in found.items():
            if not key.startswith("off"):
                count[key][result.partition(":")[0]] += 1
    print(f"{'key':16} right blank wrong")
    for key, c in count.items():
        print(f"{key:16} {c['right']:5} {c['blank']:5} {c['wrong']:5}")
    sys.exit(any(c["wrong"] for c in count.values()))


if __name__ == "__main__":
    main()
