"""Robots from URDF files. What URDF cannot say stands in an `<ambler>` element of the same file (docs/simulation.md).

The frame `base` is the root link's, moved down to the floor. In the simulator the body is a prism: the footprint from
`body_bottom` to `body_height`, by default the convex hull of all shapes but the wheels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from ambler.core.errors import BadInputError
from ambler.core.robot import MERGED_FRAME, DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se3 import SE3
from ambler.sim.camera import FRONT_CAMERA, CameraSpec, PictureNoise
from ambler.sim.sensors import (
    LEG_ODOMETRY,
    MEMS_IMU,
    MEMS_IMU_200,
    SAFETY_270,
    SCANNER_360,
    TRANSDUCER_30,
    VLP_16,
    WHEEL_ODOMETRY,
    GaitSpec,
    ImuSpec,
    LidarSpec,
    OdometrySpec,
    UltrasonicSpec,
)
from ambler.sim.sim_robot import SimRobot
from ambler.sim.urdf_tree import Link, UrdfTree, label, numbers, read_tree

F64 = NDArray[np.float64]
T = TypeVar("T")

LIDARS: dict[str, LidarSpec] = {"scanner_360": SCANNER_360, "safety_270": SAFETY_270, "vlp_16": VLP_16}
IMUS: dict[str, ImuSpec] = {"mems": MEMS_IMU, "mems_200": MEMS_IMU_200}
ULTRASONICS: dict[str, UltrasonicSpec] = {"transducer_30": TRANSDUCER_30}
ODOMETRIES: dict[str, OdometrySpec] = {"wheels": WHEEL_ODOMETRY, "legs": LEG_ODOMETRY}
GAITS: dict[str, GaitSpec] = {"trot": GaitSpec()}
RESERVED = ("base", "odom", "map")
SCALARS = ("floor", "wheel_radius", "track", "wheel_base", "strafe_loss", "body_bottom", "body_height", "watchdog")
PARTS = ("footprint", "limits", "lidar", "ultrasonic", "imu", "camera", "odometry", "gait")


def load_urdf(path: Path) -> SimRobot:
    """Load a robot; raises BadInputError in one sentence that names the file and the element."""
    tree = read_tree(path)
    extension = tree.extension if tree.extension is not None else Element("ambler")
    _check(tree, extension)
    wheels = [link for link in tree.links.values() if link.is_wheel and link.radius > 0]
    floor = _floor(tree, extension)
    drive = _drive(tree, extension, wheels)
    geometry = _wheel_geometry(tree, extension, drive, wheels)
    bottom, height = _body(tree, extension, floor)
    lidars = {e.get("link", ""): _spec(tree, e, LIDARS, "scanner_360") for e in extension.findall("lidar")}
    if not lidars:
        raise BadInputError(f"{path}: <ambler>: a <lidar link=...> is missing; without one no robot can be safe")
    ultrasonics = {
        e.get("link", ""): _spec(tree, e, ULTRASONICS, "transducer_30") for e in extension.findall("ultrasonic")
    }
    imus = extension.findall("imu") or [Element("imu", link="imu")]
    odometry = extension.find("odometry")
    gait = extension.find("gait")
    mass = sum(link.mass for link in tree.links.values())
    if mass <= 0:
        raise BadInputError(f"{path}: no <link> has an <inertial> with a <mass>")
    model = RobotModel(
        tree.name,
        drive,
        _footprint(tree, extension),
        _limits(tree, extension, drive),
        _mounts(tree, extension, floor, lidars),
        height,
    )
    return SimRobot(
        model,
        lidars,
        {e.get("link", ""): _spec(tree, e, IMUS, "mems") for e in imus},
        _spec(
            tree,
            odometry if odometry is not None else Element("odometry"),
            ODOMETRIES,
            "wheels" if geometry[0] > 0 else "legs",
        ),
        mass,
        bottom,
        *geometry,
        strafe_loss=_scalar(tree, extension, "strafe_loss", 0.0),
        gait=_spec(tree, gait, GAITS, "trot") if gait is not None else None,
        watchdog=_scalar(tree, extension, "watchdog", 0.5),
        ultrasonics=ultrasonics,
        cameras={e.get("link", ""): _camera(tree, e) for e in extension.findall("camera")},
    )


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


def _scalar(tree: UrdfTree, element: Element, key: str, default: float) -> float:
    return numbers(tree.path, element, key, 1)[0] if key in element.attrib else default


def _floor(tree: UrdfTree, extension: Element) -> float:
    """Height of the floor in the root's frame: the lowest point of all shapes unless the file says it."""
    lowest = min((float(link.points[:, 2].min()) for link in tree.links.values() if len(link.points)), default=0.0)
    return _scalar(tree, extension, "floor", lowest)


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
    """Return wheel radius, track and wheel base: from the attributes, else from the links on continuous joints."""
    places = np.array([link.root_from_link.translation for link in wheels]).reshape(-1, 3)
    radius = _scalar(tree, extension, "wheel_radius", float(np.median([w.radius for w in wheels])) if wheels else 0.0)
    if radius == 0.0 and drive is DriveKind.OMNI:
        return (0.0, 0.0, 0.0)
    spread = np.ptp(places, axis=0) if len(places) > 1 else np.zeros(3)
    track = _scalar(tree, extension, "track", float(spread[1]))
    default = float(spread[0]) if drive is DriveKind.OMNI else 0.0
    base = _scalar(tree, extension, "wheel_base", default)
    if radius <= 0 or track <= 0 or (drive is DriveKind.OMNI) != (base > 0):
        wanted = "two wheels" if drive is DriveKind.DIFFERENTIAL else "four mecanum wheels, or none"
        raise BadInputError(
            f"{tree.path}: <ambler>: a {drive.value} drive needs {wanted} (cylinders on continuous joints, or wheel_radius, "
            f"track, wheel_base)"
        )
    return (radius, track, base)


