"""Reads worlds: short YAML files of walls with doors, boxes and cylinders, or a floor plan (PGM + YAML).

A world file is written in its author's coordinates; `WorldSpec` holds everything in the map frame (see `sim.solids`).
"""

from __future__ import annotations

import math
from pathlib import Path

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim.floorplan import world_from_floor_plan
from ambler.sim.solids import Shape, Solid, WorldSpec, to_map_frame

WORLDS = Path(__file__).parent / "worlds"
SUFFIXES = (".yaml", ".yml")


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", populate_by_name=True, allow_inf_nan=False)


class _Pose(_Entry):
    x: float
    y: float
    yaw_deg: float = 0.0


class _Door(_Entry):
    at: float = Field(gt=0)
    width: float = Field(default=0.9, gt=0)


class _Wall(_Entry):
    start: tuple[float, float] = Field(alias="from")
    end: tuple[float, float] = Field(alias="to")
    thickness: float = Field(default=0.12, gt=0)
    height: float | None = Field(default=None, gt=0)
    albedo: float = Field(default=0.7, ge=0, le=1)
    doors: list[_Door] = []


class _Box(_Entry):
    center: tuple[float, float]
    size: tuple[float, float, float]
    yaw_deg: float = 0.0
    base: float = Field(default=0.0, ge=0)
    name: str = "box"
    albedo: float = Field(default=0.5, ge=0, le=1)


class _Cylinder(_Entry):
    center: tuple[float, float]
    radius: float = Field(gt=0)
    height: float = Field(gt=0)
    base: float = Field(default=0.0, ge=0)
    name: str = "cylinder"
    albedo: float = Field(default=0.5, ge=0, le=1)


class _World(_Entry):
    extends: str | None = None
    size: tuple[float, float] | None = None
    start: _Pose | None = None
    ceiling: float | None = Field(default=None, gt=0)
    wall_height: float = Field(default=2.5, gt=0)
    door_height: float = Field(default=2.1, gt=0)
    friction: float = Field(default=0.8, gt=0)
    walls: list[_Wall] = []
    boxes: list[_Box] = []
    cylinders: list[_Cylinder] = []


def world_names() -> tuple[str, ...]:
    """Return the names of the worlds that come with the package."""
    return tuple(sorted(p.stem for p in WORLDS.glob("*.yaml")))


def load_world(name_or_path: str | Path, start: SE2 | None = None) -> WorldSpec:
    """Load a world by its name, from a world file, or from the YAML of a floor plan; `start` overrides the start pose.

    Raises BadInputError with one sentence that names the file and the place.
    """
    path = _find(str(name_or_path))
    content = _read_yaml(path)
    if "image" in content:
        return world_from_floor_plan(path, start)
    entry = _parse(path, content)
    solids = _solids(path, entry)
    if entry.start is None and start is None:
        raise BadInputError(f"{path}: start: is missing, give the robot's start pose as {{x, y, yaw_deg}}")
    if start is None:
        assert entry.start is not None
        start = SE2(entry.start.x, entry.start.y, math.radians(entry.start.yaw_deg))
    ceiling = entry.ceiling if entry.ceiling is not None else math.inf
    return WorldSpec(path.stem, to_map_frame(solids, start), start, ceiling, entry.friction)


def _find(name: str) -> Path:
    path = Path(name)
    if path.suffix in SUFFIXES:
        if not path.is_file():
            raise BadInputError(f"world file {name} does not exist")
        return path
    path = WORLDS / f"{name}.yaml"
    if not path.is_file():
        raise BadInputError(f"no world {name!r}; there are {', '.join(world_names())}, or give a .yaml file")
    return path


def _read_yaml(path: Path) -> dict[str, object]:
    try:
        content = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise BadInputError(f"{path}: not readable as YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise BadInputError(f"{path}: a world is a mapping with start, walls, boxes, cylinders")
    return content


def _parse(path: Path, content: dict[str, object], heirs: tuple[Path, ...] = ()) -> _World:
    try:
        entry = _World.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(p) for p in first["loc"])
        raise BadInputError(f"{path}: {place}: {first['msg']}") from error
    if entry.extends is None:
        return entry
    beside = path.parent / entry.extends
    base_path = beside if beside.suffix in SUFFIXES and beside.is_file() else _find(entry.extends)
    heirs = (*heirs, path.resolve())
    if base_path.resolve() in heirs:
        raise BadInputError(f"{path}: extends: {entry.extends} extends this world itself")
    base = _parse(base_path, _read_yaml(base_path), heirs)
    lists = {k: getattr(base, k) + getattr(entry, k) for k in ("walls", "boxes", "cylinders")}
    own = {k: getattr(entry, k) for k in entry.model_fields_set if k not in lists}
    return base.model_copy(update={**own, **lists})


def _solids(path: Path, entry: _World) -> list[Solid]:
    out: list[Solid] = []
    for k, wall in enumerate(entry.walls):
        out += _wall_solids(path, k, wall, entry)
    for box in entry.boxes:
        if min(box.size) <= 0:
            raise BadInputError(f"{path}: box {box.name!r}: size must be positive, is {list(box.size)}")
        pose = SE2(*box.center, math.radians(box.yaw_deg))
        out.append(
            Solid(box.name, Shape.BOX, pose, box.size[0], box.size[1], box.base, box.base + box.size[2], box.albedo)
        )
    for c in entry.cylinders:
        pose, width = SE2(*c.center, 0.0), 2 * c.radius
        out.append(Solid(c.name, Shape.CYLINDER, pose, width, width, c.base, c.base + c.height, c.albedo))
    return out


def _wall_solids(path: Path, index: int, wall: _Wall, entry: _World) -> list[Solid]:
    """Cut a wall into pieces between its doors, with a lintel over each door; free ends are lengthened to close corners."""
    (x0, y0), (x1, y1) = wall.start, wall.end
    length, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
    if length == 0:
        raise BadInputError(f"{path}: walls.{index}: from and to are the same point")
    world_from_wall = SE2(x0, y0, yaw)
    height = wall.height if wall.height is not None else entry.wall_height
    name = f"wall_{index}"

    def piece(a: float, b: float, z_min: float) -> Solid:
        center = world_from_wall @ SE2(0.5 * (a + b), 0.0, 0.0)
        return Solid(name, Shape.BOX, center, b - a, wall.thickness, z_min, height, wall.albedo)

    pieces, at = [], -0.5 * wall.thickness
    for door in sorted(wall.doors, key=lambda d: d.at):
        a, b = door.at - 0.5 * door.width, door.at + 0.5 * door.width
        if a <= at or b >= length:
            raise BadInputError(f"{path}: walls.{index}.doors: the door at {door.at} m does not fit into the wall")
        pieces.append(piece(at, a, 0.0))
        if height > entry.door_height:
            pieces.append(piece(a, b, entry.door_height))
        at = b
    pieces.append(piece(at, length + 0.5 * wall.thickness, 0.0))
    return pieces
