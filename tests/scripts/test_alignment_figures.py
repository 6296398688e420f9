"""The figure scripts run small, and their numbers have the paper's shape."""

from __future__ import annotations

import json

import pytest


@pytest.fixture(scope="module")
def figures(script):
    return script("alignment_figures")


@pytest.mark.parametrize("figure", [3, 4])
def test_certified_rates(figures, figure, capsys, tmp_path):
    picture = tmp_path / "figure.png"
    arguments = ["--figure", str(figure), "--runs", "6", "--json", "--out", str(picture)]
    assert figures.main(arguments) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["figure"] == figure
    assert picture.stat().st_size > 10_000
    rate = {(row["satellites"], row["constraints"]): row["certified"] for row in data["rows"]}
    assert set(rate) == {(n, c) for n in range(1, 9) for c in ("none", "orthogonal", "all")}
    assert all(rate[n, "all"] == 1.0 for n in range(4, 9))
    if figure == 3:  # planar: nothing without handedness
        assert all(rate[n, c] == 0.0 for n in range(1, 9) for c in ("none", "orthogonal"))
    else:
        assert rate[1, "none"] == 0.0
        assert rate[8, "none"] == 1.0
    for row in data["rows"]:
        if row["constraints"] == "all" and row["observable"]:
            assert row["relative_gap_max"] < 1e-11
            assert row["error_deg_max_where_observable"] < 1e-6


@pytest.mark.parametrize("figure", [5, 6])
def test_errors_against_noise(figures, figure, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(figures, "NOISE", (0.02, 0.2))
    picture = tmp_path / "figure.png"
    arguments = ["--figure", str(figure), "--runs", "8", "--json", "--out", str(picture)]
    assert figures.main(arguments) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert picture.stat().st_size > 10_000
    median = {(r["satellites"], r["sigma_mps"], r["method"]): r["median_deg"] for r in rows}
    assert median[8, 0.2, "sdp"] == pytest.approx(10.0 * median[8, 0.02, "sdp"], rel=0.1)
    assert median[8, 0.2, "sdp"] < median[8, 0.2, "voba"]
    assert median[min(r["satellites"] for r in rows), 0.2, "voba"] is None


def test_basins_and_table(figures, capsys, tmp_path):
    picture = tmp_path / "figure.png"
    assert figures.main(["--figure", "7", "--runs", "30", "--out", str(picture)]) == 0
    header, *lines = capsys.readouterr().out.splitlines()
    assert header.split()[:3] == ["azimuth_deg", "elevation_deg", "error_deg"]
    assert len(lines) == 30
    assert picture.stat().st_size > 10_000
    data = figures.compute(7, 30, 1)
    assert data["sdp_status"] == "CERTIFIED"
    assert data["windows_with_local_minima"] > 0
    assert all(row["cost"] >= data["sdp_cost"] - 1e-9 for row in data["rows"])


def test_same_seed_same_numbers(figures):
    assert figures.compute(4, 2, 3) == figures.compute(4, 2, 3)


def test_no_runs_are_refused(figures, capsys):
    with pytest.raises(SystemExit):
        figures.main(["--figure", "3", "--runs", "0"])
    assert "--runs: expected at least 1, found 0" in capsys.readouterr().err


def test_benchmark_measures_both_solvers(script, capsys):
    pytest.importorskip("cvxpy")
    assert script("alignment_sdp_benchmark").main(["--runs", "3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["cost_difference_max"] < 1e-8
    assert min(result["clarabel_ms_median"], result["cvxpy_ms_median"]) > 0.0
