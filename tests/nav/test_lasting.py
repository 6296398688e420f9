"""What all positions share for minutes stays in the solution's σ, however many there are."""

import numpy as np

from certnav.filters.earth import C_en_of, lla_to_ecef
from certnav.nav.engine.events import GnssEvent, missing
from certnav.nav.pipeline import with_lasting
from certnav.nav.solution import Trajectory

PLACE = lla_to_ecef(0.8, 0.2, 100.0)
C_EN = C_en_of(PLACE)


def trajectory(times):
    n = len(times)
    one = np.tile(np.eye(3), (n, 1, 1))
    zero = np.zeros((n, 3))
    return Trajectory(
        time=np.array(times), pos_e=np.tile(PLACE, (n, 1)), vel_e=zero, C_eb=one,
        gyro_bias=zero, accel_bias=zero, cov_pos_n=one, cov_vel_n=one, cov_att_n=one,
        std_gyro_bias=zero, std_accel_bias=zero,
    )  # fmt: skip


def position(time, lasting_n=None):
    lasting_e = None if lasting_n is None else C_EN @ np.diag(lasting_n) @ C_EN.T
    return GnssEvent(time, "position", PLACE, np.eye(3), shared=True, lasting_e=lasting_e)


def test_the_last_position_says_what_stays():
    events = [
        position(10.0, [4.0, 1.0, 9.0]), missing(15.0, "position", "no fix"),
        position(20.0, [25.0, 16.0, 36.0]), position(30.0),
    ]  # fmt: skip
    found = with_lasting(trajectory([5.0, 10.0, 19.0, 20.0, 35.0]), events).cov_pos_n
    expected = [[5, 2, 10]] * 3 + [[26, 17, 37], [1, 1, 1]]
    np.testing.assert_allclose(found, [np.diag(d) for d in expected], atol=1e-9)


def test_positions_whose_errors_are_their_own_leave_the_covariance_as_it_is():
    sound = trajectory([5.0])
    assert with_lasting(sound, [position(1.0)]) is sound
    assert with_lasting(sound, []) is sound
