"""The transform tree interpolates and names what is missing."""

import math

import pytest

from ambler.core.errors import TransformError, TransformLoopError
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.core.transforms import TransformTree


def planar(x: float, y: float, yaw: float) -> SE3:
    return SE3.from_se2(SE2(x, y, yaw))


@pytest.fixture
def tree() -> TransformTree:
    tree = TransformTree()
    tree.set_static("base", "laser", planar(0.2, 0.0, 0.0))
    tree.set("odom", "base", 1_000_000_000, planar(0.0, 0.0, 0.0))
    tree.set("odom", "base", 2_000_000_000, planar(1.0, 0.0, math.pi / 2))
    tree.set("map", "odom", 1_500_000_000, planar(10.0, 0.0, 0.0))
    return tree


def test_interpolates_between_two_times(tree: TransformTree) -> None:
    pose = tree.lookup("odom", "base", 1_500_000_000).to_se2()
    assert (pose.x, pose.yaw) == (pytest.approx(0.5), pytest.approx(math.pi / 4))


def test_composes_along_the_tree_both_ways(tree: TransformTree) -> None:
    there = tree.lookup("map", "laser").to_se2()
    assert (there.x, there.y) == (pytest.approx(11.0), pytest.approx(0.2))
    back = tree.lookup("laser", "map").to_se2()
    again = there @ back
    assert again.distance_to(SE2()) < 1e-12


def test_names_the_missing_edge(tree: TransformTree) -> None:
    with pytest.raises(TransformError, match="no connection from camera to map: camera and map share no parent"):
        tree.lookup("map", "camera")


def test_names_the_edge_that_ends_too_early(tree: TransformTree) -> None:
    with pytest.raises(TransformError, match=r"odom_from_base ends 0\.500 s before"):
        tree.lookup("odom", "base", 2_500_000_000)
    with pytest.raises(TransformError, match=r"odom_from_base begins 0\.500 s after"):
        tree.lookup("odom", "base", 500_000_000)


def test_refuses_a_second_parent(tree: TransformTree) -> None:
    with pytest.raises(TransformError, match="base already hangs under odom"):
        tree.set("map", "base", 3_000_000_000, SE3())


def test_forgets_old_times() -> None:
    tree = TransformTree(history=1.0)
    for i in range(50):
        tree.set("odom", "base", i * 100_000_000, planar(i, 0, 0))
    with pytest.raises(TransformError, match="begins"):
        tree.lookup("odom", "base", 0)


def test_refuses_a_frame_under_itself_at_any_depth(tree: TransformTree) -> None:
    with pytest.raises(TransformLoopError, match="camera cannot hang under itself"):
        tree.set("camera", "camera", 1_000_000_000, SE3())
    with pytest.raises(TransformLoopError, match="map cannot hang under laser"):
        tree.set("laser", "map", 1_000_000_000, SE3())
    with pytest.raises(TransformLoopError, match="base cannot hang under laser"):
        tree.set_static("laser", "base", SE3())
    with pytest.raises(TransformLoopError, match="odom cannot hang under itself"):
        tree.set_static("odom", "odom", SE3())
    assert tree.lookup("map", "laser", 1_500_000_000).to_se2().x == pytest.approx(
        10.0 + 0.5 + 0.2 * math.cos(math.pi / 4)
    )
    with pytest.raises(TransformError, match="no connection from camera"):
        tree.lookup("map", "camera")
