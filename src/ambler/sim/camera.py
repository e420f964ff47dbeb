"""A camera that sees flat prints: markers, checkerboards and whatever stands before them, by exact homographies.

Every picture element is split into `samples` x `samples` rays without distortion; each ray meets a print's plane where the
homography says, so lens distortion, slant and edges are exact to a fraction of the split. Behind the prints lies a cloudy grey
background. Then come light, motion (several poses within the exposure), blur of the lens, noise and clipping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

TEXELS = 32  # per cell of a pattern
NEAREST = 0.02  # metres; what is nearer to the camera is not drawn

FRONT_CAMERA = CameraModel("camera", 640, 480, 554.0, 554.0, 319.5, 239.5, (-0.11, 0.06, 0.0004, -0.0003, 0.0))
"""640 x 480, 60 degrees wide, with the distortion of a small lens."""


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """A flat picture: `texture` uint8 (H, W), `width` and `height` in metres about the origin of its frame (x right, y up, z out of
    the face). From behind it is not seen."""

    texture: U8
    width: float
    height: float
    world_from_print: SE3


@dataclass(frozen=True, slots=True)
class Light:
    """`gain` 1 shows white as 230. `gradient`: share of light lost or won from the middle to the right and the lower edge. `shadow`: from
    this share of the width on to the right, three pixels soft, `shade` of the light is lost."""

    gain: float = 1.0
    gradient: tuple[float, float] = (0.0, 0.0)
    shadow: float = 1.0
    shade: float = 0.0


@dataclass(frozen=True, slots=True)
class PictureNoise:
    """Blur of the lens (sigma) and noise of the sensor (sigma at white, grey levels; a third of it is there in the dark)."""

    blur_px: float = 0.6
    noise: float = 2.5


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A simulated camera."""

    model: CameraModel = FRONT_CAMERA
    picture: PictureNoise = field(default_factory=PictureNoise)
    rate_hz: float = 15.0
    exposure: float = 0.008
    samples: int = 4


