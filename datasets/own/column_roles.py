"""What a column may hold, told from its name and its numbers; for drafting only.

Nothing here decides: `datasets.own.declare` writes what is found into a draft, with the evidence,
and leaves blank what numbers cannot tell.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ...filters.rotation import FloatArray
from ...filters.sensors import STANDARD_GRAVITY
from ..text.columns import Column, TextFile

#: Rows looked at.
_ROWS = 20000
_TIME = r"^(t|ts|time|stamp|timestamp|epoch|sow|tow|gpst|gpstime|utc|unix|date|datetime|sec|secs)$"
_UNITS = (
    r"(_|\b)(degps|dps|deg_s|radps|rad_s|rad|deg|mps2|mpss|m_s2|ms2|mps|m_s|kmh|kph|km_h"
    r"|ms|ns|us|s|g|m)$"
)
_DAY = r"^\d{4}[-/]\d\d?[-/]\d\d?$"
_DATE = r"^\d{4}[-/]\d\d?[-/]\d\d?([T ]\d\d?:\d\d|$)"
#: How arrays of loggers number their elements: `gyro_rad[0]`.
_ELEMENT = re.compile(r"\[([0-3])\]$")
_TRIADS = {
    # role: patterns of its three columns, in order
    "gyro": [
        (r"(gyro|angular|ang_?rate|ang_?vel).*{}$", "xyz"),
        (r"^(g|gyro?|gyr|w|omega|angular_?(velocity|rate)|rate|dtheta|ang_?vel)_?{}$", "xyz"),
        (r"^{}_?(rate|speed|vel(ocity)?)$", "pqr"),
        (r"^-?{}_?gyro?$", "xyz"),
        (r"gyro.*_{}$", "012"),
        (r"(gyro|ang_?(rate|vel)).*_?{}$", "123"),
    ],
    "accel": [
        (r"acc(?!ur).*{}$", "xyz"),
        (r"^(a|acc|accel|acceleration|f|force|linear_acceleration|dv|dvel)_?{}$", "xyz"),
        (r"^-?{}_?acc(el(eration)?)?$", "xyz"),
        (r"acc(?!ur).*_{}$", "012"),
        (r"acc(?!ur).*_?{}$", "123"),
    ],
    "velocity": [
        (r"^(v(el(ocity)?)?|speed)_?{}$", "ned"),
        (r"^(v(el(ocity)?)?|speed)_?{}$", "enu"),
        (r"^{}_?(v(el(ocity)?)?|speed)$", "ned"),
        (r"^{}_?(v(el(ocity)?)?|speed)$", "enu"),
        (r"^v(el(ocity)?)?_?{}$", "xyz"),
    ],
}
_SPELT_OUT = {
    "n": "n(orth)?", "e": "e(ast)?", "d": "d(own)?", "u": "u(p)?",
    "p": "(p|roll)", "q": "(q|pitch)", "r": "(r|yaw)",
}  # fmt: skip
_TIME_UNIT = r"(?:^|[\W_])(ms|us|ns)\W*$"
#: What columns of known receivers and IMUs count in, by their whole name: u-blox' iTOW, SBF's TOW
#: as its converters print it, Xsens' SampleTimeFine.
_TICKS = {"itow": "ms", "tow [0.001 s]": "ms", "sampletimefine": "100us"}
_PLACES = {
    "lat": r"(^|[^a-z])lat(itude)?$",
    "lon": r"(^|[^a-z])(lon|lng|long)(gitude|itude)?$",
    "height": r"(^|[^a-z])(h|height|alt|altitude|hgt|elevation|h_?ell|ellipsoidal_?height)$",
}
#: Heights by a name that says what they count from, the better one first.
_DATUMS = {
    "ellipsoid": r"ellips|(^|_)hae$|h_?ell$",
    "geoid": r"msl|(^|_)ortho|(height|alt).*geoid|sea_?level",
}
_UNDULATION = r"undul|geoid_?sep"
#: What a maker's heights count from where their name is bare and an undulation stands beside them:
#: columns that only this maker has, the datum, and whose they are.
_MAKERS = (
    (r"^wnc$|^v[neu]$|^cog$", "ellipsoid", "Septentrio's PVTGeodetic"),
    (r"^hgt$|^(north|east|up)_vel|^azimuth$", "geoid", "NovAtel's BESTPOS and INSPVAX"),
    (r"^velocity_?north$|^(latitude|altitude)_?(accuracy|std)$", "geoid", "SBG's"),
)
_SPELT = {
    "mm/s": ("mm/s", "mm_s", "mmps"),
    "rad/s": ("rad/s", "radps", "rad_s", "rad s"),
    "deg/s": ("deg/s", "degps", "deg_s", "dps", "°/s"),
    "m/s": ("m/s", "mps", "m_s"),
    "km/h": ("km/h", "kmh", "kph"),
}
_DEVIATION = r"(std|sd|sigma|σ|stddev|acc|accuracy|rms|unc)"
#: Deviations that hold for more than one axis: of u-blox and PX4.
_SHARED = {"pos": (("h_?acc", "h_?acc", "v_?acc"), ("eph", "eph", "epv")),
           "vel": (("s_?acc",) * 3, ("s_?variance",) * 3)}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sampled:
    """The columns of a file with the numbers of its first rows.

    Attributes
    ----------
    source : TextFile
    value : ndarray, shape (n, m)
        NaN where a cell is no number.
    plain : tuple of str
        Names without units, in lower case; empty strings where there is no header.
    """

    source: TextFile
    value: FloatArray
    plain: tuple[str, ...]

    def column(self, k: int) -> Column:
        """Return how a declaration calls a column: its name where it is unique, or its number."""
        names = self.source.names
        return names[k] if names and names.count(names[k]) == 1 else k + 1

    def find(self, pattern: str) -> list[int]:
        """Return the columns whose plain name matches."""
        return [k for k, name in enumerate(self.plain) if name and re.search(pattern, name)]


def sample(source: TextFile) -> Sampled:
    """Return the first rows of a file as numbers."""
    rows = [line.split(source.separator) for line in source.lines if line.strip()][:_ROWS]
    width = source.width
    cells = [(row + [""] * width)[:width] for row in rows]
    import pandas as pd  # slow to import

    frame = pd.DataFrame(cells).apply(pd.to_numeric, errors="coerce")
    names = source.names or ("",) * width
    return Sampled(source, frame.to_numpy(dtype=float), tuple(_plain(name) for name in names))


def _plain(name: str) -> str:
    """Return a header's name in lower case without brackets and unit endings."""
    element = _ELEMENT.search(name)
    bare = re.sub(r"[\[(].*?[\])]", "", name).strip().lower().replace(" ", "_").replace("-", "_")
    bare = bare.replace(".", "_").strip("_")
    shorter = re.sub(_UNITS, "", bare) or bare
    return f"{shorter}_{element[1]}" if element else shorter


