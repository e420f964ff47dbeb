"""Pictures of a run: the map with trajectories and frontiers, the overlay on the truth, curves over time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import Frontier, FrontierState, VisibilityGraphView
from ambler.evaluation.map_quality import BLUE, BOTH, FREE_UP_TO, OCCUPIED_FROM, RED, MapQuality

matplotlib.use("Agg")

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation

F64 = NDArray[np.float64]
Curve = Sequence[float] | NDArray[np.floating]
INK, MUTED, GRID = "#1f2430", "#6b7280", "#e5e7eb"
COLOURS = ("#2563eb", "#f97316", "#059669", "#9333ea", "#dc2626", "#0891b2")
UNKNOWN_SHADE, FREE_SHADE, UNDECIDED_SHADE, OCCUPIED_SHADE = (
    (225, 228, 234),
    (255, 255, 255),
    (180, 184, 194),
    (31, 36, 48),
)
GLASS_COLOUR = "#06b6d4"
DPI = 130
MOST_PIXELS = 800  # as many as the axes of a picture have: more, and thin walls fall between them


@dataclass(frozen=True, slots=True)
class Mark:
    """A place on a map that must be seen, with what to say about it; `kind` is one of MARKS."""

    x: float
    y: float
    text: str
    kind: str = "error"


MARKS = {"error": ("o", "#dc2626"), "collision": ("X", "#dc2626"), "goal": ("*", "#9333ea"), "dock": ("D", "#0891b2")}
STATE_COLOURS = {
    FrontierState.OPEN: "#059669",
    FrontierState.TARGET: "#2563eb",
    FrontierState.UNREACHABLE: "#dc2626",
    FrontierState.TOO_SMALL: "#d97706",
    FrontierState.OUTSIDE_BOUNDARY: "#9333ea",
}


def draw_map_with_trajectory(
    path: Path,
    spec: GridSpec,
    occupancy: NDArray[np.int8],
    trajectories: Mapping[str, F64],
    frontiers: Sequence[Frontier] = (),
    glass: NDArray[np.floating] | None = None,
    marks: Sequence[Mark] = (),
) -> Path:
    """Draw a map with named trajectories float64 (N, 2 or 3) in its frame, start and end marked, and frontiers by state, walls above
    them; glass, segments (N, 4) of (x0, y0, x1, y1), has its own colour. `marks` lie on top."""
    x0, x1, y0, y1 = known_box(spec, occupancy)
    figure, axes = _figure_for(x1 - x0, y1 - y0)
    _draw_cells(axes, spec, occupancy)
    for k, (label, poses) in enumerate(trajectories.items()):
        style: dict[str, Any] = {"lw": 1.6} if k == 0 else {"lw": 1.1, "ls": (0, (4, 2))}
        axes.plot(poses[:, 0], poses[:, 1], color=COLOURS[k % len(COLOURS)], label=label, zorder=3 + k, **style)
        if k == 0 and len(poses):
            axes.plot(*poses[0, :2], "o", ms=8, mfc="white", mec=COLOURS[0], mew=2, zorder=9, label="start")
            axes.plot(*poses[-1, :2], "s", ms=7, color=COLOURS[0], mec="white", zorder=9, label="end")
    for k, (ax, ay, bx, by) in enumerate(glass if glass is not None else ()):
        name = "glass" if k == 0 else None
        axes.plot([ax, bx], [ay, by], color=GLASS_COLOUR, lw=3.5, solid_capstyle="butt", label=name, zorder=2.5)
    for state, colour in STATE_COLOURS.items():
        cells = [f.cells for f in frontiers if f.state is state]
        if cells:
            label = f"frontier, {state.name.lower().replace('_', ' ')}"
            axes.plot(*np.concatenate(cells).T, ".", ms=2.5, color=colour, label=label, zorder=2)
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)
    _draw_marks(axes, marks)
    _dress_map(axes)
    return save_figure(figure, path)


def draw_graph(
    path: Path, spec: GridSpec, occupancy: NDArray[np.int8], graph: VisibilityGraphView, trajectory: F64 | None = None
) -> Path:
    """Draw a visibility graph over the map that it was planned on: contours, edges by kind, nodes, and the path that was driven, float64 (N, 2 or 3)."""
    from matplotlib.collections import LineCollection

    x0, x1, y0, y1 = known_box(spec, occupancy)
    figure, axes = _figure_for(x1 - x0, y1 - y0)
    _draw_cells(axes, spec, occupancy)
    kinds = (("sight", COLOURS[5], 0.25), ("along a contour", COLOURS[1], 0.9), ("driven", COLOURS[2], 1.2))
    for kind, (label, colour, width) in enumerate(kinds):
        lines = graph.edges[graph.edge_kinds == kind][:, :, :2]
        axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=width, label=label, zorder=3 + kind))
    corners = graph.nodes[graph.node_kinds < 2]
    axes.plot(corners[:, 0], corners[:, 1], ".", ms=2.5, color=COLOURS[4], label="corner", zorder=6)
    if trajectory is not None and len(trajectory):
        axes.plot(trajectory[:, 0], trajectory[:, 1], color=COLOURS[3], lw=1.8, label="path", zorder=7)
        axes.plot(*trajectory[0, :2], "o", ms=8, mfc="white", mec=COLOURS[3], mew=2, zorder=9)
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)
    _dress_map(axes)
    return save_figure(figure, path)


def _draw_cells(axes: Axes, spec: GridSpec, occupancy: NDArray[np.int8]) -> None:
    """Draw what is known of a map, its walls once more above the frontiers, which would bury thin ones."""
    x0, x1, y0, y1 = known_box(spec, occupancy)
    (low_y, low_x), (high_y, high_x) = spec.cell_of(x0, y0), spec.cell_of(x1, y1)
    low_y, low_x = max(low_y, 0), max(low_x, 0)
    cells = occupancy[low_y : high_y + 1, low_x : high_x + 1]
    shades = np.empty((*cells.shape, 3), np.uint8)
    shades[:] = UNDECIDED_SHADE
    shades[cells < 0] = UNKNOWN_SHADE
    shades[(cells >= 0) & (cells <= FREE_UP_TO)] = FREE_SHADE
    shades[cells >= OCCUPIED_FROM] = OCCUPIED_SHADE
    side = block_side(shades) * spec.resolution
    shades = darkest(shades)
    left, bottom = spec.origin_x + low_x * spec.resolution, spec.origin_y + low_y * spec.resolution
    extent = (left, left + shades.shape[1] * side, bottom, bottom + shades.shape[0] * side)
    axes.imshow(shades, origin="lower", extent=extent, interpolation="nearest")
    is_wall = (shades == OCCUPIED_SHADE).all(axis=2)
    walls = np.dstack((shades, np.where(is_wall, 255, 0).astype(np.uint8)))
    axes.imshow(walls, origin="lower", extent=extent, interpolation="nearest", zorder=2.2)


def _draw_marks(axes: Axes, marks: Sequence[Mark]) -> None:
    for mark in marks:
        shape, colour = MARKS[mark.kind]
        face = "none" if mark.kind == "error" else colour
        axes.plot(mark.x, mark.y, shape, ms=11, mfc=face, mec=colour, mew=1.8, zorder=10)
        low, high = axes.get_xlim()
        side = "left" if mark.x - low < 0.6 * (high - low) else "right"  # of the words: they stay inside
        away = (9 if side == "left" else -9, -14 if mark.kind == "error" else 7)
        told = axes.annotate(mark.text, (mark.x, mark.y), away, textcoords="offset points", ha=side, zorder=11)
        _dress_note(told, colour)


def _dress_note(note: Annotation, colour: str) -> None:
    """Write in a colour on a white halo, so that it can be read on everything."""
    from matplotlib.patheffects import withStroke

    note.set(color=colour, fontsize=8, fontweight="bold")
    note.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def draw_overlay(quality: MapQuality, path: Path) -> Path:
    """Draw the overlay of a comparison with its legend and numbers."""
    height, width = quality.overlay.shape[:2]
    figure, axes = _figure_for(width, height)
    axes.imshow(darkest(quality.overlay), interpolation="nearest", extent=(0.0, width, height, 0.0))
    for colour, label in ((RED, "truth"), (BLUE, "built"), (BOTH, "both")):
        axes.plot([], [], "s", color=tuple(c / 255 for c in colour), label=label)
    numbers = (
        f"coverage {quality.coverage_ratio:.2%}   false free {quality.false_free_ratio:.2%}   "
        f"NNE {quality.nne_cells:.2f} / {quality.nne_reverse_cells:.2f} cells   SSIM {quality.ssim:.3f}"
    )
    axes.text(0.0, -0.02, numbers, transform=axes.transAxes, va="top", color=INK, fontsize=9)
    axes.set_axis_off()
    _legend(axes)
    return save_figure(figure, path)


def draw_tracks(path: Path, tracks: Mapping[str, F64]) -> Path:
    """Draw named tracks float64 (N, 2), metres, into one plan."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 7.6), dpi=DPI)
    axes = figure.add_subplot()
    for k, (label, track) in enumerate(tracks.items()):
        axes.plot(track[:, 0], track[:, 1], color=COLOURS[k % len(COLOURS)], lw=1.6, label=label)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)", color=INK)
    axes.set_ylabel("y (m)", color=INK)
    axes.grid(color=GRID, lw=0.8)
    axes.set_axisbelow(True)
    _legend(axes)
    return save_figure(figure, path)


