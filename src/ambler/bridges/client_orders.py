"""What viewers publish besides poses: points, polygons, clouds, numbers, as CDR or JSON, checked before anything obeys them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.bridges.client_poses import normalized_type
from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.wire.ros_messages import decode, ros_type_of

MAP = "map"
FARTHEST = 1e5  # metres: no site is larger, and costmaps need not think about what lies beyond


def order_from_client(wanted: type[m.Message], encoding: str, schema: str, data: bytes, stamp_ns: int) -> m.Message:
    """Read what a viewer sent as a message of class `wanted`; `stamp_ns` replaces its stamp. Raises BadInputError for another schema or encoding,
    damaged data, numbers that are not finite, places that are not told in the frame map, and those too far away."""
    if normalized_type(schema) != ros_type_of(wanted):
        raise BadInputError(f"this must be {ros_type_of(wanted)}, not {schema}")
    if encoding == "cdr":
        message: Any = decode(wanted, data)
    elif encoding == "json" and wanted in _FROM_JSON:
        try:
            message = _FROM_JSON[wanted](json.loads(data))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
            raise BadInputError(f"this is no JSON of a {ros_type_of(wanted)}: {error}") from error
    else:
        raise BadInputError(f"a {ros_type_of(wanted)} must not be encoded as {encoding}")
    return _checked(replace(message, stamp_ns=stamp_ns))


def _checked(message: Any) -> m.Message:
    if isinstance(message, m.Number):
        if not (math.isfinite(message.value) and message.value >= 0.0):
            raise BadInputError(f"{message.value} is no speed or radius")
        return message
    if isinstance(message, m.Code):
        if message.value not in (0, 1, 2):
            raise BadInputError(f"an order to stop is 0, 1 or 2, not {message.value}")
        return message
    frame = message.frame.removeprefix("/") or MAP
    if frame != MAP:
        raise BadInputError(f"it must be told in the frame map, not in {frame!r}")
    points = message.point if isinstance(message, m.PointStamped) else message.points
    if not np.isfinite(np.asarray(points, np.float64)).all():
        raise BadInputError("it holds numbers that are not finite")
    if np.abs(np.asarray(points, np.float64)).max(initial=0.0) > FARTHEST:
        raise BadInputError(f"it holds places more than {FARTHEST * 1e-3:g} km from where the map begins")
    if isinstance(message, m.Polygon) and len(points) in (1, 2):
        raise BadInputError(f"a boundary has three corners or more, or none, not {len(points)}")
    return replace(message, frame=frame)  # type: ignore[no-any-return]


def _xyz(place: Any) -> tuple[float, float, float]:
    return float(place["x"]), float(place["y"]), float(place.get("z", 0.0))


def _point(fields: Any) -> m.PointStamped:
    return m.PointStamped(0, str(fields["header"]["frame_id"]), _xyz(fields["point"]))


def _polygon(fields: Any) -> m.Polygon:
    corners: NDArray[np.float32] = np.array([_xyz(p) for p in fields["polygon"]["points"]], np.float32).reshape(-1, 3)
    return m.Polygon(0, str(fields["header"]["frame_id"]), corners)


_FROM_JSON: Mapping[type[m.Message], Callable[[Any], m.Message]] = {
    m.PointStamped: _point,
    m.Polygon: _polygon,
    m.Number: lambda fields: m.Number(0, float(fields["data"])),
    m.Code: lambda fields: m.Code(0, int(fields["data"])),
}
