"""Pictures of clouds: from above and from the side, coloured by height."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ambler.evaluation.pictures import save_figure

F64 = NDArray[np.float64]
PIXELS = 1400
INK = "#1f2430"


def draw_cloud(
    path: Path, points: NDArray[np.floating], way: F64, *, from_side: bool = False, links: F64 | None = None
) -> Path:
    """Draw points (N, 3) and the way (M, 3) in the map, from above or (x and z) from the side; colours run over heights, low to high. `links` (K, 2, 3) are
    pairs of places that loop closures join."""
    across, up = (0, 2) if from_side else (0, 1)
    low, high = _box(points, way)
    size = np.maximum(high - low, 1.0)
    step = float(max(size[across], size[up]) / PIXELS)
    nx, ny = (max(2, int(size[j] / step) + 1) for j in (across, up))
    picture = np.full((ny, nx), np.nan, np.float32)
    order = np.argsort(points[:, 1] if from_side else points[:, 2], kind="stable")[:: -1 if from_side else 1]
    shown = points[order]
    ix = ((shown[:, across] - low[across]) / step).astype(np.int64)
    iy = ((shown[:, up] - low[up]) / step).astype(np.int64)
    inside = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny)
    picture[iy[inside], ix[inside]] = shown[inside, 2]
    figure = Figure(figsize=(11.0, float(np.clip(11.0 * ny / nx, 2.5, 14.0)) + 0.6), layout="constrained")
    axes = figure.add_subplot()
    box = (low[across], low[across] + nx * step, low[up], low[up] + ny * step)
    heights = points[:, 2]
    limits = np.percentile(heights, [1.0, 99.0]) if len(heights) else np.array([0.0, 1.0])
    image = axes.imshow(
        picture, origin="lower", extent=box, cmap="viridis", vmin=float(limits[0]), vmax=float(limits[1]),
        interpolation="nearest",
    )  # fmt: skip
    axes.plot(way[:, across], way[:, up], color="#dc2626", linewidth=1.2)
    for pair in [] if links is None else links:
        axes.plot(pair[:, across], pair[:, up], color="#f59e0b", linewidth=1.0, marker="o", markersize=2.5)
    axes.set_xlabel("x (m)", color=INK)
    axes.set_ylabel("z (m)" if from_side else "y (m)", color=INK)
    figure.colorbar(image, ax=axes, shrink=0.6, label="height (m)")
    return save_figure(figure, path)


def draw_laid(path: Path, target: NDArray[np.floating], source: NDArray[np.floating]) -> Path:
    """Draw two clouds (N, 3) on one another from above."""
    low, high = _box(target, np.zeros((0, 3)))
    size = high - low
    figure = Figure(figsize=(9.0, float(np.clip(9.0 * size[1] / size[0], 3.0, 12.0)) + 0.4), layout="constrained")
    axes = figure.add_subplot()
    for points, color, label in ((target, INK, "target"), (source, "#dc2626", "source, where it was laid")):
        axes.scatter(points[:, 0], points[:, 1], s=0.3, c=color, linewidths=0.0, alpha=0.6, label=label)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_xlabel("x (m)", color=INK)
    axes.set_ylabel("y (m)", color=INK)
    axes.legend(loc="upper right", markerscale=20.0)
    return save_figure(figure, path)


def _box(points: NDArray[np.floating], way: F64) -> tuple[F64, F64]:
    """What holds nearly all points and the whole way."""
    if len(points) == 0:
        return way.min(axis=0) - 1.0, way.max(axis=0) + 1.0
    low, high = np.percentile(points, [0.2, 99.8], axis=0)
    if len(way) == 0:
        return low - 0.5, high + 0.5
    return np.minimum(low, way.min(axis=0)) - 0.5, np.maximum(high, way.max(axis=0)) + 0.5
