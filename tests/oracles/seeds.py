"""Small sound inputs for every reader, made from one simulated drive (`drives`).

With CERTNAV_DATA set, excerpts of real files join them, made in the same temporary folder.
"""

from __future__ import annotations

import dataclasses
import gzip
import os
import shutil
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from certnav.datasets.gpstime import to_calendar
from certnav.datasets.great.writer import write_great

from .declarations import CONFIG, DECLARED, DECLARED_RINEX
from .drives import (
    WEEK,
    Drive,
    geodetic_deg,
    rinex_2,
    seconds_of_week,
    velocity_n,
    write_comma2k19,
    write_flt,
    write_imu_csv,
    write_kfgins,
    write_nmea,
    write_oakville,
    write_pos,
    write_rtklibexplorer,
    write_smartloc,
    write_spirent,
    write_table,
    write_ubx,
)
from .solutions import WRITE

#: Seeds that share a folder with another one.
SHARED = {"declare": "own_data", "check": "own_data", "check_great": "great"}


@dataclass(frozen=True)
class Target:
    """A reader with a sound input.

    Parameters
    ----------
    name : str
        Of the seed; its folder.
    reader : str
        Of the reader, for the table.
    kinds : mapping of str to str
        Files to break, and what kind of file each is (`mutations`).
    weight : int
        Share of the cases.
    """

    name: str
    reader: str
    kinds: dict[str, str]
    weight: int


def seed_drive() -> Drive:
    """Return the drive that all seeds hold."""
    return Drive.of(duration=12.0, imu_rate=25.0)


def make_seeds(root: Path, data: Path | None) -> list[Target]:
    """Write the seeds below `root` and return the targets."""
    d = seed_drive()
    great = root / "great"
    write_great(d.simulation, great)
    (great / "IMU/Tactical_imu_data.txt").unlink()
    rover = next(great.glob("GNSS/Rover/*"))
    base = next(great.glob("GNSS/Base/*"))
    navigation = next(great.glob("GNSS/Product/*"))
    _thin_navigation(navigation, d)
    out = [
        Target("great", "great", {
            "IMU/MEMS_imu_data.txt": "text", "Groundtruth/groundtruth.txt": "text",
            str(rover.relative_to(great)): "text", str(navigation.relative_to(great)): "text",
            str(base.relative_to(great)): "text", "great.toml": "toml",
        }, 16),
    ]  # fmt: skip
    out += _text_seeds(root, d, great)
    out += _folder_seeds(root, d, rover, navigation)
    out += _rinex_seeds(root, rover, base, navigation, data)
    out += _own_seeds(root, d, rover, navigation, great)
    out.append(_precise_seeds(root, d, rover, navigation))
    return [*out, *_raw_seeds(root, d, rover, navigation)]


def _folder(root: Path, name: str) -> Path:
    folder = root / name
    folder.mkdir(parents=True)
    return folder


def _thin_navigation(file: Path, d: Drive) -> None:
    """Keep one ephemeris a satellite: a reader needs no more."""
    lines = file.read_text().splitlines(keepends=True)
    start = next(k for k, line in enumerate(lines) if line[60:].startswith("END OF HEADER")) + 1
    seen: dict[str, list[str]] = {}
    for k in range(start, len(lines), 8):
        if lines[k][15:17] == f"{d.simulation.config.start.hour:02d}":
            seen.setdefault(lines[k][:3], lines[k : k + 8])
    visible = set(d.simulation.observations.sat.tolist())
    kept = [line for name in sorted(seen) if name in visible for line in seen[name]]
    file.write_text("".join([*lines[:start], *kept]))


