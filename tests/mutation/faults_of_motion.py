"""Faults of costmaps, planning, control, exploration and docking."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

INFLATION = ("tests/costmap/test_inflation.py",)
LAYERS = ("tests/costmap/test_layers.py",)
PLANNER = ("tests/planning/test_grid_planner.py",)
EXPLORE = ("tests/missions/test_explore.py",)
SURVEY = ("tests/exploration/test_survey.py",)
NAVIGATE = ("tests/missions/test_navigate.py",)
JUDGES = ("tests/control/test_judges.py",)
TRACKER = ("tests/docking/test_tracker.py",)
DOCK = ("tests/missions/test_dock.py",)
YIELDING = ("tests/control/test_yielding.py",)
MOVERS = ("tests/perception/test_mover_tracker.py",)
DATABASE = ("tests/docking/test_database.py",)
DETECTORS = ("tests/docking/test_detectors.py",)

MOTION = (
    PlantedFault(
        "nobody turns round",
        "control/yielding.py",
        "ways = [(vx, vy), (-vx, -vy)] if is_walking",
        "ways = [(vx, vy)] if is_walking",
        YIELDING,
    ),
    PlantedFault(
        "the robot stands only when it is touched",
        "control/yielding.py",
        "calm: float = 0.65",
        "calm: float = 0.1",
        YIELDING,
    ),
    PlantedFault(
        "robots pass on the left",
        "control/passing.py",
        "np.stack((velocity[:, 1], -velocity[:, 0]), axis=1)",
        "np.stack((-velocity[:, 1], velocity[:, 0]), axis=1)",
        YIELDING,
    ),
    PlantedFault(
        "a robot gets out of the way to where it cannot go",
        "control/yielding.py",
        "if free_slide(float(self._pose[2]) + math.atan2(vy, vx), c.evade_length) >= c.evade_length - 1e-6:",
        "if True:",
        YIELDING,
    ),
    PlantedFault(
        "who stands still is forgotten",
        "perception/mover_tracker.py",
        "near = came[np.hypot(*(came - expected).T) <= 0.7 * c.gate] if track.is_mover else came[:0]",
        "near = came[:0]",
        MOVERS,
    ),
    PlantedFault(
        "the automatic inflation ends at the robot's corners: paths keep no distance",
        "costmap/inflation.py",
        "robot.circumscribed_radius + 0.5 if config.radius is None",
        "robot.circumscribed_radius if config.radius is None",
        INFLATION,
    ),
    PlantedFault(
        "costs do not know the inscribed radius",
        "costmap/inflation.py",
        "table[d <= inscribed_radius + 1e-9] = COST_INSCRIBED",
        "table[d <= 0.5 * inscribed_radius + 1e-9] = COST_INSCRIBED",
        INFLATION,
    ),
    PlantedFault(
        "a changed box is inflated without its surroundings",
        "costmap/inflation.py",
        "max(0, y0 - r), min(height, y1 + r), max(0, x0 - r), min(width, x1 + r)",
        "y0, y1, x0, x1",
        INFLATION,
    ),
    PlantedFault(
        "the planner goes through cells within the inscribed radius",
        "planning/grid_planner.py",
        "lethal_from: int = COST_INSCRIBED",
        "lethal_from: int = COST_INSCRIBED + 1",
        PLANNER,
    ),
    PlantedFault(
        "the planner does not mind how near obstacles are",
        "planning/grid_planner.py",
        "factor: float = 0.8",
        "factor: float = 0.0",
        PLANNER,
    ),
    PlantedFault(
        "unknown cells are free to the planner",
        "planning/grid_planner.py",
        "table[COST_UNKNOWN] = dearest if config.is_unknown_allowed else 0",
        "table[COST_UNKNOWN] = dearest",
        PLANNER,
    ),
    PlantedFault(
        "a substitute of a goal says that it lies at the goal",
        "planning/grid_planner.py",
        "distance = 0.0 if is_exact else float(",
        "distance = 0.0 * float(",
        PLANNER,
    ),
    PlantedFault(
        "the length of a path is told in cells",
        "planning/grid_planner.py",
        "metres = cost * spec.resolution / (2.0",
        "metres = cost / (2.0",
        PLANNER,
    ),
    PlantedFault(
        "paths face backwards",
        "planning/grid_planner.py",
        "np.arctan2(leg[:, 1], leg[:, 0])[which]",
        "np.arctan2(-leg[:, 1], -leg[:, 0])[which]",
        PLANNER,
    ),
    PlantedFault(
        "a boxed-in robot has finished exploring",
        "missions/explore.py",
        "if self._now.reachable_area < self.config.min_reachable_area:",
        "if self._now.reachable_area < 0.0:",
        EXPLORE,
    ),
    PlantedFault(
        "an exploration ends without looking once more",
        "missions/explore.py",
        "        if not self._has_swept:\n            return self._sweep(view)\n",
        "",
        EXPLORE,
    ),
    PlantedFault(
        "a robot whose drives all fail is never stuck",
        "missions/explore.py",
        "if self._failures >= self.config.stuck_failures:",
        "if self._failures >= 10 * self.config.stuck_failures:",
        EXPLORE,
    ),
    PlantedFault(
        "an exploration that may not move never ends",
        "missions/explore.py",
        "now_ns - self._held_ns > self.config.held_timeout * 1e9",
        "now_ns - self._held_ns > self.config.held_timeout * 1e12",
        EXPLORE,
    ),
    PlantedFault(
        "a drive that does not get on goes on for ever",
        "missions/explore.py",
        "if view.now_ns - min(self._progress_ns, self._still_ns) > self.config.progress_timeout * 1e9:",
        "if view.now_ns - min(self._progress_ns, self._still_ns) > self.config.progress_timeout * 1e10:",
        EXPLORE,
    ),
    PlantedFault(
        "any end of the drive home counts as home",
        "missions/explore.py",
        'if code == "SUCCEEDED" or (code == NEAREST_REACHED and self._is_near_home(view)):',
        "if code is not None:",
        EXPLORE,
    ),
    PlantedFault(
        "a robot changes its target for any saving",
        "exploration/choice.py",
        "is_better = saving >= max(config.hysteresis * left, config.min_saving)",
        "is_better = saving > 0.0",
        EXPLORE,
    ),
    PlantedFault(
        "frontiers that were refused are open again at once",
        "exploration/memory.py",
        "if not is_refused or self._has_changed(refusal, spec, occupancy):",
        "if True:",
        EXPLORE,
    ),
    PlantedFault(
        "frontiers outside of the boundary are open",
        "exploration/survey.py",
        "if boundary and not is_inside(boundary, frontier.centroid):",
        "if False:",
        SURVEY,
    ),
    PlantedFault(
        "the reachable area is that of the known map",
        "exploration/survey.py",
        "reachable = float(np.count_nonzero(np.isfinite(distance))) * cell_area",
        "reachable = known",
        SURVEY,
    ),
    PlantedFault(
        "a goal is reached while the robot still moves",
        "control/checkers.py",
        "return self.may_stop and is_at_rest",
        "return self.may_stop",
        JUDGES,
    ),
    PlantedFault(
        "a goal's heading does not count",
        "control/checkers.py",
        "self.may_stop = self.is_position_reached and yaw_error <= self._yaw_tolerance",
        "self.may_stop = self.is_position_reached",
        JUDGES,
    ),
    PlantedFault(
        "a robot that stands makes progress for ever",
        "control/checkers.py",
        "return now_ns - self._since_ns <= self._patience_ns",
        "return True",
        JUDGES,
    ),
    PlantedFault(
        "recoveries are never given up",
        "missions/recovery.py",
        "        self._index += 1\n",
        "        self._index = (self._index + 1) % len(self._steps)\n",
        NAVIGATE,
    ),
    PlantedFault(
        "the dock tracker's gate lets sightings pass that are 7 sigma off",
        "docking/tracker.py",
        "gate: float = 16.3",
        "gate: float = 60.0",
        TRACKER,
    ),
    PlantedFault(
        "repeated errors of pictures average out: no floor",
        "docking/tracker.py",
        "place, turn = self.config.floor",
        "place, turn = 0.0, 0.0",
        TRACKER,
    ),
    PlantedFault(
        "outliers 35 cm apart agree",
        "docking/tracker.py",
        "o.distance_to(seen) < 0.05",
        "o.distance_to(seen) < 0.35",
        TRACKER,
    ),
    PlantedFault(
        "a dock that was not seen for a minute is still told",
        "docking/tracker.py",
        "age > self.config.max_age or",
        "age > 10.0 * self.config.max_age or",
        TRACKER,
    ),
    PlantedFault(
        "odometry's drift does not reach the dock's pose",
        "docking/tracker.py",
        "self._covariance = self._covariance + lever @ growth @ lever.T",
        "self._covariance = self._covariance + 0.0 * (lever @ growth @ lever.T)",
        TRACKER,
    ),
    PlantedFault(
        "the lever of a turn has the wrong sign",
        "docking/covariance.py",
        "[[c, -s, pose.y], [s, c, -pose.x], [0.0, 0.0, 1.0]]",
        "[[c, -s, -pose.y], [s, c, pose.x], [0.0, 0.0, 1.0]]",
        DETECTORS + TRACKER,
    ),
    PlantedFault(
        "a dock's pose is replaced by every docking",
        "docking/database.py",
        "share = 1.0 / (min(dock.dockings, LEARNED) + 1)",
        "share = 1.0",
        DATABASE,
    ),
    PlantedFault(
        "a docking may contradict the file by metres",
        "docking/database.py",
        "if away > JUMP[0] or abs(turn) > JUMP[1]:",
        "if away > 10.0 * JUMP[0] or abs(turn) > JUMP[1]:",
        DATABASE,
    ),
    PlantedFault(
        "a robot that does not charge is docked",
        "missions/dock.py",
        "            return bool(view.is_charging)\n        return bool(view.has_contact)",
        "            return bool(view.has_contact)\n        return bool(view.has_contact)",
        DOCK,
    ),
    PlantedFault(
        "a robot askew before the contact goes on",
        "missions/dock.py",
        "if left < c.limit_at and (abs(y) > c.limit_y or abs(yaw) > c.limit_yaw):",
        "if False:",
        DOCK,
    ),
    PlantedFault(
        "the robot goes in although the dock vanished",
        "missions/dock.py",
        "if is_old and (left > c.blind_distance or track.travel > c.blind_push):",
        "if False:",
        DOCK,
    ),
    PlantedFault(
        "docking is tried for ever",
        "missions/dock.py",
        "if self.attempts >= self.config.attempts or self._now.is_hopeless:",
        "if self._now.is_hopeless:",
        DOCK,
    ),
    PlantedFault(
        "contact need not last",
        "missions/dock.py",
        "if self._now.contact_seconds >= c.contact_time:",
        "if self._now.contact_seconds > 0.0:",
        DOCK,
    ),
)
