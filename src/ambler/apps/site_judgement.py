"""Judges a map of ground against the world's own geometry: the ground that the robot reaches, and the surfaces that can be seen from there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ambler.apps.simulated import SimulatedRobot
from ambler.core.errors import BadInputError
from ambler.core.robot import RobotModel, SensorKind
from ambler.evaluation.site_picture import draw_site
from ambler.evaluation.site_quality import SiteQuality, SiteRecord, aligned, judge_site, read_site
from ambler.evaluation.site_tour import known_tour_length
from ambler.evaluation.station_quality import StationQuality, judge_stations
from ambler.sim.reachable_ground import GroundRules, ReachableGround, reachable_ground, visible_surface
from ambler.wire.ground_files import SUFFIX, load_levels, load_passages
from ambler.wire.station_files import TABLE_SUFFIX, load_stations

CLEARANCE = 0.15  # metres beside the robot on a way that it must take, as on level floors
SITE_PICTURE = "site.png"
SIGHT = 10.0  # metres from which a surface counts as visible


def site_quality(robot: SimulatedRobot) -> SiteQuality | None:
    """Compare a robot's levels of ground and its clouds with the truth, and draw them; None when it saved none, or never knew where it was."""
    stem = robot.folder.map_stem
    file = stem.with_name(stem.name + SUFFIX)
    if not file.exists():
        return None
    height = _eye(robot.model)
    ground = reachable_ground(robot.scene.world, robot.scene.start, ground_rules(robot.model))
    surface = visible_surface(ground, height, SIGHT)
    try:
        record = read_site(robot.folder.recording)
        quality = judge_site(record, load_levels(file), ground, surface.points)
        way = np.array([pose.translation for pose in record.poses]).reshape(-1, 3)
        draw_site(robot.folder.root / SITE_PICTURE, load_levels(file), way, load_passages(file))
    except BadInputError:
        return None
    tour = known_tour_length(ground, surface, np.array(record.true_poses[0].translation))
    return replace(quality, known_tour=tour, stations=_station_quality(robot, record, ground))


def _station_quality(robot: SimulatedRobot, record: SiteRecord, ground: ReachableGround) -> StationQuality | None:
    """Judge the stations that were saved; None where none were wanted, or they could not be saved."""
    stem = robot.folder.map_stem
    if not robot.config.holds_stations or not stem.with_name(stem.name + TABLE_SUFFIX).exists():
        return None
    truth = (record.true_ns, record.true_poses)
    return judge_stations(load_stations(stem), aligned(record), truth, ground.scene)


def ground_rules(robot: RobotModel) -> GroundRules:
    """Return what ground a robot must be able to cross."""
    clearance = max(robot.body_height, _eye(robot)) + 0.1
    return GroundRules(robot.inscribed_radius + CLEARANCE, clearance)


def _eye(robot: RobotModel) -> float:
    """Return how high the first LiDAR is above the base, m."""
    return robot.of_kind(SensorKind.CLOUD)[0].base_from_sensor.translation[2]


def site_fields(quality: SiteQuality | None) -> dict[str, Any]:
    """Return the numbers as they go into JSON; what is not known is None."""
    if quality is None:
        names = ("reachable_coverage_ratio", "false_free_ratio", "surface_coverage_ratio", "levels", "known_tour_m")
        return dict.fromkeys((*names, "ate_rms_m", "ate_max_m", "ate_unaligned_rms_m", "ate_unaligned_max_m"))
    return {
        "reachable_coverage_ratio": quality.ground_coverage,
        "false_free_ratio": quality.false_ground,
        "surface_coverage_ratio": quality.surface_coverage,
        "levels": quality.levels,
        "reachable_m2": quality.reachable_m2,
        "ate_rms_m": quality.error.ate_rms_m,
        "ate_max_m": quality.error.ate_max_m,
        "ate_unaligned_rms_m": quality.error.start_rms_m,
        "ate_unaligned_max_m": quality.error.start_max_m,
        "height_range_m": quality.height_range,
        "known_tour_m": quality.known_tour,
        **({} if quality.stations is None else quality.stations.fields()),
    }
