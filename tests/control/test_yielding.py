"""Yielding: no motion passes that the robot could not end half a second before somebody reaches it; tried against a slow simulation."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.control.config import RolloutConfig
from ambler.control.omni_pursuit import OmniPursuit
from ambler.control.passing import passing_discs
from ambler.control.pursuit_config import PursuitConfig
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.control.yielding import YieldConfig, Yielding
from ambler.core.grid import GridSpec
from ambler.core.movers import Movers
from ambler.core.protocols import BodyVelocity, MoverAware, TakesNo
from ambler.core.se2 import SE2
from ambler.robots.catalog import robot_model
from ambler.sim.movers import distance_to_polygon
from tests.control.closed_loop import DIFF, ROBOTS, SPOT, World, drive, line, step_velocity

PERSON = 0.25


def walker(x: float, y: float, vx: float, vy: float) -> Movers:
    return Movers(0, np.array([[x, y, vx, vy, vx, vy]]))


def sent(yielding: Yielding, wanted: BodyVelocity) -> BodyVelocity:
    """What the controller sends to a robot that has nowhere to go out of the way."""
    passed = yielding.limited(wanted)
    return passed if passed != BodyVelocity() else yielding.creeping(wanted)


def meet(robot, start: SE2, wanted: BodyVelocity, person, velocity, turns_at: float = math.inf):
    """As `meet_bend`; who turns round does so at once."""
    return meet_bend(robot, start, wanted, person, velocity, [(turns_at, math.pi)])


def meet_bend(robot, start: SE2, wanted: BodyVelocity, person, velocity, turns):
    """Drive towards `wanted` through the yielding while somebody walks, who turns by angles (rad) at times (s); return (time of contact or inf,
    worst approach of the touched point in the half second before, metres driven)."""
    yielding, pose, v = Yielding(YieldConfig(), robot), start, BodyVelocity()
    waiting, log, dt, driven = [BodyVelocity()] * 2, [], 0.05, 0.0
    place, walk = np.array(person, float), np.array(velocity, float)
    for k in range(120):
        if turns and k * dt >= turns[0][0]:
            (_, angle), turns = turns[0], turns[1:]
            walk = SE2(0.0, 0.0, angle).transform(walk[None])[0]
        yielding.set_movers(walker(*place, *walk), pose, v)
        waiting.append(sent(yielding, wanted))
        v = step_velocity(v, waiting.pop(0), robot.limits, dt)
        log.append((pose, v, place.copy()))
        pose = pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * dt)
        driven += math.hypot(v.vx, v.vy) * dt
        place = place + walk * dt
        outline = pose.transform(robot.footprint)
        if distance_to_polygon((place[0], place[1]), outline) <= PERSON:
            point = pose.inverse().transform(_nearest(place, outline)[None])[0]
            return k * dt, max(_approach(p, u, q, point) for p, u, q in log[-10:]), driven
    return math.inf, -math.inf, driven


def meet_setting_out(robot, wanted: BodyVelocity, person, pace: float, sets_out: float, aim=(0.0, 0.0)):
    """As `meet_bend`, with somebody who stands, whom nobody has seen walking, and who then walks straight to where a point of the robot is,
    told by shares of half its length and width."""
    yielding, pose, v = Yielding(YieldConfig(), robot), SE2(), BodyVelocity()
    waiting, log, dt, driven = [BodyVelocity()] * 2, [], 0.05, 0.0
    place, velocity = np.array(person, float), np.zeros(2)
    for k in range(120):
        if not velocity.any() and k * dt >= sets_out:
            to = pose.transform((np.array(aim) * robot.footprint.max(axis=0))[None])[0] - place
            velocity = pace * to / math.hypot(*to)
        yielding.set_movers(Movers(0, np.array([[*place, *velocity, *velocity]])), pose, v)
        waiting.append(sent(yielding, wanted))
        v = step_velocity(v, waiting.pop(0), robot.limits, dt)
        log.append((pose, v, place.copy()))
        pose = pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * dt)
        driven += math.hypot(v.vx, v.vy) * dt
        place = place + velocity * dt
        outline = pose.transform(robot.footprint)
        if distance_to_polygon((place[0], place[1]), outline) <= PERSON:
            point = pose.inverse().transform(_nearest(place, outline)[None])[0]
            return k * dt, max(_approach(p, u, q, point) for p, u, q in log[-10:]), driven
    return math.inf, -math.inf, driven


def _nearest(point, outline):
    ends = np.roll(outline, -1, axis=0)
    share = np.clip(
        np.sum((point - outline) * (ends - outline), axis=1) / np.sum((ends - outline) ** 2, axis=1), 0.0, 1.0
    )
    places = outline + share[:, None] * (ends - outline)
    return places[np.argmin(np.hypot(*(places - point).T))]


def _approach(pose, v, person, point_base):
    place = pose.transform(point_base[None])[0]
    moved = SE2(0.0, 0.0, pose.yaw).transform(np.array([[v.vx - v.wz * point_base[1], v.vy + v.wz * point_base[0]]]))[0]
    away = person - place
    return float(moved @ away) / max(1e-9, math.hypot(*away))


@given(
    st.sampled_from(["diff", "spot"]),
    st.floats(-math.pi, math.pi),
    st.floats(2.5, 4.0),
    st.floats(0.6, 1.3),
    st.floats(-0.4, 0.4),
    st.sampled_from([BodyVelocity(0.8), BodyVelocity(0.4, 0.0, 0.8), BodyVelocity(0.0, 0.0, -1.2), BodyVelocity(-0.3)]),
)
@settings(max_examples=60, deadline=None)
def test_who_walks_straight_into_the_robot_finds_it_standing(name, bearing, away, pace, aside, wanted) -> None:
    robot = ROBOTS[name]
    heading = bearing + math.pi + aside
    person = (away * math.cos(bearing), away * math.sin(bearing))
    seconds, approach, _ = meet(robot, SE2(), wanted, person, (pace * math.cos(heading), pace * math.sin(heading)))
    assert math.isinf(seconds) or approach <= 0.05


@given(
    st.sampled_from(["diff", "spot"]),
    st.floats(-math.pi, math.pi),
    st.floats(1.5, 3.0),
    st.floats(-math.pi, math.pi),
    st.floats(0.8, 1.4),
    st.floats(0.0, 2.5),
    st.floats(0.3, 0.8),
    st.sampled_from([-0.5 * math.pi, 0.5 * math.pi]),
    st.sampled_from([BodyVelocity(0.5), BodyVelocity(0.3, 0.0, 0.7), BodyVelocity(0.0, 0.0, -0.8), BodyVelocity(-0.3)]),
)
@settings(max_examples=150, deadline=None)
def test_who_walks_a_bend_into_the_robot_finds_it_standing(
    name, bearing, away, heading, pace, begins, lasts, angle, wanted
) -> None:
    person = (away * math.cos(bearing), away * math.sin(bearing))
    walk, turns = (pace * math.cos(heading), pace * math.sin(heading)), [(begins, angle), (begins + lasts, angle)]
    seconds, approach, _ = meet_bend(ROBOTS[name], SE2(), wanted, person, walk, turns)
    assert math.isinf(seconds) or approach <= 0.05


@given(
    st.sampled_from(["diff", "spot"]),
    st.floats(-math.pi, math.pi),
    st.floats(0.9, 3.0),
    st.floats(0.8, 1.2),
    st.floats(0.0, 3.0),
    st.sampled_from([(0.0, 0.0), (0.8, 0.0), (-0.8, 0.0), (0.0, 0.8), (0.0, -0.8)]),
    st.sampled_from([BodyVelocity(0.5), BodyVelocity(0.3, 0.0, 0.7), BodyVelocity(0.0, 0.0, -0.8), BodyVelocity(-0.3)]),
)
@settings(max_examples=150, deadline=None)
def test_who_stood_and_sets_out_finds_the_robot_standing(name, bearing, away, pace, sets_out, aim, wanted) -> None:
    person = (away * math.cos(bearing), away * math.sin(bearing))
    seconds, approach, _ = meet_setting_out(ROBOTS[name], wanted, person, pace, sets_out, aim)
    assert math.isinf(seconds) or approach <= 0.05


def test_who_sets_out_for_the_flank_of_a_turning_robot_finds_it_standing() -> None:
    yielding = Yielding(YieldConfig(), SPOT)
    yielding.set_movers(Movers(0, np.array([[0.5, -1.2, 0.0, 0.0, 0.0, 0.0]])), SE2(), BodyVelocity())
    assert abs(yielding.limited(BodyVelocity(0.0, 0.0, 0.7)).wz) < 0.2


def test_who_has_just_set_out_and_seems_slow_yet_lets_the_robot_go_no_faster() -> None:
    yielding = Yielding(YieldConfig(), DIFF)
    for speed in (0.0, 0.2, 0.4, 0.7):
        yielding.set_movers(walker(0.2, 1.2, 0.0, -speed), SE2(), BodyVelocity())
        assert sent(yielding, BodyVelocity(0.0, 0.0, 1.5)).wz < 0.16, speed


def test_a_robot_creeps_past_who_stands_in_its_way() -> None:
    """Who stands may set out; a robot that creeps stands before he is there, and it gets on."""
    seconds, _, driven = meet_setting_out(DIFF, BodyVelocity(0.5), (1.2, 0.4), 1.0, 99.0)
    assert math.isinf(seconds)
    assert 0.2 < driven < 0.6, "six seconds, of which the first moments may be faster"


@pytest.mark.parametrize("wanted", [BodyVelocity(0.5), BodyVelocity(0.1, 0.0, 1.5), BodyVelocity(0.0, 0.0, -0.7)])
@pytest.mark.parametrize("robot", [DIFF, SPOT])
def test_no_corner_of_a_creeping_robot_is_fast(robot, wanted: BodyVelocity) -> None:
    yielding = Yielding(YieldConfig(), robot)
    yielding.set_movers(walker(1.5, 1.5, 0.0, 0.0), SE2(), BodyVelocity())
    v = yielding.creeping(wanted)
    x, y = robot.footprint.T
    speeds = np.hypot(v.vx - v.wz * y, v.vy + v.wz * x)
    assert 0.03 < speeds.max() < 0.045
    assert yielding.is_waiting(v)
    assert yielding.is_waiting(BodyVelocity())
    assert not yielding.is_waiting(BodyVelocity(0.1))
    assert yielding.creeping(BodyVelocity(0.01)) == BodyVelocity(0.01)


@pytest.mark.parametrize("robot", [DIFF, SPOT])
def test_among_people_a_robot_is_worth_its_speed_or_creeps(robot) -> None:
    """Between creeping, which starts no contact that counts, and a tenth of a metre per second there is more to lose than to gain."""
    speeds = set()
    for away in np.arange(1.0, 3.0, 0.05):
        yielding = Yielding(YieldConfig(), robot)
        yielding.set_movers(walker(away, 0.3, 0.0, 0.0), SE2(), BodyVelocity())
        for wanted in (BodyVelocity(0.5), BodyVelocity(0.0, 0.0, -0.6), BodyVelocity(0.07)):
            v = sent(yielding, wanted)
            x, y = robot.footprint.T
            speeds.add(round(float(np.hypot(v.vx - v.wz * y, v.vy + v.wz * x).max()), 3))
    assert not [v for v in speeds if 0.041 < v < 0.1]
    assert max(speeds) > 0.3
    assert 0.04 in speeds


def test_a_robot_does_not_creep_into_who_stands_at_it() -> None:
    yielding = Yielding(YieldConfig(), DIFF)
    yielding.set_movers(walker(0.65, 0.0, 0.0, 0.0), SE2(), BodyVelocity())
    assert yielding.creeping(BodyVelocity(0.3)) == BodyVelocity()
    assert yielding.creeping(BodyVelocity(-0.3)).vx < -0.03


def test_who_stands_aside_lets_the_robot_leave() -> None:
    _, _, driven = meet_setting_out(DIFF, BodyVelocity(0.5), (-0.9, 0.0), 1.0, 99.0)
    assert driven > 2.0


def test_without_yielding_the_same_robot_would_be_to_blame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Yielding, "limited", lambda self, wanted: wanted)
    seconds, approach, _ = meet(DIFF, SE2(), BodyVelocity(0.8), (3.0, 0.0), (-1.2, 0.0))
    assert seconds < 2.0
    assert approach > 0.5


def stander(x: float, y: float, walk, rest: float, *others) -> Movers:
    """Somebody who stands, last walked at `walk` and has stood for `rest` seconds; and others who stand, and walked to the left."""
    rows = [[x, y, 0.0, 0.0, *walk], *([a, b, 0.0, 0.0, 0.0, 1.0] for a, b in others)]
    return Movers(0, np.array(rows), np.full(len(rows), rest))


def passed(movers: Movers) -> float:
    yielding = Yielding(YieldConfig(), DIFF)
    yielding.set_movers(movers, SE2(), BodyVelocity())
    return yielding.limited(BodyVelocity(0.5)).vx


def test_who_has_stood_for_a_while_sets_out_along_his_own_line_if_at_all() -> None:
    aside, along, straight_at_it = (0.9, 1.0), (1.0, 0.0), (-0.67, -0.74)
    assert passed(stander(*aside, along, 2.0)) == 0.5
    assert passed(stander(*aside, along, 0.5)) < 0.2, "he may be about to turn"
    assert passed(stander(*aside, (0.0, 0.0), 2.0)) < 0.2, "nobody knows his line"
    assert passed(stander(*aside, straight_at_it, 2.0, (1.5, 1.6))) < 0.2, (
        "he was stopped by somebody else, and comes on"
    )


def test_who_stopped_for_the_robot_is_not_waited_for() -> None:
    ahead, towards = (1.4, 0.0), (-1.0, 0.0)
    assert passed(stander(*ahead, towards, 2.0)) > 0.2
    alone, accompanied = passed(stander(*ahead, towards, 2.0)), passed(stander(*ahead, towards, 2.0, (1.5, 1.1)))
    assert alone > 2.0 * accompanied, "somebody else may have stopped him"
    assert passed(stander(2.3, 0.0, towards, 2.0)) < 0.3, "so far away he stands for some other reason"
    assert passed(stander(0.62, 0.0, towards, 2.0)) < 0.1, "he stands right before it"


@given(
    st.sampled_from(["diff", "spot"]),
    st.floats(-math.pi, math.pi),
    st.floats(0.9, 2.5),
    st.floats(-math.pi, math.pi),
    st.floats(0.7, 1.2),
    st.floats(0.0, 2.0),
    st.floats(-0.3, 0.3),
    st.booleans(),
    st.sampled_from([BodyVelocity(0.5), BodyVelocity(0.3, 0.0, 0.7), BodyVelocity(0.0, 0.0, -0.8), BodyVelocity(-0.3)]),
)
@settings(max_examples=150, deadline=None)
def test_who_stood_and_goes_on_or_back_along_his_line_finds_the_robot_standing(
    name, bearing, away, heading, pace, sets_out, bend, goes_back, wanted
) -> None:
    """With somebody else near, who may have stopped him."""
    robot = ROBOTS[name]
    yielding, pose, v = Yielding(YieldConfig(), robot), SE2(), BodyVelocity()
    place, walk = np.array([away * math.cos(bearing), away * math.sin(bearing)]), np.zeros(2)
    last = pace * np.array([math.cos(heading), math.sin(heading)])
    other = place + 0.7 * last / pace
    waiting, log, dt = [BodyVelocity()] * 2, [], 0.05
    for k in range(120):
        if k * dt >= sets_out:
            walk = SE2(0.0, 0.0, bend + math.pi * goes_back).transform(last[None])[0]
        rest = 2.0 + k * dt if not walk.any() else 0.0
        rows = np.array([[*place, *walk, *(walk if walk.any() else last)], [*other, 0.0, 0.0, 0.0, 0.0]])
        yielding.set_movers(Movers(0, rows, np.array([rest, 9.0])), pose, v)
        waiting.append(sent(yielding, wanted))
        v = step_velocity(v, waiting.pop(0), robot.limits, dt)
        log.append((pose, v, place.copy()))
        pose = pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * dt)
        place = place + walk * dt
        outline = pose.transform(robot.footprint)
        if distance_to_polygon((place[0], place[1]), outline) <= PERSON:
            point = pose.inverse().transform(_nearest(place, outline)[None])[0]
            assert max(_approach(p, u, q, point) for p, u, q in log[-10:]) <= 0.05
            return


def test_who_turns_round_before_the_robot_is_not_run_into() -> None:
    for turns_at in np.arange(0.0, 3.0, 0.25):
        seconds, approach, _ = meet(DIFF, SE2(), BodyVelocity(0.8), (1.1, 0.0), (0.4, 0.0), float(turns_at))
        assert math.isinf(seconds) or approach <= 0.05


def test_who_walks_ahead_may_turn_round() -> None:
    yielding = Yielding(YieldConfig(), DIFF)
    yielding.set_movers(walker(0.9, 0.0, 1.1, 0.0), SE2(), BodyVelocity(0.4))
    assert yielding.limited(BodyVelocity(0.4)).vx < 0.2


@pytest.mark.parametrize(
    ("person", "walk", "wanted"),
    [
        ((-0.24, 1.27), (-0.84, 0.83), BodyVelocity(0.26, 0.0, 0.54)),
        ((-0.58, -0.49), (-0.96, 0.02), BodyVelocity(0.56, 0.0, 0.07)),
    ],
)
def test_who_has_passed_may_turn_round_along_his_own_line(person, walk, wanted) -> None:
    """His way back leads past the robot's middle and still meets a corner that swings or drives into it; one who goes a metre farther out does not."""
    yielding = Yielding(YieldConfig(), DIFF)
    yielding.set_movers(walker(*person, *walk), SE2(0.0, 0.0, 0.0), wanted)
    assert yielding.contact_in(wanted) < 1.0
    out = (person[0], person[1] + math.copysign(1.0, person[1]))
    yielding.set_movers(walker(*out, *walk), SE2(0.0, 0.0, 0.0), wanted)
    assert yielding.contact_in(wanted) == math.inf


