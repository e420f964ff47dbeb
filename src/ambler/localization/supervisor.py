"""Watches a localizer: is the pose still believable, and if not, find it again.

TRACKING → DEGRADED when the map explains too little of the scan for a moment → LOST when it stays so, when rays run through the
map's walls, when a search finds a place that fits much better, or when the pose jumps: particles that gather elsewhere are a guess like any
other → RELOCALIZING → TRACKING when a second viewpoint confirms.
While next to nothing returns, a robot that stands by its odometry stays DEGRADED: it cannot have driven elsewhere, but may have been carried, which the first scan
with returns tells; what spoke against the pose before is kept until then. One that moves and sees nothing at all is LOST.
People around the robot only hide walls (returns too near); a wrong pose also sees through them (returns too far).

Searching the map takes long. `update` does it at once; on a robot `step` answers immediately, `take_search` hands out the search as a
pure job for another thread, and `commit` takes its result, to be verified against what is seen by then.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels import likelihood_field as field_kernel
from ambler.localization.localizer import Estimate, Localizer, Observation
from ambler.localization.relocalizer import (
    Hypothesis,
    Relocalization,
    RelocalizationState,
    Relocalizer,
    is_same_place,
)
from ambler.localization.surface_map import SurfaceMap

F64 = NDArray[np.float64]


class LocalizationState(enum.Enum):
    """What may be done with the pose."""

    TRACKING = "the map explains what is seen"
    DEGRADED = "the map explains too little of what is seen; drive slowly"
    LOST = "the pose is not believed; stand still"
    RELOCALIZING = "searching the whole map; move only with permission"


@dataclass(frozen=True, slots=True)
class SupervisorConfig:
    """Shares of the returns: below `explained_good` DEGRADED; below `explained_least` or above `through_most` (seen through walls) for
    `lost_after` s LOST (where the map is old and more is usual, `through_rise` above the usual). While it is below the usual by `sudden_drop` a search runs every `search_every` s, then more seldom; a place
    better by `better_by`, and of `rival_quality`, means LOST; so does a pose that moves by more than `jump` (m, rad) beyond odometry and its own
    three sigma between two observations. Fewer than `seen_least` returns tell little, and a robot that odometry has moved by less than `rest` (m, rad) since
    there were more is at rest. `slack`: metres between a return and the map's wall that count as the same; `points`: returns judged."""

    explained_good: float = 0.6
    explained_least: float = 0.35
    through_most: float = 0.2
    through_rise: float = 0.15
    degraded_after: float = 0.3
    lost_after: float = 1.0
    sudden_drop: float = 0.12
    usual_rate: float = 0.02
    search_every: float = 1.0
    search_every_most: float = 16.0
    better_by: float = 0.25
    rival_quality: float = 0.7
    jump: tuple[float, float] = (0.5, 0.35)
    seen_least: int = 20
    rest: tuple[float, float] = (0.1, 0.1)
    slack: float = 0.15
    points: int = 240


@dataclass(frozen=True, slots=True, eq=False)
class Supervision:
    """State, the localizer's estimate (None before the first pose; not to be believed unless TRACKING or DEGRADED), the search if one
    runs, shares of returns explained and seen through walls, and one sentence for people."""

    stamp_ns: int
    state: LocalizationState
    estimate: Estimate | None
    relocalization: Relocalization | None
    explained: float
    through: float
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """What a job of `Supervisor.take_search` found: the relocalizer after it and its answer while lost, or, while the pose is only doubted,
    the best other place and the quality of the believed one. `series`: what was believed when it began."""

    observation: Observation
    series: int
    relocalizer: Relocalizer
    answer: Relocalization | None
    rival: Hypothesis | None = None
    here: float = 0.0


