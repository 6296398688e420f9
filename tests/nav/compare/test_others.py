"""Others' results are judged at exactly what they are off by, and by the σ they state."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.series import Reference
from certnav.datasets.solutions.solution import ForeignSolution
from certnav.filters.earth import C_en_of
from certnav.filters.errors import ConfigError, DataError
from certnav.filters.rotation import matrix_from_rpy
from certnav.nav.compare.others import Judge, Other, judged, read_others, side_by_side
from certnav.nav.compare.report import build_page
from oracles.drives import Drive
from oracles.solutions import WRITE

LEVER = np.array([0.3, -0.2, -1.1])


@pytest.fixture(scope="module")
def truth() -> Reference:
    return Drive.of(duration=60.0, imu_rate=25.0).fixes


@pytest.fixture(scope="module")
def judge(truth) -> Judge:
    reference = dataclasses.replace(truth, lever_b=np.zeros(3), point="imu")
    return Judge("drive", reference, np.eye(3), LEVER)


def _same_as(truth: Reference, **parts) -> ForeignSolution:
    given = {"vel_e": truth.vel_e, "rpy": truth.rpy, **parts}
    return ForeignSolution("theirs", truth.time, **({"pos_e": truth.pos_e} | given))


def test_a_solution_off_by_a_known_offset_is_judged_at_exactly_that(truth, judge):
    off_n, turn = np.array([3.0, -4.0, 1.2]), np.array([0.0, 0.0, np.radians(2.0)])
    pos_e = truth.pos_e + np.einsum("nij,j->ni", C_en_of(truth.pos_e), off_n)
    run = judged(Other("a", _same_as(truth, pos_e=pos_e, rpy=truth.rpy + turn)), judge)
    assert run.metrics["horizontal_rms_m"] == pytest.approx(5.0, abs=1e-5)
    assert run.metrics["up_rms_m"] == pytest.approx(1.2, abs=1e-5)
    assert run.metrics["position_3d_rms_m"] == pytest.approx(np.sqrt(25.0 + 1.44), abs=1e-5)
    assert run.metrics["velocity_3d_rms_mps"] == pytest.approx(0.0, abs=1e-9)
    assert run.metrics["heading_rms_deg"] == pytest.approx(2.0, abs=1e-4)


def test_errors_of_the_stated_size_have_the_ideal_nees(truth, judge):
    """White errors of exactly the σ that is stated: 3, 3 and 1, within 3σ of their means."""
    rng = np.random.default_rng(5)
    n = truth.time.size
    sigma = np.array([0.5, 1.0, 2.0])
    C_en = C_en_of(truth.pos_e)
    cov = np.tile(np.diag(sigma**2), (n, 1, 1))
    off, slow, turn = (rng.standard_normal((n, 3)) for _ in range(3))
    solution = _same_as(
        truth, pos_e=truth.pos_e + np.einsum("nij,nj->ni", C_en, off * sigma),
        vel_e=truth.vel_e + np.einsum("nij,nj->ni", C_en, slow * 0.1), cov_pos_n=cov,
        cov_vel_n=np.tile(np.eye(3) * 0.01, (n, 1, 1)),
        rpy=truth.rpy + turn * np.radians([0.01, 0.01, 1.0]),
        sigma_rpy=np.tile(np.radians([0.01, 0.01, 1.0]), (n, 1)),
    )  # fmt: skip
    c = judged(Other("a", solution), judge).consistency
    assert c["nees_out"] == pytest.approx(3.0, abs=3.0 * np.sqrt(6.0 / n))
    assert c["nees_velocity"] == pytest.approx(3.0, abs=3.0 * np.sqrt(6.0 / n))
    assert c["nees_heading"] == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / n))
    believed = dataclasses.replace(solution, cov_pos_n=cov / 4.0)
    assert judged(Other("a", believed), judge).consistency["nees_out"] > 10.0


def test_what_is_not_stated_is_not_judged(truth, judge):
    run = judged(Other("a", ForeignSolution("theirs", truth.time, truth.pos_e)), judge)
    assert run.metrics["horizontal_rms_m"] == pytest.approx(0.0, abs=1e-6)
    assert run.metrics["heading_rms_deg"] is None and run.metrics["velocity_3d_rms_mps"] is None
    assert all(run.consistency[k] is None for k in ("nees_out", "nees_velocity", "nees_heading"))


@pytest.mark.parametrize("states_attitude", [True, False])
def test_a_solution_of_the_antenna_is_judged_at_the_imu(truth, judge, states_attitude):
    C_eb = C_en_of(truth.pos_e) @ matrix_from_rpy(truth.rpy)
    rpy = truth.rpy if states_attitude else np.full_like(truth.rpy, np.nan)
    solution = _same_as(truth, pos_e=truth.pos_e + C_eb @ LEVER, rpy=rpy)
    at_imu = judged(Other("a", dataclasses.replace(solution, point="antenna")), judge)
    assert at_imu.metrics["position_3d_rms_m"] == pytest.approx(0.0, abs=1e-6)
    left = judged(Other("a", solution), judge).metrics["position_3d_rms_m"]
    assert left == pytest.approx(np.linalg.norm(LEVER), abs=1e-6)


def test_what_settles_is_not_judged(truth, judge):
    pos_e = truth.pos_e.copy()
    pos_e[truth.time < truth.time[0] + 20.0] += 100.0
    other = Other("a", _same_as(truth, pos_e=pos_e))
    assert judged(other, judge).metrics["position_3d_rms_m"] > 50.0
    assert judged(other, judge, 20.0).metrics["position_3d_rms_m"] == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(DataError, match="nothing is left"):
        judged(other, judge, 1000.0)


def test_names_and_points_are_given_with_the_file(truth, tmp_path):
    name, write = WRITE["csv"]
    write(tmp_path / name, truth)
    (other,) = read_others([f"mine={tmp_path / name}@antenna"])
    assert other.name == "mine" and other.solution.point == "antenna"
    for text in ("no-file", f"a={tmp_path / name}@roof", "=x"):
        with pytest.raises(ConfigError, match="--result"):
            read_others([text])
    with pytest.raises(ConfigError, match="twice"):
        read_others([f"a={tmp_path / name}"] * 2)


def test_the_page_says_whose_results_they_are(truth, judge):
    page = build_page(side_by_side([Other("theirs", _same_as(truth))], judge))
    assert "theirs, of the IMU, states velocity, attitude; not degraded in spells." in page


@pytest.mark.parametrize(
    ("file", "position", "yaw"),
    [
        ("PPK_LC", 0.051, 0.32),
        ("PPP_LC", 0.35, None),
        ("SPP_LC", 3.57, 0.80),
        ("SPP_TC", 3.31, 0.28),
    ],
)
def test_ginav_on_a_car_is_judged_as_others_have_found(file, position, yaw, data_dir):
    """Independently computed when the set was chosen."""
    folder = data_dir / "ginav-cpt"
    judge = Judge.from_file(folder / "cpt_pva_ref.mat")
    (other,) = read_others([f"theirs={folder / f'cpt0870_{file}.pos.gz'}"])
    metrics = judged(other, judge, 60.0).metrics
    assert metrics["position_3d_rms_m"] == pytest.approx(position, rel=0.01)
    if yaw is not None:
        assert metrics["heading_rms_deg"] == pytest.approx(yaw, abs=0.005)