def test_who_walks_past_with_room_does_not_stop_it() -> None:
    _, _, driven = meet(DIFF, SE2(), BodyVelocity(0.5), (4.0, 1.3), (-1.2, 0.0))
    assert driven > 2.0


def test_a_touched_robot_may_leave_and_not_press_on() -> None:
    yielding = Yielding(YieldConfig(), DIFF)
    yielding.set_movers(walker(0.52, 0.0, -1.0, 0.0), SE2(), BodyVelocity())
    assert sent(yielding, BodyVelocity(0.3)) == BodyVelocity()
    assert sent(yielding, BodyVelocity(-0.3)).vx < -0.05
    assert sent(yielding, BodyVelocity(0.0, 0.0, 1.0)) == BodyVelocity(), "turning brings its corner nearer"


@pytest.mark.parametrize(("x", "passes"), [(0.0, True), (-0.4, True), (0.8, False)])
def test_a_robot_slides_along_who_stands_at_its_flank_and_pushes_nobody_with_a_corner(
    x: float, *, passes: bool
) -> None:
    """He came along his line and has stood there for a while: his place is known to some centimetres only, so he may touch it."""
    yielding = Yielding(YieldConfig(), SPOT)
    yielding.set_movers(stander(x, 0.25 + 0.36, (0.0, -1.0), 3.0), SE2(), BodyVelocity())
    assert (yielding.limited(BodyVelocity(0.3)).vx > 0.1) is passes
    assert x < 0.0 or yielding.refuses(BodyVelocity(0.3, 0.0, 0.6)), "turning swings its flank into him"
    assert yielding.refuses(BodyVelocity(0.0, 0.2)), "towards him"


