"""Yielding: no motion passes from which the robot could not stand still for half a second before anybody who moves reaches it.

Each mover may go on, go on as he last walked, turn round, or turn towards the robot (who walks a bend does that, and who stands may set out
so, unless he was seen walking and has stood for a while: he goes on or back along his line; and not on if it was the robot that he stopped for); at every moment of the motion, and of the braking after it, the filled footprint keeps clear of all of them (passive safety, Bouraine,
Fraichard and Salhi 2012, with the half second by which a contact is judged). Whoever reaches a robot that stands, that creeps so slowly that it
stands at once, or that only moves away from him, is let come.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.movers import NOBODY, Movers
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel
from ambler.core.se2 import SE2
from ambler.core.units import Radians
from ambler.kernels.footprint import footprint_edges
from ambler.kernels.movers import outline_distance, starts_contact

F64 = NDArray[np.float64]
MOMENTS = 80  # of a motion that are looked at, at most


@dataclass(frozen=True, slots=True)
class YieldConfig:
    """Numbers of the yielding, SI.

    reach          metres within which movers matter
    radius         of a mover, with what his position is uncertain by
    growth         m/s by which that grows
    reaction       from the scan that shows a mover to the base obeying what follows from it
    hold           for which a command holds until the next one can replace it
    calm           seconds of standing before a contact that make it none of the robot's
    slow           m/s that do not count as moving towards somebody
    creep          m/s of the fastest corner of a robot that may go no faster: it stands within a centimetre, and a contact by less than
                   0.05 m/s is no collision
    least          m/s of the fastest corner that are worth going in company: below it the robot creeps, because what it would gain is less
                   than what a contact would cost
    step           seconds between the moments that are looked at
    scales         shares of a wanted velocity that are tried, the greatest first
    speed_min      below this a mover stands; he may walk again as he last did, or turn round
    setting_out    m/s at which anybody may come towards the robot, at least: who stood, and who is thought slow because he has just set out
    stood          seconds after which somebody who was seen walking before counts as standing, and goes on or back along his line: so many
                   radians to either side of it (`line`)
    stopped        metres from the outline of the robot within which who walked towards it and stands has stopped for it, if nobody else is within
                   `company` metres of him
    beside         metres within which who comes may walk into any side of the robot, not only towards its middle
    brake_share    share of the deceleration limits that is counted on
    speed_max, turn_max   m/s and rad/s in company: a robot that may have to stand half a second from now must not be fast
    patience       seconds of yielding that do not count as lack of progress
    evade_speed, evade_length, evade_seconds   m/s with which the robot gets out of somebody's way, by how many metres at most, and how long
                   ahead it sees him come
    evade_least    metres that are enough for that where they let him pass: in a corridor there is often no more room to the wall
    evade_gain     metres that it must gain by that
    """

    reach: float = 4.5
    radius: float = 0.33
    growth: float = 0.1
    reaction: float = 0.25
    hold: float = 0.1
    calm: float = 0.65
    slow: float = 0.03
    creep: float = 0.04
    least: float = 0.1
    step: float = 0.05
    scales: tuple[float, ...] = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15, 0.08)
    speed_min: float = 0.3
    setting_out: float = 1.2
    stood: float = 1.0
    line: Radians = 0.35
    stopped: float = 1.0
    company: float = 1.2
    beside: float = 2.0
    brake_share: float = 0.8
    speed_max: float = 0.5
    turn_max: Radians = 0.7
    patience: float = 30.0
    evade_speed: float = 0.4
    evade_length: float = 0.8
    evade_least: float = 0.2
    evade_seconds: float = 2.0
    evade_gain: float = 0.15


class Yielding:
    """Judges motions of one robot among movers. `set_movers` comes first, with the movers of now and where the robot is."""

    def __init__(self, config: YieldConfig, robot: RobotModel) -> None:
        self._config = config
        self._normals, self._offsets = footprint_edges(robot.footprint, 0.0)
        self._corners = np.ascontiguousarray(robot.footprint, np.float64)
        self._corner_places: list[tuple[float, float]] = [(x, y) for x, y in self._corners.tolist()]
        self._reach = config.reach + robot.circumscribed_radius
        lim, share = robot.limits, config.brake_share
        brakes = [share * lim.ax_brake, share * lim.ay_brake, share * lim.az_max]
        self._plan = np.array([config.reaction, config.hold, *brakes, config.calm, config.slow, config.step])
        (x0, y0), (x1, y1) = self._corners.min(axis=0), self._corners.max(axis=0)
        self._sides = np.array([[x0, 0.0], [x1, 0.0], [0.0, y0], [0.0, y1]])
        self.hypotheses = np.zeros((0, 6))
        """Where movers may go, float64 (H, 6) of (x, y, vx, vy, radius, growth) from now on, in the odom frame."""
        self._likely = self.hypotheses
        self._going_on = np.zeros((0, 4))
        sideways = ((0.0, -1.0), (0.0, 1.0)) if robot.drive is DriveKind.OMNI and lim.vy_max > 0.0 else ()
        self._ways_out = (*sideways, *(((-1.0, 0.0),) if lim.vx_min < 0.0 else ()), (1.0, 0.0))
        self._way_out = (0.0, 0.0)  # the one that it takes
        self._past = np.zeros((MOMENTS, 6))
        self._pose = np.zeros(3)
        self._now = np.zeros(3)

    @property
    def is_alone(self) -> bool:
        """Whether nobody who moves is near."""
        return len(self.hypotheses) == 0

    def set_movers(self, movers: Movers, odom_from_base: SE2, velocity: BodyVelocity) -> None:
        """Take the movers of now, and how the robot moves."""
        near = movers.near(odom_from_base, self._reach) if len(movers) else NOBODY
        self._pose = odom_from_base.as_array()
        self._now = np.array([velocity.vx, velocity.vy, velocity.wz])
        self._going_on = near.states[:, :4]
        self.hypotheses = self._hypotheses(near)
        self._likely = self._hypotheses(near, is_evading=True)

    def contact_in(self, wanted: BodyVelocity) -> float:
        """Return in how many seconds a velocity would start a contact, inf if in none."""
        return self._contact_in(wanted, self.hypotheses)

    def _contact_in(self, wanted: BodyVelocity, hypotheses: F64) -> float:
        if self.is_alone:
            return math.inf
        twist = np.array([wanted.vx, wanted.vy, wanted.wz])
        shape = (self._normals, self._offsets, self._corners, self._past)
        return float(starts_contact(self._pose, self._now, twist, self._plan, hypotheses, *shape))

    def refuses(self, wanted: BodyVelocity) -> bool:
        """Say whether even half of a velocity would start a contact, or is no more than creeping."""
        if self.is_alone or wanted == BodyVelocity():
            return False
        most = self._in_company(wanted)
        creep = self._config.creep / max(self._fastest(most), 1e-9)  # such a share of it is no more than creeping
        return all(
            scale <= creep or self._contact_in(_scaled(most, scale), self.hypotheses) < math.inf for scale in (1.0, 0.5)
        )

    def limited(self, wanted: BodyVelocity) -> BodyVelocity:
        """Return as much of a velocity, along the same arc, as starts no contact; nothing if that is hardly more than `creeping`."""
        if self.is_alone or wanted == BodyVelocity():
            return wanted
        c, most = self._config, self._in_company(wanted)
        for scale in c.scales:
            slower = _scaled(most, scale)
            if self._fastest(slower) < c.least:
                break
            if self.contact_in(slower) == math.inf:
                return slower
        return BodyVelocity()

    def _in_company(self, wanted: BodyVelocity) -> BodyVelocity:
        c = self._config
        fastest = max(math.hypot(wanted.vx, wanted.vy) / c.speed_max, abs(wanted.wz) / c.turn_max, 1.0)
        return wanted if fastest == 1.0 else _scaled(wanted, 1.0 / fastest)

    def creeping(self, wanted: BodyVelocity) -> BodyVelocity:
        """Return as much of a velocity, along the same arc, as moves no corner of the robot faster than what does not count; nothing if that
        leads closer still to somebody who stands at the robot."""
        if wanted == BodyVelocity():
            return wanted
        scale = min(1.0, self._config.creep / self._fastest(wanted))
        slower = _scaled(wanted, scale)
        at_rest = np.zeros((len(self._going_on), 6))
        at_rest[:, :2], at_rest[:, 4:] = self._going_on[:, :2], (self._config.radius, self._config.growth)
        return slower if self._contact_in(slower, at_rest) == math.inf else BodyVelocity()

    def is_waiting(self, sent: BodyVelocity) -> bool:
        """Say whether a robot that is sent so fast only waits for somebody: it stands or creeps."""
        return not self.is_alone and self._fastest(sent) <= self._config.creep + 1e-9

    def _fastest(self, velocity: BodyVelocity) -> float:
        """Return how fast (m/s) the fastest corner moves."""
        vx, vy, wz = velocity.vx, velocity.vy, velocity.wz
        return max(math.hypot(vx - wz * y, vy + wz * x) for x, y in self._corner_places)

    def evasion(self, free_slide: Callable[[float, float], float]) -> BodyVelocity:
        """Return a velocity straight out of the way of who is about to walk into a robot that stands; nothing if nobody is, or if there is
        nowhere to go. `free_slide(heading, length)` says how far the robot may slide along a heading of the odom frame, at most
        `length` metres, through what it has seen to be free; in a corridor that is as far as the wall."""
        c, stay = self._config, self._gap_after(BodyVelocity(), 0.0)
        best, chosen = stay + c.evade_gain, BodyVelocity()
        if stay > 0.0:
            return chosen
        before, self._way_out = self._way_out, (0.0, 0.0)
        for vx, vy in self._ways_out:
            goes_on = (vx, vy) == before  # what was begun is finished: the room is the less, the farther it has come
            wanted = BodyVelocity(vx * c.evade_speed, vy * c.evade_speed)
            free = free_slide(float(self._pose[2]) + math.atan2(vy, vx), c.evade_length)
            gap = self._gap_after(wanted, free)
            is_enough = free >= c.evade_length - 1e-6 or (free >= (0.0 if goes_on else c.evade_least) and gap > 0.0)
            is_better = gap > best or (goes_on and chosen == BodyVelocity() and gap > max(stay, 0.0))
            if is_enough and is_better and self._contact_in(wanted, self._likely) == math.inf:
                best, chosen, self._way_out = gap, wanted, (vx, vy)
        return chosen

    def _gap_after(self, wanted: BodyVelocity, length: float) -> float:
        """Return the least gap (m) to those who go on as they do while the robot moves so many metres straight, over the time that is looked ahead."""
        c, rows = self._config, self._going_on
        cos, sin = math.cos(self._pose[2]), math.sin(self._pose[2])
        vx, vy = cos * wanted.vx - sin * wanted.vy, sin * wanted.vx + cos * wanted.vy
        least, nearest = math.inf, np.empty(2)
        for t in np.arange(0.0, c.evade_seconds + 1e-9, 0.2):
            moved = min(float(t), length / c.evade_speed)
            place = SE2(self._pose[0] + vx * moved, self._pose[1] + vy * moved, self._pose[2]).inverse()
            for x, y in place.transform(rows[:, :2] + t * rows[:, 2:4]):
                gap = outline_distance(x, y, self._normals, self._offsets, self._corners, nearest)
                least = min(least, float(gap) - c.radius)
        return least

    def _hypotheses(self, movers: Movers, *, is_evading: bool = False) -> F64:
        """Return where movers may go; for a robot that gets out of their way, no faster than they walk: whoever follows it anywhere would
        leave it nowhere to go."""
        c = self._config
        if len(movers) == 0:
            return np.zeros((0, 6))
        targets = np.vstack((self._pose[None, :2], SE2(*self._pose).transform(self._sides)))
        rows = []
        for k, (x, y, vx, vy, wx, wy) in enumerate(movers.states):
            is_walking = math.hypot(vx, vy) >= c.speed_min
            if self._has_stood(movers, k):
                rows += [(x, y, *way, c.radius, c.growth) for way in self._along_his_line(movers.states, k)]
                continue
            ways = [(vx, vy), (-vx, -vy)] if is_walking else [(vx, vy), (wx, wy), (-wx, -wy)]
            speed = math.hypot(vx, vy) if is_walking else math.hypot(wx, wy)
            if not is_evading:  # who has just set out seems slow at first
                speed = max(math.hypot(vx, vy), math.hypot(wx, wy), c.setting_out)
            is_beside = not is_evading and math.dist((x, y), self._pose[:2]) < c.beside
            for to_x, to_y in (targets if is_beside else targets[:1]) - (x, y):
                away = max(1e-6, math.hypot(to_x, to_y))
                ways.append((speed * to_x / away, speed * to_y / away))
            rows += [(x, y, *way, c.radius, c.growth) for way in ways]
        return np.array(rows).reshape(-1, 6)

    def _has_stood(self, movers: Movers, k: int) -> bool:
        """Whether somebody was seen walking, and has stood since for a while."""
        (vx, vy, wx, wy), c = movers.states[k, 2:], self._config
        has_walked = math.hypot(wx, wy) >= c.speed_min > math.hypot(vx, vy)
        return has_walked and movers.rests is not None and movers.rests[k] >= c.stood

    def _along_his_line(self, states: F64, k: int) -> list[tuple[float, float]]:
        """Return at which velocities somebody who stands may set out: back along his line, and on along it unless the robot is what he stopped for."""
        c, (wx, wy) = self._config, states[k, 4:6]
        faster = max(1.0, c.setting_out / math.hypot(wx, wy))
        turns = [SE2(0.0, 0.0, angle).transform(faster * np.array([[wx, wy]]))[0] for angle in (-c.line, 0.0, c.line)]
        ways = [(0.0, 0.0), *((-u, -v) for u, v in turns)]
        return ways if self._has_stopped_for_robot(states, k) else [*ways, *((u, v) for u, v in turns)]

    def _has_stopped_for_robot(self, states: F64, k: int) -> bool:
        """Whether somebody who stands walked towards the robot and stopped right before it, with nobody else near who may have stopped him."""
        c, (x, y, _, _, wx, wy) = self._config, states[k]
        place, nearest = SE2(*self._pose).inverse().transform(np.array([[x, y]]))[0], np.empty(2)
        gap = (
            float(outline_distance(place[0], place[1], self._normals, self._offsets, self._corners, nearest)) - c.radius
        )
        to = SE2(*self._pose).transform(nearest[None])[0] - (x, y)
        is_towards = (wx * to[0] + wy * to[1]) >= 0.8 * math.hypot(wx, wy) * math.hypot(*to)
        others = np.delete(states[:, :2], k, axis=0) - (x, y)
        is_alone = bool((np.hypot(*others.T) > c.company).all())
        return is_alone and is_towards and 0.0 < gap < c.stopped


def _scaled(velocity: BodyVelocity, scale: float) -> BodyVelocity:
    return BodyVelocity(velocity.vx * scale, velocity.vy * scale, velocity.wz * scale)
