"""RTKLIB never sees a name it would make a shell command, a pattern or an overrun of."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from certnav.datasets.rtklib import satellite_states
from certnav.datasets.rtklib.file_names import harmless_name
from certnav.datasets.simulation.constellation import draw_constellation, write_navigation
from certnav.datasets.text.rinex_packing import plain_name

TIME = 2129 * 604800.0 + 180000.0


@pytest.fixture(scope="module")
def navigation(tmp_path_factory):
    file = tmp_path_factory.mktemp("nav") / "brdc.nav"
    write_navigation(file, draw_constellation(TIME, np.random.default_rng(1)), TIME, TIME + 60.0)
    return file


NAMES = [
    "brdc.20d", "brdc.nav.gz", "brdc.Z", "brdc.crx", "br*.nav", "brdc with blanks.nav",
    'a"; touch pwned; ".gz', "`touch pwned`.Z", "$(touch pwned).20d", "émile.nav", "x" * 240,
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_plain_files_of_any_name_are_read_as_they_are(navigation, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / name
    shutil.copyfile(navigation, file)
    names = [f"G{k:02d}" for k in range(1, 33)]
    expected = satellite_states([navigation], names, TIME)
    assert np.isfinite(expected.clock).sum() > 20
    np.testing.assert_array_equal(satellite_states([file], names, TIME).pos_e, expected.pos_e)
    assert [f.name for f in tmp_path.iterdir()] == [name]  # nothing ran, nothing was left


def test_a_path_longer_than_rtklibs_buffers(navigation, tmp_path):
    """1024 bytes with everything RTKLIB appends: one more overran the stack."""
    folder = tmp_path
    while len(str(folder)) < 1200:
        folder = folder / ("d" * 200)
    folder.mkdir(parents=True)
    shutil.copyfile(navigation, folder / "brdc.nav")
    found = satellite_states([folder / "brdc.nav"], ["G01"], TIME)
    np.testing.assert_array_equal(found.pos_e, satellite_states([navigation], ["G01"], TIME).pos_e)


def test_ordinary_names_are_left_alone(tmp_path):
    for name in ("brdc.nav", "SEPT3010.20O", "rover.obs"):
        with harmless_name(tmp_path / name) as given:
            assert given == str(tmp_path / name)


@pytest.mark.parametrize(
    ("packed", "plain"),
    [("a.20d.Z", "a.20o"), ("a.20D.gz", "a.20o"), ("b.crx.gz", "b.rnx"), ("c.rnx.gz", "c.rnx"),
     ("d.20n.Z", "d.20n"), ("e.obs", "e.obs")],
)  # fmt: skip
def test_what_is_unpacked_is_not_called_packed(packed, plain):
    assert plain_name(packed) == plain
