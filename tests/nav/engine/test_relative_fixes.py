"""Relative positions put in the place of single-point ones, by what RTKLIB is told to find."""

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from certnav.datasets.observations import GnssFixes
from certnav.filters.errors import DataError
from certnav.nav.config_files import from_tables
from certnav.nav.engine.events import GnssEvent, missing
from certnav.nav.engine.relative import base_files, with_relative_positions
from oracles import rigs

EAST = rigs.C_EN[:, 1]
BASE = Path("base.20o")
SEQUENCE = SimpleNamespace(
    rover_file=Path("rover.20o"), navigation=("nav",), base=(BASE,), span=(0.0, 100.0)
)


@pytest.fixture(autouse=True)
def files_as_they_are(monkeypatch):
    """The files of these tests are names."""

    def given(file, near):
        assert near == 50.0  # tells the week of a log that has none
        return SimpleNamespace(observations=file)

    monkeypatch.setattr("certnav.datasets.rtklib.given_files", given)


def single(times: Iterable[float]):
    return [
        GnssEvent(t, "position", rigs.PLACE, 9.0 * np.eye(3), rigs.NAMES, shared=True)
        for t in times
    ]


@pytest.fixture
def finds(monkeypatch):
    """Relative positioning that finds positions so far east of the single-point ones."""

    def tell(times, metres, quality="fixed", failed=(), own=None):
        n = len(times)
        pos_e = rigs.PLACE + np.broadcast_to(metres, n)[:, None] * EAST
        fixes = GnssFixes(
            np.asarray(times, dtype=float), pos_e, np.tile(0.01 * np.eye(3), (n, 1, 1)),
            np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.full(n, 8),
            np.broadcast_to(quality, n),
        )  # fmt: skip
        asked = {}

        def fake(rover, base, navigation, **options):
            asked.update(options, rover=rover, base=base, navigation=navigation)
            return SimpleNamespace(
                fixes=fixes, failed=failed, base_pos_e=rigs.PLACE, base_source="declared",
                ratio=5.0 + np.arange(n), systems="GE", frequencies=2, base_own=own,
            )  # fmt: skip

        monkeypatch.setattr("certnav.datasets.rtklib.relative_positions", fake)
        return asked

    return tell


def replaced(events, **gnss):
    config = from_tables({"gnss": {"position": "rtk", **gnss}}).gnss
    out, resolution, notes = with_relative_positions(events, "screened", SEQUENCE, config)
    return out, notes[0].text, resolution, notes[1:]


def test_each_takes_the_place_of_the_one_of_its_epoch(finds):
    """Within 10 ms; where there is none, before or between them, it is left out."""
    events = single([10.0, 11.0])
    events.insert(1, missing(10.5, "position", "no fix"))
    asked = finds([9.5, 10.005, 10.5, 11.011], 5.0, ["fixed", "float", "fixed", "fixed"])
    out, said, resolution, _ = replaced(
        events, position_sigma_scale=2.0, position_sigma_floor_m=0.3
    )
    np.testing.assert_allclose(out[0].value_e, rigs.PLACE + 5.0 * EAST)
    np.testing.assert_allclose(out[0].cov_e, (0.04 + 0.09) * np.eye(3))
    assert (out[0].time, out[0].satellites, out[0].shared) == (10.0, rigs.NAMES, True)
    assert out[1] is events[1] and out[2] is events[2]
    finds([10.0, 11.0], 5.0, ["fixed", "float"])
    assert [event.resolved for event in replaced(single([10.0, 11.0]))[0]] == [True, False]
    shares = "0 fixed (0 %), 1 float, 1 without a relative position"
    assert said.startswith(f"RTK: {shares}; forward, 2 frequencies of GE; base at [")
    assert said.endswith("m (declared)")
    assert (resolution.fixed, resolution.floating, resolution.single) == (0, 1, 1)
    assert asked["rover"] is SEQUENCE.rover_file and asked["base"] == (BASE,)
    assert asked["screened"] == "screened" and asked["base_pos_e"] is None


def test_all_of_them_leave_no_single_one(finds):
    finds([10.0, 11.0], 0.0)
    _, said, resolution, notes = replaced(single([10.0, 11.0]))
    assert said.startswith("RTK: 2 fixed (100 %), 0 float; ratio 5.5 (median), 5.0 (5 %); forward")
    assert resolution.fixed == 2 and resolution.ratio_median == 5.5 and not notes


