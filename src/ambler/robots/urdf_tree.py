"""URDF as a tree of links with shapes: parsed without entities, joints at their zero position, everything in the root's frame.

Meshes (STL, OBJ) count by the convex hull of their vertices, which is all that a base in a planar world needs.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3

F64 = NDArray[np.float64]
ROUND = 32  # points of a circle
LEVEL = 0.5  # sine up to which the axis of a wheel may lean


@dataclass(frozen=True)
class Link:
    """A link: its pose in the root, mass, points of its shapes in the root's frame (N, 3), and the radius of the
    largest round one (else 0). What `rolls` turns without end about a level axis: a wheel, if it reaches the floor."""

    name: str
    root_from_link: SE3
    mass: float
    points: F64
    rolls: bool
    radius: float


@dataclass
class UrdfTree:
    """A parsed file; `extension` is its `<ambler>` element."""

    path: Path
    name: str
    root: str
    links: dict[str, Link] = field(default_factory=dict)
    extension: Element | None = None


def parse_xml(path: Path) -> Element:
    """Read XML; raises BadInputError when it is broken or declares a document type: entities could read other files."""

    def refuse(*_: object) -> None:
        raise BadInputError(f"{path}: <!DOCTYPE> and entities are not allowed")

    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
        return ElementTree.fromstring(data)
    except (expat.ExpatError, ElementTree.ParseError, ValueError) as error:
        raise BadInputError(f"{path}: is not XML: {error}") from error


def read_tree(path: Path) -> UrdfTree:
    """Read a URDF file; raises BadInputError that names the element."""
    robot = parse_xml(path)
    if robot.tag != "robot":
        raise BadInputError(f"{path}: the outermost element is <{robot.tag}>, not <robot>")
    links = {name_of(path, e): e for e in robot.findall("link")}
    joints = {_child(path, e): e for e in robot.findall("joint")}
    for child, joint in joints.items():
        for name in (child, _end(path, joint, "parent")):
            if name not in links:
                raise BadInputError(f"{path}: {label(joint)}: there is no link {name!r}")
    roots = [name for name in links if name not in joints]
    if len(roots) != 1:
        raise BadInputError(f"{path}: one link must be the root, these have no parent: {', '.join(roots) or 'none'}")
    tree = UrdfTree(path, name_of(path, robot), roots[0], extension=robot.find("ambler"))
    for name, element in links.items():
        pose, rolls = _pose(path, name, joints)
        tree.links[name] = _link(path, element, pose, rolls)
    return tree


def label(element: Element) -> str:
    """Name an element as the file writes it."""
    for key in ("name", "link"):
        if key in element.attrib:
            return f"<{element.tag} {key}={element.attrib[key]!r}>"
    return f"<{element.tag}>"


def name_of(path: Path, element: Element) -> str:
    """Return an element's name; raises BadInputError without one."""
    name = element.get("name")
    if not name:
        raise BadInputError(f"{path}: a <{element.tag}> has no name")
    return name


def numbers(path: Path, element: Element, key: str, count: int | None, default: str | None = None) -> list[float]:
    """Return the numbers of an attribute; raises BadInputError unless there are `count` finite ones."""
    text = element.get(key, default)
    if text is None:
        raise BadInputError(f"{path}: {label(element)}: {key} is missing")
    try:
        values = [float(v) for v in text.split()]
    except ValueError:
        values = [math.nan]
    if (count is not None and len(values) != count) or not all(math.isfinite(v) for v in values):
        wanted = "numbers" if count is None else "a number" if count == 1 else f"{count} numbers"
        raise BadInputError(f"{path}: {label(element)}: {key} must be {wanted}, is {text!r}")
    return values


def _child(path: Path, joint: Element) -> str:
    name_of(path, joint)
    return _end(path, joint, "child")


def _end(path: Path, joint: Element, tag: str) -> str:
    end = joint.find(tag)
    if end is None or not end.get("link"):
        raise BadInputError(f"{path}: {label(joint)}: <{tag} link=...> is missing")
    return str(end.get("link"))


def _pose(path: Path, name: str, joints: dict[str, Element]) -> tuple[SE3, bool]:
    """Follow the joints from a link to the root; returns root_from_link, and whether the first joint that is not fixed rolls."""
    pose, axis, is_carried, seen = SE3(), (0.0, 0.0, 0.0), True, {name}
    while name in joints:
        joint = joints[name]
        if is_carried and joint.get("type") == "continuous":
            axis = pose.inverse().rotate(_axis(path, joint))
        is_carried &= joint.get("type") == "fixed"
        pose = _origin(path, joint) @ pose
        name = _end(path, joint, "parent")
        if name in seen:
            raise BadInputError(f"{path}: {label(joint)}: the joints go in a circle")
        seen.add(name)
    return pose, abs(pose.rotate(axis)[2]) < LEVEL * math.hypot(*axis)


def _axis(path: Path, joint: Element) -> tuple[float, float, float]:
    axis = joint.find("axis")
    x, y, z = (1.0, 0.0, 0.0) if axis is None else numbers(path, axis, "xyz", 3, "1 0 0")
    return x, y, z


