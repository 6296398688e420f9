"""Live and batch give the same answers; lateness and disorder are named."""

import dataclasses

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import ConfigError, DataError
from certnav.nav.config_files import from_tables
from certnav.nav.engine.gnss import gnss_timeline
from certnav.nav.navigator import Navigator
from certnav.nav.pipeline import navigate

CONFIG = from_tables({"filter": {"output_rate_hz": 10.0}})


@pytest.fixture(scope="module")
def drive():
    simulation = simulate(SimulationConfig(seed=6, duration=120.0, density="suburb"))
    calibration = simulation.calibration
    epochs = simulation.imu.time[0] + np.arange(0.5, 118.0) + 0.0033
    fixes = fixes_from_truth(
        simulation.trajectory, epochs, calibration.lever_antenna_b, 1.0, 0.1,
        np.random.default_rng(3),
    )  # fmt: skip
    return simulation.sequence(fixes=fixes)


@pytest.fixture(scope="module")
def moving():
    """In motion from the first sample on, with Doppler: certified."""
    simulation = simulate(SimulationConfig(
        seed=4, duration=40.0, density="open", static_start=0.0, moving_start=True,
    ))  # fmt: skip
    epochs = np.unique(simulation.observations.time)
    fixes = fixes_from_truth(
        simulation.trajectory, epochs, simulation.calibration.lever_antenna_b, 1.0, 0.1,
        np.random.default_rng(3),
    )  # fmt: skip
    return simulation.sequence(fixes=fixes)


def feed(drive, delay, config=CONFIG, **options):
    """Play a recorded drive into a navigator, GNSS arriving `delay` after its epoch."""
    events = list(gnss_timeline(drive, config.gnss).events)
    navigator = Navigator(drive.calibration, config, drive.imu.interval, **options)
    states = []
    for time, gyro, accel in zip(drive.imu.time, drive.imu.gyro_b, drive.imu.accel_b, strict=True):
        navigator.add_imu(time, gyro, accel)
        while events and events[0].time + delay <= time:
            navigator.add_gnss(events.pop(0))
        if navigator.state is not None and len(states) < 3000:
            states.append((time, navigator.state))
    for event in events:
        navigator.add_gnss(event)
    navigator.finish()
    return navigator, states


@pytest.mark.parametrize(
    ("name", "method", "delay"),
    [
        ("drive", "level+course", 0.0),
        ("drive", "level+course", 0.3),
        ("moving", "certified", 0.0),
        ("moving", "certified", 0.3),
    ],
)
def test_live_equals_batch(name, method, delay, request):
    drive = request.getfixturevalue(name)
    # What fits a recording is not known before its end.
    tables = {
        "filter": {"output_rate_hz": 10.0},
        "alignment": {"method": method},
        "gnss": {"position_noise": "declared", "velocity_noise": "declared"},
    }
    config = from_tables(tables)
    batch = navigate(drive, config)
    navigator, _ = feed(drive, delay, config)
    assert batch.alignment.method == method
    assert navigator.attempts == batch.alignment.attempts
    rows = navigator.rows
    at = np.searchsorted(rows[:, 0], batch.trajectory.time - 1e-6)
    assert len(batch.trajectory) > 300
    np.testing.assert_allclose(rows[at, 0], batch.trajectory.time, atol=1e-9)
    np.testing.assert_allclose(rows[at, 1:4], batch.trajectory.pos_e, rtol=0, atol=1e-8)
    np.testing.assert_allclose(rows[at, 4:7], batch.trajectory.vel_e, rtol=0, atol=1e-9)
    live = {(u.time, u.kind): u.accepted for u in navigator.updates}
    assert live == {(u.time, u.kind): u.accepted for u in batch.updates}


def test_live_finds_the_mounting_that_a_batch_finds(drive):
    unknown = dataclasses.replace(drive.calibration, mounting_source="")
    drive = dataclasses.replace(drive, calibration=unknown)
    # Live data are taken as declared.
    declared = dataclasses.replace(
        CONFIG.gnss, position_noise="declared", velocity_noise="declared"
    )
    batch = navigate(drive, dataclasses.replace(CONFIG, gnss=declared)).installation
    live = feed(drive, 0.3)[0].installation
    assert live.source == batch.source == "estimated"
    for name in ("C_bv", "mounting_cov", "wheel_v", "wheel_sigma"):
        np.testing.assert_allclose(getattr(live, name), getattr(batch, name), rtol=0, atol=1e-9)
    assert batch.pitch_yaw_sigma.max() < np.radians(2.0)  # 5° before


def test_state_is_carried_on_to_the_latest_sample(drive):
    _, states = feed(drive, 0.2)
    time, state = states[-1]
    assert state.time == pytest.approx(time, abs=1e-6)
    at = int(np.searchsorted(drive.reference.time, time))
    assert np.linalg.norm(state.pos_e - drive.reference.pos_e[at]) < 5.0


def test_before_alignment_it_says_why_it_waits(drive):
    navigator = Navigator(drive.calibration, CONFIG, drive.imu.interval)
    assert navigator.state is None and navigator.waiting == "no data yet"
    for k in range(1500):
        navigator.add_imu(drive.imu.time[k], drive.imu.gyro_b[k], drive.imu.accel_b[k])
    for event in gnss_timeline(drive, CONFIG.gnss).events[:20]:
        navigator.add_gnss(event)
    assert navigator.waiting == "not aligned: at rest, needs motion"


def test_late_gnss_is_logged_and_not_used(drive):
    navigator, _ = feed(drive, 1.6)  # latency is 0.5 s, and constraints come every second
    late = [u for u in navigator.updates if u.reason.startswith("late")]
    assert late and not any(u.accepted for u in late)


def test_disorder_is_refused(drive):
    navigator = Navigator(drive.calibration, CONFIG, 0.01)
    navigator.add_imu(10.0, np.zeros(3), np.zeros(3))
    with pytest.raises(DataError, match="goes backwards"):
        navigator.add_imu(9.99, np.zeros(3), np.zeros(3))
    with pytest.raises(DataError, match="six finite values"):
        navigator.add_imu(10.01, np.full(3, np.nan), np.zeros(3))


def test_a_short_history_changes_no_digit_and_does_not_grow(drive):
    whole, states = feed(drive, 0.3)
    short, again = feed(drive, 0.3, history=10.0)
    for (time, state), (_, other) in zip(states, again, strict=True):
        assert np.array_equal(state.pos_e, other.pos_e) and state.time == other.time, time
    end = drive.imu.time[-1]
    # What is let go of is let go of in halves, so that twice the history is the most there is.
    for held, all_of_it in ((short.rows[:, 0], whole.rows[:, 0]), (
        np.array([u.time for u in short.updates]), np.array([u.time for u in whole.updates])
    )):  # fmt: skip
        assert end - 21.0 < held[0] <= end - 9.0
        np.testing.assert_array_equal(held, all_of_it[-len(held) :])
    assert len(short._stream) * drive.imu.interval < 31.0 < drive.imu.time[-1] - drive.imu.time[0]


def test_a_history_that_is_too_short_is_refused(drive):
    with pytest.raises(ConfigError, match="history: expected 10 s or more, found 1"):
        Navigator(drive.calibration, CONFIG, 0.01, history=1.0)
