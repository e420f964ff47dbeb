"""Surfaces of triangles: meshes, and height fields as ground. Rays and contact see the same triangles.

A cell of a height field is split the way MuJoCo splits it: along the diagonal from its lower left sample [iy, ix] to its upper
right one [iy + 1, ix + 1] (tests/sim/test_meshes.py measures both MuJoCo's rays and its contact).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

MIN_ALTITUDE = 1e-5  # metres; a flatter triangle is called degenerate


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """A rigid surface: `vertices` float64 (N, 3) in the frame of the solids, metres; `triangles` int32 (M, 3) of vertex numbers,
    counter-clockwise seen from outside. Rays and bodies meet both sides; contact is exact on the outer side (see
    `sim.surface_contact`). The arrays become read-only.

    Raises BadInputError, which names the mesh and the triangle, for numbers that are not finite, vertices that are not
    there, and triangles without area.
    """

    name: str
    vertices: F64
    triangles: I32
    albedo: float = 0.6

    def __post_init__(self) -> None:
        vertices, triangles = _checked(self.name, self.vertices, self.triangles)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)

    @property
    def corners(self) -> F64:
        """The corners of all triangles, float64 (M, 3, 3)."""
        return np.asarray(self.vertices[self.triangles])

    @property
    def is_closed(self) -> bool:
        """Whether the surface encloses a volume: every edge is run through once in each direction. Vertices at one place are one."""
        _, same = np.unique(self.vertices, axis=0, return_inverse=True)
        t = same.reshape(-1)[self.triangles].astype(np.int64)
        count = len(self.vertices)
        ways = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
        there, back = ways[:, 0] * count + ways[:, 1], ways[:, 1] * count + ways[:, 0]
        return bool(len(np.unique(there)) == len(there) and np.array_equal(np.sort(there), np.sort(back)))

    def moved(self, frame_from_mesh: SE2) -> TriangleMesh:
        """Return the mesh after an upright rigid motion."""
        xy = frame_from_mesh.transform(self.vertices[:, :2])
        return replace(self, vertices=np.column_stack([xy, self.vertices[:, 2]]))


@dataclass(frozen=True, slots=True, eq=False)
class HeightField:
    """Ground: `heights` float64 (ny, nx), metres, one sample every `resolution` metres; row 0 at the lowest y. `origin` is the pose of
    the sample [0, 0] in the frame of the solids, columns along its x. Below the surface everything is solid.

    Raises BadInputError, which names the field, for fewer than 2 x 2 samples or numbers that are not finite.
    """

    name: str
    heights: F64
    resolution: float
    origin: SE2
    albedo: float = 0.3

    def __post_init__(self) -> None:
        heights = np.array(self.heights, np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise BadInputError(f"height field {self.name!r}: needs at least 2 x 2 heights, has {heights.shape}")
        if not np.isfinite(heights).all():
            iy, ix = np.argwhere(~np.isfinite(heights))[0]
            raise BadInputError(f"height field {self.name!r}: the height at row {iy}, column {ix} is no number")
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise BadInputError(f"height field {self.name!r}: resolution must be positive, is {self.resolution}")
        heights.flags.writeable = False
        place = SE2(float(self.origin.x), float(self.origin.y), float(self.origin.yaw))
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "resolution", float(self.resolution))
        object.__setattr__(self, "origin", place)

    @property
    def lowest(self) -> float:
        """The lowest height, metres."""
        return float(self.heights.min())

    @property
    def size(self) -> tuple[float, float]:
        """Metres along x and y."""
        ny, nx = self.heights.shape
        return ((nx - 1) * self.resolution, (ny - 1) * self.resolution)

    @property
    def outline(self) -> F64:
        """The four corners in the frame of the solids, counter-clockwise, float64 (4, 2)."""
        x, y = self.size
        return self.origin.transform(np.array([[0.0, 0.0], [x, 0.0], [x, y], [0.0, y]]))

    @property
    def corners(self) -> F64:
        """The corners of all triangles, two for each cell row by row, counter-clockwise from above, float64 (M, 3, 3)."""
        ny, nx = self.heights.shape
        x, y = np.meshgrid(np.arange(nx) * self.resolution, np.arange(ny) * self.resolution)
        xy = self.origin.transform(np.column_stack([x.ravel(), y.ravel()]))
        vertices = np.column_stack([xy, self.heights.ravel()])
        a = (np.arange(ny - 1)[:, None] * nx + np.arange(nx - 1)).ravel()
        b, c, d = a + 1, a + nx + 1, a + nx
        return np.asarray(vertices[np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)])

    def heights_at(self, points: F64) -> F64:
        """Return the heights of the surface at points (N, 2) in the frame of the solids, float64 (N,); NaN outside the field."""
        ny, nx = self.heights.shape
        u, v = (self.origin.inverse().transform(np.asarray(points, np.float64)) / self.resolution).T
        outside = ~((u >= 0.0) & (u <= nx - 1) & (v >= 0.0) & (v <= ny - 1))
        ix = np.clip(np.where(outside, 0, u), 0, nx - 2).astype(np.int64)
        iy = np.clip(np.where(outside, 0, v), 0, ny - 2).astype(np.int64)
        s, t, h = u - ix, v - iy, self.heights
        first, last = h[iy, ix], h[iy + 1, ix + 1]
        # Below the diagonal a step along x comes first, above it one along y.
        lower = first + s * (h[iy, ix + 1] - first) + t * (last - h[iy, ix + 1])
        upper = first + t * (h[iy + 1, ix] - first) + s * (last - h[iy + 1, ix])
        return np.asarray(np.where(outside, np.nan, np.where(s >= t, lower, upper)))

    def moved(self, frame_from_field: SE2) -> HeightField:
        """Return the field after an upright rigid motion."""
        return replace(self, origin=frame_from_field @ self.origin)


def normals_of(corners: F64) -> F64:
    """Return the unit normals of triangles (M, 3, 3), float64 (M, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def highest_below(corners: F64, points: F64, limit: float) -> F64:
    """Return the greatest height not above `limit` where the vertical lines at points (N, 2) meet triangles (M, 3, 3); -inf: none."""
    a, b, c = corners[:, 0, :2], corners[:, 1, :2], corners[:, 2, :2]
    rise_b, rise_c = (corners[:, 1:, 2] - corners[:, :1, 2]).T
    area = _cross(b - a, c - a)
    out = np.full(len(points), -np.inf)
    for k, p in enumerate(points):
        with np.errstate(divide="ignore", invalid="ignore"):
            s, t = _cross(p - a, c - a) / area, _cross(b - a, p - a) / area
            z = corners[:, 0, 2] + s * rise_b + t * rise_c
            met = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0) & (z <= limit)
        out[k] = z[met].max(initial=-np.inf)
    return out


