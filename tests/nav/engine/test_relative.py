"""RTK positions in a run, and where base stations and GREAT's facts come from."""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest

from certnav.datasets.great.files import base_stations
from certnav.datasets.great.reader import read_great
from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.rtklib import relative_positions
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.earth import C_en_of
from certnav.filters.errors import ConfigError, DataError
from certnav.nav.commands.cli import main
from certnav.nav.config_files import from_tables, load_config, to_toml
from certnav.nav.engine.gnss import gnss_timeline
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from certnav.nav.report.run import build_report
from certnav.nav.results.directory import read_result

CONFIG = SimulationConfig(duration=150.0, seed=3, density="open", base_distance_m=3000.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return simulate_folder(CONFIG, tmp_path_factory.mktemp("relative") / "drive")


@pytest.fixture(scope="module")
def drive(folder):
    return read_great(folder)


def rtk(**gnss):
    return from_tables({"gnss": {"position": "rtk", **gnss}})


def test_a_run_with_a_base_is_centimetres_where_one_without_is_decimetres(drive):
    """Once the ambiguities are fixed: the first half minute is theirs."""
    found = {}
    for name, config in (("with", rtk()), ("without", from_tables({}))):
        evaluation = evaluate(navigate(drive, config), drive)
        late = evaluation.time > drive.span[0] + 35.0
        horizontal = np.hypot(*evaluation.error_pos_n[late, :2].T)
        found[name] = float(np.sqrt(np.mean(horizontal**2)))
    assert found["with"] < 0.05 < found["without"]


def test_the_notes_say_what_was_fixed_and_where_the_base_is(drive):
    notes = gnss_timeline(drive, rtk().gnss).notes
    (note,) = [n.text for n in notes if n.text.startswith("RTK")]
    assert "fixed" in note and "APPROX POSITION" in note
    assert any("base station BASE3010.20o" in n for n in drive.notes)


def test_marked_satellites_stay_out_of_the_relative_positions(drive):
    o = drive.observations
    spell = o.time > o.time[0] + 100.0
    few = ~np.isin(o.sat, np.unique(o.sat)[:3])
    cut = dataclasses.replace(drive, observations=o.mark(spell & few, "outage"))
    events = [e for e in gnss_timeline(cut, rtk().gnss).events if e.kind == "position"]
    late = [e for e in events if e.time > o.time[0] + 101.0]
    assert late and all(e.reason for e in late)
    assert not any(e.reason for e in events if e.time < o.time[0] + 99.0)


def test_a_wrong_base_position_is_refused(drive):
    truth = relative_positions(drive.rover_file, drive.base, drive.navigation).base_pos_e
    north = C_en_of(truth)[:, 0]
    for offset, match in ((60.0, r"60 m .* wrong \(declared\)"), (3000.0, r"no relative position")):
        wrong = (truth + offset * north).tolist()
        with pytest.raises(DataError, match=match):
            gnss_timeline(drive, rtk(base_position_e_m=wrong).gnss)
    with pytest.raises(ConfigError, match="X, Y, Z"):
        rtk(base_position_e_m=[1.0])
    with pytest.raises(ConfigError, match="list of numbers"):
        rtk(base_position_e_m="here")


def test_the_base_survives_the_configuration_file(tmp_path):
    config = rtk(base="base.20o", base_position_e_m=[-2270513.95, 5006051.3, 3224187.0])
    (tmp_path / "c.toml").write_text(to_toml(config))
    assert load_config(tmp_path / "c.toml") == config


def test_without_a_base_there_is_one_line(drive, tmp_path):
    alone = dataclasses.replace(drive, base=())
    with pytest.raises(ConfigError, match="--base FILE"):
        gnss_timeline(alone, rtk().gnss)
    with pytest.raises(DataError, match="no RINEX observations in this folder"):
        gnss_timeline(alone, rtk(base=str(tmp_path)).gnss)


def test_base_files_of_the_time_and_station(drive, tmp_path):
    """Quarter hours of one station, a second station, and one of another day."""
    text = drive.base[0].read_text()
    for name, minute in (("a", "2     0"), ("b", "2    10"), ("c", "2    30")):
        (tmp_path / f"{name}.20o").write_text(text.replace("27     2    10", f"27     {minute}", 1))
    other = text.replace("BASE   ", "WUH2   ", 1)
    (tmp_path / "w.20o").write_text(other)
    (tmp_path / "d.20o").write_text(other.replace("10    27     2", "10    29     2", 1))
    start, end = drive.span
    found = base_stations(tuple(sorted(tmp_path.iterdir())), start, end)
    assert {k: [f.name for f in v] for k, v in found.items()} == {
        "BASE": ["a.20o", "b.20o"], "WUH2": ["w.20o"],
    }  # fmt: skip


def test_great_end_to_end_from_the_command_line(folder, tmp_path, capsys):
    """The catalogue gives week and lever arm; what it cannot know stays to be declared."""
    home = tmp_path / "GREAT"
    shutil.copytree(folder, home / "Dataset_campus-01")
    sidecar = home / "Dataset_campus-01" / "great.toml"
    lines = sidecar.read_text().splitlines()
    unknown = [k for k in lines if k.split(" = ")[0] not in ("lever", "week", "reference_point")]
    sidecar.write_text("\n".join(unknown) + "\n")
    run = ["run", str(home), "--great", "campus-01", "--out", str(tmp_path / "out")]
    assert main(run) == 1
    assert "reference_point not given" in capsys.readouterr().err
    declared = ["--set", "data.reference_point=mems", "--set", "data.systems=G"]
    base = ["--base", str(home / "Dataset_campus-01/GNSS/Base")]
    assert main([*run, *declared, *base]) == 0
    written = load_config(tmp_path / "out" / "config.toml")
    assert written.data["lever"] == "figure" and written.data["week"] == 2129
    assert written.gnss.position == "rtk"
    result = read_result(tmp_path / "out")
    resolution = result.solution.resolution
    shares = json.loads((tmp_path / "out/summary.json").read_text())["rtk"]
    assert resolution.fixed == shares["fixed"] > 0.5 * resolution.floating > 0
    assert resolution.ratio_median > 3.0 and resolution.systems == "G"
    page = build_report(result)
    assert "Positions relative to the base station" in page and f">{resolution.fixed}<" in page

    capsys.readouterr()
    assert main(["run", str(home), "--great", "urban-02"]) == 1
    error = capsys.readouterr().err
    assert "urban-02: lever arm" in error and "data.lever" in error and error.count("\n") == 1
    assert main(["run", str(home), "--great", "campus-9"]) == 1
    assert "campus-0" in capsys.readouterr().err
    assert main(["run", str(home / "Dataset_campus-01"), "--great", "suburb-01"]) == 1
    assert "named after campus-01" in capsys.readouterr().err