class Supervisor:
    """Owns a localizer and a relocalizer of the same map. Starts LOST unless the localizer was given a pose."""

    def __init__(
        self, surface_map: SurfaceMap, localizer: Localizer, relocalizer: Relocalizer, config: SupervisorConfig
    ) -> None:
        self.map = surface_map
        self.localizer = localizer
        self.relocalizer = relocalizer
        self.config = config
        self._state = LocalizationState.LOST if localizer.estimate is None else LocalizationState.TRACKING
        self._text = "no pose was given; searching the whole map"
        self._suspect_since_ns: int | None = None
        self._wrong_since_ns: int | None = None
        self._next_search_ns = 0
        self._search_pause = config.search_every
        self._usual, self._usual_through = 0.9, 0.0
        self._rival: SE2 | None = None
        self._wanted: Callable[[], Callable[[], SearchResult]] | None = None
        self._newest: Observation | None = None
        self._odom_when_seen: SE2 | None = None
        self._series = 0

    @property
    def state(self) -> LocalizationState:
        return self._state

    def trust(self) -> None:
        """Believe the localizer's pose again: a person has just set it."""
        self._enter(LocalizationState.TRACKING, "the pose was set by hand")
        self.relocalizer.reset()

    def distrust(self, reason: str) -> None:
        """Stop believing the pose and search the whole map."""
        self._enter(LocalizationState.LOST, reason)

    def update(self, observation: Observation) -> Supervision:
        """Track and judge, or search at once; returns what to believe."""
        seen = self.step(observation)
        work = self.take_search()
        return seen if work is None else (self.commit(work()) or seen)

    def step(self, observation: Observation) -> Supervision:
        """Track and judge without searching; returns what to believe. A search may be due then: `take_search`."""
        before, self._newest = self._newest, observation
        if self._state in (LocalizationState.TRACKING, LocalizationState.DEGRADED):
            return self._track(observation, before)
        return self._wait(observation)

    def take_search(self) -> Callable[[], SearchResult] | None:
        """Return the search that is due, if any, as a job that touches nothing of the supervisor's; one at a time, then `commit`."""
        wanted, self._wanted = self._wanted, None
        return None if wanted is None else wanted()

    def commit(self, result: SearchResult) -> Supervision | None:
        """Take the result of a search; returns what to believe now, None when the search is void because something else was decided since."""
        now = self._newest
        if result.series != self._series or now is None:
            return None
        if result.answer is None:
            return self._compare(result, now)
        self.relocalizer = result.relocalizer
        return self._take_answer(result.answer, result.observation, now)

    def _track(self, observation: Observation, before: Observation | None) -> Supervision:
        believed = self.localizer.estimate
        estimate = self.localizer.update(observation)
        if believed is not None and before is not None and believed.stamp_ns == before.stamp_ns:
            carried = believed.map_from_base @ (before.odom_from_base.inverse() @ observation.odom_from_base)
            if self._has_jumped(carried, believed.covariance, estimate.map_from_base):
                away = carried.distance_to(estimate.map_from_base)
                self._enter(LocalizationState.LOST, f"the pose jumped by {away:.1f} m without a motion")
                return Supervision(observation.stamp_ns, self._state, estimate, None, 0.0, 0.0, self._text)
        explained, through = self._judge(observation, estimate)
        config, now = self.config, observation.stamp_ns
        is_blind = np.isfinite(observation.points_base).all(axis=1).sum() < config.seen_least
        if not is_blind:
            self._odom_when_seen = observation.odom_from_base
        is_poor = is_blind or explained < config.explained_good
        is_suspect = is_poor or explained < self._usual - config.sudden_drop
        through_most = max(config.through_most, self._usual_through + config.through_rise)
        is_wrong = explained < min(config.explained_least, 0.6 * self._usual) or through > through_most
        self._suspect_since_ns = _since(self._suspect_since_ns, is_suspect, now)
        if not (is_blind and self._is_at_rest(observation)):
            self._wrong_since_ns = _since(self._wrong_since_ns, is_wrong, now)
        elif self._wrong_since_ns is not None and before is not None:
            self._wrong_since_ns += now - before.stamp_ns  # this time tells nothing
        if not is_suspect:
            self._usual += config.usual_rate * (explained - self._usual)
            self._usual_through += config.usual_rate * (through - self._usual_through)
            self._rival = None
            self._search_pause = config.search_every
        if self._wrong_since_ns is not None and now - self._wrong_since_ns >= config.lost_after * 1e9:
            why = f"the map explains {explained:.0%} of the scan, {through:.0%} of it runs through walls"
            self._enter(LocalizationState.LOST, why)
        elif self._suspect_since_ns is not None and now - self._suspect_since_ns >= config.degraded_after * 1e9:
            if is_blind:
                self._state, self._text = LocalizationState.DEGRADED, "next to nothing is seen"
            else:
                self._doubt(observation, estimate, explained, is_poor=is_poor)
        elif not is_suspect:
            self._state, self._text = LocalizationState.TRACKING, f"the map explains {explained:.0%} of the scan"
        return Supervision(now, self._state, estimate, None, explained, through, self._text)

    def _is_at_rest(self, observation: Observation) -> bool:
        """Whether odometry has not moved the robot since it last saw anything from the believed pose; False before it did."""
        seen = self._odom_when_seen
        return seen is not None and is_same_place(seen, observation.odom_from_base, *self.config.rest)

    def _has_jumped(self, carried: SE2, covariance: F64, told: SE2) -> bool:
        way, turn = self.config.jump
        way += 3.0 * math.sqrt(covariance[0, 0] + covariance[1, 1])
        turn += 3.0 * math.sqrt(covariance[2, 2])
        return not is_same_place(carried, told, way, turn)

    def _doubt(self, observation: Observation, estimate: Estimate, explained: float, *, is_poor: bool) -> None:
        """The scan fits worse than usual: is there a place that fits much better? Ask less often while the answer is no."""
        now = observation.stamp_ns
        self._state = LocalizationState.DEGRADED if is_poor else LocalizationState.TRACKING
        self._text = f"the map explains only {explained:.0%} of the scan, usual is {self._usual:.0%}"
        if now < self._next_search_ns:
            return
        self._next_search_ns = now + int(self._search_pause * 1e9)
        self._search_pause = min(1.5 * self._search_pause, self.config.search_every_most)
        self._wanted = lambda: self._begin_comparison(observation, estimate.map_from_base)

    def _begin_comparison(self, observation: Observation, believed: SE2) -> Callable[[], SearchResult]:
        relocalizer, series = self.relocalizer.fork(), self._series

        def compare() -> SearchResult:
            here = relocalizer.quality_at(observation.points_base, believed)
            places = relocalizer.search(observation.points_base)
            return SearchResult(observation, series, relocalizer, None, places[0] if places else None, here)

        return compare

    def _begin_search(self, observation: Observation) -> Callable[[], SearchResult]:
        relocalizer, series = self.relocalizer.fork(), self._series
        return lambda: SearchResult(observation, series, relocalizer, relocalizer.update(observation))

    def _compare(self, result: SearchResult, now: Observation) -> Supervision | None:
        """Is the best other place so much better than the believed one that the robot is lost?"""
        best, here, then = result.rival, result.here, result.observation
        estimate = self.localizer.estimate
        if best is None or best.quality < max(here + self.config.better_by, self.config.rival_quality):
            self._rival = None
            return None
        # One scan may deceive in an old map: a place must be much better twice, or better beyond doubt.
        is_clear = best.quality > here + 2.0 * self.config.better_by and best.quality > 0.9
        is_again = self._rival is not None and (self._rival @ then.odom_from_base).distance_to(best.map_from_base) < 0.5
        self._rival = best.map_from_base @ then.odom_from_base.inverse()
        if estimate is None or not (is_clear or is_again):
            return None
        away = (self._rival @ now.odom_from_base).distance_to(estimate.map_from_base)
        self._enter(LocalizationState.LOST, f"a place {away:.1f} m away explains the scan much better")
        return Supervision(now.stamp_ns, self._state, estimate, None, 0.0, 0.0, self._text)

    def _judge(self, observation: Observation, estimate: Estimate) -> tuple[float, float]:
        """Shares of returns that the map explains from the pose, and that went through its walls; (0, 0) without returns."""
        points = observation.points_base
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > self.config.points:
            points = points[np.linspace(0, len(points) - 1, self.config.points).astype(np.int64)]
        counts, slack = np.zeros(3, np.int64), max(self.config.slack, 1.5 * self.map.spec.resolution)
        pose = estimate.map_from_base.as_array()
        field_kernel.contradictions(
            self.map.cells, self.map.frame, np.array(points, np.float32, order="C"), pose, slack, counts
        )
        total = max(int(counts.sum()), 1)
        return float(counts[0]) / total, float(counts[1]) / total

    def _wait(self, observation: Observation) -> Supervision:
        """Lost: ask for a search when one is due."""
        text = self._text
        if self.relocalizer.is_due(observation):
            self._wanted = lambda: self._begin_search(observation)
            found = None
        else:
            found = self.relocalizer.update(observation)
            text = _describe(found)
        self._state, self._text = LocalizationState.RELOCALIZING, text
        return Supervision(observation.stamp_ns, self._state, self.localizer.estimate, found, 0.0, 0.0, text)

    def _take_answer(self, found: Relocalization, then: Observation, now: Observation) -> Supervision:
        """Believe a place that was found if what is seen now, a little farther on, is explained there too."""
        text = _describe(found)
        self._state, self._text = LocalizationState.RELOCALIZING, text
        if found.state is RelocalizationState.FOUND:
            best = found.hypotheses[0]
            pose = best.map_from_base @ then.odom_from_base.inverse() @ now.odom_from_base
            if self.relocalizer.quality_at(now.points_base, pose) >= self.relocalizer.config.accept - 0.1:
                return self._believe(found, now, pose, best.covariance + np.diag([4e-4, 4e-4, 1e-4]))
            self._text = text = "the place that was found does not explain what is seen now"
            self.relocalizer.reset()
        return Supervision(now.stamp_ns, self._state, self.localizer.estimate, found, 0.0, 0.0, text)

    def _believe(self, found: Relocalization, now: Observation, pose: SE2, covariance: F64) -> Supervision:
        self.localizer.set_pose(now.stamp_ns, now.odom_from_base, pose, covariance)
        estimate = self.localizer.update(now)
        self._enter(LocalizationState.TRACKING, _describe(found))
        self._odom_when_seen = now.odom_from_base
        self.relocalizer.reset()
        explained, through = self._judge(now, estimate)
        self._usual, self._usual_through = explained, through
        return Supervision(now.stamp_ns, self._state, estimate, found, explained, through, self._text)

    def _enter(self, state: LocalizationState, text: str) -> None:
        self._state, self._text, self._rival, self._wanted = state, text, None, None
        self._odom_when_seen = None
        self._series += 1  # searches that were begun before are void
        self._suspect_since_ns = self._wrong_since_ns = None
        self._search_pause, self._next_search_ns = self.config.search_every, 0
        if state is LocalizationState.LOST:
            self.relocalizer.reset()


def _describe(found: Relocalization) -> str:
    return f"{found.state.value} ({len(found.hypotheses)} possible)"


def _since(since_ns: int | None, is_so: bool, now_ns: int) -> int | None:
    """Return since when a condition holds without a break, None while it does not."""
    if not is_so:
        return None
    return now_ns if since_ns is None else since_ns
