"""The command line as a user meets it: results on good input, one line on bad input."""

import importlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.physics import Refusal
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.errors import DataError
from certnav.nav.commands import cli
from certnav.nav.commands.cli import main
from certnav.nav.config import Config, VehicleConfig
from certnav.nav.results.directory import read_result
from certnav.nav.sweep.drives import waived
from oracles.damage import imu_rows


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    """Two minutes in the suburbs, in the GREAT layout."""
    folder = tmp_path_factory.mktemp("drives") / "suburb"
    return simulate_folder(
        SimulationConfig(seed=4, duration=120.0, density="suburb", static_start=15.0), folder
    )


@pytest.fixture
def copy(drive, tmp_path) -> Path:
    """A copy of the drive that a test may break."""
    return Path(shutil.copytree(drive, tmp_path / "broken"))


def refuse(capsys, *arguments: str) -> str:
    """Run a command that must fail; return its one line."""
    assert main([str(a) for a in arguments]) == 1
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("certnav: ")
    assert "Traceback" not in captured.err
    return lines[0]


def test_run_writes_a_complete_result(drive, tmp_path, capsys):
    out = tmp_path / "result"
    assert main(["run", str(drive), "--out", str(out), "--format", "pos,kml,tum,nav"]) == 0
    printed = capsys.readouterr().out
    assert "horizontal" in printed and "report.html" in printed
    names = {p.name for p in out.iterdir()}
    assert {"solution.csv", "updates.csv", "config.toml", "summary.json", "report.html"} <= names
    assert {f"solution.{f}" for f in ("pos", "kml", "tum", "nav")} <= names
    summary = json.loads((out / "summary.json").read_text())
    for key in ("name", "duration_s", "imu_samples", "epochs", "alignment", "errors", "timing"):
        assert key in summary
    assert set(summary["epochs"]) >= {"total", "ge4", "two_or_three", "lt2"}
    assert summary["errors"]["horizontal_rms_m"] < 3.0
    assert summary["timing"]["total_s"] > summary["timing"]["read_s"] > 0.0
    assert len(read_result(out).solution.trajectory) > 500
    # Nothing temporary is left; RINEX has been kept for the next run.
    assert sorted(p.name for p in tmp_path.iterdir()) == [".certnav-cache", "result"]


def test_the_summary_as_json_and_nothing_else(drive, tmp_path, capsys):
    out = tmp_path / "result"
    run = ["run", str(drive), "--out", str(out), "--no-report", "--json"]
    assert main([*run, "-q", "--start", "180000", "--end", "604799"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "summary.json").read_text())


def test_verbose_says_what_took_how_long(drive, tmp_path):
    run = [sys.executable, "-m", "certnav.nav.commands.cli", "-v", "run", str(drive)]
    arguments = [*run, "--out", str(tmp_path / "result"), "--only", "tum"]
    said = subprocess.run(arguments, capture_output=True, text=True, check=True).stderr
    for what in ("read and checked in", "alignment", "filter", "all of it in"):
        assert f"{what} " in said


def test_version_is_that_of_the_package(capsys):
    from importlib.metadata import version

    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"certnav {version('certnav')}\n"


