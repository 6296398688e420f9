"""The report: one file, complete, loading nothing, in every degraded case as well."""

from __future__ import annotations

import dataclasses
from html.parser import HTMLParser

import matplotlib
import numpy as np
import pytest
from bokeh import embed
from bokeh.core.validation import check_integrity
from bokeh.model import collect_models

from certnav.filters.errors import ConfigError
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.notes import Note
from certnav.nav.page import plots
from certnav.nav.page.board import Board
from certnav.nav.page.pictures import save
from certnav.nav.page.thinning import thin
from certnav.nav.report import figures, write_figures
from certnav.nav.report.bounds import protection
from certnav.nav.report.coverage import gnss_state
from certnav.nav.report.run import write_report
from certnav.nav.report.sky import Sky
from certnav.nav.report.timeline import Timeline, start_up
from certnav.nav.report.verdict import coverage, gate_activity, verdict
from certnav.nav.results.directory import read_result, write_result
from certnav.nav.signals import Signals
from certnav.nav.solution import Protection, Separation

CONFIG = '[gate]\nnote = "<script>alert(1)</script>"\n'
VOID = {"meta", "img", "br", "input", "wbr"}
SECTIONS = ["Track", "Satellites", "Position", "Drift", "Distribution", "Velocity", "Attitude",
            "Motion", "Biases", "Updates", "Run"]  # fmt: skip
#: Without a reference nothing says how errors grow or are distributed.
CLAIMS = [s for s in SECTIONS if s not in ("Drift", "Distribution")]


class Page(HTMLParser):
    """Checks nesting, and collects headings, plots and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.plots: list[dict] = []
        self.addresses: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.addresses += [v for k, v in attrs if k in ("src", "href", "srcset", "action")]
        if attributes.get("class") == "plot":
            self.plots.append(attributes)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)
        if not {"style", "script"} & set(self.open):
            self.text += data


@pytest.fixture(autouse=True)
def checked(monkeypatch):
    """Have Bokeh check the models of every page, which outside the tests it is spared."""

    def components(models, **options):
        found = check_integrity(collect_models(*models))
        assert found.error == found.warning == []
        return embed.components(models, **options)

    monkeypatch.setattr(plots, "components", components)


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


def test_complete_report(report):
    result, page, text = report(lever_b=(0.5, 0.0, -1.0))
    assert page.headings == SECTIONS
    assert len(page.plots) == 11 and all(plot["aria-label"] for plot in page.plots)
    assert set(page.addresses) == {"solution.csv", "updates.csv", "epochs.csv", "config.toml",
                                   "reference_errors.csv", "summary.json"}  # fmt: skip
    assert len(text) < 4_000_000
    assert gate_activity(result)[0][1:] in page.text
    m = result.evaluation.metrics
    for name in ("horizontal_rms_m", "horizontal_p95_m", "up_rms_m"):
        assert f"{m[name]:.3g} m" in page.text
    assert "IMU axes <declared> right-front-up" in page.text  # escaped, so it is text
    assert "<script>alert" not in text and "<script>alert(1)</script>" in page.text
    assert "(level+course) 12.5 s after the start" in page.text


@pytest.mark.parametrize(
    ("knobs", "sections", "phrase"),
    [
        ({"duration": 60.0, "reference": False}, CLAIMS, "there is no reference"),
        ({"duration": 60.0, "observations": False}, SECTIONS, "ready-made fixes"),
        ({"duration": 0.3}, CLAIMS, "Over 0.3 s"),
        ({"duration": 0.0, "reference": False}, CLAIMS, "0 s navigated"),
    ],
    ids=["no reference", "fixes only", "short", "one epoch"],
)
def test_degraded_reports(report, knobs, sections, phrase):
    _, page, _ = report(**knobs)
    assert page.headings == sections
    assert phrase in page.text


def test_run_without_any_update(report):
    def silent(solution):
        return dataclasses.replace(solution, updates=(), notes=(), timing={})

    result, page, _ = report(silent, duration=20.0)
    assert gate_activity(result) == []
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
    assert "51 reference epochs are left out" in page.text and "Roll RMS" not in page.text


def test_a_doubt_leads_to_its_span(report):
    """A note that names seconds of week has a button that shows them; others have none."""

    def doubtful(solution):
        first = solution.trajectory.time[0]
        sow = first % 604800.0
        notes = (Note("doubtful", f"fixes wrong from SOW {sow + 5:.2f} to SOW {sow + 9:.2f}"),
                 Note("doubtful", "something is odd"))  # fmt: skip
        return dataclasses.replace(solution, notes=notes)

    result, page, text = report(doubtful, duration=20.0)
    start = result.solution.alignment.time - result.solution.alignment.waited
    begin = result.solution.trajectory.time[0] - start
    assert text.count("data-from=") == 1
    assert f'data-from="{begin + 5:.2f}" data-to="{begin + 9:.2f}"' in text
    assert "In doubt (1 of 2 doubts, the others below): fixes wrong" in page.text
    assert page.text.count("fixes wrong") == page.text.count("something is odd") == 1


def test_what_a_start_waited_for_is_said_once_a_reason():
    attempts = [
        (5.0, "not aligned: at rest, needs motion"),
        (6.0, "not aligned: in motion for 2 s, needs 10 s of it"),
        (7.0, "not aligned: in motion for 9 s, needs 10 s of it"),
        (8.0, "not aligned: heading ±2.6° 1σ (limit 1.5°), needs a turn or a rest"),
        (9.0, "certified in motion over 60 s and 60 epochs: heading ±1.4° 1σ"),
    ]
    ((plot,),) = start_up(attempts, Board(0.0, 0.0, 10.0))
    assert plot.y_range.factors[::-1] == [
        "at rest: motion", "in motion: 10 s of it", "heading: a turn or a rest",
        "certified in motion",
    ]  # fmt: skip


def test_residuals_are_drawn_on_a_scale_that_shows_their_noise():
    """Of 5 cm/s with a few of many m/s: those are at the edge, and the noise is not a line."""
    time = np.repeat(np.arange(100.0), 4)
    residual = np.random.default_rng(2).normal(0.0, 0.05, 400)
    residual[::150] = 40.0
    sats, nowhere = np.tile(["G01", "G02", "G03", "G04"], 100), np.full(400, np.nan)
    signals = Signals(
        time, sats, np.full(400, "1C"), nowhere, nowhere, nowhere, residual, np.full(400, "")
    )
    ((plot,),) = Sky(signals, Board(0.0, 0.0, 100.0)).residuals()
    drawn = plot.renderers[-1].data_source.data["y"]
    assert 0.1 < plot.y_range.end < 0.5 and np.abs(drawn).max() <= plot.y_range.end
    assert "to ±0.2 m/s" in plot.title.text


def test_figures_for_papers(result, tmp_path):
    paths = write_figures(result(duration=20.0), tmp_path / "figures", "pdf")
    assert {p.stem for p in paths} >= {"track", "position", "velocity", "attitude", "biases"}
    assert all(p.read_bytes().startswith(b"%PDF") for p in paths)
    with pytest.raises(ConfigError, match="expected pdf, svg, png, found 'gif'"):
        write_figures(result(duration=20.0), tmp_path / "other", "gif")
    assert not (tmp_path / "other").exists()


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


def test_levels_within_two_decades_have_marks_apart(report):
    """1, 2, 5 of each decade; Bokeh's own would be 1, 2, 3 … of the upper one."""
    result, *_ = report(bounded, duration=30.0, reference=False)
    for (plot,) in protection(Timeline(result, Board(0.0, 0.0, 30.0))):
        ticks = plot.left[0].ticker.ticks
        assert {1.0, 2.0, 5.0, 10.0} <= set(ticks) and 3.0 not in ticks


