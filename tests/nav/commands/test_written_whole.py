"""Every command that writes a directory: what fails on the way leaves the earlier one as it was."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from certnav.datasets import placing
from certnav.datasets.great import writer
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.nav.commands import compare as compare_command
from certnav.nav.compare import comparison
from certnav.nav.compare import report as compare_report
from certnav.nav.compare.runs import Comparison, Run
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.results import directory
from certnav.nav.tune import report as tune_report
from certnav.nav.tune.score import Score, pareto_front
from certnav.nav.tune.tuning import Tuning
from certnav.velocity.screening import Screening


@pytest.fixture
def run(drive):
    solution, sequence = drive(duration=10.0)
    evaluation = evaluate(solution, sequence)
    return lambda out: directory.write_result(out, solution, evaluation, sequence, "")


@pytest.fixture
def compare(monkeypatch):
    """The command with the runs left out; one method's directory is there."""

    def compared(*_, out: Path, **__) -> Comparison:
        (out / "lc4").mkdir()
        (out / "lc4" / "summary.json").write_text("{}")
        return Comparison((Run("lc4", "drive", "@0", reason="not tried"),), {}, "60/180")

    monkeypatch.setattr(comparison, "compare", compared)
    parser = argparse.ArgumentParser()
    compare_command.add_arguments(parser)
    return lambda out: compare_command.run(parser.parse_args(["drive", "--out", str(out)]))


@pytest.fixture
def tune():
    score = Score(np.ones((2, 2)), np.ones((2, 2)), np.ones((2, 2)), 1)
    tuning = Tuning(
        np.array([30.0, 40.0]), np.array([0.1, 0.2]), score, {"drive": score},
        Screening(30.0, min_k=0.1), "the error decided", None, pareto_front(score), (),
        "time blocks", 1.0, 1.0, 0.4, {}, {},
    )  # fmt: skip
    return lambda out: tune_report.write_tuning(tuning, out)


@pytest.fixture
def simulate():
    config = SimulationConfig(seed=1, duration=10.0, density="open", imu_rate=10.0)
    return lambda out: writer.simulate_folder(config, out, overwrite=True)


#: Each command, and the last thing it does before its directory is put in place.
LAST = {
    "run": (directory, "write_formats"),
    "compare": (compare_report, "build_page"),
    "tune": (tune_report, "_page"),
    "simulate": (writer, "_sidecar"),
}


def everything(folder: Path) -> dict[str, tuple[float, bytes]]:
    """Return time and content of all files below a folder."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(f.relative_to(folder)): (f.stat().st_mtime, f.read_bytes()) for f in files}


@pytest.mark.parametrize("moment", ["writing", "moving"])
@pytest.mark.parametrize("command", LAST)
def test_a_failure_leaves_the_earlier_directory_whole(
    command, moment, request, tmp_path, monkeypatch
):
    write = request.getfixturevalue(command)
    out = tmp_path / command
    write(out)
    before = everything(tmp_path)
    assert before

    def fails(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(*(LAST[command] if moment == "writing" else (placing, "exchange")), fails)
        write(out)
    assert everything(tmp_path) == before
    write(out)
    assert everything(tmp_path) != before
    assert [path.name for path in tmp_path.iterdir()] == [command]


@pytest.mark.parametrize(
    "command", ["allan", "declare", "align", "flow/navigation", "verify", "tune"]
)
def test_no_command_writes_a_file_piece_by_piece(command):
    """Killed on the way, it would leave half of it: files go through `placing.write_file`."""
    source = (Path(directory.__file__).parents[1] / "commands" / f"{command}.py").read_text()
    assert "write_text(" not in source and "write_bytes(" not in source
