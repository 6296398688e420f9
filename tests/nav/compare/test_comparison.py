"""The comparison: drift as defined, the same spells for everyone, page and directories agree."""

from __future__ import annotations

import argparse
import dataclasses
import json

import numpy as np
import pytest

from certnav.datasets.loading import load
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import ecef_to_lla
from certnav.filters.errors import ConfigError, DataError
from certnav.nav.commands import compare as compare_command
from certnav.nav.compare.comparison import compare
from certnav.nav.compare.directories import SIDECAR, merge
from certnav.nav.compare.methods import METHODS, parse_methods
from certnav.nav.compare.report import build_page, write_page
from certnav.nav.compare.runs import Comparison, Run, as_dict
from certnav.nav.config import Config
from certnav.nav.config_files import from_tables
from certnav.nav.spells.outages import parse_outages
from certnav.nav.windows.recording import summary


def _drive(noise: bool = True):
    simulation = simulate(
        SimulationConfig(
            name="made", seed=4, duration=150.0, density="open", imu_rate=25.0, noise=noise,
            static_start=20.0, imu="consumer", atmosphere=noise, receiver_clock=noise,
        )
    )  # fmt: skip
    time = np.arange(1.0, 149.0) + simulation.config.start_time
    lever = simulation.calibration.lever_antenna_b
    sigma = (1.0, 0.05) if noise else (0.0, 0.0)
    rng = np.random.default_rng(5)
    fixes = fixes_from_truth(simulation.trajectory, time, lever, *sigma, rng)
    return simulation.sequence(fixes)


@pytest.fixture(scope="module")
def comparison():
    """Every kind of method over 30 s spells with two or three satellites."""
    methods = "gnss-only,alignment-only,lc4,lc+ddia,lc+rows,lc+rows+vehicle+smooth"
    return compare(
        [_drive()], parse_methods(methods + ",alignment-heading"), parse_outages("38/74:2-3"),
        Config(), seeds=2,
    )  # fmt: skip


def test_everyone_has_the_same_spells(comparison):
    spells = {
        (run.variant, tuple((s.start, s.end) for s in run.spells))
        for run in comparison.runs
        if run.spells
    }
    assert len(spells) == 2  # one set of spells a seed, whatever the method


def test_doppler_below_four_holds_what_inertial_alone_loses(comparison):
    drift = {n: f["drift_m"]["rms_of_maxima"] for n, f in as_dict(comparison)["methods"].items()}
    assert max(drift["lc+rows"], drift["lc+ddia"]) < drift["lc4"] < drift["gnss-only"]
    assert drift["lc+rows"] < 1.2 * drift["lc+ddia"]
    assert drift["lc+rows+vehicle+smooth"] < 0.2 * drift["lc4"]


def test_three_satellites_hold_the_velocity_to_the_noise_of_their_doppler():
    """Range rates good to 0.1 m/s, once a second: the velocity is known for as long as they last.

    Two satellites leave one direction to the IMU, whatever is made of them.
    """
    duration = 38.0
    found = compare(
        [_drive()], parse_methods("lc4,lc+rows"), parse_outages(f"{duration:g}/74:3"), Config(),
        seeds=3,
    )  # fmt: skip
    alone, rows = (as_dict(found)["methods"][name] for name in ("lc4", "lc+rows"))
    drift = rows["drift_m"]["rms_of_maxima"]
    assert drift < 0.05 * duration and drift < alone["drift_m"]["rms_of_maxima"] / 3.0
    assert rows["velocity_error_mps"]["rms_of_maxima"] < 0.15
    assert rows["consistency"]["nees_in"] < 4.5  # 3 is right


def test_held_positions_drift_by_the_way_driven(comparison):
    drive = _drive()
    run = comparison.of("gnss-only")[0]
    for spell in run.spells:
        rows = (drive.reference.time >= spell.start) & (drive.reference.time < spell.end)
        pos_e = drive.reference.pos_e[rows]
        away = np.linalg.norm(pos_e - pos_e[0], axis=1).max()
        speed = np.linalg.norm(drive.reference.vel_e[rows], axis=1).max()
        assert abs(spell.drift - away) < 2.5 * speed + 5.0  # held from up to an epoch before
    assert run.availability < 0.75


def test_window_headings_need_no_odometer(comparison):
    found = as_dict(comparison)["methods"]["alignment-heading"]["alignment_windows"]
    assert found["passed"] > 0 and found["largest_passed_deg"] < 5.0


