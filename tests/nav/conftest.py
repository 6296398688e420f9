"""A made-up drive: analytic motion, a solution with drawn errors, and its log; a browser."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.datasets.observations import GnssFixes
from certnav.datasets.sequence import Calibration, Sequence
from certnav.datasets.series import ImuData, Reference
from certnav.filters.earth import OMEGA_IE_E, C_en_at, C_en_of, lla_to_ecef
from certnav.filters.rotation import matrix_from_rotvec, matrix_from_rpy, rpy_from_matrix
from certnav.filters.sensors import imu_preset
from certnav.nav.notes import plain
from certnav.nav.solution import AlignmentReport, Epochs, Solution, Trajectory, Update

START = 2201 * 604800.0 + 345600.0
ORIGIN = np.deg2rad([30.53, 114.36])


def _motion(t: np.ndarray) -> SimpleNamespace:
    """Return position, velocity, attitude of the IMU at `t` [s] since START."""
    a, b, w = 400.0, 250.0, 2 * np.pi / 150.0
    ned = np.stack([a * np.sin(w * t), b * np.sin(2 * w * t), -2.0 * np.cos(0.5 * w * t)], -1)
    vel = np.stack(
        [a * w * np.cos(w * t), 2 * b * w * np.cos(2 * w * t), w * np.sin(0.5 * w * t)], -1
    )
    rpy = np.stack(
        [
            0.03 * np.sin(0.7 * t),
            0.02 * np.cos(0.5 * t),
            np.unwrap(np.arctan2(vel[:, 1], vel[:, 0])),
        ],
        -1,
    )
    C_en = C_en_at(*ORIGIN)
    return SimpleNamespace(
        pos_e=lla_to_ecef(*ORIGIN, 30.0) + ned @ C_en.T,
        vel_e=vel @ C_en.T,
        C_eb=C_en @ matrix_from_rpy(rpy),
    )


def _imu(duration: float, rate: float) -> ImuData:
    dt = 1.0 / rate
    t = np.arange(-0.5, duration + 0.5 + dt / 2, dt)
    C_eb = _motion(t).C_eb
    turn = Rotation.from_matrix(np.swapaxes(C_eb[:-1], 1, 2) @ C_eb[1:]).as_rotvec() / dt
    gyro_b = turn + np.swapaxes(C_eb[1:], 1, 2) @ OMEGA_IE_E
    accel_b = np.tile([0.0, 0.0, -9.8], (len(gyro_b), 1))
    return ImuData(START + t[1:], gyro_b, accel_b)


def _epochs(duration: float, rng: np.random.Generator) -> Epochs:
    t = np.arange(0.0, duration + 0.5)
    usable = rng.integers(6, 11, t.size)
    usable[(t > 0.35 * duration) & (t < 0.45 * duration)] = 3
    usable[(t > 0.70 * duration) & (t < 0.75 * duration)] = 0
    return Epochs(START + t, usable + rng.integers(0, 4, t.size), usable)


def _updates(epochs: Epochs, fixes_only: bool, rng: np.random.Generator) -> tuple[Update, ...]:
    log = []
    for time, usable in zip(epochs.time, epochs.usable, strict=True):
        for kind, least in (("position", 4), ("velocity", 2)):
            if fixes_only and kind == "velocity":
                continue
            satellites = tuple(f"G{k:02d}" for k in range(1, int(usable) + 1))
            if usable < least:
                log.append(Update(time, kind, satellites, reason="too few satellites"))
                continue
            w = rng.standard_normal(3) * (5.0 if rng.random() < 0.01 else 1.0)
            nis = float(w @ w)
            passed = nis < 16.27
            log.append(
                Update(time, kind, satellites, tuple(w), nis, passed, "" if passed else "gate")
            )
    return tuple(log)


def _covariance(sigma: np.ndarray) -> np.ndarray:
    return np.square(sigma)[:, :, None] * np.eye(3)


def _drive(
    duration: float = 150.0,
    rate: float = 10.0,
    *,
    noise: float = 1.0,
    seed: int = 1,
    reference: bool = True,
    observations: bool = True,
    lever_b: tuple[float, float, float] = (0.0, 0.0, 0.0),
    attitude_frame: str = "b",
    C_bv: np.ndarray | None = None,
    reference_rate: float = 5.0,
) -> tuple[Solution, Sequence]:
    """Return a solution with errors of `noise` times its own sigma, and its sequence."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration + 0.5 / rate, 1.0 / rate)
    truth = _motion(t)
    n = t.size
    sawtooth = 1.0 + 0.3 * (t % 1.0)
    outage = 1.0 + 6.0 * np.clip((t - 0.70 * duration) / (0.05 * duration + 1e-9), 0, 1) * (
        t < 0.75 * duration
    )
    scale = (sawtooth * outage)[:, None]
    sigma_pos, sigma_vel = scale * [0.8, 0.8, 1.5], scale * [0.05, 0.05, 0.08]
    sigma_att = np.deg2rad(scale * [0.1, 0.1, 0.5])

    def wander() -> np.ndarray:
        """Smooth unit-variance wander, one column per axis."""
        phase, rates = rng.uniform(0, 2 * np.pi, (8, 3)), rng.uniform(0.02, 0.5, (8, 3))
        return np.sin(rates[None] * t[:, None, None] + phase[None]).sum(1) / 2.0

    C_en = C_en_of(truth.pos_e)
    phi_n = noise * wander() * sigma_att
    trajectory = Trajectory(
        time=START + t,
        pos_e=truth.pos_e + (C_en @ (noise * wander() * sigma_pos)[:, :, None])[:, :, 0],
        vel_e=truth.vel_e + (C_en @ (noise * wander() * sigma_vel)[:, :, None])[:, :, 0],
        C_eb=C_en @ matrix_from_rotvec(-phi_n) @ np.swapaxes(C_en, 1, 2) @ truth.C_eb,
        gyro_bias=np.zeros((n, 3)) + noise * 1e-4 * wander(),
        accel_bias=np.zeros((n, 3)) + noise * 2e-2 * wander(),
        cov_pos_n=_covariance(sigma_pos),
        cov_vel_n=_covariance(sigma_vel),
        cov_att_n=_covariance(sigma_att),
        std_gyro_bias=np.full((n, 3), 1e-4) * scale,
        std_accel_bias=np.full((n, 3), 2e-2) * scale,
    )
    epochs = _epochs(duration, rng)
    updates = _updates(epochs, not observations, rng)
    if not observations:
        epochs = Epochs(np.zeros(0), np.zeros(0, int), np.zeros(0, int))

    C_bv = np.eye(3) if C_bv is None else C_bv
    ref = None
    if reference:
        tr = np.arange(0.0, duration + 0.5 / reference_rate, 1.0 / reference_rate)
        ends = [_motion(tr + d) for d in (0.0, -1e-3, 1e-3)]
        point = [m.pos_e + m.C_eb @ np.array(lever_b) for m in ends]
        C_ref = ends[0].C_eb if attitude_frame == "b" else ends[0].C_eb @ C_bv
        ref = Reference(
            time=START + tr,
            pos_e=point[0],
            vel_e=(point[2] - point[1]) / 2e-3,
            rpy=rpy_from_matrix(np.swapaxes(C_en_of(ends[0].pos_e), 1, 2) @ C_ref),
            lever_b=np.array(lever_b),
            point="antenna" if any(lever_b) else "imu",
            source="analytic motion",
            attitude_frame=attitude_frame,
        )
    fixes = GnssFixes(
        START + np.array([0.0, max(duration, 1.0)]),
        truth.pos_e[[0, -1]],
        np.tile(np.eye(3), (2, 1, 1)),
        np.full((2, 3), np.nan),
        np.full((2, 3, 3), np.nan),
        np.array([-1, -1]),
        np.array(["single", "single"]),
    )
    sequence = Sequence(
        name="made-up",
        imu=_imu(duration, 100.0),
        calibration=Calibration(
            imu_preset("adis16470"), np.array([0.1, -0.2, -0.9]), "tape measure", 0.02, C_bv
        ),
        fixes=fixes,
        reference=ref,
        notes=("IMU axes <declared> right-front-up, converted",),
    )
    solution = Solution(
        name="made-up",
        trajectory=trajectory,
        updates=updates,
        alignment=AlignmentReport("aligned", "level+course", START, 12.5, np.deg2rad(1.2)),
        epochs=epochs,
        notes=plain(["velocity updates from 2 satellites on"]),
        timing={"total_s": 3.5, "read_s": 0.5, "filter_s": 2.5},
    )
    return solution, sequence


