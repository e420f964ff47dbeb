"""What truly happens to a robot, told as a device would tell its measurements; judges read it, algorithms must not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ambler.core import messages as m
from ambler.core.se3 import SE3
from ambler.sim.body import TICK, TICK_NS, Body
from ambler.sim.devices import SimulatedDevice
from ambler.sim.truth import truth_grid
from ambler.sim.world import World

TRUTH_PERIOD_NS = 20_000_000
CONTACT_PERIOD_NS = 100_000_000
WORLD = "world"


class GroundTruth(SimulatedDevice[m.Odometry | m.Contact]):
    """True poses of the base in the frame `world`, at 50 Hz, and contacts: when they begin, and every 0.1 s while they last."""

    def __init__(self, world: World, body: Body) -> None:
        super().__init__(world, body, "truth", TICK_NS)
        self._reported: dict[tuple[str, str], int] = {}

    @property
    def poll_period(self) -> float:
        """The period of the poses, seconds."""
        return TRUTH_PERIOD_NS * 1e-9

    def start_pose(self, stamp_ns: int) -> m.PoseStamped:
        """Return where the robot started."""
        return m.PoseStamped(stamp_ns, WORLD, SE3.from_se2(self._body.start))

    def grid(self, stamp_ns: int, resolution: float) -> m.OccupancyGrid:
        """Return the true map: the world cut at the height of the robot's main scanner, free where it can get to."""
        spec = replace(self._world.spec, start=self._body.start)
        return m.OccupancyGrid(stamp_ns, WORLD, *truth_grid(spec, self._body.robot.sensor_height, resolution))

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        for touch in self._world.touches(self._body):
            key = (touch.part, touch.solid)
            if elapsed_ns - self._reported.get(key, -CONTACT_PERIOD_NS) >= CONTACT_PERIOD_NS:
                self._reported[key] = elapsed_ns
                approach = self._world.approach_of(self._body, touch)
                told = (touch.part, touch.solid, touch.position, touch.speed, touch.force, approach)
                self._send(m.Contact(now_ns, *told))
        if elapsed_ns % TRUTH_PERIOD_NS == 0:
            self._send(self._pose(now_ns))

    def _pose(self, now_ns: int) -> m.Odometry:
        history, linear, angular = self._body.history, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        pose = history[-1][1]
        if len(history) > 1:
            motion = history[-2][1].inverse() @ pose
            x, y, z = motion.translation
            _, qx, qy, qz = motion.rotation if motion.rotation[0] >= 0 else tuple(-v for v in motion.rotation)
            linear, angular = (x / TICK, y / TICK, z / TICK), (2 * qx / TICK, 2 * qy / TICK, 2 * qz / TICK)
        return m.Odometry(now_ns, WORLD, "base", pose, linear, angular, np.zeros((6, 6)), np.zeros((6, 6)))
