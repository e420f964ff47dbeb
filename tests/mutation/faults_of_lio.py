"""Faults of LiDAR-inertial odometry, of its files and of its metrics."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

AIR_FILTER = ("tests/perception/test_air_filter.py",)
AIR = ("tests/sim/test_air.py",)
CLOUD_NODE = ("tests/lio/test_cloud_localization_node.py",)
INERTIAL = ("tests/lio/test_inertial.py",)
MAP = ("tests/lio/test_voxel_map.py",)
ODOMETRY = ("tests/lio/test_odometry.py",)
START = ("tests/lio/test_start.py",)
DOCTOR = ("tests/lio/test_doctor.py",)
DRIFT = ("tests/lio/test_drift.py",)
BEGINNING = ("tests/lio/test_beginning.py",)
BASE = ("tests/lio/test_base_odometry.py",)
NODE = ("tests/lio/test_lidar_odometry_node.py",)
SPATIAL = ("tests/posegraph/test_spatial.py",)
LOOPS = ("tests/lio/test_loop_closure.py",)
CLOUD = ("tests/lio/test_cloud_localization.py",)
PLACES_STUDY = ("tests/studies/test_cloud_relocalization_study.py",)
ERRORS = ("tests/evaluation/test_spatial_error.py",)

LIO = (
    PlantedFault(
        "a mount that is learned turns the way",
        "lio/beginning.py",
        "return began @ _mount(state) @ _mount(origin).inverse() @ began.inverse()",
        "return SE3()",
        BEGINNING,
    ),
    PlantedFault(
        "an error of the mount is none of the first pose",
        "lio/beginning.py",
        "out[k.ROTATION : k.VELOCITY, 3:] = turned",
        "out[k.ROTATION : k.VELOCITY, 3:] = 0.0",
        BEGINNING,
    ),
    PlantedFault(
        "the pose since the start forgets that the mount turns it",
        "lio/beginning.py",
        "-skew(place - pivot) @ axes",
        "-skew(place) @ axes",
        BEGINNING,
    ),
    PlantedFault(
        "the first map is believed as any",
        "lio/odometry.py",
        "* self._drift.begin_left if is_leaving",
        "* 0.0 if is_leaving",
        BEGINNING,
    ),
    PlantedFault(
        "the mount takes all that a scan says",
        "lio/odometry.py",
        "share, n = self.config.learned_share, len(covariance)",
        "share, n = 1.0, len(covariance)",
        BEGINNING,
    ),
    PlantedFault(
        "whole recordings take clocks as they are told",
        "lio/offline.py",
        "estimates_clock=True, clock_sigma",
        "estimates_clock=False, clock_sigma",
        BEGINNING,
    ),
    PlantedFault(
        "the velocity's covariance forgets how an attitude turns forces",
        "kernels/inertial.py",
        "f[VELOCITY + r, ROTATION + 1] = (rotation[r, 0] * e[2]",
        "f[VELOCITY + r, ROTATION + 1] = (rotation[r, 0] * -e[2]",
        INERTIAL,
    ),
    PlantedFault(
        "a scanned point does not turn with the body",
        "kernels/inertial.py",
        "so3_exp(knots[k, W] * dt, knots[k, W + 1] * dt, knots[k, W + 2] * dt, step)",
        "so3_exp(0.0, 0.0, 0.0, step)",
        INERTIAL,
    ),
    PlantedFault(
        "points on one ring make a plane",
        "kernels/voxel_map.py",
        "if not minors >= flatness * trace * trace or trace <= 0.0:",
        "if trace <= 0.0:",
        MAP,
    ),
    PlantedFault(
        "a far voxel is never forgotten",
        "kernels/voxel_map.py",
        "if x * x + y * y + z * z > radius * radius:",
        "if x * x + y * y + z * z > 1e9 * radius * radius:",
        MAP,
    ),
    PlantedFault(
        "forces in g are taken for m/s²",
        "lio/start.py",
        'return STANDARD_GRAVITY / length, "g"',
        'return 1.0, "g"',
        START,
    ),
    PlantedFault(
        "a weak direction is updated all the same",
        "lio/degeneracy.py",
        "return keep @ information @ keep, keep @ gradient",
        "return information, gradient",
        ("tests/lio/test_degeneracy.py",),
    ),
    PlantedFault(
        "degrees per second pass the check",
        "lio/doctor.py",
        "1.0 / 80.0 < ratio < 1.0 / 40.0",
        "1.0 / 8000.0 < ratio < 1.0 / 4000.0",
        DOCTOR,
    ),
    PlantedFault(
        "an error of attitude moves nothing that comes after it",
        "lio/drift.py",
        "carried[:3, 3:] = -skew(step)",
        "carried[:3, 3:] = 0.0",
        DRIFT,
    ),
    PlantedFault(
        "a trajectory's error is halved",
        "evaluation/spatial_error.py",
        "errors = np.linalg.norm(offsets, axis=1)",
        "errors = 0.5 * np.linalg.norm(offsets, axis=1)",
        ERRORS,
    ),
    PlantedFault(
        "normalized errors are ten times too small",
        "studies/lio_study.py",
        "np.linalg.solve(result.covariance, error)) / 6.0",
        "np.linalg.solve(result.covariance, error)) / 60.0",
        ("tests/studies/test_lio_study.py",),
    ),
    PlantedFault(
        "wheels that spin carry the robot away",
        "lio/odometry.py",
        "self._measure(velocity, doubted_from=c.wheels.slip)",
        "self._measure(velocity)",
        ODOMETRY,
    ),
    PlantedFault(
        "wheels that agree are doubted, too",
        "lio/odometry.py",
        "noise * max(1.0, off / doubted_from**2)",
        "noise * (1.0 + 1e3 * off)",
        ODOMETRY,
    ),
    PlantedFault(
        "the update forgets where the prediction was",
        "lio/odometry.py",
        "(inner @ g + moved[part]) - g) - moved",
        "(inner @ g) - g)",
        ODOMETRY,
    ),
    PlantedFault(
        "a late scan takes the pose back to its own time",
        "lio/carry.py",
        "samples = self._buffer.between(self._time, newest)",
        "samples = self._buffer.between(newest - 0.005, newest)",
        BASE,
    ),
    PlantedFault(
        "the base moves as the IMU does",
        "lio/base_odometry.py",
        " + _cross(self._carried.rate, self._lever))",
        ")",
        BASE,
    ),
    PlantedFault(
        "odometry coasts for ever",
        "lio/base_odometry.py",
        "stamp_ns - self._fitted_ns <= self.config.coast_most * 1e9",
        "stamp_ns - self._fitted_ns <= self.config.coast_most * 1e18",
        BASE,
    ),
    PlantedFault(
        "a scan that fits nothing counts as one that fits",
        "lio/base_odometry.py",
        "if self._fitted_ns is None or not result.health.is_lost:",
        "if True:",
        NODE,
    ),
    PlantedFault(
        "what contradicts at the start is driven with",
        "lio/doctor.py",
        "if diagnosis.troubles:\n            raise",
        "if False:\n            raise",
        NODE,
    ),
    PlantedFault(
        "every IMU of the robot is its first",
        "nodes/lidar_odometry.py",
        "if sample.frame != self._imu.frame:",
        "if False:",
        NODE,
    ),
    PlantedFault(
        "clouds may go backwards in time",
        "recordings/cloud_folder.py",
        "if (np.diff(stamps) <= 0).any():",
        "if False:",
        ("tests/recordings/test_cloud_folder.py",),
    ),
    PlantedFault(
        "a graph in space forgets how a turn moves what lies ahead",
        "posegraph/spatial.py",
        "from_a[:, :3, :3], from_a[:, :3, 3:] = -back, back @ skew_all(arm)",
        "from_a[:, :3, :3] = -back",
        SPATIAL,
    ),
    PlantedFault(
        "a covariance between two poses forgets the arm",
        "posegraph/spatial.py",
        "-turn, turn @ skew_all(arm[None])[0]",
        "-turn, 0.0 * turn",
        SPATIAL,
    ),
    PlantedFault(
        "a closure holds along a corridor",
        "lio/loop_match.py",
        "information, _ = weak.frozen(np.linalg.inv(covariance), np.zeros(6))",
        "information = np.linalg.inv(covariance)",
        LOOPS,
    ),
    PlantedFault(
        "a match with few partners counts",
        "lio/loop_match.py",
        "    match = match_clouds(",
        "    config = replace(config, overlap_least=0.0)\n    match = match_clouds(",
        LOOPS,
    ),
    PlantedFault(
        "one of two places that fit as well is taken",
        "lio/loop_match.py",
        "if is_elsewhere and other.overlap > RIVAL * best.overlap:",
        "if is_elsewhere and other.overlap > 10.0 * best.overlap:",
        LOOPS,
    ),
    PlantedFault(
        "a match beside what the drift allows counts",
        "lio/loop_closure.py",
        "if surprise <= c.gate",
        "if surprise <= 1e9 * c.gate",
        LOOPS,
    ),
    PlantedFault(
        "a correction is applied from the wrong side",
        "lio/corrections.py",
        "here = correction(k) @ odom_from_body",
        "here = odom_from_body @ correction(k)",
        LOOPS,
    ),
    PlantedFault(
        "a keyframe's cloud stays where the stretch began",
        "lio/keyframes.py",
        "cloud = self._cloud(middle_from_begin)",
        "cloud = self._cloud(np.eye(4))",
        LOOPS,
    ),
    PlantedFault(
        "false closures pass for true ones",
        "studies/lio_study.py",
        "np.linalg.norm(place) > FALSE_M",
        "np.linalg.norm(place) > 10.0 * FALSE_M",
        ("tests/studies/test_lio_study.py",),
    ),
    PlantedFault(
        "a place that is seen once is believed",
        "lio/cloud_relocalizer.py",
        "if viewpoints >= (self.config.viewpoints if",
        "if viewpoints >= 1 or viewpoints >= (self.config.viewpoints if",
        CLOUD,
    ),
    PlantedFault(
        "of two places that look alike the first is taken",
        "lio/cloud_relocalizer.py",
        "        if best - second >= c.margin:",
        "        if best >= c.margin:",
        CLOUD,
    ),
    PlantedFault(
        "rays through walls do not speak against a place",
        "lio/cloud_match.py",
        "return (self.walls - 2.0 * self.blocked) * self.tightness",
        "return self.walls",
        CLOUD,
    ),
    PlantedFault(
        "what is seen behind a wall's edge is taken to be seen through it",
        "kernels/cloud_search.py",
        "if before * after >= 0.0 or abs(before) < clear",
        "if abs(before) < clear",
        CLOUD,
    ),
    PlantedFault(
        "all heights of the sensor are taken for the lowest",
        "kernels/cloud_search.py",
        "points[k, 2] + low + h * step",
        "points[k, 2] + low",
        ("tests/lio/test_cloud_localization.py::test_heights_are_told_by_walls_and_flats_apart",),
    ),
    PlantedFault(
        "a correction steps",
        "lio/cloud_localizer.py",
        "share = 1.0 - math.exp(-self._dt / self.config.smooth)",
        "share = 1.0",
        CLOUD,
    ),
    PlantedFault(
        "the place in a tunnel follows a registration that knows nothing of it",
        "lio/cloud_localizer.py",
        "corrected = turned(predicted, self._covariance @ (information @ innovation))",
        "corrected = pose",
        CLOUD,
    ),
    PlantedFault(
        "registrations off by metres are taken",
        "lio/cloud_localizer.py",
        "if match.quality < c.accept or off > c.jump or turn > c.jump_turn:",
        "if off > 1e3:",
        CLOUD,
    ),
    PlantedFault(
        "what was computed is not counted as time until found",
        "studies/cloud_relocalization_study.py",
        "seconds = (follower.found_after or 0.0) + follower.found_cpu if is_found else None",
        "seconds = (follower.found_after or 0.0) if is_found else None",
        PLACES_STUDY,
    ),
    PlantedFault(
        "a place found in the map of another is no false one",
        "studies/cloud_relocalization_study.py",
        'wrong = int(is_found) if way == "foreign" else follower.wrong',
        "wrong = follower.wrong",
        PLACES_STUDY,
    ),
    PlantedFault(
        "leaves are smoke",
        "kernels/air.py",
        "is_dim_about = dim >= share * found",
        "is_dim_about = True",
        AIR_FILTER,
    ),
    PlantedFault(
        "what a ring sees in the air lies on a plane",
        "kernels/air.py",
        "OFF = 0.1",
        "OFF = -1.0",
        AIR_FILTER,
    ),
    PlantedFault(
        "dust that was met once is a thin pole",
        "kernels/air.py",
        "is_lasting[k] = count >= again",
        "is_lasting[k] = True",
        AIR_FILTER,
    ),
    PlantedFault(
        "a flatly met floor has no neighbours",
        "perception/air_filter.py",
        "depth: float = 0.25",
        "depth: float = 0.0",
        AIR_FILTER,
    ),
    PlantedFault(
        "dust is as bright as paint",
        "sim/air.py",
        "intensity[meets] = np.minimum(dim[meets], 0.2)",
        "intensity[meets] = 0.5",
        AIR,
    ),
    PlantedFault(
        "smoke is met beyond its column",
        "sim/air.py",
        "is_met = (half > 0.0) & (at < leaves) & (height",
        "is_met = (half > 0.0) & (height",
        AIR,
    ),
    PlantedFault(
        "another storey is matched all the same",
        "registration/submap_match.py",
        "if _overlap(target, sample, pose, reach) < overlap_least:",
        "if overlap_least > 1.0:",
        (
            "tests/lio/test_loop_closure.py::test_what_cannot_overlap_is_refused_before_it_is_matched_and_what_can_is_matched_as_ever",
        ),
    ),
    PlantedFault(
        "the cloud lies where the base was when it came",
        "nodes/cloud_localization.py",
        "odom_from_lidar = odom_from_base @ self._base_from_lidar",
        "odom_from_lidar = odom_from_base",
        CLOUD_NODE,
    ),
    PlantedFault(
        "a lost place is still told",
        "lio/cloud_localizer.py",
        "return CloudPose(result.stamp_ns, CloudState.LOST, None, None, match)",
        "return CloudPose(result.stamp_ns, CloudState.LOST, result.map_from_imu, SE3(), match)",
        CLOUD_NODE,
    ),
    PlantedFault(
        "places are not compared by how tightly they fit",
        "lio/cloud_match.py",
        "own = [replace(match, tightness=min(1.0, least / max(match.residual_m, 1e-6))) for match in matches]",
        "own = list(matches)",
        (
            "tests/lio/test_cloud_localization.py::test_the_place_where_walls_fit_tightly_comes_before_one_that_they_lie_beside",
        ),
    ),
    PlantedFault(
        "all decks are searched at once",
        "lio/cloud_map.py",
        "return tuple(images) if len(images) > 1 else ()",
        "return ()",
        ("tests/lio/test_cloud_localization.py::test_each_of_two_decks_is_seen_from_above_by_itself",),
    ),
)
