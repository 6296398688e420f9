"""How fast certnav is, and against whom: filter, whole run, alignment, tuning, growth.

    python scripts/benchmark.py [--json] [--quick]

One synthetic drive feeds everything: a car in streets, a 200 Hz IMU, 1 Hz GNSS. The peers
python-ins and sidereon (`pip install certnav[bench]`) get the same samples and the same fixes;
one that is not installed is null. Times are the best of several, and of the processor (one thread,
ours and theirs), so that what other programs do meanwhile hardly counts; only whole runs are
timed by the clock on the wall.

filter_us_per_sample      time update, covariance and record at every sample [µs], by states
text_run_s, text_run_mb   KF-GINS text in, 200 Hz `.nav` out: the process of `certnav run`, warm;
                          text_run_cpu_s is what it kept the processors busy for
read_text_s               the IMU text of it alone
first_run_s               what a first run takes more, for it compiles (not with --quick)
alignment_us              one certified solve, median over simulated windows
tune_s_per_million_pairs  all pairs of all epochs, with everything thresholds look at
peers                     filter with 1 Hz updates [µs per sample]: ours, theirs, ratio
growth                    at 1/4, 1/2 and all of the data; linear is a constant time per sample
load                      other programs at work meanwhile (1 min average, before and after)
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is imported

import numpy as np
from benchmark_peers import (
    LEVER,
    RATE,
    SIGMA_POS,
    SIGMA_VEL,
    WEEK,
    Drive,
    best,
    lla_deg,
    new_filter,
    peers,
    simulated,
)

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.datasets.formats.kfgins import read_imu
from certnav.datasets.gpstime import to_week_sow
from certnav.filters.earth import C_en_of
from certnav.nav.results.formats import format_rows
from certnav.velocity.range_rate import DopplerRows
from certnav.velocity.study.pairs import all_pairs
from certnav.velocity.vehicle_motion import ForwardMotion


def filter_us(data: Drive, states: int, repeat: int) -> float:
    """Time update with covariance and a recorded row at every sample, no measurements [µs]."""
    times = []
    for _ in range(repeat):
        kalman = new_filter(data, states)
        began = time.process_time()
        kalman.propagate(kalman.stream.end)
        times.append(time.process_time() - began)
    return 1e6 * min(times) / len(data.imu)


def write_text(data: Drive, folder: Path) -> None:
    """Write IMU increments and GNSS in KF-GINS's columns."""
    folder.mkdir(parents=True, exist_ok=True)
    sow, step = to_week_sow(data.imu.time)[1], 1.0 / RATE
    table = np.column_stack([sow, data.imu.gyro_b * step, data.imu.accel_b * step])
    rows = format_rows("%.6f" + " %.12e" * 6, table)
    (folder / "imu.txt").write_text(rows, encoding="utf-8")
    fixes, n = data.fixes, data.fixes.time.size
    vel_n = np.einsum("nji,nj->ni", C_en_of(fixes.pos_e), fixes.vel_e)
    table = np.column_stack([
        to_week_sow(fixes.time)[1], lla_deg(fixes.pos_e), np.full((n, 3), SIGMA_POS),
        vel_n, np.full((n, 3), SIGMA_VEL),
    ])  # fmt: skip
    rows = format_rows("%.3f %.11f %.11f %.5f" + " %.3f" * 3 + " %.5f" * 3 + " %.3f" * 3, table)
    (folder / "gnss.txt").write_text(rows, encoding="utf-8")


def text_run(folder: Path, out: Path, cache: Path | None = None) -> tuple[float, float, float]:
    """Run the command line on a folder; return wall and processor time [s], peak memory [MB]."""
    command = [
        sys.executable, "-m", "certnav.nav.commands.cli", "run", str(folder), "--out", str(out),
        "--only", "nav",
    ]  # fmt: skip
    settings = [
        f"data.lever={LEVER.tolist()}", 'data.imu_preset="adis16470"', f"data.week={WEEK}",
        "filter.output_rate_hz=0",
    ]  # fmt: skip
    for setting in settings:
        command += ["--set", setting]
    environment = dict(os.environ)
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    said = subprocess.DEVNULL if cache else None  # that it compiles
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said, env=environment)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"benchmark: certnav run failed on {folder}")
    spent = time.perf_counter() - began
    return spent, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0


def alignment_us(windows: int) -> float:
    """One certified solve: median over windows of the best of three [µs]."""
    rng, times = np.random.default_rng(3), []
    for k in range(windows):
        motion = "2d" if k % 2 else "3d"
        window = simulate_window(rng, int(rng.integers(2, 9)), motion, sigma=0.05)
        Q = build_problem(window.rows).Q
        if k == 0:
            fast_minimum(Q)
        times.append(best(lambda Q=Q: fast_minimum(Q), 3))
    return 1e6 * float(np.median(times))


