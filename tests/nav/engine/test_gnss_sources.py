"""Positions and velocities a set carries; which source is taken, and which is not there."""

import dataclasses

import numpy as np
import pytest

from certnav.filters.errors import ConfigError
from certnav.nav.config_files import from_tables
from certnav.nav.engine.gnss import gnss_timeline, sources
from oracles import rigs


def gnss(**options):
    return from_tables({"gnss": {"elevation_mask_deg": 0.0, **options}}).gnss


def silent():
    return rigs.sky(time=10.0).with_columns(range_rate=np.full(8, np.nan))


def carried(velocity=True):
    fixes = rigs.positions([10.0, 11.0], rigs.PLACE, "receiver")
    if not velocity:
        return fixes
    vel_e = np.array([[1.0, 2.0, 3.0], [np.nan] * 3])
    return dataclasses.replace(fixes, vel_e=vel_e, vel_cov_e=np.tile(np.eye(3), (2, 1, 1)))


def test_carried_values_have_scales_of_their_own():
    options = gnss(
        position_sigma_scale=2.0, position_sigma_floor_m=1.0,
        velocity_sigma_scale=3.0, velocity_sigma_floor_mps=2.0,
    )  # fmt: skip
    found = gnss_timeline(rigs.recording(fixes=carried()), options)
    kinds = [(e.time, e.kind, e.reason) for e in found.events]
    assert kinds == [
        (10.0, "position", ""), (10.0, "velocity", ""),
        (11.0, "position", ""), (11.0, "velocity", "no velocity in the data"),
    ]  # fmt: skip
    np.testing.assert_allclose(found.events[0].cov_e, 4.0 * rigs.FIX_COV + np.eye(3))
    np.testing.assert_allclose(found.events[1].cov_e, (9.0 + 4.0) * np.eye(3))
    assert not any(e.shared for e in found.events) and found.misfit is None
    assert found.observations is None and found.epochs.usable.tolist() == [8, 8]
    alone = gnss_timeline(rigs.recording(fixes=carried()), gnss(position="none"))
    assert {e.kind for e in alone.events} == {"velocity"}


def test_doppler_goes_with_carried_positions_whose_time_is_gps_time():
    both = rigs.recording(
        rigs.joined(*(rigs.sky(time=t) for t in (10.0, 11.0))), carried(), navigation=()
    )
    found = gnss_timeline(both, gnss())
    assert [(e.time, e.kind) for e in found.events] == [
        (10.0, "position"), (10.0, "velocity"), (11.0, "position"), (11.0, "velocity"),
    ]  # fmt: skip
    assert found.events[1].observations is not None and not found.events[0].shared
    velocity = gnss_timeline(both, gnss(position="none")).events
    assert {e.kind for e in velocity} == {"velocity"}
    given = gnss_timeline(both, gnss(velocity="carried")).events
    np.testing.assert_array_equal(given[1].value_e, [1.0, 2.0, 3.0])


def test_sources_prefer_what_is_carried_and_what_is_raw():
    for found, expected in [
        (rigs.recording(rigs.sky(time=10.0)), ("spp", "doppler")),
        (rigs.recording(rigs.sky(time=10.0), navigation=()), ("none", "doppler")),
        (rigs.recording(silent()), ("spp", "none")),
        (rigs.recording(rigs.sky(time=10.0), carried()), ("carried", "doppler")),
        (rigs.recording(silent(), carried()), ("carried", "carried")),
        (rigs.recording(fixes=carried()), ("carried", "carried")),
        (rigs.recording(fixes=carried(velocity=False)), ("carried", "none")),
    ]:
        assert sources(found, gnss()) == expected
    assert sources(rigs.recording(rigs.sky(time=10.0), carried()), gnss(position="spp"))[0] == "spp"
    assert (
        sources(rigs.recording(rigs.sky(time=10.0), carried()), gnss(velocity="carried"))[1]
        == "carried"
    )


@pytest.mark.parametrize(("made", "key", "value"), [
    (lambda: rigs.recording(rigs.sky(time=10.0)), "position", "carried"),
    (lambda: rigs.recording(rigs.sky(time=10.0), carried(velocity=False)), "velocity", "carried"),
    (lambda: rigs.recording(rigs.sky(time=10.0), navigation=()), "position", "spp"),
    (lambda: rigs.recording(rigs.sky(time=10.0), rover_file=None), "position", "rtk"),
    (lambda: rigs.recording(silent()), "velocity", "doppler"),
])  # fmt: skip
def test_a_source_that_is_not_there_is_named(made, key, value):
    with pytest.raises(ConfigError, match=rf"gnss\.{key}: '{value}'"):
        sources(made(), gnss(**{key: value}))


def test_a_fix_that_is_none_is_no_event_and_no_whereabouts():
    """Its reason is told, with the velocity's; lines of sight are seen from the others."""
    far = np.array([rigs.PLACE, rigs.PLACE + 5e4, rigs.PLACE])
    fixes = rigs.positions([10.0, 11.0, 12.0], far, "receiver")
    fixes = dataclasses.replace(
        fixes, vel_e=np.zeros((3, 3)), vel_cov_e=np.tile(np.eye(3), (3, 1, 1)),
        rejected=np.array(["", "repeats", ""]),
    )  # fmt: skip
    found = gnss_timeline(rigs.recording(fixes=fixes), gnss())
    reasons = {(e.time, e.kind): e.reason for e in found.events}
    assert reasons[11.0, "position"] == reasons[11.0, "velocity"] == "repeats"
    assert not any(why for (time, _), why in reasons.items() if time != 11.0)
    (note,) = found.notes[1:]
    assert note.doubtful and note.text.startswith("fixes: 1 rows from 11.00 s to 11.00 s")
    both = rigs.recording(rigs.sky(time=11.0), fixes)
    (doppler,) = [e for e in gnss_timeline(both, gnss()).events if e.observations is not None]
    np.testing.assert_allclose(doppler.epoch.pos_e, rigs.PLACE)
    silent = gnss_timeline(both, gnss(position="none")).notes
    assert [n.text for n in silent] == ["positions: none; velocities: doppler"]


def test_fixes_are_looked_through_before_they_are_used():
    """Latitude and longitude zero: what a logger writes until there is a fix."""
    nowhere = np.array([rigs.PLACE, [6378137.0, 0.0, 0.0], rigs.PLACE])
    found = gnss_timeline(rigs.recording(fixes=rigs.positions([10.0, 11.0, 12.0], nowhere)), gnss())
    assert [bool(e.reason) for e in found.events] == [False, True, False]