@pytest.fixture
def drive() -> Callable[..., tuple[Solution, Sequence]]:
    """Make a solution and its sequence; see `_drive` for the knobs."""
    return _drive


@pytest.fixture(scope="session")
def browser():
    """Chromium without a window."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no Chromium: pages are not looked at")
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright: pages unseen")
    with playwright.sync_playwright() as running:
        flags = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        launched = running.chromium.launch(executable_path=chromium, args=flags)
        yield launched
        launched.close()


@pytest.fixture
def look_at(browser) -> Iterator[Callable]:
    """Open a page at a width of so many pixels and wait until it is drawn.

    It fails the test if a page has an error on its console, asks anything of the network, or is
    wider than its window.
    """
    complaints: list[str] = []
    contexts = []

    def go(file: Path, width: int = 1400):
        context = browser.new_context(viewport={"width": width, "height": 900})
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request",
            lambda r: None if r.url.startswith(("file:", "data:", "blob:"))
            else complaints.append(f"asked {r.url}"),
        )  # fmt: skip
        page.goto(f"file://{file}")
        page.wait_for_selector("body[data-ready=yes]", timeout=60_000)
        wide = page.evaluate("() => document.documentElement.scrollWidth")
        if wide > width:
            complaints.append(f"{file.name} is {wide} px wide in a window of {width}")
        return page

    yield go
    for context in contexts:
        context.close()
    assert complaints == []


@pytest.fixture
def plots_of() -> Callable:
    """Return a function: alt text, width and height of every plot of an open page."""

    def found(page) -> list[tuple[str, float, float]]:
        return page.evaluate(
            "() => [...document.querySelectorAll('.plot')].map(p => [p.getAttribute('aria-label'),"
            " p.getBoundingClientRect().width, p.getBoundingClientRect().height])"
        )

    return found
