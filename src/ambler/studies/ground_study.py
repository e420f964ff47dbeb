"""Ground that nobody has seen, by simulated Mid-360s whose mounts are off: false obstacles on flat floors, drops, kerbs, rows of kerb
stones and slopes.

A robot drives straight towards an edge or a slope and stops `STOP` metres before it. What it then knows is judged in the corridor that its
body would sweep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import recorded_config
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.proportions import wilson_interval
from ambler.evaluation.terrain_picture import save_terrain_picture
from ambler.perception.terrain import Terrain, TerrainAnalysis
from ambler.perception.terrain_config import TerrainConfig
from ambler.robots.spatial_robots import go2, mecanum
from ambler.sim.sensors import named_generator
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.studies.made_ground import LEVEL, Rover, half_plane, made, ramp, slab
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

ROBOTS = {"mecanum": mecanum, "go2": go2}
KINDS = ("flat", "drop", "kerb", "stones", "slope")
HEIGHT_OFF, ANGLE_OFF = 0.05, math.radians(3.0)  # what a mount is off by at most
STOP = 1.5  # metres before the edge
KERB, SLOPE = 0.12, math.radians(15.0)
EDGES = ("drop", "kerb", "stones")
DROP = (0.08, 0.6)
STONE = (0.1, 0.4)  # width of a row of kerb stones with the same floor on both sides
SPEED = 0.8
FALSE_MOST = 0.001


@dataclass(frozen=True, slots=True)
class GroundCase:
    """A robot before a kind of ground, both drawn by the seed."""

    seed: int
    robot: str
    kind: str
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.robot}-{self.kind}-{self.seed}"


def ground_study(seeds: Sequence[int], settings: StudySettings = DEFAULTS) -> Study[GroundCase]:
    """Return the study of all robots and kinds of ground for these seeds; raises BadInputError for settings that no robot takes."""
    recorded_config(settings.profile)
    cases = [GroundCase(seed, robot, kind, settings) for seed in seeds for robot in ROBOTS for kind in KINDS]
    return Study("ground", cases, run_case, _line)


def run_case(case: GroundCase, folder: Path) -> dict[str, Any]:
    """Drive and judge; leaves a picture in the folder."""
    rng = named_generator(case.seed, f"ground-{case.kind}")
    model = ROBOTS[case.robot]().model
    world, edge, angle, drawn = _draw(case.kind, rng)
    height, roll, pitch = (float(rng.uniform(-most, most)) for most in (HEIGHT_OFF, ANGLE_OFF, ANGLE_OFF))
    rover = Rover(world, model, case.seed, SE3.from_rpy((0.0, 0.0, height), roll, pitch, 0.0))
    config = recorded_config(case.settings.profile).ground.for_robot(model)
    analysis = TerrainAnalysis(config)
    y = float(rng.uniform(-0.5, 0.5))
    front = float(model.footprint[:, 0].max())
    places = [(x, y, 0.0, 0.0) for x in np.arange(0.0, edge - STOP - front, 0.1 * SPEED).tolist()]
    seen_at = None
    terrain = analysis.terrain()
    for place in places:
        terrain = rover.feed(analysis, [place])
        if seen_at is None and case.kind in EDGES and _is_closed(terrain, config, model, edge, angle, y):
            seen_at = edge - place[0] - front
    way = np.array([place[:2] for place in places])
    title = f"{case.label}: {drawn}"
    save_terrain_picture(folder / "terrain.png", terrain.points, config.step, way, title)
    told = {
        "drawn": drawn,
        "height_off_m": height,
        "roll_off_deg": math.degrees(roll),
        "pitch_off_deg": math.degrees(pitch),
    }
    return told | _judged(case.kind, terrain, config, model, edge, angle, y, seen_at)


def _draw(kind: str, rng: np.random.Generator) -> tuple[WorldSpec, float, float, str]:
    """Return a world, where its edge or the foot of its slope crosses the x axis, by how much the edge is turned, and what it is."""
    edge, angle = float(rng.uniform(7.0, 11.0)), float(rng.uniform(-0.4, 0.4))
    clutter = []
    for _ in range(int(rng.integers(0, 5))):
        x, y = float(rng.uniform(-6.0, edge)), float(rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 6.0))
        clutter.append(
            slab(x, x + float(rng.uniform(0.2, 1.0)), y, y + float(rng.uniform(0.2, 1.0)), float(rng.uniform(0.4, 2.0)))
        )
    floor = half_plane(edge, angle, 0.0, is_beyond=False)
    if kind == "flat":
        return made(floor, half_plane(edge, angle, 0.0, is_beyond=True)), edge, angle, "flat floor"
    if kind == "drop":
        depth = float(rng.uniform(*DROP))
        return (
            made(floor, half_plane(edge, angle, -depth, is_beyond=True), *clutter),
            edge,
            angle,
            f"drop of {depth:.2f} m",
        )
    if kind == "kerb":
        return made(floor, half_plane(edge, angle, KERB, is_beyond=True), *clutter), edge, angle, f"kerb of {KERB:g} m"
    if kind == "stones":
        width = float(rng.uniform(*STONE))
        row = Solid("kerb", Shape.BOX, SE2(edge + 0.5 * width, 0.0, angle), width, 40.0, 0.0, LEVEL + KERB)
        floors = (floor, half_plane(edge, angle, 0.0, is_beyond=True))
        return made(*floors, row, *clutter), edge, angle, f"kerb stones of {KERB:g} m, {width:.2f} m wide"
    mesh, top = ramp(edge, float(rng.uniform(3.0, 8.0)), SLOPE, 6.0)
    level = (half_plane(edge, 0.0, 0.0, is_beyond=False), half_plane(edge, 0.0, 0.0, is_beyond=True))
    return made(*level, top, *clutter, meshes=(mesh,)), edge, 0.0, "slope of 15 degrees"


def _blocked(
    terrain: Terrain,
    config: TerrainConfig,
    model: RobotModel,
    low: float,
    high: float,
    edge: float,
    angle: float,
    y: float,
) -> NDArray[np.float64]:
    """Return the obstacle points of the corridor, from `low` to `high` m along x behind the edge, their y measured from the corridor's middle."""
    points = terrain.points[terrain.points[:, 3] >= config.step]
    half = float(model.footprint[:, 1].max())
    along, aside = points[:, 0] - (edge - points[:, 1] * math.tan(angle)), points[:, 1] - y
    inside = (along > low) & (along < high) & (np.abs(aside) < half + config.voxel)
    return np.asarray(aside[inside], np.float64)


