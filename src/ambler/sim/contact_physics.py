"""Contact physics with MuJoCo: two hinge wheels and a caster, or four spheres with a surface velocity (mecanum wheels, legs).

Slip, traction limits and pushing come out of the contact solver. A sphere's surface velocity is -(v + w x r) of the body
velocity that the wheels or legs work for (simulation.md §1b).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.se3 import SE3
from ambler.sim.base import Carriage, PlacedRobot, Touch
from ambler.sim.drive import after_strafe_loss, drive_of
from ambler.sim.movers import ground_under
from ambler.sim.pushing import PushingPeople, person_xml
from ambler.sim.sim_robot import SimRobot
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.surface_contact import STEEP, ground_names, rest_pose, surfaces_xml

FOOT_RADIUS = 0.05
WHEEL_WIDTH = 0.04
# Reflected inertia of motor and gear (kg m^2) and speed gain (N m s): the gain times the step stays below the inertia, so
# that an explicit integrator is stable; an implicit one would move wheels other than the contact solver assumed.
WHEEL_ARMATURE = 0.06
WHEEL_GAIN = 10.0
# Where the ground is not flat, wheels have an integral part too (1/s), or a robot that stands on a slope would creep down. It takes up
# to the load of a slope of 30 degrees.
WHEEL_INTEGRAL = 5.0
# Who walks and is pushed puts a foot aside: as far (m), and from which lean (rad) on; this much farther (rad) the foot carries everything, and from the last lean
# on he falls. `CATCH_TIME` (s) damps it.
ASIDE, STAGGER, CAUGHT, FALLING, CATCH_TIME = 0.2, math.radians(20.0), math.radians(8.0), math.radians(60.0), 0.1


class _Body:
    """One robot in the model: where its numbers lie in the arrays of MuJoCo."""

    def __init__(self, model: Any, data: Any, placed: PlacedRobot, first_sensor: int, first_motor: int) -> None:
        self.name, self.robot = placed.name, placed.robot
        self.drive = drive_of(placed.robot)
        self.turned = [0.0] * self.drive.parts
        base = model.body(f"{placed.name}/base")
        joint = int(model.body_jntadr[base.id])
        self.qpos, self.qvel = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        self.parts = frozenset(np.nonzero(model.body_rootid[model.geom_bodyid] == base.id)[0].tolist())
        self.has_wheels = placed.robot.has_two_wheels
        self.feet = [] if self.has_wheels else _find_feet(model, placed.name)
        self.walks = not placed.robot.wheel_radius
        self.base = int(base.id)
        self.sensor, self.motor = first_sensor, first_motor
        self.start = placed.start
        self._carried = np.zeros(2)
        self._carried_max = 0.25 * placed.robot.mass * 9.81 * placed.robot.wheel_radius / WHEEL_GAIN
        self.speed_before = (0.0, 0.0, 0.0)
        self.carriage = Carriage((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))

    def read(self, qpos: Any) -> None:
        """Take the pose of the base out of MuJoCo's state."""
        q = qpos[self.qpos : self.qpos + 7].tolist()
        self.carriage = Carriage((q[0], q[1], q[2]), (q[3], q[4], q[5], q[6]))

    def carry_load(self, ctrl: Any, qvel: Any, dt: float) -> None:
        """Add to the wheels' wanted rates in `ctrl` what the load, by which they fall short of them, asks for."""
        motors = slice(self.motor, self.motor + 2)
        missing = ctrl[motors] - qvel[self.qvel + 6 : self.qvel + 8]
        self._carried = np.clip(self._carried + WHEEL_INTEGRAL * dt * missing, -self._carried_max, self._carried_max)
        ctrl[motors] += self._carried

    def put_back(self, qpos: Any, rest: SE3 | None) -> None:
        """Move the base along the ground to where it started, and turn it to its first heading. On level ground (`rest` None) it becomes
        exactly level; `rest` is the pose in which it was put above other ground."""
        q, start = self.qpos, self.start
        if rest is None:
            qpos[q : q + 2] = (start.x, start.y)
            qpos[q + 3 : q + 7] = (math.cos(0.5 * start.yaw), 0.0, 0.0, math.sin(0.5 * start.yaw))
        else:
            rested = SE3(tuple(qpos[q : q + 3]), tuple(qpos[q + 3 : q + 7]))
            up = rest.matrix()[:3, 2]
            lifted = up * float(up @ np.subtract(rested.translation, rest.translation))
            back = rest.to_se2().yaw - rested.to_se2().yaw
            turned = SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, back) @ rested
            qpos[q : q + 3], qpos[q + 3 : q + 7] = np.add(rest.translation, lifted), turned.rotation
        qpos[q + 7 : q + 7 + 2 * self.has_wheels] = 0.0
        self.turned = [0.0] * self.drive.parts


