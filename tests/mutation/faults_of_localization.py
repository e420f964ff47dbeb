"""Faults of odometry and of localization in a known map."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

EKF = ("tests/localization/test_planar_ekf.py",)
EKF_NOISE = ("tests/localization/test_planar_ekf_noise.py",)
ODOMETRY = ("tests/localization/test_odometry.py",)
HONEST = ("tests/localization/test_honesty.py",)
SUPERVISOR = ("tests/localization/test_supervisor.py",)
FOUND = ("tests/localization/test_relocalization.py",)

MADE_MAPS = ("tests/localization/test_made_maps.py",)
NODE = ("tests/localization/test_localization_node.py",)
BEND = ("tests/localization/test_map_bend.py",)
PUSHED = ("tests/localization/test_pushed.py",)
ALIKE = ("tests/localization/test_place_evidence.py",)
MADE_STUDY = ("tests/studies/test_made_maps.py",)
MADE_TRUTH = ("tests/evaluation/test_made_map_truth.py",)

LOCALIZATION = (
    PlantedFault(
        "a place is believed however much of it is contradicted",
        "localization/relocalizer.py",
        "if is_here and (is_sure or is_confirmed)",
        "if (is_sure or is_confirmed)",
        ("tests/localization/test_place_evidence.py",),
    ),
    PlantedFault(
        "a place is believed to which the way does not lead",
        "localization/relocalizer.py",
        "if not self._may_have_come_to(best):",
        "if False:",
        ("tests/localization/test_place_evidence.py",),
    ),
    PlantedFault(
        "a robot that was carried while it was lost is never believed",
        "localization/relocalizer.py",
        "self._past = self._past[(len(self._past) + 1) // 2 :]",
        "self._past = self._past[0:]",
        ("tests/localization/test_place_evidence.py",),
    ),
    PlantedFault(
        "what stands where the map knows nothing contradicts it",
        "kernels/likelihood_field.py",
        "cells[iy, ix] < 0:",
        "False:",
        ("tests/localization/test_place_evidence.py",),
    ),
    PlantedFault(
        "what confirmed one place confirms every other",
        "localization/relocalizer.py",
        "is_confirmed = best.confirmations >= times",
        "is_confirmed = max(h.confirmations for h in hypotheses) >= times",
        ("tests/localization/test_place_evidence.py",),
    ),
    PlantedFault(
        "one view makes a place sure when another place had several",
        "localization/relocalizer.py",
        "best.quality >= config.sure_quality and best.views >= 2",
        "best.quality >= config.sure_quality and viewpoints >= 2",
        ("tests/localization/test_place_evidence.py",),
    ),
    PlantedFault(
        "the noise behind a wall is the wall's other face",
        "localization/surface_map.py",
        "seen = without_slivers(cells, occupied_from, max(2, round(SLIVER / spec.resolution)))",
        "seen = cells",
        ("tests/localization/test_surface_map.py",),
    ),
    PlantedFault(
        "steps of walls at an angle are surfaces of their own",
        "kernels/surfaces.py",
        "if not (left and right):",
        "if True:",
        ("tests/localization/test_surface_map.py",),
    ),
    PlantedFault(
        "the tracker believes its wheels rather than its scans when it is pushed",
        "localization/grid_tracker.py",
        "return self._matcher.explains_more(result, prior, points)",
        "return False",
        PUSHED,
    ),
    PlantedFault(
        "a match anywhere is taken for a push",
        "localization/grid_tracker.py",
        "PUSH_SPEED = 1.5",
        "PUSH_SPEED = 1e9",
        PUSHED,
    ),
    PlantedFault(
        "what is told does not cover a match that is refused",
        "localization/grid_tracker.py",
        "spread = 0.5 * np.outer(away[:3], away[:3])",
        "spread = 0.0 * np.outer(away[:3], away[:3])",
        PUSHED,
    ),
    PlantedFault(
        "while it stands the particle filter matches from its particles alone",
        "localization/particle_filter.py",
        "np.stack([mean, self._carried])",
        "np.stack([mean, mean])",
        PUSHED,
    ),
    PlantedFault(
        "one scan that fits better elsewhere carries the particle filter there",
        "localization/particle_filter.py",
        "reach = NEAR + 3.0",
        "reach = 1e9 + 3.0",
        PUSHED,
    ),
    PlantedFault(
        "one thing proves a place against another that looks alike",
        "localization/relocalizer.py",
        "< (-config.moved_things if leads else config.sure_things):",
        "< (-config.moved_things if leads else 1):",
        ALIKE,
    ),
    PlantedFault(
        "a lead tells more than several things against it",
        "localization/relocalizer.py",
        "(-config.moved_things if leads else",
        "(-1000 if leads else",
        ALIKE,
    ),
    PlantedFault(
        "no number of things tells places apart",
        "localization/relocalizer.py",
        "if 2 * near + far - 2 * against[0] - against[1] < (-config.moved_things if leads else config.sure_things):",
        "if True:",
        ALIKE,
    ),
    PlantedFault(
        "each cell of a thing counts as one",
        "localization/place_evidence.py",
        "return int(ndimage.label(picture, np.ones((3, 3)))[1])",
        "return len(cells)",
        ALIKE,
    ),
    PlantedFault(
        "floor that the map does not know is a place of the map",
        "studies/made_map.py",
        "int(cells[iy, ix]) >= 0",
        "int(cells[iy, ix]) >= -1",
        MADE_STUDY,
    ),
    PlantedFault(
        "a match that surprises by its depth widens the pose alone",
        "localization/grid_tracker.py",
        "grown[3] = min(math.sqrt(3.0), max(1.0, widest / math.sqrt(self._covariance[3, 3])))",
        "grown[3] = 1.0",
        MADE_MAPS,
    ),
    PlantedFault(
        "what is told of the pose knows nothing of the map's bend",
        "nodes/localization.py",
        "= estimate.covariance + bend",
        "= estimate.covariance",
        NODE,
    ),
    PlantedFault(
        "the bend of a map is that of its yaw alone",
        "localization/map_bend.py",
        "float(np.sqrt(0.5 * (squares[0] + squares[1])))",
        "float(np.sqrt(0.5 * squares[2]))",
        BEND,
    ),
    PlantedFault(
        "the truth in a made map ignores that its keyframe is turned",
        "evaluation/made_map_truth.py",
        "turn = told[:, 2] - true[:, 2]",
        "turn = 0.0 * (told[:, 2] - true[:, 2])",
        MADE_TRUTH,
    ),
    PlantedFault(
        "every direction counts as determined",
        "evaluation/determined.py",
        "values >= max(MIN_RETURNS, MIN_RATIO * float(values[-1]))",
        "values >= 0.0",
        MADE_TRUTH,
    ),
    PlantedFault(
        "the EKF's cross term of process noise has the wrong sign",
        "kernels/planar_ekf.py",
        "p[0, 1] += cube * ux * uy",
        "p[0, 1] -= cube * ux * uy",
        EKF_NOISE,
    ),
    PlantedFault(
        "speeds may change four times as fast (variance)",
        "localization/planar_ekf.py",
        "c.speed_noise,",
        "2.0 * c.speed_noise,",
        EKF_NOISE,
    ),
    PlantedFault(
        "wheels that slip keep their weight",
        "kernels/planar_ekf.py",
        "r[a, b] *= (turning if a == 2 else way)",
        "r[a, b] *= 1.0 if turning > 0.0 else (turning if a == 2 else way)",
        (
            "tests/localization/test_planar_ekf_noise.py::test_wheels_that_slip_move_the_robot_a_third_as_far_as_if_they_were_trusted",
        ),
    ),
    PlantedFault(
        "wheels have lost their weight for good once they slipped",
        "kernels/planar_ekf.py",
        "return entry.stamp_ns < entry.slip_until_ns",
        "return entry.slip_until_ns > 0",
        (
            "tests/localization/test_planar_ekf_noise.py::test_wheels_that_slip_move_the_robot_a_third_as_far_as_if_they_were_trusted",
        ),
    ),
    PlantedFault(
        "the EKF's gate refuses nothing",
        "kernels/planar_ekf.py",
        "gate = rules.gate if before.refused < REFUSED_MOST else math.inf",
        "gate = math.inf",
        ("tests/localization/test_planar_ekf.py::test_an_outlier_is_refused_and_a_lasting_change_is_believed",),
    ),
    PlantedFault(
        "the gyroscope's bias has the wrong sign where slip is judged",
        "kernels/planar_ekf.py",
        "difference = entry.z[2] - (entry.gyro_rate - entry.x[6])",
        "difference = entry.z[2] - (entry.gyro_rate + entry.x[6])",
        ("tests/localization/test_planar_ekf_noise.py::test_a_known_bias_of_the_gyroscope_is_no_slip",),
    ),
    PlantedFault(
        "late measurements are put at the end",
        "localization/planar_ekf.py",
        "at = bisect_right(stamps, stamp_ns)",
        "at = len(stamps) if stamp_ns >= stamps[0] else 0",
        EKF,
    ),
    PlantedFault(
        "odometry's noise is that of half the way",
        "localization/motion.py",
        "xy = self.translation**2 * way",
        "xy = self.translation**2 * 0.5 * way",
        HONEST,
    ),
    PlantedFault(
        "an uncertain heading does not make the way uncertain",
        "localization/motion.py",
        "jacobian[0, 2], jacobian[1, 2] = pose.y - moved.y, moved.x - pose.x",
        "jacobian[0, 2], jacobian[1, 2] = 0.0, 0.0",
        HONEST,
    ),
    PlantedFault(
        "the lever of the heading has the wrong sign",
        "localization/motion.py",
        "jacobian[0, 2], jacobian[1, 2] = pose.y - moved.y, moved.x - pose.x",
        "jacobian[0, 2], jacobian[1, 2] = moved.y - pose.y, pose.x - moved.x",
        HONEST,
    ),
    PlantedFault(
        "walls of one map hardly err together",
        "localization/matcher.py",
        "MAP_DOUBT = 2.1",
        "MAP_DOUBT = 0.5",
        HONEST,
    ),
    PlantedFault(
        "the covariance of a match is told without the map's errors",
        "localization/matcher.py",
        "published = (posterior + kept @ match.map_covariance() @ kept.T)[:3, :3]",
        "published = posterior[:3, :3]",
        HONEST,
    ),
    PlantedFault(
        "the covariance that the tracker tells is halved",
        "localization/grid_tracker.py",
        "fusion.map_from_base, fusion.published, result.score",
        "fusion.map_from_base, 0.5 * fusion.published, result.score",
        HONEST,
    ),
    PlantedFault(
        "a heading beyond 180 degrees is not wrapped when a match is fused",
        "localization/matcher.py",
        "innovation[2] = wrap_angle(float(innovation[2]))",
        "innovation[2] = float(innovation[2])",
        HONEST,
    ),
    PlantedFault(
        "the grid tracker believes any match",
        "localization/grid_tracker.py",
        "if fusion.surprise > config.gate:",
        "if fusion.surprise > 1e9:",
        HONEST,
    ),
    PlantedFault(
        "nine tenths of the returns may run through walls",
        "localization/supervisor.py",
        "through_most: float = 0.2",
        "through_most: float = 0.9",
        SUPERVISOR,
    ),
    PlantedFault(
        "a wrong pose is believed ten times as long",
        "localization/supervisor.py",
        "lost_after: float = 1.0",
        "lost_after: float = 10.0",
        SUPERVISOR,
    ),
    PlantedFault(
        "a robot is lost at the first bad scan",
        "localization/supervisor.py",
        "now - self._wrong_since_ns >= config.lost_after * 1e9",
        "now - self._wrong_since_ns >= 0",
        SUPERVISOR,
    ),
    PlantedFault(
        "a pose that explains little is not degraded",
        "localization/supervisor.py",
        "explained_good: float = 0.6",
        "explained_good: float = 0.36",
        SUPERVISOR,
    ),
    PlantedFault(
        "a place that is a little better makes the robot lost",
        "localization/supervisor.py",
        "better_by: float = 0.25",
        "better_by: float = 0.0",
        SUPERVISOR,
    ),
    PlantedFault(
        "searches that were begun before a pose was set are not void",
        "localization/supervisor.py",
        "if result.series != self._series or now is None:",
        "if now is None:",
        ("tests/localization/test_relocalization.py::test_a_search_that_was_overtaken_is_void",),
    ),
    PlantedFault(
        "one view is enough to believe a place",
        "localization/relocalizer.py",
        "best.views >= 2",
        "best.views >= 1",
        FOUND,
    ),
    PlantedFault(
        "places that look alike are not told",
        "localization/relocalizer.py",
        "if lead < config.margin:",
        "if lead < 0.0:",
        FOUND,
    ),
    PlantedFault(
        "half of the headings are not searched",
        "localization/relocalizer.py",
        "angles = np.arange(turns) * (2.0 * math.pi / turns) - math.pi",
        "angles = np.arange(turns) * (math.pi / turns) - math.pi",
        FOUND,
    ),
    PlantedFault(
        "turn rates are taken about the body's own axis",
        "localization/odometry.py",
        "yaw_rate = (wy * math.sin(roll) + wz * math.cos(roll)) / max(math.cos(pitch), 0.5)",
        "yaw_rate = wz",
        ODOMETRY,
    ),
    PlantedFault(
        "the turning of wheels counts fully beside a gyroscope",
        "localization/odometry.py",
        "doubt = (config.turn_doubt * turning) ** 2 + (config.way_doubt * speed) ** 2 if has_imu else 0.0",
        "doubt = 0.0",
        ODOMETRY,
    ),
    PlantedFault(
        "a pose of the wheels that was set is driven",
        "localization/odometry.py",
        "            twist = told\n",
        "            pass\n",
        ODOMETRY,
    ),
    PlantedFault(
        "a reflector is learned from one view",
        "localization/reflectors.py",
        "keep = self._views >= self._least_views",
        "keep = self._views >= 1",
        ("tests/localization/test_relocalization.py::test_a_glint_seen_once_is_not_learned_as_a_reflector",),
    ),
)
