"""Meshes and terrain in a world file: what is written there, and the surfaces that come of it, in the author's coordinates."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim.dock_entry import Entry
from ambler.sim.meshes import HeightField, TriangleMesh
from ambler.wire.mesh_files import read_mesh

F64 = NDArray[np.float64]

FOLDER = "folder"
"""Key of the validation context: the folder of the world file, beside which files are looked for."""
MAX_SAMPLES = 4_000_000


class _FileEntry(Entry):
    file: str | None = None

    @field_validator("file")
    @classmethod
    def _beside(cls, name: str | None, info: ValidationInfo) -> str | None:
        folder = info.context[FOLDER] if info.context else Path()
        return None if name is None else str(folder / name)


class MeshEntry(_FileEntry):
    """A mesh from a file (.obj, .stl, .ply), or of corners and triangles that stand here: scaled, turned about z, then moved to `at`."""

    file: str | None = None
    vertices: tuple[tuple[float, float, float], ...] = ()
    triangles: tuple[tuple[int, int, int], ...] = ()
    name: str | None = None
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    scale: float = Field(default=1.0, gt=0)
    albedo: float = Field(default=0.6, ge=0, le=1)

    @model_validator(mode="after")
    def _has_one_source(self) -> MeshEntry:
        if (self.file is None) == (not self.triangles):
            raise ValueError("give either file, or vertices and triangles")
        return self

    def to_mesh(self, world_path: Path) -> TriangleMesh:
        """Read the file, or take what stands here; raises BadInputError, which names the file that is wrong."""
        path = world_path if self.file is None else Path(self.file)
        vertices, triangles = (
            (np.array(self.vertices).reshape(-1, 3), np.array(self.triangles)) if self.file is None else read_mesh(path)
        )
        try:
            mesh = TriangleMesh(
                self.name or path.stem, self.scale * vertices + [0.0, 0.0, self.at[2]], triangles, self.albedo
            )
        except BadInputError as error:
            raise BadInputError(f"{path}: {error}") from error
        return mesh.moved(SE2(self.at[0], self.at[1], math.radians(self.yaw_deg)))


class TerrainEntry(_FileEntry):
    """The ground: a picture of 8 or 16 bits whose black and white are the two `range` heights, an .npy file of heights in metres, or
    heights on given lines `x` and `y`, between which the ground is straight."""

    file: str | None = None
    range: tuple[float, float] | None = None
    x: tuple[float, ...] = Field(default=(), min_length=2)
    y: tuple[float, ...] = Field(default=(), min_length=2)
    heights: tuple[tuple[float, ...], ...] = ()
    resolution: float = Field(gt=0)
    corner: tuple[float, float] = (0.0, 0.0)
    yaw_deg: float = 0.0
    name: str = "terrain"
    albedo: float = Field(default=0.3, ge=0, le=1)

    @model_validator(mode="after")
    def _has_one_source(self) -> TerrainEntry:
        if (self.file is None) == (not self.heights):
            raise ValueError("give either file or x, y and heights")
        if self.heights:
            if self.range is not None:
                raise ValueError("range belongs to pictures")
            if any(len(row) != len(self.x) for row in self.heights) or len(self.heights) != len(self.y):
                raise ValueError(f"heights must be {len(self.y)} rows (y) of {len(self.x)} numbers (x)")
            if any(b <= a for line in (self.x, self.y) for a, b in pairwise(line)):
                raise ValueError("x and y must grow")
        return self

    def to_terrain(self, world_path: Path) -> HeightField:
        """Read the file or fill the lines; raises BadInputError, which names the file that is wrong."""
        corner = SE2(*self.corner, math.radians(self.yaw_deg))
        if self.file is None:
            return HeightField(
                self.name,
                self._between_lines(world_path),
                self.resolution,
                corner @ SE2(self.x[0], self.y[0], 0.0),
                self.albedo,
            )
        path = Path(self.file)
        heights = _read_npy(path) if path.suffix == ".npy" else self._read_picture(path)
        try:
            return HeightField(self.name, heights, self.resolution, corner, self.albedo)
        except BadInputError as error:
            raise BadInputError(f"{path}: {error}") from error

    def _between_lines(self, path: Path) -> F64:
        counts = [round((line[-1] - line[0]) / self.resolution) + 1 for line in (self.x, self.y)]
        if counts[0] * counts[1] > MAX_SAMPLES:
            raise BadInputError(
                f"{path}: terrain {self.name!r}: {counts[0]} x {counts[1]} samples are too many, choose a coarser resolution"
            )
        x, y = (line[0] + self.resolution * np.arange(n) for line, n in zip((self.x, self.y), counts, strict=True))
        rows = np.array([np.interp(x, self.x, row) for row in self.heights])
        return np.array([np.interp(y, self.y, column) for column in rows.T]).T

    def _read_picture(self, path: Path) -> F64:
        """The picture's upper edge is the side of the greatest y."""
        if self.range is None:
            raise BadInputError(f"{path}: range: is missing, give the heights of black and white in metres")
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
        if image is None:
            raise BadInputError(f"{path}: not readable as a picture of heights (.png) or an array (.npy)")
        if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
            raise BadInputError(f"{path}: a picture of heights has one channel of 8 or 16 bits")
        low, high = self.range
        return np.asarray(
            low + image[::-1].astype(np.float64) * ((high - low) / (65535.0 if image.dtype == np.uint16 else 255.0))
        )


def _read_npy(path: Path) -> F64:
    """Row 0 is the lowest y."""
    try:
        array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise BadInputError(f"{path}: not readable as an array of heights: {error}") from error
    if array.dtype.kind not in "fiu":
        raise BadInputError(f"{path}: an array of heights holds real numbers, not {array.dtype}")
    return np.asarray(array, np.float64)
