"""Global relocalization: where in the whole map is the robot? Branch and bound finds every pose that explains the scan, a second
viewpoint must confirm one of them before it is believed, and when several places look alike that is said.
"""

from __future__ import annotations

import copy
import enum
import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.core.units import Radians
from ambler.kernels import branch_bound
from ambler.kernels import likelihood_field as field_kernel
from ambler.kernels import relocalization as kernel
from ambler.localization.localizer import Observation
from ambler.localization.matcher import MatcherConfig, ScanMatcher
from ambler.localization.place_evidence import PlaceEvidence
from ambler.localization.surface_map import SurfaceMap

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RelocalizerConfig:
    """`cell`, `sigma`, `depth`: grid, smoothing (m) and levels of the search; `search_points` at most `range_most` metres away.
    `keep_ratio`: poses scoring less than this share of the best are not pursued. A pose is plausible with `accept` quality, and unique
    when no other comes nearer than `margin`. A viewpoint is new after `viewpoint_way` m or `viewpoint_turn` rad.
    Two views suffice for a pose of `sure_quality` that leads by `sure_margin`, or explains at least `sure_things` separate things more than each
    that comes nearer (`place_evidence`), and against which no place speaks by more than `moved_things`; in an old or crowded map it must lead as much and new searches
    of the whole map must come back to it `confirmations` times. Where no other place comes within `rival` of it, `confirmations_alone` are
    enough, or one for a pose of `sure_alone`. No place is believed that more than the share `contradicted_most` of what is seen, spot by spot, contradicts: then the
    map does not hold where the robot is, unless without any rival `held_confirmations` searches over `held_way` metres came back to a place of `sure_alone`: then it was
    changed, by up to `contradicted_held`; nor one from which, back along the last `past_way` metres, what was seen on them does not fit in the mean. Nothing found: wait `retry_after` s. `slack`: metres (at least 1.5 cells) between a return and the map's wall that count as the same."""

    cell: float = 0.1
    sigma: float = 0.12
    depth: int = 5
    search_points: int = 120
    range_most: float = 15.0
    keep_ratio: float = 0.85
    min_score: float = 0.45
    candidates: int = 16
    accept: float = 0.5
    margin: float = 0.08
    viewpoint_way: float = 0.3
    viewpoint_turn: Radians = 0.45
    sure_quality: float = 0.88
    sure_margin: float = 0.15
    sure_things: int = 4
    moved_things: int = 2
    confirmations: int = 3
    rival: float = 0.3
    sure_alone: float = 0.7
    confirmations_alone: int = 2
    contradicted_most: float = 0.27
    contradicted_held: float = 0.4
    held_confirmations: int = 8
    held_way: float = 3.0
    past_way: float = 8.0
    retry_after: float = 0.5
    slack: float = 0.12
    matcher: MatcherConfig = field(default_factory=MatcherConfig)


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A place where the robot could be: refined pose, covariance float64 (3, 3) in map axes, quality: share of explained returns
    minus twice the share that went through walls, in the mean of all `views` of it, which were made along `way` metres; how many of them found it anew in the whole map;
    and what they said of it."""

    map_from_base: SE2
    covariance: F64
    quality: float
    evidence: PlaceEvidence = field(default_factory=PlaceEvidence)
    views: int = 1
    confirmations: int = 0
    way: float = 0.0


class RelocalizationState(enum.Enum):
    """How far the search has come."""

    NOT_FOUND = "no place of the map explains the scan"
    VERIFYING = "one place explains the scan; another viewpoint must confirm it"
    AMBIGUOUS = "several places look alike; another viewpoint is needed"
    FOUND = "one place explains the scans from several viewpoints"


@dataclass(frozen=True, slots=True, eq=False)
class Relocalization:
    """State of the search and all places that are still possible, the best first. Only FOUND may be believed; with VERIFYING and
    AMBIGUOUS the robot must be moved, which needs permission."""

    stamp_ns: int
    state: RelocalizationState
    hypotheses: tuple[Hypothesis, ...]
    viewpoints: int

    @property
    def needs_movement(self) -> bool:
        return self.state in (RelocalizationState.VERIFYING, RelocalizationState.AMBIGUOUS)


class Relocalizer:
    """Searches one map. `update` takes observations until it answers FOUND; `reset` starts over."""

    def __init__(self, surface_map: SurfaceMap, config: RelocalizerConfig) -> None:
        self.map = surface_map
        self.config = config
        self._matcher = ScanMatcher(surface_map, config.matcher)
        spec = surface_map.spec
        factor = max(1, round(config.cell / spec.resolution))
        self._cell = factor * spec.resolution
        shape = (math.ceil(spec.height / factor), math.ceil(spec.width / factor))
        cells, self._free = np.empty(shape, np.uint16), np.empty(shape, np.bool_)
        kernel.score_cells(surface_map.distance, config.sigma, factor, cells)
        kernel.free_cells(surface_map.cells, factor, self._free)
        pad = (1 << (config.depth - 1)) - 1
        self._stack = np.empty((config.depth, shape[0] + pad, shape[1] + pad), np.uint8)
        branch_bound.build_stack(cells, self._stack)
        self._hypotheses: tuple[Hypothesis, ...] = ()
        self._viewpoints = 0
        self._odom_of_viewpoint = SE2()
        self._next_search_ns: int | None = None
        self._past: tuple[Observation, ...] = ()
        self._slack = max(config.slack, 1.5 * spec.resolution)

    def reset(self) -> None:
        """Forget all hypotheses, and what was seen on the way."""
        self._give_up(None)
        self._past = ()

    def _give_up(self, next_search_ns: int | None) -> None:
        self._hypotheses = ()
        self._viewpoints = 0
        self._next_search_ns = next_search_ns

    def fork(self) -> Relocalizer:
        """Return one with the same map and hypotheses and its own scratch memory, to search on another thread."""
        other = copy.copy(self)
        other._matcher = ScanMatcher(self.map, self.config.matcher)
        return other

    def is_due(self, observation: Observation) -> bool:
        """Say whether `update` would search, which takes long: at the first viewpoint, unless nothing was found a moment ago, and at each new one."""
        if self._viewpoints == 0:
            return self._next_search_ns is None or observation.stamp_ns >= self._next_search_ns
        motion = self._odom_of_viewpoint.inverse() @ observation.odom_from_base
        return (
            math.hypot(motion.x, motion.y) >= self.config.viewpoint_way or abs(motion.yaw) >= self.config.viewpoint_turn
        )

    def update(self, observation: Observation) -> Relocalization:
        """Search at the first viewpoint; at each new one search again and keep the places that explain all scans."""
        if not self.is_due(observation):
            if self._viewpoints == 0:
                return Relocalization(observation.stamp_ns, RelocalizationState.NOT_FOUND, (), 0)
            return self._answer(observation.stamp_ns)
        self._past = self._with_past(observation)
        if self._viewpoints == 0:
            self._hypotheses = self.search(observation.points_base)
            if self._hypotheses:
                self._viewpoints = 1
                self._odom_of_viewpoint = observation.odom_from_base
                self._hypotheses = tuple(self._with_view(h, observation) for h in self._hypotheses)
            return self._answer(observation.stamp_ns)
        motion = self._odom_of_viewpoint.inverse() @ observation.odom_from_base
        carried = self._carry(observation.points_base, motion)
        fresh = self.search(observation.points_base)
        if carried and fresh and is_same_place(carried[0].map_from_base, fresh[0].map_from_base, 0.3, 0.2):
            carried = (replace(carried[0], confirmations=carried[0].confirmations + 1), *carried[1:])
        self._hypotheses = tuple(self._with_view(h, observation) for h in self._combine(carried, fresh))
        self._viewpoints = self._viewpoints + 1 if self._hypotheses else 0
        self._odom_of_viewpoint = observation.odom_from_base
        return self._answer(observation.stamp_ns)

    def search(self, points_base: F32) -> tuple[Hypothesis, ...]:
        """Return every plausible place for one scan, the best first; a pure function of points float32 (N, 2) in the base frame."""
        config = self.config
        points = self._matcher.thin(points_base)
        ranges = np.hypot(points[:, 0], points[:, 1])
        near = points[(ranges < config.range_most) & (ranges > 0.3)]
        if len(near) < 20:
            return ()
        chosen = np.ascontiguousarray(_spread_evenly(near, config.search_points))
        reach = float(np.percentile(np.hypot(chosen[:, 0], chosen[:, 1]), 90))
        turns = math.ceil(2.0 * math.pi * max(reach, 2.0) / self._cell)
        angles = np.arange(turns) * (2.0 * math.pi / turns) - math.pi
        stride = 1 << (config.depth - 1)
        blocks = math.ceil(self._free.shape[0] / stride) * math.ceil(self._free.shape[1] / stride)
        best = np.empty((blocks * 8, 4), np.int64)
        min_sum = int(config.min_score * 255 * len(chosen))
        kernel.search(self._stack, self._free, self._cell, chosen, angles, 8, config.keep_ratio, min_sum, best)
        best = best[best[:, 0] >= 0]
        best = best[np.argsort(-best[:, 0], kind="stable")]
        best = best[best[:, 0] >= config.keep_ratio * best[0, 0]] if len(best) else best
        found: list[Hypothesis] = []
        for _, iy, ix, a in best[: 6 * config.candidates].tolist():
            spec = self.map.spec
            pose = SE2(spec.origin_x + (ix + 0.5) * self._cell, spec.origin_y + (iy + 0.5) * self._cell, angles[a])
            if any(is_same_place(pose, other.map_from_base, 0.3, 0.2) for other in found):
                continue
            hypothesis = self._judge(points, pose)
            if hypothesis is not None and hypothesis.quality > 0.5 * config.accept:
                found = [h for h in found if not is_same_place(h.map_from_base, hypothesis.map_from_base, 0.3, 0.2)]
                found.append(hypothesis)
            if len(found) >= config.candidates:
                break
        found.sort(key=lambda h: -h.quality)
        return tuple(h for h in found if found[0].quality - h.quality < config.rival)

    def quality_at(self, points_base: F32, pose: SE2) -> float:
        """Return the quality of a pose for one scan: share explained minus twice the share that went through walls."""
        counts = np.empty(3, np.int64)
        points = self._matcher.thin(points_base)
        field_kernel.contradictions(self.map.cells, self.map.frame, points, pose.as_array(), self._slack, counts)
        return float(counts[0] - 2.0 * counts[1]) / max(int(counts.sum()), 1)

    def _judge(self, points: F32, start: SE2, first_scale: float | None = None) -> Hypothesis | None:
        """Refine a pose by the scan and judge it; None when it leaves the start or the free space."""
        state = np.append(start.as_array(), 0.0)
        match = self._matcher.match(points, state[None], (0.3 * self.map.spec.resolution) ** 2, first_scale)
        pose = match.map_from_base
        if match.determined == 0 or pose.distance_to(start) > 0.5 or not self.map.is_free(pose):
            return None
        covariance = np.linalg.inv(match.information()[:3, :3] + np.diag([100.0, 100.0, 100.0]))
        return Hypothesis(pose, covariance + match.map_covariance()[:3, :3], self.quality_at(points, pose))

    def _carry(self, points_base: F32, motion: SE2) -> tuple[Hypothesis, ...]:
        """Move every hypothesis to the new viewpoint and judge it there; its quality is the mean of both views."""
        carried = []
        points = self._matcher.thin(points_base)
        for hypothesis in self._hypotheses:
            there = hypothesis.map_from_base @ motion
            judged = self._judge(points, there)
            allowed = 0.1 + 0.15 * math.hypot(motion.x, motion.y) + 0.2 * abs(motion.yaw)
            if judged is None or not is_same_place(there, judged.map_from_base, allowed, 0.1 + 0.15 * abs(motion.yaw)):
                continue
            views = hypothesis.views + 1
            mean = hypothesis.quality + (judged.quality - hypothesis.quality) / views
            if judged.quality >= self.config.accept - 0.1:
                way = hypothesis.way + math.hypot(motion.x, motion.y)
                known = hypothesis.evidence, views, hypothesis.confirmations, way
                carried.append(Hypothesis(judged.map_from_base, judged.covariance, mean, *known))
        carried.sort(key=lambda h: -h.quality)
        return tuple(carried)

    def _with_view(self, hypothesis: Hypothesis, observation: Observation) -> Hypothesis:
        """Add what a view says of a place, at the pose that is its own there."""
        return replace(hypothesis, evidence=self._seen_from(hypothesis.map_from_base, observation, hypothesis.evidence))

    def _seen_from(self, pose: SE2, observation: Observation, evidence: PlaceEvidence) -> PlaceEvidence:
        """Return the evidence with that of a view from a pose."""
        seen = observation.points_base
        points = np.array(seen[np.isfinite(seen).all(axis=1)], np.float32, order="C")
        labels = np.empty(len(points), np.int8)
        field_kernel.label_returns(self.map.cells, self.map.frame, points, pose.as_array(), self._slack, labels)
        return evidence.with_view(observation.odom_from_base.transform(points), labels)

    def _with_past(self, observation: Observation) -> tuple[Observation, ...]:
        """Return the views of the last `past_way` metres, the oldest first, with a new one if it is of a new viewpoint."""
        c, views = self.config, list(self._past)
        if views:
            motion = views[-1].odom_from_base.inverse() @ observation.odom_from_base
            if math.hypot(motion.x, motion.y) < c.viewpoint_way and abs(motion.yaw) < c.viewpoint_turn:
                return self._past
        views.append(observation)
        way = 0.0
        for k in range(len(views) - 1, 0, -1):
            way += views[k].odom_from_base.distance_to(views[k - 1].odom_from_base)
            if way > c.past_way:
                return tuple(views[k:])
        return tuple(views)

    def _may_have_come_to(self, place: Hypothesis) -> bool:
        """Say whether what was seen on the way to a place fits the map along it. A robot that the map does not hold sees, sooner or later, something that looks like a part of it
        for a few views; it did not look so before, on the way by which it would have come."""
        here, odom, qualities = place.map_from_base, self._odom_of_viewpoint, [place.quality]
        for view in reversed(self._past):
            here = here @ (odom.inverse() @ view.odom_from_base)
            odom = view.odom_from_base
            judged = self._judge(self._matcher.thin(view.points_base), here)
            qualities.append(0.0 if judged is None else judged.quality)
            if judged is not None and is_same_place(here, judged.map_from_base, 0.2, 0.1):
                here = judged.map_from_base
        return float(np.mean(qualities)) >= self.config.accept - 0.1

    def _is_followed(self, place: Hypothesis) -> bool:
        """Say whether search after search of the whole map came back to a place along a way on which what looks alike by chance would have ended."""
        return place.confirmations >= self.config.held_confirmations and place.way >= self.config.held_way

    def _is_alone(self) -> bool:
        """Say whether each other place comes much less near than the best and explains no several things instead, or explains several less; what speaks
        the other way is taken off. One thing may have been moved since the map was made; several were not, however many returns of long walls lead."""
        best, config = self._hypotheses[0], self.config
        for other in self._hypotheses[1:]:
            leads = best.quality - other.quality >= config.sure_margin
            (near, far), against = best.evidence.things_over(other.evidence), other.evidence.things_over(best.evidence)
            if 2 * near + far - 2 * against[0] - against[1] < (-config.moved_things if leads else config.sure_things):
                return False
        return True

    def _combine(self, carried: tuple[Hypothesis, ...], fresh: tuple[Hypothesis, ...]) -> tuple[Hypothesis, ...]:
        """Keep what was carried, unless the fresh search finds a clearly better place that nobody thought of before."""
        if not carried or not fresh:
            return carried if carried else fresh
        best = fresh[0]
        known = any(is_same_place(best.map_from_base, h.map_from_base, 0.3, 0.2) for h in carried)
        if not known and best.quality > carried[0].quality - self.config.margin:
            return tuple(sorted((*carried, best), key=lambda h: -h.quality))
        return carried

    def _answer(self, stamp_ns: int) -> Relocalization:
        config = self.config
        hypotheses, viewpoints = self._hypotheses, self._viewpoints
        if not hypotheses or hypotheses[0].quality < config.accept:
            self._give_up(stamp_ns + int(config.retry_after * 1e9))
            return Relocalization(stamp_ns, RelocalizationState.NOT_FOUND, hypotheses, viewpoints)
        best = hypotheses[0]
        lead = best.quality - (hypotheses[1].quality if len(hypotheses) > 1 else 0.0)
        is_sure = best.quality >= config.sure_quality and best.views >= 2
        times, has_rival = config.confirmations, any(best.quality - h.quality < config.rival for h in hypotheses[1:])
        if not has_rival:
            times = 1 if best.quality >= config.sure_alone else config.confirmations_alone
        is_confirmed = best.confirmations >= times
        is_held = not has_rival and best.quality >= config.sure_alone and self._is_followed(best)
        is_here = best.evidence.contradicted <= (config.contradicted_held if is_held else config.contradicted_most)
        if is_here and (is_sure or is_confirmed) and self._is_alone():
            if not self._may_have_come_to(best):
                self._past = self._past[(len(self._past) + 1) // 2 :]  # it may have been carried
                self._give_up(stamp_ns + int(config.retry_after * 1e9))
                return Relocalization(stamp_ns, RelocalizationState.NOT_FOUND, hypotheses, viewpoints)
            state = RelocalizationState.FOUND
        elif lead < config.margin:
            state = RelocalizationState.AMBIGUOUS
        else:
            state = RelocalizationState.VERIFYING
        return Relocalization(stamp_ns, state, hypotheses, viewpoints)


def is_same_place(a: SE2, b: SE2, way: float, turn: float) -> bool:
    """Say whether two poses are less than `way` metres and `turn` radians apart."""
    return a.distance_to(b) < way and abs(wrap_angle(a.yaw - b.yaw)) < turn


def _spread_evenly(points: F32, count: int) -> F32:
    """Choose about `count` points so that near walls, which many beams hit, do not outweigh far ones: one per cell of a coarse grid."""
    size = 0.1
    chosen = points
    while len(chosen) > count and size < 2.0:
        keys = np.floor(points / size).astype(np.int64)
        _, first = np.unique(keys[:, 0] * 100003 + keys[:, 1], return_index=True)
        chosen = points[np.sort(first)]
        size *= 1.2
    return chosen