def time_index(table: Sampled) -> int | None:
    """Return the column of time: by name, else the first that increases throughout, else dates."""
    named = table.find(_TIME) or table.find(r"time|stamp|sow|tow")
    if week_index(table) is not None:  # beside a week, seconds of week
        named = table.find(r"(^|[^a-z]|gps)(tow|sow)$|seconds_?of_?week|^gps_?seconds$") or named
    increasing = [k for k in range(table.value.shape[1]) if _increases(table.value[:, k])]
    texts = [k for k in range(table.value.shape[1]) if np.isnan(table.value[:, k]).all()]
    dates = [k for k in texts if _all(table, k, _DATE)]
    both = [k for k in named if k in increasing or k in texts]
    return next(iter(both or increasing or dates), None)


def time_of_day(table: Sampled, k: int) -> int | None:
    """Return the column of the time of day beside one of dates without it."""
    if not _all(table, k, _DAY):
        return None
    beside = (j for j in (k + 1, k - 1) if 0 <= j < table.value.shape[1])
    return next((j for j in beside if _all(table, j, r"^\d\d?:\d\d:\d\d")), None)


def _all(table: Sampled, k: int, pattern: str) -> bool:
    """Return whether the first cells of a column match a pattern."""
    rows = [line.split(table.source.separator) for line in table.source.lines if line.strip()][:20]
    cells = [row[k].strip().strip('"') for row in rows if len(row) > k]
    return bool(cells) and all(re.search(pattern, cell) for cell in cells)


