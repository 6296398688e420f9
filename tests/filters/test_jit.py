"""Compiled and plain kernels: the same numbers, and a word to the user about which it is."""

import os
import subprocess
import sys

import numpy as np

from certnav.filters.compiled import jit, kernels
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState


def final() -> np.ndarray:
    """State and covariance after 60 samples of turning motion, 21 states, in one vector."""
    time = np.arange(1, 61) / 100.0
    gyro_b = np.column_stack([0.3 * np.sin(9.0 * time), 0.2 * np.cos(7.0 * time), 0.5 + time])
    accel_b = np.column_stack([np.sin(time), np.cos(3.0 * time), -9.8 + 0.0 * time])
    model = ErrorModel(imu_preset("adis16470"), 21, "gauss-markov")
    P = model.initial_covariance(np.eye(3), 0.01 * np.eye(3), 1e-4 * np.eye(3))
    state = NavState(0.005, [6378137.0, 10.0, 20.0], [1.0, 12.0, -3.0], np.eye(3))
    kalman = ErrorStateFilter(model, InertialStream(time, gyro_b, accel_b), state, P)
    kalman.propagate(0.597)
    return np.concatenate([kalman.pos_e, kalman.vel_e, kalman.C_eb.ravel(), kalman.P.ravel()])


def test_without_numba_the_numbers_are_the_same(tmp_path):
    file = tmp_path / "plain.npy"
    code = (
        "import importlib.util, sys, numpy as np\n"
        f"spec = importlib.util.spec_from_file_location('run', {__file__!r})\n"
        "run = importlib.util.module_from_spec(spec)\n"
        "spec.loader.exec_module(run)\n"
        f"np.save({str(file)!r}, run.final())\n"
        "assert 'numba' not in sys.modules\n"
        "from certnav.filters.compiled import jit, kernels\n"
        "print(jit.notice(kernels.advance))\n"
    )
    environment = {**os.environ, "CERTNAV_NO_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "without numba" in done.stdout
    assert len(done.stdout.splitlines()) == 1
    np.testing.assert_allclose(np.load(file), final(), rtol=1e-12, atol=1e-18)


def test_a_cold_cache_is_announced_and_a_warm_one_is_not(tmp_path):
    code = (
        "from certnav.filters.compiled import jit\n"
        "from certnav.filters.compiled.jit import njit\n"
        "import one\n"
        "print(repr(jit.notice(one.double)))\n"
        "one.double(1.0)\n"
        "print(repr(jit.notice(one.double)))\n"
    )
    (tmp_path / "one.py").write_text(
        "from certnav.filters.compiled.jit import njit\n\n\n@njit(cache=True)\n"
        "def double(x):\n    return 2.0 * x\n"
    )
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path),
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "CERTNAV_NO_JIT": "",
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    cold, warm = done.stdout.splitlines()
    assert "compiling" in cold
    assert warm == "''"


def test_kernels_are_compiled_here():
    assert jit.COMPILED
    assert hasattr(kernels.advance, "py_func")
