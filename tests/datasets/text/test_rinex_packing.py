"""Packed RINEX is the same RINEX."""

from __future__ import annotations

import gzip
import importlib.util
import subprocess
import sys

import pytest

from certnav.datasets.text.rinex_packing import is_packed, plain_rinex, unpack
from certnav.filters.errors import DataError

needs_hatanaka = pytest.mark.skipif(
    importlib.util.find_spec("hatanaka") is None, reason="hatanaka (extra crx) not installed"
)


@pytest.fixture
def rinex(data_dir):
    return data_dir / "instinct/tckf_static/reach-m2-01_raw_202306291111.nav"


@pytest.fixture
def observations(data_dir):
    """The first epochs of a real observation file."""
    file = data_dir / "instinct/tckf_static/reach-m2-01_raw_202306291111.23O"
    lines = file.read_text().splitlines(keepends=True)
    epochs = [k for k, line in enumerate(lines) if line.startswith(">")]
    return "".join(lines[: epochs[5]]).encode()


def test_a_plain_file_is_returned_as_it_is(rinex):
    assert plain_rinex(rinex) == rinex


def test_gzip_needs_no_package(rinex, tmp_path):
    file = tmp_path / "a.nav.gz"
    file.write_bytes(gzip.compress(rinex.read_bytes()))
    plain = plain_rinex(file)
    assert plain != file
    assert plain.read_bytes() == rinex.read_bytes()
    assert plain_rinex(file) == plain  # unpacked once


@needs_hatanaka
@pytest.mark.parametrize("outer", [False, True])
def test_hatanaka_round_trip(observations, outer, tmp_path):
    import hatanaka

    packed = hatanaka.rnx2crx(observations)
    packed = packed.encode() if isinstance(packed, str) else packed
    assert is_packed(packed[:80])
    file = tmp_path / "a.crx"
    file.write_bytes(gzip.compress(packed) if outer else packed)
    plain = plain_rinex(file).read_text().splitlines()
    original = observations.decode().splitlines()
    start = next(k for k, line in enumerate(original) if "END OF HEADER" in line)
    assert [line.rstrip() for line in plain[start:]] == [line.rstrip() for line in original[start:]]


@needs_hatanaka
def test_damaged_files(observations, tmp_path):
    import hatanaka

    packed = hatanaka.rnx2crx(observations)
    packed = packed.encode() if isinstance(packed, str) else packed
    broken = packed[: len(packed) // 2] + b"\x00garbage\n"
    with pytest.raises(DataError, match="cannot be unpacked") as caught:
        unpack(broken, "a.crx")
    assert "\n" not in str(caught.value)
    with pytest.raises(DataError, match="damaged gzip"):
        unpack(gzip.compress(packed)[:50], "a.gz")
    with pytest.raises(DataError, match="file not found"):
        plain_rinex(tmp_path / "none.rnx")


def test_without_the_package_the_message_says_what_to_install():
    code = (
        "import sys; sys.modules['hatanaka'] = None\n"
        "from certnav.datasets.text.rinex_packing import unpack\n"
        "from certnav.filters.errors import DataError\n"
        "try:\n    unpack(b' ' * 60 + b'CRINEX VERS   / TYPE', 'a.crx')\n"
        "except DataError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "a.crx: Hatanaka-compressed RINEX needs the package hatanaka" in done.stdout
    assert "pip install 'certnav[crx]'" in done.stdout
