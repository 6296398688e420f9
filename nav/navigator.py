"""Live navigation: IMU samples and GNSS events as they come, the same answers as a batch run.

    navigator = Navigator(calibration, config, imu_interval=0.01)
    navigator.add_imu(time, gyro_b, accel_b)         # every sample, in order
    navigator.add_gnss(event)                        # nav.engine.gnss.GnssEvent, when it arrives
    state = navigator.state                          # LiveState, or None before alignment

Events are worked off `latency` behind the IMU, so that a fix that takes its time still finds the
filter at its epoch; `state` is carried on to the latest sample. Until there is an attitude they are
kept, too, and looked at one by one (`nav.engine.start.StartFinder`); levelling in motion finds one
in the past, and then they are worked off from there. An event that arrives later than `latency` is
logged as late and not used.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np
from numpy.typing import ArrayLike

from ..datasets.sequence import Calibration
from ..datasets.series import Odometer
from ..filters.compiled import rows as layout
from ..filters.earth import C_en_of, ecef_to_lla
from ..filters.error_model import ATT, POS, VEL
from ..filters.errors import AlignmentError, ConfigError
from ..filters.rotation import FloatArray, rpy_from_matrix
from ..filters.strapdown import InertialStream
from .config import AlignmentConfig, Config
from .engine.blind import Spell, gap, is_gap
from .engine.events import GnssEvent
from .engine.loop import Diverged, FilterLoop
from .engine.model import error_model
from .engine.start.finder import StartFinder, again
from .engine.start.state import Start, start_filter
from .engine.vehicle import VehicleConstraints
from .engine.watch.sanity import Lost
from .installation import Installation
from .notes import clock
from .solution import Update

#: What is looked back to for a standstill, and for a start of what has just been lost [s].
_SHORTEST_HISTORY = 10.0


@dataclass(frozen=True, eq=False)
class LiveState:
    """The estimate at the latest IMU sample.

    Parameters
    ----------
    time : float
        GPS time [s].
    pos_e, vel_e : ndarray, shape (3,)
        ECEF position [m] and velocity [m/s] of the IMU.
    C_eb : ndarray, shape (3, 3)
        Attitude: ``C_eb @ x_b == x_e``.
    cov_pos_n, cov_vel_n, cov_att_n : ndarray, shape (3, 3)
        Covariance of position [m²], velocity [m²/s²] and attitude [rad²], north-east-down, as of
        `nav.solution.Trajectory`.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import C_en_of, lla_to_ecef
    >>> from certnav.nav import LiveState
    >>> pos_e, cov = lla_to_ecef(0.5, 2.0, 30.0), 0.01 * np.eye(3)
    >>> state = LiveState(0.0, pos_e, np.zeros(3), C_en_of(pos_e), cov, cov, cov)
    >>> np.sqrt(state.cov_pos_n.diagonal())  # 1σ north, east, down [m]
    array([0.1, 0.1, 0.1])
    """

    time: float
    pos_e: FloatArray
    vel_e: FloatArray
    C_eb: FloatArray
    cov_pos_n: FloatArray
    cov_vel_n: FloatArray
    cov_att_n: FloatArray

    @cached_property
    def _lla(self) -> FloatArray:
        return ecef_to_lla(self.pos_e)

    @cached_property
    def _rpy(self) -> FloatArray:
        return rpy_from_matrix(self.C_en.T @ self.C_eb)

    @cached_property
    def C_en(self) -> FloatArray:
        """Axes north, east, down as columns in ECEF, shape (3, 3)."""
        return C_en_of(self.pos_e)

    @property
    def vel_n(self) -> FloatArray:
        """Velocity north, east, down [m/s], shape (3,)."""
        return self.C_en.T @ self.vel_e

    @property
    def latitude(self) -> float:
        """Geodetic latitude, WGS 84 [rad]."""
        return float(self._lla[0])

    @property
    def longitude(self) -> float:
        """Longitude, east positive [rad]."""
        return float(self._lla[1])

    @property
    def height(self) -> float:
        """Height above the WGS 84 ellipsoid [m]."""
        return float(self._lla[2])

    @property
    def roll(self) -> float:
        """Right side down positive [rad]."""
        return float(self._rpy[0])

    @property
    def pitch(self) -> float:
        """Nose up positive [rad]."""
        return float(self._rpy[1])

    @property
    def heading(self) -> float:
        """Clockwise from true north, 0 … 2π [rad]."""
        return float(self._rpy[2] % (2.0 * np.pi))

    def __repr__(self) -> str:
        north, east, down = np.sqrt(np.diag(self.cov_pos_n))
        lat, lon = np.degrees(self._lla[:2])
        return (
            f"LiveState({clock(self.time)}: {lat:.7f}°, {lon:.7f}°, {self.height:.2f} m "
            f"± {north:.2f}/{east:.2f}/{down:.2f} m NED; heading {np.degrees(self.heading):.2f}° "
            f"± {np.degrees(np.sqrt(self.cov_att_n[2, 2])):.2f}°)"
        )


class Navigator:
    """Loosely coupled navigation of a live vehicle.

    Parameters
    ----------
    calibration : Calibration
    config : Config
    imu_interval : float
        Nominal sample interval of the IMU [s].
    latency : float
        How late after its epoch GNSS may arrive and is still sure to be used [s].
    odometer : Odometer, optional
        Recorded; live odometers are not supported.
    history : float
        How long `rows`, `updates` and samples of the IMU are kept while the filter runs, at least
        [s]; default: for ever, some 4 MB a minute at 400 Hz. After a lost solution a start is
        looked for in what there is.

    Attributes
    ----------
    restarts : list of (float, str)
        GPS time at which the solution was lost and a start looked for again [s], and why.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.nav import Config, Navigator
    >>> drive = simulate(SimulationConfig(duration=10.0, density="open"))
    >>> navigator = Navigator(drive.calibration, Config(), imu_interval=0.01)
    >>> for sample in zip(drive.imu.time, drive.imu.gyro_b, drive.imu.accel_b, strict=True):
    ...     navigator.add_imu(*sample)
    ...
    >>> navigator.state is None, navigator.waiting  # no GNSS yet: add_gnss(GnssEvent(...))
    (True, 'no data yet')
    """

    def __init__(
        self,
        calibration: Calibration,
        config: Config,
        imu_interval: float,
        latency: float = 0.5,
        odometer: Odometer | None = None,
        history: float = np.inf,
    ) -> None:
        if not history >= _SHORTEST_HISTORY:
            raise ConfigError(
                f"history: expected {_SHORTEST_HISTORY:g} s or more, found {history!r}"
            )
        self._history, self._forgotten = history, -np.inf
        self.calibration, self.config, self.latency = calibration, config, latency
        self._stream = InertialStream.live(imu_interval)
        self._vehicle = VehicleConstraints(calibration, config.vehicle, odometer)
        self._model = error_model(
            calibration, config, odometer=self._vehicle.odometer is not None, nhc=self._vehicle.nhc
        )
        self._finder = self._new_finder(config.alignment)
        self._kept: list[GnssEvent] = []
        self._queue: list[tuple[float, str, int, GnssEvent]] = []
        self._order = count()
        self._spells: deque[Spell] = deque()
        self._loop: FilterLoop | None = None
        self._past: list[Update] = []
        self._rows: list[FloatArray] = []
        self.restarts: list[tuple[float, str]] = []

    @property
    def waiting(self) -> str:
        """What is missing for an attitude; '' once there is one."""
        return self._finder.waiting if self._loop is None else ""

    @property
    def attempts(self) -> tuple[tuple[float, str], ...]:
        """GPS time of each certified attempt so far [s], and what it was waiting for."""
        return tuple(self._finder.attempts)

    @property
    def state(self) -> LiveState | None:
        """The estimate at the latest IMU sample, or None before alignment (see `waiting`)."""
        if self._loop is None:
            return None
        state, P = self._loop.kalman.ahead(self._stream.end)
        C_ne = C_en_of(state.pos_e).T
        C_nb = C_ne @ state.C_eb
        return LiveState(
            state.time, state.pos_e, state.vel_e, state.C_eb,
            C_ne @ P[POS, POS] @ C_ne.T, C_ne @ P[VEL, VEL] @ C_ne.T, C_nb @ P[ATT, ATT] @ C_nb.T,
        )  # fmt: skip

    def finish(self) -> None:
        """No more data will come: work off what is left, up to the last IMU sample."""
        self._work_off(self._stream.end)
        if self._loop is None:
            try:
                self._start(self._finder.close())
            except AlignmentError as error:
                self._finder.waiting = str(error)
                return
        if self._loop is not None:
            with self._restarting():
                self._loop.advance(self._stream.end)

    @property
    def updates(self) -> tuple[Update, ...]:
        """The log so far."""
        now = self._loop.updates if self._loop is not None else []
        return (*self._past, *now)

    @property
    def installation(self) -> Installation | None:
        """How the IMU sits in the vehicle as known by now; None before alignment."""
        return None if self._loop is None else self._vehicle.installation(self._loop.kalman)

    @property
    def rows(self) -> FloatArray:
        """Recorded rows so far, as of `filters.ekf.ErrorStateFilter.rows`."""
        rows = [*self._rows, *([self._loop.kalman.rows] if self._loop is not None else [])]
        return np.vstack(rows) if rows else np.zeros((0, 0))

    def add_imu(self, time: float, gyro_b: ArrayLike, accel_b: ArrayLike) -> None:
        """Take the sample that ends at GPS time `time` [s]: mean rate, mean specific force.

        Raises
        ------
        DataError
            If time does not increase or a value is not finite.
        """
        before = self._stream.end if len(self._stream) else time
        self._stream.append(time, gyro_b, accel_b)
        if is_gap(time - before, self._stream.interval):
            self._spells.append(gap(before, time))
        self._work_off(time - self.latency)

    def add_gnss(self, event: GnssEvent) -> None:
        """Take a position, a velocity or Doppler rows."""
        heapq.heappush(self._queue, (event.time, event.kind, next(self._order), event))
        if len(self._stream):
            self._work_off(self._stream.end - self.latency)

    def _work_off(self, until: float) -> None:
        """Apply what is due by `until` [s]; the steps are those of a batch run."""
        while self._queue and self._queue[0][0] <= until:
            event = heapq.heappop(self._queue)[3]
            with self._restarting():
                if self._loop is not None:
                    self._loop.offer(event)
                    continue
                self._kept.append(event)
                start = self._finder.offer(event)
                if start is not None:
                    self._start(start)
        if self._loop is not None:
            with self._restarting():
                self._loop.constrain(until)
        if until - self._forgotten > 0.5 * self._history:
            self._forget(until)

    def _forget(self, now: float) -> None:
        """Let go of what is older than the history, of all once in half of its time."""
        before, self._forgotten = now - self._history, now
        if self._loop is not None:
            self._loop.forget(before)
        self._past = [update for update in self._past if update.time >= before]
        self._rows = [rows for rows in self._rows if rows[-1, layout.ROW_TIME] >= before]

    @contextmanager
    def _restarting(self) -> Iterator[None]:
        """Begin to look for a start again where the solution is lost in the context."""
        try:
            yield
        except (Diverged, Lost) as error:
            loop = self._loop
            assert loop is not None
            self._past += loop.updates
            self._rows.append(loop.kalman.rows)
            self.restarts.append((loop.reached, str(error)))
            self._loop, self._finder = None, self._new_finder(again(self.config.alignment))
            self._kept = [event for event in self._kept if event.time > loop.reached]

    def _new_finder(self, config: AlignmentConfig) -> StartFinder:
        kind = self.config.vehicle.kind
        return StartFinder(self._stream, self.calibration, config, self._model, kind)

    def _start(self, start: Start) -> None:
        """Begin to filter, with what was kept until now."""
        kalman = start_filter(
            start, self._stream, self.calibration, self._model, self.config.filter
        )
        self._loop = FilterLoop(kalman, self.calibration, self._vehicle, self.config, self._spells)
        # One that came late was looked at late; the filter gets it in its place.
        kept = sorted(self._kept, key=lambda event: (event.time, event.kind))
        self._kept = []
        for event in kept:
            self._loop.offer(event)
