"""Depth cameras on any robot: five on `spot`, where the real one has them, and one over the front of the others."""

from __future__ import annotations

import math
from dataclasses import replace

from ambler.core.errors import BadInputError
from ambler.core.robot import RobotModel
from ambler.core.se3 import SE3
from ambler.robots.sensors import DEPTH_CAMERAS, DepthGeometry

# Frame, place (m), heading and pitch below the horizon (deg). The two in front look a little to the sides; with half a picture of 29° their upper
# edges see table tops one step ahead, their lower ones the floor from half a metre on.
SPOT = (
    ("depth_front_left", (0.44, 0.06, 0.55), 14.0, 15.0),
    ("depth_front_right", (0.44, -0.06, 0.55), -14.0, 15.0),
    ("depth_left", (-0.10, 0.22, 0.55), 90.0, 15.0),
    ("depth_right", (-0.10, -0.22, 0.55), -90.0, 15.0),
    ("depth_rear", (-0.44, 0.0, 0.55), 180.0, 15.0),
)
PITCH = 20.0  # degrees below the horizon: 9° above it stay in view
BELOW_TOP = 0.03  # metres


def with_depth_cameras(model: RobotModel, camera: DepthGeometry = DEPTH_CAMERAS["d430"]) -> RobotModel:
    """Return the robot with its depth cameras; raises BadInputError when it has some already."""
    if model.depth_cameras:
        raise BadInputError(f"robot {model.name} has depth cameras already")
    front = ((float(model.footprint[:, 0].max()), 0.0, model.body_height - BELOW_TOP), 0.0, PITCH)
    places = SPOT if model.name == "spot" else (("depth_front", *front),)
    mounts = (camera.mount(frame, optical(place, heading, pitch)) for frame, place, heading, pitch in places)
    return replace(model, sensors=(*model.sensors, *mounts))


def optical(place: tuple[float, float, float], heading_deg: float, pitch_deg: float) -> SE3:
    """Return base_from_camera of a camera at `place` that looks along a heading and so far below the horizon."""
    looking = SE3.from_rpy(place, 0.0, math.radians(pitch_deg), math.radians(heading_deg))
    return looking @ SE3.from_rpy((0.0, 0.0, 0.0), -0.5 * math.pi, 0.0, -0.5 * math.pi)
