"""Solutions in the formats other programs read: RTKLIB .pos, KML, TUM, KF-GINS .nav.

All follow the IMU, not the antenna, and lose what the format has no room for; the result
directory's own files are the complete record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...datasets.gpstime import from_unix, to_week_sow
from ...filters.earth import C_en_at, ecef_to_lla
from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray, rpy_from_matrix
from ..evaluation.interpolation import usable_at
from ..solution import Epochs, Trajectory
from ..sweep.parallel import in_order

_Part = TypeVar("_Part")

_GPS_EPOCH_UNIX = 315964800.0
#: KML: points closer together than this add size, not shape.
_KML_STEP_S, _KML_MAX_POINTS = 0.5, 20000

# East, north, up from north, east, down.
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def format_rows(template: str, table: FloatArray, rows_at_once: int = 4096) -> str:
    """Return `table` as text, one line a row, each by the %-`template` of a whole row."""
    from .text import row_blocks  # slow to import, with its compiler

    return b"".join(row_blocks(template, table, rows_at_once)).decode()


def write_rows(
    path: Path,
    header: str,
    template: str,
    parts: Iterable[_Part],
    table: Callable[[_Part], FloatArray],
) -> None:
    """Write a header and the table of each part, as by `format_rows`: never all in memory."""
    from .text import row_blocks  # slow to import, with its compiler

    def text(part: _Part) -> list[bytes]:
        return list(row_blocks(template, table(part)))

    with path.open("wb") as file:
        file.write(header.encode())
        for blocks in in_order(text, parts):
            file.writelines(blocks)


def geodetic_and_ned(trajectory: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (lat, lon [deg], height [m]), NED velocity [m/s] and (roll, pitch, heading) [deg].

    Heading in [0, 360), longitude in (−180, 180]. All of shape (n, 3).
    """
    lla = ecef_to_lla(trajectory.pos_e)
    C_ne = np.swapaxes(C_en_at(lla[:, 0], lla[:, 1]), 1, 2)
    vel_n = (C_ne @ trajectory.vel_e[:, :, None])[:, :, 0]
    rpy_deg = np.rad2deg(rpy_from_matrix(C_ne @ trajectory.C_eb))
    rpy_deg[:, 2] %= 360.0
    return np.column_stack([np.rad2deg(lla[:, :2]), lla[:, 2]]), vel_n, rpy_deg


def write_pos(path: Path, trajectory: Trajectory, epochs: Epochs) -> None:
    """Write an RTKLIB solution file: GPST, degrees, ellipsoidal height, with velocity.

    ``Q`` is 5 (single) while at least 4 satellites are usable, or their number is unknown, and
    7 (dead reckoning) below; ``ns`` is the usable satellites of the last GNSS epoch, 0 when
    unknown. ``sdne`` and its like are √|cov| with the covariance's sign, as RTKLIB writes them.
    """
    lla_deg, vel_n, _ = geodetic_and_ned(trajectory)
    usable = usable_at(epochs, trajectory.time)
    quality = np.where((usable >= 4) | (usable < 0), 5, 7)
    vel_neu = vel_n * [1.0, 1.0, -1.0]
    columns = [lla_deg, quality, np.clip(usable, 0, None), _rtklib_sd(trajectory.cov_pos_n)]
    columns += [np.zeros((len(trajectory), 2)), vel_neu, _rtklib_sd(trajectory.cov_vel_n)]
    template = (
        "%14.9f %14.9f %10.4f %3d %3d"
        + " %8.4f" * 6
        + " %6.2f %6.1f"
        + " %10.5f" * 3
        + " %8.5f" * 6
    )
    body = format_rows(template, np.column_stack(columns)).splitlines()
    header = (
        "% program   : certnav\n"
        "% (lat/lon/height=WGS84/ellipsoidal,Q=5:single,7:dead reckoning,ns=# of satellites)\n"
        "%  GPST                      latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)"
        "   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio    vn(m/s)    ve(m/s)"
        "    vu(m/s)     sdvn     sdve     sdvu    sdvne    sdveu    sdvun\n"
    )
    lines = (
        f"{stamp} {row}\n" for stamp, row in zip(_calendar(trajectory.time), body, strict=True)
    )
    path.write_text(header + "".join(lines), encoding="utf-8")


def write_nav(path: Path, trajectory: Trajectory, epochs: Epochs) -> None:
    """Write a KF-GINS navigation result, no header.

    Columns: GPS week, seconds of week, latitude, longitude [deg], height [m], velocity north,
    east, down [m/s], roll, pitch, heading [deg], heading in [0, 360).
    """
    template = "%d %.6f %.10f %.10f %.4f" + " %.5f" * 3 + " %.7f" * 3

    def table(part: Trajectory) -> FloatArray:
        return np.column_stack([*to_week_sow(part.time), *geodetic_and_ned(part)])

    write_rows(path, "", template, trajectory.parts(), table)


def write_tum(path: Path, trajectory: Trajectory, epochs: Epochs) -> None:
    """Write a TUM trajectory: ``timestamp tx ty tz qx qy qz qw``, space separated.

    GPS seconds; position [m] in the east-north-up axes at the first epoch, which the comment
    line names; the quaternion turns body axes (forward-right-down) into those axes.
    """
    lla = ecef_to_lla(trajectory.pos_e[:1])[0]
    to_enu = _ENU_FROM_NED @ C_en_at(lla[0], lla[1]).T
    pos = (trajectory.pos_e - trajectory.pos_e[0]) @ to_enu.T
    from scipy.spatial.transform import Rotation  # slow to import

    quaternion = Rotation.from_matrix(to_enu @ trajectory.C_eb).as_quat()
    lat, lon = np.rad2deg(lla[:2])
    header = (
        "# timestamp tx ty tz qx qy qz qw; GPS time, body axes forward-right-down; "
        f"ENU origin lat {lat:.10f} deg, lon {lon:.10f} deg, height {lla[2]:.4f} m\n"
    )
    table = np.column_stack([trajectory.time, pos, quaternion])
    template = "%.6f" + " %.4f" * 3 + " %.9f" * 4
    write_rows(path, header, template, [table], lambda part: part)