class ContactPhysics:
    """Robots in one world that push what they touch, each other too. See `sim.base.Physics`."""

    def __init__(
        self,
        world: WorldSpec,
        robots: Sequence[PlacedRobot],
        dt: float,
        movers: Sequence[Solid] = (),
        masses: Sequence[float] = (),
    ) -> None:
        """The first of the `movers` are people of so many kg."""
        self._model: Any = mujoco.MjModel.from_xml_string(build_mjcf(world, robots, dt, movers, masses))
        self._data: Any = mujoco.MjData(self._model)
        self._step: Any = mujoco.mj_step
        self._dt = dt
        self._qpos, self._qvel, self._ctrl = self._data.qpos, self._data.qvel, self._data.ctrl
        self._surface = self._model.geom_surfacevel
        self._floor = self._model.geom("floor").id
        self._hull_force = self._data.sensordata
        self._bodies: list[_Body] = []
        self._people = PushingPeople(self._model, self._data, [m.name for m in movers[: len(masses)]], masses, dt)
        for k, placed in enumerate(robots):
            motor = 2 * sum(body.has_wheels for body in self._bodies)
            self._bodies.append(_Body(self._model, self._data, placed, k, motor))
        self._is_flat = world.is_flat
        self._world = world
        self._is_ground, self._is_gear = self._find_ground(world)
        self._settle(world)

    def step(self, targets: Sequence[BodyVelocity]) -> None:
        """Advance by one physics step."""
        for body, target in zip(self._bodies, targets, strict=True):
            if body.has_wheels:
                self._ctrl[body.motor], self._ctrl[body.motor + 1] = body.drive.rates(target)
                if not self._is_flat:
                    body.carry_load(self._ctrl, self._qvel, self._dt)
            else:
                self._set_surface(body, target)
                if body.walks:
                    self._catch(body)
            v, first = self._qvel, body.qvel
            body.speed_before = (float(v[first]), float(v[first + 1]), float(v[first + 5]))
        if self._people.count:
            self._people.walk(is_met=any(self._hull_force[body.sensor] != 0.0 for body in self._bodies))
        self._step(self._model, self._data)
        for body in self._bodies:
            body.read(self._qpos)

    def _catch(self, body: _Body) -> None:
        """Let a walking base that is pushed over put a foot aside: what then stands beside it turns it back up."""
        w, x, y, z = body.carriage.rotation
        up_x, up_y, up_z = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
        torque = self._data.xfrc_applied[body.base, 3:]
        lean = math.acos(min(up_z, 1.0))
        if not STAGGER < lean < FALLING:
            torque[:] = 0.0
            return
        back = np.array([up_y, -up_x, 0.0]) / math.sin(lean)
        turn = self._data.xmat[body.base].reshape(3, 3).T @ back
        rate = float(turn @ self._qvel[body.qvel + 3 : body.qvel + 6])
        share = (lean - STAGGER - CATCH_TIME * rate) / CAUGHT
        torque[:] = min(max(share, 0.0), 1.0) * ASIDE * 9.81 * body.robot.mass * back

    def carriage(self, robot: int) -> Carriage:
        """Where a base is."""
        return self._bodies[robot].carriage

    def travel(self, robot: int) -> tuple[float, ...]:
        """What its encoders or legs have counted."""
        body = self._bodies[robot]
        if body.has_wheels:
            return (float(self._qpos[body.qpos + 7]), float(self._qpos[body.qpos + 8]))
        return tuple(body.turned)

    def move(self, places: Sequence[tuple[float, float]]) -> None:
        """Put doors to where they are now, and let people head for where they want to be."""
        people = self._people.count
        self._people.head_for(places[:people])
        if people and not self._is_flat:
            self._people.stand_on(ground_under(self._world, np.array(self._people.places())))
        for k, (x, y) in enumerate(places[people:]):
            self._data.mocap_pos[k, 0] = x
            self._data.mocap_pos[k, 1] = y

    def people(self) -> Sequence[tuple[float, float]]:
        """Where people are."""
        return self._people.places()

    def touches(self, robot: int) -> tuple[Touch, ...]:
        """Contacts of the robot's own parts with solids and other robots, at the end of the last step."""
        body = self._bodies[robot]
        if self._hull_force[body.sensor] == 0.0:
            return ()
        contact = self._data.contact
        geoms = contact.geom
        is_touch = (geoms != self._floor).all(axis=1) & (contact.dist < 1e-3)
        if not self._is_flat:
            is_driving = self._is_ground[geoms].any(axis=1) & self._is_gear[geoms].any(axis=1)
            is_touch &= ~(is_driving & (np.abs(contact.frame[:, 2]) >= STEEP))
        others = np.nonzero(is_touch)[0]
        touches = (self._touch(body, int(k)) for k in others)
        return tuple(touch for touch in touches if touch is not None)

    def _touch(self, body: _Body, k: int) -> Touch | None:
        contact = self._data.contact[k]
        a, b = int(contact.geom[0]), int(contact.geom[1])
        if a not in body.parts and b not in body.parts:
            return None
        part, solid = (a, b) if a in body.parts else (b, a)
        x, y, z = (float(p) for p in contact.pos)
        vx, vy, wz = body.speed_before
        cx, cy, _ = body.carriage.position
        speed = math.hypot(vx - wz * (y - cy), vy + wz * (x - cx))
        force = np.zeros(6)
        mujoco.mj_contactForce(self._model, self._data, k, force)
        part_name = self._model.geom(part).name.split("/", 1)[1]
        return Touch(part_name, self._name_of(solid), (x, y, z), speed, float(abs(force[0])))

    def _name_of(self, geom: int) -> str:
        """The name of a solid, or that of the robot whose part it is."""
        for body in self._bodies:
            if geom in body.parts:
                return body.name
        return str(self._model.geom(geom).name.rsplit("#", 1)[0])

    def _set_surface(self, body: _Body, target: BodyVelocity) -> None:
        moved = after_strafe_loss(body.robot, target)
        for geom, x, y in body.feet:
            self._surface[geom, 0] = -(moved.vx - moved.wz * y)
            self._surface[geom, 1] = -(moved.vy + moved.wz * x)
        for k, rate in enumerate(body.drive.rates(target)):
            body.turned[k] += rate * self._dt

    def _find_ground(self, world: WorldSpec) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Tell of every geom whether it is terrain or mesh, and whether it is a wheel, caster or foot of any robot."""
        grounds = ground_names(world)
        names = [str(self._model.geom(k).name) for k in range(self._model.ngeom)]
        own = frozenset[int]().union(*(body.parts for body in self._bodies))
        is_ground = [k not in own and name.rpartition("#")[0] in grounds for k, name in enumerate(names)]
        is_gear = [k in own and name.rpartition("/")[2] != "body" for k, name in enumerate(names)]
        return np.array(is_ground), np.array(is_gear)

    def _settle(self, world: WorldSpec) -> None:
        """Let the robots come to rest on the ground, then put them back to where they start."""
        rests = [None if self._is_flat else rest_pose(world, b.start, b.robot.model.footprint) for b in self._bodies]
        for body, rest in zip(self._bodies, rests, strict=True):
            if rest is not None:
                q = body.qpos
                self._qpos[q : q + 3], self._qpos[q + 3 : q + 7] = rest.translation, rest.rotation
            if not body.has_wheels:
                self._set_surface(body, BodyVelocity())
        for _ in range(200):
            self._ctrl[:] = 0.0
            for body in self._bodies:
                if body.has_wheels and not self._is_flat:
                    body.carry_load(self._ctrl, self._qvel, self._dt)
            self._step(self._model, self._data)
        for body, rest in zip(self._bodies, rests, strict=True):
            body.put_back(self._qpos, rest)
        self._qvel[:] = 0.0
        self._data.time = 0.0
        mujoco.mj_forward(self._model, self._data)
        for body in self._bodies:
            body.read(self._qpos)


def _find_feet(model: Any, name: str) -> list[tuple[int, float, float]]:
    ids = [model.geom(f"{name}/foot_{i}").id for i in range(4)]
    return [(i, float(model.geom_pos[i, 0]), float(model.geom_pos[i, 1])) for i in ids]


def build_mjcf(
    world: WorldSpec,
    robots: Sequence[PlacedRobot],
    dt: float,
    movers: Sequence[Solid] = (),
    masses: Sequence[float] = (),
) -> str:
    """Return the MuJoCo model of a world with robots at their starts; `movers` are bodies that are put where they are, but the first of
    them, which have `masses` and are pushed: people. The parts of robot A are called `A/body`, `A/wheel_left` and so on."""
    people, doors = movers[: len(masses)], movers[len(masses) :]
    solids = "\n".join(_solid_xml(k, s, _place(s)) for k, s in enumerate(world.solids))
    solids += "\n".join(
        f'<body mocap="true" {_place(s)}>{_solid_xml(len(world.solids) + k, s, "")}</body>' for k, s in enumerate(doors)
    )
    solids += "\n".join(person_xml(s, _place(s), mass) for s, mass in zip(people, masses, strict=True))
    hulls = "".join(_hull_xml(placed) for placed in robots)
    bodies = "\n".join(_robot_xml(placed) for placed in robots)
    motors = "".join(_motors_xml(placed) for placed in robots if placed.robot.has_two_wheels)
    surface_assets, surfaces = surfaces_xml(world)
    touches = "".join(f'<touch site="{placed.name}/hull"/>' for placed in robots)
    return f"""<mujoco model="ambler">
