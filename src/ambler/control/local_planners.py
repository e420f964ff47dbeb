"""The local planners of this package by name. One of one's own needs no name: `nodes.controller.ControllerNode` takes any `LocalPlanner`."""

from __future__ import annotations

from typing import Literal

from ambler.control.config import RolloutConfig
from ambler.control.dynamic_window import DynamicWindow
from ambler.control.motion_primitives import MotionPrimitives
from ambler.control.omni_pursuit import OmniPursuit
from ambler.control.primitives_config import PrimitivesConfig
from ambler.control.pursuit_config import PursuitConfig
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.core.protocols import LocalPlanner
from ambler.core.robot import RobotModel

Controller = Literal["rollout", "dwa", "pursuit", "primitives"]


def local_planner(
    name: Controller,
    robot: RobotModel,
    rollout: RolloutConfig | None = None,
    pursuit: PursuitConfig | None = None,
    primitives: PrimitivesConfig | None = None,
) -> LocalPlanner:
    """Return a new local planner: `rollout` configures the first two, `pursuit` and `primitives` those of their names."""
    if name == "pursuit":
        return OmniPursuit(pursuit if pursuit is not None else PursuitConfig(), robot)
    if name == "primitives":
        return MotionPrimitives(primitives if primitives is not None else PrimitivesConfig(), robot)
    kind = DynamicWindow if name == "dwa" else TrajectoryRollout
    return kind(rollout if rollout is not None else RolloutConfig(), robot)