def tune_s(pairs: int, repeat: int) -> float:
    """All pairs of epochs with 20 satellites, per million of them [s]."""
    rng, satellites = np.random.default_rng(4), 20
    epochs = pairs // (satellites * (satellites - 1) // 2)
    n = epochs * satellites
    e_e = rng.normal(size=(n, 3))
    e_e /= np.linalg.norm(e_e, axis=1, keepdims=True)
    u_e = rng.normal(size=(epochs, 3))
    u_e /= np.linalg.norm(u_e, axis=1, keepdims=True)
    epoch = np.repeat(np.arange(epochs), satellites)
    rows = DopplerRows(
        np.arange(n), np.full(n, "G01"), e_e, 10.0 * np.einsum("ij,ij->i", e_e, u_e[epoch]),
        np.full(n, 0.1),
    )  # fmt: skip
    motion = ForwardMotion(u_e, np.zeros((epochs, 3)), np.zeros((3, 3)))
    cn0, elevation = rng.uniform(25.0, 50.0, n), rng.uniform(0.1, 1.5, n)
    found = len(all_pairs(rows, epoch, motion, cn0, elevation))
    return 1e6 / found * best(lambda: all_pairs(rows, epoch, motion, cn0, elevation), repeat)


def run(quick: bool) -> dict:
    """All figures."""
    duration = 300.0 if quick else 1200.0
    data = simulated(duration)
    parts = [data.until(duration * share) for share in (0.25, 0.5, 1.0)]
    repeat, before = 3 if quick else 9, os.getloadavg()[0]
    new_filter(parts[0].until(5.0)).propagate(parts[0].imu.time[500])
    text, busy, memory, read, first = [], 0.0, 0.0, 0.0, None
    with tempfile.TemporaryDirectory() as scratch:
        for k, part in enumerate(parts):
            folder, out = Path(scratch) / f"text{k}", Path(scratch) / "out"
            write_text(part, folder)
            runs = [text_run(folder, out) for _ in range(2 if quick else 5)]
            text.append(min(runs)[0])
            busy, memory = min(cpu for _, cpu, _ in runs), max(peak for *_, peak in runs)
            read = best(lambda folder=folder: read_imu(folder / "imu.txt", week=WEEK), 3)
        if not quick:
            first = text_run(folder, out, Path(scratch) / "cache")[0] - text[-1]
    by_length = [filter_us(part, 15, repeat) for part in parts]
    pairs = (50_000, 100_000, 200_000) if quick else (250_000, 500_000, 1_000_000)
    tuned = [tune_s(count, 3) for count in pairs]
    return {
        "filter_us_per_sample": {
            "15": round(by_length[-1], 2),
            "21": round(filter_us(data, 21, repeat), 2),
        },
        "text_run_s": round(text[-1], 2),
        "text_run_cpu_s": round(busy, 2),
        "text_run_mb": round(memory),
        "text_run_samples": len(data.imu),
        "read_text_s": round(read, 3),
        "first_run_s": first if first is None else round(first, 1),
        "alignment_us": round(alignment_us(20 if quick else 200), 1),
        "tune_s_per_million_pairs": round(tuned[-1], 3),
        "peers": peers(data, quick),
        "growth": {
            "samples": [len(part.imu) for part in parts],
            "filter_us_per_sample": [round(value, 2) for value in by_length],
            "text_run_s": [round(value, 2) for value in text],
            "pairs": pairs,
            "tune_s_per_million_pairs": [round(value, 3) for value in tuned],
        },
        "load": [round(before, 1), round(os.getloadavg()[0], 1)],
    }


def table(figures: dict) -> list[str]:
    """The same for people."""
    f, growth = figures, figures["growth"]
    rows = [
        ("filter, 15 states", f"{f['filter_us_per_sample']['15']} µs per sample"),
        ("filter, 21 states", f"{f['filter_us_per_sample']['21']} µs per sample"),
        (
            f"whole run, {f['text_run_samples']} samples",
            f"{f['text_run_s']} s, {f['text_run_cpu_s']} s of processor, {f['text_run_mb']} MB",
        ),
        ("  reading the IMU text", f"{f['read_text_s']} s"),
        ("  more the first time", "not measured" if f["first_run_s"] is None
         else f"{f['first_run_s']} s"),
        ("alignment", f"{f['alignment_us']} µs per solve"),
        ("tuning", f"{f['tune_s_per_million_pairs']} s per million pairs"),
        ("filter with 1 Hz updates", f"{f['peers']['certnav_us']} µs per sample"),
    ]  # fmt: skip
    for name, peer in f["peers"].items():
        if name != "certnav_us":
            against = f"{peer['us']} µs per sample, {peer['ratio']} ×" if peer else "not installed"
            rows.append((f"  {name}", against))
    rows += [(f"growth, {name}", ", ".join(map(str, values))) for name, values in growth.items()]
    rows.append(("load", " → ".join(map(str, f["load"]))))
    width = max(len(name) for name, _ in rows)
    return [f"{name:<{width}}  {value}" for name, value in rows]


def main() -> None:
    """Print the table, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--quick", action="store_true", help="a quarter of the data, few repeats")
    arguments = parser.parse_args()
    figures = run(arguments.quick)
    if arguments.json:
        print(json.dumps(figures, ensure_ascii=False))
        return
    print("\n".join(table(figures)))


if __name__ == "__main__":
    main()