<compiler angle="radian" autolimits="true"/>
<option timestep="{dt!r}" integrator="Euler" cone="elliptic" impratio="10"/>
<default><geom friction="0.3 0.005 0.0001"/></default>
<asset>{hulls}
{surface_assets}</asset>
<worldbody>
<geom name="floor" type="plane" pos="0 0 {world.floor!r}" size="0 0 1" priority="1" friction="{world.friction!r} 0.005 0.0001"/>
{solids}
{surfaces}
{bodies}
</worldbody>
{f"<actuator>{motors}</actuator>" if motors else ""}
<sensor>{touches}</sensor>
</mujoco>"""


def _hull_xml(placed: PlacedRobot) -> str:
    robot = placed.robot
    levels = (robot.body_bottom, robot.model.body_height)
    hull = " ".join(f"{x:.6f} {y:.6f} {z:.6f}" for z in levels for x, y in robot.model.footprint)
    return f'<mesh name="{placed.name}/hull" vertex="{hull}"/>'


def _robot_xml(placed: PlacedRobot) -> str:
    robot, name, start = placed.robot, placed.name, placed.start
    levels = (robot.body_bottom, robot.model.body_height)
    center_x = -0.05 if robot.has_two_wheels else 0.0
    center_z = 0.4 * sum(levels)
    if (
        not robot.wheel_radius
    ):  # who walks steps to where it needs: its mass counts as lying no higher than its feet can hold
        center_z = min(center_z, 2.0 * min(_feet_reach(robot)))
    turn = f"{math.cos(start.yaw / 2)!r} 0 0 {math.sin(start.yaw / 2)!r}"
    drive = _wheels_xml(placed) if robot.has_two_wheels else _feet_xml(placed)
    return f"""<body name="{name}/base" pos="{start.x!r} {start.y!r} 0" quat="{turn}"><freejoint/>
