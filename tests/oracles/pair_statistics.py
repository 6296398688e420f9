"""The DDIA-VE paper's Tables 2, 3, 5 and Fig. 5 counted again, epoch by epoch and pair by pair.

Shares nothing with `velocity`: signal travel, Earth rotation, eq. (20) and the statistics are
written out for a single pair, from the arrays of a recording as its reader gives them.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import pearsonr, spearmanr

from certnav.datasets.sequence import Sequence

_C, _OMEGA = 299_792_458.0, 7.2921151467e-5


def pairs(sequence: Sequence, systems: str = "G", min_speed: float = 0.5) -> list[tuple]:
    """Return (k, SNR of A, SNR of B, |velocity error|) of every pair of every epoch."""
    o, reference = sequence.observations, sequence.reference
    assert o is not None and reference is not None
    usable = np.isfinite(o.range_rate) & (o.rejected == "")
    usable &= np.isin(o.sat.astype("U1"), list(systems))
    out = []
    for time in np.unique(o.time[usable]):
        after = np.searchsorted(reference.time, time)
        if after in (0, reference.time.size) and time not in reference.time[[0, -1]]:
            continue
        receiver, velocity = (
            np.array([np.interp(time, reference.time, column) for column in of.T])
            for of in (reference.pos_e, reference.vel_e)
        )
        speed = math.sqrt(velocity @ velocity)
        if not speed > min_speed:
            continue
        ahead = velocity / speed
        seen = []
        for row in np.flatnonzero(usable & (o.time == time)):
            travel = np.linalg.norm(o.sat_pos_e[row] - receiver) / _C
            angle = _OMEGA * travel
            turn = np.array(
                [[math.cos(angle), math.sin(angle), 0.0],
                 [-math.sin(angle), math.cos(angle), 0.0],
                 [0.0, 0.0, 1.0]]
            )  # fmt: skip
            sight = turn @ o.sat_pos_e[row] - receiver
            sight = sight / np.linalg.norm(sight)
            closing = -o.range_rate[row] + sight @ (turn @ o.sat_vel_e[row])
            closing -= o.sat_clock_drift[row]
            seen.append((sight, closing, o.cn0[row]))
        for first in range(len(seen)):
            for second in range(first + 1, len(seen)):
                (e_a, z_a, snr_a), (e_b, z_b, snr_b) = seen[first], seen[second]
                along = float((e_a - e_b) @ ahead)
                error = np.linalg.norm((z_a - z_b) / along * ahead - velocity)
                out.append((abs(along), snr_a, snr_b, error))
    return out


def tables(found: list[tuple]) -> dict[str, float]:
    """Return the figures of Tables 2, 3 and 5, Fig. 5, and of SNR > 40, k > 0.2."""
    k, snr_a, snr_b, error = np.array(found).T
    regular = k > 0.05
    rms = math.sqrt(np.mean(error[regular] ** 2))
    left = regular & (error <= 3.0 * rms)
    snr = (snr_a + snr_b) / 2.0
    trusted = left & (snr > 40.0) & (k > 0.2)
    both = np.concatenate([snr_a[left], snr_b[left]])
    return {
        "pairs": k.size,
        "dropped": int((~regular).sum()),
        "rms": rms,
        "kept": int(left.sum()),
        "snr_mean": float(np.mean(snr[left])),
        "snr_std": float(np.std(snr[left])),
        "pearson_k": pearsonr(k[left], error[left])[0],
        "spearman_k": spearmanr(k[left], error[left])[0],
        "pearson_snr": pearsonr(snr[left], error[left])[0],
        "spearman_snr": spearmanr(snr[left], error[left])[0],
        "pearson_one_snr": pearsonr(both, np.tile(error[left], 2))[0],
        "rms_40_20": math.sqrt(np.mean(error[trusted] ** 2)),
        "kept_40_20": trusted.sum() / left.sum(),
    }
