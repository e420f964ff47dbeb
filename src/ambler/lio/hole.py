"""After a hole in all measurements: where in the own map is the body now?

Nobody knows what it did meanwhile. A filter of its own follows the scans since, as it does for who begins in motion, and lays them together in a level frame; that is looked for in
the map around where the body went, as far as it may have come and turned. It counts where one place stands out in two sights; until then there is no pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import wrap_angle
from ambler.core.se3 import SE3
from ambler.lio.cloud_map import CloudMap
from ambler.lio.cloud_match import CloudMatch, apart
from ambler.lio.cloud_relocalizer import CloudRelocalizer, CloudSearch, CloudState
from ambler.lio.config import LioConfig
from ambler.lio.health import LioResult
from ambler.lio.state import FilterState

F64 = NDArray[np.float64]


@dataclass(slots=True)
class Hole:
    """Nobody knows what happened from `begin` to `end` (seconds of the filter). `scans` came since then until its place `is_regained`; `text` says how far the search has come."""

    begin: float
    end: float
    scans: int = 0
    is_regained: bool = False
    text: str = CloudState.GATHERING.value


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """Where a body may be: about `map_from_imu`, within `way` m and `turn` rad."""

    map_from_imu: SE3
    way: float
    turn: float


def whereabouts(
    was: FilterState, rate: float, length: float, since: FilterState, seconds: float, turned: float, config: LioConfig
) -> Whereabouts:
    """Return where a body may be that `was` somewhere and turned at `rate` (rad/s about the vertical) before a hole of `length` s, and that in the `seconds` since has `turned` (rad) and
    moves as `since` says in a level frame of its own."""
    c = config.hole
    yaw = was.map_from_imu.to_se2().yaw + turned
    other = SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, yaw - since.map_from_imu.to_se2().yaw)
    moved = length * was.velocity + seconds * other.transform(since.velocity[None])[0]
    x, y, z = (was.position + moved).tolist()
    way = c.way_least + max(c.speed_more, float(np.linalg.norm(was.velocity))) * length
    turn = c.turn_least + (c.rate_more + abs(rate)) * length
    return Whereabouts(SE3.from_rpy((x, y, z), 0.0, 0.0, yaw), way, min(turn, np.pi))


class PlaceSearch:
    """Give it the results since the hole until it tells where they are in the map of `points` (N, 3)."""

    def __init__(self, points: NDArray[np.floating], about: Whereabouts, config: LioConfig) -> None:
        self.state = CloudState.NOT_FOUND
        self._config, self._about = config.hole, about
        self._margin = config.localize.relocalizer.margin
        self._relocalizer: CloudRelocalizer | None = None
        self._first = SE3()
        self._way = 0.0
        self._at: SE3 | None = None
        self._told: SE3 | None = None
        self._searched: CloudSearch | None = None
        local = config.localize
        try:
            own = CloudMap(points, local.map, "the own map")
        except BadInputError:
            return  # too little of it to find anything in
        is_near = about.way <= self._config.way_most
        self._near = replace(local.relocalizer, guess_way=about.way, guess_turn=about.turn)
        self._relocalizer = CloudRelocalizer(own, self._near, local.match, about.map_from_imu if is_near else None)

    def update(self, result: LioResult) -> SE3 | None:
        """Take a result of the filter that follows; returns map_from_its_map once it is sure."""
        if self._relocalizer is None:
            return None
        self._move(self._relocalizer, result.map_from_imu)
        search = self._relocalizer.update(result)
        if search is self._searched or search.state is CloudState.GATHERING:
            return None
        self._searched, self.state = search, search.state
        before, self._told = self._told, None
        places = tuple(match for match in search.matches if self._is_within(match, search.odom_from_local))
        self.state, _ = self._relocalizer.state_of(places)
        if self.state is not CloudState.VERIFYING:
            return None
        if not stands_out(places, self._margin):
            self.state = CloudState.AMBIGUOUS
            return None
        self._told = places[0].map_from_local @ search.odom_from_local.inverse()
        if before is None:
            return None
        way, turn = apart(before, self._told)
        is_same = way < self._config.same_way and turn < self._config.same_turn
        return self._told if is_same else None

    def _move(self, relocalizer: CloudRelocalizer, pose: SE3) -> None:
        """Widen the window by where a body goes that may have been turned."""
        if self._at is None:
            self._first = self._at = pose
        self._way += apart(self._at, pose)[0]
        self._at = pose
        beside = 2.0 * np.sin(0.5 * self._about.turn) * self._way
        relocalizer.config = replace(self._near, guess_way=self._about.way + beside)

    def _is_within(self, match: CloudMatch, odom_from_local: SE3) -> bool:
        """Say whether it was where it may have been when the search began."""
        about, began = self._about, match.map_from_local @ odom_from_local.inverse() @ self._first
        if about.way > self._config.way_most:
            return True
        turn = abs(wrap_angle(began.to_se2().yaw - about.map_from_imu.to_se2().yaw))
        slack = self._config.way_least
        return apart(about.map_from_imu, began)[0] <= about.way + slack and turn <= about.turn + 0.1


def stands_out(matches: tuple[CloudMatch, ...], margin: float) -> bool:
    """Say whether the first explains clearly more than all others. In a map of a moment ago nothing was moved: how tightly walls fit there tells no two places apart."""
    shares = [match.walls - 2.0 * match.blocked for match in matches]
    return all(shares[0] - share >= margin for share in shares[1:])