<inertial pos="{center_x!r} 0 {center_z!r}" mass="{robot.mass!r}" diaginertia="{_inertia(robot)}"/>
<geom name="{name}/body" type="mesh" mesh="{name}/hull" conaffinity="3"/>
<site name="{name}/hull" type="box" pos="0 0 {0.5 * sum(levels)!r}" size="{_hull_size(robot)}"/>
{drive}
</body>"""


def _inertia(robot: SimRobot) -> str:
    length, width = np.ptp(robot.model.footprint, axis=0).tolist()
    height, k = robot.model.body_height - robot.body_bottom, robot.mass / 12.0
    return f"{k * (width**2 + height**2)} {k * (length**2 + height**2)} {k * (length**2 + width**2)}"


def _hull_size(robot: SimRobot) -> str:
    """Half sizes of a box 2 cm around the body; the touch sensor in it tells cheaply whether contacts need a look."""
    length, width = np.ptp(robot.model.footprint, axis=0).tolist()
    height = robot.model.body_height - robot.body_bottom
    return f"{0.5 * length + 0.02} {0.5 * width + 0.02} {0.5 * height + 0.02}"


def _place(s: Solid) -> str:
    pose = s.world_from_solid
    turn = f"{math.cos(pose.yaw / 2)!r} 0 0 {math.sin(pose.yaw / 2)!r}"
    return f'pos="{pose.x!r} {pose.y!r} {0.5 * (s.z_min + s.z_max)!r}" quat="{turn}"'


def _solid_xml(k: int, s: Solid, place: str) -> str:
    half = 0.5 * (s.z_max - s.z_min)
    if s.shape is Shape.BOX:
        kind, size = "box", f"{0.5 * s.size_x!r} {0.5 * s.size_y!r} {half!r}"
    else:
        kind, size = "cylinder", f"{0.5 * s.size_x!r} {half!r}"
    return f'<geom name={quoteattr(f"{s.name}#{k}")} type="{kind}" size="{size}" {place}/>'


def _wheels_xml(placed: PlacedRobot) -> str:
    """Two driven hinge wheels (ellipsoids: one contact each) on the base's y axis and a frictionless caster behind."""
    robot, name = placed.robot, placed.name
    r, half = robot.wheel_radius, 0.5 * robot.track
    back = -0.7 * float(robot.model.footprint[:, 0].max())
    bodies = [
        f'<body name="{name}/wheel_{side}" pos="0 {y!r} {r!r}">'
        f'<joint name="{name}/{side}" type="hinge" axis="0 1 0" armature="{WHEEL_ARMATURE!r}"/>'
        f'<geom name="{name}/wheel_{side}" type="ellipsoid" size="{r!r} {0.5 * WHEEL_WIDTH!r} {r!r}" mass="0.8"/></body>'
        for side, y in (("left", half), ("right", -half))
    ]
    caster = (
        f'<geom name="{name}/caster" type="sphere" size="0.03" pos="{back!r} 0 0.03" priority="2" condim="1" mass="0"/>'
    )
    return "\n".join([*bodies, caster])


