"""Reads worlds: short YAML files of walls with doors, boxes, cylinders, meshes and terrain, or a floor plan (PGM + YAML).

A world file is written in its author's coordinates, and these are the frame `world` (see `sim.solids`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field, ValidationError

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.sim.dock_body import dock_solids
from ambler.sim.dock_entry import DockEntry, Entry, PoseEntry, sim_dock
from ambler.sim.floorplan import world_from_floor_plan, world_from_picture
from ambler.sim.route import RouteEntry
from ambler.sim.solids import Door, Person, Shape, Solid, WorldSpec
from ambler.sim.surface_entry import FOLDER, MeshEntry, TerrainEntry
from ambler.wire.map_files import PICTURES, yaml_beside
from ambler.wire.yaml_text import read_yaml

WORLDS = Path(__file__).parent / "worlds"
SUFFIXES = (".yaml", ".yml")


class _Door(Entry):
    at: float = Field(gt=0)
    width: float = Field(default=0.9, gt=0)


class _Wall(Entry):
    start: tuple[float, float] = Field(alias="from")
    end: tuple[float, float] = Field(alias="to")
    thickness: float = Field(default=0.12, gt=0)
    height: float | None = Field(default=None, gt=0)
    albedo: float = Field(default=0.7, ge=0, le=1)
    doors: tuple[_Door, ...] = ()
    glass: bool = False


class _Box(Entry):
    center: tuple[float, float]
    size: tuple[float, float, float]
    yaw_deg: float = 0.0
    base: float = 0.0
    name: str = "box"
    albedo: float = Field(default=0.5, ge=0, le=1)
    glass: bool = False


class _Cylinder(Entry):
    center: tuple[float, float]
    radius: float = Field(gt=0)
    height: float = Field(gt=0)
    base: float = 0.0
    name: str = "cylinder"
    albedo: float = Field(default=0.5, ge=0, le=1)


class _Rack(Entry):
    corner: tuple[float, float]
    yaw_deg: float = 0.0
    bays: str = Field(pattern="^[01]+$")
    bay: float = Field(default=2.7, gt=0)
    depth: float = Field(default=1.1, gt=0)
    height: float = Field(default=4.0, gt=1.6)
    load_height: float = Field(default=1.3, gt=0)
    name: str = "rack"


class _Person(Entry):
    way: list[tuple[float, float]] = Field(min_length=2)
    speed: float = Field(default=1.1, gt=0, le=3)
    radius: float = Field(default=0.25, gt=0)
    height: float = Field(default=1.75, gt=0)
    yields: bool | None = None
    mass: float = Field(default=75.0, gt=0)
    name: str | None = None


class _World(Entry):
    extends: str | None = None
    size: tuple[float, float] | None = None
    start: PoseEntry | None = None
    ceiling: float | None = Field(default=None, gt=0)
    wall_height: float = Field(default=2.5, gt=0)
    door_height: float = Field(default=2.1, gt=0)
    friction: float = Field(default=0.8, gt=0)
    walls: tuple[_Wall, ...] = ()
    boxes: tuple[_Box, ...] = ()
    cylinders: tuple[_Cylinder, ...] = ()
    racks: tuple[_Rack, ...] = ()
    people: tuple[_Person, ...] = ()
    docks: tuple[DockEntry, ...] = ()
    meshes: tuple[MeshEntry, ...] = ()
    terrain: TerrainEntry | None = None
    route: RouteEntry | None = None


LISTS = ("walls", "boxes", "cylinders", "racks", "people", "docks", "meshes")


def world_names() -> tuple[str, ...]:
    """Return the names of the worlds that come with the package."""
    return tuple(sorted(p.stem for p in WORLDS.glob("*.yaml")))


def load_world(name_or_path: str | Path, start: SE2 | None = None) -> WorldSpec:
    """Load a world by its name, from a world file, from the YAML of a floor plan or from a picture, or draw it (`office-17`); `start` overrides
    the start.

    Raises BadInputError with one sentence that names the file and the place.
    """
    from ambler.sim.generator.draw import draw_place, parse_name  # draws content for `world_from_content`

    drawn = parse_name(str(name_or_path))
    if drawn is not None:
        return world_from_content(Path(str(name_or_path)), draw_place(*drawn).content, start)
    path = _find(str(name_or_path))
    if path.suffix.lower() in PICTURES:
        described = yaml_beside(path)  # of a map of a ROS map server; it says more than the picture
        return world_from_picture(path, start) if described is None else world_from_floor_plan(described, start)
    content = _read_yaml(path)
    if "image" in content:
        return world_from_floor_plan(path, start)
    return world_from_content(path, content, start)


def check_start(name_or_path: str | Path, start: SE2) -> None:
    """Raise BadInputError where `start` lies beside the floor of a plan. Only its file tells: in the world that is made of it nothing fills what lies beyond."""
    from ambler.sim.generator.draw import parse_name

    if parse_name(str(name_or_path)) is not None:
        return
    path = _find(str(name_or_path))
    if path.suffix.lower() in PICTURES or "image" in _read_yaml(path):
        load_world(path, start)


def world_from_content(path: Path, content: dict[str, Any], start: SE2 | None = None) -> WorldSpec:
    """Return the world that the content of a world file says; `path` gives its name and is named in errors (BadInputError)."""
    entry = _parse(path, content)
    solids = tuple(_solids(path, entry))
    if entry.start is None and start is None:
        raise BadInputError(f"{path}: start: is missing, give the robot's start pose as {{x, y, yaw_deg}}")
    if start is None:
        assert entry.start is not None
        start = entry.start.to_se2()
    ceiling = entry.ceiling if entry.ceiling is not None else math.inf
    people = tuple(
        Person(
            p.name if p.name is not None else f"person_{k}",
            tuple(p.way),
            p.speed,
            p.radius,
            p.height,
            p.yields,
            p.mass,
        )
        for k, p in enumerate(entry.people)
    )
    doors = tuple(d for k, w in enumerate(entry.walls) for d in _doors(k, w, entry))
    docks = tuple(sim_dock(f"{path}: docks.{k}", d) for k, d in enumerate(entry.docks))
    solids += tuple(solid for dock in docks for solid in dock_solids(dock))
    meshes = tuple(mesh.to_mesh(path) for mesh in entry.meshes)
    terrain = entry.terrain.to_terrain(path) if entry.terrain is not None else None
    world = WorldSpec(
        *(path.stem, solids, start, ceiling, entry.friction),
        people=people,
        doors=doors,
        docks=docks,
        meshes=meshes,
        terrain=terrain,
    )
    if entry.route is None:
        return world
    try:
        route = entry.route.to_route(world)
    except ValueError as error:
        raise BadInputError(f"{path}: route: {error}") from error
    return replace(world, route=route.points, route_speed=route.speed)


def _find(name: str) -> Path:
    path = Path(name)
    if path.suffix.lower() in (*SUFFIXES, *PICTURES):
        if not path.is_file():
            raise BadInputError(f"world file {name} does not exist")
        return path
    path = WORLDS / f"{name}.yaml"
    if not path.is_file():
        raise BadInputError(
            f"no world {name!r}; there are {', '.join(world_names())}, or draw one (office-17: `ambler world generate`),"
            " or give a .yaml file or a picture"
        )
    return path


def _read_yaml(path: Path) -> dict[str, object]:
    try:
        content = read_yaml(path)
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise BadInputError(f"{path}: not readable as YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise BadInputError(f"{path}: a world is a mapping with start, walls, boxes, cylinders")
    return content


def _parse(path: Path, content: dict[str, object], heirs: tuple[Path, ...] = ()) -> _World:
    try:
        entry = _World.model_validate(content, context={FOLDER: path.parent})
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
    lists = {k: getattr(base, k) + getattr(entry, k) for k in LISTS}
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
            Solid(
                *(box.name, Shape.BOX, pose, box.size[0], box.size[1], box.base, box.base + box.size[2], box.albedo),
                is_glass=box.glass,
            )
        )
    for rack in entry.racks:
        out += _rack_solids(rack)
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
        return Solid(name, Shape.BOX, center, b - a, wall.thickness, z_min, height, wall.albedo, wall.glass)

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


def _doors(index: int, wall: _Wall, entry: _World) -> list[Door]:
    """Return a sliding leaf for every door that has room in the wall beside it, on the longer side."""
    (x0, y0), (x1, y1) = wall.start, wall.end
    length, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
    doors, edge = [], 0.0
    ordered = sorted(wall.doors, key=lambda d: d.at)
    for k, door in enumerate(ordered):
        a, b = door.at - 0.5 * door.width, door.at + 0.5 * door.width
        end = ordered[k + 1].at - 0.5 * ordered[k + 1].width if k + 1 < len(ordered) else length
        rooms = ((a - edge, -1.0), (end - b, 1.0))
        room, side = max(rooms)
        edge = b
        if room < door.width:
            continue
        center = SE2(x0, y0, yaw) @ SE2(door.at, 0.0, 0.0)
        height = min(entry.door_height, wall.height if wall.height is not None else entry.wall_height)
        name = f"door_{index}_{k}"
        leaf = Solid(name, Shape.BOX, center, door.width, 0.5 * wall.thickness, 0.0, height, 0.5)
        slide = side * door.width
        doors.append(Door(name, leaf, (slide * math.cos(yaw), slide * math.sin(yaw))))
    return doors


POST = 0.1  # width of a rack's uprights, metres
BEAM = (1.5, 1.6)  # heights of its lowest beam


def _rack_solids(rack: _Rack) -> list[Solid]:
    """A pallet rack from its corner along x: uprights between the bays, beams over them, a loaded pallet where `bays` has a 1."""
    corner, out = SE2(*rack.corner, math.radians(rack.yaw_deg)), []

    def add(name: str, x: float, y: float, size_x: float, size_y: float, z: tuple[float, float], albedo: float) -> None:
        pose = corner @ SE2(x, y, 0.0)
        out.append(Solid(f"{rack.name}_{name}", Shape.BOX, pose, size_x, size_y, z[0], z[1], albedo))

    for k in range(len(rack.bays) + 1):
        for y in (0.5 * POST, rack.depth - 0.5 * POST):
            add("post", k * rack.bay, y, POST, POST, (0.0, rack.height), 0.6)
    length = len(rack.bays) * rack.bay
    add("shelf", 0.5 * length, 0.5 * rack.depth, length, rack.depth, BEAM, 0.5)
    for k, bay in enumerate(rack.bays):
        if bay == "1":
            middle, width = (k + 0.5) * rack.bay, rack.bay - 0.5
            add("pallet", middle, 0.5 * rack.depth, width, rack.depth - 0.1, (0.0, rack.load_height), 0.4)
    return out
