"""Numbers of the local planners."""

from __future__ import annotations

from dataclasses import dataclass, fields

from ambler.core.errors import BadInputError
from ambler.core.units import Radians


@dataclass(frozen=True, slots=True)
class RolloutConfig:
    """Trajectory Rollout and the Dynamic Window, SI.

    horizon            seconds that every trajectory is simulated
    vx_samples, vy_samples, wz_samples   wanted velocities per axis (vy only for an omnidirectional base)
    control_period     seconds whose reachable velocities are the dynamic window
    step_length        metres that the fastest corner moves between two footprint checks
    padding            added to the footprint on all sides
    reaction_time      from a measurement to the base obeying the command computed from it
    look_ahead         metres of path whose direction decides whether the robot first turns in place
    turn_start, turn_end   heading errors (rad) at which turning in place begins and ends
    window             metres of path that are scored ahead of the robot
    arrive_radius      the goal counts as reached here; within `pass_radius` also when it lies beside or behind
    arrive_yaw         final heading error that is good enough to stop turning
    escape_speed, escape_length   how the robot moves to where it can turn, m/s and m
    speed_min          slowest motion worth commanding, m/s; `turn_min` rad/s
    brake_share        share of the deceleration limits used on purpose
    near               clearance below which a trajectory is charged (the kernel measures no more than 0.25 m)
    near_speed, speed_per_clearance   a trajectory may go this fast at no clearance, and faster per metre of it
    weight_*           cost per metre off the path (less while it is blocked, as for the heading), per metre not gained, per radian off the path's heading, per metre of missing
                       clearance, per radian/s of change in yaw rate, per m/s sideways, per metre of gap to movers missing to `movers_near`
    """

    horizon: float = 1.7
    vx_samples: int = 20
    vy_samples: int = 5
    wz_samples: int = 20
    control_period: float = 0.05
    step_length: float = 0.05
    padding: float = 0.03
    reaction_time: float = 0.1
    look_ahead: float = 0.4
    turn_start: Radians = 0.8
    turn_end: Radians = 0.15
    window: float = 2.0
    arrive_radius: float = 0.03
    pass_radius: float = 0.12
    arrive_yaw: Radians = 0.02
    speed_min: float = 0.06
    turn_min: Radians = 0.15
    escape_speed: float = 0.25
    escape_length: float = 1.5
    brake_share: float = 0.6
    near: float = 0.25
    near_speed: float = 0.3
    speed_per_clearance: float = 3.5
    weight_path: float = 3.0
    weight_path_blocked: float = 0.2
    weight_progress: float = 1.0
    weight_heading: float = 0.6
    weight_heading_blocked: float = 0.2
    weight_clearance: float = 1.5
    weight_turn_change: float = 0.04
    weight_sideways: float = 0.3
    weight_movers: float = 4.0
    movers_near: float = 0.5

    def __post_init__(self) -> None:
        for name in ("horizon", "vx_samples", "vy_samples", "wz_samples", "control_period", "step_length", "window"):
            if getattr(self, name) <= 0:
                raise BadInputError(f"rollout.{name} must be positive, not {getattr(self, name):g}")
        for each in fields(self):
            if each.name.startswith("weight_") and not getattr(self, each.name) >= 0.0:
                raise BadInputError(f"rollout.{each.name} must not be negative, but is {getattr(self, each.name):g}")
