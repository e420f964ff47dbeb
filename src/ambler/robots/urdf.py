"""Robots from URDF files. What URDF cannot say stands in an `<ambler>` element of the same file (docs/simulation.md).

The frame `base` is the root link's, moved down to the floor. The body is a prism: the footprint from `body_bottom` to `body_height`,
by default the convex hull of all shapes but the wheels: what rolls on the floor. Attributes that only a simulator needs are left to `sim.urdf`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from ambler.core.errors import BadInputError
from ambler.core.robot import MERGED_FRAME, DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.robots.description import Chassis, RobotDescription
from ambler.robots.sensors import DEPTH_CAMERAS, SCANNERS, TRANSDUCERS
from ambler.robots.urdf_tree import Link, UrdfTree, label, numbers, read_tree

F64 = NDArray[np.float64]
T = TypeVar("T")

RESERVED = ("base", "odom", "map")
SCALARS = ("floor", "wheel_radius", "track", "wheel_base", "strafe_loss", "body_bottom", "body_height", "watchdog")
PARTS = ("footprint", "limits", "lidar", "ultrasonic", "imu", "camera", "depth", "odometry", "gait")
ANY = ("link", "model", "window")  # attributes of a sensor that are no values of its model


@dataclass(frozen=True)
class UrdfRobot:
    """What a file says: the robot, and the parsed file with its `<ambler>` element for those who look for more."""

    description: RobotDescription
    tree: UrdfTree
    extension: Element

    @property
    def mass(self) -> float:
        """The mass of all links, kg; raises BadInputError when none has one."""
        mass = sum(link.mass for link in self.tree.links.values())
        if mass <= 0:
            raise BadInputError(f"{self.tree.path}: no <link> has an <inertial> with a <mass>")
        return mass


def read_robot(path: Path) -> UrdfRobot:
    """Read a robot; raises BadInputError in one sentence that names the file and the element."""
    tree = read_tree(path)
    extension = tree.extension if tree.extension is not None else Element("ambler")
    _check(tree, extension)
    floor = _floor(tree, extension)
    wheels = [link for link in tree.links.values() if link.rolls and _reaches(link, floor)]
    driven = _driven(wheels)
    drive = _drive(tree, extension, driven)
    geometry = _wheel_geometry(tree, extension, drive, driven)
    bottom, height = _body(tree, extension, floor, wheels)
    if extension.find("lidar") is None:
        raise BadInputError(f"{path}: <ambler>: a <lidar link=...> is missing; without one no robot can be safe")
    footprint = _footprint(tree, extension)
    _check_track(tree, geometry[1], footprint)
    model = RobotModel(
        tree.name,
        drive,
        footprint,
        _limits(tree, extension, drive),
        _mounts(tree, extension, floor),
        height,
    )
    return UrdfRobot(RobotDescription(model, Chassis(bottom, *geometry)), tree, extension)


def _check(tree: UrdfTree, extension: Element) -> None:
    for key in extension.attrib:
        if key not in ("drive", *SCALARS):
            raise BadInputError(f"{tree.path}: <ambler>: no such attribute {key!r}")
    for part in extension:
        if part.tag not in PARTS:
            raise BadInputError(
                f"{tree.path}: <ambler>: no such element <{part.tag}>; there are {', '.join(sorted(PARTS))}"
            )
        link = part.get("link")
        if part.tag in ("lidar", "ultrasonic", "camera", "imu") and link not in tree.links:
            raise BadInputError(f"{tree.path}: {label(part)}: there is no link {link!r}")
        if link in RESERVED:
            raise BadInputError(f"{tree.path}: {label(part)}: a sensor's link must not be called {link!r}")


def scalar(tree: UrdfTree, element: Element, key: str, default: float) -> float:
    """Return an attribute's number, or the default; raises BadInputError."""
    return numbers(tree.path, element, key, 1)[0] if key in element.attrib else default


def _floor(tree: UrdfTree, extension: Element) -> float:
    """Height of the floor in the root's frame: the lowest point of all shapes unless the file says it."""
    lowest = min((float(link.points[:, 2].min()) for link in tree.links.values() if len(link.points)), default=0.0)
    return scalar(tree, extension, "floor", lowest)


def _reaches(link: Link, floor: float) -> bool:
    """Say whether the shapes of a link reach the floor, but for an eighth of their height."""
    z = link.points[:, 2]
    return len(z) > 0 and float(z.min()) - floor <= 0.125 * float(np.ptp(z))