def test_what_is_not_available_says_why():
    drive = dataclasses.replace(_drive(), observations=None)
    found = compare(
        [drive], parse_methods("certified-only,alignment-heading,lc4"), parse_outages("38/74"),
        Config(),
    )  # fmt: skip
    methods = as_dict(found)["methods"]
    assert methods["lc4"]["runs"] == 1
    for name, said in (("certified-only", "raw Doppler"), ("alignment-heading", "raw Doppler")):
        assert methods[name]["runs"] == 0 and said in methods[name]["not_available"][0]
    assert "certified-only is not available on made@0" in build_page(found)


def test_exact_data_drift_nowhere():
    found = compare(
        [_drive(noise=False)], parse_methods("lc4,lc+rows"), parse_outages("38/74:3"), Config()
    )
    for name, figures in as_dict(found)["methods"].items():
        assert figures["spells"] == 2, name
    rows = as_dict(found)["methods"]["lc+rows"]["drift_m"]["rms_of_maxima"]
    assert rows < 0.3


def test_a_drive_without_reference_is_judged_by_its_own_smoothed_solution():
    drive = dataclasses.replace(_drive(), reference=None)
    found = compare([drive], parse_methods("lc4,lc+rows"), parse_outages("38/74:3"), Config())
    assert any("no reference" in note for note in found.notes)
    drift = {n: f["drift_m"]["rms_of_maxima"] for n, f in as_dict(found)["methods"].items()}
    assert drift["lc+rows"] < drift["lc4"]


def test_page_is_one_self_contained_file(comparison, tmp_path):
    page = write_page(comparison, tmp_path / "out").read_text(encoding="utf-8")
    assert "http" not in page.replace("http-equiv", "").split("<body>")[1].split("data:")[0]
    for name in comparison.methods:
        assert name in page
    for title in ("Drift per spell", "What each step bought", "Tracks", "time since loss"):
        assert title in page
    content = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    assert set(content["methods"]["lc4"]["drift_m"]) == {"median", "rms_of_maxima", "p95"}
    assert "horizontal_rms_m" in content["methods"]["lc4"]["errors"]


def test_merged_directories_give_the_same_figures(tmp_path):
    made = compare(
        [_drive()], parse_methods("lc4,lc+rows"), parse_outages("38/74:3"), Config(),
        out=tmp_path,
    )  # fmt: skip
    assert (tmp_path / "lc4" / "summary.json").is_file()
    assert (tmp_path / "lc+rows" / SIDECAR).is_file()
    merged = merge([tmp_path])
    one, two = as_dict(made)["methods"], as_dict(merged)["methods"]
    for name in ("lc4", "lc+rows"):
        for key, value in one[name]["drift_m"].items():
            assert two[name]["drift_m"][key] == pytest.approx(value, abs=1e-3)
        assert two[name]["errors"]["horizontal_rms_m"] == pytest.approx(
            one[name]["errors"]["horizontal_rms_m"], abs=1e-3
        )
    assert "Drift per spell" in build_page(merged)


def test_nothing_to_merge_is_said(tmp_path):
    with pytest.raises(DataError, match="no certnav result"):
        merge([tmp_path])


def test_a_position_given_by_hand_is_enough_to_compare_coupling_with_alignment_alone():
    """No position in the recording, but Doppler: what needs none starts where it is said to be.

    The place holds at the beginning: what was driven until the start is added to it.
    """
    simulation = simulate(
        SimulationConfig(
            name="made", seed=4, duration=110.0, density="open", imu_rate=25.0, static_start=5.0,
            imu="tactical",
        )
    )  # fmt: skip
    sequence = simulation.sequence()
    seen = sequence.observations
    nothing = np.full(len(seen), np.nan)
    without = seen.with_columns(pseudorange=nothing, carrier=nothing)
    drive = dataclasses.replace(sequence, observations=without, navigation=())
    latitude, longitude, height = ecef_to_lla(sequence.reference.pos_e[0])
    near = [float(np.degrees(latitude)), float(np.degrees(longitude)), float(height)]
    config = from_tables({"gnss": {"near_deg": near, "near_radius_km": 0.01}})
    methods = parse_methods("gnss-only,alignment-only,certified-only,lc4")
    with pytest.raises(ConfigError, match="near_deg"):
        compare([drive], methods, parse_outages("none"), Config())
    found = as_dict(compare([drive], methods, parse_outages("none"), config))["methods"]
    assert found["gnss-only"]["not_available"] == ["made: no GNSS positions"]
    coupled, alone = (found[n]["errors"]["horizontal_rms_m"] for n in ("lc4", "alignment-only"))
    assert coupled < 12.0 and coupled < 0.5 * alone
    assert found["lc4"]["consistency"]["nees_out"] < 9.0
    assert found["certified-only"]["errors"]["heading_rms_deg"] < 3.0


