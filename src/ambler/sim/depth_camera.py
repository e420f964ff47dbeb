"""Depth cameras: exact rays through the middles of the picture's elements, then the noise and the losses of a stereo pair."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ambler.core.messages import Image
from ambler.core.se3 import SE3
from ambler.kernels import raycast
from ambler.kernels.depth_picture import DepthErrors, to_depth
from ambler.robots.depth import with_depth_cameras
from ambler.sim.lidar import NO_MOVERS, Movers
from ambler.sim.scene import RayScene
from ambler.sim.sensors import D430, DepthCameraSpec, named_generator
from ambler.sim.sim_robot import SimRobot


class DepthCameraSensor:
    """One depth camera with its own chance; the whole picture is taken at one instant."""

    def __init__(self, spec: DepthCameraSpec, frame: str, scene: RayScene, seed: int) -> None:
        self.spec, self.frame = spec, frame
        self._scene = scene
        self._rng = named_generator(seed, frame)
        model = spec.model
        u, v = np.meshgrid(np.arange(model.width) - model.cx, np.arange(model.height) - model.cy)
        rays = np.stack([u / model.fx, v / model.fy, np.ones_like(u)], axis=-1)
        self._directions = rays / np.linalg.norm(rays, axis=2, keepdims=True)
        self._along = np.ascontiguousarray(self._directions[..., 2])
        self._reach = spec.reach / float(self._along.min())
        shape = self._along.shape
        self._distance, self._cosine, self._intensity, self._normals, self._uniforms = (
            np.zeros(shape, np.float32) for _ in range(5)
        )
        self._errors = DepthErrors(
            *(spec.sigma, spec.range_min, spec.reach, spec.dropout, spec.patch, spec.patches, spec.grazing_cosine),
            *(spec.edge, spec.shadow, spec.flying),
        )
        self._patches = np.zeros(tuple(math.ceil(n / spec.patch) for n in shape), np.float32)

    def take(self, world_from_camera: SE3, stamp_ns: int, movers: Movers = NO_MOVERS) -> Image:
        """Return the picture that is taken from this pose: depth uint16 (H, W) in millimetres."""
        scene = self._scene
        position, rotation = np.array(world_from_camera.translation), np.array(world_from_camera.rotation)
        raycast.sweep(
            *(scene.solids, movers),
            raycast.Track(np.array([0.0, 1.0]), np.stack([position] * 2), np.stack([rotation] * 2)),
            *(np.zeros(len(self._directions)), self._directions, self._reach),
            raycast.Returns(self._distance, self._cosine, self._intensity),
        )
        depth = np.empty(self._along.shape, np.uint16)
        self._rng.standard_normal(out=self._normals, dtype=np.float32)
        for uniforms in (self._uniforms, self._patches):
            self._rng.random(out=uniforms, dtype=np.float32)
        to_depth(
            *(self._distance, self._cosine, self._along),
            *(self._normals, self._uniforms, self._patches, self._errors, depth),
        )
        return Image(stamp_ns, self.frame, depth)


def with_simulated_depth_cameras(robot: SimRobot, spec: DepthCameraSpec = D430) -> SimRobot:
    """Return the robot with depth cameras (`robots.depth`), which take their pictures one after the other."""
    model = with_depth_cameras(robot.model, spec)
    frames = [mount.frame for mount in model.depth_cameras]
    phases = {frame: round(k * spec.period / len(frames) / 0.005) * 0.005 for k, frame in enumerate(frames)}
    return replace(
        robot, model=model, depth_cameras={frame: replace(spec, phase=phase) for frame, phase in phases.items()}
    )
