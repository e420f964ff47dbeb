"""A floor plan (PGM + YAML of ROS map_server) or a plain picture as a world: occupied cells become walls, merged into few boxes.

A plan ends where its author saw nothing: unknown cells, and what lies beyond the picture, are no floor, and floor that borders on them ends
at a wall there. Else a robot could leave a saved map through the gaps that every saved map has in its walls. A patch of unknown cells in the
middle of the floor, beside which no surface was seen, was missed by the beams, and is floor.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_FREE_BELOW, OCC_OCCUPIED, OCC_UNKNOWN, GridSpec
from ambler.core.se2 import SE2
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.wire.map_files import PIXEL_UNKNOWN, load_plan, read_image

OCCUPIED = 65
WALL_HEIGHT = 2.5
PICTURE_RESOLUTION = 0.1
PICTURE_SOLID = 150
START_GREY = 203
# Metres from a wall that the middle of a robot needs.
ROOM = 0.4
# Metres from a wall that the middle of the slimmest robot needs to get from one part of the floor to another.
PASSAGE = 0.25
# Of the picture's border: free cells that hold more of it are taken for the paper around a drawn house.
BORDER_SHARE = 0.1
# Of the paper's area: closed floor of less is a closet beside a hall that the picture cuts.
INDOORS_SHARE = 0.1
AROUND = np.ones((3, 3), bool)


def world_from_floor_plan(yaml_path: Path, start: SE2 | None = None) -> WorldSpec:
    """Read a floor plan; without a start pose the robot begins indoors, in the largest part of the floor, where it is farthest from any wall.

    Raises BadInputError if the plan has no free cell, or the start lies on none.
    """
    spec, occupancy = load_plan(yaml_path)
    if start is None:
        start = _widest_place(yaml_path, spec, occupancy)
    spec, occupied, ends = _checked_with_ends(yaml_path, spec, occupancy, start)
    return WorldSpec(yaml_path.stem, _to_solids(spec, occupied | ends), start)


def read_picture(path: Path, resolution: float) -> tuple[GridSpec, NDArray[np.int8], SE2 | None]:
    """Read a grey or coloured picture as (grid, occupancy [iy, ix]: occupied, free or unknown, the start that it marks or None).

    Pixels darker than 150 of 255 are solid; a block of grey 203, at least 3 x 3 pixels, marks the start unless its middle is not free (the public dungeon maps use
    127, 194 and 203; 205 is what map savers write for unknown, and no mark). The lower left corner of the picture is the grid's origin. Raises BadInputError.
    """
    pixels = np.ascontiguousarray(_grey_on_white(path)[::-1])
    spec = GridSpec(resolution, pixels.shape[1], pixels.shape[0], 0.0, 0.0)
    occupancy = np.where(pixels < PICTURE_SOLID, np.int8(OCC_OCCUPIED), np.int8(OCC_FREE))
    saved = np.where(pixels == PIXEL_UNKNOWN, np.int8(OCC_UNKNOWN), occupancy)
    if np.any(saved == OCC_FREE):
        occupancy = saved
    return spec, occupancy, _marked_start(spec, pixels, occupancy)


def _grey_on_white(path: Path) -> NDArray[np.uint8]:
    """Return the grey of a picture on white paper, uint8 [row, column], which shows where it is transparent. Raises BadInputError."""
    image = read_image(path)
    if image.shape[2] not in (2, 4):
        # asked for grey, the decoder turns a photograph as its camera was held
        return read_image(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)[:, :, 0]
    grey = cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY) if image.shape[2] == 4 else image[:, :, 0]
    alpha = image[:, :, -1] / 255.0
    return np.rint(alpha * grey + (1.0 - alpha) * 255.0).astype(np.uint8)


def _marked_start(spec: GridSpec, pixels: NDArray[np.uint8], occupancy: NDArray[np.int8]) -> SE2 | None:
    """Return the middle of the largest block of the start's grey; thin lines of it are edges that a drawing program has softened."""
    blocks, count = ndimage.label(ndimage.binary_opening(np.abs(pixels.astype(int) - START_GREY) <= 1, AROUND))
    if count == 0:
        return None
    rows, columns = np.nonzero(blocks == 1 + np.argmax(np.bincount(blocks.ravel())[1:]))
    iy, ix = round(float(rows.mean())), round(float(columns.mean()))
    return SE2(*spec.center_of(iy, ix), 0.0) if occupancy[iy, ix] == OCC_FREE else None


def world_from_picture(path: Path, start: SE2 | None = None, resolution: float = PICTURE_RESOLUTION) -> WorldSpec:
    """Read a picture as `read_picture` does; without any start it begins as `world_from_floor_plan` says.

    Raises BadInputError.
    """
    spec, occupancy, marked = read_picture(path, resolution)
    if start is None:
        start = marked if marked is not None else _widest_place(path, spec, occupancy)
    spec, solid, ends = _checked_with_ends(path, spec, occupancy, start)
    surface = solid & ndimage.binary_dilation(~solid, AROUND, iterations=2)
    return WorldSpec(path.stem, _to_solids(spec, surface | ends), start)


