"""Attack the certificate: windows made to have a cheaper rotation than the one called the best.

    python scripts/alignment_attacks.py [--attacks 20000] [--sdp 2000] [--first 0] [--seconds S]

The windows, and what rotations cost in them, are those of `tests/oracles/attacks.py`: numpy alone,
sums over the rows in 80 bits. A certificate is false if a rotation more than a degree away from
the certified one costs less: the truth, or a bottom reached from either, from their half-turns
or from random starts. The first `--sdp` windows are given to the semidefinite relaxation as well,
which must say the same. A run that ended early (`--seconds`) says with what `--first` to go on.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.certifiable import certified_minimum
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.status import AlignmentStatus
from certnav.filters.errors import AlignmentError

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.oracles.attacks import KINDS, Attack, Costs, angle, attacks

#: How far away a cheaper rotation makes a certificate false [deg].
AWAY = 1.0


def window(attack: Attack) -> AlignmentRows:
    """Return an attack as rows."""
    time_s = attack.epoch.astype(float)
    return AlignmentRows(attack.e, attack.v, attack.z, attack.sigma, attack.epoch, time_s)


def cheapest_elsewhere(attack: Attack, C: np.ndarray, seed: int) -> tuple[float, float]:
    """Return what the cheapest rotation found beyond a degree costs more, and its distance."""
    costs, here = Costs(attack), 0.0
    here = costs(C)
    found = costs.wells(np.random.default_rng(seed), [C, attack.C])
    others = [(float(costs(R) - here), angle(R, C)) for R in [attack.C, *found]]
    return min((o for o in others if o[1] > AWAY), default=(np.inf, np.nan))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--attacks", type=int, default=20_000)
    parser.add_argument("--sdp", type=int, default=2_000, help="of them also by the relaxation")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=np.inf, help="stop after so long")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    begin, said, disagree, false = time.monotonic(), Counter(), [], []
    worst, number, microseconds = (np.inf, np.nan, -1), arguments.first, []
    for number, attack in enumerate(
        attacks(arguments.seed, arguments.first, arguments.attacks), arguments.first
    ):
        if time.monotonic() - begin > arguments.seconds:
            break
        try:
            problem = build_problem(window(attack))
        except AlignmentError:
            said[attack.kind, "REFUSED"] += 1
            continue
        start = time.perf_counter()
        minimum = fast_minimum(problem.Q, factor=problem.factor)
        microseconds.append(1e6 * (time.perf_counter() - start))
        said[attack.kind, minimum.status.name] += 1
        if number < arguments.sdp:
            sdp = certified_minimum(problem.Q, factor=problem.factor)
            if sdp.status is not minimum.status:
                disagree.append((number, minimum.status.name, sdp.status.name))
        if minimum.status is AlignmentStatus.CERTIFIED:
            excess, away = cheapest_elsewhere(attack, minimum.C, number)
            worst = min(worst, (excess / minimum.scale, away, number))
            if excess < 0.0:
                false.append((number, attack.kind, excess, away))
    else:
        number = max(arguments.attacks, arguments.first)
    report = {
        "attacks": number - arguments.first,
        "next": number,
        "said": {
            kind: {s: n for (k, s), n in sorted(said.items()) if k == kind} for kind in KINDS
        },
        "false": false,
        "least_excess_of_trace": worst[0], "its_angle_deg": worst[1], "its_number": worst[2],
        "sdp_asked": max(min(number, arguments.sdp) - arguments.first, 0),
        "sdp_disagrees": disagree,
        "solver_us": [round(float(np.percentile(microseconds, p)), 1) for p in (50.0, 99.0, 100.0)],
    }  # fmt: skip
    if arguments.json:
        print(json.dumps(report))
    else:
        for name, value in report.items():
            print(f"{name:22} {value}")
    return 1 if false or disagree else 0


if __name__ == "__main__":
    sys.exit(main())