def _origin(path: Path, element: Element) -> SE3:
    origin = element.find("origin")
    if origin is None:
        return SE3()
    x, y, z = numbers(path, origin, "xyz", 3, "0 0 0")
    return SE3.from_rpy((x, y, z), *numbers(path, origin, "rpy", 3, "0 0 0"))


def _link(path: Path, element: Element, pose: SE3, rolls: bool) -> Link:
    mass = element.find("inertial/mass")
    value = numbers(path, mass, "value", 1)[0] if mass is not None else 0.0
    if value < 0:
        raise BadInputError(f"{path}: {label(element)}: the mass is negative")
    shapes = element.findall("collision") or element.findall("visual")
    parts, radius = [np.zeros((0, 3))], 0.0
    for shape in shapes:
        points, round_radius = _shape_points(path, element, shape)
        parts.append((pose @ _origin(path, shape)).transform(points))
        radius = max(radius, round_radius)
    return Link(str(element.get("name")), pose, value, np.concatenate(parts), rolls, radius)


def _shape_points(path: Path, link: Element, shape: Element) -> tuple[F64, float]:
    """Return points whose convex hull is the shape, in its own frame, and the radius of a round one (else 0)."""
    geometry = shape.find("geometry")
    kind = next(iter(geometry), None) if geometry is not None else None
    if kind is None:
        raise BadInputError(f"{path}: {label(link)}: <{shape.tag}> has no geometry")
    if kind.tag == "box":
        half = 0.5 * np.array(numbers(path, kind, "size", 3))
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return half * signs, 0.0
    angles = 2.0 * math.pi / ROUND * np.arange(ROUND)
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    if kind.tag == "cylinder":
        (radius,), (length,) = numbers(path, kind, "radius", 1), numbers(path, kind, "length", 1)
        ends = [np.column_stack([radius * ring, np.full(ROUND, z)]) for z in (-0.5 * length, 0.5 * length)]
        return np.concatenate(ends), radius
    if kind.tag == "sphere":
        (radius,) = numbers(path, kind, "radius", 1)
        levels = np.linspace(-0.5 * math.pi, 0.5 * math.pi, ROUND // 2 + 1)
        rings = [np.column_stack([math.cos(a) * ring, np.full(ROUND, math.sin(a))]) for a in levels]
        return radius * np.concatenate(rings), radius
    if kind.tag == "mesh":
        scale = np.array(numbers(path, kind, "scale", 3, "1 1 1"))
        return scale * load_mesh(_mesh_path(path, link, kind)), 0.0
    raise BadInputError(f"{path}: {label(link)}: the shape <{kind.tag}> is not known (box, cylinder, sphere, mesh)")


def _mesh_path(path: Path, link: Element, mesh: Element) -> Path:
    """Find a mesh file: beside the URDF, or `package://NAME/...` in a folder NAME at or above it; a URL's `%20` is a blank."""
    name = mesh.get("filename", "")
    scheme, separator, rest = name.partition("://")
    rest = unquote(rest)
    if not separator:
        candidates = [path.parent / name]
    elif scheme == "file":
        candidates = [Path(rest)]
    else:
        package, _, inner = rest.partition("/")
        above = [path.parent, *path.resolve().parents]
        candidates = [p / inner for p in above if p.name == package] + [p / package / inner for p in above]
    for candidate in candidates:
        if name and candidate.is_file():
            return candidate
    raise BadInputError(f"{path}: {label(link)}: the mesh file {name!r} is not there")


def load_mesh(path: Path) -> F64:
    """Return the vertices of an STL or OBJ file, float64 (N, 3); raises BadInputError."""
    data = path.read_bytes()
    try:
        if path.suffix.lower() == ".obj":
            points = list(_text_vertices(data.decode("utf-8"), "v"))
        elif path.suffix.lower() != ".stl":
            raise BadInputError(f"{path}: meshes are read from .stl and .obj files only")
        elif data[:5] == b"solid" and b"vertex" in data[:1000]:
            points = list(_text_vertices(data.decode("ascii"), "vertex"))
        else:
            (count,) = struct.unpack_from("<I", data, 80)
            rows = np.frombuffer(data, np.dtype([("v", "<f4", 12), ("n", "<u2")]), count, 84)
            points = rows["v"][:, 3:].reshape(-1, 3).tolist()
    except (struct.error, UnicodeDecodeError, ValueError, IndexError) as error:
        raise BadInputError(f"{path}: is no mesh: {error}") from error
    out = np.array(points, np.float64).reshape(-1, 3)
    if len(out) == 0 or not np.isfinite(out).all():
        raise BadInputError(f"{path}: the mesh has no vertices, or some are no numbers")
    return out


def _text_vertices(text: str, word: str) -> Iterator[list[float]]:
    for line in text.splitlines():
        parts = line.split()
        if parts and parts[0] == word:
            yield [float(parts[1]), float(parts[2]), float(parts[3])]