def _driven(wheels: list[Link]) -> list[Link]:
    """Return the largest round wheels of which there are several alike: the others are those of casters."""
    for largest in sorted((w.radius for w in wheels if w.radius > 0), reverse=True):
        alike = [w for w in wheels if abs(w.radius - largest) <= 0.1 * largest]
        if len(alike) > 1:
            return alike
    return []


def _drive(tree: UrdfTree, extension: Element, wheels: list[Link]) -> DriveKind:
    text = extension.get("drive", "differential" if len(wheels) == 2 else "")
    try:
        return DriveKind(text)
    except ValueError as error:
        kinds = " or ".join(k.value for k in DriveKind)
        raise BadInputError(f"{tree.path}: <ambler>: drive must be {kinds}, is {text!r}") from error


def _wheel_geometry(
    tree: UrdfTree, extension: Element, drive: DriveKind, wheels: list[Link]
) -> tuple[float, float, float]:
    """Return wheel radius, track and wheel base: from the attributes, else from the wheels that drive."""
    places = np.array([link.root_from_link.translation for link in wheels]).reshape(-1, 3)
    radius = scalar(tree, extension, "wheel_radius", float(np.median([w.radius for w in wheels])) if wheels else 0.0)
    if radius == 0.0 and drive is DriveKind.OMNI:
        return (0.0, 0.0, 0.0)
    spread = np.ptp(places, axis=0) if len(places) > 1 else np.zeros(3)
    track = scalar(tree, extension, "track", float(spread[1]))
    default = float(spread[0]) if drive is DriveKind.OMNI else 0.0
    base = scalar(tree, extension, "wheel_base", default)
    if radius <= 0 or track <= 0 or (drive is DriveKind.OMNI) != (base > 0):
        wanted = "two wheels" if drive is DriveKind.DIFFERENTIAL else "four mecanum wheels, or none"
        raise BadInputError(
            f"{tree.path}: <ambler>: a {drive.value} drive needs {wanted} (cylinders on the floor that continuous joints turn about level axes, or wheel_radius, "
            f"track, wheel_base)"
        )
    return (radius, track, base)


def _body(tree: UrdfTree, extension: Element, floor: float, wheels: list[Link]) -> tuple[float, float]:
    names = {wheel.name for wheel in wheels}
    bodies = [link.points[:, 2] for link in tree.links.values() if link.name not in names and len(link.points)]
    low = min((float(z.min()) for z in bodies), default=math.nan) - floor
    high = max((float(z.max()) for z in bodies), default=math.nan) - floor
    bottom = scalar(tree, extension, "body_bottom", max(low, 0.01))
    height = scalar(tree, extension, "body_height", high)
    if not 0.0 < bottom < height:
        raise BadInputError(
            f"{tree.path}: no shape tells the body's height; give body_bottom and body_height in <ambler>"
        )
    return bottom, height


def _footprint(tree: UrdfTree, extension: Element) -> F64:
    element = extension.find("footprint")
    if element is not None:
        points = np.array(numbers(tree.path, element, "points", None))
        if len(points) < 6 or len(points) % 2:
            raise BadInputError(f"{tree.path}: <footprint>: points must be at least three pairs x y")
        points = points.reshape(-1, 2)
    else:
        points = np.concatenate([np.zeros((0, 2)), *(link.points[:, :2] for link in tree.links.values())])
    try:
        hull = points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise BadInputError(f"{tree.path}: the shapes of the links span no footprint") from error
    if element is not None:
        if len(hull) != len(points):
            raise BadInputError(f"{tree.path}: <footprint>: the points are no convex polygon")
        area = float(np.sum(points[:, 0] * np.roll(points[:, 1], -1) - points[:, 1] * np.roll(points[:, 0], -1)))
        return points if area > 0 else points[::-1].copy()
    return np.ascontiguousarray(hull)


def _limits(tree: UrdfTree, extension: Element, drive: DriveKind) -> VelocityLimits:
    default = VelocityLimits(vy_max=0.4) if drive is DriveKind.OMNI else VelocityLimits()
    element = extension.find("limits")
    if element is None:
        return default
    limits = override(tree, element, default)
    for f in fields(limits):
        value: float = getattr(limits, f.name)
        wanted, is_right = {
            "vx_min": ("0 or negative", value <= 0.0),
            "vy_max": ("0 or positive", value >= 0.0),
        }.get(f.name, ("positive", value > 0.0))
        if not is_right:
            raise BadInputError(f"{tree.path}: {label(element)}: {f.name} must be {wanted}, is {value:g}")
    return limits


