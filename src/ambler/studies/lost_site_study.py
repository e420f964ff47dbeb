"""A robot is switched on at drawn places of drawn sites whose cloud is saved, and told nothing: it stands, looks, and turns on the spot as `ambler navigate --lost --may-turn` does, until it says where it is.

Judged by the truth: right, wrong (farther off than 0.5 m or 5°), or unsure at the end. No odometry is run and nothing drives, so that a site has sixty places in minutes.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ambler.apps.config import GROUND_PROFILE, robot_config
from ambler.apps.site_judgement import ground_rules
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.proportions import wilson_interval
from ambler.lio.cloud_localizer import CloudLocalizer
from ambler.lio.cloud_map import CloudMap
from ambler.lio.cloud_match import apart
from ambler.lio.config import LioConfig
from ambler.settings.profiles import merge
from ambler.sim.reachable_ground import reachable_ground
from ambler.sim.robots import robot_named
from ambler.sim.scene import build_scene
from ambler.sim.solids import Solid, WorldSpec
from ambler.sim.world_file import load_world
from ambler.studies.standing_scans import BEGIN_NS, Stand, StandingRobot, leaning, toured_cloud
from ambler.studies.study import CRASHED, Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

FALSE_M, FALSE_DEG = 0.5, 5.0
REST, TURN, TURN_EVERY = (
    1.0,
    0.8,
    1.5,
)  # seconds before the first turn; rad, seconds from a turn to the next: those of the operator
LOOK = 0.8  # seconds for which it looks between two turns
PUSHED = (0.5, 4.0)  # metres that a thing is moved by on another day
CLEAR = 2.5  # metres that a start keeps from what was moved
THINGS = ("car", "cabin", "trunk", "crown", "pole")
UNSURE_MOST = 0.1  # of the starts


@dataclass(frozen=True, slots=True)
class LostSiteCase:
    """`starts` places of one site, `moved` of whose things stand elsewhere or are gone since it was saved; each search may take `seconds`."""

    seed: int
    kind: str
    robot: str
    starts: int = 60
    moved: float = 0.0
    seconds: float = 20.0
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.kind}-{self.seed}-{self.robot}"


def lost_site_study(cases: Sequence[LostSiteCase]) -> Study[LostSiteCase]:
    """Return the study of these sites."""
    return Study("lost3d", cases, run_case, line)


def run_case(case: LostSiteCase, folder: Path) -> dict[str, Any]:
    """Save the cloud of a site, move things, and be lost again and again."""
    robot, world = robot_named(case.robot), load_world(f"{case.kind}-{case.seed}")
    rng = np.random.default_rng([case.seed, 95])
    ground = reachable_ground(world, world.start, ground_rules(robot.model))
    lio = robot_config(robot.model, merge(GROUND_PROFILE, dict(case.settings.profile)), has_map=True).lio
    world_from_map = SE3.from_se2(world.start, 0.0)
    cloud = world_from_map.inverse().transform(toured_cloud(StandingRobot(robot, ground, case.seed), lio, rng))
    saved = CloudMap(cloud, lio.localize.map)
    changed, moved = move_things(world, case.moved, rng)
    today = StandingRobot(robot, replace(ground, scene=build_scene(changed)), case.seed + 1)
    places = ground.places()
    if len(moved):
        places = places[cKDTree(moved).query(places[:, :2])[0] > CLEAR]
    told = [
        be_lost(today, saved, world_from_map, draw_stand(places, number, case), lio, case.seconds, number)
        for number in range(case.starts)
    ]
    return {"map_points": len(saved.points), "levels": _levels(places), **_columns(told)}


@dataclass(frozen=True, slots=True)
class Lost:
    """What came of one start: `ended` "right", "wrong" or "unsure"; seconds until a pose was told, and by how much it was off."""

    ended: str
    found_s: float | None
    found_m: float | None
    found_deg: float | None


def be_lost(
    robot: StandingRobot,
    saved: CloudMap,
    world_from_map: SE3,
    stand: Stand,
    lio: LioConfig,
    seconds: float,
    number: int,
) -> Lost:
    """Stand, look and turn until a pose is told."""
    odom_from_world = leaning(np.random.default_rng([number, 97]))
    localizer = CloudLocalizer(saved, lio.localize)
    for k in range(int(seconds / robot.period)):
        after = k * robot.period
        turns = max(0, math.ceil((after - REST) / TURN_EVERY)) if after > REST else 0
        if turns and after - REST - (turns - 1) * TURN_EVERY < TURN_EVERY - LOOK:
            continue  # it turns
        here = replace(stand, yaw=stand.yaw + turns * TURN)
        scan = robot.seen(here, odom_from_world, BEGIN_NS + round(after * 1e9), lio.localize.match.fine_cell)
        pose = localizer.update(scan)
        if pose.map_from_imu is not None:
            truth = world_from_map.inverse() @ robot.world_from_base(here) @ robot.base_from_lidar
            off, turn = apart(truth, pose.map_from_imu)
            return judged(after, off, math.degrees(turn))
    return Lost("unsure", None, None, None)


def judged(after: float, off_m: float, off_deg: float) -> Lost:
    """Say whether a pose that was told is that of the right place."""
    return Lost("wrong" if off_m > FALSE_M or off_deg > FALSE_DEG else "right", after, off_m, off_deg)


def draw_stand(places: NDArray[np.float64], number: int, case: LostSiteCase) -> Stand:
    """Draw a place of the ground that the robot reaches, on any level, and a heading."""
    rng = np.random.default_rng([case.seed, 96, number])
    x, y, z = places[int(rng.integers(len(places)))].tolist()
    return Stand((x, y, z), float(rng.uniform(-math.pi, math.pi)))


def move_things(world: WorldSpec, share: float, rng: np.random.Generator) -> tuple[WorldSpec, NDArray[np.float64]]:
    """Return a world in which a share of the things (a car and its cabin are one) is gone, half of them, or was moved and turned, and where these are now, (N, 2)."""
    things: dict[tuple[float, float, bool], list[int]] = {}
    for k, solid in enumerate(world.solids):
        if solid.name.partition("-")[0] in THINGS:
            pose = solid.world_from_solid
            things.setdefault((pose.x, pose.y, solid.z_min > 2.5), []).append(k)
    solids: list[Solid | None] = list(world.solids)
    moved: list[tuple[float, float]] = []
    groups = list(things.values())
    for g in rng.permutation(len(groups))[: round(share * len(groups))].tolist():
        is_gone = rng.random() < 0.5
        first = world.solids[groups[g][0]].world_from_solid
        far, bearing = float(rng.uniform(*PUSHED)), float(rng.uniform(-math.pi, math.pi))
        there = SE2(first.x + far * math.cos(bearing), first.y + far * math.sin(bearing), float(rng.uniform(0.0, 3.0)))
        for k in groups[g]:
            solids[k] = None if is_gone else replace(world.solids[k], world_from_solid=there)
        moved += [] if is_gone else [(there.x, there.y)]
    kept = tuple(solid for solid in solids if solid is not None)
    return replace(world, solids=kept), np.array(moved).reshape(-1, 2)


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields over all sites, each site's own counts, and which bars are met."""
    whole = [r for r in results if r.get("ended") != CRASHED]
    ended = [each for r in whole for each in r["outcomes"]]
    wrong = ended.count("wrong")
    fields: dict[str, Any] = {
        "sites": len(results),
        "starts": len(ended),
        "right": ended.count("right"),
        "wrong": wrong,
        "wrong_ratio_high_95": wilson_interval(wrong, len(ended))[1],
        "unsure": ended.count("unsure"),
    }
    for name in ("found_s", "found_m", "found_deg"):
        values = [value for r in whole for value in r[name] if value is not None]
        fields[f"{name}_median"] = statistics.median(values) if values else None
        fields[f"{name}_worst"] = max(values, default=None)
    for r in whole:
        fields |= {f"{r['label']}.{what}": r["outcomes"].count(what) for what in ("right", "wrong", "unsure")}
        fields |= {f"{r['label']}.{what}": r[what] for what in ("map_points", "levels")}
    is_whole = len(whole) == len(results) and bool(ended)
    fields |= {
        "bars.wrong": is_whole and wrong == 0,
        "bars.unsure": is_whole and fields["unsure"] <= UNSURE_MOST * len(ended),
    }
    return fields


def line(result: dict[str, Any]) -> str:
    """Say in a few words how a site went."""
    counts = ", ".join(f"{result['outcomes'].count(what)} {what}" for what in ("right", "wrong", "unsure"))
    found = [value for value in result["found_s"] if value is not None]
    return f"{counts}; found after {statistics.median(found) if found else math.nan:.1f} s"


def _columns(told: Sequence[Lost]) -> dict[str, Any]:
    return {
        "outcomes": [each.ended for each in told],
        **{name: [getattr(each, name) for each in told] for name in ("found_s", "found_m", "found_deg")},
    }


def _levels(places: NDArray[np.float64]) -> int:
    """Return how many heights 2 m apart the places lie on: the levels of a garage."""
    return len(np.unique(np.round(places[:, 2] / 2.0)))
