"""Levels of ground in a file: what is known of each cell, how high it lies, and where one comes from level to level; `<stem>.levels.npz` beside the maps of the levels."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.wire.atomic_file import write_whole

GroundLevel = tuple[GridSpec, NDArray[np.int8], NDArray[np.float32]]
"""Geometry, occupancy int8 [iy, ix] (-1 unknown, 0 ground, 100 in the way) and heights of the ground float32 [iy, ix], metres, NaN where not known."""
SUFFIX = ".levels.npz"


def save_levels(stem: Path, levels: Sequence[GroundLevel], passages: NDArray[np.float64] | None = None) -> Path:
    """Write levels and `passages` float64 (N, 5) (level from, level to, x, y, yaw), whole or not at all; returns the file."""
    out: dict[str, NDArray[np.generic]] = {"passages": np.zeros((0, 5)) if passages is None else passages}
    for k, (spec, occupancy, heights) in enumerate(levels):
        out[f"spec_{k}"] = np.array([spec.resolution, spec.width, spec.height, spec.origin_x, spec.origin_y])
        out[f"occupancy_{k}"], out[f"heights_{k}"] = occupancy, heights
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **out)  # type: ignore[arg-type]
    path = stem.with_name(stem.name + SUFFIX)
    write_whole(path, buffer.getvalue())
    return path


def load_levels(path: Path) -> list[GroundLevel]:
    """Read levels; raises BadInputError for anything that `save_levels` did not write."""
    held = _held(path)
    levels: list[GroundLevel] = []
    while f"spec_{len(levels)}" in held:
        k = len(levels)
        try:
            numbers, occupancy, heights = (held[f"{name}_{k}"] for name in ("spec", "occupancy", "heights"))
            resolution, width, height, x, y = (float(v) for v in numbers)
        except (KeyError, ValueError, TypeError) as error:
            raise BadInputError(f"{path}: level {k} is not whole: {error}") from error
        spec = GridSpec(resolution, int(width), int(height), x, y)
        if occupancy.shape != spec.shape or heights.shape != spec.shape:
            raise BadInputError(f"{path}: level {k} is {occupancy.shape}, its geometry says {spec.shape}")
        levels.append((spec, occupancy.astype(np.int8), heights.astype(np.float32)))
    if not levels:
        raise BadInputError(f"{path}: holds no level")
    return levels


def load_passages(path: Path) -> NDArray[np.float64]:
    """Read the passages (N, 5) between levels, none from files of before there were any; raises BadInputError."""
    passages = np.asarray(_held(path).get("passages", np.zeros((0, 5))))
    if passages.ndim != 2 or passages.shape[1] != 5 or passages.dtype.kind != "f" or not np.isfinite(passages).all():
        raise BadInputError(f"{path}: its passages between levels are not whole")
    return passages


def _held(path: Path) -> dict[str, NDArray[np.generic]]:
    """Return everything that a file holds."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError, KeyError) as error:
        raise BadInputError(f"{path}: not readable as levels of ground: {error}") from error
