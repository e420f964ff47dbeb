"""A ring of ultrasonic transducers around any robot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.robot import RobotModel
from ambler.core.se3 import SE3
from ambler.robots.sensors import TRANSDUCERS, TransducerGeometry

RING = 12
RING_HEIGHT = 0.2  # metres above the floor, or below the top of a lower body


def with_transducer_ring(
    model: RobotModel, count: int = RING, transducer: TransducerGeometry = TRANSDUCERS["transducer_30"]
) -> RobotModel:
    """Return the robot with `count` transducers `sonar_0 ...` on its outline, evenly spaced by angle, the first one ahead. Raises
    BadInputError when it has transducers already."""
    if model.rangers:
        raise BadInputError(f"robot {model.name} has ultrasonic transducers already")
    height = min(RING_HEIGHT, model.body_height - 0.03)
    mounts = []
    for k in range(count):
        yaw = math.remainder(2.0 * math.pi * k / count, 2.0 * math.pi)
        reach = _to_outline(model.footprint, yaw)
        place = SE3.from_rpy((reach * math.cos(yaw), reach * math.sin(yaw), height), 0.0, 0.0, yaw)
        mounts.append(transducer.mount(f"sonar_{k}", place))
    return replace(model, sensors=(*model.sensors, *mounts))


def _to_outline(footprint: NDArray[np.float64], yaw: float) -> float:
    """Distance from the base's origin to the convex footprint's edge in a direction."""
    edge = np.roll(footprint, -1, axis=0) - footprint
    normals = np.column_stack((edge[:, 1], -edge[:, 0]))
    along = normals @ np.array([math.cos(yaw), math.sin(yaw)])
    offset = np.sum(normals * footprint, axis=1)
    return float(np.min(offset[along > 1e-12] / along[along > 1e-12]))
