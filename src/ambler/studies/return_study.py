"""One run from the unknown to the daily round: a robot explores a drawn site, comes home and saves what it knows; another process switches it on elsewhere in
the site, it finds out where it is in what was saved, and drives to way-points. Nobody lends a hand, and the truth judges."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import GROUND_PROFILE, robot_config
from ambler.apps.run_folder import RunFolder
from ambler.apps.saved_site import SavedSite, load_site
from ambler.apps.site_judgement import ground_rules
from ambler.core.errors import BadInputError
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.proportions import wilson_interval
from ambler.evaluation.return_quality import ExploredTruth, ReturnQuality, WayPoint, judge_return
from ambler.settings.profiles import merge
from ambler.sim.reachable_ground import reachable_ground
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world
from ambler.studies.demo_process import run_demo, run_verb
from ambler.studies.site_places import draw_start, draw_way_points, free_pieces
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

TOLERANCE = 0.15  # metres from a way-point at which it is reached: that of `ambler navigate`
SLACK = 0.1  # metres by which the truth may exceed that: the error of localization
ROOM = 0.1  # metres beyond what the planner keeps free around a way-point: a cell of the map
ANOTHER_DAY = 1  # added to the seed of the noise


@dataclass(frozen=True, slots=True)
class ReturnCase:
    """A robot in a drawn site, sent to `way_points` when it comes back. `exploring` and `returning` are further words of `ambler demo` and `ambler navigate`."""

    seed: int
    kind: str
    robot: str
    way_points: int = 5
    exploring: tuple[str, ...] = ()
    returning: tuple[str, ...] = ()
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.kind}-{self.seed}-{self.robot}"

    @property
    def world(self) -> str:
        """The name of the site."""
        return f"{self.kind}-{self.seed}"


def return_study(cases: Sequence[ReturnCase]) -> Study[ReturnCase]:
    """Return the study of these sites."""
    return Study("return", cases, run_case, line)


def run_case(case: ReturnCase, folder: Path) -> dict[str, Any]:
    """Explore, draw where the robot is switched on and sent to, come back, judge."""
    explored = run_demo(folder / "explore", case.world, case.robot, case.seed, case.exploring, case.settings)
    fields: dict[str, Any] = {
        "explored": explored.get("ended"),
        "explored_text": explored.get("text") or explored.get("why"),
        "explored_home": bool(explored.get("is_home")),
        "explored_collisions": explored.get("collisions"),
        "explored_seconds": explored.get("sim_seconds"),
        "explored_surface_ratio": explored.get("surface_coverage_ratio"),
        "levels": explored.get("levels"),
        "ended": "not_explored",
    }
    if "recording" not in explored:
        return fields
    first = RunFolder(Path(explored["recording"]).parent)
    try:
        truth = ExploredTruth.of_recording(first.recording)
        site = load_site(first.map_stem.with_suffix(".yaml"))
        start, goals = draw_places(case, site)
    except BadInputError as error:
        return {**fields, "why": str(error)}
    words = (
        *("--map", str(first.root), "--lost", "--may-turn", f"--start={_word(start)}", *case.returning, "--"),
        *(_word(goal) + (f"@{level}" if len(site.levels) > 1 else "") for goal, level in goals),
    )
    seed = case.seed + ANOTHER_DAY
    returned = run_verb("navigate", folder / "return", case.world, case.robot, seed, words, case.settings)
    fields |= {"ended": returned.get("ended"), "text": returned.get("text") or returned.get("why")}
    if "recording" not in returned:
        return fields
    way_points = [WayPoint(goal, _height(site, goal, level)) for goal, level in goals]
    second = RunFolder(Path(returned["recording"]).parent)
    quality = judge_return(second.recording, second.log, truth, way_points)
    return {**fields, **told(quality, len(goals)), "sim_seconds": returned.get("sim_seconds")}


def draw_places(case: ReturnCase, site: SavedSite) -> tuple[SE2, list[tuple[SE2, int]]]:
    """Return where the robot is switched on, and its way-points with their levels, in the frame of the map."""
    rng = np.random.default_rng([case.seed, 93])
    world, model = load_world(case.world), robot_named(case.robot).model
    ground = site.ground()
    pieces = free_pieces(ground, _room(model, case.settings))
    reached = reachable_ground(world, world.start, ground_rules(model))
    height = float(world.ground_at(np.array([[world.start.x, world.start.y]]))[0])
    start, piece = draw_start(ground, pieces, reached, world, SE3.from_se2(world.start, height), rng)
    return start, draw_way_points(ground, pieces, piece, case.way_points, rng)


def told(quality: ReturnQuality, way_points: int) -> dict[str, Any]:
    """Return what was judged of a return as plain values."""
    errors = [arrival.error for arrival in quality.arrivals]
    return {
        "found_s": quality.found_s,
        "found_m": quality.found_m,
        "found_deg": quality.found_deg,
        "track_rms_m": quality.track_rms_m,
        "track_max_m": quality.track_max_m,
        "wrong_poses": quality.wrong,
        "way_points": way_points,
        "way_points_reached": sum(arrival.is_there(TOLERANCE + SLACK) for arrival in quality.arrivals),
        "way_points_ended": ",".join(arrival.code.lower() for arrival in quality.arrivals),
        "way_point_error_max_m": max(errors, default=None),
        "collisions": quality.collisions,
        "path_length_m": quality.path_length_m,
    }


def has_returned(result: dict[str, Any]) -> bool:
    """Say whether a robot found its place, told no wrong one, and reached all way-points without a collision."""
    is_placed = result.get("found_s") is not None and result.get("wrong_poses") == 0
    has_all = result.get("way_points_reached") == result.get("way_points") and result.get("way_points", 0) > 0
    return is_placed and has_all and result.get("collisions") == 0


def is_done(result: dict[str, Any]) -> bool:
    """Say whether all went well from the first step: explored with proof, home, no collision, and returned."""
    is_explored = result.get("explored") == "finished" and bool(result.get("explored_home"))
    return is_explored and result.get("explored_collisions") == 0 and has_returned(result)


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields: counts with intervals, medians and worst values, each run's own, and which bars are met."""
    done = sum(map(is_done, results))
    low, high = wilson_interval(done, len(results))
    fields: dict[str, Any] = {
        "runs": len(results),
        "done": done,
        "done_ratio_low_95": low,
        "done_ratio_high_95": high,
        "explored": sum(r.get("explored") == "finished" and bool(r.get("explored_home")) for r in results),
        "relocalized": sum(r.get("found_s") is not None and r.get("wrong_poses") == 0 for r in results),
        "returned": sum(map(has_returned, results)),
        "way_points": sum(r.get("way_points") or 0 for r in results),
        "way_points_reached": sum(r.get("way_points_reached") or 0 for r in results),
        "collisions": sum((r.get("collisions") or 0) + (r.get("explored_collisions") or 0) for r in results),
    }
    for name in ("found_s", "found_m", "found_deg", "track_rms_m", "track_max_m", "way_point_error_max_m"):
        values = [float(r[name]) for r in results if r.get(name) is not None]
        fields[f"{name}_median"] = statistics.median(values) if values else None
        fields[f"{name}_worst"] = max(values, default=None)
    own = ("explored", "explored_home", "explored_seconds", "explored_surface_ratio", "explored_collisions", "levels")
    back = ("ended", "found_s", "found_m", "found_deg", "wrong_poses", "track_rms_m", "track_max_m")
    there = ("way_points_reached", "way_points_ended", "way_point_error_max_m", "collisions", "path_length_m")
    for r in results:
        fields |= {f"run.{r['label']}.{what}": r.get(what) for what in (*own, *back, *there)}
    fields |= {"bars.done": done == len(results), "bars.collisions": fields["collisions"] == 0}
    return fields


