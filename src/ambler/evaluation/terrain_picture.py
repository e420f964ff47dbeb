"""A picture of a terrain from above: coloured by height above the ground, red where it cannot be crossed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def save_terrain_picture(
    file: Path, points: NDArray[np.float32], step: float, way: NDArray[np.float64], title: str = ""
) -> None:
    """Save `points` (N, 4) of x, y, z and height above the ground; what is `step` or more above it is red. `way` (M, 2): where the robot was."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 7.0), dpi=110)
    axes = figure.add_subplot()
    blocked = points[:, 3] >= step
    free = axes.scatter(
        points[~blocked, 0], points[~blocked, 1], c=points[~blocked, 2], s=5, cmap="viridis", marker="s"
    )
    axes.scatter(points[blocked, 0], points[blocked, 1], c="red", s=5, marker="s")
    axes.plot(way[:, 0], way[:, 1], color="black", linewidth=1.0)
    axes.plot(*way[-1], "k^")
    figure.colorbar(free, ax=axes, label="height of the ground (m)")
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=title)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)
