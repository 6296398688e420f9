"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

# Small matrices: threads cost more than they bring. Before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real recordings; tests that need it are skipped where it is absent."""
    path = Path(os.environ.get("CERTNAV_DATA", ROOT.parent / "shared" / "data"))
    if not path.is_dir():
        pytest.skip(f"real data not found at {path} (set CERTNAV_DATA)")
    return path
