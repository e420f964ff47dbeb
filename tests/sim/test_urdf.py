"""Robots as URDF: built-in ones survive the round trip, an integrator's file drives, and mistakes get one clear line."""

import math
import re
import struct
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import MERGED_FRAME, DriveKind
from ambler.sim.camera import FRONT_CAMERA, PictureNoise
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.sensors import MEMS_IMU, SCANNER_360
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import WorldSpec
from ambler.sim.urdf_writer import save_urdf

# The base link sits at the wheels' axle; the laser stands turned on a mast, the body is a box and a cylinder.
INTEGRATOR = """<?xml version="1.0"?>
<robot name="cart">
  <link name="base_link">
    <inertial><mass value="20"/></inertial>
    <collision><origin xyz="0 0 0.1"/><geometry><box size="0.6 0.4 0.2"/></geometry></collision>
  </link>
  <link name="nose">
    <inertial><mass value="2"/></inertial>
    <collision><geometry><cylinder radius="0.2" length="0.1"/></geometry></collision>
  </link>
  <joint name="nose_joint" type="fixed"><parent link="base_link"/><child link="nose"/><origin xyz="0.3 0 0.1"/></joint>
  <link name="wheel_l"><visual><geometry><cylinder radius="0.1" length="0.04"/></geometry>
    <origin rpy="1.5707963 0 0"/></visual></link>
  <joint name="l" type="continuous"><parent link="base_link"/><child link="wheel_l"/><origin xyz="0 0.15 0"/></joint>
  <link name="wheel_r"><visual><geometry><cylinder radius="0.1" length="0.04"/></geometry>
    <origin rpy="1.5707963 0 0"/></visual></link>
  <joint name="r" type="continuous"><parent link="base_link"/><child link="wheel_r"/><origin xyz="0 -0.15 0"/></joint>
  <link name="mast"/>
  <joint name="m" type="fixed"><parent link="base_link"/><child link="mast"/><origin xyz="0.1 0 0.2" rpy="0 0 1.5707963267948966"/></joint>
  <link name="laser_link"/>
  <joint name="s" type="fixed"><parent link="mast"/><child link="laser_link"/><origin xyz="0.05 0 0.1"/></joint>
  <ambler>
    <limits vx_max="0.6"/>
    <lidar link="laser_link" columns="360" range_max="12"/>
  </ambler>
</robot>
"""


def write(folder: Path, text: str = INTEGRATOR) -> Path:
    path = folder / "robot.urdf"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", [*robot_names(), "diff+ultrasonic", "spot+depth"])
def test_built_in_robots_survive_the_round_trip(name: str, tmp_path: Path) -> None:
    robot = robot_named(name)
    save_urdf(robot, tmp_path / "robot.urdf")
    again = robot_named(str(tmp_path / "robot.urdf"))
    for f in fields(robot):
        if f.name != "model":
            assert getattr(again, f.name) == getattr(robot, f.name), f.name
    assert again.model.limits == robot.model.limits
    assert again.model.drive is robot.model.drive
    assert again.model.body_height == robot.model.body_height
    np.testing.assert_array_equal(again.model.footprint, robot.model.footprint)
    assert [s.frame for s in again.model.sensors] == [s.frame for s in robot.model.sensors]
    for a, b in zip(again.model.sensors, robot.model.sensors, strict=True):
        assert (a.kind, a.range_min, a.azimuth, a.elevation) == (b.kind, b.range_min, b.azimuth, b.elevation)
        np.testing.assert_allclose(a.base_from_sensor.matrix(), b.base_from_sensor.matrix(), atol=1e-12)