def test_levels_and_separation_have_their_panels(report):
    result, page, text = report(bounded, duration=30.0)
    at = page.headings.index("Position")
    assert page.headings[at + 1 : at + 3] == ["Protection level", "Forward, backward and combined"]
    assert "probability of 0.0001" in page.text and "one satellite's pseudorange" in page.text
    assert "Not covered: the <rest>" in page.text and "2.5 on the average" in page.text
    said = [plot["aria-label"] for plot in page.plots]
    assert {"Protection level of the run", "Forward, backward and combined of the run"} <= {*said}
    assert "protection level" in text and "backward" in text
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


def test_levels_are_drawn_without_a_reference_too(result, tmp_path):
    bounded_run = result(bounded, duration=20.0, reference=False)
    assert save(figures.protection, bounded_run, tmp_path / "levels.pdf")


def test_report_is_rebuilt_from_the_directory_alone(report):
    result, _, text = report(duration=20.0)
    (result.path / "report.html").unlink()
    assert write_report(result.path).read_text(encoding="utf-8") == text
    assert [p.name for p in result.path.iterdir() if p.name.startswith(".")] == []


def test_drawing_leaves_matplotlib_as_it_was(result, tmp_path):
    before = dict(matplotlib.rcParams)
    assert save(figures.satellites, result(duration=5.0), tmp_path / "satellites.svg")
    assert dict(matplotlib.rcParams) == before


def test_verdict(result):
    result = result(duration=150.0)
    epochs = result.summary["epochs"]
    assert f"{100 * epochs['ge4'] / epochs['total']:.0f} % of {epochs['total']}" in coverage(result)
    sentences = " ".join(verdict(result))
    assert "Judged against: analytic motion." in sentences
    assert "Nothing in the data or the run speaks against it." in sentences


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