#: KML styles by least usable satellites: name and colour as aabbggrr (Okabe–Ito).
_KML_CLASSES = (
    (4, "4 or more satellites", "ffb27200"),
    (2, "2 or 3 satellites", "ff009fe6"),
    (0, "fewer than 2 satellites", "ff005ed5"),
    (-1, "satellites unknown", "ffb27200"),
)


def write_kml(path: Path, trajectory: Trajectory, epochs: Epochs) -> None:
    """Write a track for Google Earth, on the ground, coloured by usable satellites.

    Thinned to one point per 0.5 s and at most 20 000 points; start and end carry UTC times.
    """
    from xml.sax.saxutils import escape

    time = trajectory.time
    step = max(_KML_STEP_S, (time[-1] - time[0]) / _KML_MAX_POINTS)
    keep = np.unique(np.append(np.unique(np.floor((time - time[0]) / step), return_index=True)[1],
                               time.size - 1))  # fmt: skip
    lla = ecef_to_lla(trajectory.pos_e[keep])
    lla[:, :2] = np.rad2deg(lla[:, :2])
    points = format_rows("%.8f,%.8f,%.2f", lla[:, [1, 0, 2]]).splitlines()
    least = np.array([limit for limit, _, _ in _KML_CLASSES])
    usable = usable_at(epochs, time[keep])
    kind = np.argmax(usable[:, None] >= least, axis=1)

    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n'
        f"<Document>\n<name>{escape(path.stem)}</name>\n"
    ]
    for limit, _, colour in _KML_CLASSES:
        parts.append(
            f'<Style id="s{limit}"><LineStyle><color>{colour}</color><width>4</width></LineStyle>'
            "</Style>\n"
        )
    starts = np.flatnonzero(np.diff(kind, prepend=-1))
    for start, stop in zip(starts, [*starts[1:], kind.size - 1], strict=True):
        limit, name, _ = _KML_CLASSES[kind[start]]
        line = " ".join(points[start : stop + 1])
        parts.append(
            f"<Placemark><name>{name}</name><styleUrl>#s{limit}</styleUrl><LineString>"
            "<tessellate>1</tessellate><altitudeMode>clampToGround</altitudeMode>"
            f"<coordinates>{line}</coordinates></LineString></Placemark>\n"
        )
    for name, index in (("start", 0), ("end", -1)):
        when = _iso_utc(float(time[index]))
        parts.append(
            f"<Placemark><name>{name}</name><TimeStamp><when>{when}</when></TimeStamp>"
            f"<Point><coordinates>{points[index]}</coordinates></Point></Placemark>\n"
        )
    path.write_text("".join(parts) + "</Document>\n</kml>\n", encoding="utf-8")


#: Writers by the name `--format` knows, which is also the file suffix.
FORMATS: dict[str, Callable[[Path, Trajectory, Epochs], None]] = {
    "pos": write_pos,
    "kml": write_kml,
    "tum": write_tum,
    "nav": write_nav,
}


def parse_formats(text: str) -> tuple[str, ...]:
    """Return the formats of a comma-separated list; an unknown one is a `ConfigError`."""
    return check_formats(part.strip() for part in text.split(",") if part.strip())


def check_formats(names: Iterable[str]) -> tuple[str, ...]:
    """Return `names` without repeats; an unknown one is a `ConfigError` naming the nearest."""
    unique = tuple(dict.fromkeys(names))
    for name in unique:
        if name not in FORMATS:
            raise ConfigError.unknown_key(name, FORMATS, where="--format")
    return unique


def write_formats(
    directory: Path, names: Iterable[str], trajectory: Trajectory, epochs: Epochs
) -> list[Path]:
    """Write ``solution.<name>`` for each format into `directory`; return the paths."""
    paths = []
    for name in check_formats(names):
        path = directory / f"solution.{name}"
        FORMATS[name](path, trajectory, epochs)
        paths.append(path)
    return paths


def _rtklib_sd(cov_n: FloatArray) -> FloatArray:
    """Return sdn sde sdu sdne sdeu sdun of NED covariances; u = −d turns two signs."""
    rows = [(0, 0, 1), (1, 1, 1), (2, 2, 1), (0, 1, 1), (1, 2, -1), (2, 0, -1)]
    cov = np.stack([sign * cov_n[:, i, j] for i, j, sign in rows], axis=-1)
    sd: FloatArray = np.sign(cov) * np.sqrt(np.abs(cov))
    return sd + 0.0  # no −0


def _calendar(time: FloatArray) -> list[str]:
    """Return '2025/07/08 19:34:18.499000' in GPS time."""
    ticks = np.round(time * 1e6).astype(np.int64).astype("timedelta64[us]")
    stamps = np.datetime_as_string(np.datetime64("1980-01-06", "us") + ticks, unit="us")
    return [s.replace("-", "/").replace("T", " ") for s in stamps.tolist()]


def _iso_utc(time: float) -> str:
    unix = time + _GPS_EPOCH_UNIX
    for _ in range(2):  # the leap seconds of the instant, not of the instant plus leap seconds
        unix += time - float(from_unix(unix))
    stamp = np.datetime64(round(unix * 1000), "ms")
    return f"{np.datetime_as_string(stamp, unit='ms')}Z"
