"""Records of services and tasks (`core.requests`) to ROS records and back, field by field under the same names.

A field that may be None has a flag `has_<name>` before it. Poses of the plane are geometry_msgs/Pose2D, whose angle is exact.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, fields
from types import NoneType
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Frontier, Path
from ambler.core.se2 import SE2
from ambler.wire.ros_geometry import header_to_ros, stamp_from_ros
from ambler.wire.ros_types import record_class

R = TypeVar("R")

_Pose2D = record_class("geometry_msgs/msg/Pose2D")
_Point = record_class("geometry_msgs/msg/Point")
_PlanarPath = record_class("ambler_msgs/msg/PlanarPath")
_FRONTIER = "ambler_msgs/msg/Frontier"
# A reply that says itself whether it was done uses the fields that every response begins with.
_REPLY_NAMES = {"is_done": "success", "text": "message"}


@dataclass(frozen=True, slots=True)
class _Form:
    """How values of one type travel, and what stands for a value that is absent."""

    to_ros: Callable[[Any], Any]
    from_ros: Callable[[Any], Any]
    absent: Callable[[], Any]


@dataclass(frozen=True, slots=True)
class _Field:
    """One field of a record: its name, that of its flag (empty: it is always there), and its form."""

    name: str
    ros_name: str
    flag: str
    form: _Form


def values_of(record: Any) -> dict[str, Any]:
    """Return the ROS fields of a record by name."""
    values: dict[str, Any] = {}
    for field in _fields_of(type(record)):
        value = getattr(record, field.name)
        if field.flag:
            values[field.flag] = value is not None
        values[field.ros_name] = field.form.absent() if value is None else field.form.to_ros(value)
    return values


def absent_values(record_type: type[Any]) -> dict[str, Any]:
    """Return ROS fields for a record that is not there."""
    values: dict[str, Any] = {}
    for field in _fields_of(record_type):
        if field.flag:
            values[field.flag] = False
        values[field.ros_name] = field.form.absent()
    return values


def record_from(record_type: type[R], ros: Any) -> R:
    """Build a record from a ROS record that has at least its fields."""
    values = {
        field.name: None
        if field.flag and not getattr(ros, field.flag)
        else field.form.from_ros(getattr(ros, field.ros_name))
        for field in _fields_of(record_type)
    }
    return record_type(**values)


def first_not_finite(record: Any) -> str | None:
    """Return the name of the first field of a record that holds a number that is not finite."""
    return next((f.name for f in fields(record) if not _is_finite(getattr(record, f.name))), None)


def _is_finite(value: Any) -> bool:
    if isinstance(value, SE2):
        return _is_finite((value.x, value.y, value.yaw))
    if isinstance(value, Path):
        return _is_finite(value.poses)
    if isinstance(value, tuple | float | np.ndarray):
        return all(map(_is_finite, value)) if isinstance(value, tuple) else bool(np.isfinite(value).all())
    return True


_KNOWN: dict[type[Any], tuple[_Field, ...]] = {}


def _fields_of(record_type: type[Any]) -> tuple[_Field, ...]:
    if record_type not in _KNOWN:
        _KNOWN[record_type] = _find_fields(record_type)
    return _KNOWN[record_type]


def _find_fields(record_type: type[Any]) -> tuple[_Field, ...]:
    hints, found = get_type_hints(record_type), []
    names = _REPLY_NAMES if "is_done" in hints else {}
    for field in fields(record_type):
        wanted = [kind for kind in get_args(hints[field.name]) if kind is not NoneType]
        is_optional = NoneType in get_args(hints[field.name])
        form = _form_of(wanted[0] if is_optional else hints[field.name])
        found.append(
            _Field(field.name, names.get(field.name, field.name), f"has_{field.name}" if is_optional else "", form)
        )
    return tuple(found)


def _form_of(hint: Any) -> _Form:
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        members = list(hint)
        return _Form(members.index, lambda index: members[index], lambda: 0)
    return _FORMS[hint]


def _same(value: Any) -> Any:
    return value


def _pose_from(ros: Any) -> SE2:
    return SE2(ros.x, ros.y, ros.theta)


def _points_to(points: Any) -> list[Any]:
    return [_Point(float(x), float(y), 0.0) for x, y in points]


def _path_to(path: Path) -> Any:
    return _PlanarPath(header_to_ros(path.stamp_ns, path.frame), [_Pose2D(*row) for row in path.poses.tolist()])


def _path_from(ros: Any) -> Path:
    poses = np.array([(p.x, p.y, p.theta) for p in ros.poses], np.float64).reshape(-1, 3)
    return Path(stamp_from_ros(ros.header), ros.header.frame_id, poses)


def _frontiers_from(ros: Any) -> tuple[Frontier, ...]:
    return tuple(record_from(Frontier, each) for each in ros)


_FORMS: dict[Any, _Form] = {
    bool: _Form(_same, _same, bool),
    int: _Form(_same, _same, int),
    float: _Form(_same, _same, float),
    str: _Form(_same, _same, str),
    SE2: _Form(lambda p: _Pose2D(p.x, p.y, p.yaw), _pose_from, lambda: _Pose2D(0.0, 0.0, 0.0)),
    tuple[float, float]: _Form(lambda p: _Point(*p, 0.0), lambda ros: (ros.x, ros.y), lambda: _Point(0.0, 0.0, 0.0)),
    tuple[float, float, float]: _Form(
        lambda p: _Pose2D(*p), lambda ros: (ros.x, ros.y, ros.theta), lambda: _Pose2D(0.0, 0.0, 0.0)
    ),
    NDArray[np.float64]: _Form(
        _points_to, lambda ros: np.array([(p.x, p.y) for p in ros], np.float64).reshape(-1, 2), list
    ),
    NDArray[np.float32]: _Form(
        lambda cells: np.ascontiguousarray(cells, np.float32).reshape(-1),
        lambda ros: np.array(ros, np.float32).reshape(-1, 2),
        lambda: np.empty(0, np.float32),
    ),
    tuple[tuple[float, float], ...]: _Form(_points_to, lambda ros: tuple((p.x, p.y) for p in ros), list),
    Path: _Form(_path_to, _path_from, lambda: _path_to(Path(0, "", np.empty((0, 3))))),
    tuple[Frontier, ...]: _Form(
        lambda some: [record_class(_FRONTIER)(**values_of(each)) for each in some], _frontiers_from, list
    ),
}