def _text_seeds(root: Path, d: Drive, great: Path) -> list[Target]:
    imu, ie = _folder(root, "imu_text"), _folder(root, "inertial_explorer")
    (imu / "imu.txt").write_bytes((great / "IMU/MEMS_imu_data.txt").read_bytes())
    (ie / "ref.txt").write_bytes((great / "Groundtruth/groundtruth.txt").read_bytes())
    flt = _folder(root, "great_pvt")
    write_flt(flt / "rover.flt", d)
    out = [
        Target("imu_text", "imu_text", {"imu.txt": "text"}, 14),
        Target("inertial_explorer", "inertial_explorer", {"ref.txt": "text"}, 14),
        Target("great_pvt", "great_pvt", {"rover.flt": "text"}, 12),
    ]
    for form in ("llh", "ecef", "dms"):
        folder = _folder(root, f"rtklib_pos_{form}")
        write_pos(folder / "a.pos", d, form)
        out.append(Target(folder.name, "rtklib_pos", {"a.pos": "text"}, 6))
    for form, (file, write) in WRITE.items():
        folder = _folder(root, f"solution_{form}")
        write(folder / file, d.fixes)
        out.append(Target(folder.name, "solutions", {file: "text"}, 5))
    ubx, nmea = _folder(root, "ubx"), _folder(root, "nmea")
    write_ubx(ubx / "a.ubx", d)
    write_nmea(nmea / "a.nmea", d)
    return [
        *out,
        Target("ubx", "receiver_logs UBX", {"a.ubx": "ubx"}, 12),
        Target("nmea", "receiver_logs NMEA", {"a.nmea": "nmea"}, 12),
    ]


def _folder_seeds(root: Path, d: Drive, rover: Path, navigation: Path) -> list[Target]:
    write_kfgins(_folder(root, "kfgins"), d)
    write_oakville(_folder(root, "oakville"), d)
    write_rtklibexplorer(_folder(root, "rtklibexplorer"), d)
    write_comma2k19(_folder(root, "comma2k19"), d)
    write_smartloc(_folder(root, "smartloc"), d)
    write_spirent(_folder(root, "instinct"), d, rover, navigation)
    arrays = sorted(
        str(f.relative_to(root / "comma2k19"))
        for f in (root / "comma2k19").rglob("*")
        if f.is_file() and f.suffix != ".csv"
    )
    return [
        Target("kfgins", "kfgins", {
            "imu.txt": "text", "gnss.txt": "text", "truth.nav": "text", "options.yaml": "text",
        }, 12),
        Target("oakville", "oakville", {
            "imu.csv": "text", "gnss.csv.gz": "gzip", "reference_position.csv": "text",
            "reference_attitude.csv": "text", "reference_mount.csv": "text",
        }, 12),
        Target("rtklibexplorer", "rtklibexplorer", {
            "imu_1.csv": "text", "imu_1.csv.tag": "binary", "gnss_1.pos": "text",
        }, 12),
        Target("comma2k19", "comma2k19", {
            **dict.fromkeys(arrays, "npy"), "derived/gps_ublox_with_satpv.csv": "text",
        }, 14),
        Target("smartloc", "smartloc", {
            "RXM-RAWX.csv": "text", "MY_DATASET.csv": "text", "NAV-POSLLH.csv": "text",
            "derived_gps_doppler_merged.csv": "text",
        }, 12),
        Target("instinct", "instinct", {
            "Rover-dynamic_motion_Spirent.csv": "text", "RINEX_GN_Spirent.20N": "text",
            "iono-Klob_tropo-Saast/rover.obs": "text",
        }, 6),
    ]  # fmt: skip


