"""The report: one file, complete, loading nothing, in every degraded case as well."""

from __future__ import annotations

import base64
import dataclasses
import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest

from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.page.pictures import render
from certnav.nav.report import figures
from certnav.nav.report.panels import gnss_state, thin
from certnav.nav.report.run import write_report
from certnav.nav.report.verdict import gate_activity, verdict
from certnav.nav.results.directory import read_result, write_result
from certnav.nav.solution import Protection, Separation

CONFIG = '[gate]\nnote = "<script>alert(1)</script>"\n'
VOID = {"meta", "img", "br"}
SECTIONS = ["Track", "Satellites", "Position", "Velocity", "Attitude", "Biases", "Updates", "Run"]


class Page(HTMLParser):
    """Checks nesting, and collects headings, images and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.images: list[dict] = []
        self.addresses: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.addresses += [v for k, v in attrs if k in ("src", "href", "srcset", "action")]
        if tag == "img":
            self.images.append(attributes)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)
        if "style" not in self.open:
            self.text += data


@pytest.fixture
def report(drive, tmp_path):
    """Run a made-up drive through to its result, and return that with its parsed report."""

    def make(change=lambda solution: solution, **knobs):
        solution, sequence = drive(**knobs)
        solution = change(solution)
        out = write_result(
            tmp_path / "run", solution, evaluate(solution, sequence), sequence, CONFIG,
            draw=write_report,
        )  # fmt: skip
        text = (out / "report.html").read_text(encoding="utf-8")
        return read_result(out), Page(text), text

    return make


@pytest.fixture
def result(drive, tmp_path):
    """Run a made-up drive through to its result, without drawing the report."""

    def make(change=lambda solution: solution, **knobs):
        solution, sequence = drive(**knobs)
        solution = change(solution)
        out = write_result(
            tmp_path / "run", solution, evaluate(solution, sequence), sequence, CONFIG
        )
        return read_result(out)

    return make


def svg_of(image: dict) -> str:
    prefix = "data:image/svg+xml;base64,"
    assert image["src"].startswith(prefix) and image["alt"]
    svg = base64.b64decode(image["src"][len(prefix) :]).decode()
    ElementTree.fromstring(svg)
    return svg


def test_complete_report(report):
    result, page, text = report(lever_b=(0.5, 0.0, -1.0))
    assert page.headings == SECTIONS
    assert len(page.images) == 7
    for image in page.images:
        svg = svg_of(image)
        # Inside the pictures only references to their own parts or to embedded data.
        links = re.findall(r'(?:xlink:)?href="([^"]*)"', svg)
        assert all(link.startswith(("#", "data:")) for link in links)
    assert all(a.startswith("data:") for a in page.addresses)
    assert "http" not in re.sub(r'src="data:[^"]*"', "", text) and "@import" not in text
    assert len(text) < 2_000_000
    assert gate_activity(result)[0][1:] in page.text
    m = result.evaluation.metrics
    for name in ("horizontal_rms_m", "horizontal_p95_m", "up_rms_m"):
        assert f"{m[name]:.3g} m" in page.text
    assert "IMU axes <declared> right-front-up" in page.text  # escaped, so it is text
    assert "<script>" not in text and "<script>alert(1)</script>" in page.text
    assert "level+course, 12.5 s after the start" in page.text


@pytest.mark.parametrize(
    ("knobs", "pictures", "phrase"),
    [
        ({"duration": 60.0, "reference": False}, 7, "there is no reference"),
        ({"duration": 60.0, "observations": False}, 6, "ready-made fixes"),
        ({"duration": 0.3}, 7, "Over 0.3 s"),
        ({"duration": 0.0, "reference": False}, 7, "0 s navigated"),
    ],
    ids=["no reference", "fixes only", "short", "one epoch"],
)
def test_degraded_reports(report, knobs, pictures, phrase):
    _, page, _ = report(**knobs)
    assert page.headings == SECTIONS and len(page.images) == pictures
    assert phrase in page.text
    for image in page.images:
        svg_of(image)


def test_run_without_any_update(report):
    def silent(solution):
        return dataclasses.replace(solution, updates=(), notes=(), timing={})

    result, page, _ = report(silent, duration=20.0)
    assert len(page.images) == 6 and gate_activity(result) == []
    assert "No update was offered" in page.text


def test_reference_without_attitude_and_with_a_hole(drive, tmp_path):
    solution, sequence = drive(duration=60.0)
    t = solution.trajectory.time - solution.trajectory.time[0]
    rows = (t < 20.0) | (t > 30.0)
    columns = {f.name: getattr(solution.trajectory, f.name)[rows]
               for f in dataclasses.fields(solution.trajectory)}  # fmt: skip
    solution = dataclasses.replace(solution, trajectory=type(solution.trajectory)(**columns))
    blind = dataclasses.replace(sequence.reference, rpy=np.full((301, 3), np.nan))
    sequence = dataclasses.replace(sequence, reference=blind)
    evaluation = evaluate(solution, sequence)
    out = write_result(tmp_path / "x", solution, evaluation, sequence, CONFIG, draw=write_report)
    page = Page((out / "report.html").read_text(encoding="utf-8"))
    assert "51 left out" in page.text and len(page.images) == 7


def bounded(solution):
    """Return a solution with protection levels and a separation."""
    track = solution.trajectory
    levels = np.column_stack([np.full(len(track), 12.0), np.full(len(track), 20.0)])
    time = track.time[::10]
    forward, backward = (np.tile([1.0, -2.0, 0.5], (len(time), 1)) * k for k in (1.0, -0.3))
    backward[-1] = np.nan
    chi2 = np.where(np.isfinite(backward[:, 0]), 2.5, np.nan)
    return dataclasses.replace(
        solution, trajectory=dataclasses.replace(track, protection=levels),
        protection=Protection(1e-4, ("one satellite's pseudorange",), ("the <rest>",)),
        separation=Separation(time, forward, backward, chi2),
    )  # fmt: skip


def test_levels_and_separation_have_their_panels(report):
    result, page, _ = report(bounded, duration=30.0)
    at = page.headings.index("Position")
    assert page.headings[at + 1 : at + 3] == ["Protection level", "Forward, backward and combined"]
    assert "probability of 0.0001" in page.text and "one satellite's pseudorange" in page.text
    assert "Not covered: the <rest>" in page.text and "2.5 on the average" in page.text
    for name, legend in (
        ("Protection level", "protection level"),
        ("Forward, backward and combined", "backward"),
    ):
        (image,) = (i for i in page.images if i["alt"] == f"{name} over time")
        assert legend in svg_of(image)
    back = result.solution
    assert back.protection == bounded(back).protection
    np.testing.assert_allclose(back.trajectory.protection[0], [12.0, 20.0])
    np.testing.assert_allclose(back.separation.forward_n[0], [1.0, -2.0, 0.5])
    assert np.isnan(back.separation.chi2[-1]) and np.isnan(back.separation.backward_n[-1]).all()


def test_what_was_not_asked_for_is_absent_not_zero(result):
    result = result(duration=20.0)
    assert result.solution.separation is None and result.solution.protection is None
    assert not (result.path / "separation.csv").exists()
    assert result.summary["protection"] is None and result.summary["separation"] is None
    assert np.isnan(result.solution.trajectory.protection).all()
    assert figures.protection(result) is None and figures.separation(result) is None


def test_levels_are_drawn_without_a_reference_too(result):
    assert render(figures.protection, result(bounded, duration=20.0, reference=False)) is not None


def test_report_is_rebuilt_from_the_directory_alone(report):
    result, _, text = report(duration=20.0)
    (result.path / "report.html").unlink()
    assert write_report(result.path).read_text(encoding="utf-8") == text
    assert [p.name for p in result.path.iterdir() if p.name.startswith(".")] == []


def test_drawing_leaves_matplotlib_as_it_was(result):
    before = dict(matplotlib.rcParams)
    assert render(figures.satellites, result(duration=5.0)) is not None
    assert dict(matplotlib.rcParams) == before


def test_verdict_counts(result):
    result = result(duration=150.0)
    sentences = " ".join(verdict(result))
    epochs, counts = result.summary["epochs"], result.summary["updates"]["position"]
    assert f"{100 * epochs['ge4'] / epochs['total']:.0f} % of {epochs['total']}" in sentences
    assert f"{counts['accepted']} of {counts['offered']} position updates" in sentences
    assert "Judged against: analytic motion." in sentences
    assert f"too few satellites {counts['rejected']['too few satellites']}" in sentences


@pytest.mark.parametrize(
    ("passed", "sentence"),
    [
        (lambda k: True, "position gate never fired (40 tested)"),
        (lambda k: False, "position gate fired every time (40 of 40)"),
        (lambda k: k % 20 != 0, "position gate fired 2 of 40 (5.0 %)."),
    ],
)
def test_gate_activity(result, passed, sentence):
    def gated(solution):
        update = solution.updates[0]
        assert update.kind == "position" and np.isfinite(update.nis)
        log = [dataclasses.replace(update, accepted=passed(k), reason="" if passed(k) else "gate")
               for k in range(40)]  # fmt: skip
        skipped = dataclasses.replace(update, nis=np.nan, whitened=(), accepted=False, reason="few")
        return dataclasses.replace(solution, updates=(*log, skipped))

    assert gate_activity(result(gated, duration=10.0))[0].startswith(sentence)


def test_an_overruled_gate_is_told(report):
    def overrule(solution):
        first, *rest = (u for u in solution.updates if u.accepted and u.kind == "position")
        return dataclasses.replace(
            solution, updates=(dataclasses.replace(first, reason="covariance enlarged"), *rest)
        )

    result, page, _ = report(overrule, duration=20.0)
    assert "fired 1 of" in gate_activity(result)[0] and "1 of them overruled" in page.text
    assert "covariance enlarged" in page.text


def test_thin_keeps_the_extremes():
    rng = np.random.default_rng(4)
    y = rng.normal(size=100_003)
    y[[12_345, 99_999]] = 50.0, -60.0
    y[500:700] = np.nan
    keep = thin(y, bins=200)
    assert keep.size <= 402 and {12_345, 99_999, 0, y.size - 1} <= set(keep.tolist())
    assert np.all(np.diff(keep) > 0)
    np.testing.assert_array_equal(thin(y[:50], bins=200), np.arange(50))


def test_gnss_state_of_a_set_of_fixes(result):
    result = result(duration=100.0, observations=False)
    state = gnss_state(result)
    t = result.solution.trajectory.time - result.solution.trajectory.time[0]
    # Fixes at 1 Hz are missing in (35, 45) and (70, 75) s; 3 s without one is an outage.
    assert state[(t > 39.0) & (t < 44.9)].all() and not state[(t > 50.0) & (t < 60.0)].any()
    assert set(state.tolist()) == {0, 2}
