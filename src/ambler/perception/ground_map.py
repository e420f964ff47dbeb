"""A map of the ground that a robot can cross, out of the terrain around it, level by level.

A level is a sheet of ground without anything of it above or below itself: it may rise and fall as it likes. The first is that on which the robot began. Where a window of terrain
contradicts the heights of the level that it is drawn into (the upper deck of a car park above the lower one), it belongs to another level,
or begins one; the ramp between two is on both, and is how one comes from one to the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN, GridSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import ground_map as kernels
from ambler.perception.ground_level import FAR, Level, common_cells
from ambler.perception.low_edges import beyond_low_edges
from ambler.perception.terrain_window import TerrainWindow

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


BEYOND = 1.0  # metres beyond what is assumed in which it is unknown again
ROOM = 0.95  # of the ground around a robot: nearly all of it
OF_OTHERS = 0.7  # of what speaks against a level: most of it
SPARSE = 4  # looks from afar of which one counts against what was in the way: most tell the same few returns again


@dataclass(frozen=True, slots=True)
class GroundMapConfig:
    """SI.

    resolution      side of a cell of the map
    assumed         metres around the robot within which ground that its sensor cannot see is taken to go on as it stands: a level LiDAR does not see the
                    nearest 5 m of where it starts
    step, rise      ground is joined to the robot's where heights differ by at most `step` and `rise` for each metre between
    block           metres by which the map grows
    drop_most       metres from the robot within which a drop counts: seen from afar, a ramp that begins to fall is one
    clear_most      metres from the robot within which every look at ground counts against what was in the way; farther away a kerb shows itself in few returns
    firm            metres to the sides of the robot within which ground that lies in the plane of its wheels is firm from then on
    firm_off        how far it may lie off that plane, and
    firm_slope      how much farther for each metre from the robot
    remembered      metres around the robot within which firm ground is told to the terrain analysis
    level_step      heights that agree within this are one level, those more than twice as far off contradict: half of a car's height, and what odometry drifts
    level_share     share of a window's known cells that must contradict before another level is looked for
    level_cells     and how many of them at least
    level_stand     metres around the robot within which as many cells must agree for it to stand on a level
    level_reach     metres from the robot within which they count: farther away it may see another level from this one
    apart           metres between two passages of the same levels
    level_room      metres around the robot within which nearly all ground of the present level must be known on another one for it to change to that, and for the place to be a
                    passage: who changes levels closer to the end of one stands in what closes it there
    level_back      metres before the place where a level began to the place of the way that counts as being on both
    border          metres beyond the ground that two levels share within which what is known of one is not looked for on the other
    stride          metres between the places that the way of the robot is kept by
    """

    resolution: float = 0.1
    assumed: float = 6.0
    step: float = 0.08
    rise: float = 0.4
    block: float = 12.8
    drop_most: float = 3.0
    clear_most: float = 5.0
    firm: float = 2.5
    firm_off: float = 0.04
    firm_slope: float = 0.03
    remembered: float = 9.0
    level_step: float = 0.7
    level_share: float = 0.02
    level_cells: int = 120
    level_stand: float = 1.5
    level_reach: float = 3.0
    level_room: float = 1.0
    apart: float = 9.0
    level_back: float = 4.0
    border: float = 1.0
    stride: float = 1.0

    @property
    def firm_limits(self) -> tuple[float, float, float]:
        """The numbers of firm ground, as the kernel takes them."""
        return self.firm, self.firm_off, self.firm_slope

    def __post_init__(self) -> None:
        for name in ("resolution", "assumed", "block", "level_step"):
            if not getattr(self, name) > 0.0:
                raise BadInputError(f"ground map {name}: must be positive, is {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class Passage:
    """A place that two levels share, on the way from one to the other."""

    of_level: int
    to_level: int
    map_from_base: SE2


@dataclass(frozen=True, slots=True)
class _Agreement:
    """How a window fits a level: with how many cells it agrees, and how many contradict; whether the robot stands on such that agree, whether it contradicts the level, whether it clearly
    does not, and how high it and the level are where it does (m)."""

    same: int
    other: int
    is_on: bool
    is_contradicted: bool
    is_free: bool
    height: float
    level_height: float


class GroundMap:
    """`update` it with every window of terrain; `level` is the one that the robot is on, `version` counts changes of what it says. `wanted`: a
    level that is gone to as soon as a window does not contradict it. `stance`: metres around its base on which the robot stands."""

    def __init__(self, config: GroundMapConfig | None = None, stance: float = 0.2) -> None:
        self.config = config if config is not None else GroundMapConfig()
        self._stance = stance
        self.levels: list[Level] = []
        self.passages: list[Passage] = []
        self.active = 0
        self.version = 0
        self.wanted: int | None = None
        self._looks = 0
        self._start: SE2 | None = None
        self._way: list[SE3] = []  # map_from_base on the present level, every `stride` metres

    @property
    def level(self) -> Level:
        """The level that the robot is on; raises BadInputError before the first window."""
        if not self.levels:
            raise BadInputError("the map of ground has no level yet")
        return self.levels[self.active]

    def update(
        self,
        window: TerrainWindow,
        map_from_odom: SE3,
        odom_from_base: SE3,
        odom_from_sensor: SE3,
        elevation: tuple[float, float],
    ) -> None:
        """Take a window of terrain, with where base and sensor were and the elevations (rad) that the sensor sees."""
        if window.kinds.size == 0:
            return
        c, plane = self.config, _plane(odom_from_base)
        window = window.around(plane[0], plane[1], c.assumed + BEYOND)
        sines = np.sin(np.clip(elevation, -0.5 * math.pi, 0.5 * math.pi))
        place = np.array(odom_from_sensor.translation)
        upright = odom_from_sensor.inverse().matrix()[:3, :3].copy()
        kernels.find_blind(window.kinds, window.tops, window.origin, place, upright, sines, plane, c.assumed)
        _carry_heights(window, plane)
        queue = np.empty(window.kinds.size, np.int32)
        kernels.keep_joined(window.kinds, window.tops, window.heights, window.origin, plane[:3], c.step, c.rise, queue)
        flat = map_from_odom.to_se2()
        rise = float((map_from_odom @ odom_from_base).translation[2] - odom_from_base.translation[2])
        count = len(self.levels)
        map_from_base = map_from_odom @ odom_from_base
        if count == 0:
            self._begin(window, flat)
            self._start = map_from_base.to_se2()
        self._choose(window, flat, rise, map_from_base)
        level = self._grown(window, flat)
        box, spec = _box(level.spec, flat.transform(window.corners())), _spec(level.spec)
        of_map = _plane(map_from_base)
        self._looks += 1
        clear_most = c.clear_most if self._looks % SPARSE else math.inf
        limits = np.array([c.assumed, c.level_step, c.drop_most, clear_most])
        sensor = (place, upright, float(sines[0]))
        frames = (_turn(flat.inverse()), rise, of_map[:2], *sensor, limits, spec, box)
        was_unknown, is_first = level.evidence[_inside(box)] == kernels.UNKNOWN, not level.is_begun
        cells = (level.evidence, level.heights, level.firm)
        changed = kernels.merge(
            window.kinds, window.tops, window.heights, window.origin, *frames, *cells, level.reaches
        )
        yaw = map_from_base.to_se2().yaw
        stance = (np.array([math.cos(yaw), math.sin(yaw)]), np.array([self._stance, *c.firm_limits, c.level_step]))
        kernels.stand(of_map, *stance, spec, box, *cells)
        doubted = beyond_low_edges(level)
        level.evidence[doubted], level.firm[doubted] = kernels.UNKNOWN, 0
        undone = np.count_nonzero(doubted[_inside(box)] & was_unknown)
        changed += np.count_nonzero(doubted) - 2 * undone
        if len(self.levels) == count and not is_first:  # that is on the level from which the robot comes, too
            self._leave_to_others(level, _inside(box), was_unknown)
        self.version += int(changed > 0)

    def remembered(self, map_from_odom: SE3, odom_from_base: SE3) -> F32:
        """Return the ground around a robot that is firm or was seen often, points float32 (N, 3) in odom; of levels above one another, that nearest to its height comes last."""
        c, (x, y, z) = self.config, (map_from_odom @ odom_from_base).translation
        corners = np.array([[x - c.remembered, y - c.remembered], [x + c.remembered, y + c.remembered]])
        found = [np.zeros((0, 3))]
        for level in self.levels:
            y0, y1, x0, x1 = _box(level.spec, corners).tolist()
            of_box = level.evidence[y0:y1, x0:x1]
            is_sure = (of_box >= kernels.GROUND_MOST) & (of_box != kernels.ASSUMED)
            iy, ix = np.nonzero(is_sure | ((level.firm[y0:y1, x0:x1] > 0) & (of_box > 0)))
            places = (np.column_stack((ix + x0, iy + y0)) + 0.5) * level.spec.resolution
            places += (level.spec.origin_x, level.spec.origin_y)
            found.append(np.column_stack((places, level.heights[y0:y1, x0:x1][iy, ix])))
        points = np.concatenate(found)
        points = points[np.argsort(-np.abs(points[:, 2] - z), kind="stable")]
        rise = float((map_from_odom @ odom_from_base).translation[2] - odom_from_base.translation[2])
        flat = map_from_odom.to_se2().inverse().transform(points[:, :2])
        return np.column_stack((flat, points[:, 2] - rise)).astype(np.float32)

    def occupancy(self, k: int) -> NDArray[np.int8]:
        """Return a level as a map, int8 [iy, ix]. Holes in it that another level knows as ground, as high as what is around them, are ground. Where another level goes on beyond the
        ground that both share, it is closed: nothing of this one is to be found there."""
        level, c = self.levels[k], self.config
        out = level.occupancy()
        reach = 2 * round(c.border / c.resolution) + 1
        around = np.ones((reach, reach), np.uint8)
        for other in self.levels:
            inner, of_other = common_cells(level.spec, other.spec)
            if other is level or inner is None:
                continue
            known, its = level.evidence[inner] != kernels.UNKNOWN, other.evidence[of_other]
            heights, its_heights = level.heights[inner], other.heights[of_other]
            ground = (level.evidence[inner] > 0) & np.isfinite(heights)
            shared = ground & (its > 0) & (np.abs(heights - its_heights) <= c.level_step)
            beyond = ~known & (cv2.dilate(shared.astype(np.uint8), around) > 0) & (its != kernels.UNKNOWN)
            high = cv2.dilate(np.where(ground, heights, -FAR), around)
            low = cv2.erode(np.where(ground, heights, FAR), around)
            is_hole = cv2.morphologyEx(ground.astype(np.uint8), cv2.MORPH_CLOSE, around) > 0
            goes_on = is_hole & (its > 0) & (its_heights <= high + c.step) & (its_heights >= low - c.step)
            out[inner][beyond & (out[inner] == OCC_UNKNOWN)] = OCC_OCCUPIED
            out[inner][~known & goes_on] = OCC_FREE
        return out

    def _choose(self, window: TerrainWindow, map_from_odom: SE2, rise: float, base: SE3) -> None:
        """Go to the level that a window belongs to: the wanted one where the robot stands on it, else the present one, unless it contradicts it and the ground below the
        robot is not on both: there, what speaks against a level is of the other one."""
        wanted = None if self.wanted == self.active else self.wanted
        if wanted is not None and wanted < len(self.levels):
            fits = self._agreement(wanted, window, map_from_odom, rise, base)
            if fits.is_on and (self._has_room(self.levels[wanted], base) or self._is_at_passage(wanted, base)):
                return self._go_to(wanted)
        here = self._agreement(self.active, window, map_from_odom, rise, base)
        is_off = here.same < self.config.level_cells and len(self.levels) > 1 and self.levels[self.active].is_begun
        if not here.is_contradicted and not is_off:
            if not self._way or math.dist(self._way[-1].translation, base.translation) > self.config.stride:
                self._way.append(base)
                self._meet_others(window, map_from_odom, rise, base)
            return None
        found = [(self._agreement(k, window, map_from_odom, rise, base), k) for k in range(len(self.levels))]
        if here.is_on and any(fit.is_on for fit, k in found if k != self.active):
            return None
        free = [(fit.same, k) for fit, k in found if not fit.is_contradicted and fit.is_on]
        if free:
            return self._go_to(max(free)[1])
        if here.is_on and self._is_of_others(here.other, window, map_from_odom, rise, base):
            return None
        if not here.is_contradicted or self._give_back(here.level_height, base):
            return None
        return self._found_level(window, map_from_odom, here.height, base)

    def _is_of_others(self, count: int, window: TerrainWindow, map_from_odom: SE2, rise: float, base: SE3) -> bool:
        """Say whether another level knows most of the `count` cells of a window that contradict the present one: a deck that is seen from the ramp."""
        level = self.level
        for other in self.levels:
            inner, of_other = common_cells(level.spec, other.spec)
            if other is level or inner is None:
                continue
            its = Level.empty(other.spec)
            is_apart = np.abs(level.heights[inner] - other.heights[of_other]) > 2.0 * self.config.level_step
            its.evidence[of_other][is_apart] = other.evidence[of_other][is_apart]
            its.heights[of_other][is_apart] = other.heights[of_other][is_apart]
            if self._agreement_with(its, window, map_from_odom, rise, base).same >= OF_OTHERS * count:
                return True
        return False

    def _meet_others(self, window: TerrainWindow, map_from_odom: SE2, rise: float, base: SE3) -> None:
        """Remember where the present level meets another one: whoever stands there is on both."""
        for k in range(len(self.levels)):
            place = base.to_se2()
            ways = [p.map_from_base for p in self.passages if (p.of_level, p.to_level) == (self.active, k)]
            if k == self.active or any(way.distance_to(place) < self.config.apart for way in ways):
                continue
            fits = self._agreement(k, window, map_from_odom, rise, base)
            if fits.is_on and fits.is_free and self._has_room(self.levels[k], base):
                self.passages += [Passage(self.active, k, place), Passage(k, self.active, place)]
                self.version += 1

    def _is_at_passage(self, to_level: int, base: SE3) -> bool:
        place, near = base.to_se2(), 0.5 * self.config.level_room
        ways = [p.map_from_base for p in self.passages if (p.of_level, p.to_level) == (self.active, to_level)]
        return any(way.distance_to(place) <= near for way in ways)

    def _has_room(self, other: Level, base: SE3) -> bool:
        """Say whether another level knows the ground of the present one all around a robot."""
        c, level = self.config, self.level
        inner, of_other = common_cells(level.spec, other.spec)
        if inner is None:
            return False
        ground = (level.evidence > 0) & level.around(base, c.level_room, c.level_step)
        its = (other.evidence[of_other] > 0) & (np.abs(other.heights[of_other] - level.heights[inner]) <= c.level_step)
        return bool((ground[inner] & its).sum() >= ROOM * ground.sum())

    def _give_back(self, height: float, base: SE3) -> bool:
        """Hand ground of the present level that lies at a height above or below the robot to the level that it belongs to: a deck that was seen from the ramp. Returns whether
        there is one: its own ground goes on there, and the robot has not stood on what is handed over."""
        c, level, x, y = self.config, self.level, *base.translation[:2]
        cells = level.joined(height, c.level_step, x, y, c.level_reach)
        for other in self.levels:
            inner, of_other = common_cells(level.spec, other.spec)
            if other is level or inner is None:
                continue
            is_its = (other.evidence[of_other] > 0) & (np.abs(other.heights[of_other] - height) <= c.level_step)
            only_here = cells.copy()
            only_here[inner] &= ~is_its
            reach = 2 * round(2.0 * c.border / c.resolution) + 1
            beside = cv2.dilate(is_its.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
            if (cells[inner] & beside).sum() >= c.level_cells and not (level.firm[only_here] > 0).any():
                level.give(only_here | (cells & level.around(base, c.level_reach, math.inf)), other)
                self.version += 1
                return True
        return False

    def _leave_to_others(self, level: Level, inner: tuple[slice, slice], is_new: NDArray[np.bool_]) -> None:
        """Forget what is new on a level and known at that height on another one: the upper deck, seen from the end of the ramp."""
        rows, columns = inner
        for other in self.levels:
            if other is level:
                continue
            diy, dix = level.spec.offset_in(other.spec)
            y0, y1 = max(rows.start, -diy), min(rows.stop, other.spec.height - diy)
            x0, x1 = max(columns.start, -dix), min(columns.stop, other.spec.width - dix)
            if y1 <= y0 or x1 <= x0:
                continue
            its = np.s_[y0 + diy : y1 + diy, x0 + dix : x1 + dix]
            of_box = np.s_[y0 - rows.start : y1 - rows.start, x0 - columns.start : x1 - columns.start]
            same = np.abs(level.heights[y0:y1, x0:x1] - other.heights[its]) <= self.config.level_step
            gone = is_new[of_box] & same & (other.evidence[its] != kernels.UNKNOWN)
            level.evidence[y0:y1, x0:x1][gone] = kernels.UNKNOWN
            level.heights[y0:y1, x0:x1][gone] = np.nan

    def _found_level(self, window: TerrainWindow, map_from_odom: SE2, height: float, base: SE3) -> None:
        """Begin another level at `height` with what the present one already holds of it, islands too: they were seen from here and are joined to nothing of the present one. The last place of the way that lies
        lower or higher is on both, as is the way from there; the present level keeps the ground around that place as far as the robot must stand on it, but nothing as high as the new one.
        Of the two that on which the robot began, however much was drawn into it since, has its number from then on, so that home stays on it."""
        c, old, level = self.config, self.active, self.level
        step, at, new = 0.5 * c.level_step, base.translation, Level.empty(level.spec)
        of_new = level.joined(height, step, at[0], at[1], c.level_reach) | level.islands(height, step, c.level_step)
        off = [abs(p.translation[2] - height) > step and math.dist(p.translation, at) > c.level_back for p in self._way]
        first = max(np.flatnonzero(off), default=len(self._way))
        on_both = [*self._way[first:], base]
        kept = level.ground_under(on_both[0], c.level_stand, c.level_step) & (np.abs(level.heights - height) > c.step)
        level.give(of_new & ~kept, new)
        for p in on_both:
            level.share(level.around(p, c.level_reach, c.level_step), new)
        self.levels.append(new)
        to = len(self.levels) - 1
        self._renumber({old: to}, lambda place: new.is_ground(place) and not level.is_ground(place))
        if self._start is not None and new.is_ground(self._start) and not level.is_ground(self._start):
            self.levels[old], self.levels[to] = new, level
            self._renumber({old: to, to: old})
            old, to = to, old
        place = on_both[0].to_se2()
        self.passages += [Passage(old, to, place), Passage(to, old, place)]
        self._go_to(to)

    def _renumber(self, number: dict[int, int], is_meant: Callable[[SE2], bool] = lambda _: True) -> None:
        """Give the passages that are meant the new numbers of their levels."""
        for k, p in enumerate(self.passages):
            if is_meant(p.map_from_base):
                of_level, to_level = number.get(p.of_level, p.of_level), number.get(p.to_level, p.to_level)
                self.passages[k] = Passage(of_level, to_level, p.map_from_base)

    def _go_to(self, level: int) -> None:
        """Take another level for the one that the robot is on."""
        self.active, self.wanted, self._way = level, None, []
        self.version += 1

    def _agreement(self, k: int, window: TerrainWindow, map_from_odom: SE2, rise: float, base: SE3) -> _Agreement:
        return self._agreement_with(self.levels[k], window, map_from_odom, rise, base)

    def _agreement_with(
        self, level: Level, window: TerrainWindow, map_from_odom: SE2, rise: float, base: SE3
    ) -> _Agreement:
        """Compare a window with a level."""
        c = self.config
        box = _box(level.spec, map_from_odom.transform(window.corners()))
        near = (np.array(base.translation[:2]), np.array([c.level_stand, c.level_reach]))
        frames = (_turn(map_from_odom.inverse()), rise, *near, _spec(level.spec), box, level.evidence, level.heights)
        found = kernels.agreement(window.kinds, window.heights, window.origin, *frames, c.level_step)
        close, same, other, height, level_height = found
        is_other = other >= c.level_cells and other >= c.level_share * (same + other)
        is_free = 3 * other < c.level_cells  # clearly, else a robot between two levels goes to and fro
        return _Agreement(
            int(same), int(other), bool(close >= c.level_cells), is_other, is_free, float(height), float(level_height)
        )

    def _begin(self, window: TerrainWindow, map_from_odom: SE2) -> None:
        """Begin a level around a window."""
        c = self.config
        low, high = _bounds(map_from_odom.transform(window.corners()), c.block)
        nx, ny = np.round((high - low) / c.resolution).astype(int).tolist()
        spec = GridSpec(c.resolution, nx, ny, float(low[0]), float(low[1]))
        self.levels.append(Level.empty(spec))

    def _grown(self, window: TerrainWindow, map_from_odom: SE2) -> Level:
        """Return the present level, with room for a window."""
        c, level = self.config, self.level
        low, high = _bounds(map_from_odom.transform(window.corners()), c.block)
        spec = level.spec
        first = np.minimum(low, (spec.origin_x, spec.origin_y))
        last = np.maximum(high, (spec.origin_x + spec.width * c.resolution, spec.origin_y + spec.height * c.resolution))
        nx, ny = np.round((last - first) / c.resolution).astype(int).tolist()
        grown = GridSpec(c.resolution, nx, ny, float(first[0]), float(first[1]))
        if grown.shape != spec.shape:
            level = self.levels[self.active] = level.grown(grown)
        return level


def _plane(odom_from_base: SE3) -> F64:
    """Return the plane on which a base stands: x, y, z and its rise along x and along y."""
    x, y, z = odom_from_base.translation
    up = odom_from_base.rotate((0.0, 0.0, 1.0))
    return np.array([x, y, z, -up[0] / max(up[2], 0.1), -up[1] / max(up[2], 0.1)])


def _carry_heights(window: TerrainWindow, plane: F64) -> None:
    """Give the blind cells of a window the heights of the plane on which the robot stands."""
    iy, ix = np.nonzero(window.kinds == kernels.BLIND)
    x = window.origin_x + (ix + 0.5) * window.cell - plane[0]
    y = window.origin_y + (iy + 0.5) * window.cell - plane[1]
    window.heights[iy, ix] = plane[2] + x * plane[3] + y * plane[4]


def _bounds(corners: F64, block: float) -> tuple[F64, F64]:
    """Return the box around corners, in whole blocks."""
    return np.floor(corners.min(axis=0) / block) * block, np.ceil(corners.max(axis=0) / block) * block


def _box(spec: GridSpec, corners: F64) -> NDArray[np.int64]:
    """Return the rows and columns (y0, y1, x0, x1) of a map around corners, those that it has."""
    cells = spec.cells_of(corners)
    low, high = np.maximum(cells.min(axis=0), 0), np.minimum(cells.max(axis=0) + 1, spec.shape)
    return np.array([low[0], max(low[0], high[0]), low[1], max(low[1], high[1])])


def _inside(box: NDArray[np.int64]) -> tuple[slice, slice]:
    """Return the rows and columns of a box as slices."""
    y0, y1, x0, x1 = box.tolist()
    return slice(y0, y1), slice(x0, x1)


def _spec(spec: GridSpec) -> F64:
    return np.array([spec.origin_x, spec.origin_y, spec.resolution])


def _turn(pose: SE2) -> F64:
    return np.array([math.cos(pose.yaw), math.sin(pose.yaw), pose.x, pose.y])