def _rinex_seeds(
    root: Path, rover: Path, base: Path, navigation: Path, data: Path | None
) -> list[Target]:
    r3, r2 = _folder(root, "rinex_3"), _folder(root, "rinex_2")
    text = rover.read_text().splitlines(keepends=True)
    epochs = [k for k, line in enumerate(text) if line.startswith(">")]
    short = "".join(text[: epochs[6]])
    for folder in (r3, r2):
        (folder / "brdc.nav").write_bytes(navigation.read_bytes())
    (r3 / "rover.obs").write_text(short)
    (r2 / "rover.obs").write_text(rinex_2(r3 / "rover.obs"))
    kinds = {"rover.obs": "text", "brdc.nav": "text"}
    out = [
        Target("rinex_3", "RINEX 3", kinds, 20),
        Target("rinex_2", "RINEX 2", {"rover.obs": "text"}, 12),
    ]
    relative = _folder(root, "relative")
    (relative / "brdc.nav").write_bytes(navigation.read_bytes())
    (relative / "rover.obs").write_text(short)
    text = base.read_text().splitlines(keepends=True)
    epochs = [k for k, line in enumerate(text) if line.startswith(">")]
    (relative / "base.obs").write_text("".join(text[: epochs[6]]))
    out.append(Target("relative", "RINEX, relative to a base", {
        "rover.obs": "text", "base.obs": "text", "brdc.nav": "text",
    }, 6))  # fmt: skip
    packed = _folder(root, "packed")
    (packed / "brdc.nav").write_bytes(navigation.read_bytes())
    (packed / "rover.20o.gz").write_bytes(gzip.compress(short.encode()))
    import hatanaka

    crx = hatanaka.rnx2crx(short.encode())
    (packed / "rover.20d").write_bytes(crx)
    (packed / "rover.20d.Z").write_bytes(hatanaka.compress(short.encode(), compression="Z"))
    out.append(Target("packed", "Hatanaka, gzip, compress", {
        "rover.20o.gz": "gzip", "rover.20d": "text", "rover.20d.Z": "binary",
    }, 4))  # fmt: skip
    if data is None:
        return out
    real = _folder(root, "real_rinex")
    source = data / "instinct/tckf_static/reach-m2-01_raw_202306291111"
    lines = source.with_suffix(".23O").read_text("latin-1").splitlines(keepends=True)
    epochs = [k for k, line in enumerate(lines) if line.startswith(">")]
    (real / "rover.obs").write_text("".join(lines[: epochs[3]]), "latin-1")
    (real / "brdc.nav").write_bytes(source.with_suffix(".nav").read_bytes()[:40_000])
    _whole_ephemerides(real / "brdc.nav")
    out.append(Target("real_rinex", "RINEX 3", kinds, 10))
    for name in ("brdc0870.19n", "BRDC00IGS_R_20230730000_01D_MN.rnx"):
        folder = _folder(root, f"real_{name[:8]}")
        text_ = (data / "broadcast" / name).read_text("latin-1").splitlines(keepends=True)
        begin = next(k for k, s in enumerate(text_) if "END OF HEADER" in s) + 1
        if name.endswith("n"):
            text_ = text_[: begin + 8 * 6]
        else:  # of each constellation some
            starts = [k for k in range(begin, len(text_)) if text_[k][0].isalpha()]
            per: dict[str, int] = {}
            kept: list[str] = []
            for k, end in zip(starts, [*starts[1:], len(text_)], strict=True):
                per[text_[k][0]] = per.get(text_[k][0], 0) + 1
                if per[text_[k][0]] <= 3:
                    kept += text_[k:end]
            text_ = [*text_[:begin], *kept]
        (folder / "brdc.nav").write_text("".join(text_), "latin-1")
        out.append(Target(folder.name, "RINEX navigation", {"brdc.nav": "text"}, 12))
    return out


def _whole_ephemerides(file: Path) -> None:
    lines = file.read_text("latin-1").splitlines(keepends=True)
    last = max(k for k, line in enumerate(lines) if line[0].isalpha())
    file.write_text("".join(lines[:last]), "latin-1")


