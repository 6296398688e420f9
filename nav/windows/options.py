"""How a recording is cut into windows, and what is kept of it."""

from __future__ import annotations

from dataclasses import dataclass

from ...filters.error_model import ODOMETER_SCALE_SIGMA
from ...filters.errors import ConfigError

#: Ways of our own, and others' to compare with.
OWN = ("certified", "robust")
METHODS = (*OWN, "sdp", "voba", "gauss-newton")


@dataclass(frozen=True)
class WindowOptions:
    """How a recording is cut into windows and what is kept of it.

    Parameters
    ----------
    window, step : float
        Length of a window and distance between their beginnings [s].
    method : {'certified', 'robust', 'sdp', 'voba', 'gauss-newton'}
        'certified': the SDP-free solver with all verdicts; 'robust': the same on the largest
        consensus of the rows; 'sdp': the paper's relaxation; 'gauss-newton' starts from the
        identity, as in Song et al.'s Table III.
    clock : {'constant', 'linear', 'per-epoch', 'random-walk'}
        Model of the receiver's clock drift within a window.
    clock_walk : float
        Of the random walk [m/s/√s]; a quartz oscillator's is about 0.1.
    sigma_local_mps : float
        1σ per axis of the local velocity, odometer and yaw rate together; added to that of
        every row.
    position_sigma_m : float, optional
        1σ per axis of the positions that lines of sight are computed for [m], unknowns of each
        window. Default: what the receiver's positions come with.
    speed_scale_sigma : float
        1σ of the odometer's scale, an unknown of each window; the default is what tyres leave
        open.
    satellites : float, optional
        Keep this many satellites per epoch, drawn at random; a fraction is the average.
        Default: all.
    labels : {'all', 'los'}
        'los' drops rows labelled as not in line of sight, where the recording has labels.
    decimate : int
        Keep every so-manieth epoch.
    noise : {'assumed', 'fitted'}
        Of the Doppler: `velocity.range_rate.DopplerNoise` as it is, or fitted to the recording
        with its correlation (`nav.windows.noise`).
    phase : {'gate', 'rates', 'off'}
        Where the recording has carrier phases: 'gate' leaves out rows whose Doppler they do not
        bear out (`velocity.phase_rates`), 'rates' also takes the rates of the phase in place of
        Doppler where they are better.
    min_cn0 : float
        Weaker signals are left out [dB-Hz]; mostly reflections in a city.
    level_deg : float, optional
        1σ per axis of the vehicle's tilt: the up prior of a car on a road (`certified` and
        `robust`). Default: none.
    elevation_mask_deg : float
    seed : int
        For drawing satellites.
    """

    window: float = 15.0
    step: float = 5.0
    method: str = "certified"
    clock: str = "random-walk"
    clock_walk: float = 0.1
    sigma_local_mps: float = 0.0
    position_sigma_m: float | None = None
    speed_scale_sigma: float = ODOMETER_SCALE_SIGMA
    satellites: float | None = None
    labels: str = "all"
    decimate: int = 1
    noise: str = "assumed"
    phase: str = "gate"
    min_cn0: float = 0.0
    level_deg: float | None = None
    elevation_mask_deg: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError.unknown_key(self.method, METHODS, where="--method")
        if self.labels not in ("all", "los"):
            raise ConfigError(f"--rows: expected 'all' or 'los', found '{self.labels}'")
        if self.noise not in ("assumed", "fitted"):
            raise ConfigError(f"--noise: expected 'assumed' or 'fitted', found '{self.noise}'")
        if self.phase not in ("gate", "rates", "off"):
            raise ConfigError(f"--phase: expected 'gate', 'rates' or 'off', found '{self.phase}'")
        if self.level_deg is not None and not 0.0 < self.level_deg <= 45.0:
            raise ConfigError(f"--level: expected 0 < level ≤ 45°, found {self.level_deg:g}")
        if not (self.window > 0.0 and self.step > 0.0 and self.decimate >= 1):
            raise ConfigError("expected window > 0 s, step > 0 s and decimate ≥ 1")
        if not (self.position_sigma_m is None or 0.0 <= self.position_sigma_m < float("inf")):
            raise ConfigError(f"--position-sigma: expected ≥ 0 m, found {self.position_sigma_m:g}")
        if not 0.0 <= self.speed_scale_sigma < 1.0:
            raise ConfigError(
                f"--speed-scale: expected 0 ≤ 1σ < 100 %, found {100.0 * self.speed_scale_sigma:g}"
            )
        if self.satellites is not None and not self.satellites >= 1.0:
            raise ConfigError(f"--satellites: expected at least 1, found {self.satellites:g}")
