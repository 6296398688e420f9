"""Which settings a run should have: candidates judged by the filter, the default among them.

Recommended is the candidate of least error if it is better than the default beyond doubt: on the
recordings, and where each choice is made without the data it is judged by; and if it is worse than
the default beyond doubt in no part of any recording, by more than a table shows. Otherwise the
default stays, and what decided is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from collections.abc import Sequence as Listing
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from ...datasets.sequence import Sequence
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ...velocity.doppler_noise import NoiseFit
from ..config import Config, GnssConfig
from ..engine.prepared import offered_by
from ..spells.outages import Outages, parse_outages
from ..sweep.drives import Source, drive
from ..sweep.parallel import in_parallel
from ..sweep.shared import Shared
from .candidates import SNR, Candidate, K, candidates
from .choice import Change, Group, best, by_time, change, cross_validated, of_candidate
from .trials import (
    FOLDS,
    Prepared,
    Trial,
    centres,
    forget,
    pooled,
    prepare,
    try_out,
    weights_for,
)

#: Two or three satellites, of any strength, for half of the time.
OUTAGES = parse_outages("30/60:2-3")
#: A change that three digits show: below, an interval beside zero says nothing of use.
SEEN = 5e-4
#: A change beyond tenfold is told as such: of few spells intervals reach anywhere.
_HUGE = 10.0


@dataclass(frozen=True, eq=False)
class Settings:
    """Outcome of `tune_settings`.

    Attributes
    ----------
    candidates : tuple of Candidate
        The default first.
    groups : tuple of Group
        Errors by recording and part.
    changes : tuple of Change
        Of every candidate against the default, over all groups.
    held : tuple of float
        Share of the epochs in spells of weak GNSS that gave the filter something, by candidate.
    reasons : tuple of str
        Why a candidate could not be judged; '' where it could.
    best, chosen : int
        Candidate of least error, and the one recommended: 0 is the default.
    decided : str
        What decided between the two, in a sentence.
    validated : Change
        What choosing changes where the choice had not been made.
    folds : tuple of (str, int)
        What was left out, and the candidate chosen without it.
    folds_by : {'recordings', 'parts of time'}
    knee : int or None
        Candidate after which holding more costs error fastest, of those that nothing beats in
        both; None with fewer than three of them.
    fits : dict of str to dict
        Doppler noise of every recording's receiver: by spread, 'mad' and 'rms'.
    base, config : Config
        The user's own settings, and those recommended.
    outages : Outages
    notes : tuple of str
    """

    candidates: tuple[Candidate, ...]
    groups: tuple[Group, ...]
    changes: tuple[Change, ...]
    held: tuple[float, ...]
    reasons: tuple[str, ...]
    best: int
    chosen: int
    decided: str
    validated: Change
    folds: tuple[tuple[str, int], ...]
    folds_by: str
    knee: int | None
    fits: dict[str, dict[str, NoiseFit]]
    base: Config
    config: Config
    outages: Outages
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Settings: {self.candidates[self.chosen].name}; {self.decided}>"

    @property
    def recordings(self) -> list[str]:
        """Names, in order."""
        return list(dict.fromkeys(group.recording for group in self.groups))

    def rms(self, candidate: int, part: str) -> float:
        """Return the RMS over all recordings' blocks of a part [m]; NaN where there are none."""
        values = [g.rms(candidate) ** 2 for g in self.groups if g.part == part]
        return float(np.sqrt(np.mean(values))) if values else float("nan")

    def change_in(self, candidate: int, part: str) -> Change | None:
        """Return what a candidate changes in one part alone; None where there is none."""
        groups = [g for g in self.groups if g.part == part]
        return of_candidate(groups, candidate) if groups else None


