"""What a run produces: the trajectory of the IMU with covariance, and the log of every update."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields

import numpy as np

from ..filters.rotation import FloatArray
from .installation import Installation
from .notes import Note
from .signals import Signals

#: Kinds of update the pipeline offers to the filter.
UPDATE_KINDS = ("position", "velocity", "doppler", "nhc", "zupt", "zaru", "odometer")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Navigation solution of the IMU, one row per output epoch.

    Parameters
    ----------
    time : ndarray, shape (n,)
        GPS time [s].
    pos_e, vel_e : ndarray, shape (n, 3)
        ECEF position [m] and velocity [m/s] of the IMU.
    C_eb : ndarray, shape (n, 3, 3)
        Attitude: ``C_eb @ x_b == x_e``.
    gyro_bias, accel_bias : ndarray, shape (n, 3)
        [rad/s], [m/s²], body axes: measured − true.
    cov_pos_n, cov_vel_n, cov_att_n : ndarray, shape (n, 3, 3)
        Covariance of position [m²], velocity [m²/s²] and attitude error vector [rad²] in
        north-east-down axes. The attitude error vector is the small rotation about north, east
        and down from the estimated to the true attitude; its down component is the heading error.
    std_gyro_bias, std_accel_bias : ndarray, shape (n, 3)
        1σ of the biases.
    protection : ndarray, shape (n, 2), optional
        Horizontal and vertical protection level of the position [m], see `Protection`; NaN without.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import C_en_of, lla_to_ecef
    >>> from certnav.nav import Trajectory
    >>> pos_e, zero = np.tile(lla_to_ecef(0.5, 2.0, 30.0), (2, 1)), np.zeros((2, 3))
    >>> cov = np.tile(0.01 * np.eye(3), (2, 1, 1))
    >>> motion = np.arange(2.0), pos_e, zero, C_en_of(pos_e)
    >>> trajectory = Trajectory(*motion, zero, zero, cov, cov, cov, zero, zero)
    >>> len(trajectory)
    2
    """

    time: FloatArray
    pos_e: FloatArray
    vel_e: FloatArray
    C_eb: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray
    cov_pos_n: FloatArray
    cov_vel_n: FloatArray
    cov_att_n: FloatArray
    std_gyro_bias: FloatArray
    std_accel_bias: FloatArray
    protection: FloatArray = field(default_factory=lambda: np.empty((0, 2)))

    def __post_init__(self) -> None:
        if len(self.protection) != len(self):
            object.__setattr__(self, "protection", np.full((len(self), 2), np.nan))

    def __len__(self) -> int:
        return self.time.size

    def parts(self, rows: int = 16384) -> Iterator[Trajectory]:
        """Yield it in pieces of so many rows at most, for what would fill the memory at once."""
        for start in range(0, len(self), rows):
            piece = slice(start, start + rows)
            yield Trajectory(*(getattr(self, f.name)[piece] for f in fields(self)))


@dataclass(frozen=True)
class Update:
    """One measurement offered to the filter, and what became of it.

    Parameters
    ----------
    time : float
        GPS time [s].
    kind : str
        'position', 'velocity' …
    satellites : tuple of str
        Satellites behind it; empty when unknown or when none.
    whitened : tuple of float
        Innovation times the inverse Cholesky factor of its covariance: independent and of unit
        variance when model and noise are right. Empty when the update was not computed.
    nis : float
        Normalised innovation squared; NaN when the update was not computed.
    accepted : bool
    reason : str
        Why not accepted; '' when accepted in the ordinary way.

    Examples
    --------
    >>> from certnav.nav import Update
    >>> update = Update(1331164800.0, "position", ("G01", "G05"), (0.3, -1.2, 0.5), 1.78, True)
    >>> update.accepted, update.nis
    (True, 1.78)
    """

    time: float
    kind: str
    satellites: tuple[str, ...] = ()
    whitened: tuple[float, ...] = ()
    nis: float = float("nan")
    accepted: bool = False
    reason: str = ""


@dataclass(frozen=True)
class AlignmentReport:
    """How the initial attitude was found.

    Parameters
    ----------
    status : str
        'aligned', 'given' or 'failed'.
    method : str
        For example 'level+course'.
    time : float
        GPS time of the first solution epoch [s].
    waited : float
        From the start of the data to `time` [s].
    sigma_heading : float
        1σ of the initial heading [rad].
    message : str
        One line for people.
    bound : float, optional
        Certified: largest attitude error within the 3σ region, proved [rad].
    verdicts : tuple of (str, str)
        Certified: name of each verdict that was passed, and what it says.
    attempts : tuple of (float, str)
        GPS time of each certified attempt [s], and what it was waiting for or found.
    """

    status: str
    method: str
    time: float
    waited: float
    sigma_heading: float
    message: str = ""
    bound: float | None = None
    verdicts: tuple[tuple[str, str], ...] = ()
    attempts: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True)
