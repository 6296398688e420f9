"""Result directories in a comparison: what they must know of it, and how they are merged."""

from __future__ import annotations

import json
from collections.abc import Sequence as Listing
from pathlib import Path
from typing import Any

from ...filters.earth import lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..results.directory import is_result, read_result
from ..spells.outages import Spell
from .runs import Comparison, Run, reduced, thin_track

#: What stands beside a result directory's files when it took part in a comparison.
SIDECAR = "comparison-run.json"


def write_sidecar(out: Path, run: Run, spells: Listing[Spell], outages: str) -> None:
    """Write what a result directory must know to take part in a comparison again."""
    content = {
        "method": run.method, "sequence": run.sequence, "variant": run.variant,
        "outages": outages, "spells": spells, "availability": run.availability,
    }  # fmt: skip
    (out / SIDECAR).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def merge(directories: list[Path]) -> Comparison:
    """Return the comparison of result directories made elsewhere.

    Parameters
    ----------
    directories : list of Path
        Result directories, or folders that hold some, at any depth.

    A result that took part in a comparison brings its spells along; a plain run has none, is
    called by its directory, and is compared by its errors alone.

    Raises
    ------
    DataError
        If there is no result directory, or one of them is damaged.
    """
    found: list[Path] = []
    for directory in map(Path, directories):
        if not directory.is_dir():
            problem = "no such directory"
            if directory.exists():
                problem = "expected a result directory, found a file"
            raise DataError(problem, file=directory, remedy="name result directories")
        below = [directory, *sorted(p.parent for p in directory.rglob("summary.json"))]
        inside = [p for p in dict.fromkeys(below) if is_result(p)]
        if not inside:
            raise DataError(
                "holds no certnav result", file=directory, remedy="give what a run has written"
            )
        found += inside
    reference: dict[str, FloatArray] = {}
    runs, outages = [], []
    for path in dict.fromkeys(p.resolve() for p in found):
        run, spec, track = _run_from(path)
        runs.append(run)
        outages.append(spec)
        if track is not None:
            reference.setdefault(run.sequence, track)
    order = list(dict.fromkeys(run.method for run in runs))
    runs.sort(key=lambda run: order.index(run.method))
    spec = ", ".join(dict.fromkeys(s for s in outages if s))
    return Comparison(
        tuple(runs), reference, spec, (f"merged from {len(runs)} result directories",)
    )


def _run_from(path: Path) -> tuple[Run, str, FloatArray | None]:
    result = read_result(path)
    about: dict[str, Any] = {}
    if (path / SIDECAR).is_file():
        try:
            about = json.loads((path / SIDECAR).read_text(encoding="utf-8"))
            spells = [Spell(float(start), float(end)) for start, end in about["spells"]]
            names = about["method"], about["sequence"], about["variant"]
        except (ValueError, KeyError, TypeError):
            raise DataError("not as certnav writes it", file=path / SIDECAR) from None
    else:
        spells, names = [], (path.name, result.name, "")
    evaluation = result.evaluation
    track = None
    if evaluation.has_reference:
        track = thin_track(lla_to_ecef(*evaluation.ref_lla.T))
    run = reduced(
        *names, result.solution, evaluation, spells,
        availability=float(about.get("availability") or 1.0),
    )  # fmt: skip
    return run, str(about.get("outages", "")), track