def _increases(column: FloatArray) -> bool:
    return column.size > 2 and bool(np.isfinite(column).all() and (np.diff(column) > 0.0).all())


def week_index(table: Sampled) -> int | None:
    """Return the column of GPS weeks: by name; without names, constant beside seconds of week."""
    for k in table.find(r"week|^wnc?$"):
        value = table.value[:, k]
        if (value == np.round(value)).all() and 500 < value[0] < 5000:
            return k
    if any(table.plain) or len(table.value) < 3:
        return None
    for k in range(table.value.shape[1] - 1):
        week, sow = table.value[:, k], table.value[:, k + 1]
        constant = (
            (week == week[0]).all() and week[0] == np.round(week[0]) and 1000 < week[0] < 5000
        )
        if constant and _increases(sow) and 0.0 <= sow[0] <= 7 * 86400.0:
            return k
    return None


def triad(table: Sampled, role: str) -> tuple[list[int], str] | None:
    """Return three columns by name, and the letters they were found by ('xyz', 'ned' …)."""
    for pattern, letters in _TRIADS[role]:
        hits = [table.find(pattern.format(_SPELT_OUT.get(x, x))) for x in letters]
        if all(hits):
            return [h[0] for h in hits], letters
    return None


def gravity_triad(table: Sampled, taken: set[int]) -> list[int] | None:
    """Return three neighbouring columns whose mean has the size of gravity in a known unit.

    One column holds most of gravity, and with any two neighbours it has its size: of several
    threes those count whose names differ in their last sign alone, then those that begin where
    threes do, counted from the first column that is no time.
    """
    found = []
    for k in range(table.value.shape[1] - 2):
        columns = [k, k + 1, k + 2]
        if not taken & set(columns) and accel_unit(table, columns)[0]:
            found.append(columns)
    first = next((k for k in range(table.value.shape[1]) if k not in taken), 0)
    alike = [c for c in found if len({_stem(table.plain[k]) for k in c}) == 1 and table.plain[c[0]]]
    in_threes = [c for c in found if (c[0] - first) % 3 == 0]
    for choice in (alike, found if len(found) == 1 else [], in_threes, found):
        if choice:
            return choice[0]
    return None


def _stem(name: str) -> str:
    """Return a name without the sign that tells axes apart, at its end or its beginning."""
    return re.sub(r"_?([xyz]|[0-9]|[abc])$", "", name)


def accel_unit(table: Sampled, columns: list[int]) -> tuple[str, str]:
    """Return the unit in which the mean specific force is gravity ('' if in none), and evidence."""
    value = table.value[:, columns]
    if not np.isfinite(value).all():
        return "", ""
    size = float(np.linalg.norm(value.mean(axis=0)))
    k = time_index(table)
    steps = {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}
    if k is not None and np.isfinite(table.value[:, k]).all():
        interval = float(np.median(np.diff(table.value[:, k])))
        if 0.0 < interval < 0.5:
            steps["m/s"] = 1.0 / interval
    for unit, factor in steps.items():
        if abs(size * factor / STANDARD_GRAVITY - 1.0) < 0.06:
            of = "gravity" if unit != "m/s" else "gravity times the interval: increments"
            return unit, f"mean has size {size:.5g}: {of}"
    return "", f"mean has size {size:.5g}, gravity in no known unit"


def unit_said(table: Sampled, columns: list[int], known: tuple[str, ...]) -> str:
    """Return the unit that all the columns' headers name, '' if they do not or disagree."""
    said = set()
    for k in columns:
        name = table.source.names[k].lower() if table.source.names else ""
        said.add(next((u for u in known if any(form in name for form in _SPELT[u])), ""))
    return said.pop() if len(said) == 1 else ""


