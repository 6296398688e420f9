"""What a caller may declare of a GREAT sequence, and choose in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from numpy.typing import ArrayLike

from ...filters.errors import ConfigError

#: Noise model of each IMU, unless another is named.
IMU_PRESETS = {"mems": "adis16470", "tactical": "tactical"}


@dataclass(frozen=True, eq=False)
class GreatOptions:
    """Options of `read_great`; whatever is None is searched for, or has to be in ``great.toml``.

    Parameters
    ----------
    imu : {'mems', 'tactical'}
        Which IMU to navigate with.
    lever : {'figure', 'msf_xml'} or array_like, shape (3,)
        From that IMU to the antenna: a preset (2020 sequences only), or forward-right-down [m].
        Required, here or in ``great.toml``.
    reference_point : {'imu', 'antenna', 'mems', 'tactical'} or array_like, shape (3,)
        Point the reference trajectory is of: the IMU navigated with, the antenna, one of the
        IMUs, or a vector from the IMU, forward-right-down [m]. Required when there is one.
    reference_body : {'imu', 'tactical'}, optional
        Whose attitude the reference holds. Default 'tactical': GREAT's reference comes from the
        tactical IMU, so that against the MEMS IMU a constant misalignment of about a degree
        remains.
    imu_preset : str, optional
        Name of the noise model; default by `imu`.
    week : int, optional
        GPS week of the first IMU row; default from reference and RINEX, with which a declared
        week has to agree.
    gyro_unit : {'auto', 'deg/s', 'rad/s'}, optional
        Default 'auto': told from the course. 'deg/s' is what GREAT's configuration files say.
    imu_file, reference_file, rinex : path, optional
        Files to take where the folder has several or none.
    navigation : path or sequence of path
        Broadcast ephemerides, where the folder has none.
    base : path or sequence of path
        Observations of one base station, where the folder has none or those of several.
    systems, signals : str
        As in `datasets.rtklib.read_observations`.

    Raises
    ------
    ConfigError
        An unknown `imu`.

    Examples
    --------
    >>> from certnav.datasets import GreatOptions
    >>> GreatOptions(imu="mems", lever="figure").systems
    'GREJC'
    >>> GreatOptions(imu="fibre")
    Traceback (most recent call last):
        ...
    certnav.filters.errors.ConfigError: imu: expected 'mems' or 'tactical', found 'fibre'
    """

    imu: str = "mems"
    lever: str | ArrayLike | None = None
    reference_point: str | ArrayLike | None = None
    reference_body: str | None = None
    imu_preset: str | None = None
    week: int | None = None
    gyro_unit: str | None = None
    imu_file: str | Path | None = None
    reference_file: str | Path | None = None
    rinex: str | Path | None = None
    navigation: str | Path | Sequence[str | Path] = ()
    base: str | Path | Sequence[str | Path] = ()
    systems: str = "GREJC"
    signals: str = "first"

    def __post_init__(self) -> None:
        if self.imu not in IMU_PRESETS:
            raise ConfigError(f"imu: expected 'mems' or 'tactical', found {self.imu!r}")


def paths(value: str | Path | Sequence[str | Path]) -> tuple[Path, ...]:
    """Return one path or several as a tuple."""
    return (Path(value),) if isinstance(value, str | Path) else tuple(map(Path, value))
