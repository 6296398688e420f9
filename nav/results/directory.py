"""The result directory of a run: what is in it, written in one move and read back whole.

=====================  ========================================================================
solution.csv           the IMU's trajectory, one row per output epoch (`nav.results.tables`), unless
                       only other formats were asked for
updates.csv            every measurement offered to the filter and what became of it:
                       time_gps_s, kind, satellites (space separated), whitened innovation
                       w1, w2, w3 …, nis, dof, accepted (1 or 0), reason
separation.csv         forward and backward against smoothed positions, and χ² of what is between
                       them (`nav.solution.Separation`); smoothed runs only
epochs.csv             GNSS epochs: time_gps_s, satellites tracked, satellites usable
signals.csv            every satellite signal: C/N0, direction, residual, and why it was not used;
                       only where there were observations
alignment.csv          attempts to align in motion: time_gps_s, message (what was missing); only
                       when there were any
reference_errors.csv   solution − reference at each compared reference epoch, with the filter's
                       3σ; only when there is a reference
config.toml            the configuration in force
summary.json           figures of the run; strict JSON, what is not known is null
report.html            all of it for people, unless it was left out
solution.pos …         exports that were asked for (`nav.results.formats`)
SHA256SUMS             checksums of all these: ``sha256sum --check SHA256SUMS`` (`datasets.placing`)
=====================  ========================================================================
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.placing import SEAL, current, seal, written_whole
from ...datasets.sequence import Sequence
from ...filters.errors import DataError
from ..config import Config
from ..config_files import to_toml
from ..evaluation.accuracy import Evaluation, without_reference
from ..notes import Note
from ..solution import AlignmentReport, FixErrors, Protection, Resolution, Solution
from .formats import check_formats, write_formats
from .summary import strict, summarise
from .tables import (
    read_attempts,
    read_epochs,
    read_errors,
    read_separation,
    read_signals,
    read_solution,
    read_updates,
    write_attempts,
    write_epochs,
    write_errors,
    write_separation,
    write_signals,
    write_solution,
    write_updates,
)

#: How often a result that is replaced while it is read is read anew.
_TRIES = 10


@dataclass(frozen=True, eq=False)
class Result:
    """A result directory, read back.

    Parameters
    ----------
    path : Path
    solution : Solution
        With diagonal covariances (see `nav.results.tables`).
    evaluation : Evaluation
    summary : dict
        summary.json as it stands.
    config_text : str
        config.toml as it stands.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, load
    >>> from certnav.datasets.great.writer import simulate_folder
    >>> from certnav.nav import Config, evaluate, navigate, read_result, write_result
    >>> folder = simulate_folder(SimulationConfig("city", duration=90.0, density="open"), "city")
    >>> sequence = load(folder)
    >>> solution = navigate(sequence, Config())
    >>> out = write_result("result", solution, evaluate(solution, sequence), sequence, Config())
    >>> result = read_result(out)
    >>> result.summary["status"], len(result.solution.trajectory) == len(solution.trajectory)
    ('ok', True)
    """

    path: Path
    solution: Solution
    evaluation: Evaluation
    summary: dict[str, Any]
    config_text: str

    def __repr__(self) -> str:
        rms = self.evaluation.metrics["horizontal_rms_m"]
        judged = "no reference" if rms is None else f"horizontal RMS {rms:.3g} m"
        epochs = len(self.solution.trajectory)
        return f"<Result '{self.name}', {epochs} epochs, {judged}, in {self.path}>"

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.solution.name


def write_result(
    out: Path,
    solution: Solution,
    evaluation: Evaluation,
    sequence: Sequence,
    config: Config | str,
    formats: Iterable[str] = (),
    *,
    draw: Callable[[Path], object] | None = None,
    table: bool = True,
) -> Path:
    """Write the result directory `out` completely or not at all; an earlier result is replaced.

    Parameters
    ----------
    out : path
    solution : Solution
    evaluation : Evaluation
    sequence : Sequence
        What was navigated; its size, sensors and notes go into the summary.
    config : Config or str
        Configuration in force; a text is written as it stands.
    formats : iterable of str
        Exports to add, keys of `nav.results.formats.FORMATS`.
    draw : callable, optional
        Adds pages to the directory once all else is in it, for example
        `nav.report.run.write_report`; it takes longer than all else.
    table : bool
        Whether to write solution.csv; without it the directory cannot be read back.

    Returns
    -------
    Path
        `out`, resolved.

    Raises
    ------
    DataError
        If `out` exists and is not a result directory.
    ConfigError
        If a format is unknown.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, load
    >>> from certnav.datasets.great.writer import simulate_folder
    >>> from certnav.nav import Config, evaluate, navigate, write_result
    >>> folder = simulate_folder(SimulationConfig("city", duration=90.0, density="open"), "city")
    >>> sequence = load(folder)
    >>> solution = navigate(sequence, Config())
    >>> out = write_result("result", solution, evaluate(solution, sequence), sequence, Config())
    >>> (out / "solution.csv").exists(), (out / "summary.json").exists()
    (True, True)
    """
    out, formats = Path(out).resolve(), check_formats(formats)
    check_replaceable(out)
    with written_whole(out) as draft:
        if table:
            write_solution(draft / "solution.csv", solution.trajectory)
        write_updates(draft / "updates.csv", solution.updates)
        write_epochs(draft / "epochs.csv", solution.epochs)
        if solution.signals is not None:
            write_signals(draft / "signals.csv", solution.signals)
        if solution.separation is not None:
            write_separation(draft / "separation.csv", solution.separation)
        if solution.alignment.attempts:
            write_attempts(draft / "alignment.csv", solution.alignment.attempts)
        if evaluation.has_reference:
            write_errors(draft / "reference_errors.csv", evaluation)
        text = config if isinstance(config, str) else to_toml(config)
        (draft / "config.toml").write_text(text, encoding="utf-8")
        summary = strict(summarise(solution, evaluation, sequence))
        text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
        (draft / "summary.json").write_text(text + "\n", encoding="utf-8")
        write_formats(draft, formats, solution.trajectory, solution.epochs)
        if draw is not None:
            draw(draft)
        seal(draft)
    return out


def check_replaceable(out: Path) -> None:
    """Refuse (`DataError`) to write a result over anything but a result or an empty folder."""
    if not out.exists() or is_result(out) or (out.is_dir() and not any(out.iterdir())):
        return
    raise DataError(
        "exists and is not a certnav result directory",
        file=out,
        remedy="name another output directory, or remove this one",
    )


def is_result(path: Path) -> bool:
    """Whether `path` is a directory whose summary.json is certnav's."""
    try:
        summary = json.loads((path / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(summary, dict) and "certnav_version" in summary


def read_result(path: str | Path) -> Result:
    """Read a result directory back, whole: if a run replaces it meanwhile, the new one.

    Raises
    ------
    DataError
        If it is not one, or if a file of it is missing or damaged.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, load
    >>> from certnav.datasets.great.writer import simulate_folder
    >>> from certnav.nav import Config, evaluate, navigate, read_result, write_result
    >>> folder = simulate_folder(SimulationConfig("city", duration=90.0, density="open"), "city")
    >>> sequence = load(folder)
    >>> solution = navigate(sequence, Config())
    >>> out = write_result("result", solution, evaluate(solution, sequence), sequence, Config())
    >>> read_result(out).name
    'city'
    """
    for _ in range(_TRIES):
        there = current(Path(path))
        before = _seal(there)
        try:
            result = _read(there)
        except DataError:
            if _seal(current(Path(path))) == before:
                raise
            continue
        if _seal(there) == before:
            return result
    raise DataError("is being replaced all the time", file=path, remedy="read a copy of it")


def _seal(path: Path) -> bytes | None:
    try:
        return (path / SEAL).read_bytes()
    except OSError:
        return None


def _resolution(found: dict[str, Any] | None) -> Resolution | None:
    if found is None:
        return None
    numbers = {k: _number(found[k]) for k in ("ratio_median", "ratio_p5", "base_apart_m")}
    return Resolution(**found | numbers)


def _read(path: Path) -> Result:
    if not is_result(path):
        raise DataError(
            "not a certnav result directory (no summary.json of certnav's)",
            file=path,
            remedy="give the directory a run has written",
        )
    summary = json.loads((path / "summary.json").read_text(encoding="utf-8"))
    try:
        alignment, noise = summary["alignment"], summary["position_noise"]
        solution = Solution(
            name=summary["name"],
            trajectory=read_solution(path / "solution.csv"),
            updates=read_updates(path / "updates.csv"),
            alignment=AlignmentReport(
                alignment["status"],
                alignment["method"],
                _number(alignment["gps_time_s"]),
                _number(alignment["time_s"]),
                np.deg2rad(_number(alignment["sigma_heading_deg"])),
                alignment["message"],
                None if alignment["bound_deg"] is None else np.deg2rad(alignment["bound_deg"]),
                tuple(alignment["verdicts"].items()),
                read_attempts(path / "alignment.csv"),
            ),
            epochs=read_epochs(path / "epochs.csv"),
            notes=tuple(Note(**note) for note in summary["notes"]),
            status=summary["status"],
            fix_errors=None if noise is None else FixErrors(**noise),
            resolution=_resolution(summary["rtk"]),
            signals=read_signals(path / "signals.csv"),
            protection=_read_protection(summary["protection"]),
            separation=read_separation(path / "separation.csv"),
            timing={k: v for k, v in summary["timing"].items() if v is not None},
        )
        evaluation = _read_evaluation(path / "reference_errors.csv", summary)
    except (KeyError, TypeError) as error:
        raise DataError(
            f"expected key {error} of a certnav summary",
            file=path / "summary.json",
            remedy="written by another version? run the sequence again",
        ) from error
    return Result(path, solution, evaluation, summary, _read_text(path / "config.toml"))


def _read_protection(told: Mapping[str, Any] | None) -> Protection | None:
    if told is None:
        return None
    return Protection(told["risk"], tuple(told["covers"]), tuple(told["lacks"]))


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}", file=path) from error


def _read_evaluation(path: Path, summary: Mapping[str, Any]) -> Evaluation:
    reference = summary["reference"]
    if reference is None:
        return without_reference(summary["consistency"]["nis_mean"])
    return Evaluation(
        metrics=summary["errors"],
        consistency=summary["consistency"],
        **read_errors(path),
        misalignment_rpy=np.deg2rad([_number(v) for v in reference["misalignment_rpy_deg"]]),
        left_out=reference["epochs_left_out"],
        source=reference["source"],
        point=reference["point"],
    )
