"""One person or whatever else moves: where, how fast, and whether to believe it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2

F64 = NDArray[np.float64]
NOTHING = np.zeros((0, 2))
HIDDEN = 0.25  # seconds without a measurement after which somebody who stood is taken to stand


@dataclass(frozen=True, slots=True)
class MoverConfig:
    """Numbers of the tracker, SI.

    reach           metres from a scanner within which movers are looked for: 2 s of a person and a robot who approach each other
    resolution      side of a cell; below half a person, above the noise of ranges
    age             seconds for which a cell may be occupied and still count as reached by something that moves: a person of 0.5 m who
                    walks at 0.7 m/s is past a place by then
    link            metres between neighbouring points of one group
    min_points      points of a group: a person at the end of the reach shows more
    size_max        metres across a group; a larger one is no single person, one of up to `pair_size_max` two side by side
    new_share       of the points that somebody who is known shows, at least, lie where nothing ever stood, even when he leans on a wall
    to_middle       metres from the mean of the visible side of a person to the middle
    gate            metres from a track's prediction within which a group may be its own
    alpha, beta     the gains that the fit fades to
    confirmed       measurements after which a track is believed, if it has moved by `way` metres and nothing stands within `vacated` metres
                    of where it began: a wall that comes into sight piece by piece leaves its first piece behind
    close           metres from a scanner within which `close_confirmed` measurements and `close_way` metres are enough: there is no time for
                    more, and walls that come into sight piece by piece lie farther off
    stand_size      metres across what stands where the room was seen free, for it to be somebody who may set out: less is a leg of a table that
                    rays met late
    stand_bulge     standard deviation (m) of such a one's points across their line, at least: pieces of walls are straight
    stand_confirmed measurements after which such a one is believed
    headless        metres from a scanner within which the head of whoever stands there may be above all rays, if what they meet goes up to
                    `headroom` metres below the scanner
    twin            metres between two tracks that are one and the same person's
    hidden          metres from a direction that falls silent (`perception.silent_sectors`) within which somebody who is tracked may have stepped
                    nearer to the scanner than it sees, and within which he is expected again
    coast           seconds for which a track that nobody sees goes on
    hides           seconds without a measurement after which nobody vouches for it that a direction that falls silent hides him
    unknown         seconds after a correction that made the room unknown in which what comes into sight where somebody is expected is he
    speed_max       faster than this nobody walks, m/s; below `speed_min` he counts as standing
    still           seconds after which somebody who has not moved by `way` is an obstacle like others, until he does: what is no person at all
                    (a post that came into sight behind glass) would be yielded to for ever; `still_walker` for who has gone `walked` metres
    """

    reach: float = 5.5
    resolution: float = 0.1
    age: float = 0.7
    link: float = 0.25
    min_points: int = 3
    size_max: float = 0.7
    pair_size_max: float = 1.3
    new_share: float = 0.25
    to_middle: float = 0.15
    gate: float = 0.5
    alpha: float = 0.5
    beta: float = 0.2
    confirmed: int = 3
    way: float = 0.3
    vacated: float = 0.15
    close: float = 1.6
    close_confirmed: int = 2
    close_way: float = 0.1
    stand_size: float = 0.25
    stand_bulge: float = 0.04
    stand_confirmed: int = 3
    headless: float = 1.0
    headroom: float = 0.1
    twin: float = 0.25
    hidden: float = 0.8
    coast: float = 0.8
    hides: float = 15.0
    unknown: float = 2.0
    speed_max: float = 2.0
    speed_min: float = 0.3
    still: float = 10.0
    still_walker: float = 60.0
    walked: float = 1.0


class MoverTrack:
    """One mover: position and velocity, when it was last measured, and how often."""

    def __init__(self, place: F64, now: float, *, stands: bool = False) -> None:
        self.place, self.velocity, self.walk = place, np.zeros(2), np.zeros(2)
        self.born, self.seen, self.at, self.measured = place, now, now, now
        self.count = 1
        self.is_mover = self.has_walked = False
        self.stands = stands
        self.surface = NOTHING
        """What was hit of him when he stood, float64 (N, 2)."""
        self.rest, self.resting_since = place, now

    def move(self, new_from_old: SE2) -> None:
        """Take on another frame."""
        self.place, self.born, self.rest = new_from_old.transform(np.stack((self.place, self.born, self.rest)))
        self.velocity, self.walk = SE2(0.0, 0.0, new_from_old.yaw).transform(np.stack((self.velocity, self.walk)))
        self.surface = new_from_old.transform(self.surface)

    def predicted(self, now: float) -> F64:
        return self.place + self.pace(now) * (now - self.at)

    def pace(self, now: float) -> F64:
        """Return his velocity: who stood before he was hidden stands."""
        is_hidden = len(self.surface) > 0 and now - self.seen > HIDDEN
        return np.zeros(2) if is_hidden else self.velocity

    def halt(self, now: float) -> None:
        """Take him to have stopped where he was last measured."""
        self.velocity, self.at = np.zeros(2), now

    def hide(self, place: F64, now: float, config: MoverConfig) -> None:
        """Take him to stand at a place where no ray meets him."""
        self.place, self.velocity, self.surface = place, np.zeros(2), NOTHING
        self.at = self.seen = now
        self.is_mover = self.has_walked = True
        if math.dist(place, self.rest) > config.way:
            self.rest, self.resting_since = place, now

    def measure(self, place: F64, now: float, config: MoverConfig, points: F64, starts: F64) -> None:
        """Take a place; `points` (N, 2) are all that the scan hit, from `starts`."""
        self.count += 1
        k, dt = self.count, now - self.at
        alpha = max(config.alpha, 2.0 * (2 * k - 1) / (k * (k + 1)))
        beta = max(config.beta, 6.0 / (k * (k + 1)))
        rest = place - self.predicted(now)
        self.place = self.predicted(now) + alpha * rest
        if dt > 0.0:
            self.velocity = self.velocity + beta * rest / dt
        speed = math.hypot(*self.velocity)
        if speed > config.speed_max:
            self.velocity = self.velocity * (config.speed_max / speed)
        self.at = self.seen = self.measured = now
        is_close = float(np.hypot(*(starts - self.place).T).min()) < config.close
        enough, way = (config.close_confirmed, config.close_way) if is_close else (config.confirmed, config.way)
        moved = math.dist(self.place, self.rest)
        if moved > config.way or (moved > way and speed > config.speed_min):
            self.rest, self.resting_since = self.place, now
        if not self.is_mover and self.count >= enough and math.dist(self.place, self.born) >= way:
            self.is_mover = not (np.hypot(*(points - self.born).T) < config.vacated).any()
        if self.stands and self.count >= config.stand_confirmed:
            self.is_mover = True
        self.has_walked |= self.is_mover and math.dist(self.place, self.born) >= config.walked
        if self.is_mover and speed >= max(config.speed_min, 0.8 * math.hypot(*self.walk)):
            self.walk = self.velocity