def test_an_integrators_file_becomes_a_robot(tmp_path: Path) -> None:
    robot = robot_named(str(write(tmp_path)))
    model = robot.model
    assert (model.name, model.drive, robot.mass) == ("cart", DriveKind.DIFFERENTIAL, 22.0)
    assert (robot.wheel_radius, robot.track, robot.wheel_base) == pytest.approx((0.1, 0.3, 0.0))
    # The base stands on the floor, one wheel radius under the base link; the body reaches from 0.1 to 0.3 m above it.
    assert (robot.body_bottom, model.body_height) == pytest.approx((0.1, 0.3))
    np.testing.assert_allclose(model.footprint.max(axis=0), (0.5, 0.2), atol=1e-9)
    np.testing.assert_allclose(model.footprint.min(axis=0), (-0.3, -0.2), atol=1e-9)
    laser = model.sensor("laser_link")
    np.testing.assert_allclose(laser.base_from_sensor.translation, (0.1, 0.05, 0.4), atol=1e-9)
    assert laser.base_from_sensor.to_se2().yaw == pytest.approx(math.pi / 2)
    assert model.limits.vx_max == 0.6
    assert robot.lidars["laser_link"].columns == 360
    assert robot.lidars["laser_link"].sigma_0 == SCANNER_360.sigma_0
    assert list(robot.imus.values()) == [MEMS_IMU]
    twice = np.roll(model.footprint, -1, axis=0)
    assert np.sum(model.footprint[:, 0] * twice[:, 1] - model.footprint[:, 1] * twice[:, 0]) > 0, "counter-clockwise"


def turning(name: str, parent: str, place: str, shape: str, axis: str, kind: str = "continuous") -> str:
    """Return a link with a shape, and the joint that turns it."""
    origin = '<origin rpy="1.5707963 0 0"/>' if "cylinder" in shape else ""
    geometry = f"<collision>{origin}<geometry>{shape}</geometry></collision>" if shape else ""
    joint = f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
    return f'<link name="{name}">{geometry}</link><joint name="{name}_joint" type="{kind}">{joint}</joint>'


def with_links(folder: Path, *links: str) -> Path:
    return write(folder, INTEGRATOR.replace("</robot>", "".join(links) + "</robot>"))


@pytest.mark.parametrize("kind", ["fixed", "revolute", "continuous"])
def test_a_mast_is_body_however_it_pans(kind: str, tmp_path: Path) -> None:
    """What turns without end above the floor is no wheel: neither a mast nor the drum of a scanner."""
    mast = turning("tower", "base_link", "0 0 0.4", '<box size="0.1 0.1 0.4"/>', "0 0 1", kind)
    drum = turning("drum", "base_link", "0 0 0.3", '<cylinder radius="0.2" length="0.1"/>', "0 1 0", kind)
    assert robot_named(str(with_links(tmp_path, drum))).model.body_height == pytest.approx(0.6)
    robot = robot_named(str(with_links(tmp_path, mast, drum)))
    assert robot.model.body_height == pytest.approx(0.7)
    assert (robot.wheel_radius, robot.track) == pytest.approx((0.1, 0.3))
    assert robot.model.drive is DriveKind.DIFFERENTIAL


def test_casters_are_wheels_that_do_not_drive(tmp_path: Path) -> None:
    """Swivel casters change neither radius nor track, nor how low the body reaches; a tire that is fixed to a hub is its wheel's."""
    tire = '<cylinder radius="0.03" length="0.02"/>'
    links = []
    for side, y in (("left", 0.2), ("right", -0.2)):
        links.append(turning(f"fork_{side}", "base_link", f"-0.2 {y} 0", "", "0 0 1"))
        links.append(turning(f"hub_{side}", f"fork_{side}", "-0.03 0 -0.07", "", "0 1 0"))
        links.append(turning(f"tire_{side}", f"hub_{side}", "0 0 0", tire, "0 0 1", "fixed"))
    robot = robot_named(str(with_links(tmp_path, *links)))
    assert (robot.wheel_radius, robot.track, robot.body_bottom) == pytest.approx((0.1, 0.3, 0.1))
    assert robot.model.drive is DriveKind.DIFFERENTIAL


