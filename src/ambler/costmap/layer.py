"""What a costmap is made of: layers, drawn one over the other, and inflation last.

A layer is fed by whoever has news for it, each in its own way. The costmap asks it to `update`, then to draw what changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import costmap as kernels

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]
L = TypeVar("L")
T = TypeVar("T", bound=np.generic)

Box = tuple[int, int, int, int]
"""Cells (y0, y1, x0, x1) of a grid, half open."""


@dataclass(frozen=True, slots=True)
class Moment:
    """What holds while a costmap is brought up to date, in the costmap's frame: where the base is and where the map lies, as far as
    that is known, and the polygon (N, 2), convex and counter-clockwise, in which the robot stands and nothing else does."""

    costmap_from_base: SE2 | None = None
    costmap_from_map: SE2 | None = None
    footprint: F64 | None = None


class Frames(Protocol):
    """Where things are in a costmap's frame, for whoever feeds a layer with messages."""

    def costmap_from(self, frame: str, stamp_ns: int) -> SE2:
        """Return the pose of `base` or of a sensor at a time, or the newest one of `map` or `odom`; raises TransformError."""
        ...

    def spatial_from(self, frame: str, stamp_ns: int) -> SE3:
        """Return the pose of `base` or of a sensor at a time with its height and lean; raises TransformError."""
        ...


class Layer(Protocol):
    """One source of costs. It has a state of its own, so a layer serves one costmap."""

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Cover `spec` from now on and take in everything fed since the last update. Returns a box of `spec` that holds every
        cell that the layer would draw differently than before, None when there is none; what it says of a new `spec` is not used."""
        ...

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Draw over `master` uint8 [iy, ix], which holds what the layers below say. All cells of `box` must become right; what is
        drawn outside of it does not count. `spec` is that of the last update."""
        ...

    def clear(self) -> None:
        """Forget what sensors saw; what is known of the place stays."""
        ...


@runtime_checkable
class Forgets(Protocol):
    """A layer that can forget a part of what sensors saw."""

    def clear_within(self, x: float, y: float, radius: float) -> None:
        """Forget what was seen within a radius (m) of a place in the costmap's frame."""
        ...


def clear_layers(layers: Sequence[Layer], x: float, y: float, radius: float) -> None:
    """Have all layers that saw anything forget what lies within a radius (m) of a place."""
    for layer in layers:
        if isinstance(layer, Forgets):
            layer.clear_within(x, y, radius)


def cells_within(spec: GridSpec, x: float, y: float, radius: float) -> NDArray[np.bool_]:
    """Return which cells have their middles within a radius (m) of a place, bool [iy, ix]."""
    xs = spec.origin_x + (np.arange(spec.width) + 0.5) * spec.resolution - x
    ys = spec.origin_y + (np.arange(spec.height) + 0.5) * spec.resolution - y
    return np.asarray(np.hypot(xs[None, :], ys[:, None]) <= radius)


def whole(spec: GridSpec) -> Box:
    """Return the box of all cells."""
    return 0, spec.height, 0, spec.width


def changed_box(old: U8, new: U8, box: Box | None = None) -> Box | None:
    """Return the smallest box of cells that differ, of those in `box`; None when none does."""
    height, width = new.shape
    y0, y1, x0, x1 = kernels.changed_box(old, new, *((0, height, 0, width) if box is None else box))
    return (int(y0), int(y1), int(x0), int(x1)) if y1 > y0 else None


def union(a: Box | None, b: Box | None) -> Box | None:
    """Return the smallest box around two; None stands for nothing."""
    if a is None or b is None:
        return b if a is None else a
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


def box_around(points: F64, spec: GridSpec) -> Box | None:
    """Return the cells that contain points (N, 2) and what lies between them, and one cell more; None when the grid has none of them."""
    if len(points) == 0:
        return None
    xs, ys = points[:, 0].tolist(), points[:, 1].tolist()
    return _clipped(min(xs), min(ys), max(xs), max(ys), spec)


def box_within(x: float, y: float, radius: float, spec: GridSpec) -> Box | None:
    """Return the cells within a radius (m) of a point, and some more; None when the grid has none of them."""
    return _clipped(x - radius, y - radius, x + radius, y + radius, spec)


def _clipped(x0: float, y0: float, x1: float, y1: float, spec: GridSpec) -> Box | None:
    (iy0, ix0), (iy1, ix1) = spec.cell_of(x0, y0), spec.cell_of(x1, y1)
    box = max(0, iy0 - 1), min(spec.height, iy1 + 2), max(0, ix0 - 1), min(spec.width, ix1 + 2)
    return box if box[0] < box[1] and box[2] < box[3] else None


def layer_of(layers: Sequence[Layer], kind: type[L]) -> L:
    """Return the first layer of a class; raises BadInputError."""
    for layer in layers:
        if isinstance(layer, kind):
            return layer
    raise BadInputError(f"the costmap has no {kind.__name__}, only {[type(layer).__name__ for layer in layers]}")


def moved(old: NDArray[T], old_spec: GridSpec, spec: GridSpec, fill: float) -> NDArray[T]:
    """Return a layer's cells in another grid of the same resolution, aligned to whole cells; `fill` where they do not overlap."""
    new = np.full((*spec.shape, *old.shape[2:]), fill, old.dtype)
    dy, dx = spec.offset_in(old_spec)
    y0, y1 = max(0, dy), min(old.shape[0], dy + spec.height)
    x0, x1 = max(0, dx), min(old.shape[1], dx + spec.width)
    if y1 > y0 and x1 > x0:
        new[y0 - dy : y1 - dy, x0 - dx : x1 - dx] = old[y0:y1, x0:x1]
    return new