class FixErrors:
    """How large the errors of positions are, and how much of them lasts.

    Parameters
    ----------
    scale : float
        True over declared σ.
    share : float
        Of the variance, what successive positions have in common; 0: nothing.
    correlation_s : float
        How long that lasts [s].
    meaning : {'steady', 'allowance'}
        What the declared variance stands for (`nav.engine.fix_noise.estimate`).
    usual_n : tuple of float
        What of it is usual, north, east, down [m²].
    gain : float
        Log units by which sharing explains the innovations better.
    spread : float
        1σ of ln of the scale.
    """

    scale: float
    share: float
    correlation_s: float
    meaning: str
    usual_n: tuple[float, ...]
    gain: float
    spread: float


@dataclass(frozen=True)
class Resolution:
    """Positions relative to a base station: how many are resolved, and how surely.

    Parameters
    ----------
    fixed, floating, dgps, single : int
        Positions with resolved ambiguities, with real-valued ones, of code alone, and those that
        stayed single-point ones.
    contradicted : int
        Of the single-point ones, those that the relative position contradicts, whatever it is
        called: see `nav.engine.relative`.
    ratio_median, ratio_p5 : float
        Of the second-best to the best integer ambiguities of the fixed ones, median and 5 %.
    systems : str
    frequencies : int
        Constellation letters and bands used.
    direction : {'forward', 'backward', 'combined'}
    base_apart_m : float
        From the base's position as taken to where its own pseudoranges have it [m]; NaN: unknown.
    """

    fixed: int
    floating: int
    dgps: int
    single: int
    contradicted: int
    ratio_median: float
    ratio_p5: float
    systems: str
    frequencies: int
    direction: str
    base_apart_m: float

    @property
    def shares(self) -> str:
        """How many positions are what, in words."""
        offered = self.fixed + self.floating + self.dgps + self.single
        if not offered:
            return "no positions"
        said = f"{self.fixed} fixed ({100.0 * self.fixed / offered:.0f} %), {self.floating} float"
        without = self.single - self.contradicted
        for count, words in (
            (self.dgps, "of code alone"),
            (self.contradicted, "contradicted by their pseudoranges"),
            (without, "without a relative position"),
        ):
            said += f", {count} {words}" if count else ""
        return said + (f"; ratio {self.ratio_median:.1f}" if self.fixed else "")


@dataclass(frozen=True)
class Protection:
    """What the protection levels of a trajectory stand for.

    Parameters
    ----------
    risk : float
        Probability of an error beyond the level, horizontally and vertically each.
    covers : tuple of str
        What may be wrong without the level being exceeded more often: one of these at a time, and
        for as long as it likes.
    lacks : tuple of str
        What may not, because nothing is known of it beyond its σ.
    """

    risk: float
    covers: tuple[str, ...]
    lacks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Separation:
    """What earlier and later data say of the position, against both together; smoothed runs only.

    Parameters
    ----------
    time : ndarray, shape (m,)
        GPS time [s].
    forward_n, backward_n : ndarray, shape (m, 3)
        Position from the data before each epoch, and what the data from it on make of it, less the
        smoothed one, north, east, down [m]; NaN where the later data do not know it.
    chi2 : ndarray, shape (m,)
        Square of what is between the two, over its covariance: χ² of three degrees of freedom, 3
        on the average, if σ is right.
    """

    time: FloatArray
    forward_n: FloatArray
    backward_n: FloatArray
    chi2: FloatArray


@dataclass(frozen=True, eq=False)
class Epochs:
    """What GNSS offered, epoch by epoch.

    Parameters
    ----------
    time : ndarray, shape (m,)
        GPS time [s].
    tracked, usable : ndarray of int, shape (m,)
        Satellites in the data, and satellites left after screening (with Doppler); −1: unknown.
    """

    time: FloatArray
    tracked: np.ndarray
    usable: np.ndarray


@dataclass(frozen=True, eq=False)
class Solution:
    """Everything one run found out.

    `status` is 'ok'; 'doubtful', where a note says so; 'restarted', where the solution was lost and
    found again; 'lost', where it was not, and ends before the data. `installation` is how the IMU
    sits in the vehicle as known in the end; None where that was not asked. `fix_errors` is None
    where positions were taken as declared; `signals` is None where there were no observations,
    `resolution` where no position is relative to a base, `separation` where nothing was smoothed.
    `protection` says what the trajectory's protection levels stand for, None where there are none.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, load
    >>> from certnav.datasets.great.writer import simulate_folder
    >>> from certnav.nav import Config, navigate
    >>> folder = simulate_folder(SimulationConfig("city", duration=90.0, density="open"), "city")
    >>> sequence = load(folder)
    >>> solution = navigate(sequence, Config())
    >>> solution.alignment.status, sorted({u.kind for u in solution.updates})
    ('aligned', ['nhc', 'position', 'velocity', 'zaru', 'zupt'])
    """

    name: str
    trajectory: Trajectory
    updates: tuple[Update, ...]
    alignment: AlignmentReport
    epochs: Epochs
    notes: tuple[Note, ...] = ()
    timing: dict[str, float] = field(default_factory=dict)
    status: str = "ok"
    installation: Installation | None = None
    fix_errors: FixErrors | None = None
    resolution: Resolution | None = None
    signals: Signals | None = None
    protection: Protection | None = None
    separation: Separation | None = None