def test_it_drives_and_measures_a_wall(tmp_path: Path, wall_ahead: WorldSpec) -> None:
    simulation = Simulation(wall_ahead, robot_named(str(write(tmp_path))), SimulationConfig(0, True))
    for _ in range(20):
        simulation.command(BodyVelocity(0.5, 0.0, 0.0))
        out = simulation.step(simulation.now_ns + 50_000_000)
    x = simulation.world_from_base.translation[0]
    assert x == pytest.approx(0.5 - 0.5 * 0.5 / 2.0, abs=0.05)
    scan = out.scans[-1] if out.scans else simulation.step(simulation.now_ns + 100_000_000).scans[-1]
    ahead = round((-math.pi / 2 - scan.angle_min) / scan.angle_increment)
    assert scan.ranges[ahead] == pytest.approx(3.0 - 0.1 - x, abs=0.06)


@pytest.mark.parametrize("name", ["part.stl", "ascii.stl", "part.obj", "part%201.obj"])
def test_meshes_count_by_their_hull(name: str, tmp_path: Path) -> None:
    corners = [(0.4, 0.3, 0), (-0.4, 0.3, 0), (-0.4, -0.3, 0), (0.4, -0.3, 0.25)]
    mesh = tmp_path / "cart" / "meshes" / name.replace("%20", " ")
    mesh.parent.mkdir(parents=True)
    if name == "part.stl":
        faces = [(corners[0], corners[1], corners[2]), (corners[0], corners[2], corners[3])]
        rows = b"".join(struct.pack("<12fH", 0, 0, 1, *(v for c in f for v in c), 0) for f in faces)
        mesh.write_bytes(b"binary".ljust(80, b" ") + struct.pack("<I", 2) + rows)
    elif name == "ascii.stl":
        mesh.write_text("solid x\nfacet normal 0 0 1\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners))
    else:
        mesh.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\n")
    geometry = f'<mesh filename="package://cart/meshes/{name}" scale="1 1 2"/>'
    text = INTEGRATOR.replace('<box size="0.6 0.4 0.2"/>', geometry).replace(
        'radius="0.2" length="0.1"', 'radius="0.05" length="0.1"'
    )
    (tmp_path / "cart" / "urdf").mkdir()
    robot = robot_named(str(write(tmp_path / "cart" / "urdf", text)))
    np.testing.assert_allclose(np.ptp(robot.model.footprint, axis=0), (0.8, 0.6), atol=1e-6)
    assert robot.model.body_height == pytest.approx(0.1 + 0.1 + 0.5)


def test_several_scanners_get_a_virtual_one(tmp_path: Path) -> None:
    extra = '<lidar link="mast" model="safety_270" window_deg="-134 130"/>'
    text = INTEGRATOR.replace(
        "<limits", extra.replace("window_deg", "window").replace("-134 130", "-2.3 2.2") + "<limits"
    )
    model = robot_named(str(write(tmp_path, text))).model
    assert [m.frame for m in model.scanners] == ["mast", "laser_link"]
    assert model.sensor("mast").azimuth == (-2.3, 2.2)
    assert model.sensor(MERGED_FRAME).base_from_sensor.translation[2] == pytest.approx(0.35)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('<lidar link="laser_link"', '<lidar link="lazer"', "lazer"),
        ('columns="360"', 'columns="many"', "columns"),
        ('columns="360"', 'colums="360"', "colums"),
        ('columns="360"', 'model="hal_9000"', "hal_9000"),
        ("<limits", "<limit", "<limit>"),
        ('vx_max="0.6"', 'vx_max="-0.6"', "<limits>: vx_max must be positive, is -0.6"),
        ('vx_max="0.6"', 'vx_max="0"', "<limits>: vx_max must be positive, is 0"),
        ('vx_max="0.6"', 'vx_max="inf"', "<limits>: vx_max must be a number"),
        ('vx_max="0.6"', 'vx_min="0.3"', "<limits>: vx_min must be 0 or negative, is 0.3"),
        ('vx_max="0.6"', 'vy_max="-0.1"', "<limits>: vy_max must be 0 or positive, is -0.1"),
        ('vx_max="0.6"', 'wz_max="0"', "<limits>: wz_max must be positive, is 0"),
        ('vx_max="0.6"', 'az_max="-1"', "<limits>: az_max must be positive, is -1"),
        ('vx_max="0.6"', 'ax_brake="0"', "<limits>: ax_brake must be positive, is 0"),
        ("<ambler>", '<ambler track="5">', "<ambler>: the track of 5 m is more than twice the body's width of 0.4 m"),
        ('"0.05 0 0.1"', '"0.05 0 -0.9"', "<lidar link='laser_link'>: lies 0.6 m below the floor"),
        ('<ambler>', '<ambler drive="wings">', "wings"),
        ('<ambler>', '<ambler drive="omni">', "mecanum"),
        ('<parent link="mast"/>', '<parent link="mist"/>', "mist"),
        ('<parent link="mast"/>', '<parent link="laser_link"/>', "circle"),
        ('<parent link="mast"/>', "", "parent"),
        ('<link name="mast"/>', "<link/>", "has no name"),
        ('<link name="mast"/>', '<link name="mast"/><link name="alone"/>', "alone"),
        ('size="0.6 0.4 0.2"', 'size="0.6 0.4"', "size"),
        ('size="0.6 0.4 0.2"', 'size="0.6 0.4 nan"', "size"),
        ('<box size="0.6 0.4 0.2"/>', '<mesh filename="package://no/such.stl"/>', "such.stl"),
        ('<box size="0.6 0.4 0.2"/>', "<capsule/>", "capsule"),
        ('<mass value="20"/>', '<mass value="-20"/>', "negative"),
        ("</robot>", "", "XML"),
        ("<robot name", "<robots name", "XML"),
        ('<robot name="cart">', '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot name="cart">', "DOCTYPE"),
        ("<ambler>", '<ambler><footprint points="0 0 1 0"/>', "footprint"),
        ("<ambler>", '<ambler><footprint points="0 0 1 0 0.1 0.1 0 1"/>', "convex"),
    ],
)  # fmt: skip
def test_mistakes_get_one_clear_line(old: str, new: str, place: str, tmp_path: Path) -> None:
    assert old in INTEGRATOR
    with pytest.raises(BadInputError, match=re.escape(place)) as caught:
        robot_named(str(write(tmp_path, INTEGRATOR.replace(old, new))))
    assert "\n" not in str(caught.value)
    assert "robot.urdf" in str(caught.value)


