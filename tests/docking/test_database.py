"""The dock database keeps what it was given, learns from dockings, and refuses bad files with the field that is wrong."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.docking.database import DockDatabase
from ambler.docking.dock import Contacts, Dock, DockKind
from tests.docking.docks import MARKER_DOCK, NOTCH, REFLECTORS, WEDGE

FILE = """docks:
  charger_1:
    type: markers
    pose: [4.2, 1.0, 90.0]
    offset: [0.0, 0.002, 0.5]
    approach_distance: 0.9
    contacts: charge
    outline: [[0.62, -0.3], [0.9, -0.3], [0.9, 0.3], [0.62, 0.3]]
    markers:
      - {dictionary: 4X4_50, id: 3, size: 0.15, pose: [0.95, 0.0, 0.32, 0.0]}
  lathe:
    type: v_shape
    pose: [0.0, 1.0, 0.0]
    contacts: none
    outline: [[0.62, -0.3], [0.9, -0.3], [0.9, 0.3], [0.62, 0.3]]
    v_shape: {angle: 120, leg: 0.2, pose: [0.8, 0.0, 0.0]}
"""


def same(a: Dock, b: Dock) -> bool:
    flat = replace(a, outline=b.outline, reflectors=b.reflectors, map_from_dock=b.map_from_dock, offset=b.offset,
                   v_shape=b.v_shape, markers=b.markers)  # fmt: skip
    poses = [(a.map_from_dock, b.map_from_dock), (a.offset, b.offset)]
    if a.v_shape and b.v_shape:
        poses.append((a.v_shape.dock_from_corner, b.v_shape.dock_from_corner))
        assert a.v_shape.angle == pytest.approx(b.v_shape.angle)
    for m, n in zip(a.markers, b.markers, strict=True):
        assert m.spec == n.spec
        assert (m.x, m.y, m.z, m.yaw) == pytest.approx((n.x, n.y, n.z, n.yaw))
    close = all(np.allclose(p.as_array(), q.as_array()) for p, q in poses)
    arrays = np.array_equal(a.outline, b.outline) and np.array_equal(a.reflectors, b.reflectors)
    fields = ("name", "kind", "approach_distance", "contacts", "dockings")
    return close and arrays and all(getattr(flat, f) == getattr(b, f) for f in fields)


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "docks.yaml"
    path.write_text(FILE)
    base = DockDatabase.load(path)
    assert base.names == ("charger_1", "lathe")
    dock = base.dock("charger_1")
    assert dock.map_from_dock.yaw == pytest.approx(math.pi / 2)
    assert dock.map_from_staging.y == pytest.approx(0.1)
    assert dock.markers[0].dock_from_marker.rotate((0.0, 0.0, 1.0)) == pytest.approx((-1.0, 0.0, 0.0))
    assert dock.markers[0].dock_from_marker.rotate((0.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0))
    assert base.dock("lathe").approach_distance == 1.0
    assert base.dock("lathe").contacts is Contacts.NONE
    with pytest.raises(BadInputError, match=r"no dock 'nowhere'.*charger_1, lathe"):
        base.dock("nowhere")


@pytest.mark.parametrize("dock", [MARKER_DOCK, NOTCH, WEDGE, REFLECTORS], ids=lambda d: d.name)
def test_a_taught_dock_is_read_back(tmp_path: Path, dock: Dock) -> None:
    path = tmp_path / "docks.yaml"
    taught = DockDatabase(path, {}).teach(dock, SE2(1.25, -2.5, 0.75))
    assert taught.map_from_dock == SE2(1.25, -2.5, 0.75)
    assert same(DockDatabase.load(path).dock(dock.name), taught)
    assert [p.name for p in tmp_path.iterdir()] == ["docks.yaml"]


def test_every_docking_refines_the_pose(tmp_path: Path) -> None:
    base = DockDatabase(tmp_path / "docks.yaml", {})
    base.teach(NOTCH, SE2(1.03, 2.0, math.pi - 0.01))
    rng = np.random.default_rng(1)
    for _ in range(30):
        noise = (rng.normal(0.0, 1.0, 3) * (0.01, 0.01, 0.005)).tolist()
        base.refine("notch", SE2(1.0 + noise[0], 2.0 + noise[1], -math.pi + 0.01 + noise[2]))
    dock = DockDatabase.load(tmp_path / "docks.yaml").dock("notch")
    assert dock.dockings == 30
    assert dock.map_from_dock.distance_to(SE2(1.0, 2.0)) < 0.006
    assert abs(abs(dock.map_from_dock.yaw) - math.pi) < 0.015
    for bad in (SE2(1.5, 2.0, math.pi), SE2(1.0, 2.0, math.pi - 0.3), SE2(math.nan, 0.0, 0.0)):
        with pytest.raises(BadInputError):
            base.refine("notch", bad)
    assert base.dock("notch").map_from_dock.as_array() == pytest.approx(dock.map_from_dock.as_array())


def test_a_pose_is_the_mean_of_its_dockings_not_the_last_one(tmp_path: Path) -> None:
    """Twenty dockings, 1 cm to the left and to the right in turn: their mean is in the middle. What moved for good is followed in time."""
    base = DockDatabase(tmp_path / "docks.yaml", {})
    base.teach(NOTCH, SE2(1.0, 2.0, 0.0))
    for k in range(20):
        base.refine("notch", SE2(1.0, 2.01 if k % 2 else 1.99, 0.02 if k % 2 else -0.02))
    assert base.dock("notch").map_from_dock.distance_to(SE2(1.0, 2.0)) < 1e-3
    assert abs(base.dock("notch").map_from_dock.yaw) < 2e-3
    for _ in range(100):
        base.refine("notch", SE2(1.1, 2.0, 0.0))
    assert base.dock("notch").map_from_dock.distance_to(SE2(1.1, 2.0)) < 0.002


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("docks:", "dock:", "one table `docks`"),
        ("type: markers", "type: magic", "dock charger_1: type must be one of"),
        ("type: markers", "type: reflectors", "needs the field reflectors"),
        ("[4.2, 1.0, 90.0]", "[4.2, 1.0]", r"dock charger_1: pose \(x, y, degrees\) must be 3 numbers"),
        ("[4.2, 1.0, 90.0]", "[.nan, 1.0, 0]", "must be a number, not nan"),
        ("approach_distance: 0.9", "approach_distance: 9", "0.2 to 5 m"),
        ("contacts: charge", "contacts: yes", "contacts must be one of"),
        ("[0.9, 0.3], [0.62, 0.3]]\n    markers", "[0.62, 0.3], [0.9, 0.3]]\n    markers", "convex"),
        ("[0.9, 0.3]", "[9.0, 0.3]", "longer than 3 m"),
        ("size: 0.15, pose: [0.95, 0.0, 0.32, 0.0]", "size: 0.15", "marker 3 has no pose: without its offset"),
        ("size: 0.15", "size: 15", "0.01 to 2 m"),
        ("id: 3, ", "", "a marker needs"),
        ("4X4_50", "4", "dictionary must be a name"),
        ("offset:", "ofset:", "unknown field ofset"),
        ("angle: 120", "angle: 178", "30 to 165"),
        ("leg: 0.2", "leg: long", "leg must be a number"),
        ("charger_1", "7", "name of a dock"),
        ("docks:", "docks: [", "YAML"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "docks.yaml"
    assert old in FILE
    path.write_text(FILE.replace(old, new, 1))
    with pytest.raises(BadInputError, match=text):
        DockDatabase.load(path)


def test_a_marker_belongs_to_one_dock(tmp_path: Path) -> None:
    base = DockDatabase(tmp_path / "docks.yaml", {})
    base.teach(MARKER_DOCK, SE2())
    with pytest.raises(BadInputError, match="belongs to the docks charger and twin"):
        base.teach(replace(MARKER_DOCK, name="twin"), SE2())
    with pytest.raises(BadInputError, match="finite"):
        base.teach(NOTCH, SE2(math.inf, 0.0, 0.0))
    assert base.names == ("charger",)
    assert DockKind.MARKERS.value == "markers"
    with pytest.raises(BadInputError, match="cannot be read"):
        DockDatabase.load(tmp_path / "none.yaml")


def test_what_cannot_be_written_is_not_known(tmp_path: Path) -> None:
    """The disk fails during the second docking: the pose is that of the file, and the third docking counts as the second."""
    base = DockDatabase(tmp_path / "docks.yaml", {})
    base.teach(NOTCH, SE2(1.0, 2.0, 0.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ambler.docking.database.write_whole", _full_disk)
        with pytest.raises(OSError, match="full"):
            base.refine("notch", SE2(1.1, 2.0, 0.0))
        with pytest.raises(OSError, match="full"):
            base.teach(NOTCH, SE2(5.0, 2.0, 0.0))
    assert base.dock("notch").map_from_dock == DockDatabase.load(tmp_path / "docks.yaml").dock("notch").map_from_dock
    assert base.dock("notch").map_from_dock.x == 1.0


def _full_disk(path: Path, text: str) -> None:
    raise OSError("the disk is full")
