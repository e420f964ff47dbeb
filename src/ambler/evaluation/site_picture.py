"""A picture of a site that was explored: every level with the heights of its ground, the way of the robot, and the passages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, GridSpec
from ambler.evaluation.pictures import COLOURS, INK, OCCUPIED_SHADE, UNKNOWN_SHADE, known_box, save_figure

F64 = NDArray[np.float64]
SAME = 0.7  # metres between the way and the ground of the level on which it is drawn


def draw_site(
    path: Path, levels: Sequence[tuple[GridSpec, NDArray[np.int8], NDArray[np.float32]]], way: F64, passages: F64
) -> Path:
    """Draw levels (geometry, occupancy and heights [iy, ix], as in `wire.ground_files`) side by side, with the `way` (N, 3) of the base in the map frame on that level whose ground
    carries it, and `passages` (N, 5) of level, level, x, y, yaw."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5 + 5.0 * len(levels), 6.0), dpi=110)
    heights = np.concatenate([h[o == OCC_FREE] for _, o, h in levels])
    low, high = np.nanquantile(heights, (0.01, 0.99)) if np.isfinite(heights).any() else (0.0, 1.0)
    colours = matplotlib.colormaps["viridis"]
    for k, (spec, occupancy, ground) in enumerate(levels):
        axes = figure.add_subplot(1, len(levels), k + 1)
        share = np.clip((np.nan_to_num(ground, nan=low) - low) / max(high - low, 1e-3), 0.0, 1.0)
        shades = (255.0 * colours(share)[..., :3]).astype(np.uint8)
        shades[occupancy != OCC_FREE] = UNKNOWN_SHADE
        shades[occupancy == OCC_OCCUPIED] = OCCUPIED_SHADE
        x1, y1 = spec.origin_x + spec.width * spec.resolution, spec.origin_y + spec.height * spec.resolution
        axes.imshow(shades, origin="lower", extent=(spec.origin_x, x1, spec.origin_y, y1), interpolation="nearest")
        own = np.where(_carries(spec, ground, way)[:, None], way[:, :2], np.nan)
        axes.plot(own[:, 0], own[:, 1], color="white", linewidth=1.0)
        places = passages[passages[:, 0] == k]
        axes.plot(places[:, 2], places[:, 3], "D", mfc="none", mec=COLOURS[4], mew=1.8, ms=8, label="passage")
        left, right, bottom, top = known_box(spec, occupancy)
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x (m)", ylabel="y (m)", title=f"level {k}")
        axes.set_aspect("equal")
    scale = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(float(low), float(high)), colours)
    bar = figure.colorbar(scale, ax=figure.axes, shrink=0.7)
    bar.set_label("height of the ground (m)", color=INK)
    return save_figure(figure, path)


def _carries(spec: GridSpec, heights: NDArray[np.float32], way: F64) -> NDArray[np.bool_]:
    """Say of every place of a way whether it lies on the ground of a level."""
    cells = spec.cells_of(way[:, :2])
    inside = (cells >= 0).all(axis=1) & (cells < np.array(spec.shape)).all(axis=1)
    out = np.zeros(len(way), np.bool_)
    at = heights[cells[inside, 0], cells[inside, 1]]
    out[inside] = np.abs(at - way[inside, 2]) <= SAME
    return out
