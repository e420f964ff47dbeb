"""What the robot looks like and where its sensors sit, told once: an outline, and the fixed transforms from the base."""

from __future__ import annotations

from ambler.core import messages as m
from ambler.core.robot import RobotModel
from ambler.robots.outline import outline_urdf
from ambler.runtime.node import Node
from ambler.runtime.topics import ROBOT_DESCRIPTION, STATIC_TRANSFORMS


class MountsNode(Node):
    """Publishes `base` → sensor of every mount of a robot, and its outline as URDF."""

    name = "mounts"
    outputs = (STATIC_TRANSFORMS, ROBOT_DESCRIPTION)
    latency = 1e-6

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot

    def start(self) -> None:
        now_ns = self.ctx.now_ns
        edges = (m.TransformStamped(now_ns, "base", s.frame, s.base_from_sensor) for s in self._robot.sensors)
        self.ctx.publish(STATIC_TRANSFORMS, m.Transforms(now_ns, tuple(edges)))
        self.ctx.publish(ROBOT_DESCRIPTION, m.Text(now_ns, outline_urdf(self._robot)))