def _checked_with_ends(
    path: Path, spec: GridSpec, occupancy: NDArray[np.int8], start: SE2
) -> tuple[GridSpec, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return a plan with one cell around it: its grid, which cells [iy, ix] are occupied, and at which the floor ends without a wall.

    Raises BadInputError if the start lies neither on a free cell nor on one that the beams missed.
    """
    r = spec.resolution
    spec = GridSpec(r, spec.width + 2, spec.height + 2, spec.origin_x - r, spec.origin_y - r)
    occupancy = np.pad(occupancy, 1, constant_values=OCC_UNKNOWN)
    occupied, unknown = occupancy >= OCCUPIED, occupancy < 0
    patches, _ = ndimage.label(unknown, AROUND)
    bounded = np.append(
        patches[ndimage.binary_dilation(occupied, AROUND)], patches[0, 0]
    )  # beside a surface, or the outside
    beyond = unknown & np.isin(patches, bounded)
    iy, ix = spec.cell_of(start.x, start.y)
    if not spec.contains_cell(iy, ix) or not (_is_free(occupancy) | unknown & ~beyond)[iy, ix]:
        raise BadInputError(f"{path}: the start pose ({start.x:.2f}, {start.y:.2f}) is not on a free cell")
    ends = beyond & ndimage.binary_dilation(~occupied & ~beyond, AROUND)
    return spec, occupied, np.asarray(ends)


def merge_cells(occupied: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """Cover exactly the true cells by rectangles (iy0, ix0, iy1, ix1), upper ends exclusive.

    Runs of a row grow into the next row while it holds the same run: few boxes for walls along the axes.
    """
    done: list[tuple[int, int, int, int]] = []
    growing: dict[tuple[int, int], int] = {}
    for iy in range(len(occupied) + 1):
        runs = set(_runs(occupied[iy])) if iy < len(occupied) else set()
        for run in [r for r in growing if r not in runs]:
            done.append((growing.pop(run), run[0], iy, run[1]))
        for run in sorted(runs):
            growing.setdefault(run, iy)
    return done


def _runs(row: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _widest_place(path: Path, spec: GridSpec, occupancy: NDArray[np.int8]) -> SE2:
    """Return a corner of the cell that is farthest from any wall: a true map has a corner of its cells there, so its lattice is the plan's.

    Floor indoors goes before the paper around a drawn house, if a robot has room there, and its largest part before the others. Raises BadInputError if
    no cell is free.
    """
    free = _is_free(occupancy)
    if not free.any():
        raise BadInputError(f"{path}: the floor plan has no free cell")
    clearance = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    paper = _is_paper(free)
    indoors = np.where(paper, 0.0, clearance)
    has_indoors = indoors.max() * spec.resolution >= ROOM and (free & ~paper).sum() >= INDOORS_SHARE * paper.sum()
    wanted = _largest_part(indoors if has_indoors else clearance, PASSAGE / spec.resolution)
    iy, ix = (int(k) for k in np.unravel_index(int(np.argmax(wanted)), wanted.shape))
    x, y = spec.center_of(iy, ix)
    around = np.pad(clearance, 1)[iy : iy + 3, ix : ix + 3]
    # the least of the four cells that meet at each corner of the cell
    corners = {(up, right): float(around[up : up + 2, right : right + 2].min()) for up in (0, 1) for right in (0, 1)}
    up, right = max(corners, key=corners.__getitem__)
    if corners[up, right] < 1.0:
        return SE2(x, y, 0.0)  # a passage of one cell, whose corners lie on walls
    return SE2(x + (right - 0.5) * spec.resolution, y + (up - 0.5) * spec.resolution, 0.0)


def _largest_part(clearance: NDArray[np.float64], passage: float) -> NDArray[np.float64]:
    """Return the clearance [iy, ix], cells, of the largest part of the floor alone, zero elsewhere: the widest place of all may be a yard that no door leads
    into. Parts are joined where the clearance is at least `passage`; a plan without any such floor is returned as it is."""
    parts, count = ndimage.label(clearance >= passage)
    if count < 2:
        return clearance
    return np.where(parts == 1 + np.argmax(np.bincount(parts.ravel())[1:]), clearance, 0.0)


def _is_free(occupancy: NDArray[np.int8]) -> NDArray[np.bool_]:
    return np.asarray((occupancy >= OCC_FREE) & (occupancy < OCC_FREE_BELOW))


def _is_paper(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which cells [iy, ix] are free and joined to a free stretch of the picture's border; a saved map may touch that with a few cells."""
    regions, count = ndimage.label(free)
    border = np.concatenate([regions[0], regions[-1], regions[1:-1, 0], regions[1:-1, -1]])
    touching = np.bincount(border, minlength=count + 1) > BORDER_SHARE * len(border)
    touching[0] = False
    return np.asarray(touching[regions])


def _to_solids(spec: GridSpec, cells: NDArray[np.bool_]) -> tuple[Solid, ...]:
    return tuple(_to_solid(k, box, spec) for k, box in enumerate(merge_cells(cells)))


def _to_solid(k: int, box: tuple[int, int, int, int], spec: GridSpec) -> Solid:
    iy0, ix0, iy1, ix1 = box
    r = spec.resolution
    center = SE2(spec.origin_x + 0.5 * (ix0 + ix1) * r, spec.origin_y + 0.5 * (iy0 + iy1) * r, 0.0)
    return Solid(f"plan_{k}", Shape.BOX, center, (ix1 - ix0) * r, (iy1 - iy0) * r, 0.0, WALL_HEIGHT, 0.7)