@pytest.mark.parametrize("away", [1.2, 1.4])
def test_whoever_comes_to_a_turning_robot_may_meet_a_corner_beside_the_point_that_he_heads_for(away: float) -> None:
    """From thirty degrees he heads for a point that turns past him."""
    yielding, turn = Yielding(YieldConfig(), DIFF), BodyVelocity(0.0, 0.0, 0.35)
    for bearing in np.radians(np.arange(0.0, 360.0, 30.0)):
        towards = -np.array([math.cos(bearing), math.sin(bearing)])
        yielding.set_movers(walker(*(-away * towards), *towards), SE2(), turn)
        assert yielding.contact_in(turn) < 1.0, f"from {math.degrees(bearing):.0f} degrees"


def test_who_stands_at_a_corner_may_stand_a_decimetre_farther_ahead() -> None:
    yielding = Yielding(YieldConfig(), SPOT)
    yielding.set_movers(stander(0.6, 0.25 + 0.36, (0.0, -1.0), 3.0), SE2(), BodyVelocity())
    ahead = yielding.limited(BodyVelocity(0.5)).vx
    assert ahead * 0.15 / math.hypot(0.15, 0.36) < 0.05, "the corner would push him"


def test_what_would_start_a_contact_is_refused_and_so_is_creeping() -> None:
    yielding = Yielding(YieldConfig(), SPOT)
    yielding.set_movers(walker(1.6, 0.0, -1.0, 0.0), SE2(), BodyVelocity())
    assert yielding.refuses(BodyVelocity(0.5))
    assert not yielding.refuses(BodyVelocity(-0.4)), "away from him"
    assert yielding.refuses(BodyVelocity(-0.03)), "nobody gets anywhere like that"
    assert not yielding.refuses(BodyVelocity()), "standing is always allowed"
    yielding.set_movers(Movers(), SE2(), BodyVelocity())
    assert not yielding.refuses(BodyVelocity(0.5))
    assert not yielding.refuses(BodyVelocity(0.03))


