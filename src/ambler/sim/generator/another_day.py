"""Another day in a drawn place: a share of its furniture stands elsewhere.

Every piece that is moved stays in its room: pushed by `WAY` metres and turned by up to `TURN` degrees, off walls, doors, ways and other
things, and every room can still be reached.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import replace

import numpy as np

from ambler.sim.generator.plan import Entry, Piece, Plan
from ambler.sim.generator.rect import Rect

WAY = (0.3, 1.5)  # metres: less is what a scan matcher takes for the old place, more is another room
TURN = 20.0  # degrees
TRIES = 60  # per piece; corners are tight
WALL_GAP = 0.1  # metres between a moved piece and the wall


def move_furniture(plan: Plan, share: float, rng: np.random.Generator) -> tuple[int, ...]:
    """Move a share of the pieces of a plan in it and return which: indices into `plan.pieces`. Racks stay; fewer are moved where there is
    no room."""
    movable = [k for k, piece in enumerate(plan.pieces) if not piece.racks and _room_of(plan, piece) is not None]
    moved: list[int] = []
    for k in rng.permutation(movable).tolist():
        if len(moved) >= round(share * len(movable)):
            break
        piece = _moved(plan, plan.pieces[k], rng)
        if piece is not None:
            plan.pieces[k] = piece
            moved.append(k)
    return tuple(moved)


def day_generator(kind: str, seed: int, day: int) -> np.random.Generator:
    """Return the generator of what happens in a place until a day."""
    return np.random.Generator(np.random.SFC64([zlib.crc32(b"day " + kind.encode()), seed, day]))


def _moved(plan: Plan, piece: Piece, rng: np.random.Generator) -> Piece | None:
    """Return the piece at a free place of its room, None when none was found."""
    room = _room_of(plan, piece)
    assert room is not None
    others = replace(plan, pieces=[other for other in plan.pieces if other is not piece])
    for _ in range(TRIES):
        way, bearing = float(rng.uniform(*WAY)), float(rng.uniform(-math.pi, math.pi))
        shift = way * math.cos(bearing), way * math.sin(bearing)
        there = shifted(piece, shift, math.radians(float(rng.uniform(-TURN, TURN))))
        if room.inset(WALL_GAP).contains(there.place) and others.is_free(there.place):
            return there
    return None


def shifted(piece: Piece, shift: tuple[float, float], turn: float) -> Piece:
    """Return a piece moved by `shift` metres and turned by `turn` radians about its middle."""
    (cx, cy), c, s = piece.place.center, math.cos(turn), math.sin(turn)

    def there(entry: Entry) -> Entry:
        x, y = entry["center"][0] - cx, entry["center"][1] - cy
        at = [round(cx + shift[0] + c * x - s * y, 3), round(cy + shift[1] + s * x + c * y, 3)]
        return {**entry, "center": at}

    boxes = [{**there(box), "yaw_deg": round(box.get("yaw_deg", 0.0) + math.degrees(turn), 1)} for box in piece.boxes]
    width, depth = piece.place.width, piece.place.depth
    half_x, half_y = 0.5 * (abs(c) * width + abs(s) * depth), 0.5 * (abs(s) * width + abs(c) * depth)
    x, y = cx + shift[0], cy + shift[1]
    place = Rect(x - half_x, y - half_y, x + half_x, y + half_y)
    return Piece(place, boxes, [there(cylinder) for cylinder in piece.cylinders])


def _room_of(plan: Plan, piece: Piece) -> Rect | None:
    x, y = piece.place.center
    return next((room for room in plan.floors if room.has(x, y)), None)
