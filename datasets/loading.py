"""Load a recording: recognise the folder by what is in it and hand it to its reader."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..filters.errors import ConfigError, DataError
from .fix_faults import screened
from .imu_faults import polled
from .sequence import Sequence
from .text.rinex_packing import plain_rinex


@dataclass(frozen=True)
class Format:
    """A kind of recording; its reader is imported when it is looked at.

    Attributes
    ----------
    module, name : str
        ``datasets.<module>`` has ``is_<name>``, which takes a folder and returns whether it is
        one, and ``read_<name>``, which takes the folder and the reader's options by name.
    looks_like : str
        What ``is_<name>`` looks for, for the message when nothing matches.
    takes : str
        The dataclass in ``datasets.<module>`` that holds the options, where they are many:
        ``read_<name>`` then takes one of it.
    """

    module: str
    name: str
    looks_like: str
    takes: str = ""

    @property
    def detect(self) -> Callable[[Path], bool]:
        """Whether a folder is one."""
        return self._attribute(f"is_{self.name}")

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options the reader takes."""
        return tuple(self.defaults)

    @property
    def defaults(self) -> dict[str, Any]:
        """What the options are where they are not given."""
        if self.takes:
            return {f.name: f.default for f in dataclasses.fields(self._attribute(self.takes))}
        parameters = inspect.signature(self._attribute(f"read_{self.name}")).parameters.values()
        return {p.name: p.default for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY}

    def read(self, path: str | Path, **options: Any) -> Sequence:
        """From a folder to a `Sequence`."""
        reader = self._attribute(f"read_{self.name}")
        if self.takes:
            return reader(path, self._attribute(self.takes)(**options))
        return reader(path, **options)

    def _attribute(self, name: str) -> Any:
        return getattr(importlib.import_module(f".{self.module}", __package__), name)


#: Recordings in a folder that are named, of more.
_LISTED = 10

FORMATS: dict[str, Format] = {
    "great": Format(
        "great.reader",
        "great",
        "IMU/*.txt with GNSS/ or Groundtruth/, or great.toml",
        takes="GreatOptions",
    ),
    "comma2k19": Format("formats.comma2k19", "comma2k19", "processed_log/IMU with global_pose"),
    "declared": Format("own.reader", "declared", "sequence.toml"),
    "smartloc": Format("formats.smartloc", "smartloc", "RXM-RAWX.csv"),
    "kf-gins": Format("formats.kfgins", "kfgins", "IMU and GNSS text in KF-GINS's columns"),
    "oakville": Format("formats.oakville", "oakville", "imu.csv[.gz] with gnss.csv[.gz]"),
    "rtklibexplorer": Format(
        "formats.rtklibexplorer", "rtklibexplorer", "imu_*.csv with gnss_*.pos"
    ),
    "tumsat": Format("formats.tumsat", "tumsat", "GNSSTCData*.mat with IMUData*.mat"),
    "spirent": Format("formats.instinct", "spirent", "Rover-*_MO_*.obs with *_PVA_*.csv"),
    "ppc": Format("own.ppc", "ppc", "rover.obs with imu.csv"),
    "receiver": Format("receivers.receiver_file", "receiver_file", "a log or RINEX itself"),
}


def formats() -> dict[str, Format]:
    """Return all known formats by name."""
    return dict(FORMATS)


def recognise(path: str | Path) -> str:
    """Return the name of the format a folder is in.

    A declaration goes before everything else the folder may look like; it may also be named
    itself (``drive.toml``), and so may a receiver's log or RINEX observations.

    Raises
    ------
    DataError
        A missing path, a folder nothing recognises, or one that two formats claim.

    Examples
    --------
    >>> from pathlib import Path
    >>> from certnav.datasets import recognise
    >>> Path("drive").mkdir()
    >>> _ = [Path("drive", name).write_text("time") for name in ("imu.csv", "gnss.csv")]
    >>> recognise("drive")
    'oakville'
    >>> recognise("nowhere")
    Traceback (most recent call last):
        ...
    certnav.filters.errors.DataError: nowhere: no such file or folder — check the path
    """
    folder = Path(path)
    if not folder.exists():
        raise DataError("no such file or folder", file=folder, remedy="check the path")
    if folder.is_file() and folder.suffix == ".toml":
        return "declared"
    if not folder.is_dir():
        if FORMATS["receiver"].detect(folder):
            return "receiver"
        raise DataError(
            "neither RINEX observations nor a receiver's log (UBX, SBF, RTCM 3, NovAtel OEM)",
            file=folder,
            remedy="name the folder of a recording; fixes (NMEA, CSV) go beside an IMU's file: "
            "certnav run FILE --imu IMU.csv",
        )
    known = formats()
    found = [name for name, kind in known.items() if kind.detect(folder)]
    if "declared" in found:
        return "declared"
    if len(found) == 1:
        return found[0]
    if found:
        raise DataError(
            f"both {' and '.join(found)} recognise this folder",
            file=folder,
            remedy="name one with format=…",
        )
    if inside := _recordings_in(folder, known):
        raise DataError(f"holds {len(inside)} recordings and is none itself", file=folder,
                        remedy=_which_of(inside))  # fmt: skip
    looked = "; ".join(f"{name}: {kind.looks_like}" for name, kind in known.items())
    raise DataError(
        f"not recognised (looked for {looked})",
        file=folder,
        remedy="own files: `certnav declare FILE…` drafts the sequence.toml they need",
    )