def test_unknown_method_names_the_nearest():
    with pytest.raises(ConfigError, match=r"lc\+rows"):
        parse_methods("lc+row")
    assert [m.name for m in parse_methods("all")] == list(METHODS)


def test_methods_differ_in_what_they_are_named_for():
    config = METHODS["lc4"].config(Config())
    assert config.gnss.below_four == "off" and not config.vehicle.zupt and not config.filter.smooth
    config = METHODS["lc+ddia+vehicle+smooth"].config(Config())
    assert config.gnss.below_four == "ddia" and config.vehicle == Config().vehicle
    assert config.filter.smooth


def test_command_refuses_to_overwrite_what_is_not_its_own(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine", encoding="utf-8")
    parser = argparse.ArgumentParser()
    compare_command.add_arguments(parser)
    with pytest.raises(DataError, match="not a comparison"):
        compare_command.run(parser.parse_args([str(tmp_path), "--out", str(tmp_path)]))
    assert (tmp_path / "thesis.txt").is_file()


def test_certified_only_and_window_headings_on_a_recording(data_dir, tmp_path):
    methods = parse_methods("certified-only,lc4,alignment-heading")
    sequence = load(data_dir / "comma2k19-example1")
    found = compare([sequence], methods, parse_outages("30-50"), Config())
    table = as_dict(found)["methods"]
    certified, lc4 = table["certified-only"], table["lc4"]
    # The same start; without any GNSS after it the position can only be worse.
    assert certified["errors"]["horizontal_rms_m"] > lc4["errors"]["horizontal_rms_m"]
    assert certified["updates"]["position"]["accepted"] < lc4["updates"]["position"]["accepted"]
    headings = table["alignment-heading"]
    assert "alignment_windows" in headings or headings["not_available"]
    page = write_page(found, tmp_path).read_text(encoding="utf-8")
    assert "certified-only" in page and "alignment-heading" in page


def test_window_headings_are_on_the_page():
    weak = {"windows_in_spells": 0, "solved_in_spells": 0, "mae_in_spells_deg": float("nan")}
    run = Run("alignment-heading", "drive", "@0", headings=summary([]) | weak)
    assert "Heading of sliding-window alignment" in build_page(Comparison((run,), {}, "60/180"))


def test_spells_are_where_they_can_be_judged_and_satellites_be_left():
    """Of 15 s in every 30 s: one whose end no reference has seen, one without observations."""
    drive = _drive(noise=False)
    begin = drive.span[0]
    reference, observed = drive.reference, drive.observations
    # Spells end at second 30, 60, 90, 120 and 150; the reference is blind around second 90.
    seen = np.abs(reference.time - begin - 90.0) > 4.0
    blind = dataclasses.replace(
        drive,
        reference=dataclasses.replace(
            reference,
            **{
                f.name: getattr(reference, f.name)[seen]
                for f in dataclasses.fields(reference)
                if isinstance(getattr(reference, f.name), np.ndarray)
                and len(getattr(reference, f.name)) == seen.size
            },
        ),
        observations=observed.take(observed.time < begin + 125.0),
    )
    found = compare([blind], parse_methods("lc4"), parse_outages("15/30:2"), Config())
    ends = [round(spell.end - begin) for spell in found.runs[0].spells]
    assert ends == [30, 60, 120]
    assert any(
        "1 of 4 spells that the reference has not seen begin or end" in n for n in found.notes
    )
    assert any("spells up to second 124: later there are no observations" in n for n in found.notes)
    none_left = compare([blind], parse_methods("lc4"), parse_outages("15/30"), Config())
    assert [round(s.end - begin) for s in none_left.runs[0].spells] == [30, 60, 120, 150]
    with pytest.raises(DataError, match="has seen none of 1 spells begin and end"):
        compare([blind], parse_methods("lc4"), parse_outages("15/90:2"), Config())
