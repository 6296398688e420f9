"""The release of GREAT, rehearsed: archives in, all pages and tables out, and honest about it."""

import json
import re
import zipfile
from html.parser import HTMLParser

import numpy as np
import pytest

from certnav.datasets.great.asking import asked
from certnav.datasets.great.reader import SIMULATED
from certnav.datasets.loading import load
from certnav.filters.earth import ecef_to_lla
from certnav.nav.commands.cli import main as certnav
from certnav.nav.config import Config
from certnav.nav.tune.candidates import candidates

NAMES = ("campus-01", "urban-02")
#: Of the settings that tuning tries, the default and two: the others take minutes.
TRIED = ("default", "C/N0 > 40 dB-Hz", "nothing below four satellites")
FEW = ["--methods", "alignment-only,lc4,lc+rows", "--outages", "12/30:2-3", "--jobs", "1"]


class Links(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        found = [value for key, value in attributes if key == "href"]
        self.found += [value for value in found if not value.startswith("data:")]  # in the page


@pytest.fixture(scope="module")
def rehearsal(script):
    return script("great_rehearsal")


@pytest.fixture(scope="module")
def rehearsed(rehearsal, tmp_path_factory):
    """Rehearse two sequences of a minute, once for all tests."""
    out = tmp_path_factory.mktemp("great") / "rehearsal"
    given = rehearsal.parser().parse_args(
        ["--out", str(out), "--seconds", "65", "--only", ",".join(NAMES), *FEW]
    )
    few = [c for c in candidates(Config(), [35.0], [0.2]) if c.name in TRIED]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("certnav.nav.tune.settings.candidates", lambda *_: few)
        assert rehearsal.rehearse(out, given) == 0
    return out


def test_every_page_is_there_and_every_link_of_the_index_leads_somewhere(rehearsed):
    site = rehearsed / "site"
    links = Links()
    links.feed((site / "index.html").read_text())
    for link in links.found:
        assert (site / link).is_file(), link
    assert {"study/study.html", "tuning/tuning.html", "comparison/comparison.html"} <= set(
        links.found
    )
    assert {f"checks/Dataset_{name}-simulated.html" for name in NAMES} <= set(links.found)
    reports = [f"runs/Dataset_{name}-simulated/report.html" for name in NAMES]
    assert set(reports) <= set(links.found)


def test_every_table_is_latex_and_tables_tex_takes_all_of_them(rehearsed):
    tables = rehearsed / "site" / "tables"
    names = {file.stem for file in tables.glob("*.tex")} - {"tables"}
    assert {"recordings", "runs", "table2", "table3", "table4", "table5", "candidates"} <= names
    assert "comparison" in names
    whole = (tables / "tables.tex").read_text()
    assert set(re.findall(r"\\input\{(.*)\}", whole)) == names
    for name in names:
        text = (tables / f"{name}.tex").read_text()
        assert text.count(r"\begin{") == text.count(r"\end{") > 0
        bare = re.sub(r"\\[{}]", "", text)
        assert bare.count("{") == bare.count("}")


def test_nothing_passes_for_a_figure_of_great(rehearsed):
    site = rehearsed / "site"
    assert "No figure of theirs is of the GREAT" in (site / "index.html").read_text()
    for file in (site / "tables").glob("*.tex"):
        for name in NAMES:
            text = file.read_text()
            assert text.count(name) == text.count(f"{name}-simulated"), file
    drive = load(site / "data" / "Dataset_campus-01")
    assert SIMULATED in drive.notes and drive.reference.source == "simulation truth"


def test_figures_of_the_index_are_those_of_the_runs(rehearsed):
    site = rehearsed / "site"
    content = json.loads((site / "great.json").read_text())
    assert [step["failed"] for step in content["steps"]] == [""] * len(content["steps"])
    assert content["tuned"]
    assert [step["step"] for step in content["steps"]][:4] == ["check", "study", "run", "tune"]
    for run in content["runs"]:
        summary = json.loads((site / "runs" / run["recording"] / "summary.json").read_text())
        if run["settings"] == "as configured":
            assert run["horizontal_rms_m"] == summary["errors"]["horizontal_rms_m"]


def test_a_day_s_file_is_cut_to_each_sequence(rehearsal, tmp_path):
    """One rover file of two drives, one of which has a tunnel and was saved as it came."""
    chosen = [p for p in rehearsal.RELEASE if p.name in ("campus-01", "campus-03")]
    found = rehearsal.write_release(tmp_path / "downloads", 60.0, chosen)
    assert [file.name for file in found] == [
        "Dataset_campus-03.zip", "GNSS_RAW_DATA.zip", "campus-01-IMU.zip", "campus-01.txt",
    ]  # fmt: skip
    with zipfile.ZipFile(found[1]) as archive:
        assert len(archive.namelist()) == 2
    site = tmp_path / "site"
    (tmp_path / "answers.toml").write_text(rehearsal.ANSWERS)
    command = ["datasets", "import", str(tmp_path / "downloads" / "campus-01-IMU.zip")]
    assert certnav([*command, *map(str, found), "--to", str(site / "data")]) == 0
    asked(site / "data", tmp_path / "answers.toml")
    first, third = (load(site / "data" / f"Dataset_{p.name}") for p in chosen)
    for drive, tunnel in ((first, 0), (third, 5)):
        begin, end = drive.span
        time = np.unique(drive.observations.time)
        assert begin - 2.0 <= time[0] and time[-1] <= end + 2.0
        assert time.size == pytest.approx(61 - tunnel, abs=1)
        near = np.degrees(ecef_to_lla(drive.reference.pos_e[0]))[:2]
        np.testing.assert_allclose(near, (30.53, 114.36), atol=0.02)
    assert any("before or after the IMU left out" in note for note in first.notes)


def test_one_recording_that_fails_costs_the_others_nothing(rehearsal, tmp_path, capsys):
    chosen = [p for p in rehearsal.RELEASE if p.name in ("campus-01", "suburb-01")]
    rehearsal.write_release(tmp_path / "downloads", 60.0, chosen)
    (tmp_path / "answers.toml").write_text(rehearsal.ANSWERS)
    site = tmp_path / "site"
    command = [
        "great", str(tmp_path / "downloads"), "--out", str(site), "--declared",
        str(tmp_path / "answers.toml"), "--skip", "tune,compare", *FEW,
    ]  # fmt: skip
    assert certnav([*command[:-2], "--jobs", "0"]) == 1 and not site.exists()
    archives = [str(file) for file in sorted((tmp_path / "downloads").rglob("*.*"))]
    assert certnav(["datasets", "import", *archives, "--to", str(site / "data")]) == 0
    broken = site / "data" / "Dataset_suburb-01" / "IMU" / "MEMS_imu_data.txt"
    broken.write_text("".join(broken.read_text().splitlines(keepends=True)[:40]))
    capsys.readouterr()
    assert certnav(["great", "--data", str(site / "data"), *command[2:]]) == 1
    said = capsys.readouterr().out
    assert "suburb-01-simulated left out" in said
    content = json.loads((site / "great.json").read_text())
    assert [run["recording"] for run in content["runs"]] == ["Dataset_campus-01-simulated"]
    assert "suburb-01" in (site / "index.html").read_text()
