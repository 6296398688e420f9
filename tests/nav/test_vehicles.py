"""Kinds of vehicles: what is set by them, what is asked of them, and what they would explain."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.filters.errors import ConfigError
from certnav.nav.check.recording import check_sequence
from certnav.nav.config import Config, VehicleConfig
from certnav.nav.config_files import from_tables, load_config, to_toml
from certnav.nav.pipeline import navigate
from certnav.nav.vehicles import VEHICLES, would_explain

CRABS = ("walker", "robot", "boat", "aircraft")


@pytest.fixture(scope="module")
def drive():
    config = SimulationConfig(seed=0, duration=160.0, density="open")
    simulation = simulate(config)
    fixes = fixes_from_truth(
        simulation.trajectory, config.start_time + np.arange(1.0, 159.0),
        config.lever_antenna_b, 1.0, 0.05, np.random.default_rng(0),
    )  # fmt: skip
    return dataclasses.replace(simulation.sequence(fixes), observations=None, reference=None)


def adrift(sequence):
    """Return the same vehicle on water that carries it sideways: a tide that turns and turns."""
    fixes = sequence.fixes
    C_en = C_en_of(fixes.pos_e)
    t = fixes.time - fixes.time[0]
    drift = np.column_stack([8.0 * np.sin(0.13 * t), 8.0 * np.cos(0.11 * t), 0.0 * t])
    way = np.cumsum(drift * np.gradient(t)[:, None], axis=0)
    moved = dataclasses.replace(
        fixes,
        pos_e=fixes.pos_e + np.einsum("nij,nj->ni", C_en, way),
        vel_e=fixes.vel_e + np.einsum("nij,nj->ni", C_en, drift),
    )
    return dataclasses.replace(sequence, fixes=moved)


@pytest.mark.parametrize("kind", VEHICLES)
def test_only_what_goes_where_it_points_is_constrained_to(kind):
    config = Config(vehicle=VehicleConfig(kind=kind))
    asked = "off" if kind in CRABS else "auto"
    assert (config.vehicle.nhc, config.gnss.forward_motion) == (asked, asked)
    assert Config(vehicle=VehicleConfig(kind=kind, nhc="on")).vehicle.nhc == "on"


def test_defaults_of_a_kind_give_way_to_what_is_asked(tmp_path):
    boat = load_config(None, ["vehicle.kind=boat"])
    assert not boat.vehicle.zupt and not boat.vehicle.zaru
    assert load_config(None, ["vehicle.kind=boat", "vehicle.zupt=true"]).vehicle.zupt
    walker = from_tables({"vehicle": {"kind": "walker"}})
    assert walker.alignment.min_speed_mps == 1.0 and walker.vehicle.zupt
    asked = from_tables({"vehicle": {"kind": "walker"}, "alignment": {"min_speed_mps": 2.0}})
    assert asked.alignment.min_speed_mps == 2.0
    file = tmp_path / "c.toml"
    file.write_text(to_toml(boat), encoding="utf-8")
    assert load_config(file) == boat


def test_unknown_kinds_are_refused():
    with pytest.raises(ConfigError, match=r"vehicle\.kind: unknown key 'boot' — .* 'boat'"):
        load_config(None, ["vehicle.kind=boot"])


def test_a_car_is_asked_to_go_where_it_points_and_told_what_else_it_may_be(drive):
    found = check_sequence(adrift(drive))
    gyro = next(f for f in found if f.subject == "gyro" and f.severity != "note")
    assert "if this is a walker, a robot, a boat or an aircraft" in gyro.remedy
    assert "--set vehicle.kind=walker|robot|boat|aircraft" in gyro.remedy


@pytest.mark.parametrize("kind", ["boat", "aircraft"])
def test_a_boat_is_not(drive, kind):
    alarms = [f for f in check_sequence(adrift(drive), kind=kind) if f.severity != "note"]
    assert [f for f in alarms if f.subject in ("gyro", "accelerometer axes")] == []


def test_a_sound_drive_is_a_car_and_no_walker(drive):
    assert [f.subject for f in check_sequence(drive) if f.severity != "note"] == []
    (found,) = [f for f in check_sequence(drive, kind="walker") if f.severity != "note"]
    assert found.subject == "speed" and "a walker is not so fast" in found.found
    assert "if this is a car" in found.remedy and "vehicle.kind=car|" in found.remedy


def test_a_climb_that_no_road_has_is_an_aircraft_s(drive):
    fixes = drive.fixes
    C_en = C_en_of(fixes.pos_e)
    t = fixes.time - fixes.time[0]
    climbing = dataclasses.replace(
        drive,
        fixes=dataclasses.replace(
            fixes, pos_e=fixes.pos_e - 20.0 * t[:, None] * C_en[:, :, 2],
            vel_e=fixes.vel_e - 20.0 * C_en[:, :, 2],
        ),
    )  # fmt: skip
    found = [f for f in check_sequence(climbing) if f.subject == "height"]
    assert "20 m/s" in found[0].found and found[0].remedy.endswith("vehicle.kind=aircraft")
    assert not [f for f in check_sequence(climbing, kind="aircraft") if f.subject == "height"]


def test_nothing_is_suggested_where_nothing_fits():
    assert would_explain(lambda v: v.max_speed > 1e4, "car") == ""


def test_a_boat_is_navigated_without_the_car_s_constraint(drive):
    kinds = {u.kind for u in navigate(drive, load_config(None, ["vehicle.kind=boat"])).updates}
    assert "nhc" not in kinds and "zupt" not in kinds
    assert "nhc" in {u.kind for u in navigate(drive, Config()).updates}