def test_a_fix_that_its_pseudoranges_contradict_is_none(finds):
    """3 m of single-point noise per axis: 13 m happen once in 10 000, 15 m are a wrong fix."""
    finds([10.0, 11.0], np.array([13.0, 15.0]))
    events = single([10.0, 11.0])
    out, said, resolution, notes = replaced(events)
    assert said.startswith("RTK: 1 fixed (50 %), 0 float, 1 contradicted by their pseudoranges;")
    assert out[0].resolved and out[1] is events[1] and resolution.contradicted == 1
    assert [n.text for n in notes] == [
        "RTK: 1 relative positions contradict their pseudoranges: the single-point ones stay"
    ]


def test_contradictions_of_most_ask_for_the_base(finds):
    finds([10.0, 11.0, 12.0], np.array([0.0, 20.0, 21.0]))
    _, _, resolution, notes = replaced(single([10.0, 11.0, 12.0]))
    assert resolution.contradicted == 2 and notes[-1].doubtful
    assert notes[-1].text.endswith("Is the base's position right (declared)?")


def test_a_base_is_held_against_its_own_ranges(finds):
    """4 m per axis: 17 m are possible, 20 m are another marker, or another datum."""
    for metres, doubtful in ((17.0, False), (20.0, True)):
        own = SimpleNamespace(pos_e=rigs.PLACE + metres * EAST, sigma=4.0)
        finds([10.0], 0.0, own=own, failed=[(12.0, "no base observations")])
        _, said, resolution, notes = replaced(single([10.0]))
        assert said.endswith(
            f"its own single-point mean is {metres} m from there (1σ 4.0 m per axis)"
        )
        assert resolution.base_apart_m == pytest.approx(metres)
        assert any(n.doubtful and "base position (declared)" in n.text for n in notes) is doubtful
        assert "1 no base observations" in notes[-1].text


@pytest.mark.parametrize(("mask", "asked_for"), [(15.0, 15.0), (-5.0, 0.0)])
def test_what_is_configured_reaches_it(finds, mask, asked_for):
    asked = finds([10.0], 0.0)
    replaced(
        single([10.0]), elevation_mask_deg=mask, base_position_e_m=[1.0, 2.0, 3.0],
        systems="GE", frequencies=1, rtk_direction="combined",
    )  # fmt: skip
    assert (asked["systems"], asked["frequencies"], asked["direction"]) == ("GE", 1, "combined")
    assert np.degrees(asked["elevation_mask"]) == pytest.approx(asked_for)
    assert asked["base_pos_e"] == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(("metres", "refused"), [
    ([29.0] * 3, False), ([31.0] * 3, True), ([500.0, 0.0, 0.0], False), ([0.0, 40.0, 40.0], True),
])  # fmt: skip
def test_thirty_metres_throughout_are_a_wrong_base(finds, metres, refused):
    """The median: one that is wild says nothing about the base."""
    finds([10.0, 11.0, 12.0], np.array(metres))
    events = single([10.0, 11.0, 12.0])
    if not refused:
        replaced(events)
        return
    with pytest.raises(DataError, match=rf"are {np.median(metres):.0f} m \(median\).*declared"):
        replaced(events)


def test_none_at_all_is_an_error_where_there_was_something_to_find(finds):
    finds([], 0.0, failed=[(10.0, "no base data"), (11.0, "few"), (12.0, "no base data")])
    with pytest.raises(DataError, match="at any of 2 epochs, mostly: no base data"):
        replaced(single([10.0, 11.0]))
    finds([], 0.0)
    with pytest.raises(DataError, match="at any of 1 epochs") as error:
        replaced(single([10.0]))
    assert "mostly" not in str(error.value)
    lost = [missing(10.0, "position", "no fix")]
    out, said, *_ = replaced(lost)
    assert out == lost and said.startswith("RTK: no positions; forward")


def test_a_base_that_is_configured_goes_before_the_recordings(tmp_path):
    config = from_tables({"gnss": {"base": str(tmp_path / "mine.20o")}}).gnss
    assert base_files(config, SEQUENCE) == (tmp_path / "mine.20o",)
    assert base_files(from_tables({}).gnss, SEQUENCE) == (BASE,)
