"""What a robot looks like to a viewer: a minimal URDF of its body, its front and its scanners, in the frame `base`.

For simulators and other programs `robots.urdf_writer` writes the whole robot; here is only what can be seen, out of the model alone.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ambler.core.robot import RobotModel, SensorKind
from ambler.robots.urdf_writer import text_of

COLORS = {"body": (0.12, 0.31, 0.71, 1.0), "front": (1.0, 0.72, 0.0, 1.0), "sensor": (0.1, 0.1, 0.12, 1.0)}
FRONT_SHARE = 0.15  # of the length
FRONT_RISE = 0.01  # above the body, so that it is seen from above
SCANNER_RADIUS, SCANNER_HEIGHT = 0.05, 0.07


def outline_urdf(robot: RobotModel) -> str:
    """Return the text of the URDF: a box around the footprint from the floor to the body's height (m), its front, its scanners."""
    root = Element("robot", name=robot.name)
    link = SubElement(root, "link", name="base")
    low, high = robot.footprint.min(axis=0), robot.footprint.max(axis=0)
    (length, width), (x, y) = (high - low).tolist(), (0.5 * (low + high)).tolist()
    _add(link, "body", (x, y, 0.5 * robot.body_height), "box", size=text_of(length, width, robot.body_height))
    depth, height = FRONT_SHARE * length, robot.body_height + FRONT_RISE
    front = (float(high[0]) - 0.5 * depth, y, 0.5 * height)
    _add(link, "front", front, "box", size=text_of(depth, 0.5 * width, height))
    for mount in (*robot.scanners, *robot.of_kind(SensorKind.CLOUD)):
        place = mount.base_from_sensor.translation
        _add(link, "sensor", place, "cylinder", radius=text_of(SCANNER_RADIUS), length=text_of(SCANNER_HEIGHT))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add(link: Element, material: str, place: tuple[float, float, float], shape: str, **sizes: str) -> None:
    visual = SubElement(link, "visual")
    SubElement(visual, "origin", xyz=text_of(*place), rpy="0 0 0")
    SubElement(SubElement(visual, "geometry"), shape, sizes)
    SubElement(SubElement(visual, "material", name=material), "color", rgba=text_of(*COLORS[material]))
