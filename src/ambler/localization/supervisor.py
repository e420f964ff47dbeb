"""Watches a localizer: is the pose still believable, and if not, find it again.

TRACKING → DEGRADED when the map explains too little of the scan for a moment → LOST when it stays so, when rays run through the
map's walls, or when a search finds a place that fits much better → RELOCALIZING → TRACKING when a second viewpoint confirms.
People around the robot only hide walls (returns too near); a wrong pose also sees through them (returns too far).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from ambler.core.se2 import SE2
from ambler.kernels import likelihood_field as field_kernel
from ambler.localization.localizer import Estimate, Localizer, Observation
from ambler.localization.relocalizer import Relocalization, RelocalizationState, Relocalizer
from ambler.localization.surface_map import SurfaceMap


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
    better by `better_by`, and of `rival_quality`, means LOST. `slack`: metres between a return and the map's wall that count as the same; `points`: returns judged."""

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
        """Track and judge, or search; returns what to believe."""
        if self._state in (LocalizationState.TRACKING, LocalizationState.DEGRADED):
            return self._track(observation)
        return self._search(observation)

    def _track(self, observation: Observation) -> Supervision:
        estimate = self.localizer.update(observation)
        explained, through = self._judge(observation, estimate)
        config, now = self.config, observation.stamp_ns
        is_poor = explained < config.explained_good
        is_suspect = is_poor or explained < self._usual - config.sudden_drop
        through_most = max(config.through_most, self._usual_through + config.through_rise)
        is_wrong = explained < min(config.explained_least, 0.6 * self._usual) or through > through_most
        self._suspect_since_ns = _since(self._suspect_since_ns, is_suspect, now)
        self._wrong_since_ns = _since(self._wrong_since_ns, is_wrong, now)
        if not is_suspect:
            self._usual += config.usual_rate * (explained - self._usual)
            self._usual_through += config.usual_rate * (through - self._usual_through)
            self._rival = None
            self._search_pause = config.search_every
        if self._wrong_since_ns is not None and now - self._wrong_since_ns >= config.lost_after * 1e9:
            why = f"the map explains {explained:.0%} of the scan, {through:.0%} of it runs through walls"
            self._enter(LocalizationState.LOST, why)
        elif self._suspect_since_ns is not None and now - self._suspect_since_ns >= config.degraded_after * 1e9:
            self._doubt(observation, estimate, explained, is_poor=is_poor)
        elif not is_suspect:
            self._state, self._text = LocalizationState.TRACKING, f"the map explains {explained:.0%} of the scan"
        return Supervision(now, self._state, estimate, None, explained, through, self._text)

    def _doubt(self, observation: Observation, estimate: Estimate, explained: float, *, is_poor: bool) -> None:
        """The scan fits worse than usual: is there a place that fits much better? Ask less often while the answer is no."""
        now = observation.stamp_ns
        self._state = LocalizationState.DEGRADED if is_poor else LocalizationState.TRACKING
        self._text = f"the map explains only {explained:.0%} of the scan, usual is {self._usual:.0%}"
        if now < self._next_search_ns:
            return
        self._next_search_ns = now + int(self._search_pause * 1e9)
        self._search_pause = min(1.5 * self._search_pause, self.config.search_every_most)
        here = self.relocalizer.quality_at(observation.points_base, estimate.map_from_base)
        places = self.relocalizer.search(observation.points_base)
        best = places[0] if places else None
        if best is None or best.quality < max(here + self.config.better_by, self.config.rival_quality):
            self._rival = None
            return
        # One scan may deceive in an old map: a place must be much better twice, or better beyond doubt.
        is_clear = best.quality > here + 2.0 * self.config.better_by and best.quality > 0.9
        is_again = (
            self._rival is not None and (self._rival @ observation.odom_from_base).distance_to(best.map_from_base) < 0.5
        )
        self._rival = best.map_from_base @ observation.odom_from_base.inverse()
        if is_clear or is_again:
            away = best.map_from_base.distance_to(estimate.map_from_base)
            self._enter(LocalizationState.LOST, f"a place {away:.1f} m away explains the scan much better")

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

    def _search(self, observation: Observation) -> Supervision:
        found = self.relocalizer.update(observation)
        text = f"{found.state.value} ({len(found.hypotheses)} possible)"
        self._state, self._text = LocalizationState.RELOCALIZING, text
        if found.state is RelocalizationState.FOUND:
            best = found.hypotheses[0]
            covariance = best.covariance + np.diag([4e-4, 4e-4, 1e-4])
            self.localizer.set_pose(observation.stamp_ns, observation.odom_from_base, best.map_from_base, covariance)
            estimate = self.localizer.update(observation)
            self._enter(LocalizationState.TRACKING, text)
            self.relocalizer.reset()
            explained, through = self._judge(observation, estimate)
            self._usual, self._usual_through = explained, through
            return Supervision(observation.stamp_ns, self._state, estimate, found, explained, through, text)
        return Supervision(observation.stamp_ns, self._state, self.localizer.estimate, found, 0.0, 0.0, text)

    def _enter(self, state: LocalizationState, text: str) -> None:
        self._state, self._text, self._rival = state, text, None
        self._suspect_since_ns = self._wrong_since_ns = None
        self._search_pause, self._next_search_ns = self.config.search_every, 0
        if state is LocalizationState.LOST:
            self.relocalizer.reset()


def _since(since_ns: int | None, is_so: bool, now_ns: int) -> int | None:
    """Return since when a condition holds without a break, None while it does not."""
    if not is_so:
        return None
    return now_ns if since_ns is None else since_ns
