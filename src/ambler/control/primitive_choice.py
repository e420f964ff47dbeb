"""Chooses a motion primitive: points block paths, free paths score by where they lead, and the group with the greatest sum wins (navigation reference 1.5)."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.control.local_window import LocalWindow
from ambler.control.primitive_library import DIRECTIONS, GROUPS, START, primitive_library
from ambler.control.primitive_sweeps import ANGLES, SweepTable, following_table, holding_table
from ambler.control.primitives_config import PrimitivesConfig
from ambler.core.robot import DriveKind, RobotModel
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels.primitives import LEVELS, WORDS, block_paths, points_around, rough_share, score_groups

F64 = NDArray[np.float64]

MOVER_POINTS_MAX = 2000


class Manner(enum.StrEnum):
    """How a base moves along a path."""

    FORWARD = "forward"
    BACKWARDS = "backwards"
    HOLDING = "holding"


@dataclass(frozen=True, slots=True)
class Choice:
    """A primitive: points float64 (N, 2) in the base frame, the direction in which it begins (rad), how the base moves along it, and how rough its
    ground is (0, 1, 2)."""

    points: F64
    direction: float
    manner: Manner
    roughness: int


class PrimitiveChooser:
    """Knows one robot's tables; `window` holds the local costs."""

    def __init__(self, config: PrimitivesConfig, robot: RobotModel, window: LocalWindow) -> None:
        self._config = config
        self._window = window
        self._library = primitive_library()
        polygon, padding = robot.footprint, config.padding
        self._forward = [following_table(polygon, padding, scale) for scale in config.scales]
        self._backwards: list[SweepTable] = []
        if robot.limits.vx_min < 0.0:
            self._backwards = [following_table(polygon, padding, s, backwards=True) for s in config.scales]
        is_omni = robot.drive is DriveKind.OMNI and robot.limits.vy_max > 0.0
        self._holding = [holding_table(polygon, padding, config.hold_scale)] if is_omni else []
        self._nose = float(np.max(np.abs(polygon[:, 0]))) + padding
        self._cos, self._sin = np.cos(ANGLES), np.sin(ANGLES)
        self._blocked = np.zeros((LEVELS, DIRECTIONS, WORDS), np.uint64)
        self._scores, self._free = np.empty((DIRECTIONS, GROUPS)), np.empty((DIRECTIONS, GROUPS), np.int64)
        self._points, self._levels = np.empty((0, 2)), np.empty(0, np.uint8)
        self._last: tuple[Manner, float] | None = None  # and the heading of the choice in the odom frame
        self.free_paths = 0
        """How many paths of the last choice were free, over all directions that were tried."""

    def reset(self) -> None:
        """Forget what was chosen last."""
        self._last = None

    def choose(
        self, start: SE2, goal: tuple[float, float], speed_share: float, others: F64, *, is_goal_near: bool = False
    ) -> Choice | None:
        """Return what leads best from `start` to a point of the odom frame, or None when nothing that leads there is free. `speed_share` (0..1) of
        the greatest speed sets how far is looked; `others` (N, 2) are points in the base frame beside those of the window."""
        bearing = wrap_angle(math.atan2(goal[1] - start.y, goal[0] - start.x) - start.yaw)
        distance = math.hypot(goal[0] - start.x, goal[1] - start.y)
        points, levels = self.seen(start, others)
        turns = self._turns(start)
        for manner in self._manners(bearing, is_goal_near=is_goal_near):
            for table, scale, reach in self._sizes(manner, speed_share):
                reach = min(reach, distance + self._nose + self._config.goal_clear)
                choice = self._best(start, bearing, distance, manner, table, scale, reach, points, levels, turns)
                if choice is not None:
                    return choice
        return None

    def best_group(self, points: F64, levels: NDArray[np.uint8], bearing: float) -> tuple[int, int]:
        """Return the direction and the group that lead best in a bearing (rad), at full size and range with room to turn: the scoring itself."""
        manner = Manner.FORWARD
        may = self._may(bearing, manner, (-math.pi, math.pi))
        self._score(
            bearing, self._forward[0], may, self._weights(SE2(), manner, math.inf), self._config.range, points, levels
        )
        d, g = np.unravel_index(int(np.argmax(self._scores)), self._scores.shape)
        return int(d), int(g)

    def _score(
        self,
        bearing: float,
        table: SweepTable,
        may: NDArray[np.bool_],
        weights: F64,
        reach: float,
        points: F64,
        levels: NDArray[np.uint8],
    ) -> None:
        """Block and score all paths in the directions that may be taken, by points (N, 2) of the base frame within `reach`."""
        c, lib = self._config, self._library
        block_paths(
            points, levels, reach, self._cos, self._sin, may, table.bitmaps, table.origin, table.cell, self._blocked
        )
        plan = np.array([c.worthless_angle, *c.rough_worth])
        score_groups(
            self._blocked, may, bearing, ANGLES, weights, lib.end_directions, lib.groups, plan, self._scores, self._free
        )
        self.free_paths = int(self._free.sum())

    def _best(
        self,
        start: SE2,
        bearing: float,
        distance: float,
        manner: Manner,
        table: SweepTable,
        scale: float,
        reach: float,
        points: F64,
        levels: NDArray[np.uint8],
        turns: tuple[float, float],
    ) -> Choice | None:
        may = self._may(bearing, manner, turns)
        self._score(bearing, table, may, self._weights(start, manner, distance), reach, points, levels)
        d, g = np.unravel_index(int(np.argmax(self._scores)), self._scores.shape)
        if self._scores[d, g] <= 0.0:
            return None
        shares = np.empty(2)
        rough_share(self._blocked, int(d), int(g), self._library.groups, shares)
        roughness = 2 if shares[1] >= self._config.rough_share else int(shares[0] >= self._config.rough_share)
        direction = float(ANGLES[d])
        self._last = manner, wrap_angle(start.yaw + direction)
        return Choice(self._start_path(int(g), direction, scale, min(reach, distance)), direction, manner, roughness)

    def _start_path(self, group: int, direction: float, scale: float, length: float) -> F64:
        path = self._library.start(group) * scale
        path = path[: max(2, math.ceil(length / (scale * START) * (len(path) - 1)) + 1)]
        return SE2(0.0, 0.0, direction).transform(path)

    def _sizes(self, manner: Manner, speed_share: float) -> Iterator[tuple[SweepTable, float, float]]:
        """Yield tables with their scales and the range of obstacles, from those that fit the speed on to the least."""
        c = self._config
        scales: tuple[float, ...] = c.scales
        tables = self._forward if manner is Manner.FORWARD else self._backwards
        if manner is Manner.HOLDING:
            tables, scales = self._holding, (c.hold_scale,)
        wanted = max(scales[-1], scales[0] * speed_share)
        reach = max(c.range_min, c.range * speed_share)
        for number, (table, scale) in enumerate(zip(tables, scales, strict=True)):
            if scale > wanted + 1e-9 and number + 1 < len(scales):
                continue
            reach = min(reach, max(c.range_min, c.range * scale / c.scales[0]))
            yield table, scale, reach
        while reach > c.range_min + 1e-9:
            reach = max(c.range_min, reach - c.range_step)
            yield tables[-1], scales[-1], reach

    def _manners(self, bearing: float, *, is_goal_near: bool) -> tuple[Manner, ...]:
        """Return how the base may move, in the order in which it is tried. Two-way drive changes its way round only well beyond the side."""
        back = (Manner.BACKWARDS,) if self._backwards else ()
        hold = (Manner.HOLDING,) if self._holding else ()
        last = self._last[0] if self._last is not None else Manner.FORWARD
        if self._config.is_two_way and back:
            beyond = math.radians(60.0 if last is Manner.BACKWARDS else 120.0)
            if abs(bearing) > beyond:
                return (*back, Manner.FORWARD, *hold)
        if is_goal_near and hold:
            return (*hold, Manner.FORWARD, *back)
        if last is Manner.BACKWARDS:  # who draws back goes on until he can turn
            return (Manner.FORWARD, *back, *hold)
        return (Manner.FORWARD, *hold, *back)

    def _may(self, bearing: float, manner: Manner, turns: tuple[float, float]) -> NDArray[np.bool_]:
        """Which directions are tried: those within reach of the goal's, to which the footprint can turn where it stands."""
        c = self._config
        away = np.abs((ANGLES - bearing + np.pi) % (2.0 * np.pi) - np.pi)
        may = away <= c.direction_reach + 1e-9
        if manner is Manner.HOLDING:
            return np.asarray(may)
        turn = ANGLES if manner is Manner.FORWARD else (ANGLES + 2.0 * np.pi) % (2.0 * np.pi) - np.pi
        small = np.abs(turn) <= c.turn_start
        free = ((turn >= turns[0] - 1e-9) & (turn <= turns[1] + 1e-9)) | small
        if manner is Manner.BACKWARDS:
            free &= np.abs(turn) <= 0.5 * np.pi
        return np.asarray(may & free)

    def _turns(self, start: SE2) -> tuple[float, float]:
        """Return how far the footprint can turn clockwise (negative) and counter-clockwise where it stands."""
        return self._window.free_turn(start, -math.pi), self._window.free_turn(start, math.pi)

    def _weights(self, start: SE2, manner: Manner, distance: float) -> F64:
        c = self._config
        if distance < c.near_goal and manner is Manner.HOLDING:
            weights = np.tile((4.0 - np.abs(np.arange(GROUPS) - GROUPS // 2)) ** 2, (DIRECTIONS, 1))
        else:
            turn = np.abs(ANGLES)
            turn = np.minimum(turn, np.pi - turn) if manner is not Manner.FORWARD else turn
            ahead = 1.0 + 9.0 * np.maximum(0.0, 1.0 - turn / (0.5 * np.pi))
            weights = np.tile((ahead**4)[:, None], (1, GROUPS))
        if self._last is not None and self._last[0] is manner:
            off = np.abs((ANGLES + start.yaw - self._last[1] + np.pi) % (2.0 * np.pi) - np.pi)
            near = off < math.radians(8.0)
            is_aside = manner is Manner.FORWARD and abs(wrap_angle(self._last[1] - start.yaw)) > c.turn_end
            weights[near] *= c.keep_turning if is_aside else c.keep
        return weights

    def seen(self, start: SE2, others: F64) -> tuple[F64, NDArray[np.uint8]]:
        """Return the points of the window and the others in the base frame, with their levels."""
        w, c = self._window, self._config
        costs = w.costs
        if len(self._points) < costs.size + MOVER_POINTS_MAX:
            self._points = np.empty((costs.size + MOVER_POINTS_MAX, 2))
            self._levels = np.empty(len(self._points), np.uint8)
        reach = c.range + self._nose
        ranges, rough = np.array([reach, self._forward[0].slack]), np.array(c.rough_costs, np.uint8)
        edges = (w.outline.normals, w.outline.offsets)
        count = points_around(
            costs, w.placed(start), w.spec.resolution, ranges, rough, *edges, self._points, self._levels
        )
        others = others[:MOVER_POINTS_MAX]
        self._points[count : count + len(others)] = others
        self._levels[count : count + len(others)] = 0
        return self._points[: count + len(others)], self._levels[: count + len(others)]
