"""Numbers of the omnidirectional pursuit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ambler.core.units import Radians


@dataclass(frozen=True, slots=True)
class PursuitConfig:
    """The pursuit of navigation reference 7.1, SI; gains in 1/s, or as their names say.

    reaction_time      from a measurement to the base obeying the command computed from it
    lookahead, lookahead_time   the path's direction is taken over so many metres plus seconds at the present speed
    start_yaw, end_yaw   heading errors (rad) at which turning in place begins and ends
    yaw_gain, static_yaw_gain   of the heading error while driving, and near the goal
    lateral_gain       yaw rate per metre beside the path and metre per second (a differential base)
    pos_gain           of the position error near the goal
    pos_y_gain         of the distance to the path (an omnidirectional base)
    cost_gain, cost_yaw_gain   away from near obstacles: sideways velocity (m/s at contact), yaw rate of a differential base
    curve_speed        speed at which the robot may turn by one radian within the lookahead, m/s
    goal_distance      metres of path before the goal from which the robot moves holonomically
    near, near_speed   clearance below which the speed falls, to `near_speed` m/s at none
    padding            added to the footprint on all sides
    min_stop           metres kept from what stops the robot
    brake_share        share of the deceleration limits used on purpose
    xy_tolerance, yaw_tolerance   where the goal is reached: no command any more
    creep, creep_yaw   slowest motion commanded while the goal is not reached, m/s and rad/s
    give_way_gain, give_way_seconds, give_way_width   velocity to the right (m/s) for who comes towards the robot, how soon before they meet, and
                       how far beside its way he may walk (m)
    arrive_radius, pass_radius, arrive_yaw   of a differential base, as in the rollout
    """

    reaction_time: float = 0.1
    lookahead: float = 0.4
    lookahead_time: float = 0.3
    start_yaw: Radians = 0.6
    end_yaw: Radians = 0.12
    yaw_gain: float = 2.0
    static_yaw_gain: float = 2.0
    lateral_gain: float = 1.0
    pos_gain: float = 1.8
    pos_y_gain: float = 1.0
    cost_gain: float = 0.1
    cost_yaw_gain: float = 0.8
    curve_speed: float = 0.45
    goal_distance: float = 0.5
    near: float = 0.25
    near_speed: float = 0.25
    padding: float = 0.03
    min_stop: float = 0.03
    brake_share: float = 0.6
    xy_tolerance: float = 0.01
    yaw_tolerance: Radians = 0.005
    creep: float = 0.01
    creep_yaw: Radians = 0.02
    give_way_gain: float = 0.3
    give_way_seconds: float = 2.0
    give_way_width: float = 1.0
    arrive_radius: float = 0.03
    pass_radius: float = 0.12
    arrive_yaw: Radians = math.radians(1.1)
