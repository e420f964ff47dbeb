"""Odometry on the bus: the wheels' own odometry and turn rates in; `odometry` and odom -> base out, for everybody, at the wheels' rate."""

from __future__ import annotations

from ambler.core.messages import Imu, Odometry, Transforms, TransformStamped
from ambler.core.robot import RobotModel
from ambler.localization.odometry import OdometryEstimator, WheelInertialOdometry
from ambler.runtime.node import Node
from ambler.runtime.topics import IMU, ODOMETRY, TRANSFORMS, WHEEL_ODOMETRY


class OdometryNode(Node):
    """Runs any `OdometryEstimator`. When the wheels fall silent nothing is published, odometry grows stale, and the gate stops the robot.

    The turn rates are those of the robot's first IMU.
    """

    name = "odometry"
    inputs = (WHEEL_ODOMETRY,)
    optional_inputs = (IMU,)
    outputs = (ODOMETRY, TRANSFORMS)
    latency = 5e-4

    def __init__(self, robot: RobotModel, estimator: OdometryEstimator | None = None) -> None:
        self._estimator = estimator if estimator is not None else WheelInertialOdometry()
        self._imu = next((mount for mount in robot.sensors if mount.kind == "imu"), None)

    def start(self) -> None:
        """Subscribe to wheels and IMU."""
        self.ctx.subscribe(WHEEL_ODOMETRY, self._on_wheels)
        self.ctx.subscribe(IMU, self._on_imu)

    def _on_imu(self, message: Imu) -> None:
        if self._imu is None or message.frame != self._imu.frame:
            return
        self._estimator.add_imu(message.stamp_ns, self._imu.base_from_sensor.rotate(message.angular_velocity))

    def _on_wheels(self, message: Odometry) -> None:
        update = self._estimator.update(message)
        for note in update.notes:
            self.ctx.log(note.code, note.text)
        odometry = update.odometry
        if odometry is None:
            return
        self.ctx.publish(ODOMETRY, odometry)
        edge = TransformStamped(odometry.stamp_ns, odometry.frame, odometry.child, odometry.pose)
        self.ctx.publish(TRANSFORMS, Transforms(odometry.stamp_ns, (edge,)))