def test_a_planner_to_which_the_best_is_refused_takes_what_is_left_of_it_and_gains_all_the_same() -> None:
    planner = TrajectoryRollout(RolloutConfig(), DIFF)
    assert isinstance(planner, TakesNo)
    costs, spec = np.zeros((120, 120), np.uint8), GridSpec(0.05, 120, 120, -3.0, -3.0)
    planner.set_path(line((0.0, 0.0), (2.8, 0.0)))
    best = planner.compute_command(costs, spec, SE2(), BodyVelocity(0.4))
    assert abs(best.wz) < 0.02
    planner.set_refusal(lambda wanted: wanted.wz < 0.1)
    other = planner.compute_command(costs, spec, SE2(), BodyVelocity(0.4))
    assert other.wz >= 0.1
    assert other.vx > 0.1
    planner.set_refusal(lambda wanted: True)
    assert planner.compute_command(costs, spec, SE2(), BodyVelocity(0.4)) == best, "as before"


@pytest.mark.parametrize("robot", [SPOT, DIFF])
def test_a_robot_that_may_not_turn_glides_if_it_can(robot) -> None:
    """Somebody stands at the corner that it would bring nearer."""
    planner = TrajectoryRollout(RolloutConfig(), robot)
    costs, spec = np.zeros((160, 160), np.uint8), GridSpec(0.05, 160, 160, -4.0, -4.0)
    planner.set_path(line((0.0, 0.0), (0.0, 2.5)))
    turn = planner.compute_command(costs, spec, SE2(), BodyVelocity())
    assert abs(turn.wz) > 0.3
    assert abs(turn.vy) < 1e-9
    planner.set_refusal(lambda wanted: abs(wanted.wz) > 0.3)
    command = planner.compute_command(costs, spec, SE2(), BodyVelocity())
    assert (command.vy > 0.1 and abs(command.wz) <= 0.3) if robot is SPOT else command == turn


