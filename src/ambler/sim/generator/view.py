"""A world from above: what the highest surface below a height is, coloured by its height and shaded by its slope, with route and start; what
the cut goes through is grey."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.sim.scene import build_scene
from ambler.sim.solids import Shape, WorldSpec

F64 = NDArray[np.float64]
MARGIN = 1.0  # metres around
LONGER_SIDE = 1400  # pixels
SKY = 1000.0  # metres
HIGHEST = 0.98  # share of the pixels that the colours tell apart; single poles and towers do not count
CUT = (90, 90, 90)  # what reaches through the height of the cut
ROUTE, PEOPLE, START = (60, 60, 230), (200, 90, 200), (60, 200, 60)


def heights_from_above(world: WorldSpec, metres_per_pixel: float, cut: float = SKY) -> F64:
    """Return the heights that vertical rays from `cut` metres down meet, float64 (rows, columns), row 0 at the greatest y."""
    x0, y0, x1, y1 = world.bounds()
    columns = np.arange(x0 - MARGIN, x1 + MARGIN, metres_per_pixel)
    rows = np.arange(y1 + MARGIN, y0 - MARGIN, -metres_per_pixel)
    x, y = np.meshgrid(columns, rows)
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, cut)])
    distance, _, _ = build_scene(world).cast(origins, np.tile([0.0, 0.0, -1.0], (x.size, 1)), 2.0 * SKY)
    return np.asarray((cut - np.minimum(distance, 2.0 * SKY)).reshape(x.shape))


def view_of(world: WorldSpec, cut: float = SKY) -> NDArray[np.uint8]:
    """Return the picture, BGR uint8 (H, W, 3), y upwards."""
    x0, y0, x1, y1 = world.bounds()
    step = (max(x1 - x0, y1 - y0) + 2.0 * MARGIN) / LONGER_SIDE
    heights = heights_from_above(world, step, cut)
    low, high = float(heights.min()), float(np.quantile(heights, HIGHEST))
    levels = np.clip((heights - low) / max(high - low, 0.1), 0.0, 1.0)
    image = cv2.applyColorMap(np.asarray(255.0 * levels, np.uint8), cv2.COLORMAP_VIRIDIS).astype(np.float64)
    down, right = np.gradient(heights, step)
    shade = np.clip(0.75 + 0.35 * (right + down) / np.sqrt(1.0 + right**2 + down**2), 0.3, 1.0)
    out = np.ascontiguousarray(np.clip(image * shade[..., None], 0.0, 255.0).astype(np.uint8))

    def pixels(points: F64) -> NDArray[np.int32]:
        return np.round((points * [1.0, -1.0] - [x0 - MARGIN, -(y1 + MARGIN)]) / step).astype(np.int32)

    for solid in world.solids:
        if solid.z_min <= cut < solid.z_max:
            round_radius = round(0.5 * solid.size_x / step)
            if solid.shape is Shape.BOX:
                cv2.fillPoly(out, [pixels(solid.corners())], CUT, cv2.LINE_AA)
            else:
                cv2.circle(
                    out, pixels(solid.corners().mean(axis=0)[None, :])[0].tolist(), round_radius, CUT, -1, cv2.LINE_AA
                )
    for person in world.people:
        cv2.polylines(out, [pixels(np.array([*person.way, person.way[0]]))], False, PEOPLE, 2, cv2.LINE_AA)
    if world.route:
        cv2.polylines(out, [pixels(np.array(world.route))], False, ROUTE, 2, cv2.LINE_AA)
    tail, tip = pixels(world.start.transform(np.array([[0.0, 0.0], [max(1.0, 25.0 * step), 0.0]]))).tolist()
    cv2.arrowedLine(out, tail, tip, START, 3, cv2.LINE_AA, tipLength=0.4)
    return out


def save_view(path: Path, world: WorldSpec, cut: float = SKY) -> None:
    """Write the picture of a world; raises BadInputError where that is not possible."""
    if not math.isfinite(cut):
        raise BadInputError(f"--cut {cut}: must be a height in metres")
    try:
        is_written = cv2.imwrite(str(path), view_of(world, cut))
    except cv2.error as error:
        raise BadInputError(f"{path}: no picture can be written under this name") from error
    if not is_written:
        raise BadInputError(f"{path}: cannot be written")
