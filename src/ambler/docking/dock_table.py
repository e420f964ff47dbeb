"""One dock as a table of the YAML file, and back; every refusal says which field is wrong and why."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import MarkerSpec
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.docking.dock import Contacts, Dock, DockKind, DockMarker, VShape

F64 = NDArray[np.float64]

_FIELDS = (
    "type",
    "pose",
    "offset",
    "approach_distance",
    "contacts",
    "outline",
    "dockings",
    *(k.value for k in DockKind),
)
_OUTLINE_SIDE = 3.0  # metres; a longer outline would hide more than a dock


def dock_of_table(where: str, name: str, table: Any) -> Dock:
    """Read a dock; `where` begins every error. Raises BadInputError."""
    if not isinstance(table, dict):
        raise BadInputError(f"{where}: must be a table")
    unknown = sorted(str(k) for k in table if k not in _FIELDS)
    if unknown:
        raise BadInputError(f"{where}: unknown field {', '.join(unknown)}; there are {', '.join(_FIELDS)}")
    kind = DockKind(_choice(where, table, "type", [k.value for k in DockKind]))
    if kind.value not in table:
        raise BadInputError(f"{where}: a dock of type {kind.value} needs the field {kind.value}")
    distance = _number(f"{where}: approach_distance", table.get("approach_distance", 1.0))
    if not 0.2 <= distance <= 5.0:
        raise BadInputError(f"{where}: approach_distance must be 0.2 to 5 m, not {distance:g}")
    part = table[kind.value]
    dockings = table.get("dockings", 0)
    if not isinstance(dockings, int) or dockings < 0:
        raise BadInputError(f"{where}: dockings must be a whole number, not {dockings!r}")
    return Dock(
        name,
        kind,
        _pose(f"{where}: pose", table.get("pose")),
        _outline(where, table.get("outline")),
        _pose(f"{where}: offset", table.get("offset", [0.0, 0.0, 0.0])),
        distance,
        Contacts(_choice(where, table, "contacts", [c.value for c in Contacts])),
        _markers(where, part) if kind is DockKind.MARKERS else (),
        _v_shape(where, part) if kind is DockKind.V_SHAPE else None,
        _reflectors(where, part) if kind is DockKind.REFLECTORS else np.empty((0, 2)),
        dockings,
    )


def table_of_dock(dock: Dock) -> dict[str, Any]:
    """Return the table that `dock_of_table` reads."""
    table: dict[str, Any] = {
        "type": dock.kind.value,
        "pose": _list_of(dock.map_from_dock),
        "offset": _list_of(dock.offset),
        "approach_distance": dock.approach_distance,
        "contacts": dock.contacts.value,
        "outline": dock.outline.tolist(),
        "dockings": dock.dockings,
    }
    if dock.v_shape is not None:
        v = dock.v_shape
        table["v_shape"] = {"angle": math.degrees(v.angle), "leg": v.leg, "pose": _list_of(v.dock_from_corner)}
    elif dock.markers:
        table["markers"] = [
            {
                "dictionary": m.spec.dictionary,
                "id": m.spec.number,
                "size": m.spec.size,
                "pose": [m.x, m.y, m.z, math.degrees(m.yaw)],
            }
            for m in dock.markers
        ]
    else:
        table["reflectors"] = dock.reflectors.tolist()
    return table


def _list_of(pose: SE2) -> list[float]:
    return [float(pose.x), float(pose.y), math.degrees(pose.yaw)]


def _choice(where: str, table: dict[Any, Any], key: str, known: list[str]) -> str:
    value = table.get(key)
    if value not in known:
        raise BadInputError(f"{where}: {key} must be one of {', '.join(known)}, not {value!r}")
    return str(value)


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadInputError(f"{where} must be a number, not {value!r}")
    return float(value)


def _numbers(where: str, value: Any, count: int) -> list[float]:
    if not isinstance(value, list) or len(value) != count:
        raise BadInputError(f"{where} must be {count} numbers, not {value!r}")
    return [_number(where, v) for v in value]


def _pose(where: str, value: Any) -> SE2:
    x, y, yaw_deg = _numbers(f"{where} (x, y, degrees)", value, 3)
    return SE2(x, y, math.radians(yaw_deg))


def _points(where: str, value: Any, least: int) -> F64:
    if not isinstance(value, list) or len(value) < least:
        raise BadInputError(f"{where} must be at least {least} points [x, y]")
    return np.array([_numbers(where, point, 2) for point in value])


def _outline(where: str, value: Any) -> F64:
    points = _points(f"{where}: outline", value, 3)
    edge = np.roll(points, -1, axis=0) - points
    following = np.roll(edge, -1, axis=0)
    turn = edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0]
    if not (turn > 1e-9).all():
        raise BadInputError(f"{where}: outline must be convex and counter-clockwise")
    if float(np.ptp(points, axis=0).max()) > _OUTLINE_SIDE:
        raise BadInputError(f"{where}: outline is longer than {_OUTLINE_SIDE:g} m")
    return points


def _markers(where: str, value: Any) -> tuple[DockMarker, ...]:
    if not isinstance(value, list) or not value:
        raise BadInputError(f"{where}: markers must be a list of at least one marker")
    markers = []
    for entry in value:
        if not isinstance(entry, dict) or not isinstance(entry.get("id"), int):
            raise BadInputError(f"{where}: a marker needs dictionary, id, size and pose")
        number = entry["id"]
        here = f"{where}: marker {number}"
        size = _number(f"{here}: size", entry.get("size"))
        if not 0.01 <= size <= 2.0:
            raise BadInputError(f"{here}: size must be 0.01 to 2 m, not {size:g}")
        if "pose" not in entry:
            raise BadInputError(f"{here} has no pose: without its offset to the dock it says nothing")
        if not isinstance(entry.get("dictionary"), str):
            raise BadInputError(f"{here}: dictionary must be a name such as 4X4_50")
        x, y, z, yaw_deg = _numbers(f"{here}: pose (x, y, z, degrees)", entry["pose"], 4)
        markers.append(DockMarker(MarkerSpec(entry["dictionary"], number, size), x, y, z, math.radians(yaw_deg)))
    if len({m.spec.number for m in markers}) < len(markers):
        raise BadInputError(f"{where}: two markers have the same id")
    return tuple(markers)


def _v_shape(where: str, value: Any) -> VShape:
    if not isinstance(value, dict):
        raise BadInputError(f"{where}: v_shape must be a table of angle, leg and pose")
    angle = math.radians(_number(f"{where}: v_shape: angle", value.get("angle")))
    leg = _number(f"{where}: v_shape: leg", value.get("leg"))
    if not math.radians(30.0) <= angle <= math.radians(330.0) or abs(angle - math.pi) < math.radians(15.0):
        raise BadInputError(f"{where}: v_shape: angle must be 30 to 165 or 195 to 330 degrees")
    if not 0.05 <= leg <= 2.0:
        raise BadInputError(f"{where}: v_shape: leg must be 0.05 to 2 m, not {leg:g}")
    return VShape(angle, leg, _pose(f"{where}: v_shape: pose", value.get("pose")))


def _reflectors(where: str, value: Any) -> F64:
    points = _points(f"{where}: reflectors", value, 2)
    gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) + 9.0 * np.eye(len(points))
    if float(gaps.min()) < 0.15:
        raise BadInputError(f"{where}: reflectors must be at least 0.15 m apart")
    return points