def test_a_robot_that_may_not_turn_where_it_stands_drives_a_bend() -> None:
    planner = TrajectoryRollout(RolloutConfig(), DIFF)
    costs, spec = np.zeros((160, 160), np.uint8), GridSpec(0.05, 160, 160, -4.0, -4.0)
    planner.set_path(line((0.0, 0.0), (1.0, 1.9)))
    turn = planner.compute_command(costs, spec, SE2(), BodyVelocity())
    assert (turn.vx, turn.wz > 0.3) == (0.0, True)
    planner.set_refusal(lambda wanted: abs(wanted.vx) < 0.02)
    bend = planner.compute_command(costs, spec, SE2(), BodyVelocity())
    assert bend.vx >= 0.02
    assert bend.wz > 0.3


def test_nobody_near_changes_nothing() -> None:
    yielding = Yielding(YieldConfig(), SPOT)
    yielding.set_movers(walker(9.0, 0.0, -1.0, 0.0), SE2(), BodyVelocity())
    assert yielding.is_alone
    wanted = BodyVelocity(0.8, 0.1, 1.2)
    assert yielding.limited(wanted) is wanted


def test_a_standing_robot_gets_out_of_the_way_only_where_it_may() -> None:
    yielding = Yielding(YieldConfig(), SPOT)
    yielding.set_movers(walker(2.0, 0.0, -1.0, 0.0), SE2(), BodyVelocity())
    assert abs(yielding.evasion(lambda heading, length: length).vy) > 0.1, "sideways"
    assert yielding.evasion(lambda heading, length: 0.3) == BodyVelocity(), "not far enough: he comes straight on"
    yielding.set_movers(walker(2.0, 0.35, -1.0, 0.0), SE2(), BodyVelocity())
    assert yielding.evasion(lambda heading, length: 0.3).vy < -0.1, "to the wall, beside which he passes"
    assert yielding.evasion(lambda heading, length: 0.15) == BodyVelocity(), "hardly any room"
    yielding.set_movers(walker(2.0, 0.0, -1.0, 0.0), SE2(), BodyVelocity())
    only_left = yielding.evasion(lambda heading, length: length if abs(heading - math.pi / 2) < 0.1 else 0.0)
    assert only_left.vy > 0.1
    yielding.set_movers(walker(2.0, 2.0, -1.0, 0.0), SE2(), BodyVelocity())
    assert yielding.evasion(lambda heading, length: length) == BodyVelocity(), "nobody comes"


