"""Numbers of the terrain analysis, with their reasons; a small window and a wide one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ambler.core.errors import BadInputError
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.units import Radians

WIDE_COLUMNS = 200  # of 0.2 m: 40 m
SEEN_FLOOR = 4.5  # metres of floor ahead that the window shows at least: a level LiDAR sees none nearer than 5 m


@dataclass(frozen=True, slots=True)
class TerrainConfig:
    """SI. What a robot can cross is in `step`, `steep` and `climbs_stairs`, its size in `clearance` and `own_radius` (`for_robot`).

    columns         columns of voxels along a side of the window, an even number; more for a robot that sees the floor from far away on only
    voxel           side of a voxel; a cell of ground has twice that. 0.1: two of a kerb's edges do not fall into one
    step            a rise from which on a thing is an obstacle: half of what wheels of 15 cm cross is 4 cm, noise of ranges and of the
                    mount another 4
    steep           the steepest ground that is crossed (rad): 15° and the 3° by which a mount may lie, and the noise of a slope
    clearance       what hangs higher above the ground is passed below
    own_radius      metres around the base within which points are the robot's own
    climbs_stairs   whether stairs are ground
    drop            how much lower ground must lie behind an edge to be a drop: 8 cm less the noise of the slope before it
    hidden          metres behind an edge that a drop may hide: 8 cm hide 0.9 m at 7 m from a LiDAR 0.62 m high, 20 cm 2.3 m
    evidence        count from which a drop is believed: two for each scan that shows it, less one for each that shows ground there
    decay           seconds after which what was not seen again is forgotten, counted only while its column is seen: where nothing is seen,
                    as close to a level LiDAR, the ground stays known
    margin          metres, and a tenth of the distance on top, by which a ray must go on behind a voxel to have looked through it
    misses          looks through a voxel after which it is gone: a thin pole fills a third of a direction, so one or two happen to it
    climb           rise between two seen cells side by side that is still one surface; stairs have 17 to 19 cm
    slack, tilt     how far ground behind a gap may lie off the height before the gap, and how much farther for each metre of it: the
                    height of a mount is known to 5 cm and its angle to 3°
    gap             metres of unseen ground that are bridged: a level LiDAR 0.62 m high does not see the nearest 5 m
    above, above_slope, below, below_slope   what is kept of a cloud: `above` plus clearance over the base, and as much more for each metre
                    away as ground may rise
    points_most     points of a terrain cloud at most
    """

    columns: int = 144
    voxel: float = 0.1
    step: float = 0.08
    steep: Radians = math.radians(22.0)
    clearance: float = 0.8
    own_radius: float = 0.45
    climbs_stairs: bool = False
    drop: float = 0.055
    hidden: float = 3.0
    evidence: int = 6
    decay: float = 1.5
    margin: float = 0.25
    misses: float = 2.0
    climb: float = 0.21
    slack: float = 0.1
    tilt: float = 0.075
    gap: float = 7.0
    above: float = 0.3
    above_slope: float = 0.35
    below: float = 0.6
    below_slope: float = 0.4
    points_most: int = 60_000

    def __post_init__(self) -> None:
        if self.columns < 8 or self.columns % 2:
            raise BadInputError(f"terrain columns: an even number from 8 on, not {self.columns}")
        for name in ("voxel", "step", "steep", "clearance", "drop", "decay", "misses", "climb"):
            if not getattr(self, name) > 0.0:
                raise BadInputError(f"terrain {name}: must be positive, is {getattr(self, name)}")

    @property
    def cell(self) -> float:
        """Side of a cell of ground, metres."""
        return 2.0 * self.voxel

    @property
    def size(self) -> float:
        """Side of the window, metres."""
        return self.columns * self.voxel

    def for_robot(self, robot: RobotModel) -> TerrainConfig:
        """Return the numbers of a robot's size, what carries its LiDAR being part of it, and a window that holds enough of the floor that it sees."""
        tops = [mount.base_from_sensor.translation[2] for mount in robot.of_kind(SensorKind.CLOUD)]
        clearance = max([robot.body_height, *tops]) + 0.1
        floor_from = min((mount.sees_floor_from for mount in robot.clouds[:1]), default=0.0)
        reach = floor_from + SEEN_FLOOR if math.isfinite(floor_from) else 0.0
        columns = max(self.columns, min(WIDE_COLUMNS, 4 * math.ceil(0.5 * reach / self.voxel)))
        return replace(self, clearance=clearance, own_radius=robot.circumscribed_radius, columns=columns)


def wide(near: TerrainConfig) -> TerrainConfig:
    """Return the same numbers for a window of twice the side with voxels of twice the size: ground far away is seen sparsely, and what
    is a step between larger cells is larger."""
    voxel = 2.0 * near.voxel
    return replace(
        near,
        columns=WIDE_COLUMNS,
        voxel=voxel,
        step=near.step + 0.04,
        drop=near.drop + 0.04,
        climb=near.climb + 0.1,
        gap=2.0 * near.gap,
    )
