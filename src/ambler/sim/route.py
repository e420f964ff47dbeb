"""Routes: waypoints that a robot is driven along, in files of their own and in world files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import Field, ValidationError

from ambler.core.errors import BadInputError
from ambler.sim.dock_entry import Entry
from ambler.sim.solids import WorldSpec
from ambler.wire.yaml_text import read_yaml

Point = tuple[float, float]
SPEED = 0.8  # m/s where nothing is said
NEAREST = 0.05  # metres that two waypoints lie apart at least


@dataclass(frozen=True, slots=True)
class Route:
    """Waypoints (x, y) in the frame `world`, driven through in their order at `speed` m/s."""

    points: tuple[Point, ...]
    speed: float = SPEED

    @property
    def length(self) -> float:
        """Metres from the first waypoint to the last, in the plane."""
        return float(np.hypot(*np.diff(np.array(self.points), axis=0).T).sum())


class RouteEntry(Entry):
    """A route as files hold it. `frame`: `world`, or `start`, that of the pose in which robots of the world start."""

    points: tuple[Point, ...] = Field(min_length=2)
    speed: float = Field(default=SPEED, gt=0, le=5)
    frame: Literal["world", "start"] = "world"

    def to_route(self, world: WorldSpec) -> Route:
        """Return the route in the frame `world`; raises ValueError where two waypoints are one."""
        points = np.array(self.points)
        steps = np.hypot(*np.diff(points, axis=0).T)
        if steps.min() < NEAREST:
            k = int(np.argmin(steps))
            raise ValueError(f"points {k} and {k + 1} lie {1e3 * steps[k]:.0f} mm apart, at least 50 are asked")
        moved = world.start.transform(points) if self.frame == "start" else points
        return Route(tuple((float(x), float(y)) for x, y in moved), self.speed)


def load_route(path: Path, world: WorldSpec) -> Route:
    """Read a route file; raises BadInputError in one sentence that names the file and the place."""
    try:
        content: Any = read_yaml(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: not readable as YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise BadInputError(f"{path}: a route is a mapping with points, and perhaps speed and frame")
    try:
        return RouteEntry.model_validate(content).to_route(world)
    except ValidationError as error:
        first = error.errors()[0]
        raise BadInputError(f"{path}: {'.'.join(str(p) for p in first['loc'])}: {first['msg']}") from error
    except ValueError as error:
        raise BadInputError(f"{path}: {error}") from error


def built_in_route(world: WorldSpec) -> Route:
    """Return the route that a world brings along; raises BadInputError where it has none."""
    if len(world.route) < 2:
        raise BadInputError(f"world {world.name} brings no route along: give --drive a file of waypoints")
    return Route(world.route, world.route_speed)


def heading_of(points: tuple[Point, ...]) -> float:
    """Return the direction (rad) from the first waypoint to the second."""
    (x0, y0), (x1, y1) = points[:2]
    return math.atan2(y1 - y0, x1 - x0)