def _motors_xml(placed: PlacedRobot) -> str:
    torque = placed.robot.mass * 9.81 * placed.robot.wheel_radius
    return "".join(
        f'<velocity joint="{placed.name}/{side}" kv="{WHEEL_GAIN!r}" forcerange="{-torque!r} {torque!r}"/>'
        for side in ("left", "right")
    )


def _feet_reach(robot: SimRobot) -> tuple[float, float]:
    """How far (m) ahead and beside the middle the feet stand: within the outline, of a short body by a share of it."""
    x, y = robot.model.footprint.max(axis=0).tolist()
    return max(x - 0.15, 0.5 * x), max(y - 0.06, 0.5 * y)


def _feet_xml(placed: PlacedRobot) -> str:
    """Four spheres, wheels or feet near the corners, whose surface moves; MuJoCo wants one non-zero surface velocity when it
    compiles."""
    robot = placed.robot
    if robot.has_mecanum_wheels:
        radius, x, y = robot.wheel_radius, 0.5 * robot.wheel_base, 0.5 * robot.track
    else:
        radius, (x, y) = FOOT_RADIUS, _feet_reach(robot)
    places = [(x, y), (-x, y), (-x, -y), (x, -y)]
    return "\n".join(
        f'<geom name="{placed.name}/foot_{i}" type="sphere" size="{radius!r}" pos="{px!r} {py!r} {radius!r}" mass="0"'
        f' surfacevel="1 0 0 0 0 0"/>'
        for i, (px, py) in enumerate(places)
    )
