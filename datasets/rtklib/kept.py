"""RINEX observations, read by RTKLIB once and kept where `datasets.cache` is told to."""

from __future__ import annotations

import functools
import inspect
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from .. import cache
from ..observations import GnssObservations
from . import observations

#: Source whose change makes other observations of the same files.
_HERE = Path(__file__).parent
_CODE = sorted(_HERE.glob("*.py")) + [
    _HERE.parent / name for name in ("text/rinex.py", "gpstime.py", "fields.py", "observations.py")
]


@functools.wraps(observations.read_observations)
def read_observations(*args: Any, **options: Any) -> GnssObservations:
    """See `datasets.rtklib.observations.read_observations`."""
    call = inspect.signature(observations.read_observations).bind(*args, **options)
    call.apply_defaults()
    given = dict(call.arguments)
    files = [Path(given.pop("path")), *(Path(file) for file in given.pop("navigation"))]

    def make() -> cache.Arrays:
        found = observations.read_observations(*args, **options)
        return {field.name: getattr(found, field.name) for field in fields(found)}

    made_by = (version("pyrtklib5"), len(files), sorted(given.items()))
    return GnssObservations(**cache.kept(make, files, made_by, _CODE))