def _precise_seeds(root: Path, d: Drive, rover: Path, navigation: Path) -> Target:
    """Write orbits, clocks and antennas of satellites that go straight on from where they are."""
    from .products import write_antex, write_clk, write_sp3

    folder = _folder(root, "precise")
    shutil.copyfile(root / "rinex_3/rover.obs", folder / "rover.obs")
    shutil.copyfile(navigation, folder / "brdc.nav")
    o = d.simulation.observations
    names = sorted(set(o.sat.tolist()))[:4]
    row = {name: np.flatnonzero(o.sat == name)[0] for name in names}
    begin = float(np.floor(o.time[0] / 900.0) * 900.0)

    def states(sats: list[str], time: float) -> tuple[np.ndarray, np.ndarray]:
        k = [row[sat] for sat in sats]
        sent = o.time[0] - 0.075  # where they were when they sent
        return o.sat_pos_e[k] + o.sat_vel_e[k] * (time - sent), np.full(len(sats), 1e-5)

    write_sp3(folder / "day.sp3", names, begin + 900.0 * np.arange(-6, 8), states)
    write_clk(folder / "day.clk", names, begin + 30.0 * np.arange(12), states)
    write_antex(folder / "igs.atx", names, 1.5)
    kinds = {"day.sp3": "text", "day.clk": "text", "igs.atx": "text"}
    return Target("precise", "precise products", kinds, 8)


def _raw_seeds(root: Path, d: Drive, rover: Path, navigation: Path) -> list[Target]:
    """Write the drive's first seconds as the logs of four makers."""
    from certnav.datasets.rtklib.satellites import load_navigation, satellite_name

    from . import receiver_logs as logs

    nav = load_navigation([navigation])
    ephemerides = [(satellite_name(nav.eph[k].sat), nav.eph[k]) for k in range(nav.n)]
    epochs = logs.epochs_of(d.simulation.observations)[:6]
    written = {
        "ubx": logs.ubx_log(epochs, ephemerides),
        "sbf": logs.sbf_log(epochs, ephemerides, 299792458.0 / 1575.42e6),
        "novatel": logs.novatel_log(epochs, ephemerides),
        "rtcm3": logs.rtcm3_log(str(rover), str(navigation), {"G": 1077}),
    }
    for name, parts in written.items():
        (_folder(root, f"raw_{name}") / f"a.{name}").write_bytes(b"".join(parts))
    return [Target(f"raw_{n}", f"raw logs, {n}", {f"a.{n}": "raw"}, 8) for n in written]


