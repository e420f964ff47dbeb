"""A picture of a drawn place: what is solid by its height, glass, people's ways, the start, and the floor that a robot can reach."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.sim.generator.draw import DrawnPlace
from ambler.sim.generator.floor import HEIGHTS
from ambler.sim.solids import Shape, Solid

MARGIN = 0.5
SHIFT = 4  # binary digits of pixels' fractions
REACHED, OUTSIDE = (255, 255, 255), (225, 225, 225)
WALL, TALL, LOW, ABOVE, GLASS = (50, 50, 50), (120, 120, 120), (120, 170, 205), (175, 215, 235), (230, 190, 60)
PERSON, START = (60, 60, 220), (60, 160, 40)


def picture_of(place: DrawnPlace, pixels_per_metre: float | None = None) -> NDArray[np.uint8]:
    """Return the plan as BGR uint8 (H, W, 3), y upwards; without a scale the longer side has about 1400 pixels."""
    x0, y0, x1, y1 = place.world.bounds()
    scale = pixels_per_metre or min(60.0, 1400.0 / (max(x1 - x0, y1 - y0) + 2 * MARGIN))
    width, height = int((x1 - x0 + 2 * MARGIN) * scale), int((y1 - y0 + 2 * MARGIN) * scale)
    image = np.full((height, width, 3), OUTSIDE, np.uint8)

    def pixel(points: NDArray[np.float64]) -> NDArray[np.int32]:
        offset = (points - [x0 - MARGIN, y0 - MARGIN]) * scale
        offset[:, 1] = height - offset[:, 1]
        return np.asarray(np.round(offset * (1 << SHIFT)), np.int32)

    _shade(image, place, (x0 - MARGIN, y0 - MARGIN), scale)
    for solid in sorted(place.world.solids, key=lambda s: (s.is_glass, s.z_min < HEIGHTS[1], s.z_max)):
        _draw(image, solid, pixel(solid.corners()), round(0.5 * solid.size_x * scale * (1 << SHIFT)))
    for person in place.world.people:
        way = pixel(np.array([*person.way, person.way[0]]))
        cv2.polylines(image, [way], False, PERSON, 1, cv2.LINE_AA, SHIFT)
    start = place.world.start
    ends = pixel(start.transform(np.array([[-0.4, 0.0], [0.6, 0.0]])))
    tip = [tuple(int(v) >> SHIFT for v in end) for end in ends]
    cv2.arrowedLine(image, tip[0], tip[1], START, max(2, int(0.06 * scale)), cv2.LINE_AA, tipLength=0.5)
    return image


def save_picture(path: Path, place: DrawnPlace) -> None:
    """Write the picture of a place. Raises BadInputError where that is not possible."""
    try:
        is_written = cv2.imwrite(str(path), picture_of(place))
    except cv2.error as error:
        raise BadInputError(f"{path}: no picture can be written under this name") from error
    if not is_written:
        raise BadInputError(f"{path}: cannot be written")


def _shade(image: NDArray[np.uint8], place: DrawnPlace, origin: tuple[float, float], scale: float) -> None:
    """Make the floor white that the disc covers on its ways."""
    spec, reached = place.floor.spec, place.floor.reached
    radius = max(1, round(0.45 / spec.resolution))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    covered = cv2.dilate(reached.astype(np.uint8), kernel)
    rows = origin[1] + (image.shape[0] - 0.5 - np.arange(image.shape[0])) / scale
    columns = origin[0] + (np.arange(image.shape[1]) + 0.5) / scale
    iy = np.clip(((rows - spec.origin_y) / spec.resolution).astype(int), 0, spec.height - 1)
    ix = np.clip(((columns - spec.origin_x) / spec.resolution).astype(int), 0, spec.width - 1)
    image[covered[np.ix_(iy, ix)] > 0] = REACHED


def _draw(image: NDArray[np.uint8], solid: Solid, corners: NDArray[np.int32], radius: int) -> None:
    is_outline = solid.z_min >= HEIGHTS[1] and not solid.is_glass
    color = _color(solid)
    if solid.shape is Shape.CYLINDER:
        middle = tuple(int(v) for v in corners.mean(axis=0))
        cv2.circle(image, middle, max(radius, 1 << SHIFT), color, 1 if is_outline else -1, cv2.LINE_AA, SHIFT)
    elif is_outline:
        cv2.polylines(image, [corners], True, color, 1, cv2.LINE_AA, SHIFT)
    else:
        cv2.fillPoly(image, [corners], color, cv2.LINE_AA, SHIFT)


def _color(solid: Solid) -> tuple[int, int, int]:
    if solid.is_glass:
        return GLASS
    if solid.name.startswith("wall") or solid.name == "lintel":
        return WALL
    if solid.z_min > 0.35:
        return ABOVE
    return TALL if solid.z_max > 1.0 else LOW
