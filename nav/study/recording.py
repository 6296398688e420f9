"""Every figure of the paper for every recording: loaded, sampled and counted one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...datasets.loading import formats, recognise, with_precise
from ...datasets.sequence import Sequence
from ...filters.errors import ConfigError, DataError, NavError
from ...velocity.study.samples import reference_samples
from ...velocity.study.tables import describe, pair_table
from ...velocity.study.unaided import EPOCHS, Outage, outages, over_outages
from ..sweep.drives import Source, drive
from ..sweep.parallel import in_parallel


@dataclass(frozen=True)
class StudyOptions:
    """What is studied.

    Parameters
    ----------
    systems : str
        Constellation letters; the paper has GPS alone.
    direction : {'motion', 'attitude'}
        Direction of motion from the reference's velocity, which is free of mounting and lever
        arm, or from its attitude, as DDIA-VE has it (`velocity.study.samples`). Table 4 is always
        of attitudes.
    label : str
        Only rows the data set labels so ('los').
    epochs : int
        Of an outage, for Table 4.
    """

    systems: str = "G"
    direction: str = "motion"
    label: str = ""
    epochs: int = EPOCHS

    def __post_init__(self) -> None:
        if self.direction not in ("motion", "attitude"):
            raise ConfigError(
                f"direction: expected 'motion' or 'attitude', found '{self.direction}'"
            )
        if not self.systems.isalpha():
            raise ConfigError(f"systems: expected constellation letters, found '{self.systems}'")
        if self.epochs < 2:
            raise ConfigError(f"epochs: expected 2 or more, found {self.epochs}")


@dataclass(frozen=True, eq=False)
class Studied:
    """One recording.

    Parameters
    ----------
    name : str
    figures : dict
        See `velocity.study.tables.describe`; empty where the Doppler cannot be judged.
    attitude : dict
        See `velocity.study.unaided.over_outages`; empty where there is nothing to compare.
    outages : tuple of Outage
    epochs : int
        With Doppler and a reference.
    notes : tuple of str
        Epochs left out, figures that could not be made, and why.
    """

    name: str
    figures: dict[str, Any]
    attitude: dict[str, Any]
    outages: tuple[Outage, ...] = ()
    epochs: int = 0
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        pairs = self.figures.get("pairs", 0)
        return f"Studied({self.name!r}, {self.epochs} epochs, {pairs} pairs)"

    def at(self, snr: float, k: float) -> dict[str, Any]:
        """Return the cell of Fig. 8 with these thresholds; empty off the grid."""
        cells = self.figures.get("heatmap", ())
        return next((c for c in cells if (c["snr"], c["k"]) == (snr, k)), {})


@dataclass(frozen=True, eq=False)
class Study:
    """All recordings, and what was asked."""

    recordings: tuple[Studied, ...]
    options: StudyOptions

    def __repr__(self) -> str:
        return f"<Study of {', '.join(r.name for r in self.recordings)}>"


def study(
    sources: Iterable[Source],
    options: StudyOptions | None = None,
    *,
    data: dict[str, Any] | None = None,
    precise: Iterable[str | Path] = (),
    jobs: int = -1,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Study:
    """Return the paper's statistics of every recording.

    Parameters
    ----------
    sources : iterable of path or Sequence
        With raw Doppler and a reference; one that lacks them stays in the study and says so.
    options : StudyOptions, optional
    data : dict, optional
        Options of readers; each goes to the recordings whose reader knows it.
    precise : iterable of path
        Precise products (`datasets.rtklib.precise`) of any days: what they cover is studied twice,
        with broadcast and with precise ephemerides.
    jobs : int
        Processes on this machine; −1: as many as processors.
    scheduler : str, optional
        Address of a Dask scheduler; every worker loads what it studies.
    progress : callable, optional
        Told the fraction done and what is being done.

    Raises
    ------
    DataError
        A recording that cannot be read, or none whose Doppler can be judged.
    ConfigError
        An option that no reader knows.
    """
    options, say = options or StudyOptions(), progress or (lambda fraction, what: None)
    sources = list(sources)
    if not sources:
        raise ConfigError("study: no recording given")
    products = tuple(str(Path(file).resolve()) for file in precise)
    shared = [drive(source, own) for source, own in with_options(sources, data or {})]
    calls = [(one, options, used) for one in shared for used in dict.fromkeys(((), products))]
    found: list[Studied] = []
    for one in in_parallel(studied, calls, jobs=jobs, scheduler=scheduler):
        found.append(one)
        say(len(found) / len(calls), one.name)
    if not any(one.figures for one in found):
        raise DataError("; ".join(note for one in found for note in one.notes))
    return Study(tuple(distinct(found)), options)


def with_options(
    sources: list[Source], data: dict[str, Any]
) -> list[tuple[Source, dict[str, Any]]]:
    """Return each source with those reader's options that its reader knows.

    Raises
    ------
    ConfigError
        If no reader knows one of them.
    """
    known = [
        () if isinstance(s, Sequence) or not data else (*formats()[recognise(s)].options, "precise")
        for s in sources
    ]
    for key in data:
        if not any(key in keys for keys in known):
            everything = sorted({k for keys in known for k in keys})
            raise ConfigError.unknown_key(key, everything, where="data")
    return [
        (source, {key: value for key, value in data.items() if key in keys})
        for source, keys in zip(sources, known, strict=True)
    ]


def studied(sequence: Sequence, options: StudyOptions, precise: tuple[str, ...] = ()) -> Studied:
    """Return the figures of one recording: the unit of work of a sweep."""
    notes: list[str] = []
    if precise:
        name = f"{sequence.name}, precise"
        try:
            sequence = with_precise(sequence, precise)
        except DataError as error:
            return Studied(name, {}, {}, notes=(f"{name}: {error}",))
        notes.append(f"{name}: {sequence.notes[-1]}")
        sequence = replace(sequence, name=name)
    figures: dict[str, Any] = {}
    epochs = 0
    try:
        samples = reference_samples(
            sequence, direction=options.direction, systems=options.systems, label=options.label
        )
        epochs = samples.time.size
        figures = describe(pair_table(samples))
        notes += [f"{sequence.name}: {n} epochs left out: {w}" for w, n in samples.left_out.items()]
        if not figures["pairs"]:
            without = figures["unknown_cn0"]
            why = f"no two satellites of '{options.systems}' at once"
            if without:
                why = f"none of {without} pairs has a C/N0"
            figures = {}
            notes.append(f"{sequence.name}: {why}")
        elif figures["unknown_cn0"]:
            notes.append(f"{sequence.name}: {figures['unknown_cn0']} pairs without C/N0 left out")
    except DataError as error:
        notes.append(str(error))
    found: tuple[Outage, ...] = ()
    if figures:
        try:
            found = tuple(outages(sequence, epochs=options.epochs, systems=options.systems))
        except NavError as error:
            notes.append(f"no Table 4: {error}")
    return Studied(
        name=sequence.name,
        figures=figures,
        attitude=over_outages(found) if found else {},
        outages=found,
        epochs=epochs,
        notes=tuple(notes),
    )


def distinct(found: list[Studied]) -> list[Studied]:
    """Return the recordings with names made unique: two may share a folder's name."""
    out: list[Studied] = []
    seen: dict[str, int] = {}
    for one in found:
        seen[one.name] = seen.get(one.name, 0) + 1
        number = seen[one.name]
        out.append(one if number == 1 else replace(one, name=f"{one.name} ({number})"))
    return out
