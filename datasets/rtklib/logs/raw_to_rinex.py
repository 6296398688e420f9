"""RTKLIB's decoders of receivers' logs as a program: a broken log may end it, and nothing else.

    python raw_to_rinex.py FORMAT LOG OBSERVATIONS NAVIGATION [SECONDS]

FORMAT is RTKLIB's number of a stream format; SECONDS a Unix time without leap seconds near the
beginning, for RTCM.
"""

from __future__ import annotations

import sys

import pyrtklib5 as rtk


def convert(format: int, log: str, observations: str, navigation: str, near: float = 0.0) -> None:
    """Write RINEX 3.04 of everything in a log.

    Parameters
    ----------
    format : int
        RTKLIB's ``STRFMT_…``.
    log, observations, navigation : str
        Files.
    near : float
        RTKLIB's time near the beginning [s]; 0: the log tells it.
    """
    options = rtk.rnxopt_t()
    options.rnxver = 304
    options.navsys = rtk.SYS_GPS | rtk.SYS_GLO | rtk.SYS_GAL | rtk.SYS_QZS | rtk.SYS_CMP
    options.obstype, options.freqtype = rtk.OBSTYPE_ALL, rtk.FREQTYPE_ALL
    for system in range(rtk.RNX_NUMSYS):
        for code in range(rtk.MAXCODE):
            options.mask[system, code] = "1"
    options.outiono = options.outleaps = 1
    if near:
        time = rtk.gtime_t()
        time.time, time.sec = int(near), near % 1.0
        options.trtcm = time
    rtk.convrnx(format, options, log, [observations, navigation, *[""] * 7])


if __name__ == "__main__":
    log, observations, navigation = sys.argv[2:5]
    convert(int(sys.argv[1]), log, observations, navigation, float((sys.argv[5:] or ["0"])[0]))
