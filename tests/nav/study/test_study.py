"""The study of the paper: what it counts, what it leaves open, and what it writes."""

from __future__ import annotations

import csv
import dataclasses
import json
import re

import numpy as np
import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.rtklib import satellite_states
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import SPEED_OF_LIGHT
from certnav.filters.errors import ConfigError, DataError
from certnav.nav.commands.cli import main
from certnav.nav.study.paper import PAPER
from certnav.nav.study.recording import StudyOptions, study, with_options
from certnav.nav.study.report import write_study
from certnav.nav.study.tables import series, tables
from certnav.velocity.study.samples import reference_samples
from certnav.velocity.study.tables import describe, pair_table
from oracles import pair_statistics
from oracles.products import write_clk, write_sp3


@pytest.fixture(scope="module")
def drive():
    config = SimulationConfig("drive_1 & co", 5, 280.0, density="suburb")
    return simulate(config).sequence()


@pytest.fixture(scope="module")
def found(drive):
    bare = dataclasses.replace(drive, reference=None, name="no reference")
    return study([drive, drive, bare], StudyOptions(epochs=100), jobs=1)


@pytest.mark.parametrize("name", ["comma2k19-example1", "simulated"])
def test_tables_2_3_5_and_fig_5_agree_with_a_count_pair_by_pair(name, drive, data_dir):
    # The count knows no lever arm: both have the reference's point for the antenna's.
    here = dataclasses.replace(drive.calibration, lever_antenna_b=drive.reference.lever_b)
    sequence = dataclasses.replace(drive, calibration=here)
    if name != "simulated":
        if not (data_dir / name).is_dir():
            pytest.skip(f"{name} not found")
        sequence = load(data_dir / name)
    expected = pair_statistics.tables(pair_statistics.pairs(sequence))
    (one,) = study([sequence], jobs=1).recordings
    f = one.figures
    cell, correlation = one.at(40.0, 0.2), f["correlation"]
    ours = {
        "pairs": f["pairs"],
        "dropped": f["pairs"] - f["k05_kept"],
        "rms": f["rms_k05_mps"],
        "kept": f["kept_3rms"],
        "snr_mean": f["cn0"]["mean_dbhz"],
        "snr_std": f["cn0"]["std_db"],
        "pearson_k": correlation["k"]["pearson"],
        "spearman_k": correlation["k"]["spearman"],
        "pearson_snr": correlation["snr_mean"]["pearson"],
        "spearman_snr": correlation["snr_mean"]["spearman"],
        "pearson_one_snr": correlation["snr"]["pearson"],
        "rms_40_20": cell["rms_mps"],
        "kept_40_20": cell["kept"],
    }
    assert ours == pytest.approx(expected, rel=0.01)
    if name != "simulated":
        known = {"pairs": 21_012, "dropped": 1_079, "rms": 2.747, "kept": 19_584,
                 "rms_40_20": 0.869, "kept_40_20": 0.621}  # fmt: skip
        assert {key: expected[key] for key in known} == pytest.approx(known, rel=0.01)


def test_nothing_depends_on_which_satellite_is_called_a(drive):
    table = pair_table(reference_samples(drive))
    rng = np.random.default_rng(1)
    swap = rng.random(len(table)) < 0.5
    values = {f.name: getattr(table, f.name) for f in dataclasses.fields(table)}
    for name in ("sat", "cn0", "elevation", "azimuth"):
        a, b = values[f"{name}_a"], values[f"{name}_b"]
        values[f"{name}_a"], values[f"{name}_b"] = np.where(swap, b, a), np.where(swap, a, b)
    swapped, plain = describe(type(table)(**values)), describe(table)
    for key in ("correlation", "by_satellite", "within_snr", "cn0"):
        assert json.dumps(_rounded(swapped[key])) == json.dumps(_rounded(plain[key]))
    assert swapped["correlation"]["snr"]["pearson"] != 0.0


def _rounded(value):
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return round(value, 9) if isinstance(value, float) else value


