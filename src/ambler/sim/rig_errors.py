"""What a plate with a LiDAR and an IMU is off by: the LiDAR sits a little beside its drawing and its clock runs a little late."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ambler.core.robot import SensorKind
from ambler.core.se3 import SE3
from ambler.sim.sensors import named_generator
from ambler.sim.sim_robot import SimRobot


@dataclass(frozen=True, slots=True)
class RigErrors:
    """Standard deviations of a LiDAR's place (m), its angles (rad), and of its clock (s)."""

    place: float = 0.002
    angle: float = 0.001
    clock: float = 0.0005


EXACT = RigErrors(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class RigFlaw:
    """What one LiDAR is off by: where it sits in the frame in which it is drawn, and the seconds that its stamps lie behind the true times
    of its points; `rest` is one more standard normal number of the same draw, for what else the plate carries."""

    drawn_from_built: SE3
    clock: float
    rest: float


def draw_flaw(seed: int, errors: RigErrors, name: str = "rig") -> RigFlaw:
    """Draw what a LiDAR is off by; the same for the same seed and name."""
    off = named_generator(seed, name).standard_normal(8)
    x, y, z = (float(errors.place * v) for v in off[:3])
    built = SE3.from_rpy((x, y, z), *(float(errors.angle * v) for v in off[3:6]))
    return RigFlaw(built, float(errors.clock * off[6]), float(off[7]))


def as_built(robot: SimRobot, seed: int, errors: RigErrors | None = None) -> SimRobot:
    """Return a robot whose LiDARs of many rings are off by what the seed draws; its drawing, which algorithms know, stays as it is."""
    model, lidars = robot.model, dict(robot.lidars)
    for mount in model.of_kind(SensorKind.CLOUD):
        flaw = draw_flaw(seed, errors if errors is not None else RigErrors(), f"rig-{mount.frame}")
        moved = replace(mount, base_from_sensor=mount.base_from_sensor @ flaw.drawn_from_built)
        model = replace(model, sensors=tuple(moved if m.frame == mount.frame else m for m in model.sensors))
        lidars[mount.frame] = replace(lidars[mount.frame], clock=flaw.clock)
    return replace(robot, model=model, lidars=lidars)


def with_depth_mounts_off(robot: SimRobot, seed: int, place: float, angle: float) -> SimRobot:
    """Return a robot whose depth cameras are off by up to `place` (m) in each axis and up to `angle` (rad) about each, evenly drawn by the seed;
    its drawing stays as it is."""
    model = robot.model
    for mount in model.depth_cameras:
        off = named_generator(seed, f"mount-{mount.frame}").uniform(-1.0, 1.0, 6)
        x, y, z = (float(place * v) for v in off[:3])
        built = mount.base_from_sensor @ SE3.from_rpy((x, y, z), *(float(angle * v) for v in off[3:]))
        moved = replace(mount, base_from_sensor=built)
        model = replace(model, sensors=tuple(moved if m.frame == mount.frame else m for m in model.sensors))
    return replace(robot, model=model)
