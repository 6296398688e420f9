"""Results of other programs come back as they were written, whatever their words and axes."""

from __future__ import annotations

import gzip
import re

import numpy as np
import pytest

from certnav.datasets.series import Reference
from certnav.datasets.solutions.reading import read_solution
from certnav.datasets.solutions.solution import ForeignSolution
from certnav.filters.earth import C_en_of
from certnav.filters.errors import ConfigError, DataError
from certnav.nav.results.formats import write_formats
from certnav.nav.results.tables import write_solution
from certnav.nav.solution import Epochs, Trajectory
from oracles.drives import WEEK, Drive, write_flt, write_pos
from oracles.solutions import SIGMA_ATT, SIGMA_POS, WRITE


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive.of(duration=12.0, imu_rate=25.0)


@pytest.fixture(scope="module")
def truth(drive) -> Reference:
    return drive.fixes


@pytest.mark.parametrize("form", WRITE)
def test_what_is_written_is_read(form, truth, tmp_path):
    name, write = WRITE[form]
    write(tmp_path / name, truth)
    found = read_solution(tmp_path / name, week=WEEK)
    np.testing.assert_allclose(found.time, truth.time, atol=1e-3)
    np.testing.assert_allclose(found.pos_e, truth.pos_e, atol=1e-3)
    turned = np.angle(np.exp(1j * (found.rpy - truth.rpy)))
    assert np.abs(turned).max() < np.radians(1e-4)
    if form != "tum":
        np.testing.assert_allclose(found.vel_e, truth.vel_e, atol=1e-4)
    assert found.point == "imu" and len(found.source.splitlines()) == 1


def test_gzipped_files_are_read_and_blamed_by_their_own_name(truth, tmp_path):
    name, write = WRITE["csv"]
    write(tmp_path / name, truth)
    text = (tmp_path / name).read_bytes()
    packed = tmp_path / "b.csv.gz"
    packed.write_bytes(gzip.compress(text))
    np.testing.assert_array_equal(read_solution(packed).pos_e, read_solution(tmp_path / name).pos_e)
    packed.write_bytes(gzip.compress(text.replace(b"\n", b"\nx", 3)))
    with pytest.raises(DataError, match=r"b\.csv\.gz:2: expected a number, found 'x"):
        read_solution(packed)


def test_sdy_of_a_position_is_not_the_sdy_of_yaw(truth, tmp_path):
    """GINav names two columns alike: the second σ of the position, and that of yaw."""
    name, write = WRITE["ginav"]
    write(tmp_path / name, truth)
    found = read_solution(tmp_path / name)
    C_en = C_en_of(found.pos_e)
    cov_e = C_en @ found.cov_pos_n @ np.swapaxes(C_en, 1, 2)
    np.testing.assert_allclose(cov_e, np.broadcast_to(np.diag(np.square(SIGMA_POS)), cov_e.shape),
                               atol=1e-9)  # fmt: skip
    roll, pitch, yaw = np.degrees(found.sigma_rpy[0])
    assert (pitch, roll, yaw) == pytest.approx(SIGMA_ATT)


def test_a_plain_pos_follows_the_antenna_and_states_no_attitude(drive, tmp_path):
    write_pos(tmp_path / "a.pos", drive, "llh")
    found = read_solution(tmp_path / "a.pos")
    assert found.point == "antenna" and np.isnan(found.rpy).all()
    assert np.isfinite(found.cov_pos_n).all()


def test_great_pvt_needs_a_week(drive, tmp_path):
    write_flt(tmp_path / "a.flt", drive)
    with pytest.raises(ConfigError, match="--week"):
        read_solution(tmp_path / "a.flt")
    found = read_solution(tmp_path / "a.flt", week=WEEK)
    np.testing.assert_allclose(found.pos_e, drive.fixes.pos_e, atol=1e-3)


def _trajectory(truth: Reference) -> Trajectory:
    n, nothing = truth.time.size, np.zeros((truth.time.size, 3))
    from certnav.filters.rotation import matrix_from_rpy

    cov = np.tile(np.diag([0.04, 0.09, 0.16]), (n, 1, 1))
    return Trajectory(
        truth.time, truth.pos_e, truth.vel_e, C_en_of(truth.pos_e) @ matrix_from_rpy(truth.rpy),
        nothing, nothing, cov, cov, 1e-4 * cov, nothing, nothing,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["solution.pos", "solution.tum", "solution.nav", "solution.csv"])
def test_what_certnav_writes_it_reads(name, truth, tmp_path):
    trajectory = _trajectory(truth)
    epochs = Epochs(np.zeros(0), np.zeros(0, dtype=int), np.zeros(0, dtype=int))
    write_formats(tmp_path, ("pos", "tum", "nav"), trajectory, epochs)
    write_solution(tmp_path / "solution.csv", trajectory)
    found = read_solution(tmp_path / name)
    np.testing.assert_allclose(found.pos_e, truth.pos_e, atol=2e-3)
    if name != "solution.pos":
        assert np.abs(np.angle(np.exp(1j * (found.rpy - truth.rpy)))).max() < 1e-5
    if name in ("solution.pos", "solution.csv"):
        np.testing.assert_allclose(found.cov_pos_n, trajectory.cov_pos_n, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(
    ("form", "change", "said"),
    [
        ("csv", lambda t: t.replace("lat_deg", "breite"), "not recognised"),
        ("csv", lambda t: t.replace("mood", "lat_deg"), "column 'lat_deg' is there twice"),
        ("csv", lambda t: "\n".join([*t.split("\n")[:3], t.split("\n")[1]]), "to increase"),
        ("csv", lambda t: t.replace("\n1", "\n1,1", 1), "header of 14 columns above a row of 15"),
        ("ginav", lambda t: t.rsplit(" ", 3)[0] + " x 0 0\n", "attitude: expected 9 numbers"),
        (
            "great_ins",
            lambda t: re.sub(r"(\n[\d.]+) \S+", r"\1 1", t, count=1),
            "the Earth's surface",
        ),
        ("tum", lambda t: re.sub(r"\S+\n$", "2.0\n", t), "quaternion: expected length 1"),
        ("tum", lambda t: "1 2 3 4 0 0 0 1\n2 2 3 4 0 0 0 1\n", "axes of the positions unknown"),
    ],
)
def test_damage_is_named_in_one_line(form, change, said, truth, tmp_path):
    name, write = WRITE[form]
    write(tmp_path / name, truth)
    (tmp_path / name).write_text(change((tmp_path / name).read_text()))
    with pytest.raises(DataError, match=said) as caught:
        read_solution(tmp_path / name, week=WEEK)
    assert len(str(caught.value).splitlines()) == 1


def test_what_is_nobodys_is_not_recognised(tmp_path):
    (tmp_path / "a.pos").write_text("hello\n")
    with pytest.raises(DataError, match="not recognised"):
        read_solution(tmp_path / "a.pos")
    with pytest.raises(DataError, match="not found"):
        read_solution(tmp_path / "b.pos")


def test_a_point_is_one_of_two():
    with pytest.raises(DataError, match="imu"):
        ForeignSolution("x", [0.0, 1.0], np.full((2, 3), 6.4e6), point="roof")
