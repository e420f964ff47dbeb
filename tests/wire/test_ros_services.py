"""Requests, replies, goals, feedback and outcomes survive the wire bit by bit; damage and nonsense are named."""

import enum
import math
from dataclasses import fields
from types import NoneType
from typing import get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from ambler.core.errors import AmblerError, BadInputError, NoValidPathError
from ambler.core.messages import Frontier, FrontierState, Path
from ambler.core.requests import DockFeedback, GateReply, NavigateGoal, Nothing, PlanReply, RecoveryKind, TaskOutcome
from ambler.core.se2 import SE2
from ambler.runtime.tasks import (
    ARM,
    COMPUTE_PATH,
    DOCK,
    NAVIGATE,
    RELOCALIZE,
    UNDOCK,
    all_services,
    all_tasks,
    service_named,
    task_named,
)
from ambler.wire.ros_types import STORE, record_class
from tests.wire.test_ros_messages import assert_same, stamps, words

finite = st.floats(allow_nan=False, allow_infinity=False)
counts = st.integers(0, 2**32 - 1)
planar = st.builds(SE2, finite, finite, finite)
pairs = st.tuples(finite, finite)
paths = st.builds(
    Path, stamps, words, hnp.arrays(np.float64, st.tuples(st.integers(0, 5), st.just(3)), elements=finite)
)
frontiers = st.builds(
    Frontier,
    hnp.arrays(np.float32, st.tuples(st.integers(0, 4), st.just(2)), elements=st.floats(width=32)),
    pairs,
    st.none() | st.tuples(finite, finite, finite),
    finite | st.just(math.inf),
    st.sampled_from(FrontierState),
    words,
)
VALUES = {
    bool: st.booleans(),
    int: counts,
    float: finite,
    str: words,
    SE2: planar,
    Path: paths,
    NDArray[np.float64]: hnp.arrays(np.float64, st.tuples(st.integers(0, 5), st.just(2)), elements=finite),
    tuple[tuple[float, float], ...]: st.lists(pairs, max_size=4).map(tuple),
    tuple[Frontier, ...]: st.lists(frontiers, max_size=3).map(tuple),
}


def records(record_type):
    hints = get_type_hints(record_type)

    def values(hint):
        if NoneType in get_args(hint):
            return st.none() | values(next(kind for kind in get_args(hint) if kind is not NoneType))
        return st.sampled_from(hint) if isinstance(hint, enum.EnumMeta) else VALUES[hint]

    return st.builds(record_type, **{f.name: values(hints[f.name]) for f in fields(record_type)})


few = settings(max_examples=25, deadline=None)


@pytest.mark.parametrize("service", all_services(), ids=lambda s: s.name)
@few
@given(data=st.data())
def test_requests_and_replies_survive_the_wire(service, data):
    request, reply = data.draw(records(service.request)), data.draw(records(service.reply))
    raw = service.encode_request(request)
    assert_same(service.decode_request(raw), request)
    assert service.encode_request(service.decode_request(raw)) == raw
    raw = service.encode_reply(reply)
    assert_same(service.decode_reply(raw), reply)


@pytest.mark.parametrize("service", all_services(), ids=lambda s: s.name)
def test_a_named_failure_travels_as_a_reply(service):
    raw = service.encode_reply(NoValidPathError("the goal: in a wall"))
    with pytest.raises(NoValidPathError) as caught:
        service.decode_reply(raw)
    assert (caught.value.code, str(caught.value)) == ("NO_VALID_PATH", "the goal: in a wall")
    own = AmblerError("something")
    own.code = "NEVER_HEARD_OF"
    with pytest.raises(AmblerError, match="something") as caught:
        service.decode_reply(service.encode_reply(own))
    assert caught.value.code == "NEVER_HEARD_OF"
    assert AmblerError.code == "AMBLER_ERROR"


@pytest.mark.parametrize("task", all_tasks(), ids=lambda t: t.name)
@few
@given(data=st.data())
def test_goals_feedback_and_outcomes_survive_the_wire(task, data):
    goal, feedback = data.draw(records(task.goal)), data.draw(records(task.feedback))
    assert_same(task.decode_goal(task.encode_goal(goal)), goal)
    assert_same(task.decode_feedback(task.encode_feedback(feedback)), feedback)
    code = st.sampled_from(["SUCCEEDED", "CANCELLED", *task.failures])
    outcome = TaskOutcome(data.draw(code), data.draw(words), data.draw(st.none() | records(task.result)))
    assert_same(task.decode_outcome(task.encode_outcome(outcome)), outcome)