def _is_closed(terrain: Terrain, config: TerrainConfig, model: RobotModel, edge: float, angle: float, y: float) -> bool:
    """Whether the body cannot pass the edge within its corridor: no opening between marks is as wide as the body."""
    aside = _blocked(terrain, config, model, -0.35, 1.0, edge, angle, y)
    half = float(model.footprint[:, 1].max())
    return (
        len(aside) > 0 and float(np.diff(np.sort([-half - 0.5, *aside.tolist(), half + 0.5])).max()) < 2.0 * half + 0.5
    )


def _judged(
    kind: str,
    terrain: Terrain,
    config: TerrainConfig,
    model: RobotModel,
    edge: float,
    angle: float,
    y: float,
    seen_at: float | None,
) -> dict[str, Any]:
    if kind == "flat":
        return {"points": len(terrain.points), "false_points": int((terrain.points[:, 3] >= config.step).sum())}
    if kind == "slope":
        blocked = len(_blocked(terrain, config, model, -2.0, 3.0, edge, angle, y))
        return {"is_good": blocked == 0, "blocked_points": blocked}
    return {"is_good": _is_closed(terrain, config, model, edge, angle, y), "seen_at_m": seen_at}


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields: the ratio of false points on flat floors, and how many drops, kerbs, rows of stones and slopes were told right, for each robot."""
    fields: dict[str, Any] = {"runs": len(results)}
    is_met = True
    for robot in ROBOTS:
        mine = [r for r in results if r.get("robot") == robot and r.get("ended") != "crashed"]
        flat = [r for r in mine if r["kind"] == "flat"]
        points, false = sum(r["points"] for r in flat), sum(r["false_points"] for r in flat)
        fields[f"{robot}.flat_points"] = points
        fields[f"{robot}.false_ratio"] = false / max(points, 1)
        fields[f"{robot}.false_ratio_worst"] = max(
            (r["false_points"] / max(r["points"], 1) for r in flat), default=None
        )
        is_met &= false <= FALSE_MOST * points
        for kind in KINDS[1:]:
            of_kind = [r for r in mine if r["kind"] == kind]
            good = sum(bool(r["is_good"]) for r in of_kind)
            low, high = wilson_interval(good, len(of_kind))
            fields[f"{robot}.{kind}_runs"], fields[f"{robot}.{kind}_good"] = len(of_kind), good
            fields[f"{robot}.{kind}_good_ratio_low_95"], fields[f"{robot}.{kind}_good_ratio_high_95"] = low, high
            is_met &= good == len(of_kind)
            at = [r["seen_at_m"] for r in of_kind if r.get("seen_at_m") is not None]
            if at:
                fields[f"{robot}.{kind}_seen_at_median_m"] = float(np.median(at))
                fields[f"{robot}.{kind}_seen_at_least_m"] = min(at)
    fields["crashed"] = sum(r.get("ended") == "crashed" for r in results)
    fields["is_met"] = is_met and fields["crashed"] == 0
    return fields


def _line(result: dict[str, Any]) -> str:
    if result["kind"] == "flat":
        return f"{result['false_points']} of {result['points']} points false"
    good = "right" if result["is_good"] else "WRONG"
    at = f", seen at {result['seen_at_m']:.1f} m" if result.get("seen_at_m") is not None else ""
    return f"{result['drawn']}: {good}{at}"