def test_the_command_exports_and_shows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "amr.urdf"
    assert main(["robot", "export", "amr_omni", str(path)]) == 0
    assert main(["robot", "show", str(path)]) == 0
    assert "amr_omni: omni drive, 1.20 x 0.80 m, 150 kg" in capsys.readouterr().out
    assert main(["robot", "show", str(tmp_path / "none.urdf")]) == 2
    assert main(["robot", "export", "amr_omni", str(tmp_path / "no" / "folder.urdf")]) == 2


def test_a_camera_has_its_own_lens_and_noise(tmp_path: Path) -> None:
    camera = '<camera link="mast" width="320" fx="300" distortion="0 0 0 0 0" noise="1.5" rate_hz="10"/>'
    robot = robot_named(str(write(tmp_path, INTEGRATOR.replace("<limits", camera + "<limits"))))
    camera_spec = robot.cameras["mast"]
    assert camera_spec.model == replace(FRONT_CAMERA, width=320, fx=300.0, distortion=(0.0,) * 5)
    assert camera_spec.picture == PictureNoise(noise=1.5)
    assert camera_spec.rate_hz == 10.0


@pytest.mark.parametrize("attribute", ['distortion="0 0"', 'zoom="2"', 'name="front"', 'rate_hz="fast"'])
def test_a_camera_with_a_bad_attribute_is_refused(attribute: str, tmp_path: Path) -> None:
    text = INTEGRATOR.replace("<limits", f'<camera link="mast" {attribute}/><limits')
    with pytest.raises(BadInputError, match="<camera"):
        robot_named(str(write(tmp_path, text)))
