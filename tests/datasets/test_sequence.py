"""The types: labels follow their rows, a set without IMU is one, overlap is required."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.observations import GnssFixes, GnssObservations
from certnav.datasets.sequence import Calibration, Sequence
from certnav.datasets.series import Odometer
from certnav.filters.errors import DataError
from certnav.filters.sensors import imu_preset


def observations(n=4, **columns):
    nothing, text = np.full(n, np.nan), np.full(n, "")
    values = {
        "time": np.arange(n, dtype=float), "sat": np.full(n, "G01"), "signal": np.full(n, "1C"),
        "wavelength": np.full(n, 0.19), "pseudorange": nothing, "carrier": nothing,
        "range_rate": nothing, "cn0": nothing, "loss_of_lock": np.zeros(n, int),
        "sat_pos_e": np.full((n, 3), np.nan), "sat_vel_e": np.full((n, 3), np.nan),
        "sat_clock": nothing, "sat_clock_drift": nothing, "elevation": nothing,
        "azimuth": nothing, "rejected": text,
    }  # fmt: skip
    return GnssObservations(**{**values, **columns})


def fixes(time):
    n = len(time)
    return GnssFixes(
        time=time, pos_e=np.tile([6378137.0, 0, 0], (n, 1)), vel_e=np.zeros((n, 3)),
        pos_cov_e=np.tile(np.eye(3), (n, 1, 1)), vel_cov_e=np.tile(np.eye(3), (n, 1, 1)),
        satellites=np.full(n, -1), quality=np.full(n, "x"),
    )  # fmt: skip


CALIBRATION = Calibration(imu_preset("consumer"), np.zeros(3), "test")


def test_labels_are_empty_unless_given_and_follow_their_rows():
    plain = observations()
    assert list(plain.label) == [""] * 4
    labelled = observations(label=np.array(["los", "nlos", "", "los"]))
    assert list(labelled.take(slice(1, 3)).label) == ["nlos", ""]
    assert list(labelled.mark(np.array([True, False, False, False]), "x").label) == list(
        labelled.label
    )
    with pytest.raises(DataError, match=r"observations\.label: expected shape \(4,\)"):
        observations(label=np.array(["los"]))
    assert len(observations(0).label) == 0


def test_a_set_without_imu_overlaps_by_its_other_parts():
    s = Sequence("s", None, CALIBRATION, fixes=fixes(np.arange(5.0)),
                 odometer=Odometer(np.arange(3.0, 9.0), np.ones(6)))  # fmt: skip
    assert s.span == (0.0, 4.0)
    part = s.between(1.0, 3.5)
    assert part.span == (1.0, 3.0)
    assert part.odometer is None  # one row is no series
    with pytest.raises(DataError, match="no IMU data"):
        _ = s.inertial
    with pytest.raises(DataError, match=r"no time overlap: fixes 0\.0…4\.0 s, odometer 10\.0"):
        Sequence("s", None, CALIBRATION, fixes=fixes(np.arange(5.0)),
                 odometer=Odometer(np.arange(10.0, 12.0), np.ones(2)))  # fmt: skip
