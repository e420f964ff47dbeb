"""Exact synthetic rooms: walls are segments and circles known to the digit, scans are cast analytically, maps are rasterized.

Independent of every algorithm under test. Boxes may be turned; the map of a box is either filled or its outline (thin).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.localization.reflectors import ReflectorMap

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]


def box(cx: float, cy: float, sx: float, sy: float, yaw: float = 0.0) -> F64:
    """Corners (4, 2) of a box."""
    half = 0.5 * np.array([[sx, sy], [-sx, sy], [-sx, -sy], [sx, -sy]])
    return SE2(cx, cy, yaw).transform(half)


@dataclass(frozen=True)
class Room:
    """Free space `size` (x, y) from (0, 0) inside an outer wall, with convex polygons (corners (K, 2)) standing in it."""

    name: str
    size: tuple[float, float]
    solids: tuple[F64, ...]

    @cached_property
    def segments(self) -> F64:
        """All surfaces, float64 (M, 4) of (x0, y0, x1, y1)."""
        w, h = self.size
        outer = np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]])
        rings = [outer, *self.solids]
        return np.concatenate([np.hstack([r, np.roll(r, -1, axis=0)]) for r in rings])

    def cast(self, pose: SE2, angles: F64) -> F64:
        """Distances along base-frame angles from a pose; inf where nothing is hit."""
        seg = self.segments
        a = angles + pose.yaw
        d = np.stack([np.cos(a), np.sin(a)], axis=1)
        e = seg[:, 2:] - seg[:, :2]
        o = seg[:, :2] - [pose.x, pose.y]
        cross = d[:, :1] * e[None, :, 1] - d[:, 1:] * e[None, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (o[:, 0] * e[:, 1] - o[:, 1] * e[:, 0])[None] / cross
            u = (o[None, :, 0] * d[:, 1:] - o[None, :, 1] * d[:, :1]) / cross
        t = np.where((t > 1e-9) & (u >= 0) & (u <= 1) & (np.abs(cross) > 1e-12), t, np.inf)
        return np.asarray(t.min(axis=1))

    @cached_property
    def reflectors(self) -> ReflectorMap:
        """Strips of 10 cm on the walls, every few metres of surface, unevenly spaced; their surveyed map."""
        out = []
        for k, (x0, y0, x1, y1) in enumerate(self.segments):
            length = math.hypot(x1 - x0, y1 - y0)
            at = 0.6 + 0.13 * (k % 5)
            while at < length - 0.15:
                out.append((x0 + (x1 - x0) * at / length, y0 + (y1 - y0) * at / length))
                at += 2.3 + 0.37 * ((3 * len(out)) % 4)
        return ReflectorMap.surveyed(np.array(out))

    def intensities(self, pose: SE2, points: F32) -> F32:
        """Intensity 250 of returns that lie on a reflector, else 60; points (N, 2) seen from a pose."""
        hits = pose.transform(points)
        away = np.hypot(*(hits[:, None] - self.reflectors.positions[None]).transpose(2, 0, 1)).min(axis=1)
        return np.where(away < 0.05, 250.0, 60.0).astype(np.float32)

    def scan(
        self,
        pose: SE2,
        rng: np.random.Generator,
        *,
        beams: int = 720,
        sigma: float = 0.01,
        reach: float = 20.0,
    ) -> F32:
        """A merged 360° scan as points float32 (N, 2) in the base frame, with Gaussian range noise."""
        angles = np.linspace(-math.pi, math.pi, beams, endpoint=False)
        r = self.cast(pose, angles)
        keep = r < reach
        r = r[keep] + sigma * rng.standard_normal(int(keep.sum()))
        return np.stack([r * np.cos(angles[keep]), r * np.sin(angles[keep])], axis=1).astype(np.float32)

    def is_inside_solid(self, points: F64) -> NDArray[np.bool_]:
        """Which points (N, 2) lie in a solid or outside of the room."""
        w, h = self.size
        inside = (points[:, 0] < 0) | (points[:, 0] > w) | (points[:, 1] < 0) | (points[:, 1] > h)
        for corners in self.solids:
            edge = np.roll(corners, -1, axis=0) - corners
            rel = points[:, None] - corners[None]
            side = edge[None, :, 0] * rel[..., 1] - edge[None, :, 1] * rel[..., 0]
            inside |= (side >= 0).all(axis=1)
        return np.asarray(inside)

    def occupancy(
        self, *, resolution: float = 0.05, is_filled: bool = True, margin: float = 0.5, is_coverage: bool = False
    ) -> tuple[NDArray[np.int8], GridSpec]:
        """The map: free space 0, solids 100; thin: only the solid cells beside free space are 100, the inside is unknown.

        With `is_coverage` a cell holds the share of 8 x 8 of its points that lie in solids.
        """
        w, h = self.size
        spec = GridSpec(
            resolution,
            round((w + 2 * margin) / resolution),
            round((h + 2 * margin) / resolution),
            -margin,
            -margin,
        )
        index = np.stack(np.divmod(np.arange(spec.width * spec.height), spec.width), axis=1)
        solid = self.is_inside_solid(spec.centers_of(index)).reshape(spec.shape)
        cells = np.where(solid, 100, 0).astype(np.int8)
        if is_coverage:
            k = 8
            fine = GridSpec(resolution / k, spec.width * k, spec.height * k, -margin, -margin)
            index = np.stack(np.divmod(np.arange(fine.width * fine.height), fine.width), axis=1)
            share = self.is_inside_solid(fine.centers_of(index)).reshape(spec.height, k, spec.width, k)
            cells = np.rint(100 * share.mean(axis=(1, 3))).astype(np.int8)
        if not is_filled:
            free = np.pad(~solid, 1)
            beside = free[:-2, 1:-1] | free[2:, 1:-1] | free[1:-1, :-2] | free[1:-1, 2:]
            cells[solid & ~beside] = -1
        return cells, spec


def jittered(room: Room, rng: np.random.Generator, amount: float = 0.025) -> Room:
    """Move every solid and the outer wall off the grid, each by its own amount."""
    w, h = (float(v + rng.uniform(-amount, amount)) for v in room.size)
    solids = tuple(s + rng.uniform(-amount, amount, 2) for s in room.solids)
    grown = tuple(c.mean(axis=0) + (c - c.mean(axis=0)) * (1 + rng.uniform(-amount, amount)) for c in solids)
    return Room(room.name, (w, h), grown)


def office() -> Room:
    """An L of rooms with desks, all walls on multiples of 5 cm, nothing symmetric, a turned desk and a turned wall."""
    return Room(
        "office",
        (14.0, 9.0),
        (
            box(5.0, 2.0, 0.2, 4.0),
            box(5.0, 7.4, 0.2, 3.2),
            box(9.5, 5.0, 6.0, 0.2),
            box(9.0, 8.0, 0.1, 2.0),
            box(2.0, 6.0, 1.6, 0.8),
            box(2.5, 1.2, 0.8, 0.6, 0.5),
            box(11.0, 2.0, 2.4, 0.7, -0.35),
            box(7.0, 1.0, 0.5, 0.5),
            box(13.7, 7.0, 0.6, 1.2),
        ),
    )


def corridor() -> Room:
    """A bare corridor of 60 x 2 m: along x nothing can be seen within 20 m of its middle."""
    return Room("corridor", (60.0, 2.0), ())


def aisle() -> Room:
    """Racks on both sides of an aisle with feet and gaps; along x there is something to see."""
    racks = []
    for k in range(9):
        x = 1.5 + 2.7 * k + (0.2 if k % 3 == 0 else 0.0)
        racks += [box(x, 1.0, 2.2, 0.8), box(x + 0.35, 4.2, 2.1, 0.9)]
    return Room("aisle", (26.0, 5.2), tuple(racks))


def wall() -> Room:
    """A hall of 18 x 14 m driven along one wall: the others are far, a few columns stand before it."""
    columns = tuple(box(2.0 + 3.0 * k, 0.9, 0.4, 0.3) for k in range(6))
    return Room("wall", (18.0, 14.0), (*columns, box(9.0, 13.0, 3.0, 1.0), box(17.0, 8.0, 1.0, 2.5)))


@dataclass(frozen=True, slots=True)
class Step:
    """One instant of a drive: the truth, the drifting odometry, and the scan."""

    stamp_ns: int
    truth: SE2
    odom_from_base: SE2
    points_base: F32
    intensities: F32


def drive(
    room: Room,
    waypoints: list[tuple[float, float]],
    rng: np.random.Generator,
    *,
    speed: float = 0.6,
    rate_hz: float = 10.0,
    drift: float = 0.03,
    beams: int = 720,
    is_holonomic: bool = False,
) -> Iterator[Step]:
    """Drive along waypoints, turning towards each; odometry has a constant scale error and noise of `drift` of each motion."""
    dt = 1.0 / rate_hz
    x, y = waypoints[0]
    yaw = math.atan2(waypoints[1][1] - y, waypoints[1][0] - x)
    truth, odom = SE2(x, y, yaw), SE2(3.0, -2.0, 0.7)
    scale = 1.0 + drift * rng.standard_normal(2)
    stamp = 0
    points = room.scan(truth, rng, beams=beams)
    yield Step(stamp, truth, odom, points, room.intensities(truth, points))
    for goal in waypoints[1:]:
        while True:
            dx, dy = goal[0] - truth.x, goal[1] - truth.y
            distance = math.hypot(dx, dy)
            if distance < 0.5 * speed * dt:
                break
            heading = math.atan2(dy, dx) - truth.yaw
            heading = math.atan2(math.sin(heading), math.cos(heading))
            travel = min(speed * dt, distance)
            if is_holonomic:
                twist = np.array([travel * math.cos(heading), travel * math.sin(heading), 0.3 * dt])
            else:
                turn = float(np.clip(heading, -1.0 * dt, 1.0 * dt))
                travel = travel if abs(heading) < 0.4 else 0.0
                twist = np.array([travel, 0.0, turn])
            truth = truth @ SE2.exp(twist)
            noise = drift * rng.standard_normal(3)
            length = math.hypot(twist[0], twist[1])
            measured = np.array(
                [
                    twist[0] * scale[0] + noise[0] * length,
                    twist[1] * scale[0] + noise[1] * length * 0.3,
                    twist[2] * scale[1] + noise[2] * (abs(twist[2]) + 0.1 * length),
                ]
            )
            odom = odom @ SE2.exp(measured)
            stamp += round(dt * 1e9)
            points = room.scan(truth, rng, beams=beams)
            yield Step(stamp, truth, odom, points, room.intensities(truth, points))


ROUTES: dict[str, list[tuple[float, float]]] = {
    "office": [
        (1.0, 4.5),
        (4.0, 4.8),
        (7.0, 4.0),
        (9.0, 3.3),
        (12.5, 3.6),
        (9.0, 3.3),
        (6.0, 4.7),
        (3.5, 4.5),
        (1.0, 2.5),
    ],
    "corridor": [(22.0, 1.0), (26.0, 0.9), (34.0, 1.1), (38.0, 1.0)],
    "aisle": [(1.0, 2.6), (8.0, 2.5), (14.0, 2.8), (25.0, 2.6)],
    "wall": [(1.0, 2.0), (6.0, 1.9), (12.0, 2.2), (16.0, 2.0)],
}


def error_of(estimate: SE2, truth: SE2) -> F64:
    """Return (dx, dy, dyaw) in map axes."""
    d = estimate.yaw - truth.yaw
    return np.array([estimate.x - truth.x, estimate.y - truth.y, math.atan2(math.sin(d), math.cos(d))])
