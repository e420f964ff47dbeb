"""The robot's camera in a world with docks: markers that nothing hides, people who hide a part of them, light and lens as the faults have it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.robot import SensorMount
from ambler.core.se3 import SE3
from ambler.sim.camera import CameraSpec, Light, Print, PrintCamera, plain_print
from ambler.sim.dock_body import dock_prints, marker_poses
from ambler.sim.faults import FaultInjector, FaultKind
from ambler.sim.lidar import NO_MOVERS, Movers
from ambler.sim.scene import RayScene
from ambler.sim.sensors import named_generator
from ambler.sim.solids import Shape, SimDock

F64 = NDArray[np.float64]

REACH = 6.0  # metres beyond which a marker is a spot
RAYS = 3  # of the five to a marker's middle and corners, how many must reach it
FADE_HZ, WANDER_HZ = 0.5, 0.13
LEAST_LIGHT, SHADE = 0.25, 0.6
BLUR_PX = 1.8
CLOTHES = 70  # grey level of what moves
LEAST_DEPTH = 0.05  # metres that what moves must be before the eye
FACING = SE3.from_rpy((0.0, 0.0, 0.0), 0.5 * math.pi, 0.0, -0.5 * math.pi)  # a print that who looks along x sees
STILL = 1e-4  # metres of motion during an exposure that no picture shows


@dataclass(frozen=True, slots=True)
class _Board:
    """A dock as the camera sees it, and the points (5, 3) in the world by which each of its markers is looked for."""

    panel: Print
    markers: tuple[Print, ...]
    points: tuple[F64, ...]


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
        """What may be in the picture, the farthest first: docks, and people who hide a part of them."""
        eye = np.array(world_from_camera.translation)
        is_missing = self._faults.is_on(FaultKind.MARKER_MISSING, seconds)
        is_hidden = self._faults.is_on(FaultKind.OCCLUSION, seconds)
        found: list[tuple[float, list[Print]]] = []
        for board in self._boards:
            away = float(np.linalg.norm(np.array(board.panel.world_from_print.translation) - eye))
            if away > REACH:
                continue
            prints = [board.panel]
            for k, (marker, points) in enumerate(zip(board.markers, board.points, strict=True)):
                if (k == 0 and is_missing) or not self._reaches(eye, points):
                    continue
                prints.append(marker)
                if k == 0 and is_hidden:
                    before = marker.world_from_print @ SE3((-0.5 * marker.width, 0.0, 0.01))
                    prints.append(plain_print(90, marker.width, marker.height, before))
            found.append((away, prints))
        if found:
            found += _silhouettes(eye, movers)
        found.sort(key=lambda f: -f[0])
        return [one for _, prints in found for one in prints]

    def _reaches(self, eye: F64, points: F64) -> bool:
        """Whether nothing that stands hides a marker. What moves is drawn and hides what it covers."""
        ways = points - eye
        lengths = np.linalg.norm(ways, axis=1)
        distances, _, _ = self._scene.cast(np.tile(eye, (len(points), 1)), ways / lengths[:, None])
        return int(np.count_nonzero(distances >= lengths - 1e-3)) >= RAYS

    def _light(self, seconds: float) -> Light:
        gain, shadow, shade = 1.0, 1.0, 0.0
        if self._faults.is_on(FaultKind.LIGHT, seconds):
            swell = 0.5 + 0.5 * math.cos(2.0 * math.pi * FADE_HZ * seconds)
            gain = LEAST_LIGHT + (1.0 - LEAST_LIGHT) * swell
        if self._faults.is_on(FaultKind.SHADOW, seconds):
            shadow, shade = 0.5 + 0.35 * math.sin(2.0 * math.pi * WANDER_HZ * seconds), SHADE
        return Light(gain, shadow=shadow, shade=shade)


def _silhouettes(eye: F64, movers: Movers) -> list[tuple[float, list[Print]]]:
    """Return upright boards as wide and high as what moves looks from the eye, with their distances. Rows are those of `scene.primitive`; what stands
    around the eye, as its own robot would, is left out."""
    out = []
    for row, kind in zip(movers.prims, movers.kinds, strict=True):
        middle, half = row[:2] - eye[:2], row[3:6]
        away = math.hypot(*middle)
        if kind == Shape.CYLINDER:
            reach = float(half[0])
            if not reach < away < REACH:
                continue
            sides = np.array([-1.0, 1.0]) * away * math.tan(math.asin(reach / away))
        else:
            axes = row[6:15].reshape(3, 3)[:2, :2] * half[:2]
            corners = middle + np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ axes.T
            ahead, aside = middle / max(away, 1e-9), np.array([-middle[1], middle[0]]) / max(away, 1e-9)
            depth = corners @ ahead
            if not (float(depth.min()) > LEAST_DEPTH and away < REACH):
                continue
            sides = away * np.array([(corners @ aside / depth).min(), (corners @ aside / depth).max()])
        bearing = math.atan2(middle[1], middle[0])
        place = SE3(
            (float(row[0]), float(row[1]), float(row[2])), (math.cos(0.5 * bearing), 0.0, 0.0, math.sin(0.5 * bearing))
        )
        board = place @ SE3((0.0, 0.5 * float(sides[0] + sides[1]), 0.0)) @ FACING
        out.append((away, [plain_print(CLOTHES, float(sides[1] - sides[0]), 2.0 * float(half[2]), board)]))
    return out


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
