"""Precise products written from any function of time: SP3-c orbits, RINEX 3 clocks, ANTEX."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from certnav.datasets import gpstime

#: Satellites and GPS times → positions [m] (n, 3), clocks [s] (n,).
States = Callable[[list[str], float], tuple[np.ndarray, np.ndarray]]


def _stamp(time: float, form: str) -> str:
    t = gpstime.to_calendar(time)
    return form.format(t.year, t.month, t.day, t.hour, t.minute, t.second + t.microsecond * 1e-6)


def write_sp3(path: Path, names: list[str], times: np.ndarray, states: States) -> Path:
    """Write positions [km] and clocks [µs] as SP3-c."""
    epoch = "{:4d} {:2d} {:2d} {:2d} {:2d} {:11.8f}"
    listed = [*names, *["  0"] * (85 - len(names))]
    lines = [f"#cP{_stamp(times[0], epoch)} {times.size:7d} ORBIT IGS14 FIT  TST"]
    week, sow = gpstime.to_week_sow(times[0])
    step = times[1] - times[0]
    lines.append(f"## {int(week):4d} {float(sow):15.8f} {step:14.8f} 59149 0.0000000000000")
    for k in range(5):
        head = f"+  {len(names):3d}   " if k == 0 else "+        "
        lines.append(head + "".join(listed[17 * k : 17 * (k + 1)]))
    lines += ["++       " + "  0" * 17] * 5
    lines += ["%c G  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc"]
    lines += ["%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc"]
    lines += ["%f  1.2500000  1.025000000  0.00000000000  0.000000000000000"] * 2
    lines += ["%i    0    0    0    0      0      0      0      0         0"] * 2
    lines += ["/* TEST"] * 4
    for time in times:
        lines.append("*  " + _stamp(time, epoch))
        position, clock = states(names, time)
        for name, p, c in zip(names, position / 1e3, clock * 1e6, strict=True):
            lines.append(f"P{name}{p[0]:14.6f}{p[1]:14.6f}{p[2]:14.6f}{c:14.6f}")
    path.write_text("\n".join([*lines, "EOF"]) + "\n")
    return path


def write_clk(path: Path, names: list[str], times: np.ndarray, states: States) -> Path:
    """Write clocks [s] as RINEX 3."""
    lines = [
        f"{'     3.00':20}{'CLOCK DATA':20}{'G':20}RINEX VERSION / TYPE",
        f"{'     1    AS':60}# / TYPES OF DATA",
        f"{'':60}END OF HEADER",
    ]
    for time in times:
        _, clock = states(names, time)
        for name, c in zip(names, clock, strict=True):
            stamp = _stamp(time, "{:4d} {:02d} {:02d} {:02d} {:02d} {:9.6f}")
            lines.append(f"AS {name}  {stamp}  2   {c:19.12E} {1e-11:19.12E}")
    path.write_text("\n".join(lines) + "\n")
    return path


def write_antex(path: Path, names: list[str], up_m: float) -> Path:
    """Write antennas of satellites, so far in front of their centre of mass on two frequencies."""

    def line(text: str, label: str) -> str:
        return f"{text:60}{label}"

    lines = [
        line("     1.4            M", "ANTEX VERSION / SYST"),
        line("A", "PCV TYPE / REFANT"),
        line("", "END OF HEADER"),
    ]
    for name in names:
        lines += [
            line("", "START OF ANTENNA"),
            line(f"{'BLOCK IIF':20}{name:20}{'G063':10}{'2011-036A':10}", "TYPE / SERIAL NO"),
            line("     0.0", "DAZI"),
            line("     0.0  17.0   1.0", "ZEN1 / ZEN2 / DZEN"),
            line("     2", "# OF FREQUENCIES"),
            line("  2011     7    16     0     0    0.0000000", "VALID FROM"),
        ]
        for band in ("01", "02"):
            name_of = f"   {name[0]}{band}"
            lines += [
                line(name_of, "START OF FREQUENCY"),
                line(f"{0.0:10.2f}{0.0:10.2f}{up_m * 1e3:10.2f}", "NORTH / EAST / UP"),
                "   NOAZI" + "    0.00" * 18,
                line(name_of, "END OF FREQUENCY"),
            ]
        lines.append(line("", "END OF ANTENNA"))
    path.write_text("\n".join(lines) + "\n")
    return path
