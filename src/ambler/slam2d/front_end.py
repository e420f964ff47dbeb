"""Local SLAM: predict, correlate, refine against the older active submap, insert when the robot has moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.registration.branch_bound import BranchBoundMatcher, search_coarse_to_fine
from ambler.registration.correlative import Window, correlate
from ambler.registration.gauss_newton import MatchResult, RefineConfig, refine, translational
from ambler.registration.line_field import LineFit
from ambler.registration.planar_scan import PlanarScan, filter_voxels_adaptively, points_between_returns
from ambler.registration.seen_by_both import contradiction
from ambler.slam2d.config import FrontEndConfig
from ambler.slam2d.extrapolator import SAME_INSTANT_NS, Prediction
from ambler.slam2d.submaps import ActiveSubmaps, Submap

F32 = NDArray[np.float32]

SEARCH_WEIGHTS = 0.5, 0.5  # 1/m, 1/rad: what a place farther from the prediction loses of its score
MOST = 0.5  # of the points lie on walls where a scan is found again; fewer do in many places of a window that wide
LOST_DEPTH = 4  # of the stack in which a scan is sought that fits nowhere near
USUAL_RATE = 0.05  # of what one match counts in what is usual, which begins with the first one
FIRST_MATCHES = 10  # in which steady motion is tried beside odometry, even where that is trusted
YOUNG_SCANS = 5  # of a submap: before, its lines may hold few of the points
YOUNG_SHARE = 0.2  # of the points on lines, from which on these tell what the place does not tell
YOUNG_TELLING = 0.05  # `telling` there
POINTS_LEAST = 10  # of a scan that is matched or inserted
ANOTHER_SCANNER = 0.01  # metres between two scanners of a base
START_SCANS = 10  # that a base which still stands where it began lays on one another: the frame of the map is not that of one noisy scan
LED_APART = 0.02  # metres between where cells found a scan and where odometry leads, from which on lines are asked which is right
LED_LEAST, LED_SHARE = 0.03, 0.25  # of the points on lines where odometry leads: least, and beside where cells found it
LED_RESIDUAL = 1.5  # times as far from lines as there, at most
BEGUN_WAY = 3.0  # metres of a submap, before which it may show spots on walls instead of walls
LEAP = 0.5  # metres between two scans, more than which odometry is not followed against a match
HELD_BACK = 0.5  # of the way that odometry tells, less than which a match of a submap just begun may be held back
HELD_INLIERS = 0.95  # of the best share of points on walls, with more of which it is right all the same
STILL_MOTION = (
    1e-3,
    5e-4,
)  # metres and rad between two scans below which a base stands: gyroscopes drift by a tenth of it

STILL_MATCH = (0.02, 0.005)  # metres and rad that the match of a single scan with a single scan may be off


@dataclass(frozen=True, slots=True, eq=False)
class LocalResult:
    """One scan in the local frame. `match` is None for the first scan and for scans without points; `submaps` took the scan. `doubt` (m, rad) is the standard
    deviation of a pose that little of the scan speaks for, (0, 0) where it fits as scans usually do. `line_share` is the share of its points on lines of the submap, where these were asked."""

    local_from_base: SE2
    match: MatchResult | None
    scan: PlanarScan
    match_points: F32
    submaps: list[Submap]
    finished: Submap | None
    doubt: tuple[float, float] = (0.0, 0.0)
    line_share: float | None = None


class FrontEnd:
    """Local SLAM of Cartographer (Hess, Kohler, Rapp and Andor, ICRA 2016, section IV): `update` is its one step per scan.

    What the paper does not have stands in steps of its own: the last step of a match, onto the lines of the submap (`LineField`); odometry that is doubted (`_judge_odometry`, `_steady_match`), and a match
    that is unusually bad (`_rescued_match`, `_found_again`). Knows nothing of the global frame.
    """

    def __init__(self, config: FrontEndConfig) -> None:
        self._config = config
        self.active = ActiveSubmaps(
            *(config.insertion, config.scans_per_submap, config.distance_per_submap, config.motion_distance),
            lines=config.lines,
        )
        self._inserted: tuple[int, SE2] | None = None
        self._inserted_origin = (0.0, 0.0)
        self._stands_at_start, self._scans_at_start = True, 0
        self._matches = 0
        self._usual_score = 0.0
        self._usual_inliers = self._best_inliers = 0.0
        self.odometry_error = 0.0
        self._line_share: float | None = None

    def update(self, scan: PlanarScan, prediction: Prediction, *, may_insert: bool = True) -> LocalResult:
        """Match one scan near its prediction and insert it when the robot has moved, if it may be."""
        config, target = self._config, self.active.target
        scan = scan.thinned(config.voxel_size, picks_middle=config.picks_middle)
        sizes = (config.match_max_voxel, config.match_min_points)
        points = filter_voxels_adaptively(scan.points, *sizes, picks_middle=config.picks_middle)
        pose, match, self._line_share = prediction.local_from_base, None, None
        if target is not None and len(points) >= POINTS_LEAST:
            match = self._match(target, points, scan.origin, prediction)
            matched = target.local_from_submap @ match.grid_from_base
            self._stands_at_start &= self._scans_at_start < START_SCANS and self._is_still(prediction, matched)
            if self._stands_at_start and self._inserted is not None:
                _, pose = self._inserted
            else:
                pose = target.local_from_submap @ self._on_lines(target, points, scan, match, prediction)
                if self._is_held_back(target, prediction, match, pose):
                    pose = prediction.local_from_base
                self._judge_odometry(prediction, pose)
        submaps: list[Submap] = []
        finished = None
        if (
            may_insert
            and len(scan.points) >= POINTS_LEAST
            and (self._stands_at_start or self._has_moved(scan.stamp_ns, pose) or self._is_by_another_scanner(scan))
        ):
            between = points_between_returns(scan, 0.5 * config.insertion.resolution)
            submaps, finished = self.active.insert(scan, pose, between)
            self._scans_at_start += 1
            self._inserted, self._inserted_origin = (scan.stamp_ns, pose), scan.origin
        doubt = (0.0, 0.0) if target is None else self._doubt(match)
        return LocalResult(pose, match, scan, points, submaps, finished, doubt, self._line_share)

    def _match(self, target: Submap, points: F32, origin: tuple[float, float], prediction: Prediction) -> MatchResult:
        """Correlate about the prediction and refine; doubt odometry and bad matches."""
        is_trusted = self._trusts(prediction)
        window = self._window(prediction.motion, is_trusted)
        weights = self._config.refine if is_trusted else self._config.blind_refine
        match = _match_near(target, points, target.to_submap(prediction.local_from_base), window, weights)
        # By what is usual a leap of odometry is found out, and the first matches do not tell yet what that is.
        if prediction.is_measured and (not is_trusted or self._matches < FIRST_MATCHES):
            match = self._steady_match(target, points, prediction, window, match)
        if match.score < self._usual_score - self._config.rescue_score_drop:
            match = self._rescued_match(target, points, origin, prediction, match)
        rate = USUAL_RATE if self._matches else 1.0
        self._matches += 1
        self._usual_score += rate * (match.score - self._usual_score)
        self._usual_inliers += rate * (match.inlier_ratio - self._usual_inliers)
        self._best_inliers = max(self._best_inliers, match.inlier_ratio)
        return match

    def _doubt(self, match: MatchResult | None) -> tuple[float, float]:
        """Return how far (m, rad) a pose may be off that hardly anything of the scan speaks for: what was found is then any place of the window that is
        searched for bad matches, and the next scans fit onto it."""
        config = self._config
        usual = config.doubted_below * self._usual_inliers
        share = 1.0 if match is None else max(0.0, 1.0 - match.inlier_ratio / max(usual, 1e-9))
        return share * config.window_linear_max, share * config.window_angular_max

    def _on_lines(
        self, target: Submap, points: F32, scan: PlanarScan, match: MatchResult, prediction: Prediction
    ) -> SE2:
        """Return the pose at which a scan lies on the lines of the submap, in its frame. Along a direction of which these lines say next to nothing, between smooth
        parallel walls whose ends are out of sight, it is the predicted one: what cells prefer there is their texture, which holds a scan back
        by some percent of the way. So it is where trusted odometry leads and hardly anything of the scan is known."""
        is_led = self._trusts(prediction) and math.hypot(prediction.motion.x, prediction.motion.y) < LEAP
        if is_led and match.inlier_ratio < self._config.doubted_below * self._usual_inliers:
            return target.to_submap(prediction.local_from_base)
        fit = target.lines.fit(points, scan.origin, match.grid_from_base)
        if is_led:
            fit = self._led_fit(target, points, scan.origin, fit, target.to_submap(prediction.local_from_base))
        self._line_share = fit.share
        fitted, told = fit.grid_from_base, self._telling_of(target, fit)
        if told == 0.0 or not self._trusts(prediction):
            return fitted
        values, vectors = np.linalg.eigh(translational(fit.information))
        weakness = 1.0 - float(values[0]) / max(told * float(values[1]), 1e-9)
        if weakness <= 0.0:
            return fitted
        predicted, along = target.to_submap(prediction.local_from_base), vectors[:, 0]
        miss = weakness * float(along @ (predicted.x - fitted.x, predicted.y - fitted.y))
        return SE2(fitted.x + miss * float(along[0]), fitted.y + miss * float(along[1]), fitted.yaw)

    def _led_fit(
        self, target: Submap, points: F32, origin: tuple[float, float], fit: LineFit, predicted: SE2
    ) -> LineFit:
        """Return the fit to lines from where cells found a scan; but if it lies on them as well from where odometry leads, that one: on cells, what a narrow view shows beyond the end of what
        was drawn draws it back onto that, while where no line is, it counts for nothing."""
        if math.hypot(fit.grid_from_base.x - predicted.x, fit.grid_from_base.y - predicted.y) < LED_APART:
            return fit
        led = target.lines.fit(points, origin, predicted, LED_LEAST)
        is_as_good = led.share >= LED_SHARE * fit.share and led.residual <= LED_RESIDUAL * fit.residual
        return led if led.is_held and is_as_good else fit

    def _telling_of(self, target: Submap, fit: LineFit) -> float:
        """Return the share of what lines hold across that they must hold along, 0 where that is not asked. A young submap shows lines only near where it began,
        and cells that the same beams of a moving scanner hit again as they did before, which fits best where the scanner has not moved."""
        if fit.is_held or self._config.telling == 0.0:
            return self._config.telling
        return YOUNG_TELLING if target.scans < YOUNG_SCANS and fit.share >= YOUNG_SHARE else 0.0

    def _steady_match(
        self, target: Submap, points: F32, prediction: Prediction, window: Window, match: MatchResult
    ) -> MatchResult:
        """Odometry is doubted: return what is found where steady motion leads, if it fits clearly better."""
        steady = target.to_submap(prediction.steady_pose)
        other = _match_near(target, points, steady, window, self._config.blind_refine)
        return other if other.score > match.score + self._config.rescue_margin else match

    def _rescued_match(
        self,
        target: Submap,
        points: F32,
        origin: tuple[float, float],
        prediction: Prediction,
        match: MatchResult,
    ) -> MatchResult:
        """The match is unusually bad. Either the prediction was wrong, then the right place, searched in a wide window, fits as well as
        usual; or the view is new, then nothing does, and the match stands. Where trusted odometry leads into a new view, of which the submap knows too little to contradict it, what
        looks alike elsewhere is not asked."""
        config = self._config
        wide = Window(config.window_linear_max, config.window_angular_max)
        usual = self._usual_score - config.rescue_score_drop
        against = contradiction(target.grid, points, origin, match.grid_from_base)
        is_new_view = self._trusts(prediction) and against < config.lost_contradiction
        led_to = (prediction.local_from_base, prediction.steady_pose)
        for pose in led_to[:1] if is_new_view else led_to:
            start = correlate(
                target.grid, points, target.to_submap(pose), wide, unknown=config.blind_refine.unknown
            ).grid_from_base
            rescued = refine(target.grid, points, start, start, config.blind_refine)
            if rescued.score > max(usual, match.score + config.rescue_margin):
                match = rescued
        if is_new_view or match.score >= config.lost_score_ratio * self._usual_score:
            return match
        return self._found_again(target, points, prediction) or match

    def _found_again(self, target: Submap, points: F32, prediction: Prediction) -> MatchResult | None:
        """Hardly anything of the scan is where odometry led: wheels slip and are lifted, and tell more or less way than any gain allows. Search as far as a base
        gets from one scan to the next; None where nothing fits as usual."""
        config = self._config
        usual = self._usual_score - config.rescue_score_drop
        matcher = BranchBoundMatcher(target.grid, LOST_DEPTH, config.lost_coarseness)
        prior = target.to_submap(prediction.local_from_base)
        start = search_coarse_to_fine(matcher, target.grid, points, prior, Window(*config.lost_window), usual)
        if start is None:
            return None
        found = refine(target.grid, points, start, start, config.blind_refine)
        return found if found.score > usual and found.inlier_ratio > MOST else None

    def _trusts(self, prediction: Prediction) -> bool:
        return prediction.is_measured and self.odometry_error < 1.0

    def _window(self, motion: SE2, is_trusted: bool) -> Window:
        """Return where to search: farther after more motion, and where odometry is not trusted."""
        config = self._config
        linear = config.window_linear if is_trusted else config.blind_window_linear
        angular = config.window_angular if is_trusted else config.blind_window_angular
        return Window(
            min(linear + config.window_gain * SE2().distance_to(motion), max(linear, config.window_linear_max)),
            min(angular + config.window_gain * abs(motion.yaw), config.window_angular_max),
        )

    def _judge_odometry(self, prediction: Prediction, pose: SE2) -> None:
        """Average how far odometry misses the match, in units of what it is allowed to miss; above 1 it is not trusted."""
        if not prediction.is_measured:
            return
        config, motion = self._config, prediction.motion
        allowed = config.odometry_slack + config.odometry_slack_gain * SE2().distance_to(motion)
        error = min(prediction.local_from_base.distance_to(pose) / allowed, 4.0)
        self.odometry_error += 0.3 * (error - self.odometry_error)

    def _is_still(self, prediction: Prediction, matched: SE2) -> bool:
        """Whether neither odometry nor the scan has seen the base move since the scan that began the map."""
        last = matched if self._inserted is None else self._inserted[1]
        return prediction.is_measured and all(
            moved.distance_to(SE2()) < way and abs(moved.yaw) < turn
            for moved, (way, turn) in ((prediction.motion, STILL_MOTION), (last.inverse() @ matched, STILL_MATCH))
        )

    def _is_held_back(self, target: Submap, prediction: Prediction, match: MatchResult, pose: SE2) -> bool:
        """Whether an unusually bad match says that the base hardly moves though trusted odometry says it drives straight on, in a submap just begun: it shows spots on walls,
        which the same beams hit again a little farther on, and which fit best where the base has not moved. Beams that turn hit others."""
        way = math.hypot(prediction.motion.x, prediction.motion.y)
        is_straight = STILL_MATCH[0] < way < LEAP and abs(prediction.motion.yaw) < self._config.motion_angle
        if (
            target.travelled > BEGUN_WAY
            or not is_straight
            or match.inlier_ratio > HELD_INLIERS * self._best_inliers
            or not self._trusts(prediction)
        ):
            return False
        last = prediction.local_from_base @ prediction.motion.inverse()
        moved = last.inverse() @ pose
        return moved.x * prediction.motion.x + moved.y * prediction.motion.y < HELD_BACK * way * way

    def _is_by_another_scanner(self, scan: PlanarScan) -> bool:
        """Whether a scan was taken beside one that was just drawn: from the same pose of the base a second scanner sees other walls."""
        if self._inserted is None or scan.stamp_ns - self._inserted[0] > SAME_INSTANT_NS:
            return False
        return math.dist(scan.origin, self._inserted_origin) > ANOTHER_SCANNER

    def _has_moved(self, stamp_ns: int, pose: SE2) -> bool:
        config = self._config
        if self._inserted is None:
            return True
        last_ns, last = self._inserted
        return (
            (stamp_ns - last_ns) * 1e-9 > config.motion_time
            or last.distance_to(pose) > config.motion_distance
            or abs(wrap_angle(pose.yaw - last.yaw)) > config.motion_angle
        )


def _match_near(target: Submap, points: F32, prior: SE2, window: Window, weights: RefineConfig) -> MatchResult:
    start = correlate(target.grid, points, prior, window, *SEARCH_WEIGHTS, unknown=weights.unknown).grid_from_base
    return refine(target.grid, points, start, prior, weights)