def line(result: dict[str, Any]) -> str:
    """Say in a few words how a run went."""
    found, off = result.get("found_s"), result.get("found_m")
    place = "did not find out where it was" if found is None else f"found itself after {found:.1f} s, {off:.2f} m off"
    reached = f"{result.get('way_points_reached', 0)} of {result.get('way_points', 0)} way-points"
    hits = (result.get("explored_collisions") or 0) + (result.get("collisions") or 0)
    return f"explored: {result.get('explored')}; {place}; {reached}; {hits} collisions"


def _room(robot: RobotModel, settings: StudySettings) -> float:
    """Return the radius of free ground that a way-point needs: what the planner keeps, and a cell."""
    profile = merge(GROUND_PROFILE, dict(settings.profile))
    kept = robot_config(robot, profile, has_map=True).global_costmap.inflation.inscribed_radius
    return (robot.inscribed_radius if kept is None else kept) + ROOM


def _height(site: SavedSite, place: SE2, level: int) -> float:
    height = site.levels[level].height_at(place.x, place.y)
    assert height is not None  # way-points are drawn where it is known
    return height


def _word(pose: SE2) -> str:
    """Return a pose as the command line takes it."""
    return f"{pose.x:.3f},{pose.y:.3f},{math.degrees(pose.yaw):.2f}"