def _check_track(tree: UrdfTree, track: float, footprint: F64) -> None:
    """Raise BadInputError for wheels that stand too far outside of the body to be its own."""
    width = float(np.ptp(footprint[:, 1]))
    if track > 2.0 * width:
        raise BadInputError(
            f"{tree.path}: <ambler>: the track of {track:g} m is more than twice the body's width of {width:g} m"
        )


def _mounts(tree: UrdfTree, extension: Element, floor: float) -> tuple[SensorMount, ...]:
    base_from_root = SE3((0.0, 0.0, -floor))
    poses = {name: base_from_root @ link.root_from_link for name, link in tree.links.items()}
    scans: list[SensorMount] = []
    others: list[SensorMount] = []
    for element in extension.findall("lidar"):
        name = element.get("link", "")
        geometry = spec_of(tree, element, SCANNERS, "scanner_360", is_partial=True)
        window = numbers(tree.path, element, "window", 2) if "window" in element.attrib else None
        mount = geometry.mount(name, poses[name], None if window is None else (window[0], window[1]))
        below = -mount.base_from_sensor.translation[2]
        if mount.kind is SensorKind.SCAN and below > 1e-6:
            raise BadInputError(f"{tree.path}: {label(element)}: lies {below:g} m below the floor")
        (scans if mount.kind is SensorKind.SCAN else others).append(mount)
    if len(scans) > 1 and MERGED_FRAME not in poses:
        poses[MERGED_FRAME] = SE3((0.0, 0.0, float(np.mean([m.base_from_sensor.translation[2] for m in scans]))))
    merged = [SensorMount(MERGED_FRAME, SensorKind.SCAN, poses[MERGED_FRAME])] if len(scans) > 1 else []
    for element in imu_elements(extension):
        name = element.get("link", "")
        others.append(SensorMount(name, SensorKind.IMU, poses.get(name, SE3())))
    for element in extension.findall("camera"):
        name = element.get("link", "")
        others.append(SensorMount(name, SensorKind.CAMERA, poses[name]))
    for element in extension.findall("ultrasonic"):
        name = element.get("link", "")
        transducer = spec_of(tree, element, TRANSDUCERS, "transducer_30", is_partial=True)
        others.append(transducer.mount(name, poses[name]))
    for element in extension.findall("depth"):
        name = element.get("link", "")
        others.append(spec_of(tree, element, DEPTH_CAMERAS, "d430", is_partial=True).mount(name, poses[name]))
    return (*scans, *merged, *others)


def imu_elements(extension: Element) -> list[Element]:
    """Return the inertial units; a file without any has one called `imu` at the base."""
    return extension.findall("imu") or [Element("imu", link="imu")]


def spec_of(tree: UrdfTree, element: Element, known: Mapping[str, T], default: str, *, is_partial: bool = False) -> T:
    """Return the specification that `model` names, with the element's other attributes in place of its values. Attributes that it does
    not have raise BadInputError, unless it is only a part of what the element describes."""
    model = element.get("model", default)
    if model not in known:
        raise BadInputError(f"{tree.path}: {label(element)}: no model {model!r}; there are {', '.join(known)}")
    return override(tree, element, known[model], is_partial=is_partial)


def override(tree: UrdfTree, element: Element, default: T, *, is_partial: bool = False) -> T:
    """Return a record with the element's attributes in place of its values, angles also as `name_deg`; raises BadInputError."""
    names = {f.name for f in fields(default)}  # type: ignore[arg-type]
    changes: dict[str, Any] = {}
    for key in element.attrib:
        plain = key.removesuffix("_deg")
        if key in ANY:
            continue
        if key not in names and plain not in names:
            if is_partial:
                continue
            raise BadInputError(f"{tree.path}: {label(element)}: no such attribute {key!r}")
        unit = math.pi / 180.0 if key not in names else 1.0
        value: Any
        if isinstance(getattr(default, plain), tuple):
            value = tuple(v * unit for v in numbers(tree.path, element, key, None))
        else:
            (number,) = numbers(tree.path, element, key, 1)
            value = int(number) if isinstance(getattr(default, plain), int) else number * unit
        changes[plain] = value
    return replace(default, **changes)  # type: ignore[type-var]
