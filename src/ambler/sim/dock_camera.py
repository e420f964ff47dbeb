"""The robot's camera in a world with docks: markers that nothing hides, light and lens as the faults have it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.robot import SensorMount
from ambler.core.se3 import SE3
from ambler.kernels import raycast
from ambler.sim.camera import CameraSpec, Light, Print, PrintCamera, plain_print
from ambler.sim.dock_body import dock_prints, marker_poses
from ambler.sim.faults import FaultInjector, FaultKind
from ambler.sim.lidar import NO_MOVERS, Movers
from ambler.sim.scene import RayScene
from ambler.sim.sensors import named_generator
from ambler.sim.solids import SimDock

REACH = 6.0  # metres beyond which a marker is a spot
RAYS = 3  # of the five to a marker's middle and corners, how many must reach it
FADE_HZ, WANDER_HZ = 0.5, 0.13
LEAST_LIGHT, SHADE = 0.25, 0.6
BLUR_PX = 1.8
STILL = 1e-4  # metres of motion during an exposure that no picture shows


@dataclass(frozen=True, slots=True)
class _Board:
    """A dock as the camera sees it, and the points (5, 3) in the world by which each of its markers is looked for."""

    panel: Print
    markers: tuple[Print, ...]
    points: tuple[NDArray[np.float64], ...]


class DockCamera:
    """Takes pictures of the docks of a world. The same seed gives the same pictures."""

    def __init__(
        self,
        spec: CameraSpec,
        mount: SensorMount,
        docks: Sequence[SimDock],
        scene: RayScene,
        faults: FaultInjector,
        seed: int,
    ) -> None:
        self.spec = spec
        self.mount = mount
        self._camera = PrintCamera(spec, named_generator(seed, mount.frame))
        self._scene = scene
        self._faults = faults
        self._boards = [_board(dock) for dock in docks]

    def take(self, world_from_bases: Sequence[SE3], seconds: float, movers: Movers = NO_MOVERS) -> NDArray[np.uint8]:
        """Return the picture uint8 (H, W) on a base that passes these poses during the exposure, `seconds` after the start; `movers` may
        hide markers."""
        world_from_cameras = [pose @ self.mount.base_from_sensor for pose in world_from_bases]
        if _moved(world_from_cameras[0], world_from_cameras[-1]) < STILL:
            world_from_cameras = world_from_cameras[-1:]
        prints = self._prints(world_from_cameras[-1], seconds, movers)
        more_blur_px = BLUR_PX if self._faults.is_on(FaultKind.BLUR, seconds) else 0.0
        return self._camera.take(world_from_cameras, prints, self._light(seconds), more_blur_px)

    def _prints(self, world_from_camera: SE3, seconds: float, movers: Movers) -> list[Print]:
        prints: list[Print] = []
        eye = np.array(world_from_camera.translation)
        is_missing = self._faults.is_on(FaultKind.MARKER_MISSING, seconds)
        is_hidden = self._faults.is_on(FaultKind.OCCLUSION, seconds)
        for board in self._boards:
            if float(np.linalg.norm(np.array(board.panel.world_from_print.translation) - eye)) > REACH:
                continue
            prints.append(board.panel)
            for k, (marker, points) in enumerate(zip(board.markers, board.points, strict=True)):
                if (k == 0 and is_missing) or not self._reaches(eye, points, movers):
                    continue
                prints.append(marker)
                if k == 0 and is_hidden:
                    before = marker.world_from_print @ SE3((-0.5 * marker.width, 0.0, 0.01))
                    prints.append(plain_print(90, marker.width, marker.height, before))
        return prints

    def _reaches(self, eye: NDArray[np.float64], points: NDArray[np.float64], movers: Movers) -> bool:
        ways = points - eye
        lengths = np.linalg.norm(ways, axis=1)
        directions = ways / lengths[:, None]
        distances, _, _ = self._scene.cast(np.tile(eye, (len(points), 1)), directions)
        if len(movers[0]):
            distances = np.minimum(distances, self._to_movers(eye, directions, movers))
        return int(np.count_nonzero(distances >= lengths - 1e-3)) >= RAYS

    def _to_movers(
        self, eye: NDArray[np.float64], directions: NDArray[np.float64], movers: Movers
    ) -> NDArray[np.float64]:
        """Distances (N,) along rays (N, 3) from the eye to the nearest surface, moving ones too."""
        scene, shape = self._scene, (1, len(directions))
        distance, cosine, intensity = (np.zeros(shape, np.float32) for _ in range(3))
        still = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
        raycast.sweep(
            *(*scene.hierarchy, scene.albedos, scene.floor, scene.ceiling, *movers),
            *(np.array([0.0, 1.0]), np.stack([eye, eye]), still, np.zeros(1), np.ascontiguousarray(directions[None])),
            *(2.0 * REACH, distance, cosine, intensity),
        )
        return np.asarray(distance[0], np.float64)

    def _light(self, seconds: float) -> Light:
        gain, shadow, shade = 1.0, 1.0, 0.0
        if self._faults.is_on(FaultKind.LIGHT, seconds):
            swell = 0.5 + 0.5 * math.cos(2.0 * math.pi * FADE_HZ * seconds)
            gain = LEAST_LIGHT + (1.0 - LEAST_LIGHT) * swell
        if self._faults.is_on(FaultKind.SHADOW, seconds):
            shadow, shade = 0.5 + 0.35 * math.sin(2.0 * math.pi * WANDER_HZ * seconds), SHADE
        return Light(gain, shadow=shadow, shade=shade)


def _moved(a: SE3, b: SE3) -> float:
    """Metres that a camera moved, and those that what it sees a metre away seemed to move."""
    motion = a.inverse() @ b
    return math.hypot(*motion.translation) + 2.0 * math.hypot(*motion.rotation[1:])


def _board(dock: SimDock) -> _Board:
    panel, markers = dock_prints(dock)
    points = []
    for marker, pose in zip(dock.markers, marker_poses(dock), strict=True):
        h = 0.5 * marker.size
        corners = np.array([[0.0, 0.0, 0.0], [-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
        points.append(pose.transform(corners))
    return _Board(panel, markers, tuple(points))