def test_every_satellite_and_every_range_counts_all_its_pairs(found):
    f = found.recordings[0].figures
    assert sum(s["count"] for s in f["by_satellite"]) == 2 * f["kept_3rms"]
    assert sum(r["count"] for r in f["within_snr"]) == f["kept_3rms"]
    whole = sum(s["count"] * s["mean_dbhz"] for s in f["by_satellite"]) / (2 * f["kept_3rms"])
    assert whole == pytest.approx(f["cn0"]["mean_dbhz"])
    total = sum(r["count"] * r["rms_mps"] ** 2 for r in f["within_snr"])
    assert np.sqrt(total / f["kept_3rms"]) == pytest.approx(f["rms_3rms_mps"])


def test_the_paper_s_own_rows_add_up():
    assert [p.pairs - p.singular for p in PAPER] == [10_521, 49_868, 11_203]
    lost = [p.pairs - p.singular - p.outliers - p.left for p in PAPER]
    assert lost == [0, 0, 1]  # the slip of its Table 3


def test_a_recording_that_cannot_be_judged_stays_and_says_why(found, drive):
    first, second, bare = found.recordings
    assert second.name == f"{first.name} (2)"
    assert second.figures["rms_k05_mps"] == first.figures["rms_k05_mps"]
    assert not bare.figures
    assert "no reference" in bare.notes[0]
    for table in tables(found):
        row = next(r for r in table.rows if r[0] == "no reference")
        assert set(row[1:]) == {None}
    with pytest.raises(DataError, match="no reference"):
        study([dataclasses.replace(drive, reference=None)], jobs=1)


def test_all_files_are_there_and_say_the_same(found, tmp_path):
    out = write_study(found, tmp_path / "study")
    names = {path.name for path in out.iterdir()}
    numbered = {f"table{k}{kind}" for k in (2, 3, 4, 5) for kind in (".csv", ".tex")}
    drawn = {f"fig{k}{kind}" for k in range(3, 9) for kind in (".csv", ".pdf")}
    assert names == numbered | drawn | {
        "study.html", "study.json", "operating_points.csv", "operating_points.tex",
    }  # fmt: skip
    stored = json.loads((out / "study.json").read_text())["recordings"]
    one = found.recordings[0]
    with (out / "table3.csv").open() as file:
        row = next(csv.DictReader(file))
    assert float(row["RMS [m/s]"]) == stored[one.name]["rms_k05_mps"] == one.figures["rms_k05_mps"]
    assert r"drive\_1 \& co" in (out / "table3.tex").read_text()
    page = (out / "study.html").read_text()
    assert {int(k) for k in re.findall(r"\(Fig\. (\d)", page)} == set(range(3, 9))
    assert page.count('class="plot"') == 2 * 5 + 4
    assert "drive_1 &amp; co" in page
    assert all(len(table.rows) for table in series(found))
    write_study(found, out)  # replaces its own
    (out / "study.json").unlink()
    with pytest.raises(DataError, match="is not a study"):
        write_study(found, out)


def test_options_go_to_the_readers_that_know_them(data_dir, tmp_path):
    folder = data_dir / "smartloc-berlin1"
    if not folder.is_dir():
        pytest.skip("smartloc-berlin1 not found")
    drive = simulate(SimulationConfig(duration=20.0)).sequence()
    given = with_options([drive, folder], {})
    assert [options for _, options in given] == [{}, {}]
    with pytest.raises(ConfigError, match="data"):
        with_options([drive, folder], {"no_such_option": 1})


