"""What a comparison says: recordings apart, no pooling of what is not alike, plain sentences."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

from certnav.nav.compare import exports
from certnav.nav.compare.methods import METHODS
from certnav.nav.compare.report import build_page, in_words
from certnav.nav.compare.runs import TOGETHER, Comparison, Run, as_dict, tables
from certnav.nav.spells.drift import SpellFigures


def _spell(start: float, length: float, drift: float) -> SpellFigures:
    grid = np.arange(0.0, length)
    growth = drift * (grid / length) ** 2
    return SpellFigures(
        start, start + length, drift, drift, drift, drift, 0.1, 0.0, 3.0, 3.0, grid, growth
    )


def _run(method: str, sequence: str, length: float, drifts: list[float]) -> Run:
    spells = tuple(_spell(1000.0 * k, length, d) for k, d in enumerate(drifts))
    return Run(method, sequence, "@0", spells=spells)


def _comparison(*lengths: float) -> Comparison:
    runs = [
        _run(method, f"drive-{k}", length, [scale * (k + 1) * d for d in (1, 2, 3, 2, 1, 2)])
        for method, scale in (("lc4", 1.0), ("lc+rows", 0.25))
        for k, length in enumerate(lengths)
    ]
    return Comparison(tuple(runs), {f"drive-{k}": np.zeros((0, 2)) for k, _ in enumerate(lengths)},
                      "10-end:2")  # fmt: skip


def test_spells_of_50_and_590_seconds_have_no_common_median():
    apart = _comparison(50.0, 590.0)
    assert [name for name, _ in tables(apart)] == ["drive-0", "drive-1"]
    assert as_dict(apart)["methods"]["lc4"]["drift_m"]["median"] is None
    assert as_dict(apart)["recordings"]["drive-1"]["lc4"]["drift_m"]["median"] == 4.0
    page = build_page(apart)
    assert "50 s to 9 min 50 s long" in page and TOGETHER not in page


def test_spells_that_are_long_alike_are_taken_together_after_each_for_itself():
    alike = _comparison(60.0, 59.6)
    assert [name for name, _ in tables(alike)] == ["drive-0", "drive-1", TOGETHER]
    assert as_dict(alike)["methods"]["lc4"]["spells"] == 12
    page = build_page(alike)
    assert page.index("<h3>drive-0</h3>") < page.index("<h3>drive-1</h3>") < page.index(TOGETHER)


def test_every_method_is_defined_on_the_page():
    page = build_page(_comparison(60.0))
    for name in ("lc4", "lc+rows"):
        assert METHODS[name].sentence in page
    assert all(m.sentence.endswith(".") for m in METHODS.values())
    assert len({m.sentence for m in METHODS.values()}) == len(METHODS)


def test_sentences_are_shares_with_what_other_spells_would_make_of_them():
    page = build_page(_comparison(60.0))
    assert "lc+rows drifts 0.489 m where lc4 drifts 1.96 m: 25 % of it" in page
    assert "times less" not in page and "1 times" not in page
    assert in_words(0.0, (0.0, 0.0)) == "the same"
    assert in_words(-0.2, (-0.4, -0.1)) == "80 % of it (95 % interval 60 … 90 %)"
    assert "turn round" in in_words(-0.2, (-0.4, 0.1))
    assert in_words(2.0, None) == "300 % of it"


def test_tables_for_others_hold_the_same_figures():
    made = _comparison(60.0, 60.0)
    rows = list(csv.DictReader(io.StringIO(exports.figures_csv(made))))
    assert {(r["recording"], r["method"]) for r in rows} == {
        (where, method)
        for where in ("drive-0", "drive-1", TOGETHER)
        for method in ("lc4", "lc+rows")
    }
    known = as_dict(made)["recordings"]["drive-1"]["lc+rows"]
    row = next(r for r in rows if (r["recording"], r["method"]) == ("drive-1", "lc+rows"))
    assert float(row["drift_rms_m"]) == pytest.approx(known["drift_m"]["rms_of_maxima"])
    assert float(row["drift_rms_low_m"]) <= float(row["drift_rms_m"])
    spells = list(csv.DictReader(io.StringIO(exports.spells_csv(made))))
    assert len(spells) == 24 and float(spells[-1]["drift_m"]) == 1.0


def test_latex_is_balanced_and_escaped():
    runs = (_run("rtk_50%", "a_b&c", 60.0, [1.0] * 6),)
    text = exports.latex(Comparison(runs, {"a_b&c": np.zeros((0, 2))}, "60/180"))
    assert r"rtk\_50\%" in text and r"a\_b\&c" in text
    body = text[text.index(r"\toprule") : text.index(r"\bottomrule")]
    lines = [
        line for line in body.splitlines() if line.endswith(r"\\") and "multicolumn" not in line
    ]
    columns = text[text.index("{tabular}{") + len("{tabular}{") :].split("}")[0]
    assert {line.count(" & ") + 1 for line in lines} == {len(columns)}
    assert text.count(r"\begin{") == text.count(r"\end{") == 1
