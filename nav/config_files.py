"""Configurations from and to TOML; unknown keys are refused with the nearest known one."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from ..datasets.text.toml_files import parse_toml, read_toml
from ..filters.errors import ConfigError, DataError
from .config import AlignmentConfig, Config, FilterConfig, GnssConfig, VehicleConfig
from .vehicles import VEHICLES, defaults

T = TypeVar("T")


def _section(cls: type[T], table: Mapping[str, Any], where: str) -> T:
    """Build the dataclass `cls` from a table, checking keys and types."""
    known = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key not in known:
            raise ConfigError.unknown_key(key, known, where=where)
        default = known[key].default
        if isinstance(default, tuple):
            values[key] = _numbers(f"{where}.{key}", value)
            continue
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        wants_number = default is None or (
            isinstance(default, (int, float)) and not isinstance(default, bool)
        )
        fits = number if wants_number else isinstance(value, type(default))
        if not fits:
            wanted = "number" if wants_number else type(default).__name__
            raise ConfigError(f"{where}.{key}: expected a {wanted}, found {value!r}")
        values[key] = float(value) if isinstance(default, float) or default is None else value
    return cls(**values)


def _numbers(key: str, value: Any) -> tuple[float, ...]:
    numbers = isinstance(value, list | tuple) and all(
        isinstance(v, int | float) and not isinstance(v, bool) for v in value
    )
    if not numbers:
        raise ConfigError(f"{key}: expected a list of numbers, found {value!r}")
    return tuple(float(v) for v in value)


def from_tables(tables: Mapping[str, Any]) -> Config:
    """Return the configuration given as nested tables; what is absent keeps its default."""
    sections = {
        "alignment": AlignmentConfig,
        "filter": FilterConfig,
        "gnss": GnssConfig,
        "vehicle": VehicleConfig,
    }
    parts: dict[str, Any] = {}
    asked = tables.get("vehicle", {})
    kind = asked.get("kind", "car") if isinstance(asked, Mapping) else "car"
    of_kind = defaults(kind) if kind in VEHICLES else {}
    for name, table in {**{name: {} for name in of_kind}, **tables}.items():
        if name not in (*sections, "data"):
            raise ConfigError.unknown_key(name, (*sections, "data"), where="configuration")
        if not isinstance(table, Mapping):
            raise ConfigError(f"{name}: expected a table, found {table!r}")
        if name == "data":
            parts[name] = dict(table)
        else:
            parts[name] = _section(sections[name], {**of_kind.get(name, {}), **table}, name)
    return Config(**parts)


def load_config(file: str | Path | None = None, assignments: Iterable[str] = ()) -> Config:
    """Return the configuration of a TOML file with ``section.key=value`` assignments on top.

    Examples
    --------
    >>> from certnav import load_config
    >>> config = load_config(None, ["gnss.min_cn0_dbhz=38", "filter.states=21"])
    >>> config.gnss.min_cn0_dbhz, config.filter.states
    (38.0, 21)
    >>> load_config(None, ["gnss.min_cnO=38"])
    Traceback (most recent call last):
        ...
    certnav.filters.errors.ConfigError: gnss: unknown key 'min_cnO' — did you mean 'min_cn0_dbhz'?
    """
    tables: dict[str, Any] = {}
    if file is not None:
        if not Path(file).exists():
            raise DataError("no such file", file=file, remedy="check --config")
        tables, _ = read_toml(Path(file))
    for text in assignments:
        key, equals, value = text.partition("=")
        section, dot, name = key.strip().partition(".")
        if not (equals and dot and section and name):
            raise ConfigError(f"--set {text}: expected section.key=value")
        table = tables.setdefault(section, {})
        if not isinstance(table, dict):
            raise ConfigError(f"{section}: expected a table, found {table!r}")
        table[name] = _parse_value(value.strip())
    return from_tables(tables)


def _parse_value(text: str) -> Any:
    """Return a TOML value; bare words are strings."""
    try:
        return parse_toml(f"v = {text}")["v"]
    except ValueError:
        return text


def to_toml(config: Config) -> str:
    """Return the whole configuration as TOML; reading it back gives an equal configuration."""
    lines = []
    for section in dataclasses.fields(config):
        part = getattr(config, section.name)
        table = dict(part) if isinstance(part, Mapping) else dataclasses.asdict(part)
        lines.append(f"[{section.name}]")
        for key, value in table.items():
            if value is None:
                lines.append(f"# {key} is not set")
            else:
                lines.append(f"{key} = {_format_value(value)}")
        lines.append("")
    return "\n".join(lines)


def _format_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_format_value(v) for v in value) + "]"
    return json.dumps(str(value), ensure_ascii=False)