def draw_series(
    path: Path,
    label_x: str,
    label_y: str,
    series: Mapping[str, tuple[Curve, Curve]],
    mark: tuple[float, float, str] | None = None,
) -> Path:
    """Draw named curves (x values, y values) into one plot; a single curve needs no legend. `mark` is a place (x, y) and what to say
    about it."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 3.2), dpi=DPI)
    axes = figure.add_subplot()
    for k, (label, (x, y)) in enumerate(series.items()):
        axes.plot(x, y, color=COLOURS[k % len(COLOURS)], lw=1.6, label=label)
    if len(series) == 1:
        for x, y in series.values():
            axes.fill_between(x, y, color=COLOURS[0], alpha=0.08, lw=0)
    axes.set_xlabel(label_x, color=INK)
    axes.set_ylabel(label_y, color=INK)
    axes.grid(color=GRID, lw=0.8)
    axes.set_axisbelow(True)
    axes.margins(x=0.01)
    if mark is not None:
        axes.margins(y=0.15)
        _draw_marks(axes, [Mark(*mark)])
    _dress(axes)
    if len(series) > 1:
        _legend(axes)
    return save_figure(figure, path)


def block_side(picture: NDArray[np.uint8], most: int = MOST_PIXELS) -> int:
    """Return how many pixels wide and high the blocks are of which `darkest` makes one."""
    height, width, _ = picture.shape
    return int(max(1, math.ceil(max(height, width) / most)))


def darkest(picture: NDArray[np.uint8], most: int = MOST_PIXELS) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) with at most about `most` rows and columns: of each block of pixels the darkest of every colour, so that
    walls stay. Rows and columns that fill no block are white."""
    k = block_side(picture, most)
    if k == 1:
        return picture
    height, width = (-(-n // k) for n in picture.shape[:2])
    whole = np.full((height * k, width * k, 3), 255, np.uint8)
    whole[: picture.shape[0], : picture.shape[1]] = picture
    return np.asarray(whole.reshape(height, k, width, k, 3).min(axis=(1, 3)))


def known_box(spec: GridSpec, occupancy: NDArray[np.int8]) -> tuple[float, float, float, float]:
    """Return (x0, x1, y0, y1), metres, around what is known, with half a metre of margin; all of the grid when nothing is."""
    rows, columns = np.nonzero((occupancy >= 0).any(axis=1))[0], np.nonzero((occupancy >= 0).any(axis=0))[0]
    if len(rows) == 0:
        rows, columns = np.array([0, spec.height - 1]), np.array([0, spec.width - 1])
    margin, r = 0.5, spec.resolution
    return (
        float(spec.origin_x + columns[0] * r - margin),
        float(spec.origin_x + (columns[-1] + 1) * r + margin),
        float(spec.origin_y + rows[0] * r - margin),
        float(spec.origin_y + (rows[-1] + 1) * r + margin),
    )


def _figure_for(width: float, height: float) -> tuple[Figure, Axes]:
    """Make a figure of about 60 square inches' area in the shape of the content, at most 9 by 9 inches."""
    from matplotlib.figure import Figure

    scale = min(9.0 / max(width, height), math.sqrt(60.0 / (width * height)))
    figure = Figure(figsize=(max(4.5, width * scale), max(3.0, height * scale) + 0.6), dpi=DPI)
    return figure, figure.add_subplot()


def _dress(axes: Axes) -> None:
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_color(MUTED)
    axes.tick_params(colors=MUTED, labelsize=8)


def _dress_map(axes: Axes) -> None:
    _dress(axes)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)", color=INK, fontsize=9)
    axes.set_ylabel("y (m)", color=INK, fontsize=9)
    _legend(axes)


def _legend(axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        return
    axes.legend(
        handles,
        labels,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=min(6, len(handles)),
        frameon=False,
        fontsize=8,
        labelcolor=INK,
        handlelength=1.6,
        columnspacing=1.2,
        borderaxespad=0.2,
    )


def save_figure(figure: Figure, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, bbox_inches="tight", facecolor="white")
    return path
