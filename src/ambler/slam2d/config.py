"""Parameters of 2-D SLAM, with the defaults that Ambler ships; angles in radians, lengths in metres."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ambler.core.units import Radians
from ambler.grids.probability_grid import InsertionConfig
from ambler.registration.gauss_newton import RefineConfig
from ambler.registration.line_field import LineConfig


@dataclass(frozen=True, slots=True)
class FrontEndConfig:
    """Scan matching and insertion. The search window around the prediction is base + gain * predicted motion, within the largest. A direction of which
    the lines of a submap hold less than `telling` of what they hold of the other one is left to odometry, as long as that is trusted (0: none is).

    `picks_middle`: of the returns in a voxel the middle one of the scan is taken, which turns no wall (`kernels.scan_points.choose_voxels`); else the first.

    A match of which less than `doubted_below` of the usual share of points lies on walls is doubted: up to the whole of the largest window where none does.

    A match whose score is below `lost_score_ratio` of the usual one is sought in `lost_window` (m, rad) too, on cells `lost_coarseness` times as wide first. But where
    odometry is trusted and less than `lost_contradiction` of the points lie where the submap saw nothing, the view is new, and odometry is not left.
    """

    voxel_size: float = 0.025
    match_max_voxel: float = 0.5
    match_min_points: int = 200
    window_linear: float = 0.05
    window_angular: Radians = math.radians(3.0)
    window_gain: float = 0.3
    window_linear_max: float = 0.25
    window_angular_max: Radians = math.radians(20.0)
    blind_window_linear: float = 0.15
    blind_window_angular: Radians = math.radians(10.0)
    rescue_score_drop: float = 0.12
    odometry_slack: float = 0.03
    odometry_slack_gain: float = 0.4
    rescue_margin: float = 0.05
    doubted_below: float = 0.5
    lost_score_ratio: float = 0.7
    lost_contradiction: float = 0.15
    lost_window: tuple[float, float] = (2.0, math.radians(45.0))
    lost_coarseness: int = 4
    refine: RefineConfig = field(default_factory=lambda: RefineConfig(unknown=0.3))
    blind_refine: RefineConfig = field(default_factory=lambda: RefineConfig(1.0, 1.0, 4.0, 3.0, unknown=0.3))
    lines: LineConfig = field(default_factory=LineConfig)
    telling: float = 0.01
    picks_middle: bool = False
    point_sigma: float = 0.35
    motion_time: float = 5.0
    motion_distance: float = 0.2
    motion_angle: Radians = math.radians(1.0)
    scans_per_submap: int = 90
    distance_per_submap: float = 10.0
    insertion: InsertionConfig = field(default_factory=InsertionConfig)


@dataclass(frozen=True, slots=True)
class DriftConfig:
    """What scan matching drifts, as standard deviations per metre of way (m/m, rad/m) and at `least` (m, rad) from one submap to the next;
    `closure` (m, rad) is how well a loop closure holds two submaps together. `scale_limits` bound the factor that is learned from
    closures of pairs whose positions were known to no better than `informative` (m), `scale_weight` is how many of them the configured
    figures count as."""

    linear_per_metre: float = 0.02
    angular_per_metre: Radians = math.radians(0.05)
    least: tuple[float, float] = (0.02, math.radians(0.1))
    closure: tuple[float, float] = (0.05, math.radians(0.5))
    scale_limits: tuple[float, float] = (0.5, 5.0)
    scale_weight: float = 2.0
    informative: float = 0.5


@dataclass(frozen=True, slots=True)
class LoopConfig:
    """Search for loop closures: every `query_distance` metres of way, at the end of a recording every `final_distance`, a
    node is compared with submaps that it may see.

    A window is `window_base`, `angle_base` and three standard deviations of the drift between the two. A score counts relative to what
    local matches usually reach, but at most `min_score` is asked. A scan of which the lines of the submap hold along one direction less than
    `telling` of what they hold across fits as well further along its corridor, and closes nothing; nor does one of which they hold too little to tell and the
    cells weakly (`RefineConfig.weak_ratio`): clutter fits clutter anywhere.

    A closure that moves its node by more than `surprise` (m) must be confirmed: by `confirmations` closures of several nodes, which all
    move the map in the same way, spread over a way of `spread_ratio` times what they move it, within `spread` (m). Two closures move it the
    same way within `agreement` (m, rad) and `agreement_per_metre` of the way between them. For each such closure the nodes are searched
    that come `follow` metres of way before or after its own, near where they would be if it were true.
    A node sees farther than `max_view_distance`. Where closures hold nothing yet, and the window is within `partial_window` (m), it is compared with a submap of
    which it sees `partial_share` of its points and `partial_points` of them or more, by these points alone, `partial_tries` times per pair of submaps; what is
    found must be confirmed, however little it moves the map.
    `picks_middle` as in the front end. `refine` takes few steps: one that begins at the best cell of all needs no more, and what would need more slides to
    another place.
    """

    max_voxel: float = 0.9
    min_points: int = 100
    min_score: float = 0.55
    min_score_ratio: float = 0.78
    min_inlier_ratio_of_usual: float = 0.75
    telling: float = 0.01
    surprise: float = 0.6
    confirmations: int = 3
    spread_ratio: float = 0.5
    spread: tuple[float, float] = (1.5, 10.0)
    agreement: tuple[float, float] = (0.5, math.radians(3.0))
    agreement_per_metre: tuple[float, float] = (0.02, math.radians(0.1))
    most_pending: int = 600
    follow: tuple[float, ...] = (-8.0, -5.0, -3.0, -1.5, 1.5, 3.0, 5.0, 8.0)
    max_view_distance: float = 6.0
    partial_share: float = 0.15
    partial_points: int = 25
    partial_window: tuple[float, float] = (0.7, 4.0)
    partial_tries: int = 4
    turn_price: float = 4.0
    query_distance: float = 1.0
    final_distance: float = 0.4
    window_base: float = 0.4
    window_max: float = 40.0
    angle_base: Radians = math.radians(4.0)
    angle_max: Radians = math.radians(60.0)
    coarse_above: float = 1.0
    coarseness: int = 4
    candidates_per_node: int = 2
    tries_per_pair: int = 12
    tries_to_double: float = 8.0
    wide_window: float = 6.0
    searches_per_job: int = 24
    edges_per_pair: int = 6
    cached_stacks: int = 12
    picks_middle: bool = False
    drift: DriftConfig = field(default_factory=DriftConfig)
    refine: RefineConfig = field(default_factory=lambda: RefineConfig(1.0, 0.01, 0.01, 0.01, max_iterations=4))


@dataclass(frozen=True, slots=True)
class GraphConfig:
    """Standard deviations of the edges (metres, radians) and when to optimize. A closure beyond `reject_width` standard deviations is rejected. Once `loosening_for` closures
    more are kept if submaps hold their nodes `loosening` times as loosely, and at most the share `loosening_rejects` of those that were rejected before is rejected still, they do so from
    then on."""

    intra_sigma: tuple[float, float] = (0.02, math.radians(0.3))
    inter_sigma: tuple[float, float] = (0.02, math.radians(0.2))  # a closure that ends on lines through the returns
    local_sigma: tuple[float, float] = (0.01, math.radians(0.2))
    odometry_sigma: tuple[float, float] = (0.05, math.radians(2.0))
    odometry_gain: float = 0.2
    robust_width: float = 2.0
    reject_width: float = 5.0
    loosening: float = 5.0
    loosening_for: int = 6
    loosening_rejects: float = 0.33
    nodes_between: int = 90
    max_iterations: int = 50


@dataclass(frozen=True, slots=True)
class RenderConfig:
    """The published map: cells whose summed log odds pass the thresholds. In each submap a free cell beside an occupied one counts
    `beside_occupied` times its log odds only, so that walls on which submaps disagree by a cell keep no holes."""

    resolution: float = 0.05
    occupied_above: float = 0.0
    free_below: float = 0.0
    beside_occupied: float = 0.3
    margin: float = 0.5


@dataclass(frozen=True, slots=True)
class Slam2dConfig:
    """Everything; `correction_time` is the time constant (s) with which a loop closure's correction reaches the published pose."""

    front_end: FrontEndConfig = field(default_factory=FrontEndConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    graph: GraphConfig = field(default_factory=GraphConfig)
    render: RenderConfig = field(default_factory=RenderConfig)
    correction_time: float = 0.5
