"""Requests, replies, goals, feedback and outcomes as ROS 2 CDR; definitions in `srv/` and `action/`.

A response begins with `success`, `message` and, where the type is ours, `error_code`: a named failure of the server travels in
them. An action's result begins with `code`, `text` and `has_result`. What asks a robot to do something holds finite numbers only.
"""

from __future__ import annotations

from functools import cache
from typing import Any, TypeVar

from ambler.core.errors import AmblerError, BadInputError
from ambler.core.requests import TaskOutcome
from ambler.wire.ros_messages import DAMAGE
from ambler.wire.ros_records import absent_values, first_not_finite, record_from, values_of
from ambler.wire.ros_types import STORE, TRIGGER, record_class

R = TypeVar("R")

_FILLER = "structure_needs_at_least_one_member"


def encode_request(service_type: str, request: Any) -> bytes:
    """Return a request as CDR; raises BadInputError for values that do not fit into their fields, or are not finite."""
    return _encode_wish(f"{service_type}_Request", request)


def decode_request(service_type: str, request_type: type[R], data: bytes) -> R:
    """Read a request; raises BadInputError when the bytes are none, or hold numbers that are not finite."""
    return _decode_wish(f"{service_type}_Request", request_type, data)


def encode_reply(service_type: str, reply_type: type[Any], reply: Any) -> bytes:
    """Return a reply, or the AmblerError that the server answered with, as CDR."""
    if isinstance(reply, AmblerError):
        values = {**absent_values(reply_type), **_failure(service_type, reply)}
    else:
        values = {"success": True, "message": "", **values_of(reply)}
        if service_type != TRIGGER:
            values["error_code"] = ""
    return _encode(f"{service_type}_Response", values)


def decode_reply(service_type: str, reply_type: type[R], data: bytes) -> R:
    """Read a reply; raises the AmblerError that the server answered with, and BadInputError when the bytes are no reply."""
    ros = _decode(f"{service_type}_Response", data)
    failure = _failure_of(service_type, ros)
    if failure is not None:
        raise failure
    return _record(f"{service_type}_Response", reply_type, ros)


def encode_goal(task_type: str, goal: Any) -> bytes:
    """Return a goal as CDR; raises BadInputError for values that do not fit into their fields, or are not finite."""
    return _encode_wish(f"{task_type}_Goal", goal)


def decode_goal(task_type: str, goal_type: type[R], data: bytes) -> R:
    """Read a goal; raises BadInputError when the bytes are none, or hold numbers that are not finite."""
    return _decode_wish(f"{task_type}_Goal", goal_type, data)


def encode_feedback(task_type: str, feedback: Any) -> bytes:
    """Return feedback as CDR."""
    return _encode(f"{task_type}_Feedback", values_of(feedback))


def decode_feedback(task_type: str, feedback_type: type[R], data: bytes) -> R:
    """Read feedback; raises BadInputError."""
    name = f"{task_type}_Feedback"
    return _record(name, feedback_type, _decode(name, data))


def encode_outcome(task_type: str, result_type: type[Any], outcome: TaskOutcome[Any]) -> bytes:
    """Return how a task ended as CDR."""
    result = outcome.result
    values = absent_values(result_type) if result is None else values_of(result)
    head = {"code": outcome.code, "text": outcome.text, "has_result": result is not None}
    return _encode(f"{task_type}_Result", {**head, **values})


def decode_outcome(task_type: str, result_type: type[R], data: bytes) -> TaskOutcome[R]:
    """Read how a task ended; raises BadInputError."""
    name = f"{task_type}_Result"
    ros = _decode(name, data)
    return TaskOutcome(ros.code, ros.text, _record(name, result_type, ros) if ros.has_result else None)


def _failure(service_type: str, error: AmblerError) -> dict[str, Any]:
    if service_type == TRIGGER:  # has no field for the code
        return {"success": False, "message": f"{error.code}: {error}"}
    return {"success": False, "message": str(error), "error_code": error.code}


def _failure_of(service_type: str, ros: Any) -> AmblerError | None:
    if service_type != TRIGGER:
        return _error_named(ros.error_code, ros.message) if ros.error_code else None
    if ros.success:
        return None
    code, separator, text = ros.message.partition(": ")
    return _error_named(code, text) if separator and code.isupper() else AmblerError(ros.message)


def _error_named(code: str, text: str) -> AmblerError:
    """Return the error of that code: of its own class where there is one."""
    error = _error_classes().get(code, AmblerError)(text)
    error.code = code
    return error


def _error_classes() -> dict[str, type[AmblerError]]:
    found: dict[str, type[AmblerError]] = {}
    waiting: list[type[AmblerError]] = [AmblerError]
    while waiting:
        error = waiting.pop(0)
        found.setdefault(error.code, error)
        waiting += error.__subclasses__()
    return found


def _encode_wish(name: str, record: Any) -> bytes:
    _check_finite(name, record)
    return _encode(name, values_of(record))


def _decode_wish(name: str, record_type: type[R], data: bytes) -> R:
    record = _record(name, record_type, _decode(name, data))
    _check_finite(name, record)
    return record


def _check_finite(name: str, record: Any) -> None:
    wrong = first_not_finite(record)
    if wrong is not None:
        raise BadInputError(f"{wrong} of {name} holds a number that is not finite")


def _encode(name: str, values: dict[str, Any]) -> bytes:
    try:
        return bytes(STORE.serialize_cdr(record_class(name)(**values, **_filler(name)), name))
    except (*DAMAGE, AttributeError) as error:
        raise BadInputError(f"these values do not fit into {name}: {error}") from error


def _decode(name: str, data: bytes) -> Any:
    try:
        return STORE.deserialize_cdr(data, name)
    except DAMAGE as error:
        raise BadInputError(f"{len(data)} bytes are no {name}: {error}") from error


def _record(name: str, record_type: type[R], ros: Any) -> R:
    try:
        return record_from(record_type, ros)
    except DAMAGE as error:
        raise BadInputError(f"this is no {record_type.__name__} of {name}: {error}") from error


@cache
def _filler(name: str) -> dict[str, int]:
    return {_FILLER: 0} if _FILLER in record_class(name).__dataclass_fields__ else {}
