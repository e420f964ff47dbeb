"""Poses that a viewer publishes, as CDR or JSON: a goal (PoseStamped), or where the robot is (PoseWithCovarianceStamped, whose
covariance the robot's configuration replaces). They are checked before anything may drive there or believe them.
"""

from __future__ import annotations

import json
import math
from typing import Any

from ambler.core.errors import BadInputError
from ambler.core.messages import PoseStamped
from ambler.core.se3 import SE3
from ambler.wire.ros_messages import decode

POSE_SCHEMA = "geometry_msgs/msg/PoseStamped"
ESTIMATE_SCHEMA = "geometry_msgs/msg/PoseWithCovarianceStamped"
_COVARIANCE_BYTES = 36 * 8  # the last field; what comes before it has the layout of a PoseStamped


def normalized_type(name: str) -> str:
    """Return a ROS type name with `/msg/`; viewers leave it out or put it in as they like."""
    package, _, rest = name.partition("/")
    return name if not rest or rest.startswith("msg/") else f"{package}/msg/{rest}"


def pose_from_client(encoding: str, schema: str, data: bytes, stamp_ns: int, wanted: str = POSE_SCHEMA) -> PoseStamped:
    """Read a pose that a viewer sent as `wanted`; `stamp_ns` replaces its stamp, which is the browser's clock.

    Raises BadInputError for another schema or encoding, damaged data, numbers that are not finite, or no direction.
    """
    if normalized_type(schema) != wanted:
        raise BadInputError(f"a pose here must be {wanted}, not {schema}")
    is_estimate = wanted == ESTIMATE_SCHEMA
    if encoding == "cdr":
        frame, pose = _from_cdr(data[:-_COVARIANCE_BYTES] if is_estimate else data)
    elif encoding == "json":
        frame, pose = _from_json(data, is_estimate=is_estimate)
    else:
        raise BadInputError(f"a pose must be encoded as cdr or json, not {encoding}")
    return PoseStamped(stamp_ns, frame.removeprefix("/"), _checked(pose))


def _from_cdr(data: bytes) -> tuple[str, SE3]:
    message = decode(PoseStamped, data)
    return message.frame, message.pose


def _from_json(data: bytes, *, is_estimate: bool) -> tuple[str, SE3]:
    try:
        fields: Any = json.loads(data)
        placed = fields["pose"]["pose"] if is_estimate else fields["pose"]
        position, q = placed["position"], placed["orientation"]
        translation = (float(position["x"]), float(position["y"]), float(position.get("z", 0.0)))
        rotation = (float(q["w"]), float(q.get("x", 0.0)), float(q.get("y", 0.0)), float(q["z"]))
        return str(fields["header"]["frame_id"]), SE3(translation, rotation)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadInputError(f"this is no JSON of a pose: {error}") from error


def _checked(pose: SE3) -> SE3:
    if not all(math.isfinite(value) for value in (*pose.translation, *pose.rotation)):
        raise BadInputError("the pose holds numbers that are not finite")
    w, x, y, z = pose.rotation
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0.5 < norm < 2.0:
        raise BadInputError(f"the pose has no direction: its quaternion has length {norm:.3g}")
    return SE3(pose.translation, (w / norm, x / norm, y / norm, z / norm))
