"""One case of ``scripts/fuzz.py``: a seed's folder broken by seed and number, and read."""

from __future__ import annotations

import os
import shutil
import traceback
import warnings
from pathlib import Path
from random import Random

import numpy as np

from certnav.filters.errors import NavError

from . import mutations
from .readers import READ
from .seeds import SHARED, Target


def make_case(
    target: Target, seeds: Path, folder: Path, seed: int, number: int
) -> tuple[str, list[str]]:
    """Break files of a folder of links to a target's seed; return how, and which."""
    r = Random(f"{seed}/{target.name}/{number}")
    sound = seeds / SHARED.get(target.name, target.name)
    number_of = min(len(target.kinds), 1 if r.random() < 0.85 else 2)
    broken, said = r.sample(sorted(target.kinds), number_of), []
    for name in broken:
        place = folder / name
        content, how = mutations.mutate((sound / name).read_bytes(), target.kinds[name], r)
        said.append(f"{name}: {how}")
        place.unlink()
        if content == mutations.DIRECTORY:
            place.mkdir()
        elif content != mutations.MISSING:
            assert isinstance(content, bytes)
            place.write_bytes(content)
            # caches go by size and time, and a clock may tick slower than this
            os.utime(place, ns=(10**18 + number * 10**6,) * 2)
    return "; ".join(said), broken


def link(sound: Path, folder: Path) -> None:
    """Make a folder of links to the files of another one."""
    for file in sound.rglob("*"):
        place = folder / file.relative_to(sound)
        place.parent.mkdir(parents=True, exist_ok=True)
        if file.is_dir():
            place.mkdir(exist_ok=True)
        else:
            place.symlink_to(file)


def repair(sound: Path, folder: Path, broken: list[str]) -> None:
    """Put the links back."""
    for name in broken:
        place = folder / name
        if place.is_dir():
            place.rmdir()
        place.unlink(missing_ok=True)
        place.symlink_to(sound / name)
    shutil.rmtree(folder / "imported", ignore_errors=True)


def read_case(name: str, folder: Path, random: Random | None = None) -> tuple[str, str]:
    """Read a folder; return the outcome and what it said."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with np.errstate(all="ignore"):
                READ[name](folder)
                if name == "config" and random is not None:
                    _assign(folder, random)
    except NavError as error:
        text = str(error)
        if "\n" in text or "\r" in text or not text:
            return "traceback", f"message of several lines: {text!r}"[:300]
        return "refused", text
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [f for f in frames if not any(p in f.filename for p in ("packages/", "lib/python"))]
        where = " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in reversed(own[-3:]))
        return "traceback", f"{type(error).__name__}: {str(error)[:120]!r} at {where}"
    return "ok", ""


def _assign(folder: Path, r: Random) -> None:
    """Set one value of the configuration as ``--set`` does."""
    from certnav.nav.config import Config
    from certnav.nav.config_files import load_config

    sections = ("alignment", "filter", "gnss", "vehicle", "data")
    section = r.choice(sections)
    fields = list(vars(getattr(Config(), section))) if section != "data" else ["lever", "week"]
    value = r.choice(mutations.TOML + mutations.WORDS + mutations.NUMBERS)
    text = f"{section}.{r.choice(fields)}={value}"
    if r.random() < 0.3:
        text = mutations.flip_bytes(text.encode(), r).decode("latin-1")
    load_config(None, [text])
