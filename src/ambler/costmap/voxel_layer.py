"""The voxel layer: what depth cameras and clouds see between the floor and the robot's top, in voxels, so that it also goes again in three dimensions.

A voxel is marked when it was hit in two pictures and cleared when some looked through it; what nobody looks at stays. Every voxel with
evidence is asked for by a ray of its own (`kernels.voxels`), so edges and surfaces seen at a flat angle are not worn away by rays that pass
close to them. How far above the floor an obstacle must reach grows with its distance from the sensor: mounts and bodies lean by unknown
degrees, and far floor must not become an obstacle.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError
from ambler.core.grid import COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.core.se3 import SE3
from ambler.core.units import Radians
from ambler.costmap.layer import Box, Moment, box_around, box_within, cells_within, changed_box, moved, union, whole
from ambler.kernels import costmap as cells_kernels
from ambler.kernels import voxels as kernels

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
FED_MAX = 64  # the newest views that wait for an update: a map may be long in coming
GROUND_CELL = 0.2  # metres that a point of the ground covers
NO_GROUND = np.zeros((0, 0), np.float32)
FOOT = 2  # levels below the floor: it may sink a little before all voxels have to be moved


@dataclass(frozen=True, slots=True)
class VoxelConfig:
    """Voxels are as wide as the costmap's cells and `level` metres high, higher for a robot taller than LEVELS of them. Views mark and clear up to
    `reach` metres. An obstacle reaches `doubt` metres above the floor and `lean` (rad) of its distance more, and begins less than `clearance`
    above the robot's top: errors of mounting of 5 cm, and of 3° in roll and pitch at once (4.2° together), leave the floor free, noise included. A hit adds `gain` up to `most`, a look through takes 1,
    `enough` marks: two hits mark, and four looks, 0.4 s of a camera, clear what was surest. A look counts when it goes on `margin` metres
    and `spread` times the squared distance beyond (three sigma of a stereo camera's noise). A cloud's picture has elements of `step` rad."""

    level: float = 0.05
    reach: float = 4.0
    doubt: float = 0.07
    lean: Radians = math.radians(4.5)
    clearance: float = 0.1
    gain: int = 2
    most: int = 6
    enough: int = 3
    margin: float = 0.06
    spread: float = 0.008
    step: Radians = math.radians(2.0)


@dataclass(frozen=True, slots=True, eq=False)
class VoxelView:
    """What one sensor saw at once, in the costmap's frame: points float32 (N, 3) of its own frame with their times float32 (N,) after the stamp (s),
    its poses float64 (K, 3, 4) every `period` seconds, the floor's height under the robot, from where on it measures (m), and its picture of
    distances with `lens` (`kernels.voxels.Picture`)."""

    points: F32
    times: F32
    matrices: F64
    period: float
    floor: float
    near: float
    far: float
    picture: F32
    is_round: bool
    lens: F64


def view_of_depth(
    depth: NDArray[np.uint16], model: CameraModel, costmap_from_camera: SE3, floor: float, near: float, far: float
) -> VoxelView:
    """Return the view of a depth picture (H, W) in millimetres, used between two distances along its axis."""
    points, picture = np.empty((depth.size, 3), np.float32), np.empty(depth.shape, np.float32)
    count = kernels.points_of_depth(depth, *(model.fx, model.fy, model.cx, model.cy), near, far, points)
    kernels.view_of_depth(depth, picture)
    matrices = np.ascontiguousarray(costmap_from_camera.matrix()[None, :3])
    lens = np.array([model.fx, model.fy, model.cx, model.cy])
    corner = math.hypot(1.0, model.cx / model.fx, model.cy / model.fy)  # of a plane at `far` the corners are farther
    times = np.zeros(count, np.float32)
    return VoxelView(points[:count], times, matrices, 1.0, floor, near, far * corner, picture, False, lens)


def view_of_cloud(
    points: F32,
    times: F32,
    costmap_from_sensor: F64,
    period: float,
    floor: float,
    near: float,
    elevation: tuple[float, float],
    config: VoxelConfig,
) -> VoxelView:
    """Return the view of a cloud in its sensor's frame, whose poses are float64 (K, 3, 4) every `period` seconds from the stamp on."""
    step = config.step
    lowest = max(elevation[0], -0.5 * math.pi) - step
    rows = math.ceil((min(elevation[1], 0.5 * math.pi) + step - lowest) / step)
    picture = np.empty((rows, round(2.0 * math.pi / step)), np.float32)
    kernels.view_of_cloud(points, step, lowest, picture)
    lens = np.array([step, lowest, 0.0, 0.0])
    return VoxelView(points, times, costmap_from_sensor, period, floor, near, config.reach, picture, True, lens)


class VoxelLayer:
    """A `Layer` of views. `top`: height of the robot with all that it carries, metres. It marks only, over anything."""

    def __init__(self, config: VoxelConfig, top: float) -> None:
        self.config = config
        self.cells: U8 | None = None
        self._top = top + config.clearance
        self._level = max(config.level, self._top / (kernels.LEVELS - 2 * FOOT))
        self._fed: deque[VoxelView] = deque(maxlen=FED_MAX)
        self._spec: GridSpec | None = None
        self._bottom = 0  # level number of the lowest voxels' feet
        self._is_cleared = False
        self._terrain: tuple[F64, F64] | None = None
        self._ground: F32 = NO_GROUND
        self._scores: NDArray[np.int8] = np.zeros((0, 0, kernels.LEVELS), np.int8)
        self._occupied, self._marked, self._hits = (np.zeros((0, 0), np.uint32) for _ in range(3))

    def add(self, view: VoxelView) -> None:
        """Take a view; the next update weighs it."""
        self._fed.append(view)

    def set_ground(self, points: F64, heights: F64) -> None:
        """Take where the ground lies, points (N, 2) and heights (N,) in the costmap's frame, in place of the last ones; elsewhere the floor is as
        high as under the robot."""
        if len(points) != len(heights):
            raise BadInputError(f"a ground of {len(points)} points and {len(heights)} heights")
        self._terrain = points, heights

    def marked(self) -> F32:
        """Return the middles of the marked voxels, float32 (N, 3), in the costmap's frame."""
        if self._spec is None:
            return np.zeros((0, 3), np.float32)
        spec, levels = self._spec, np.arange(kernels.LEVELS, dtype=np.uint32)
        iy, ix, iz = np.nonzero((self._marked[..., None] >> levels) & np.uint32(1))
        xy = spec.centers_of(np.stack([iy, ix], axis=1))
        return np.column_stack([xy, (self._bottom + iz + 0.5) * self._level]).astype(np.float32)

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Weigh the views fed since the last update, then forget what lies in the footprint."""
        changed = whole(spec) if self._is_cleared else None
        self._is_cleared = False
        if self.cells is None and not self._fed:
            return changed
        before = self._move_to(spec)
        place = np.array([spec.origin_x, spec.origin_y, spec.resolution])
        self._lay_ground(spec)
        touched: Box | None = None
        while self._fed:
            touched = union(touched, self._weigh(self._fed.popleft(), spec, place))
        if moment.footprint is not None:
            footprint = np.require(moment.footprint, np.float64, ["C", "W"])
            kernels.empty_polygon(self._voxels(), place, footprint)
            touched = union(touched, box_around(footprint, spec))
        if before is None:
            touched = whole(spec)
        return union(changed, self._draw_cells(touched))

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Draw the columns with marked voxels."""
        if self.cells is not None:
            cells_kernels.lay_lethal(master, self.cells, *box)

    def clear(self) -> None:
        """Forget everything."""
        self.cells, self._spec, self._is_cleared = None, None, True
        self._fed.clear()

    def clear_within(self, x: float, y: float, radius: float) -> None:
        """Forget what was seen there."""
        if self.cells is not None and self._spec is not None:
            near = cells_within(self._spec, x, y, radius)
            self._scores[near], self._occupied[near], self._marked[near] = 0, 0, 0
            self.cells[near] = COST_UNKNOWN
            self._is_cleared = True

    def _move_to(self, spec: GridSpec) -> U8 | None:
        """Cover another grid of whole cells; returns the cells before it, None when there were none."""
        if self.cells is None or self._spec is None or spec.resolution != self._spec.resolution:
            self.cells = np.full(spec.shape, COST_UNKNOWN, np.uint8)
            self._scores = np.zeros((*spec.shape, kernels.LEVELS), np.int8)
            self._occupied, self._marked, self._hits = (np.zeros(spec.shape, np.uint32) for _ in range(3))
            self._spec = spec
            if self._fed:
                self._bottom = self._bottom_over(self._fed[0].floor)
            return None
        if spec != self._spec:
            self.cells = moved(self.cells, self._spec, spec, COST_UNKNOWN)
            self._scores = moved(self._scores, self._spec, spec, 0)
            self._occupied, self._marked = (moved(a, self._spec, spec, 0) for a in (self._occupied, self._marked))
            self._hits = np.zeros(spec.shape, np.uint32)
            self._spec = spec
        return self.cells

    def _lay_ground(self, spec: GridSpec) -> None:
        """Draw the ground that was told last; nothing where none ever was."""
        if self._terrain is None:
            return
        points, heights = self._terrain
        self._ground = np.full(spec.shape, np.nan, np.float32)
        across = max(1, round(GROUND_CELL / spec.resolution))
        corner = np.round((points - (spec.origin_x, spec.origin_y)) / spec.resolution - 0.5 * across).astype(np.int64)
        for dy, dx in np.ndindex(across, across):
            iy, ix = corner[:, 1] + dy, corner[:, 0] + dx
            inside = (iy >= 0) & (ix >= 0) & (iy < spec.height) & (ix < spec.width)
            self._ground[iy[inside], ix[inside]] = heights[inside]

    def _weigh(self, view: VoxelView, spec: GridSpec, place: F64) -> Box | None:
        c, level = self.config, self._level
        lifted = self._follow_floor(view.floor)
        bottom = self._bottom * level
        there = kernels.VoxelPlace(place, level, bottom)
        hit = kernels.mark_hits(
            *(view.points, view.times, view.matrices, view.period, view.near, view.far, there),
            *(kernels.Band(view.floor, self._ground, c.doubt, c.lean, self._top), self._hits),
        )
        matrix = np.ascontiguousarray(view.matrices[len(view.matrices) // 2])
        box = union(
            box_within(float(matrix[0, 3]), float(matrix[1, 3]), view.far, spec), hit if hit[0] < hit[1] else None
        )
        if box is not None:
            picture = kernels.Picture(view.picture, view.is_round, view.lens, view.near, view.far)
            weights = kernels.Weights(c.margin, c.spread, c.gain, c.most, c.enough)
            kernels.weigh(self._voxels(), self._hits, box, picture, matrix, there, weights)
        return whole(spec) if lifted else box

    def _voxels(self) -> kernels.Voxels:
        return kernels.Voxels(self._scores, self._occupied, self._marked)

    def _draw_cells(self, box: Box | None) -> Box | None:
        """Write `cells` anew in a box; returns where they differ."""
        if box is None or self.cells is None:
            return None
        y0, y1, x0, x1 = box
        new = self.cells.copy()
        new[y0:y1, x0:x1] = np.where(self._marked[y0:y1, x0:x1] > 0, COST_LETHAL, COST_UNKNOWN)
        before, self.cells = self.cells, new
        return changed_box(before, new, box)

    def _bottom_over(self, floor: float) -> int:
        return math.floor(floor / self._level) - FOOT

    def _follow_floor(self, floor: float) -> bool:
        """Move the voxels up or down when the robot's floor has left the levels that they were laid for; says whether it did."""
        shift = self._bottom_over(floor) - self._bottom
        if abs(shift) < FOOT:
            return False
        scores = np.zeros_like(self._scores)
        kept = max(0, kernels.LEVELS - abs(shift))
        if shift > 0:
            scores[..., :kept] = self._scores[..., shift : shift + kept]
        else:
            scores[..., -shift : -shift + kept] = self._scores[..., :kept]
        self._scores, self._bottom = scores, self._bottom + shift
        bits = np.uint32(1) << np.arange(kernels.LEVELS, dtype=np.uint32)
        self._occupied = ((scores > 0) * bits).sum(axis=2, dtype=np.uint32)
        self._marked = ((scores >= self.config.enough) * bits).sum(axis=2, dtype=np.uint32)
        return True
