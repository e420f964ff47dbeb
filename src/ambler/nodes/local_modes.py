"""What the controller does beside following paths: steering by a person through the local planner (smart joystick), and telling why the robot stands."""

from __future__ import annotations

import json
import math

from ambler.core.messages import GateState, GateStatus, Odometry, VelocityCommand
from ambler.core.protocols import BodyVelocity, Lean, LocalState

STEER_AGE_NS = 400_000_000  # a request to steer counts for as long as one to the gate does
STATE_PERIOD_NS = 500_000_000  # between two tellings; what turns up in between and goes again is not worth one
LEVEL_COUNT = 20  # odometry that is level to the last bit so many times in a row does not measure the lean

Told = tuple[str, str, str]


class Steering:
    """What a person wants, while it is fresh."""

    def __init__(self) -> None:
        self._wanted: VelocityCommand | None = None
        self._is_active = False

    def take(self, wanted: VelocityCommand) -> None:
        """Take a request: a direction and a speed in the base frame, or a yaw rate; all zero means to stand."""
        self._wanted = wanted

    def wanted(self, now_ns: int) -> BodyVelocity | None:
        """Return what is wanted now, None when nobody steers."""
        w = self._wanted
        if w is None or now_ns - w.stamp_ns > STEER_AGE_NS:
            return None
        return BodyVelocity(w.vx, w.vy, w.wz)

    def has_ended(self, wanted: BodyVelocity | None) -> bool:
        """Whether the steering was under way until now and is over."""
        was, self._is_active = self._is_active, wanted is not None
        return was and not self._is_active


class StateTeller:
    """Says what to tell of the local planner's state, when there is news: (code, sentence, fields as JSON)."""

    def __init__(self) -> None:
        self._told: tuple[str, str] | None = None
        self._told_ns = -(1 << 62)

    def news(self, now_ns: int, state: LocalState, reason: str, gate: GateStatus | None) -> Told | None:
        """Return what to tell, or None. What the gate stops is told as such, whatever the planner wants."""
        code, text = f"LOCAL_{state.name}", reason or state.value.replace("_", " ")
        if gate is not None and gate.state is not GateState.ARMED:
            code, text = f"HELD_{gate.state.name}", gate.reason
        if (code, text) == self._told or now_ns - self._told_ns < STATE_PERIOD_NS:
            return None
        self._told, self._told_ns = (code, text), now_ns
        return code, text, json.dumps({"state": state.value})


class LeanMeter:
    """Makes leans of odometry."""

    def __init__(self) -> None:
        self._level = 0

    @property
    def is_blind(self) -> bool:
        """Whether the odometry has just turned out to be planar, so that no lean is ever told."""
        return self._level == LEVEL_COUNT

    def read(self, odometry: Odometry) -> Lean:
        """Return the lean of a body."""
        w, x, y, z = odometry.pose.rotation
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
        lean = Lean(roll, pitch, odometry.angular[0], odometry.angular[1])
        self._level = self._level + 1 if lean == Lean() else 0
        return lean