class PrintCamera:
    """Takes pictures. The same seed of `rng` gives the same pictures."""

    def __init__(self, spec: CameraSpec, rng: np.random.Generator) -> None:
        self.spec = spec
        self._rng = rng
        self._background = _cloudy(spec.model.height, spec.model.width, rng)
        self._rays = _ray_table(spec.model, spec.samples)
        self._limits = self._rays.min(axis=(0, 1)) - 0.05, self._rays.max(axis=(0, 1)) + 0.05

    def take(
        self,
        world_from_cameras: Sequence[SE3],
        prints: Sequence[Print],
        light: Light | None = None,
        more_blur_px: float = 0.0,
    ) -> U8:
        """Return a picture uint8 (H, W). A print covers those before it in the list. Several poses are those of a moving camera, spread
        evenly over the exposure. `more_blur_px` comes on top of the lens's own."""
        model, light = self.spec.model, light if light is not None else Light()
        exposed = [self._project(pose, prints) for pose in world_from_cameras]
        image = np.mean(exposed, axis=0) if len(exposed) > 1 else exposed[0]
        u, v = np.linspace(-1.0, 1.0, model.width), np.linspace(-1.0, 1.0, model.height)
        gain = light.gain * (1.0 + light.gradient[0] * u[None, :] + light.gradient[1] * v[:, None])
        if light.shade > 0.0:
            edge = (np.arange(model.width) - light.shadow * model.width) / 3.0
            gain = gain * (1.0 - light.shade * np.clip(edge + 0.5, 0.0, 1.0))
        image = (image * gain).astype(np.float32)
        blur_px = float(np.hypot(self.spec.picture.blur_px, more_blur_px))
        if blur_px > 0.0:
            image = cv2.GaussianBlur(image, (0, 0), blur_px)
        sigma = self.spec.picture.noise
        if sigma > 0.0:
            share = np.sqrt(1.0 / 9.0 + np.clip(image, 0.0, 255.0) * (8.0 / 9.0 / 230.0))
            image = image + sigma * share * self._rng.standard_normal(image.shape, np.float32)
        return np.asarray(np.clip(np.rint(image), 0.0, 255.0), np.uint8)

    def _project(self, world_from_camera: SE3, prints: Sequence[Print]) -> F32:
        image = self._background.copy()
        camera_from_world = world_from_camera.inverse()
        for p in prints:
            self._draw(image, camera_from_world @ p.world_from_print, p)
        return image

    def _draw(self, image: F32, camera_from_print: SE3, p: Print) -> None:
        matrix = camera_from_print.matrix()
        box = self._box(camera_from_print, p)
        if box is None or float(matrix[:3, 2] @ matrix[:3, 3]) >= 0.0:
            return
        n = self.spec.samples
        v0, v1, u0, u1 = box
        rays = self._rays[v0 * n : v1 * n, u0 * n : u1 * n]
        # A ray (x, y, 1) times its depth = R (a, b, 0) + t: the homography from the print to rays, inverted.
        homography = np.linalg.inv(np.column_stack((matrix[:3, 0], matrix[:3, 1], matrix[:3, 3]))).astype(np.float32)
        a, b, c = (h[0] * rays[..., 0] + h[1] * rays[..., 1] + h[2] for h in homography)
        texture = _level(p.texture, p.width, camera_from_print.translation[2], self.spec)
        rows, columns = texture.shape
        half = np.float32(0.5)
        x = (a / c) * np.float32(columns / p.width) + np.float32(0.5 * columns - 0.5)
        y = (b / c) * np.float32(-rows / p.height) + np.float32(0.5 * rows - 0.5)
        colour = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        is_hit = (x > -half) & (x < columns - half) & (y > -half) & (y < rows - half) & (c > 0.0)
        size = (u1 - u0, v1 - v0)
        share = cv2.resize(is_hit.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        seen = cv2.resize(colour * is_hit, size, interpolation=cv2.INTER_AREA)
        part = image[v0:v1, u0:u1]
        part *= 1.0 - share
        part += seen

    def _box(self, camera_from_print: SE3, p: Print) -> tuple[int, int, int, int] | None:
        """Return the rows and columns that a print may cover, or None when it is out of the picture."""
        t = np.linspace(-0.5, 0.5, 9)
        rim = [(s, e) for s in t for e in (-0.5, 0.5)] + [(e, s) for s in t for e in (-0.5, 0.5)]
        corners = np.array([[p.width * a, p.height * b, 0.0] for a, b in rim])
        points = camera_from_print.transform(corners)
        if float(points[:, 2].max()) < NEAREST:
            return None
        model = self.spec.model
        if float(points[:, 2].min()) < NEAREST:
            return 0, model.height, 0, model.width
        rays = points[:, :2] / points[:, 2:]
        pixels = model.distort(np.clip(rays, *self._limits).astype(np.float64))
        u0, v0 = np.maximum(np.floor(pixels.min(axis=0)) - 2, 0).astype(int)
        u1, v1 = np.ceil(pixels.max(axis=0)).astype(int) + 3
        u1, v1 = min(int(u1), model.width), min(int(v1), model.height)
        return (int(v0), v1, int(u0), u1) if v0 < v1 and u0 < u1 else None


def marker_print(dictionary: str, number: int, size: float, world_from_marker: SE3, rim: float = 1.0) -> Print:
    """Return a marker whose black square has the side `size` (m), on white paper that reaches `rim` cells farther."""
    found = getattr(cv2.aruco, f"DICT_{dictionary}", None)
    if found is None:
        raise BadInputError(f"no dictionary of markers {dictionary!r}")
    markers = cv2.aruco.getPredefinedDictionary(found)
    cells = int(markers.markerSize) + 2
    square = cv2.aruco.generateImageMarker(markers, number, cells * TEXELS, borderBits=1)
    if dictionary.startswith("APRILTAG"):
        square = np.rot90(square, 2)  # as AprilTag publishes them; OpenCV's stand on their heads
    texture = _ink(np.pad(square, round(rim * TEXELS), constant_values=255))
    side = size * (cells + 2.0 * round(rim * TEXELS) / TEXELS) / cells
    return Print(texture, side, side, world_from_marker)


def checkerboard_print(columns: int, rows: int, square: float, world_from_board: SE3) -> Print:
    """Return a checkerboard with so many inner corners, the origin of its frame in its middle."""
    board = (np.indices((rows + 1, columns + 1)).sum(axis=0) % 2) * 255
    texture = np.pad(np.kron(board, np.ones((TEXELS, TEXELS))), TEXELS, constant_values=255).astype(np.uint8)
    return Print(_ink(texture), (columns + 3) * square, (rows + 3) * square, world_from_board)


def plain_print(grey: int, width: float, height: float, world_from_print: SE3) -> Print:
    """Return a plain board: a wall, the body of a dock, a hand before a marker."""
    return Print(np.full((8, 8), grey, np.uint8), width, height, world_from_print)


def _ink(texture: NDArray[np.generic]) -> U8:
    """Black ink reflects a little, white paper not everything."""
    return np.where(np.asarray(texture) > 127, 230, 25).astype(np.uint8)


def _level(texture: U8, width: float, depth: float, spec: CameraSpec) -> F32:
    """Return the texture averaged down until its elements are not smaller than a ray's: smaller ones would be missed."""
    wanted = max(1.0, width * spec.model.fx / max(depth, NEAREST) * spec.samples)
    factor = 1
    while texture.shape[1] / factor > wanted and all(s % (2 * factor) == 0 for s in texture.shape):
        factor *= 2
    rows, columns = texture.shape
    shape = (rows // factor, factor, columns // factor, factor)
    return np.ascontiguousarray(texture.reshape(shape).mean(axis=(1, 3)), np.float32)


@lru_cache(maxsize=4)
def _ray_table(model: CameraModel, samples: int) -> F32:
    """Return the rays of all samples, float32 (H * samples, W * samples, 2)."""
    offset = (np.arange(samples) + 0.5) / samples - 0.5
    u = (np.arange(model.width)[:, None] + offset).reshape(-1)
    v = (np.arange(model.height)[:, None] + offset).reshape(-1)
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return model.undistort(grid).astype(np.float32).reshape(len(v), len(u), 2)


def _cloudy(height: int, width: int, rng: np.random.Generator) -> F32:
    coarse = rng.uniform(70.0, 170.0, (height // 40 + 1, width // 40 + 1)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)
