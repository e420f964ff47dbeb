"""Faults of scan matching, loop closure, the pose graph, of merged scans and of glass."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

LOOPS = ("tests/slam2d/test_loop_searcher.py",)
BACK_END = ("tests/slam2d/test_back_end.py",)
MARGINALS = ("tests/posegraph/test_marginals.py",)
SLAM = ("tests/slam2d/test_slam.py",)
EXTRAPOLATOR = ("tests/slam2d/test_extrapolator.py",)
GRAPH = ("tests/slam2d/test_graph.py",)
REFINE = ("tests/registration/test_gauss_newton.py",)
CORRELATE = ("tests/registration/test_correlative.py",)
BOUND = ("tests/registration/test_branch_bound.py",)
SOLVER = ("tests/posegraph/test_solver.py",)
MERGER = ("tests/perception/test_merger.py",)
PLANAR = ("tests/perception/test_planar.py",)
GLASS = ("tests/perception/test_glass.py",)

MAPPING = (
    PlantedFault(
        "a loop closure may fit ten times worse than a place does",
        "slam2d/config.py",
        "min_score: float = 0.55",
        "min_score: float = 0.1",
        LOOPS,
    ),
    PlantedFault(
        "a loop closure need not fit as local matches do",
        "slam2d/config.py",
        "min_score_ratio: float = 0.78",
        "min_score_ratio: float = 0.1",
        LOOPS,
    ),
    PlantedFault(
        "a loop closure counts whatever its share of inliers",
        "slam2d/loop_closure.py",
        " or match.inlier_ratio < config.min_inlier_ratio_of_usual * usual.inlier_ratio",
        "",
        LOOPS,
    ),
    PlantedFault(
        "far loop closures are believed alone",
        "slam2d/agreement.py",
        "is_far = np.array([m > config.surprise for m in moved], np.bool_)",
        "is_far = np.array([m > 1e9 for m in moved], np.bool_)",
        BACK_END,
    ),
    PlantedFault(
        "a loop closure confirms itself from the same node",
        "slam2d/agreement.py",
        "len({far[i].node for i in group}) < config.confirmations",
        "len(group) < config.confirmations",
        BACK_END,
    ),
    PlantedFault(
        "headings of two loop closures need not agree",
        "slam2d/agreement.py",
        " & (turn < config.agreement[1] + config.agreement_per_metre[1] * between)",
        "",
        BACK_END,
    ),
    PlantedFault(
        "loop closures on a short way confirm a far move",
        "slam2d/agreement.py",
        "high - low < np.clip(",
        "high - low < 0.0 * np.clip(",
        BACK_END,
    ),
    PlantedFault(
        "what others contradict is believed",
        "slam2d/agreement.py",
        "2 * is_against.sum() < len(group)",
        "is_against.sum() < 1000",
        BACK_END,
    ),
    PlantedFault(
        "loop closures do not end the drift",
        "slam2d/drift.py",
        "loops = np.array(self.loops, np.int64).reshape(-1, 2)",
        "loops = np.array((), np.int64).reshape(-1, 2)",
        BACK_END,
    ),
    PlantedFault(
        "drift of the heading does not move the position",
        "posegraph/marginals.py",
        "lever[:, 0, 2], lever[:, 1, 2] = -d[:, 1], d[:, 0]",
        "lever[:, 0, 2], lever[:, 1, 2] = 0.0, 0.0",
        MARGINALS,
    ),
    PlantedFault(
        "relative covariances leave out what both poses share",
        "posegraph/marginals.py",
        "own + there - between - between.transpose(0, 2, 1)",
        "own + there",
        MARGINALS,
    ),
    PlantedFault(
        "surfaces go on between any two returns",
        "registration/planar_scan.py",
        "LEAST_BEND = math.cos(math.radians(15.0))",
        "LEAST_BEND = -2.0",
        ("tests/registration/test_surfaces.py",),
    ),
    PlantedFault(
        "surfaces overwrite what was measured",
        "kernels/submap.py",
        "and 0 <= iy < height and cells[iy, ix] == 0:",
        "and 0 <= iy < height:",
        ("tests/grids/test_insertion.py",),
    ),
    PlantedFault(
        "rays of a cloud erase what they pass over in a submap",
        "kernels/submap.py",
        "if is_inside and not (min(next_x, next_y) < high_to and cells[iy, ix] & VALUE > EVEN):",
        "if is_inside:",
        ("tests/grids/test_insertion.py",),
    ),
    PlantedFault(
        "rays of a cloud erase what they pass over in the local costmap",
        "kernels/costmap.py",
        "if not (is_over and layer[iy, ix] == LETHAL and lowest > tops[iy, ix] - GRAZE):",
        "if True:",
        ("tests/costmap/test_costmaps.py",),
    ),
    PlantedFault(
        "the last return tells how high a thing is",
        "kernels/costmap.py",
        "tops[iy, ix] = max(tops[iy, ix], top) if layer[iy, ix] == LETHAL else top",
        "tops[iy, ix] = top",
        ("tests/costmap/test_costmaps.py",),
    ),
    PlantedFault(
        "heights of things stay behind when the window moves",
        "costmap/obstacle_layer.py",
        "self._tops = moved(self._tops, self._spec, spec, 0.0)",
        "self._tops = self._tops.copy()",
        ("tests/costmap/test_costmaps.py",),
    ),
    PlantedFault(
        "what goes on above the band is as high as the band",
        "kernels/scan_points.py",
        "inside[n_inside, 0], inside[n_inside, 1], inside[n_inside, 4] = b, d, math.inf",
        "inside[n_inside, 0], inside[n_inside, 1], inside[n_inside, 4] = b, math.inf, math.inf",
        ("tests/perception/test_planar.py",),
    ),
    PlantedFault(
        "scans count once whatever the way between them",
        "slam2d/submaps.py",
        "times = min(max(1, round(changed / self._step)), MOST_TIMES)",
        "times = 1",
        ("tests/slam2d/test_submaps.py",),
    ),
    PlantedFault(
        "rejected closures teach how much scan matching drifts",
        "slam2d/back_end.py",
        "if key_of(closure) not in rejected:",
        "if True:",
        BACK_END,
    ),
    PlantedFault(
        "a long way without a loop closure is no warning",
        "slam2d/offline.py",
        "not self.loop_closures and self.way > LONG_WAY",
        "False",
        ("tests/slam2d/test_offline_verb.py",),
    ),
    PlantedFault(
        "revisits have no error",
        "evaluation/revisits.py",
        "return RevisitErrors(np.hypot(off[:, 0], off[:, 1]))",
        "return RevisitErrors(0.0 * np.hypot(off[:, 0], off[:, 1]))",
        ("tests/evaluation/test_revisits.py",),
    ),
    PlantedFault(
        "loop closures far beyond their sigma stay in the graph",
        "slam2d/graph.py",
        "result.edge_chi2 > config.reject_width**2",
        "result.edge_chi2 > 1e12",
        GRAPH,
    ),
    PlantedFault(
        "loop closures are not robust in the graph",
        "slam2d/graph.py",
        "np.concatenate((graph.is_robust, [e.kind == EdgeKind.INTER for e in extra]))",
        "np.concatenate((graph.is_robust, [False for e in extra]))",
        GRAPH,
    ),
    PlantedFault(
        "an edge's covariance is not turned into the measured frame",
        "slam2d/graph.py",
        "turned = turn @ covariance @ turn.T + np.diag",
        "turned = covariance + np.diag",
        GRAPH,
    ),
    PlantedFault(
        "the information of odometry is that of its sigma, not of its variance",
        "slam2d/graph.py",
        "np.diag([sigma[0] ** -2, sigma[0] ** -2, sigma[1] ** -2])",
        "np.diag([sigma[0] ** -1, sigma[0] ** -1, sigma[1] ** -1])",
        GRAPH,
    ),
    PlantedFault(
        "the gyroscope does not turn the predicted motion",
        "slam2d/extrapolator.py",
        "return SE2(motion.x, motion.y, wrap_angle(yaw1.yaw - yaw0.yaw))",
        "return motion",
        EXTRAPOLATOR,
    ),
    PlantedFault(
        "predictions continue the last motion whatever the time between scans",
        "slam2d/extrapolator.py",
        "SE2.exp((poses[-2].inverse() @ poses[-1]).log() * min(ratio, 2.0))",
        "poses[-2].inverse() @ poses[-1]",
        EXTRAPOLATOR,
    ),
    PlantedFault(
        "the twist for motion compensation is told per scan, not per second",
        "slam2d/extrapolator.py",
        "else motion).log() / span",
        "else motion).log()",
        EXTRAPOLATOR,
    ),
    PlantedFault(
        "odometry that slips is trusted",
        "slam2d/front_end.py",
        "is_trusted = prediction.is_measured and self.odometry_error < 1.0",
        "is_trusted = prediction.is_measured",
        SLAM,
    ),
    PlantedFault(
        "scans are inserted although the robot stands",
        "slam2d/front_end.py",
        "if self._inserted is None:\n            return True",
        "return True",
        SLAM,
    ),
    PlantedFault(
        "a match states a quarter of its variance",
        "registration/gauss_newton.py",
        "cov = sigma**2 * np.linalg.inv(",
        "cov = 0.25 * sigma**2 * np.linalg.inv(",
        REFINE,
    ),
    PlantedFault(
        "the degeneracy of a corridor is not told",
        "registration/gauss_newton.py",
        "return float(max(0.0, low) / high) if high > 0.0 else 0.0",
        "return 1.0",
        REFINE,
    ),
    PlantedFault(
        "the correlative search looks at half of its window",
        "registration/correlative.py",
        "half = math.ceil(window.linear / resolution)",
        "half = math.ceil(0.5 * window.linear / resolution)",
        CORRELATE,
    ),
    PlantedFault(
        "headings between two steps of the search are left out",
        "registration/correlative.py",
        "step = angular_step(points, resolution, 0.9)",
        "step = 4.0 * angular_step(points, resolution, 0.9)",
        CORRELATE,
    ),
    PlantedFault(
        "branch and bound accepts what lies below the least score",
        "registration/branch_bound.py",
        "min_sum = math.floor((min_score - 0.1) / 0.8 * 255.0 * len(points))",
        "min_sum = 0",
        BOUND,
    ),
    PlantedFault(
        "solved headings are not brought into one turn",
        "posegraph/solver.py",
        "poses[:, 2] = (poses[:, 2] + np.pi) % (2.0 * np.pi) - np.pi",
        "poses[:, 2] += 2.0 * np.pi",
        SOLVER,
    ),
    PlantedFault(
        "flagged edges bend the first guess of the pose graph",
        "posegraph/solver.py",
        "trust = np.where(graph.is_robust, 1e-3, 1.0)",
        "trust = np.where(graph.is_robust, 1.0, 1e-3)",
        SOLVER,
    ),
    PlantedFault(
        "the solver stops after one iteration and calls it converged",
        "posegraph/solver.py",
        "                poses, cost = moved, new_cost\n",
        "                poses, cost = moved, new_cost\n                return poses, cost, iteration, True\n",
        SOLVER,
    ),
    PlantedFault(
        "the pose graph's chi-squared is that of the guess",
        "posegraph/solver.py",
        "kernels.edge_chi2(poses, graph.edge_from",
        "kernels.edge_chi2(graph.poses, graph.edge_from",
        SOLVER,
    ),
    PlantedFault(
        "a leaning body does not tilt its scanner",
        "perception/level_mount.py",
        "SE3((0.0, 0.0, 0.0), lean) @ base_from_sensor",
        "base_from_sensor",
        PLANAR,
    ),
    PlantedFault(
        "one lean holds for the whole turn of a scanner",
        "perception/level_mount.py",
        "motion.pose_at(stamp_ns + round(k * step * 1e9))",
        "motion.pose_at(stamp_ns)",
        PLANAR,
    ),
    PlantedFault(
        "far floor is as surely floor as near floor",
        "kernels/scan_points.py",
        "if z < band[0] + band[2] * d:",
        "if z < band[0]:",
        PLANAR,
    ),
    PlantedFault(
        "the beam of a nodding scanner ends at the floor as at a wall",
        "kernels/scan_points.py",
        "if over < r * sink:",
        "if over < -1e9:",
        PLANAR,
    ),
    PlantedFault(
        "beams are not moved to the stamp of their scan",
        "perception/planar.py",
        "np.array([scan.angle_min, scan.angle_increment, scan.time_increment])",
        "np.array([scan.angle_min, scan.angle_increment, 0.0])",
        PLANAR,
    ),
    PlantedFault(
        "painted surfaces count as glass",
        "perception/glass.py",
        "is_glass = (intensities >= self.config.intensity_min) & (intensities <= self.config.intensity_max)",
        "is_glass = intensities >= 0.0",
        GLASS,
    ),
)
