"""The settings that are tried: what Doppler below four satellites does, thresholds, weights."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from ...filters.errors import ConfigError
from ...velocity.range_rate import DopplerNoise
from ..config import Config

#: The operating point the paper recommends.
PAPER = (40.0, 0.2)
#: Thresholds of DDIA-VE that are tried unless others are asked for [dB-Hz], [1].
SNR, K = (35.0, 45.0), (0.1, 0.4)
#: Thresholds of every signal, and elevation masks: around the defaults of 35 dB-Hz and 10°.
_CN0, _MASKS = (25.0, 30.0, 35.0, 40.0), (5.0, 10.0, 15.0)
_WEIGHTS = {
    "mad": "weights fitted to undisturbed signals",
    "rms": "weights fitted with reflections",
}


@dataclass(frozen=True)
class Weights:
    """Noise of range rates as a reference has shown it.

    Parameters
    ----------
    noise : DopplerNoise
    shown : tuple of float
        σ that the same recordings show by themselves at 35 and 45 dB-Hz [m/s].
    """

    noise: DopplerNoise
    shown: tuple[float, ...]

    def keys(self) -> dict[str, Any]:
        """Return the keys of ``[gnss]`` that apply them where a recording shows the same."""
        numbers = (self.noise.sigma_45, self.noise.floor, *self.shown)
        return {
            "velocity_noise": "fitted",
            "doppler_known_mps": tuple(float(f"{v:.3g}") for v in numbers),
        }


@dataclass(frozen=True)
class Candidate:
    """Settings on trial: what differs from the user's own.

    Parameters
    ----------
    name : str
    changes : tuple of (str, value)
        Keys of ``[gnss]``.
    weights : {'', 'mad', 'rms', 'declared'}
        Which spread of the receiver's range rates σ over C/N0 is fitted to, or σ as the user's
        settings declare it; '': as a run finds it.
    """

    name: str
    changes: tuple[tuple[str, Any], ...] = ()
    weights: str = ""

    def config(self, base: Config, weights: Weights | None = None) -> Config:
        """Return the user's configuration with the changes; `weights` are what was fitted."""
        changes = dict(self.changes)
        if self.weights:
            assert weights is not None
            changes |= weights.keys()
        return replace(base, gnss=replace(base.gnss, **changes))


def insisting_keys(noise: DopplerNoise) -> dict[str, Any]:
    """Return the keys of ``[gnss]`` that make any run use these σ, to three digits."""
    return {
        "velocity_noise": "declared",
        "doppler_sigma_mps": float(f"{noise.sigma_45:.3g}"),
        "doppler_floor_mps": float(f"{noise.floor:.3g}"),
    }


def candidates(base: Config, snr: Iterable[float] = SNR, k: Iterable[float] = K) -> list[Candidate]:
    """Return what is tried, the user's own settings first and the paper's second.

    Parameters
    ----------
    base : Config
        The user's own.
    snr, k : iterable of float
        Thresholds of DDIA-VE as the filter applies them: the C/N0 of every single satellite
        [dB-Hz], and |SDV·RMD| of all that are left, not normalised.
    """
    gnss = base.gnss

    def ddia(name: str, c: float, limit: float) -> Candidate:
        keys = (("below_four", "ddia"), ("ddia_min_cn0_dbhz", c), ("ddia_min_k", limit))
        return Candidate(name, keys)

    out = [Candidate("default"), ddia("paper: DDIA-VE, 40 dB-Hz, k 0.2", *PAPER)]
    for which, words in _WEIGHTS.items():
        out.append(Candidate(words, weights=which))
    out.append(Candidate("Doppler noise as declared", weights="declared"))
    for level in _CN0:
        out.append(Candidate(f"C/N0 > {level:g} dB-Hz", (("min_cn0_dbhz", level),)))
    weak = 30.0  # what is let in by a lower threshold is weighted for what it is
    name = f"C/N0 > {weak:g} dB-Hz, {_WEIGHTS['rms']}"
    out.append(Candidate(name, (("min_cn0_dbhz", weak),), "rms"))
    for mask in _MASKS:
        out.append(Candidate(f"elevation > {mask:g}°", (("elevation_mask_deg", mask),)))
    for other in ("rows", "off"):
        name = {"rows": "rows", "off": "nothing"}[other]
        out.append(Candidate(f"{name} below four satellites", (("below_four", other),)))
    for c in snr:
        for limit in k:
            out.append(ddia(f"DDIA-VE, {c:g} dB-Hz, k {limit:g}", float(c), float(limit)))
    return _without_repeats(out, gnss)


def _without_repeats(found: list[Candidate], gnss: Any) -> list[Candidate]:
    """Return the candidates that differ from all before them, the user's settings included."""
    seen, out = set(), []
    for candidate in found:
        try:
            key = (replace(gnss, **dict(candidate.changes)), candidate.weights)
        except ConfigError as error:
            raise ConfigError(f"{candidate.name}: {error}") from None
        if key not in seen:
            seen.add(key)
            out.append(candidate)
    return out
