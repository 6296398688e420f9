"""What kinds of vehicles can do: which constraints and checks hold for them, and their limits.

A car goes where it points; a boat drifts, an aircraft crabs, a walker steps aside and a robot's
wheels may turn any way: their course is not their heading, and neither a side velocity of zero nor
a yaw rate of the course may be asked of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Vehicle:
    """One kind.

    Attributes
    ----------
    words : str
        As in "if this is …".
    max_speed, max_height_rate : float
        What none of them exceeds in ordinary use [m/s].
    max_acceleration : float
        The same over three seconds [m/s²]: what tyres, legs and wings bear.
    max_height : float
        Above the ellipsoid [m].
    holds_course : bool
        Whether it moves where it points: the course is the heading, sideways velocity is none.
    stands : bool
        Whether a quiet IMU means that it stands: a boat is carried along, an aircraft hovers.
    course_speed : float
        Speed from which its course is a direction [m/s].
    """

    words: str
    max_speed: float
    max_height_rate: float
    max_acceleration: float
    max_height: float
    holds_course: bool
    stands: bool
    course_speed: float


#: By the name they have in ``vehicle.kind``.
VEHICLES = {
    "car": Vehicle("a car", 75.0, 10.0, 12.0, 6000.0, True, True, 3.0),
    "truck": Vehicle("a truck", 45.0, 6.0, 9.0, 6000.0, True, True, 3.0),
    "bicycle": Vehicle("a bicycle", 25.0, 6.0, 8.0, 6000.0, True, True, 2.0),
    "walker": Vehicle("a walker", 8.0, 4.0, 6.0, 9000.0, False, True, 1.0),
    "robot": Vehicle("a robot", 15.0, 3.0, 12.0, 6000.0, False, True, 1.0),
    "boat": Vehicle("a boat", 45.0, 3.0, 12.0, 6000.0, False, False, 2.0),
    "aircraft": Vehicle("an aircraft", 340.0, 100.0, 60.0, 20000.0, False, False, 5.0),
}  # fmt: skip


def would_explain(fits: Callable[[Vehicle], bool], kind: str) -> str:
    """Return the line that declares the kinds for which something holds, other than `kind`; ''.

    "if this is a boat: --set vehicle.kind=boat".
    """
    found = [name for name, vehicle in VEHICLES.items() if name != kind and fits(vehicle)]
    if not found:
        return ""
    words = [VEHICLES[name].words for name in found]
    listed = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
    return f"if this is {listed}: --set vehicle.kind={'|'.join(found)}"


def defaults(kind: str) -> dict[str, dict[str, object]]:
    """Return the configuration that a kind needs, section by section, where it is not a car's."""
    vehicle = VEHICLES[kind]
    out: dict[str, dict[str, object]] = {}
    if not vehicle.stands:
        out["vehicle"] = {"zupt": False, "zaru": False}
    if vehicle.course_speed != VEHICLES["car"].course_speed:
        out["alignment"] = {"min_speed_mps": vehicle.course_speed}
    return out