def _cross(a: F64, b: F64) -> F64:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _checked(name: str, vertices: ArrayLike, triangles: ArrayLike) -> tuple[F64, I32]:
    """Return read-only copies of a mesh's arrays; raises BadInputError."""
    points, numbers = np.array(vertices, np.float64), np.array(triangles, np.int32)
    if points.ndim != 2 or points.shape[1:] != (3,) or numbers.ndim != 2 or numbers.shape[1:] != (3,):
        raise BadInputError(f"mesh {name!r}: needs vertices (N, 3) and triangles (M, 3)")
    if len(numbers) == 0:
        raise BadInputError(f"mesh {name!r}: has no triangles")
    if not np.isfinite(points).all():
        raise BadInputError(f"mesh {name!r}: vertex {int(np.argwhere(~np.isfinite(points))[0, 0])} is no point")
    if numbers.min() < 0 or numbers.max() >= len(points):
        bad = int(np.argwhere((numbers < 0) | (numbers >= len(points)))[0, 0])
        raise BadInputError(f"mesh {name!r}: triangle {bad} names a vertex that is not there")
    corners = points[numbers]
    sides = corners - np.roll(corners, -1, axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    flat = area <= MIN_ALTITUDE * np.linalg.norm(sides, axis=2).max(axis=1)
    if flat.any():
        raise BadInputError(f"mesh {name!r}: triangle {int(np.argmax(flat))} has no area")
    points.flags.writeable = False
    numbers.flags.writeable = False
    return points, numbers