def _recordings_in(folder: Path, known: dict[str, Format]) -> list[tuple[str, str]]:
    """Return name and format of the recordings a folder holds."""
    try:
        places = sorted(place for place in folder.iterdir() if place.is_dir())
    except OSError:
        return []
    return [(p.name, name) for p in places for name, kind in known.items() if kind.detect(p)]


def _which_of(inside: list[tuple[str, str]]) -> str:
    """Return how to name one of them: of GREAT sequences by their name in the catalogue, too."""
    from .great.catalogue import named_in

    names = list(dict.fromkeys(name for name, _ in inside))
    text = f"name one of them: {', '.join(names[:_LISTED])}" + (" …" if names[_LISTED:] else "")
    great = [named_in(name) for name, kind in inside if kind == "great"]
    if found := [entry.name for entry in great if entry is not None]:
        text += f"; or run with --great {found[0]}"
    return text


def with_precise(sequence: Sequence, products: Iterable[str | Path]) -> Sequence:
    """Return a recording with satellite states of precise products, and positions by them.

    Parameters
    ----------
    sequence : Sequence
    products : iterable of path
        SP3 orbits, RINEX clocks, ANTEX; packed or not (`datasets.rtklib.precise`).

    Raises
    ------
    DataError
        No observations, or products that are damaged, of another time, or none.
    """
    from .rtklib import precise_observations

    if sequence.observations is None:
        raise DataError(
            f"{sequence.name}: no satellite observations for the precise ephemerides",
            remedy="leave them out",
        )
    files = [plain_rinex(file) for file in products]
    observations, note = precise_observations(sequence.observations, files)
    navigation = tuple(dict.fromkeys((*sequence.navigation, *files)))
    return dataclasses.replace(
        sequence,
        observations=observations,
        navigation=navigation if sequence.navigation else (),
        notes=(*sequence.notes, note),
    )


def _products(sequence: Sequence, named: Any) -> list[str | Path]:
    """Return the precise products named, and those among a recording's navigation files."""
    from .text.orbit_products import is_product

    if isinstance(named, str | Path):
        named = (named,)
    if not (isinstance(named, list | tuple) and all(isinstance(p, str | Path) for p in named)):
        raise ConfigError(f"data.precise: expected names of files, found {named!r}")
    return [*(file for file in sequence.navigation if is_product(file)), *named]


def load(path: str | Path, *, format: str | None = None, **options: Any) -> Sequence:
    """Return the recording in a folder.

    Parameters
    ----------
    path : path
    format : str, optional
        One of `formats`; default: recognised by the folder's contents, and said in the notes.
    **options
        The reader's own; see `GreatOptions`, `read_smartloc`, `read_kfgins`, `read_comma2k19`,
        `read_oakville`, `read_rtklibexplorer`, `read_tumsat`,
        `datasets.formats.instinct.read_spirent`. A declaration takes none: everything is in the
        file. Every reader of satellite observations takes ``precise``: files of precise
        ephemerides, SP3 orbits, RINEX clocks, ANTEX (`datasets.rtklib.precise`). They may as well
        be among its navigation files.

    Raises
    ------
    DataError
        What cannot be recognised or read.
    ConfigError
        An unknown format or option, with the nearest known one.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, load
    >>> from certnav.datasets.great.writer import simulate_folder
    >>> folder = simulate_folder(SimulationConfig("city", duration=20.0, density="open"), "city")
    >>> sequence = load(folder)
    >>> sequence.name, len(sequence.imu)
    ('city', 2001)
    """
    known = formats()
    if format is not None and format not in known:
        raise ConfigError.unknown_key(format, known, where="format")
    name = recognise(path) if format is None else format
    reader = known[name]
    precise = options.pop("precise", ())
    for key in options:
        if key not in reader.options:
            taken = (*reader.options, "precise")
            raise ConfigError.unknown_key(key, taken, where=f"options of {name}")
    sequence = reader.read(path, **options)
    if sequence.fixes is not None:
        sequence = dataclasses.replace(sequence, fixes=screened(sequence.fixes))
    sequence = _with_polled_noise(sequence)
    if products := _products(sequence, precise):
        sequence = with_precise(sequence, products)
    how = "as told" if format is not None else f"recognised by {reader.looks_like}"
    return dataclasses.replace(sequence, notes=(f"read as {name}, {how}", *sequence.notes))


def _with_polled_noise(sequence: Sequence) -> Sequence:
    """Return the recording with the noise in its IMU of samples polled twice, or missed."""
    found = None if sequence.imu is None else polled(sequence.imu)
    if found is None:
        return sequence
    spec = sequence.calibration.imu
    more = spec.with_noise(found.gyro_density, found.accel_density, "samples polled twice")
    said = (
        f"IMU: {100.0 * found.share:.1f} % of the rows repeat the one before: polled out of step, "
        f"others are missed; white noise {spec.gyro_arw_deg_sqrth:.3g} → "
        f"{more.gyro_arw_deg_sqrth:.3g} deg/√h, {spec.accel_vrw_mps_sqrth:.3g} → "
        f"{more.accel_vrw_mps_sqrth:.3g} m/s/√h"
    )
    calibration = dataclasses.replace(sequence.calibration, imu=more)
    return dataclasses.replace(sequence, calibration=calibration, notes=(*sequence.notes, said))