def test_what_is_missing_is_named(drive):
    observations, reference = drive.observations, drive.reference
    deaf = dataclasses.replace(observations, cn0=np.full(len(observations), np.nan))
    with pytest.raises(DataError, match=r"none of \d+ pairs has a C/N0"):
        study([dataclasses.replace(drive, observations=deaf)], jobs=1)
    flat = dataclasses.replace(reference, rpy=np.full_like(reference.rpy, np.nan))
    with pytest.raises(DataError, match="'no reference attitude for the lever arm': 281"):
        study([dataclasses.replace(drive, reference=flat)], jobs=1)
    # A minute without reference in every attempt at an outage: none is made up over the hole.
    hole = (reference.time < reference.time[0] + 150.0) | (reference.time > reference.time[0] + 160)
    parts = {name: getattr(reference, name)[hole] for name in ("time", "pos_e", "vel_e", "rpy")}
    holed = dataclasses.replace(drive, reference=dataclasses.replace(reference, **parts))
    (one,) = study([holed], jobs=1).recordings
    assert not one.attitude
    assert "with a reference attitude throughout" in one.notes[-1]


@pytest.mark.parametrize(
    "more, said",
    [
        (["--direction", "north"], "direction: expected"),
        (["--systems", "G1"], "systems: expected"),
        (["--epochs", "1"], "epochs: expected"),
        (["--jobs", "0"], "--jobs: expected"),
        (["--set", "data.no_such=1"], "no_such"),
        ([], "no such file or folder"),
    ],
)
def test_impossible_wishes_are_one_line(more, said, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["study", str(tmp_path / "nothing"), "--out", str(out), *more]) == 1
    printed = capsys.readouterr()
    if "no_such" not in said:
        assert said in printed.err
    assert printed.err.count("\n") == 1
    assert not out.exists()


def test_precise_products_are_studied_beside_broadcast_ones(tmp_path):
    """Made of the broadcasts they say the same; with wrong clock rates, what those do to Doppler.

    Every second satellite's clock runs 0.5 m/s fast: its Doppler is as much off.
    """
    folder = simulate_folder(
        SimulationConfig("drive", 5, 120.0, density="suburb", imu_rate=25.0), tmp_path / "drive"
    )
    sequence = load(folder)
    o = sequence.observations
    names = sorted(set(map(str, o.sat)))
    begin = np.floor(o.time[0] / 900.0) * 900.0

    def states(fast_mps):
        def at(sats, time):
            found = satellite_states(sequence.navigation, sats, np.full(len(sats), time))
            moving = found.vel_e + np.cross([0.0, 0.0, 7.2921151467e-5], found.pos_e)
            clock = found.clock + 2.0 * np.sum(found.pos_e * moving, axis=1) / SPEED_OF_LIGHT
            wrong = np.array([fast_mps * (names.index(sat) % 2) for sat in sats])
            return found.pos_e, (clock + wrong * (time - begin)) / SPEED_OF_LIGHT

        return at

    def made(fast_mps):
        orbits = begin + 900.0 * np.arange(-6, 8)
        return [
            write_sp3(tmp_path / "day.sp3", names, orbits, states(fast_mps)),
            write_clk(tmp_path / "day.clk", names, begin + 30.0 * np.arange(40), states(fast_mps)),
        ]

    broadcast, precise = study([folder], precise=made(0.0), jobs=1).recordings
    assert (broadcast.name, precise.name) == ("drive", "drive, precise")
    assert broadcast.figures["pairs"] == precise.figures["pairs"] > 500
    rms = [one.figures["rms_k05_mps"] for one in (broadcast, precise)]
    assert rms[1] == pytest.approx(rms[0], rel=0.01)
    assert "precise ephemerides (day.sp3, day.clk; " in precise.notes[0]
    broadcast, wrong = study([folder], precise=made(0.5), jobs=1).recordings
    assert wrong.figures["rms_k05_mps"] > 1.5 * broadcast.figures["rms_k05_mps"]
    held = states(0.0)
    orbits = begin + 86400.0 + 900.0 * np.arange(-6, 8)
    other = write_sp3(tmp_path / "other.sp3", names, orbits, lambda sats, _: held(sats, begin))
    broadcast, nothing = study([folder], precise=[other], jobs=1).recordings
    assert (
        broadcast.figures
        and not nothing.figures
        and "of none of the satellites at the time" in nothing.notes[0]
    )
