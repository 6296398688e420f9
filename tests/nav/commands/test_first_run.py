"""Kernels compiled ahead of the first run: all that a run calls, whoever does it."""

import importlib
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.nav.commands.cli import main
from certnav.nav.commands.flow import first_run

SMALL = ["filters.compiled.rows", "nav._frames"]


def in_a_process(code: str, cache: Path) -> subprocess.CompletedProcess[str]:
    """Run Python code with an empty cache of numba's."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "CERTNAV_NO_JIT": ""}
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )


def test_a_run_compiles_no_further_signature(tmp_path):
    """A kernel of two signatures is compiled twice; one not listed, by this process alone."""
    config = SimulationConfig(seed=2, duration=200.0, density="suburb")
    drive = simulate_folder(config, tmp_path / "drive")
    first_run.compile_kernels(list(first_run.KERNELS))
    kernels = {
        (name, kernel): getattr(importlib.import_module(f"certnav.{name}"), kernel)
        for name, listed in first_run.KERNELS.items()
        for kernel in listed
    }
    before = {where: list(kernel.overloads) for where, kernel in kernels.items()}
    assert main(["-q", "run", str(drive), "--out", str(tmp_path / "r"), "--no-report"]) == 0
    assert {where: list(kernel.overloads) for where, kernel in kernels.items()} == before
    for (name, kernel), overloads in before.items():
        signature = first_run._signature(first_run.KERNELS[name][kernel])
        assert signature in overloads, (name, kernel)


@pytest.mark.parametrize("processes", [1, 2, 3, 4])
def test_every_module_is_in_one_share(processes):
    shares = first_run._shared_out(processes)
    assert sorted(name for share in shares for name in share) == sorted(first_run.KERNELS)
    assert all(shares)


def test_another_process_fills_the_cache_and_says_nothing(tmp_path):
    cache = tmp_path / "cache"
    code = (
        "from certnav.nav.commands.flow import first_run\n"
        f"with first_run._others([{SMALL[:1]}, {SMALL[1:]}, ['no such module']]):\n"
        "    pass\n"
        "import sys; assert 'numba' not in sys.modules\n"
    )
    done = in_a_process(code, cache)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    found = {index.name.split("-")[0] for index in cache.rglob("*.nbi")}
    assert found == {"rows.record", "_frames.ned_covariances", "_frames._times"}


def test_no_other_process_costs_only_time(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no python"))
    monkeypatch.setattr(first_run, "_processors", lambda: 2)
    done = []
    monkeypatch.setattr(first_run, "compile_kernels", done.append)
    first_run.compile_ahead()
    assert done == first_run._shared_out(2)[:1]


def test_interrupted_it_leaves_no_process_behind(tmp_path, monkeypatch):
    (tmp_path / "asleep.py").write_text("import time\ntime.sleep(60.0)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(first_run, "_THIS", "asleep")
    begun = []
    popen = subprocess.Popen
    monkeypatch.setattr(
        subprocess, "Popen", lambda *a, **k: begun.append(popen(*a, **k)) or begun[-1]
    )
    before = time.monotonic()
    with pytest.raises(KeyboardInterrupt), first_run._others([SMALL]):
        raise KeyboardInterrupt
    assert time.monotonic() - before < 30.0
    assert [process.returncode is not None for process in begun] == [True]
    # One that hangs is not waited for any longer than its share may take.
    monkeypatch.setattr(first_run, "_PATIENCE", 0.1)
    with first_run._others([SMALL]):
        pass
    assert begun[1].returncode is not None
