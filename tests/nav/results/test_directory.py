"""The result directory: complete or absent, refusing strangers, and read back as it was."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from certnav.datasets.placing import SEAL, broken_seals
from certnav.filters.errors import ConfigError, DataError
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.notes import plain
from certnav.nav.report.figures import satellites
from certnav.nav.report.panels import gnss_state
from certnav.nav.results.directory import is_result, read_result, write_result
from certnav.nav.results.summary import count_updates, strict
from certnav.nav.solution import Epochs, Update

CONFIG = 'name = "made-up"\n[gate]\nposition = 16.27\n'


def test_what_a_certified_start_knows_comes_back(drive, tmp_path):
    solution, sequence = drive()
    attempts = ((1331510405.0, "not aligned: no heading, needs a turn"), (1331510406.0, "±1.2°"))
    verdicts = (("optimal", 'proved, "gap" 1e-13'), ("bounded", "attitude within 4°"))
    alignment = dataclasses.replace(
        solution.alignment, bound=np.deg2rad(4.0), verdicts=verdicts, attempts=attempts
    )
    solution = dataclasses.replace(solution, alignment=alignment)
    evaluation = evaluate(solution, sequence)
    out = write_result(tmp_path / "run", solution, evaluation, sequence, CONFIG)
    back = read_result(out).solution.alignment
    assert (back.verdicts, back.attempts) == (verdicts, attempts)
    assert back.bound == pytest.approx(np.deg2rad(4.0))
    assert json.loads((out / "summary.json").read_text())["alignment"]["bound_deg"] == 4.0


@pytest.fixture
def written(drive, tmp_path):
    solution, sequence = drive(lever_b=(1.0, 0.2, -0.8))
    evaluation = evaluate(solution, sequence)
    out = write_result(tmp_path / "run", solution, evaluation, sequence, CONFIG, ("nav",))
    return out, solution, evaluation, sequence


def test_everything_comes_back(written):
    out, solution, evaluation, _ = written
    result = read_result(out)
    track, back = solution.trajectory, result.solution.trajectory
    tolerance = {
        "time": 1e-6, "pos_e": 6e-5, "vel_e": 1e-5, "C_eb": 2e-8, "gyro_bias": 3e-10,
        "accel_bias": 1e-7,
    }  # fmt: skip
    for name, atol in tolerance.items():
        np.testing.assert_allclose(getattr(back, name), getattr(track, name), 0, atol, err_msg=name)
    # The made-up covariances are diagonal, standard deviations have five digits.
    for name in ("cov_pos_n", "cov_vel_n", "std_gyro_bias", "std_accel_bias"):
        np.testing.assert_allclose(getattr(back, name), getattr(track, name), 2e-4, err_msg=name)
    assert len(result.solution.updates) == len(solution.updates)
    for u, v in zip(solution.updates, result.solution.updates, strict=True):
        assert (u.kind, u.satellites, u.accepted, u.reason) == (
            v.kind, v.satellites, v.accepted, v.reason,
        )  # fmt: skip
        np.testing.assert_allclose(v.whitened, u.whitened, atol=1e-5)
        np.testing.assert_allclose([v.time, v.nis], [u.time, u.nis], rtol=1e-5)
    for name in ("time", "tracked", "usable"):
        np.testing.assert_allclose(
            getattr(result.solution.epochs, name), getattr(solution.epochs, name)
        )
    back, report = (dataclasses.asdict(s.alignment) for s in (result.solution, solution))
    for name in ("verdicts", "attempts"):
        assert back.pop(name) == report.pop(name)
    assert back == pytest.approx(report)
    assert result.evaluation.metrics == evaluation.metrics
    for name in ("error_pos_n", "error_vel_n", "error_rpy", "error_rpy_aligned", "ref_lla"):
        np.testing.assert_allclose(
            getattr(result.evaluation, name), getattr(evaluation, name), atol=1e-4, err_msg=name
        )
    np.testing.assert_allclose(result.evaluation.sigma_rpy, evaluation.sigma_rpy, rtol=1e-4)
    np.testing.assert_allclose(result.evaluation.nees_position, evaluation.nees_position, rtol=1e-4)
    assert result.config_text == CONFIG and result.name == "made-up"
    assert result.solution.timing == solution.timing


def test_standard_deviations_survive_a_tilted_attitude(drive, tmp_path):
    """The written roll, pitch, heading σ are those read back, whatever the correlations were."""
    solution, sequence = drive(duration=5.0, reference=False)
    A = np.random.default_rng(2).normal(size=(3, 3)) * 1e-2
    solution.trajectory.cov_att_n[:] = A @ A.T
    evaluation = evaluate(solution, sequence)
    out = write_result(tmp_path / "a", solution, evaluation, sequence, "")
    again = write_result(tmp_path / "b", read_result(out).solution, evaluation, sequence, "")
    tables = [np.loadtxt(d / "solution.csv", delimiter=",", skiprows=1) for d in (out, again)]
    np.testing.assert_allclose(tables[1][:, 15:24], tables[0][:, 15:24], rtol=2e-5)


def test_summary_has_its_keys_and_is_strict(written):
    out, solution, _, sequence = written
    summary = json.loads((out / "summary.json").read_text(), parse_constant=pytest.fail)
    wanted = (
        "name status certnav_version duration_s imu_samples epochs alignment installation errors "
        "reference consistency position_noise rtk protection separation updates timing sensors "
        "notes"
    )
    assert list(summary) == wanted.split()
    usable = solution.epochs.usable
    assert summary["epochs"] == {
        "total": usable.size,
        "ge4": int((usable >= 4).sum()),
        "two_or_three": int(((usable == 2) | (usable == 3)).sum()),
        "lt2": int((usable < 2).sum()),
    }
    assert sum(summary["epochs"].values()) == 2 * usable.size
    assert summary["duration_s"] == pytest.approx(150.0)
    assert summary["imu_samples"] == len(sequence.imu)
    assert summary["alignment"]["sigma_heading_deg"] == pytest.approx(1.2)
    assert summary["notes"] == [
        {"severity": n.severity, "text": n.text} for n in [*plain(sequence.notes), *solution.notes]
    ]
    for counts in summary["updates"].values():
        assert counts["offered"] == counts["accepted"] + sum(counts["rejected"].values())


def test_satellites_that_fixes_do_not_count_are_unknown_not_missing(drive, tmp_path):
    solution, sequence = drive(duration=20.0, observations=False)
    time = np.array([u.time for u in solution.updates])
    unknown = Epochs(time, np.full(time.size, -1), np.full(time.size, -1))
    solution = dataclasses.replace(solution, epochs=unknown)
    evaluation = evaluate(solution, sequence)
    result = read_result(write_result(tmp_path / "x", solution, evaluation, sequence, CONFIG))
    assert set(result.summary["epochs"].values()) == {0}
    assert satellites(result) is None
    assert (gnss_state(result) == 0).mean() > 0.9


def test_without_reference_errors_are_null_and_there_is_no_error_table(drive, tmp_path):
    solution, sequence = drive(duration=20.0, reference=False, observations=False)
    out = write_result(tmp_path / "x", solution, evaluate(solution, sequence), sequence, CONFIG)
    assert not (out / "reference_errors.csv").exists()
    result = read_result(out)
    assert set(result.summary["errors"].values()) == {None}
    assert result.summary["reference"] is None and not result.evaluation.has_reference
    assert result.solution.epochs.time.size == 0 and result.summary["epochs"]["total"] == 0
    assert result.evaluation.consistency["nis_mean"] == result.summary["consistency"]["nis_mean"]


def test_a_result_is_replaced_whole(written):
    out, solution, evaluation, sequence = written
    assert (out / "solution.nav").exists()
    write_result(out, solution, evaluation, sequence, "name = 'second'\n")
    assert not (out / "solution.nav").exists()
    assert read_result(out).config_text == "name = 'second'\n"
    assert [p.name for p in out.parent.iterdir()] == ["run"]


def test_nothing_but_a_result_is_replaced(written, tmp_path):
    _, *rest = written
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter1.tex").write_text("precious")
    with pytest.raises(DataError, match=r"thesis: exists and is not a certnav result directory"):
        write_result(folder, *rest, CONFIG)
    assert (folder / "chapter1.tex").read_text() == "precious"
    (folder / "summary.json").write_text('{"name": "somebody else\'s"}')
    with pytest.raises(DataError, match="not a certnav result"):
        write_result(folder, *rest, CONFIG)
    with pytest.raises(DataError, match="not a certnav result"):
        write_result(folder / "chapter1.tex", *rest, CONFIG)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert is_result(write_result(empty, *rest, CONFIG))


def test_a_failure_leaves_the_earlier_result_and_no_debris(written):
    out, *rest = written

    def fail(directory):
        assert (directory / "summary.json").exists()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_result(out, *rest, "name = 'half'\n", draw=fail)
    assert read_result(out).config_text == CONFIG
    assert [p.name for p in out.parent.iterdir()] == ["run"]


def test_what_is_drawn_into_a_result_is_sealed_with_it(drive, tmp_path):
    solution, sequence = drive(duration=20.0)
    out = write_result(
        tmp_path / "run", solution, evaluate(solution, sequence), sequence, CONFIG,
        draw=lambda draft: (draft / "page.html").write_text("<p>"),
    )  # fmt: skip
    assert "page.html" in (out / SEAL).read_text() and broken_seals(out) == []


def test_unknown_format_is_refused_before_anything_is_written(written, tmp_path):
    _, *rest = written
    with pytest.raises(ConfigError, match="did you mean 'tum'"):
        write_result(tmp_path / "new", *rest, CONFIG, ("tun",))
    assert not (tmp_path / "new").exists()


def test_reading_what_is_not_a_result(written, tmp_path):
    out, *_ = written
    with pytest.raises(DataError, match="not a certnav result directory"):
        read_result(tmp_path)
    table = out / "solution.csv"
    text = table.read_text()
    table.write_text(text.replace("lat_deg", "latitude", 1))
    with pytest.raises(DataError, match=r"solution.csv: expected column 'lat_deg', not found"):
        read_result(out)
    table.write_text(text.replace("0.8,", "zero,", 1))
    with pytest.raises(DataError, match=r"solution.csv: not a table certnav wrote"):
        read_result(out)
    table.unlink()
    with pytest.raises(DataError, match=r"solution.csv: missing"):
        read_result(out)


def test_a_damaged_update_names_its_line(written):
    out, *_ = written
    lines = (out / "updates.csv").read_text().splitlines()
    lines[6] = lines[6].replace(",3,1,", ",three,1,")
    (out / "updates.csv").write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"updates.csv:7: not a line certnav wrote"):
        read_result(out)


def test_summary_of_another_version(written):
    out, *_ = written
    summary = json.loads((out / "summary.json").read_text())
    del summary["alignment"]
    (out / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(DataError, match=r"summary.json: expected key 'alignment'"):
        read_result(out)


def test_count_updates():
    updates = [
        Update(0.0, "position", accepted=True),
        Update(1.0, "position", reason="gate, outer"),
        Update(2.0, "position", reason="gate, outer"),
        Update(3.0, "velocity", reason="few"),
        Update(4.0, "velocity", accepted=True, reason="covariance enlarged"),
    ]
    assert count_updates(updates) == {
        "position": {"offered": 3, "accepted": 1, "rejected": {"gate, outer": 2}},
        "velocity": {
            "offered": 2,
            "accepted": 1,
            "rejected": {"few": 1},
            "accepted_although": {"covariance enlarged": 1},
        },
    }


def test_strict_has_no_nan_and_no_numpy():
    value = {"a": np.float64("nan"), "b": np.array([1.0, np.inf]), "c": (np.int64(3), True)}
    assert strict(value) == {"a": None, "b": [1.0, None], "c": [3, True]}
    json.dumps(strict(value), allow_nan=False)
