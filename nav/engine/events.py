"""What GNSS offers the filter, one event after the other, and how sure it is of each.

Everything offered is an event in time order; one that cannot be used carries its reason, so that
the update log tells of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...alignment.in_motion.rows import DopplerEpoch
from ...datasets.observations import GnssObservations
from ...filters.measurements import Biases
from ...filters.rotation import FloatArray
from ...velocity.range_rate import DopplerNoise
from ..config import GnssConfig

#: Share of a position's variance that successive positions have in common, where nothing better
#: is known: of a single-point position's, reflections, ionosphere and orbits are nearly all.
SHARED = 0.9


@dataclass(frozen=True, eq=False)
class GnssEvent:
    """One antenna position or velocity, or the reason why there is none.

    Parameters
    ----------
    time : float
        GPS time it belongs to [s].
    kind : {'position', 'velocity', 'doppler'}
    value_e : ndarray, shape (3,)
        ECEF [m] or [m/s]; NaN when there is none.
    cov_e : ndarray, shape (3, 3)
        Covariance as the filter is to use it [m²] or [m²/s²].
    satellites : tuple of str
        Satellites behind it, where known.
    reason : str
        Why it cannot be used; '' when it can.
    observations : GnssObservations, optional
        Usable rows of an epoch with Doppler; of kind 'doppler' where they give no least-squares
        velocity. Lines of sight are left to the filter, which knows best where it is: 1 km is
        0.2 m/s.
    epoch : DopplerEpoch, optional
        Doppler of the epoch for alignment in motion, whatever became of its velocity.
    shared : bool
        Whether part of a position's error is that of the positions around it.
    lasting_e : ndarray, shape (3, 3), optional
        Covariance of what a position shares with all others for minutes and longer [m²]: no
        filter can average it away.
    shared_cov_e : ndarray, shape (3, 3), optional
        Covariance of the part that `shared` is about [m²]; default: `SHARED` of the whole.
    resolved : bool
        Whether the ambiguities of a position's carrier phases are resolved.
    ranges : Biases, optional
        What an error of each pseudorange does to a position, and what its residuals say of it.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import lla_to_ecef
    >>> from certnav.nav import GnssEvent
    >>> pos_e, cov_e = lla_to_ecef(0.5, 2.0, 30.0), 4.0 * np.eye(3)
    >>> fix = GnssEvent(1331164800.0, "position", pos_e, cov_e, ("G01", "G05", "G07", "G12"))
    >>> fix.kind, fix.reason == ""  # it can be used
    ('position', True)
    """

    time: float
    kind: str
    value_e: FloatArray
    cov_e: FloatArray
    satellites: tuple[str, ...] = ()
    reason: str = ""
    observations: GnssObservations | None = None
    epoch: DopplerEpoch | None = None
    shared: bool = False
    lasting_e: FloatArray | None = None
    shared_cov_e: FloatArray | None = None
    resolved: bool = False
    ranges: Biases | None = None

    @property
    def sigma(self) -> float:
        """1σ per axis [m] or [m/s]."""
        return float(np.sqrt(np.trace(self.cov_e) / 3.0))

    @property
    def common_cov_e(self) -> FloatArray | None:
        """Covariance of what the positions around it share with it [m²]; None: nothing."""
        if not self.shared:
            return None
        return SHARED * self.cov_e if self.shared_cov_e is None else self.shared_cov_e


def missing(
    time: float,
    kind: str,
    reason: str,
    satellites: tuple[str, ...] = (),
    observations: GnssObservations | None = None,
    epoch: DopplerEpoch | None = None,
) -> GnssEvent:
    """Return an event without a value: see `GnssEvent`."""
    value_e, cov_e = np.full(3, np.nan), np.full((3, 3), np.nan)
    return GnssEvent(time, kind, value_e, cov_e, satellites, reason, observations, epoch)


def inflated(cov_e: FloatArray, scale: float, floor: float) -> FloatArray:
    """Return the covariance scaled, with `floor` added in variance on every axis."""
    return cov_e * scale**2 + np.eye(3) * floor**2


def doppler_noise(config: GnssConfig) -> DopplerNoise:
    """Return the range-rate noise that is configured."""
    return DopplerNoise(config.doppler_sigma_mps, config.doppler_floor_mps)