@pytest.mark.parametrize(("aside", "room"), [(0.35, 0.4), (0.5, 0.25)])
def test_beside_a_wall_it_gets_as_far_aside_as_lets_him_pass(aside: float, room: float) -> None:
    """It goes on although the room to the wall gets less while it does."""
    yielding, y, x = Yielding(YieldConfig(), robot_model("amr_omni")), 0.0, 2.4
    while x > 0.0:
        yielding.set_movers(walker(x, aside, -1.0, 0.0), SE2(0.0, y, 0.0), BodyVelocity())
        free = room + y
        velocity = yielding.evasion(lambda heading, length: min(length, free) if heading < -1.0 else 0.0)  # noqa: B023
        y = max(-room, y + 0.05 * velocity.vy)
        x -= 0.05
    assert aside - y - 0.4 >= YieldConfig().radius - 0.02, "his shoulder passes its side"


def test_discs_stand_to_the_right_of_who_walks() -> None:
    (row,) = passing_discs(walker(3.0, 0.0, -1.0, 0.0), 0.5)
    assert row[0] == pytest.approx(2.5)
    assert row[1] > 0.1, "his right is the left of who meets him"
    (row,) = passing_discs(walker(3.0, 0.0, 0.0, 0.0), 0.5)
    assert row[:2].tolist() == [3.0, 0.0]


