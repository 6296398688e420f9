"""Relative positions of real receivers: a rover at rest on a known point, and one that moves."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from certnav.datasets.rtklib import relative_positions
from certnav.filters.earth import C_en_of, lla_to_ecef
from certnav.filters.errors import DataError

FUJI_BASE = (-3959400.631, 3385704.533, 3667523.111)


def point(file):
    lat, lon, height = (float(v) for v in file.read_text().split())
    return lla_to_ecef(np.radians(lat), np.radians(lon), height)


@pytest.fixture(scope="module")
def nagoya(data_dir, tmp_path_factory):
    """Rover, base, navigation, and where both antennas are."""
    source, folder = data_dir / "nagoya-rtk-static", tmp_path_factory.mktemp("nagoya")
    for name in ("rover", "base"):
        packed = (source / f"{name}.obs.gz").read_bytes()
        (folder / f"{name}.obs").write_bytes(gzip.decompress(packed))
    places = [point(source / f"{name}_position.txt") for name in ("rover", "base")]
    return folder / "rover.obs", folder / "base.obs", [source / "base.nav"], places


@pytest.fixture(scope="module")
def fuji(data_dir):
    folder = data_dir / "fuji-rtk"
    rover, base = (folder / f"{name}.21O" for name in ("SEPT265G", "3034265G"))

    def solved(**options):
        navigation = [folder / "SEPT2650.21P"]
        options.setdefault("base_pos_e", FUJI_BASE)
        return relative_positions(rover, base, navigation, **options)

    return solved


def decimated(base, to, keep):
    """Write the epochs of a RINEX 3 file whose number `keep` takes."""
    head, *epochs = base.read_text().split("\n> ")
    parts = [head, *(epoch.rstrip("\n") for k, epoch in enumerate(epochs) if keep(k))]
    to.write_text("\n> ".join(parts) + "\n")
    return to


def test_a_known_point_is_found_to_a_centimetre_at_every_epoch(nagoya):
    rover, base, navigation, (rover_e, base_e) = nagoya
    found = relative_positions(rover, base, navigation, base_pos_e=base_e)
    assert len(found.fixes) == 301 and set(found.fixes.quality) == {"fixed"}
    error_n = (found.fixes.pos_e - rover_e) @ C_en_of(rover_e)
    assert np.abs(error_n).max() < 0.01
    assert sorted(found.systems) == list("CEGJR") and found.frequencies == 3
    assert found.ratio.min() >= 3.0
    apart = np.linalg.norm(found.base_own.pos_e - base_e)
    assert apart < 4.0 * found.base_own.sigma < 20.0


#: Enough for these, and quicker.
FEW = {"systems": "GE", "frequencies": 2}


@pytest.mark.parametrize("step", [5, 30])
def test_a_base_of_another_rate(nagoya, tmp_path, step):
    """Every 30 s is what networks publish; in between its nearest epoch is used, and σ says so."""
    rover, base, navigation, (rover_e, base_e) = nagoya
    seldom = decimated(base, tmp_path / "seldom.obs", lambda k: k % step == 0)
    found = relative_positions(rover, seldom, navigation, base_pos_e=base_e, **FEW).fixes
    fixed = found.quality == "fixed"
    assert len(found) == 301 and fixed.mean() > 0.9
    assert honest_and_within(found, rover_e, 0.1)


def honest_and_within(fixes, rover_e, metres):
    error_n = (fixes.pos_e - rover_e) @ C_en_of(rover_e)
    sigma = np.sqrt(np.trace(fixes.pos_cov_e, axis1=1, axis2=2) / 3.0)
    fixed = fixes.quality == "fixed"
    return (
        np.abs(error_n[fixed]).max() < metres
        and np.abs(error_n[fixed] / sigma[fixed, None]).max() < 3.0
    )


def test_a_gap_of_the_base_is_bridged_for_its_age_and_then_named(nagoya, tmp_path):
    """Half a minute behind its last and before its next epoch; the 20 s between them have none."""
    rover, base, navigation, (rover_e, base_e) = nagoya
    gappy = decimated(base, tmp_path / "gap.obs", lambda k: not 100 <= k < 180)
    found = relative_positions(rover, gappy, navigation, base_pos_e=base_e, **FEW)
    assert {reason for _, reason in found.failed} == {"no base observations"}
    assert len(found.failed) + len(found.fixes) == 301 and 15 <= len(found.failed) <= 25
    assert (found.fixes.quality == "fixed").mean() > 0.9
    assert honest_and_within(found.fixes, rover_e, 0.1)


def test_a_moving_rover_is_fixed_by_default_and_more_bands_agree(fuji):
    """The same path from one, two and three bands: decimetres would be another integer."""
    found = {bands: fuji(frequencies=bands) for bands in (1, 2, 3)}
    default = fuji()
    assert default.frequencies == 3 and sorted(default.systems) == list("EGJ")
    assert (default.fixes.quality == "fixed").sum() >= 344
    np.testing.assert_array_equal(default.fixes.pos_e, found[3].fixes.pos_e)
    assert (found[2].fixes.quality == "fixed").sum() >= 344
    for bands, rms in ((1, 0.05), (2, 0.03)):
        few, many = found[bands].fixes, found[3].fixes
        _, i, j = np.intersect1d(np.round(few.time, 1), np.round(many.time, 1), return_indices=True)
        both = (few.quality[i] == "fixed") & (many.quality[j] == "fixed")
        apart = np.linalg.norm(few.pos_e[i][both] - many.pos_e[j][both], axis=1)
        assert both.sum() >= 250 and np.sqrt(np.mean(apart**2)) < rms


def test_the_future_contradicts_some_fixes_of_the_past(fuji):
    """Combined, what is fixed differently from both sides counts as float, and says so by its σ."""
    forward, combined = fuji().fixes, fuji(direction="combined").fixes
    assert len(combined) == len(forward) == 360
    doubted = (forward.quality == "fixed") & (combined.quality == "float")
    assert doubted.any()
    sigma = np.sqrt(np.trace(combined.pos_cov_e, axis1=1, axis2=2) / 3.0)
    assert sigma[doubted].min() > 0.49 > 0.1 > sigma[combined.quality == "fixed"].max()
    assert (np.diff(fuji(direction="backward").fixes.time) > 0).all()


def test_a_base_without_a_position_is_told_its_own(nagoya, tmp_path):
    rover, base, navigation, _ = nagoya
    text = base.read_text()
    line = next(x for x in text.splitlines() if "APPROX POSITION XYZ" in x)
    bare = tmp_path / "bare.obs"
    bare.write_text(text.replace(line + "\n", ""))
    with pytest.raises(DataError, match=r"no APPROX POSITION.*single-point positions have it at"):
        relative_positions(rover, bare, navigation, **FEW)