def test_what_is_missing_is_said_before_anything_is_compiled(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("certnav.nav.commands.flow.navigation.announce_kernels", lambda: 1 / 0)
    assert "no such file or folder" in refuse(capsys, "run", tmp_path / "nowhere")


def test_only_one_format_and_the_same_numbers(drive, tmp_path, capsys):
    whole, lean = tmp_path / "whole", tmp_path / "lean"
    rate = ["--set", "filter.output_rate_hz=0"]
    run = ["run", str(drive), *rate]
    assert main([*run, "--out", str(whole), "--format", "nav", "--no-report"]) == 0
    assert main([*run, "--out", str(lean), "--only", "nav"]) == 0
    assert not {"solution.csv", "report.html"} & {p.name for p in lean.iterdir()}
    nav = (lean / "solution.nav").read_bytes()
    assert nav == (whole / "solution.nav").read_bytes()
    summary = json.loads((lean / "summary.json").read_text())
    assert len(nav.splitlines()) > 0.8 * summary["imu_samples"]  # every sample once aligned
    capsys.readouterr()
    assert "solution.csv" in refuse(capsys, "report", lean, "--out", tmp_path / "page")
    for wrong in ([], ["nav", "--format", "kml"], ["nvv"]):
        said = refuse(capsys, *run, "--out", lean, "--only", *(wrong or [""]))
        assert "--only" in said or "--format" in said


def test_what_taught_nothing_is_said_and_its_result_stands(drive, tmp_path, capsys):
    out, file = tmp_path / "result", tmp_path / "van.toml"
    command = ["run", str(drive), "--out", str(out), "--only", "pos", "--set", "vehicle.nhc=off"]
    assert main([*command, "--write-calibration", str(file)]) == 0
    lines = capsys.readouterr().err.strip().splitlines()
    (said,) = (line for line in lines if str(file) in line)  # others: progress of a slow machine
    assert "van.toml not written" in said and "nothing was learned" in said
    assert not file.exists() and (out / "solution.pos").exists()


def test_rinex_comes_from_the_cache_and_gives_the_same_solution(drive, tmp_path, monkeypatch):
    from certnav.datasets.rtklib import observations

    first, second = tmp_path / "first", tmp_path / "second"
    assert main(["run", str(drive), "--out", str(first), "--only", "tum"]) == 0
    monkeypatch.setattr(observations, "_observation_records", None)  # would fail if called
    assert main(["run", str(drive), "--out", str(second), "--only", "tum"]) == 0
    same = [(out / "solution.tum").read_bytes() for out in (first, second)]
    assert same[0] == same[1]


def test_set_start_and_end(drive, tmp_path):
    out = tmp_path / "result"
    arguments = ["run", str(drive), "--out", str(out), "--set", "filter.states=21"]
    start = read_start(drive)
    assert main([*arguments, "--start", str(start + 10.0), "--end", str(start + 100.0)]) == 0
    assert "states = 21" in (out / "config.toml").read_text()
    times = read_result(out).solution.trajectory.time % 604800
    assert times.min() >= start + 10.0 and times.max() <= start + 100.0


def read_start(folder: Path) -> float:
    imu = folder / "IMU" / "MEMS_imu_data.txt"
    return float(imu.read_text().splitlines()[1].split()[0])


def edit_imu(folder: Path, change) -> None:
    """Rewrite the IMU text; `change` gets and returns its rows."""
    file = folder / "IMU" / "MEMS_imu_data.txt"
    header, *rows = file.read_text().splitlines()
    file.write_text("\n".join([header, *change(rows)]) + "\n")


def scaled(rows, columns, factor):
    table = np.array([row.split() for row in rows], dtype=float)
    table[:, columns] *= factor
    return [" ".join(f"{v:.8f}" for v in row) for row in table]


def with_nan(rows):
    first, rest = rows[:500], rows[500:]
    bad = rest[0].split()
    bad[2] = "nan"
    return [*first, " ".join(bad), *rest[1:]]


FAULTS = {
    "nan in the imu": (
        lambda d: edit_imu(d, with_nan), ["MEMS_imu_data.txt:502", "nan"],
    ),
    "time going backwards": (
        lambda d: edit_imu(d, lambda rows: [*rows[:800], rows[700], *rows[800:]]),
        ["MEMS_imu_data.txt:802"],
    ),
    "accelerometer in g": (
        lambda d: edit_imu(d, lambda rows: scaled(rows, [4, 5, 6], 1 / 9.80665)),
        ["MEMS_imu_data.txt", "m/s²"],
    ),
    "truncated rinex": (
        lambda d: truncate(next((d / "GNSS" / "Rover").iterdir())), [".20O:", "cut short"],
    ),
    "wrong week": (
        lambda d: replace(d / "great.toml", "week = 2129", "week = 2233"), ["2233", "2129"],
    ),
    "no overlap": (
        lambda d: edit_imu(d, lambda rows: [shift(row, 9000.0) for row in rows]), ["overlap"],
    ),
    "unknown key in the sidecar": (
        lambda d: replace(d / "great.toml", "gyro_unit", "giro_unit"), ["giro_unit", "gyro_unit"],
    ),
    "lever arm not declared": (
        lambda d: replace(d / "great.toml", 'lever = "figure"', ""), ["lever", "figure", "msf_xml"],
    ),
    "missing imu file": (
        lambda d: (d / "IMU" / "MEMS_imu_data.txt").unlink(), ["IMU"],
    ),
    "missing navigation": (
        lambda d: shutil.rmtree(d / "GNSS" / "Product"), ["navigation"],
    ),
}  # fmt: skip


def truncate(file: Path) -> None:
    text = file.read_text()
    file.write_text(text[: int(0.61 * len(text))])


def replace(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def shift(row: str, seconds: float) -> str:
    first, rest = row.split(maxsplit=1)
    return f"{float(first) + seconds:.5f} {rest}"


@pytest.mark.parametrize("fault", FAULTS)
def test_bad_input_is_one_line(fault, copy, tmp_path, capsys):
    damage, words = FAULTS[fault]
    damage(copy)
    out = tmp_path / "result"
    line = refuse(capsys, "run", copy, "--out", out)
    for word in words:
        assert word.lower() in line.lower(), line
    assert not out.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["broken"]


def test_missing_path_and_strange_folder(tmp_path, capsys):
    assert "no such" in refuse(capsys, "run", tmp_path / "absent").lower()
    (tmp_path / "holiday.jpg").write_text("")
    line = refuse(capsys, "run", tmp_path)
    assert "great" in line.lower()


def test_mistyped_option_names_the_nearest(drive, capsys):
    assert "did you mean 'states'" in refuse(capsys, "run", drive, "--set", "filter.state=21")
    assert "did you mean 'lever'" in refuse(capsys, "run", drive, "--set", "data.levr=figure")
    assert "did you mean 'kml'" in refuse(capsys, "run", drive, "--format", "pos,kmz")


def test_a_foreign_directory_is_not_overwritten(drive, tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("years of work")
    line = refuse(capsys, "run", drive, "--out", tmp_path)
    assert "not a certnav result" in line
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_check_says_so_and_exits_by_it(drive, copy, capsys):
    assert main(["check", str(drive)]) == 0
    assert "can be navigated" in capsys.readouterr().out
    edit_imu(copy, lambda rows: scaled(rows, [4, 5, 6], 1 / 9.80665))
    assert main(["check", str(copy), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert not report["navigable"]
    assert any("g" in f["found"] for f in report["findings"] if f["severity"] == "fatal")


def test_run_stops_at_what_check_finds_fatal_unless_told_not_to(copy, tmp_path, capsys):
    """The IMU's clock is 18 s off: readable, overlapping, and wrong."""
    edit_imu(copy, lambda rows: [shift(row, 18.0) for row in rows])
    out = tmp_path / "result"
    line = refuse(capsys, "run", copy, "--out", out)
    assert "18.0" in line and "leap seconds" in line
    assert not out.exists()


def test_declare_drafts_and_does_not_overwrite(tmp_path, capsys):
    table = tmp_path / "imu.csv"
    rows = np.column_stack(
        [np.arange(400) * 0.01, np.zeros((400, 3)), np.zeros((400, 2)), np.full(400, 9.81)]
    )
    np.savetxt(table, rows, delimiter=",", header="t,gx,gy,gz,ax,ay,az", comments="")
    out = tmp_path / "sequence.toml"
    assert main(["declare", str(table), "--out", str(out)]) == 0
    assert "blanks left" in capsys.readouterr().out
    assert "[imu]" in out.read_text()
    assert "exists already" in refuse(capsys, "declare", table, "--out", out)
    line = refuse(capsys, "run", tmp_path)
    assert "sequence.toml:" in line and "time_scale" in line


def test_datasets_lists_the_eight_sequences(capsys):
    assert main(["datasets"]) == 0
    printed = capsys.readouterr().out
    for name in ("campus-01", "campus-night", "suburb-02", "urban-02"):
        assert name in printed


def test_a_recording_among_the_results_stays_as_it_is(drive, tmp_path, capsys, monkeypatch):
    """Where `certnav demo` puts it; its result stands beside it."""
    monkeypatch.chdir(tmp_path)
    recording = Path(shutil.copytree(drive, tmp_path / "results" / drive.name))
    before = sorted(recording.rglob("*"))
    assert main(["run", f"results/{drive.name}", "--no-report"]) == 0
    assert f"results/{drive.name}-run" in capsys.readouterr().out
    assert read_result(tmp_path / "results" / f"{drive.name}-run").summary["name"]
    assert sorted(recording.rglob("*")) == before


def test_align_without_an_odometer_asks_for_nothing_that_needs_one(drive, tmp_path, capsys):
    assert main(["align", str(drive)]) == 0
    printed = capsys.readouterr().out
    assert "Doppler σ assumed" in printed and re.search(r"PASSED\n", printed)
    assert "needs an odometer" in refuse(capsys, "align", drive, "--noise", "fitted")
    assert "no odometer" in refuse(capsys, "align", drive, "--proof", tmp_path / "proofs.json")
    assert not (tmp_path / "proofs.json").exists()  # which certnav verify could not read


def test_simulate_and_refusal_to_overwrite(tmp_path, capsys):
    out = tmp_path / "drive"
    arguments = ["simulate", "--out", str(out), "--duration", "30", "--density", "open"]
    assert main(arguments) == 0
    assert "certnav run" in capsys.readouterr().out
    assert (out / "IMU" / "MEMS_imu_data.txt").is_file()
    assert "exists" in refuse(capsys, *arguments)
    assert main([*arguments, "--overwrite"]) == 0


def test_a_run_imports_nothing_slow_that_it_may_not_need():
    """Each of these takes longer to import than minutes of data to navigate."""
    code = (
        "import sys, certnav.nav.commands.flow.navigation, certnav.datasets.loading as load\n"
        "for kind in load.formats().values(): kind.detect, kind.read\n"
        "print(sorted(set(sys.modules) & {'pandas', 'filterpy', 'scipy.stats', 'scipy.special',"
        " 'scipy.spatial', 'scipy.interpolate', 'matplotlib', 'pyrtklib5', 'joblib', 'rich'}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "[]"


def test_every_command_is_a_module_of_one_pattern(capsys):
    folder = Path(cli.__file__).parent
    parsed = {f.stem for f in folder.glob("*.py") if "def add_arguments(" in f.read_text()}
    assert parsed == set(cli.COMMANDS)
    for name in cli.COMMANDS:
        with pytest.raises(SystemExit) as left:
            main([name, "--help"])
        assert left.value.code == 0
        said = " ".join(capsys.readouterr().out.split())
        module = importlib.import_module(f"certnav.nav.commands.{name}")
        assert module.DESCRIPTION.split(":")[0].split(".")[0] in said and callable(module.run)


def test_help_is_instant():
    """No numerical library may be imported for --help."""
    code = (
        "import sys; from certnav.nav.commands.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'numba', 'pandas', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "navigate a sequence" in done.stdout


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("comma2k19-example1", 1.0),
        ("rtklibexplorer-drive", 0.3),
        ("oakville-drives/urban-long-turn-loop-nominal-001", 1.5),
        ("instinct/spirent_dynamic", 0.6),
    ],
)
def test_real_recordings_run(name, limit, data_dir, tmp_path):
    """Real sets end in a result whose horizontal RMS is of the size the GNSS itself allows."""
    out = tmp_path / "result"
    assert main(["run", str(data_dir / name), "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["errors"]["horizontal_rms_m"] < limit
    velocity = summary["updates"]["velocity"]
    outside = ("before alignment", "after the IMU data")
    missed = sum(velocity["rejected"].get(reason, 0) for reason in outside)
    assert velocity["accepted"] > 0.8 * (velocity["offered"] - missed)


def test_a_run_measures_the_mounting_that_nobody_has_declared(drive, copy, tmp_path, capsys):
    sidecar = copy / "great.toml"
    kept = [line for line in sidecar.read_text().splitlines() if "_rpy" not in line]
    sidecar.write_text("\n".join(line for line in kept if "lever_vehicle" not in line))
    c, s = np.cos(np.radians(14.0)), np.sin(np.radians(14.0))

    def tilted(rows):
        for k in (1, 4):  # about the right axis; files are right, forward, up
            rows[:, k + 1 : k + 3] = rows[:, k + 1 : k + 3] @ np.array([[c, s], [-s, c]])
        return rows

    imu_rows(copy, tilted)
    command = ["run", str(copy), "--only", "pos", "--out"]
    assert main([*command, str(tmp_path / "car")]) == 0
    notes = (tmp_path / "car" / "summary.json").read_text()
    assert notes.count("mounting not declared: measured") == 1
    assert re.search("roll [-+][012]°, pitch -1[3-6]°, yaw", notes)  # a bias of 10 mg is 0.6°
    for more in (["--unchecked"], ["--set", "vehicle.kind=boat"]):
        assert main([*command, str(tmp_path / "other"), *more]) == 0
        notes = (tmp_path / "other" / "summary.json").read_text()
        assert "mounting not declared" not in notes


def test_unchecked_means_it_in_readers_too(copy, tmp_path, capsys):
    """Gravity 8 % off is refused by the reader, with the way out; then it is a doubtful note."""

    def scaled(rows):
        rows[:, 4:7] *= 1.08
        return rows

    imu_rows(copy, scaled)
    line = refuse(capsys, "run", copy, "--out", tmp_path / "out")
    assert "expected a mean of 9.8 m/s²" in line and line.endswith("--unchecked")
    assert main(["run", str(copy), "--out", str(tmp_path / "out"), "--unchecked"]) in (0, 2, 3)
    notes = read_result(tmp_path / "out").solution.notes
    assert any(n.doubtful and n.text.startswith("unchecked: ") for n in notes)


def test_unchecked_does_not_read_what_cannot_be_read(copy, tmp_path, capsys):
    def nan(rows):
        rows[100, 5] = np.nan
        return rows

    imu_rows(copy, nan)
    line = refuse(capsys, "run", copy, "--out", tmp_path / "out", "--unchecked")
    assert "expected a finite number" in line


def test_what_a_reader_refuses_against_the_course_is_not_asked_of_a_boat():
    """Its own test of the gyro steps aside; gravity is the same at sea."""
    gyro = Refusal(DataError("the gyro contradicts the course", remedy="check axes"), "course")
    gravity = Refusal(DataError("a mean of 9.8 m/s²", remedy="check units"), "gravity")
    car, boat = Config(), Config(vehicle=VehicleConfig(kind="boat"))
    with pytest.raises(DataError, match=r"check axes; if this is .* a boat.*--unchecked"):
        waived([gyro], car, checked=True)
    (note,) = waived([gyro], boat, checked=True)
    assert not note.doubtful and note.text.startswith("not asked of a boat")
    with pytest.raises(DataError, match=r"check units; to navigate .*--unchecked"):
        waived([gyro, gravity], boat, checked=True)
    assert [n.doubtful for n in waived([gyro, gravity], boat, checked=False)] == [False, True]
    assert all(n.doubtful for n in waived([gyro, gravity], car, checked=False))


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_each_command_has_an_example_that_its_parser_takes(name):
    module = importlib.import_module(f"certnav.nav.commands.{name}")
    for line in module.EXAMPLE.split(" && "):
        words = line.split()
        assert words[0] == "certnav"
        cli.parser().parse_args(words[1:])
    assert name in module.EXAMPLE.split()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["chek", "x"], "did you mean check?"),
        (["run", "x", "--smoth"], "did you mean --smooth?"),
        (["run", "x", "--figures", "pfd"], "did you mean pdf?"),
        (["datasets", "imprt"], "did you mean import?"),
        (["declare", "x", "--ouut", "y"], "did you mean --out?"),
    ],
)
def test_a_typo_is_answered_by_the_nearest_word(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(words)
    assert ended.value.code == 2
    out = capsys.readouterr()
    assert said in out.err and len(out.err.splitlines()) == 2


def test_a_bound_outside_the_recording_is_refused(drive, capsys):
    for bound in (["--start", "999999"], ["--end", "5"], ["--start", "600000", "--end", "1"]):
        assert cli.main(["run", str(drive), *bound]) == 1
        assert "expected a part of" in capsys.readouterr().err
