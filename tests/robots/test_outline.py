"""The outline that viewers draw: a URDF of one link `base` that is as large as the robot."""

from xml.etree import ElementTree

import numpy as np
import pytest

from ambler.core.robot import RobotModel
from ambler.robots.catalog import robot_model
from ambler.robots.outline import outline_urdf


def numbers(element: ElementTree.Element, path: str, name: str) -> list[float]:
    found = element.find(path)
    assert found is not None
    return [float(v) for v in found.attrib[name].split()]


@pytest.mark.parametrize("name", ["diff", "amr_omni", "spot"])
def test_the_outline_is_the_body_with_a_front_and_scanners(name: str) -> None:
    model: RobotModel = robot_model(name)
    root = ElementTree.fromstring(outline_urdf(model))
    (link,) = root.findall("link")
    assert (root.attrib["name"], link.attrib["name"]) == (name, "base")
    body, front, *scanners = link.findall("visual")
    size, place = np.array(numbers(body, "geometry/box", "size")), np.array(numbers(body, "origin", "xyz"))
    low, high = model.footprint.min(axis=0), model.footprint.max(axis=0)
    assert np.allclose(place - size / 2, [*low, 0.0])
    assert np.allclose(place + size / 2, [*high, model.body_height])
    assert numbers(front, "origin", "xyz")[0] > 0.3 * (high - low)[0]
    assert len(scanners) == len(model.scanners) + len(model.clouds)
