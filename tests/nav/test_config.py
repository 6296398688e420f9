"""Configuration: round trip, types, and errors that name the nearest key."""

import pytest

from certnav.filters.errors import ConfigError, DataError
from certnav.nav.config import Config
from certnav.nav.config_files import from_tables, load_config, to_toml


def test_toml_round_trip(tmp_path):
    tables = {
        "alignment": {"heading_deg": 12.5, "roll_deg": 0.0, "pitch_deg": -1.0, "method": "given"},
        "filter": {"states": 21, "gate_probability": 0.0},
        "gnss": {"raim": False, "elevation_mask_deg": 15},
        "data": {"lever": [0.1, -0.2, 0.3], "imu": "mems", "week": 2129},
    }
    config = from_tables(tables)
    file = tmp_path / "config.toml"
    file.write_text(to_toml(config), encoding="utf-8")
    assert load_config(file) == config
    assert config.gnss.elevation_mask_deg == 15.0


def test_defaults_are_valid_and_complete():
    text = to_toml(Config())
    for name in ("[alignment]", "[filter]", "[gnss]", "[data]", "gate_probability", "min_cn0_dbhz"):
        assert name in text


def test_assignments_win_over_the_file(tmp_path):
    file = tmp_path / "c.toml"
    file.write_text("[filter]\nstates = 21\n[gnss]\nraim = true\n")
    config = load_config(file, ["filter.states=15", "gnss.raim=false", "data.lever=figure"])
    assert (config.filter.states, config.gnss.raim, config.data["lever"]) == (15, False, "figure")
    assert load_config(None, ["data.lever=[0.1, 0.2, 0.3]"]).data["lever"] == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"fliter": {}}, "unknown key 'fliter' — did you mean 'filter'"),
        ({"filter": {"sates": 15}}, "filter: unknown key 'sates' — did you mean 'states'"),
        ({"filter": {"states": 17}}, "expected 15 or 21, found 17"),
        ({"filter": {"imu": "adis1647"}}, "did you mean 'adis16470'"),
        ({"filter": {"gate_probability": 1.5}}, "0 ≤ p < 1"),
        ({"filter": {"states": "many"}}, "filter.states: expected a number, found 'many'"),
        ({"filter": 3}, "filter: expected a table"),
        ({"gnss": {"position": "ppp"}}, "expected one of auto, spp, rtk, carried, none"),
        ({"gnss": {"raim": 1}}, "gnss.raim: expected a bool"),
        ({"gnss": {"elevation_mask_deg": 95}}, "found 95"),
        ({"alignment": {"method": "given"}}, "needs alignment.roll_deg"),
        ({"alignment": {"min_speed_mps": 0}}, "expected a number > 0"),
        ({"alignment": {"method": "sure"}}, "auto, certified, level\\+course, given"),
        ({"alignment": {"sigma_clock_walk_mps": 0}}, "sigma_clock_walk_mps: expected a number > 0"),
        ({"alignment": {"max_sigma_heading_deg": -1}}, "max_sigma_heading_deg"),
        ({"alignment": {"max_window_s": 3}}, "max_window_s: expected at least 5 s, found 3"),
    ],
)
def test_mistakes_are_named(tables, message):
    with pytest.raises(ConfigError, match=message.replace("[", r"\[")):
        from_tables(tables)


@pytest.mark.parametrize("text", ["filter.states", "states=15", "=3", ".states=15"])
def test_malformed_assignment(text):
    with pytest.raises(ConfigError, match="expected section"):
        load_config(None, [text])


def test_unreadable_file(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        load_config(tmp_path / "absent.toml")
    bad = tmp_path / "bad.toml"
    bad.write_text("[filter\n")
    with pytest.raises(DataError, match="not readable as TOML"):
        load_config(bad)
