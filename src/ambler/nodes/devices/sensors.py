"""Scanners, inertial units and ultrasonic rings on the bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ambler.core.devices import Imu, Lidar, RangeSensor
from ambler.core.messages import Imu as ImuMessage
from ambler.nodes.devices.node import DeviceNode
from ambler.runtime.topics import RANGES, STATUS, Topic


class LidarNode(DeviceNode):
    """Publishes the scans of a planar scanner, or the clouds of one with many rings."""

    def __init__(self, lidar: Lidar, topic: Topic[Any]) -> None:
        super().__init__(f"lidar_{lidar.frame}", (lidar,))
        self._lidar, self._topic = lidar, topic
        self.outputs = (topic, STATUS)

    def poll(self) -> None:
        for measured in self._lidar.read(self.ctx.now_ns):
            self.ctx.publish(self._topic, measured)


class ImuNode(DeviceNode):
    """Publishes what an inertial unit measures."""

    def __init__(self, imu: Imu, topic: Topic[ImuMessage]) -> None:
        super().__init__(f"imu_{imu.frame}", (imu,))
        self._imu, self._topic = imu, topic
        self.outputs = (topic, STATUS)

    def poll(self) -> None:
        for measured in self._imu.read(self.ctx.now_ns):
            self.ctx.publish(self._topic, measured)


class RangesNode(DeviceNode):
    """Publishes the echoes of all transducers of a robot, one after the other."""

    outputs = (RANGES, STATUS)

    def __init__(self, transducers: Sequence[RangeSensor]) -> None:
        super().__init__("ranges", transducers)
        self._transducers = tuple(transducers)

    def poll(self) -> None:
        for transducer in self._transducers:
            for measured in transducer.read(self.ctx.now_ns):
                self.ctx.publish(RANGES, measured)