@pytest.mark.parametrize("kind", [TrajectoryRollout, OmniPursuit])
def test_planners_pass_on_the_right(kind) -> None:
    robot = SPOT
    planner = OmniPursuit(PursuitConfig(), robot) if kind is OmniPursuit else TrajectoryRollout(RolloutConfig(), robot)
    assert isinstance(planner, MoverAware)
    costs, spec = np.zeros((120, 120), np.uint8), GridSpec(0.05, 120, 120, -3.0, -3.0)
    planner.set_path(line((0.0, 0.0), (2.8, 0.0)))
    planner.set_movers(walker(2.6, 0.0, -1.0, 0.0))
    command = planner.compute_command(costs, spec, SE2(), BodyVelocity(0.4))
    assert command.vy + command.wz < -0.02, "to the right"
    planner.set_movers(Movers())
    alone = planner.compute_command(costs, spec, SE2(), BodyVelocity(0.4))
    assert abs(alone.vy) + abs(alone.wz) < 0.02


def test_without_movers_planners_drive_as_before() -> None:
    world = World().block(1.0, 0.2, 1.4, 1.0)
    path = line((0.0, 0.0), (3.0, 0.0))
    plain = drive(TrajectoryRollout(RolloutConfig(), DIFF), DIFF, world, path, SE2())
    planner = TrajectoryRollout(RolloutConfig(), DIFF)
    planner.set_movers(Movers())
    assert drive(planner, DIFF, world, path, SE2()).commands == plain.commands