PARTS = [
    *((f"{s.name} {kind}", getattr(s, kind), s) for s in all_services() for kind in ("request", "reply")),
    *((f"{t.name} {kind}", getattr(t, kind), t) for t in all_tasks() for kind in ("goal", "feedback", "result")),
]


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(PARTS), st.data())
def test_damaged_bytes_are_refused_or_read_but_never_crash(part, data):
    name, record_type, offer = part
    kind = name.split()[1]
    record = data.draw(records(record_type))
    if kind == "result":
        kind, record = "outcome", TaskOutcome("SUCCEEDED", "", record)
    raw = bytearray(getattr(offer, f"encode_{kind}")(record))
    cut = data.draw(st.integers(0, len(raw)))
    for position in data.draw(st.lists(st.integers(4, max(4, len(raw) - 1)), max_size=4)):
        raw[min(position, len(raw) - 1)] ^= 0xFF
    refusal = ""
    try:
        getattr(offer, f"decode_{kind}")(bytes(raw[:cut]))
    except BadInputError as error:
        refusal = str(error)
    except AmblerError as error:
        refusal = f"{offer.ros_type} answered {error}" if kind == "reply" else "only a reply may hold a failure"
    assert not refusal or offer.ros_type in refusal or kind == "reply"


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_goal_with_numbers_that_are_not_finite_is_refused_on_both_sides(wrong):
    with pytest.raises(BadInputError, match=r"map_from_goal of ambler_msgs/action/Navigate_Goal .* not finite"):
        NAVIGATE.encode_goal(NavigateGoal(SE2(1.0, wrong, 0.0)))
    with pytest.raises(BadInputError, match="xy_tolerance"):
        NAVIGATE.encode_goal(NavigateGoal(SE2(), wrong))
    raw = NAVIGATE.encode_goal(NavigateGoal(SE2(1.0, 7.0, 0.0)))
    damaged = raw.replace(np.float64(7.0).tobytes(), np.float64(wrong).tobytes())
    assert damaged != raw
    with pytest.raises(BadInputError, match="not finite"):
        NAVIGATE.decode_goal(damaged)


def test_values_that_do_not_fit_are_named():
    with pytest.raises(BadInputError, match="do not fit into ambler_msgs/action/Dock_Feedback"):
        DOCK.encode_feedback(DockFeedback("state", "", -1, None))


def test_a_path_keeps_its_yaw_where_quaternions_would_round_it():
    reply = PlanReply(Path(5, "map", np.array([[0.1, 0.2, 3.0000000000000004]])), 2.0, 0.0)
    assert COMPUTE_PATH.decode_reply(COMPUTE_PATH.encode_reply(reply)).path.poses[0, 2] == 3.0000000000000004


def test_bytes_are_those_that_ros_would_write():
    """Trigger: an empty request is one filler byte; a response is a flag, padding, a string with its length and zero."""
    assert RELOCALIZE.encode_request(Nothing()) == b"\x00\x01\x00\x00\x00"
    assert RELOCALIZE.encode_reply(Nothing()) == b"\x00\x01\x00\x00\x01\x00\x00\x00\x01\x00\x00\x00\x00"
    refused = ARM.encode_reply(GateReply(False, "no"))
    assert refused[4:] == b"\x00\0\0\0\x03\0\0\0no\0\0\x01\0\0\0\0"
    assert RELOCALIZE.ros_type == "std_srvs/srv/Trigger"


def test_the_table_is_complete():
    names = [offer.ros_name for offer in (*all_services(), *all_tasks())]
    assert len(set(names)) == len(names) >= 22
    for service in all_services():
        assert {f"{service.ros_type}_Request", f"{service.ros_type}_Response"} <= STORE.types.keys()
        assert service_named(service.ros_name) is service_named(service.name) is service
    for task in all_tasks():
        assert {f"{task.ros_type}_{part}" for part in ("Goal", "Result", "Feedback")} <= STORE.types.keys()
        assert task_named(task.ros_name) is task
    closed = {offer.name for offer in (*all_services(), *all_tasks()) if not offer.is_outside}
    assert closed >= {"permit_approach", "revoke_approach", "save_map"}, "these must never be offered to a page"
    assert UNDOCK.is_outside


def test_constants_of_the_definitions_are_those_of_the_code():
    recover = record_class("ambler_msgs/action/Recover_Goal")
    assert [getattr(recover, kind.name) for kind in RecoveryKind] == list(range(len(RecoveryKind)))
    frontier = record_class("ambler_msgs/msg/Frontier")
    assert [getattr(frontier, state.name) for state in FrontierState] == [int(state) for state in FrontierState]