def _body(tree: UrdfTree, extension: Element, floor: float) -> tuple[float, float]:
    bodies = [link.points[:, 2] for link in tree.links.values() if not link.is_wheel and len(link.points)]
    low = min((float(z.min()) for z in bodies), default=math.nan) - floor
    high = max((float(z.max()) for z in bodies), default=math.nan) - floor
    bottom = _scalar(tree, extension, "body_bottom", max(low, 0.01))
    height = _scalar(tree, extension, "body_height", high)
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
    return default if element is None else _override(tree, element, default)


def _mounts(
    tree: UrdfTree, extension: Element, floor: float, lidars: Mapping[str, LidarSpec]
) -> tuple[SensorMount, ...]:
    base_from_root = SE3((0.0, 0.0, -floor))
    poses = {name: base_from_root @ link.root_from_link for name, link in tree.links.items()}
    scans, others = [], []
    for element in extension.findall("lidar"):
        name = element.get("link", "")
        spec = lidars[name]
        sector = (spec.azimuth_start, spec.azimuth_start + spec.span)
        window = numbers(tree.path, element, "window", 2, None if "window" in element.attrib else "0 0")
        azimuth = (window[0], window[1]) if "window" in element.attrib else sector
        if len(spec.elevations) == 1:
            azimuth = (-math.pi, math.pi) if azimuth == sector and spec.is_full_turn else azimuth
            scans.append(SensorMount(name, SensorKind.SCAN, poses[name], spec.range_min, azimuth=azimuth))
        else:
            ends = (spec.elevations[0], spec.elevations[-1])
            others.append(SensorMount(name, SensorKind.CLOUD, poses[name], spec.range_min, elevation=ends))
    if len(scans) > 1 and MERGED_FRAME not in poses:
        poses[MERGED_FRAME] = SE3((0.0, 0.0, float(np.mean([m.base_from_sensor.translation[2] for m in scans]))))
    merged = [SensorMount(MERGED_FRAME, SensorKind.SCAN, poses[MERGED_FRAME])] if len(scans) > 1 else []
    imus = [e.get("link", "") for e in extension.findall("imu")]
    others += [SensorMount(name, SensorKind.IMU, poses[name]) for name in imus]
    if not imus:
        others.append(SensorMount("imu", SensorKind.IMU, SE3()))
    cameras = [
        SensorMount(e.get("link", ""), SensorKind.CAMERA, poses[e.get("link", "")]) for e in extension.findall("camera")
    ]
    rangers = []
    for element in extension.findall("ultrasonic"):
        name = element.get("link", "")
        rangers.append(
            SensorMount(
                name, SensorKind.RANGE, poses[name], _spec(tree, element, ULTRASONICS, "transducer_30").range_min
            )
        )
    return (*scans, *merged, *others, *cameras, *rangers)


def _camera(tree: UrdfTree, element: Element) -> CameraSpec:
    """Return the camera; values of its lens and of its picture's noise are attributes of the element, too."""
    rest = Element(element.tag, element.attrib)

    def taken(default: T) -> T:
        names = {f.name for f in fields(default)} - {"name"}  # type: ignore[arg-type]
        own = {key: rest.attrib.pop(key) for key in list(rest.attrib) if key in names}
        return _override(tree, Element(element.tag, own), default)

    try:
        lens, noise = taken(FRONT_CAMERA), taken(PictureNoise())
    except ValueError as error:
        raise BadInputError(f"{tree.path}: {label(element)}: {error}") from None
    return replace(_override(tree, rest, CameraSpec()), model=lens, picture=noise)


def _spec(tree: UrdfTree, element: Element, known: Mapping[str, T], default: str) -> T:
    """Return the specification that `model` names, with the element's other attributes in place of its values."""
    model = element.get("model", default)
    if model not in known:
        raise BadInputError(f"{tree.path}: {label(element)}: no model {model!r}; there are {', '.join(known)}")
    return _override(tree, element, known[model])


def _override(tree: UrdfTree, element: Element, default: T) -> T:
    names = {f.name for f in fields(default)}  # type: ignore[arg-type]
    changes: dict[str, Any] = {}
    for key in element.attrib:
        if key in ("link", "model", "window"):
            continue
        plain = key.removesuffix("_deg")
        if key not in names and plain not in names:
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