def time_columns(table: Sampled) -> set[int]:
    """Return the columns that hold time."""
    return {k for k in (time_index(table), week_index(table)) if k is not None}


def time_unit_said(table: Sampled, k: int) -> tuple[str, str]:
    """Return the unit below the second that the header of a column of time names, and how; ''."""
    name = table.source.names[k].lower().strip() if table.source.names else ""
    if name in _TICKS:
        return _TICKS[name], f"of {table.source.names[k]}"
    found = re.search(_TIME_UNIT, name)
    return (found[1], "says the header") if found else ("", "")


def zone_said(table: Sampled, k: int) -> str:
    """Return 'utc' where dates of a column end in a zone, '' where they do not."""
    return "utc" if _all(table, k, r"\d(Z|[+-]\d\d:?\d\d)$") else ""


def datum_said(table: Sampled, k: int) -> tuple[str, str] | None:
    """Return what heights count from where a name or a known maker says so, and the evidence."""
    for datum, pattern in _DATUMS.items():
        if re.search(pattern, table.plain[k]):
            return datum, "says the header"
    if undulation(table) is not None:
        for pattern, datum, whose in _MAKERS:
            if table.find(pattern):
                return datum, f"beside an undulation: as {whose}"
    return None


def undulation(table: Sampled) -> int | None:
    """Return the column of the geoid's height above the ellipsoid."""
    return next(iter(table.find(_UNDULATION)), None)


def is_other_sensor(table: Sampled, columns: list[int]) -> bool:
    """Return whether the names say that columns are of a magnetometer or the like."""
    return any(
        re.search(r"mag|temp|baro|press|euler|roll(?!_?rate)|quat", table.plain[k]) for k in columns
    )


def up_axis(table: Sampled, columns: list[int]) -> str:
    """Return which axis of the file points up, as text."""
    mean = table.value[:, columns].mean(axis=0)
    axis = int(np.argmax(np.abs(mean)))
    return f"{'xyz'[axis]} of the file points {'up' if mean[axis] > 0 else 'down'}"


def place(table: Sampled) -> list[int] | None:
    """Return the columns of latitude, longitude and height: by name."""
    hits = [table.find(pattern) for pattern in _PLACES.values()]
    heights = [k for p in _DATUMS.values() for k in table.find(p) if not table.find(_UNDULATION) or
               k not in table.find(_UNDULATION)]  # fmt: skip
    hits[2] = [k for k in (*heights[:1], *hits[2]) if re.search("h|alt", table.plain[k])]
    return [h[0] for h in hits] if all(hits) else None


def ecef(table: Sampled) -> list[int] | None:
    """Return three neighbouring columns that hold an ECEF position."""
    for k in range(table.value.shape[1] - 2):
        radius = np.linalg.norm(table.value[:, k : k + 3], axis=1)
        if ((radius > 6.3e6) & (radius < 6.5e6)).all():
            return [k, k + 1, k + 2]
    return None


def deviations(table: Sampled, letters: str, of: str) -> list[int] | None:
    """Return three columns of standard deviations of position ('pos') or velocity ('vel').

    `letters` 'lla': those of latitude, longitude and height.
    """
    for shared in _SHARED[of]:
        hits = [table.find(rf"^{name}$") for name in shared]
        if all(hits):
            return [h[0] for h in hits]
    if letters == "lla":
        places = ("lat(itude)?", "(lon|lng)(gitude)?", "(h|hgt|height|alt(itude)?)")
        hits = [table.find(rf"^{p}_?{_DEVIATION}$|^{_DEVIATION}_?{p}$") for p in places]
        return [h[0] for h in hits] if all(hits) else None
    for form in (
        rf"^{of}\w*_{_DEVIATION}_?{{}}$",
        rf"^{_DEVIATION}_?{of}\w*_?{{}}$",
        rf"^{_DEVIATION}_?{'v' if of == 'vel' else ''}{{}}$",
        rf"^{'v' if of == 'vel' else ''}{{}}_?{_DEVIATION}$",
    ):
        hits = [table.find(form.format(letter)) for letter in letters]
        if all(hits):
            return [h[0] for h in hits]
    return None
