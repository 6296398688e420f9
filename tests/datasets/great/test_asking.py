"""What GREAT's files do not say is asked once, all of it, and nothing is half answered."""

import pytest

from certnav.datasets.great.asking import asked, sequences_in
from certnav.datasets.great.installation import sidecar
from certnav.filters.errors import ConfigError, NavError

ANSWERS = 'reference_point = "mems"\nlever = "msf_xml"\n[urban-02]\n'
VECTOR = "lever_antenna_frd_m = [-0.3, 0.01, -0.2]\n"


@pytest.fixture
def home(tmp_path):
    for name in ("campus-01", "suburb-02", "urban-02"):
        (tmp_path / f"Dataset_{name}").mkdir()
    return tmp_path


def written(home):
    return sorted(p.parent.name for p in home.glob("*/great.toml"))


def test_everything_is_asked_at_once_and_the_draft_is_readable(home):
    file = home / "out" / "declared.toml"
    with pytest.raises(ConfigError, match=r"3 sequences; 3 answers .* same command again"):
        asked(home, file)
    with pytest.raises(ConfigError) as caught:  # left as drafted
        asked(home, file)
    said = str(caught.value)
    assert "campus-01: reference_point" in said and "campus-01: lever" in said
    assert "urban-02: lever_antenna_frd_m" in said and "urban-02: reference_point" in said
    assert "\n" not in said
    assert written(home) == []


def test_answers_reach_every_sequence_and_a_section_goes_before_what_is_common(home):
    file = home / "declared.toml"
    own = 'reference_point = "antenna"\n'
    file.write_text(ANSWERS + VECTOR + own)
    asked(home, file)
    assert [e.name for e in sequences_in(home)] == ["campus-01", "suburb-02", "urban-02"]
    first = dict(sidecar(home / "Dataset_campus-01", "mems"))
    assert first == {"week": 2129, "reference_point": "mems", "lever": "msf_xml"}
    last = dict(sidecar(home / "Dataset_urban-02", "mems"))
    assert last == {
        "week": 2233, "reference_point": "antenna", "lever_antenna_frd_m": [-0.3, 0.01, -0.2],
    }  # fmt: skip
    stamp = (home / "Dataset_urban-02" / "great.toml").stat().st_mtime_ns
    asked(home, file)  # again: nothing to do, and what has not changed is not written
    assert (home / "Dataset_urban-02" / "great.toml").stat().st_mtime_ns == stamp


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ANSWERS, "urban-02: lever_antenna_frd_m"),
        (ANSWERS + "lever_antenna_frd_m = [1, 2]\n", "three numbers"),
        (ANSWERS.replace("msf_xml", "figur") + VECTOR, "figure"),
        (ANSWERS.replace('"mems"', '"wheel"') + VECTOR, "reference_point"),
        (ANSWERS.replace("lever =", "levr =") + VECTOR, "lever"),
        (ANSWERS.replace("[urban-02]", "[urban-03]") + VECTOR, "urban-02"),
        (ANSWERS + "week = 2129\n" + VECTOR, "2233"),
        ("reference_point = \n", "TOML"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(home, text, said):
    file = home / "declared.toml"
    file.write_text(text)
    with pytest.raises(NavError, match=said) as caught:
        asked(home, file)
    assert "\n" not in str(caught.value)
    assert written(home) == []


def test_a_file_of_the_user_stays_and_is_not_asked(home):
    own = home / "Dataset_urban-02" / "great.toml"
    own.write_text('reference_point = "tactical"\n' + VECTOR)
    file = home / "declared.toml"
    with pytest.raises(ConfigError, match="2 sequences; 2 answers"):
        asked(home, file)
    assert "urban-02" not in file.read_text()
    own.write_text('reference_point = "tactical"\n')
    with pytest.raises(ConfigError, match=r"great\.toml: lacks lever_antenna_frd_m"):
        asked(home, file)
    assert own.read_text() == 'reference_point = "tactical"\n'
