"""Depth cameras against geometry: planes at every distance, noise that grows with its square, edges, losses, and where they look on robots."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import Image
from ambler.core.se2 import SE2
from ambler.robots.depth import optical, with_depth_cameras
from ambler.sim.depth_camera import DepthCameraSensor
from ambler.sim.faults import Fault
from ambler.sim.rig_errors import with_depth_mounts_off
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.scene import build_scene
from ambler.sim.sensors import D430, DepthCameraSpec
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.world_file import load_world

AHEAD = optical((0.0, 0.0, 1.0), 0.0, 0.0)


def wall(distance: float, z_min: float = 0.0, z_max: float = 20.0, width: float = 60.0) -> Solid:
    return Solid("wall", Shape.BOX, SE2(distance + 0.5, 0.0, 0.0), 1.0, width, z_min, z_max)


def camera(*solids: Solid, spec: DepthCameraSpec = D430, seed: int = 1) -> DepthCameraSensor:
    return DepthCameraSensor(spec, "depth", build_scene(WorldSpec("w", solids, SE2())), seed)


@pytest.mark.parametrize("pitch", [0.0, 20.0, 60.0])
def test_floor_and_walls_lie_where_geometry_puts_them(pitch: float) -> None:
    pose, spec = optical((0.2, 0.1, 0.8), 25.0, pitch), D430.perfect()
    depth = camera(wall(3.0), spec=spec).take(pose, 0).depth
    v, u = np.nonzero(depth)
    model = spec.model
    z = 0.001 * depth[v, u]
    points = pose.transform(np.stack([z * (u - model.cx) / model.fx, z * (v - model.cy) / model.fy, z], axis=1))
    off = np.minimum(np.abs(points[:, 2]), np.abs(points[:, 0] - 3.0))
    assert len(points) > 0.5 * depth.size
    assert off.max() < 0.002  # a millimetre of rounding
    assert points[:, 0].max() < 3.002
    assert points[:, 2].min() > -0.002


def test_the_fields_of_view_are_those_of_the_sheet() -> None:
    model = D430.model
    assert math.degrees(2.0 * math.atan(0.5 * model.width / model.fx)) == pytest.approx(87.0)
    assert math.degrees(2.0 * math.atan(0.5 * model.height / model.fy)) == pytest.approx(58.0)


def test_noise_grows_with_the_square_of_the_distance() -> None:
    spreads = []
    for distance in (1.0, 2.0, 4.0):
        depth = camera(wall(distance)).take(AHEAD, 0).depth
        seen = 0.001 * depth[20:40, 30:76][depth[20:40, 30:76] > 0]
        assert np.mean(seen) == pytest.approx(distance, abs=0.01)
        spreads.append(float(np.std(seen)))
    assert spreads[0] == pytest.approx(D430.sigma, rel=0.15)
    assert spreads[1] / spreads[0] == pytest.approx(4.0, rel=0.2)
    assert spreads[2] / spreads[1] == pytest.approx(4.0, rel=0.2)


def test_losses_and_limits() -> None:
    parts = [(camera(wall(2.0), seed=k).take(AHEAD, 0).depth[:30] == 0).mean() for k in range(20)]
    expected = 1.0 - (1.0 - D430.dropout) * (1.0 - D430.patches)
    assert np.mean(parts) == pytest.approx(expected, rel=0.3)
    assert not camera(wall(0.25)).take(AHEAD, 0).depth.any()
    assert not camera(wall(10.5)).take(AHEAD, 0).depth[:29].any()


def test_beside_an_edge_elements_fly_between_the_two_surfaces_or_are_lost() -> None:
    near = Solid("post", Shape.BOX, SE2(1.5, 0.0, 0.0), 0.2, 0.5, 0.0, 20.0)
    quiet = replace(D430, sigma=0.0, dropout=0.0, patches=0.0)
    sensor = camera(near, wall(3.0), spec=quiet)
    flying = lost = elements = 0
    for _ in range(20):
        depth = sensor.take(AHEAD, 0).depth[:25]
        between = (depth > 1450) & (depth < 2950)
        columns = np.nonzero(between.any(axis=0))[0]
        assert set(columns.tolist()) <= {42, 43, 62, 63, 64}, "they fly at edges only"
        flying, lost, elements = flying + between.sum(), lost + (depth == 0).sum(), elements + 2 * len(depth)
    assert flying / elements == pytest.approx(D430.flying, abs=0.06)
    assert lost / elements == pytest.approx(D430.shadow, abs=0.06)


def test_the_same_seed_takes_the_same_pictures() -> None:
    a, b, other = (camera(wall(2.0), seed=seed).take(AHEAD, 0).depth for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert (a != other).mean() > 0.5


@pytest.mark.parametrize("name", robot_names())
def test_every_robot_can_carry_them_and_they_see_the_floor_ahead(name: str) -> None:
    robot = robot_named(f"{name}+depth")
    frames = [mount.frame for mount in robot.model.depth_cameras]
    assert frames == list(robot.depth_cameras)
    assert len(frames) == (5 if name == "spot" else 1)
    mount = robot.model.depth_cameras[0].base_from_sensor
    floor = camera(spec=D430.perfect()).take(mount, 0).depth
    row = int(np.nonzero(floor[:, 53])[0][-1])  # a low camera has the nearest floor too near
    lowest = 0.001 * floor[row, 53]
    point = mount.transform(np.array([[0.0, lowest * (row - D430.model.cy) / D430.model.fy, lowest]]))[0]
    assert point[2] == pytest.approx(0.0, abs=0.01)
    assert 0.2 < point[0] - robot.model.footprint[:, 0].max() < 1.4


def test_spots_five_look_all_around() -> None:
    model = robot_named("spot+depth").model
    looking = [m.base_from_sensor.matrix()[:3, 2] for m in model.depth_cameras]
    headings = np.sort([math.degrees(math.atan2(d[1], d[0])) % 360.0 for d in looking])
    gaps = np.diff([*headings.tolist(), headings[0] + 360.0])
    assert gaps.max() - 87.0 < 10.0, "what lies between two pictures is narrow"


def test_a_second_set_is_refused() -> None:
    with pytest.raises(BadInputError, match="already"):
        with_depth_cameras(robot_named("diff+depth").model)


def pictures(faults: tuple[Fault, ...] = ()) -> list[Image]:
    config = SimulationConfig(physics="kinematic", faults=faults)
    simulation = Simulation(load_world("lab_empty"), robot_named("porter+depth"), config)
    simulation.devices.depth_cameras[0].request(10**12)
    return simulation.step(1_000_000_000).images


def test_a_device_sends_ten_pictures_a_second_while_they_are_wanted_and_faults_reach_it() -> None:
    assert len(pictures()) == 11  # from 0 to 1 s
    assert len(pictures((Fault.parse("scanner_dropout@depth_front:0.45"),))) == 5
    simulation = Simulation(load_world("lab_empty"), robot_named("porter+depth"), SimulationConfig(physics="kinematic"))
    assert not simulation.step(1_000_000_000).images


def test_mounts_that_are_off_are_off_by_as_much_and_drawn_by_the_seed() -> None:
    robot = robot_named("spot+depth")
    built = with_depth_mounts_off(robot, 3, 0.05, math.radians(3.0))
    offs = [
        a.base_from_sensor.inverse() @ b.base_from_sensor
        for a, b in zip(robot.model.depth_cameras, built.model.depth_cameras, strict=True)
    ]
    for off in offs:
        assert 0.0 < max(abs(v) for v in off.translation) <= 0.05
        assert 0.0 < 2.0 * math.acos(min(1.0, abs(off.rotation[0]))) < math.radians(3.0 * 1.75)
    assert len({off.translation for off in offs}) == 5
    again = with_depth_mounts_off(robot, 3, 0.05, math.radians(3.0)).model.depth_cameras
    assert [m.base_from_sensor for m in again] == [m.base_from_sensor for m in built.model.depth_cameras]
    assert built.model.sensor("velodyne") == robot.model.sensor("velodyne")
