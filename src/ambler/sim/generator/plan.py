"""A plan that grows: walls, things, people and ways, as entries of a world file, and where nothing more may be put."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ambler.sim.generator.rect import Rect

Point = tuple[float, float]
Entry = dict[str, Any]


@dataclass
class Plan:
    """The entries drawn so far. `is_taken` holds what furniture must keep off: itself, doors, ways; `blocks` says which entries of `boxes`,
    `cylinders` and `racks` belong together as one piece that may be left out again."""

    rng: np.random.Generator
    wall_height: float = 2.6
    ceiling: float | None = None
    door_height: float = 2.1
    friction: float = 0.8
    start: Entry = field(default_factory=dict)
    walls: list[Entry] = field(default_factory=list)
    people: list[Entry] = field(default_factory=list)
    walks: list[Rect] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)
    fixed: Piece = field(default_factory=lambda: Piece(Rect(0, 0, 0, 0)))
    clear: list[Rect] = field(default_factory=list)
    floors: list[Rect] = field(default_factory=list)
    ways: list[list[Point]] = field(default_factory=list)

    def wall(
        self,
        a: Point,
        b: Point,
        thickness: float,
        doors: Sequence[tuple[float, float]] = (),
        *,
        height: float | None = None,
        is_glass: bool = False,
    ) -> None:
        """Put a wall between two points with doors (distance of the middle from `a`, width)."""
        entry: Entry = {"from": _rounded(a), "to": _rounded(b), "thickness": round(thickness, 3)}
        if doors:
            entry["doors"] = [{"at": round(at, 3), "width": round(width, 3)} for at, width in doors]
        if height is not None:
            entry["height"] = round(height, 3)
        if is_glass:
            entry["glass"] = True
        self.walls.append(entry)

    def enclose(self, outline: Rect, thickness: float) -> None:
        """Put walls around a rectangle."""
        corners = [
            (outline.x0, outline.y0),
            (outline.x1, outline.y0),
            (outline.x1, outline.y1),
            (outline.x0, outline.y1),
        ]
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            self.wall(a, b, thickness)

    def keep_clear(self, place: Rect) -> None:
        """Let nothing be put there any more."""
        self.clear.append(place)

    def is_free(self, place: Rect, gap: float = 0.0) -> bool:
        """Tell whether a thing may stand there with `gap` metres to others."""
        return not any(place.overlaps(c) for c in self.clear) and not any(
            place.overlaps(p.place, gap) for p in self.pieces
        )

    def put(self, piece: Piece, gap: float = 0.0) -> bool:
        """Put a piece if its place is free; returns whether it was."""
        if not self.is_free(piece.place, gap):
            return False
        self.pieces.append(piece)
        return True

    def person(self, way: Sequence[Point], speed: float) -> None:
        """Let somebody walk along the points and back."""
        self.people.append({"way": [_rounded(p) for p in way], "speed": round(speed, 2)})

    def set_start(self, at: Point) -> None:
        """Say where the robot starts, and keep that place clear for the largest of them."""
        self.start = {"x": round(at[0], 3), "y": round(at[1], 3), "yaw_deg": 0.0}
        self.keep_clear(Rect(at[0] - 1.0, at[1] - 1.0, at[0] + 1.0, at[1] + 1.0))

    def content(self) -> Entry:
        """Return the plan as a world file holds it."""
        out: Entry = {"start": self.start, "wall_height": round(self.wall_height, 2)}
        if self.ceiling is not None:
            out["ceiling"] = round(self.ceiling, 2)
        out |= {"door_height": self.door_height, "friction": round(self.friction, 2), "walls": self.walls}
        for kind in ("boxes", "cylinders", "racks"):
            entries = [e for piece in (self.fixed, *self.pieces) for e in getattr(piece, kind)]
            if entries:
                out[kind] = entries
        if self.people:
            out["people"] = self.people
        return out


@dataclass
class Piece:
    """A thing made of solids, and the place that it takes."""

    place: Rect
    boxes: list[Entry] = field(default_factory=list)
    cylinders: list[Entry] = field(default_factory=list)
    racks: list[Entry] = field(default_factory=list)

    def box(
        self,
        name: str,
        center: Point,
        size: tuple[float, float, float],
        *,
        base: float = 0.0,
        yaw_deg: float = 0.0,
        albedo: float = 0.5,
        is_glass: bool = False,
    ) -> Piece:
        """Add a box: `size` along x, y and z."""
        entry: Entry = {"name": name, "center": _rounded(center), "size": [round(s, 3) for s in size]}
        if base:
            entry["base"] = round(base, 3)
        if yaw_deg:
            entry["yaw_deg"] = round(yaw_deg, 1)
        if albedo != 0.5:
            entry["albedo"] = round(albedo, 2)
        if is_glass:
            entry["glass"] = True
        self.boxes.append(entry)
        return self

    def cylinder(self, name: str, center: Point, radius: float, height: float, base: float = 0.0) -> Piece:
        """Add an upright cylinder."""
        entry: Entry = {
            "name": name,
            "center": _rounded(center),
            "radius": round(radius, 3),
            "height": round(height, 3),
        }
        if base:
            entry["base"] = round(base, 3)
        self.cylinders.append(entry)
        return self


def turned(rect_center: Point, offset: Point, quarter: int) -> Point:
    """Return a point `offset` from a centre after `quarter` quarter turns counter-clockwise."""
    x, y = offset
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter % 4]
    return rect_center[0] + c * x - s * y, rect_center[1] + s * x + c * y


def _rounded(point: Point) -> list[float]:
    return [round(float(point[0]), 3), round(float(point[1]), 3)]