def tune_settings(
    sources: Iterable[Source],
    *,
    config: Config | None = None,
    snr: Iterable[float] = SNR,
    k: Iterable[float] = K,
    outages: Outages = OUTAGES,
    jobs: int = -1,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Settings:
    """Return the settings a run should have, with all that is behind them.

    Parameters
    ----------
    sources : iterable of path or Sequence
        Drives with IMU and raw Doppler, and a reference if possible.
    config : Config, optional
        The user's own settings: the default that candidates are held against.
    snr, k : iterable of float
        Thresholds of DDIA-VE to try [dB-Hz], [1].
    outages : Outages
        How GNSS is made weak.
    jobs : int
        Processes on this machine; −1: as many as processors.
    scheduler : str, optional
        Address of a Dask scheduler; every worker loads what it runs.
    progress : callable, optional
        Told the fraction done and what is being done.

    Raises
    ------
    NavError
        If a recording has no Doppler, cannot be navigated, or is too short to divide.
    """
    base, say = config or Config(), progress or (lambda fraction, what: None)
    drives = [drive(source, base.data) for source in sources]
    if not drives:
        raise ConfigError("tune: no recording given")
    tried = candidates(base, snr, k)
    all_gnss = [c.config(base, None).gnss for c in tried if not c.weights]
    least_cn0 = min(g.min_cn0_dbhz for g in all_gnss)
    least_elevation = min(g.elevation_mask_deg for g in all_gnss)
    say(0.0, "default settings")
    calls = [(one, base, outages, least_cn0, least_elevation) for one in drives]
    ready = distinct(list(in_parallel(prepare, calls, jobs=jobs, scheduler=scheduler)))
    work, where = _work(drives, ready, tried, base)
    trials = [[Trial(reason="no weights could be fitted") for _ in ready] for _ in tried]
    found = in_parallel(try_out, work, jobs=jobs, scheduler=scheduler)
    for done, (trial, (number, recording)) in enumerate(zip(found, where, strict=True), 1):
        trials[number][recording] = trial
        say(done / len(work), f"{tried[number].name}: {ready[recording].name}")
    forget()
    return _settled(tried, ready, trials, base, outages)


def _work(
    drives: list[Shared[Sequence]], ready: list[Prepared], tried: list[Candidate], base: Config
) -> tuple[list[tuple], list[tuple[int, int]]]:
    """Return the calls of all trials, drive by drive, and the candidate and recording of each.

    Candidates with the same GNSS follow one another: that is kept for them, but not for long.
    """
    work: list[tuple] = []
    where: list[tuple[int, int]] = []
    for recording, (source, one) in enumerate(zip(drives, ready, strict=True)):
        alike: dict[GnssConfig, list[tuple[int, tuple]]] = {}
        for number, candidate in enumerate(tried):
            configs: tuple[Config, ...] = (candidate.config(base),) if not candidate.weights else ()
            if candidate.weights:
                others = [o for o in ready if o is not one]
                known = weights_for(one, others, candidate.weights)
                configs = tuple(candidate.config(base, weights) for weights in known or ())
            if configs:
                alike.setdefault(offered_by(configs[0]).gnss, []).append((number, configs))
        for number, configs in chain(*alike.values()):
            work.append((source, one, configs))
            where.append((number, recording))
    return work, where


def _settled(
    tried: list[Candidate],
    ready: list[Prepared],
    trials: list[list[Trial]],
    base: Config,
    outages: Outages,
) -> Settings:
    """Put the trials together and decide."""
    for one, trial in zip(ready, trials[0], strict=True):
        if trial.reason:
            raise DataError(
                f"{one.name}: the settings as they are cannot be judged: {trial.reason}"
            )
    groups = tuple(
        group for number, one in enumerate(ready) for group in _groups(one, trials, number)
    )
    if not groups:
        raise DataError(
            "tune: nothing to judge by: no reference, and no spell of weak GNSS fits",
            remedy="give longer recordings, or ones with a reference",
        )
    changes = tuple(of_candidate(groups, k) for k in range(len(tried)))
    leader = best(groups)
    validated, folds = cross_validated(groups)
    fits = {
        one.name: {spread: one.fits[spread, "all"] for spread in ("mad", "rms")}
        for one in ready
        if one.fits
    }
    names = [c.name for c in tried]
    chosen, decided = decide(groups, names, changes, leader, validated)
    with np.errstate(all="ignore"):
        held = tuple(
            float(np.mean([t.held for t in row if np.isfinite(t.held)] or [np.nan]))
            for row in trials
        )
    weights = tried[chosen].weights
    known = pooled(ready, weights) if weights else None
    out = Settings(
        candidates=tuple(tried),
        groups=groups,
        changes=changes,
        held=held,
        reasons=tuple(next((t.reason for t in row if t.reason), "") for row in trials),
        best=leader,
        chosen=chosen,
        decided=decided,
        validated=validated,
        folds=tuple(folds),
        folds_by="parts of time" if by_time(groups) else "recordings",
        knee=None,
        fits=fits,
        base=base,
        config=tried[chosen].config(base, known),
        outages=outages,
        notes=tuple(note for one in ready for note in one.notes),
    )
    drift = [out.rms(number, "weak GNSS") for number in range(len(tried))]
    return replace(out, knee=knee(out.held, drift))


def _groups(one: Prepared, trials: list[list[Trial]], number: int) -> list[Group]:
    """Return the groups of one recording; what could not be judged is infinitely wrong."""
    out = []
    for part, centre in centres(one).items():
        rows = [row[number].square.get(part, np.full(centre.size, np.inf)) for row in trials]
        weight = np.ones(centre.size)
        if part == "as recorded":
            weight = np.bincount(one.block, minlength=centre.size).astype(float)
        span = max(float(one.time[-1] - one.time[0]), 1e-9)
        fold = np.clip(FOLDS * (centre - one.time[0]) / span, 0, FOLDS - 1).astype(np.int64)
        out.append(Group(one.name, part, np.array(rows), weight, fold))
    return out


def decide(
    groups: Listing[Group],
    names: Listing[str],
    changes: Listing[Change],
    leader: int,
    validated: Change,
) -> tuple[int, str]:
    """Return the candidate to take, and what decided."""
    lead = changes[leader]
    if leader == 0:
        return 0, "nothing tried has less error than the settings as they are"
    name = names[leader]
    if not lead.better:
        return 0, (
            f"keep the settings as they are: the least error, of '{name}', is "
            f"{interval(lead)}, which does not exclude zero"
        )
    if not validated.better:
        return 0, (
            f"keep the settings as they are: '{name}' is {interval(lead)}, but chosen without the "
            f"data it is judged by, {interval(validated)}, which does not exclude zero"
        )
    for group in groups:
        alone = change([group], [group.square[leader]])
        if alone.worse and alone.high > SEEN:
            return 0, (
                f"keep the settings as they are: '{name}' is {interval(lead)}, but on "
                f"{group.recording}, {group.part}, {interval(alone)}"
            )
    return leader, (
        f"'{name}' is {interval(lead)}, and {interval(validated)} chosen without the data it is "
        "judged by: both exclude zero"
    )


def interval(value: Change) -> str:
    """Return a change in words."""
    if not np.isfinite([value.value, value.low, value.high]).all():
        return "not known"
    middle, low, high = (
        f"{100.0 * v:+.1f}".replace("-", "−") if v < _HUGE else f"> +{100.0 * _HUGE:.0f}"
        for v in (value.value, value.low, value.high)
    )
    return f"{middle} % [{low}, {high}]"


def knee(held: Listing[float], error: Listing[float]) -> int | None:
    """Return where a curve of error over what is held bends: farthest from its chord.

    Of the candidates that none beats in both, ln(error) over the share held, each scaled to its
    range; None with fewer than three.
    """
    share, wrong = np.array(held), np.array(error)
    known = np.isfinite(share) & np.isfinite(wrong) & (wrong > 0.0)
    front = [k for k in np.flatnonzero(known) if not _beaten(k, share, wrong, known)]
    _, first = np.unique(np.column_stack([share, wrong])[front], axis=0, return_index=True)
    front = [front[i] for i in first]
    if len(front) < 3:
        return None
    x, y = share[front], np.log(wrong[front])
    x, y = (x - x[0]) / (x[-1] - x[0]), (y - y[0]) / (y[-1] - y[0])
    return int(front[int(np.argmax(x - y))])


def _beaten(k: np.intp, share: FloatArray, wrong: FloatArray, known: np.ndarray) -> bool:
    better = known & (share >= share[k]) & (wrong <= wrong[k])
    return bool((better & ((share > share[k]) | (wrong < wrong[k]))).any())


def distinct(found: list[Prepared]) -> list[Prepared]:
    """Return the recordings with names made unique: two may share a folder's name."""
    seen: dict[str, int] = {}
    out = []
    for one in found:
        seen[one.name] = seen.get(one.name, 0) + 1
        number = seen[one.name]
        out.append(one if number == 1 else replace(one, name=f"{one.name} ({number})"))
    return out