def _own_seeds(root: Path, d: Drive, rover: Path, navigation: Path, great: Path) -> list[Target]:
    own = _folder(root, "own_data")
    (own / "sequence.toml").write_text(DECLARED)
    write_imu_csv(own / "imu.csv", d)
    f = d.fixes
    lla, vel_n = geodetic_deg(f.pos_e), velocity_n(f)
    rows = ["date,clock,lat,lon,h,sn,se,su,vn,ve,vd,ns,q"]
    for k in range(len(f)):
        t = to_calendar(round(float(f.time[k]), 3))
        numbers = ",".join(f"{v:.9f}" for v in (*lla[k], 1.0, 1.0, 2.0, *vel_n[k]))
        rows.append(f"{t:%Y-%m-%d},{t:%H:%M:%S}.{t.microsecond // 1000:03d},{numbers},9,good")
    (own / "gnss.csv").write_text("\n".join(rows) + "\n")
    speed = 3.6 * np.linalg.norm(f.vel_e, axis=1)
    yaw = -np.degrees(np.gradient(np.unwrap(f.rpy[:, 2]), f.time))
    table = np.column_stack([seconds_of_week(f), speed, yaw])
    write_table(own / "odometer.csv", "t;speed;yaw", table, "%.6f", ";")
    table = np.column_stack([np.full(len(f), WEEK), seconds_of_week(f), f.pos_e, np.degrees(f.rpy)])
    write_table(own / "ref.csv", "week sow x y z roll pitch yaw", table, "%.5f", " ")
    (own / "ref.csv.gz").write_bytes(gzip.compress((own / "ref.csv").read_bytes()))
    (own / "ref.csv").unlink()
    mixed = _folder(root, "own_rinex")
    (mixed / "sequence.toml").write_text(DECLARED_RINEX)
    write_imu_csv(mixed / "imu.csv", d)
    write_pos(mixed / "gnss.pos", d)
    (mixed / "rover.20o.gz").write_bytes(gzip.compress(rover.read_bytes()))
    (mixed / "brdc.rnx").write_bytes(navigation.read_bytes())
    (mixed / "groundtruth.txt").write_bytes((great / "Groundtruth/groundtruth.txt").read_bytes())
    config = _folder(root, "config")
    (config / "config.toml").write_text(CONFIG)
    archive = _folder(root, "great_import")
    with zipfile.ZipFile(archive / "campus-01.zip", "w") as z:
        rows = (great / "IMU/MEMS_imu_data.txt").read_text().splitlines()
        # the importer tells a MEMS IMU by its 100 Hz
        z.writestr("IMU/MEMS.txt", "\n".join(_at_100_hz(rows[1:])) + "\n")
        z.write(great / "Groundtruth/groundtruth.txt", "gt.txt", zipfile.ZIP_DEFLATED)
        z.write(rover, f"rover/{rover.name}", zipfile.ZIP_DEFLATED)
    return [
        Target("own_data", "own data, declared", {
            "sequence.toml": "toml", "imu.csv": "text", "gnss.csv": "text",
            "odometer.csv": "text", "ref.csv.gz": "gzip",
        }, 20),
        Target("own_rinex", "own data, declared", {
            "sequence.toml": "toml", "imu.csv": "text", "gnss.pos": "text",
            "rover.20o.gz": "gzip", "brdc.rnx": "text", "groundtruth.txt": "text",
        }, 6),
        Target("declare", "certnav declare", {
            "imu.csv": "text", "gnss.csv": "text", "odometer.csv": "text", "ref.csv.gz": "gzip",
        }, 8),
        Target("config", "configuration (TOML, --set)", {"config.toml": "toml"}, 20),
        Target("great_import", "certnav datasets import", {"campus-01.zip": "binary"}, 4),
        Target("check", "certnav check, whole", {
            "sequence.toml": "toml", "imu.csv": "text", "gnss.csv": "text",
            "odometer.csv": "text", "ref.csv.gz": "gzip",
        }, 1),
        Target("check_great", "certnav check, whole", {
            "IMU/MEMS_imu_data.txt": "text", "Groundtruth/groundtruth.txt": "text",
            str(rover.relative_to(great)): "text", str(navigation.relative_to(great)): "text",
        }, 1),
    ]  # fmt: skip


def _at_100_hz(rows: Iterable[str]) -> list[str]:
    out = []
    start = None
    for k, row in enumerate(rows):
        time, _, rest = row.partition(" ")
        start = float(time) if start is None else start
        out.append(f"{start + 0.01 * k:.5f} {rest}")
    return out


def data_folder() -> Path | None:
    """Return CERTNAV_DATA, or None where it is not set."""
    value = os.environ.get("CERTNAV_DATA")
    return Path(value) if value and Path(value).is_dir() else None


def _write_declared(folder: Path, d: Drive) -> None:
    write_imu_csv(folder / "imu.csv", d)
    write_pos(folder / "gnss.pos", d)
    text = DECLARED_RINEX.partition("[rinex]")[0].replace('samples = "instant"\n', "")
    (folder / "sequence.toml").write_text(text)


def _write_great(folder: Path, d: Drive) -> None:
    """Write a folder whose declaration says deg/s whatever the numbers are."""
    imu = dataclasses.replace(d.simulation.imu, gyro_b=d.gyro, accel_b=d.accel)
    folder.rmdir()
    write_great(dataclasses.replace(d.simulation, imu=imu), folder)


#: Formats whose readers or checks see gyro, accelerometer and motion together.
UNIT_FORMATS: dict[str, Callable[[Path, Drive], None]] = {
    "great": _write_great,
    "own data": _write_declared,
    "kf-gins": write_kfgins,
    "oakville": write_oakville,
    "rtklibexplorer": write_rtklibexplorer,
    "comma2k19": write_comma2k19,
}
