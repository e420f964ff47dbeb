"""Ultrasonic transducers: the nearest surface anywhere within a cone, whatever it is made of; and a ring of them around a robot.

Sound sees what light sees, and glass too. A surface that the cone meets too flat throws the sound away.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Range
from ambler.core.se3 import SE3
from ambler.kernels import raycast
from ambler.robots.ring import RING, with_transducer_ring
from ambler.sim.lidar import NO_MOVERS, Movers
from ambler.sim.scene import RayScene
from ambler.sim.sensors import TRANSDUCER_30, UltrasonicSpec, named_generator
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import Shape

GROUPS = 4  # transducers of one group fire together, far apart from each other

F64 = NDArray[np.float64]


class UltrasonicSensor:
    """One transducer with its own chance."""

    def __init__(self, spec: UltrasonicSpec, frame: str, scene: RayScene, seed: int) -> None:
        self.spec, self.frame = spec, frame
        kinds = scene.solids.kinds
        self._solids = scene.solids._replace(kinds=np.where(kinds == raycast.GLASS, Shape.BOX, kinds).astype(np.uint8))
        self._rng = named_generator(seed, frame)
        self._directions = spec.directions()[None, :, :]
        self._distance, self._cosine, self._intensity = (
            np.zeros(self._directions.shape[:2], np.float32) for _ in range(3)
        )

    def measure(self, world_from_sensor: SE3, stamp_ns: int, movers: Movers = NO_MOVERS) -> Range:
        """Return the echo of a pulse that is sent now from this pose."""
        spec = self.spec
        distance = self._nearest(world_from_sensor, movers)
        noise, chance, other = self._rng.standard_normal(), self._rng.random(), self._rng.random()
        if chance < spec.dropout:
            distance = math.inf
        elif chance < spec.dropout + spec.crosstalk:
            distance = min(distance, spec.range_min + other * (spec.range_max - spec.range_min))
        distance += spec.sigma * noise
        if distance > spec.range_max:
            distance = math.inf
        elif distance < spec.range_min:
            distance = -math.inf
        return Range(stamp_ns, self.frame, spec.field_of_view, spec.range_min, spec.range_max, distance)

    def _nearest(self, world_from_sensor: SE3, movers: Movers) -> float:
        """Distance to the nearest surface of the cone that sends an echo; inf without one."""
        position, rotation = np.array(world_from_sensor.translation), np.array(world_from_sensor.rotation)
        raycast.sweep(
            *(self._solids, movers),
            raycast.Track(np.array([0.0, 1.0]), np.stack([position] * 2), np.stack([rotation] * 2)),
            *(np.zeros(1), self._directions, self.spec.range_max + 1.0),
            raycast.Returns(self._distance, self._cosine, self._intensity),
        )
        heard = self._cosine[0] >= math.cos(self.spec.incidence_max)
        return float(self._distance[0].min(where=heard, initial=np.inf))


def with_ultrasonic_ring(robot: SimRobot, count: int = RING, spec: UltrasonicSpec = TRANSDUCER_30) -> SimRobot:
    """Return the robot with `count` transducers `sonar_0 ...` on its outline, which fire in four groups; see `robots.ring`."""
    model = with_transducer_ring(robot.model, count, spec)
    phases = {mount.frame: (k % GROUPS) * spec.period / GROUPS for k, mount in enumerate(model.rangers)}
    return replace(robot, model=model, ultrasonics={f: replace(spec, phase=phase) for f, phase in phases.items()})
