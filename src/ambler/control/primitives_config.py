"""Numbers of the local planner on motion primitives."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ambler.control.path_follower import FollowerConfig
from ambler.core.units import Radians


@dataclass(frozen=True, slots=True)
class PrimitivesConfig:
    """The local planner of navigation reference 1.5, SI.

    padding            added to the footprint on all sides
    reaction_time      from a measurement to the base obeying the command computed from it
    range, range_min, range_step   metres within which obstacles count at full speed (a local costmap of 6 m shows 3), the least, and by how much it is drawn in
                       while nothing is free
    scales             sizes of the paths, the greatest at full speed; each has its table (a smaller one turns more tightly)
    hold_scale         size of the paths along which an omnidirectional base slides without turning, where it cannot turn
    direction_reach    directions so far (rad) from that of the goal are tried
    worthless_angle    a path whose end leads so far (rad) off the goal's direction counts for nothing
    keep, keep_turning   factors in favour of the direction that was chosen last, while the robot drives along it and while it turns to it: no dithering between
                       two that are alike
    goal_clear         metres behind the goal in which obstacles still count, beside the footprint's own length
    near_goal          within this many metres straight paths are preferred, and a goal in sight is driven to in a straight line
    freeze_angle, freeze_time   a goal farther aside (rad) than this is not turned to at once: it may have been told by mistake
    arrive_radius, pass_radius, arrive_yaw   the goal is reached here; within `pass_radius` also when it lies beside or behind
    turn_start, turn_end   angles (rad) to the way at which turning in place begins and ends
    is_two_way         whether a base that can drive backwards does so rather than turn round; without it it only draws back where nothing else is free
    aside_speed        m/s of a base that slides without turning, or draws back: its scanners may see less there
    rough_costs        costs of ground that is rough, and very rough (the terrain layer charges up to 90 below what is lethal)
    rough_worth        what paths over such ground are worth
    rough_share        share of the paths of a group from which on their ground slows the robot down
    mover_radius, mover_growth, mover_seconds   of who moves, and how far ahead his way blocks paths that the robot would be on at the time
    detour             metres by which a way around may be longer than the path it avoids
    sight_step         metres between the places at which a line of sight is checked
    dead_end_seconds   of standing before what is blocked, before that place is remembered as a dead end
    dead_end_radius, dead_end_weight, dead_end_memory   metres around such a place that are avoided, metres of detour that this is worth, and for how many
                       seconds; each time at the same place it is worth as much more
    escapes_max, escape_progress   dead ends on the way to one goal after which the planner says that there is no way, and metres of path gained with which
                       it counts anew
    """

    padding: float = 0.03
    reaction_time: float = 0.1
    range: float = 2.7
    range_min: float = 0.6
    range_step: float = 0.4
    scales: tuple[float, ...] = (0.9, 0.65, 0.4)
    hold_scale: float = 0.5
    direction_reach: Radians = math.radians(90.0)
    worthless_angle: Radians = math.radians(50.0)
    keep: float = 1.15
    keep_turning: float = 5.0
    goal_clear: float = 0.05
    near_goal: float = 0.6
    freeze_angle: Radians = math.radians(90.0)
    freeze_time: float = 0.3
    arrive_radius: float = 0.03
    pass_radius: float = 0.12
    arrive_yaw: Radians = 0.02
    turn_start: Radians = 0.5
    turn_end: Radians = 0.15
    is_two_way: bool = False
    aside_speed: float = 0.3
    rough_costs: tuple[int, int] = (30, 60)
    rough_worth: tuple[float, float] = (0.5, 0.15)
    rough_share: float = 0.5
    mover_radius: float = 0.33
    mover_growth: float = 0.1
    mover_seconds: float = 2.5
    detour: float = 4.0
    sight_step: float = 0.05
    dead_end_seconds: float = 0.5
    dead_end_radius: float = 1.0
    dead_end_weight: float = 8.0
    dead_end_memory: float = 60.0
    escapes_max: int = 6
    escape_progress: float = 3.0
    follower: FollowerConfig = field(default_factory=FollowerConfig)
