"""The velocity gate: select a source, check it, limit it, hold it back before obstacles; stop for every doubt.

The chain of `step`: clock -> latched stops -> fresh input -> mode -> source -> speed limit -> acceleration limit -> protective
field -> output. It starts PAUSED; only an explicit `arm` lets motion pass. An emergency stop and a fault of a source stay until
an explicit `reset`, which leads to PAUSED. A protective stop ends by itself when the field has been clear for a while.
Software on an application computer is no certified safety function.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import GateState
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.kernels.protective_field import carry_points
from ambler.safety.approach_permit import ApproachField, ApproachPermit
from ambler.safety.config import GateConfig
from ambler.safety.field import ProtectiveField
from ambler.safety.limits import STILL, is_finite, is_still, limit_acceleration, limit_speed, scaled
from ambler.safety.protective_stop import ProtectiveStop
from ambler.safety.selection import SourceSelector, VelocityRequest
from ambler.safety.stops import StopLatch

F64 = NDArray[np.float64]

MAX_DT = 0.05  # seconds of acceleration that one step may use at most


@dataclass(frozen=True, slots=True)
class GateStep:
    """One output of the gate: the velocity for the base, the state, why (CODE: sentence), and the source that drives."""

    velocity: BodyVelocity
    state: GateState
    reason: str
    source: str


class VelocityGate:
    """Decides what reaches the base. Call `step` at 20 Hz or faster; every method takes the time, none asks for it."""

    def __init__(self, config: GateConfig, robot: RobotModel) -> None:
        self._config = config
        self._limits = robot.limits
        self._field = ProtectiveField(robot, config.reaction_time, config.margin, config.min_points, config.self_depth)
        self._selector = SourceSelector(config.sources)
        self._latch = StopLatch()
        self._approach = ApproachField(robot.limits, config.reaction_time)
        self._protective = ProtectiveStop(config.stop_scale, config.resume_scale, config.resume_delay)
        self._is_armed = False
        self._pause_reason = "POWER_UP: not armed yet"
        self._order = 0
        self._output = STILL
        self._last_step_ns: int | None = None
        self._stale_since_ns: int | None = None
        self._stale_reason = ""
        self._points: dict[str, tuple[int, F64, SE2]] = {}
        self._odometry: tuple[int, SE2] | None = None
        self._upright_ns: int | None = None

    # Input

    def request(self, source: str, stamp_ns: int, velocity: BodyVelocity, now_ns: int) -> None:
        """Take what a source wants. A value that is no number latches a fault; a stamp from the future is refused."""
        if not is_finite(velocity):
            self._latch.fault(f"NOT_FINITE: {source} asked for a velocity that is no number")
            return
        if stamp_ns - now_ns > self._config.max_future * 1e9:
            self._latch.fault(f"STAMP_IN_FUTURE: {source} asked with a stamp ahead of the clock")
            return
        self._selector.take(source, VelocityRequest(stamp_ns, velocity))

    def update_odometry(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Take the newest pose of the base; one that is no number latches a fault, one older than the last is ignored, unless that came from the future."""
        if not np.isfinite(odom_from_base.as_array()).all():
            self.fault_odometry()
        elif self._odometry is None or stamp_ns >= self._odometry[0] or self._is_ahead(self._odometry[0]):
            self._odometry = (stamp_ns, odom_from_base)

    def fault_odometry(self) -> None:
        """Latch a fault: odometry told something that is no number."""
        self._latch.fault("NOT_FINITE: the odometry is no number")

    def _is_ahead(self, stamp_ns: int) -> bool:
        """Whether a stamp lies further ahead of the last step than any right one does."""
        most = (self._config.max_future + self._config.max_step_gap) * 1e9
        return stamp_ns - (self._last_step_ns or 0) > most

    def update_lean(self, stamp_ns: int, lean: float) -> None:
        """Take how far (rad) the base leans off the vertical. One that lies on its side latches a fault, and again after a reset until somebody has put it up: what
        its wheels or legs do there is no driving."""
        if self._upright_ns is None or lean <= self._config.tipped:
            self._upright_ns = stamp_ns
        elif stamp_ns - self._upright_ns >= self._config.tipped_time * 1e9:
            self._latch.fault("TIPPED_OVER: the base lies on its side")

    def update_points(self, sensor: str, stamp_ns: int, points_base: F64, odom_from_base: SE2) -> None:
        """Take a sensor's newest points (N, 2), in the base frame of the moment whose pose is given.

        From its first message on, every sensor must stay fresh.
        """
        points = np.array(points_base, np.float64, order="C")
        is_finite = np.isfinite(points)
        finite = points if is_finite.all() else points[is_finite.all(axis=1)]  # rows are looked at one by one, slowly
        self._points[sensor] = (stamp_ns, finite, odom_from_base)

    @property
    def seen_ns(self) -> dict[str, int]:
        """The stamp of each sensor's newest points, by its frame."""
        return {sensor: stamp_ns for sensor, (stamp_ns, _, _) in self._points.items()}

    # Operator

    def arm(self, now_ns: int) -> tuple[bool, str]:
        """Let motion pass from now on; refused while a stop is latched. Requests issued before are void."""
        if self._latch.is_set:
            return False, f"reset the stop first: {self._latch.reason}"
        if not self._is_armed:
            self._is_armed = True
            self._selector.void(now_ns)
            self._protective.reset()
        return True, "armed"

    def permit_approach(self, permit: ApproachPermit, now_ns: int) -> tuple[bool, str]:
        """Let a dock's own outline be approached for a moment; refused without odometry. A pause or stop of any kind ends it."""
        if self._odometry is None:
            return False, "there is no odometry"
        return self._approach.permit(permit, self._odometry[1], now_ns)

    def revoke_approach(self) -> None:
        """End a permission to approach."""
        self._approach.revoke()

    def pause(self, now_ns: int, reason: str) -> None:
        """Brake to a stand and let nothing pass until the next `arm`."""
        self._is_armed = False
        self._approach.revoke()
        self._pause_reason = reason
        self._selector.void(now_ns)

    def order_stop(self, level: int) -> None:
        """Obey an order from outside: 0 lets motion pass, 1 turning only, 2 nothing, and so does any other number. It latches nothing: 0 ends it."""
        self._order = level if level in (0, 1) else 2

    def emergency_stop(self, now_ns: int, cause: str, reason: str) -> None:
        """Latch an emergency stop for a cause that is over once it was reported, such as a button in a page."""
        self._latch.stop(cause, reason)
        self.pause(now_ns, "STOPPED: waiting for arm after an emergency stop")

    def hold_stop(self, now_ns: int, cause: str, reason: str) -> None:
        """Latch an emergency stop that cannot be reset until `release_stop` says that the cause is gone."""
        self._latch.hold(cause, reason)
        self.pause(now_ns, "STOPPED: waiting for arm after an emergency stop")

    def release_stop(self, cause: str) -> None:
        """Say that a held cause is gone; the stop itself stays latched."""
        self._latch.release(cause)

    def reset(self, now_ns: int) -> tuple[bool, str]:
        """Clear latched stops and faults if no cause is held; the gate is PAUSED afterwards, never driving."""
        is_done, text = self._latch.reset()
        if is_done:
            self.pause(now_ns, "RESET: waiting for arm")
        return is_done, text

    # Output

    def step(self, now_ns: int) -> GateStep:
        """Return the command for the base and the state of the gate."""
        dt = self._advance_clock(now_ns)
        if self._latch.is_stopped:
            return self._finish(STILL, GateState.EMERGENCY_STOP, self._latch.reason)
        if self._latch.is_faulty:
            self.pause(now_ns, "FAULT: waiting for arm after a fault")
            return self._finish(STILL, GateState.FAULT, self._latch.reason)
        if not self._is_armed:
            return self._finish(self._towards(STILL, dt), GateState.PAUSED, self._pause_reason)
        stale = self._stale_input(now_ns)
        if stale is not None:
            return self._finish(STILL, GateState.FAULT, stale)  # it sees nothing: as hard as the base can
        if self._order == 2:
            return self._finish(self._towards(STILL, dt), GateState.PAUSED, "PAUSED: by an order to stop")
        return self._drive(now_ns, dt)

    def _drive(self, now_ns: int, dt: float) -> GateStep:
        selected = self._selector.select(now_ns)
        source, wanted = selected if selected is not None else ("", STILL)
        wanted = limit_speed(wanted, self._limits)
        wanted = BodyVelocity(0.0, 0.0, wanted.wz) if self._order == 1 else wanted
        points = self._points_now()
        if self._odometry is not None:
            wanted = self._approach.limited(wanted, self._odometry[1], now_ns)
            points = self._approach.remaining(points, self._odometry[1], now_ns)
        velocity = self._towards(wanted, dt)
        scale = 1.0 if is_still(velocity) else self._field.free_scale(velocity, points)
        probe = self._protective.blocked if is_still(wanted) else wanted
        if probe == velocity:
            clear_scale = scale
        else:
            clear_scale = 1.0 if is_still(probe) else self._field.free_scale(probe, points)
        if self._protective.update(now_ns, velocity, scale, wanted, clear_scale):
            text = "OBSTACLE: something is in the way of the wanted motion"
            return self._finish(STILL, GateState.PROTECTIVE_STOP, text, source)
        if selected is None:
            return self._finish(scaled(velocity, scale), GateState.ARMED, "IDLE: no source asks")
        reason = "" if min(scale, clear_scale) >= 1.0 else "SLOWED: an obstacle is near"
        return self._finish(scaled(velocity, scale), GateState.ARMED, reason, source)

    def _advance_clock(self, now_ns: int) -> float:
        last, self._last_step_ns = self._last_step_ns, now_ns
        if last is None:
            return 0.0
        gap = (now_ns - last) * 1e-9
        if gap < 0.0:
            self.emergency_stop(now_ns, "clock", "CLOCK_JUMP: the clock went backwards")
            return 0.0
        if gap > self._config.max_step_gap:
            self._stale_since_ns = now_ns
            self._stale_reason = f"GATE_STARVED: no step for {gap:.2f} s"
        return min(gap, MAX_DT)

    def _stale_input(self, now_ns: int) -> str | None:
        reason = None
        timeout = self._config.points_timeout
        stale = [
            name for name, (stamp_ns, _, _) in self._points.items() if not self._is_fresh(stamp_ns, now_ns, timeout)
        ]
        if stale or not self._points:
            reason = f"STALE_POINTS: no fresh scan or cloud from {', '.join(stale) or 'any sensor'}"
        elif self._odometry is None or not self._is_fresh(self._odometry[0], now_ns, self._config.odometry_timeout):
            reason = "STALE_ODOMETRY: no fresh odometry"
        if reason is not None:
            self._stale_since_ns, self._stale_reason = now_ns, reason
        elif self._stale_since_ns is None or now_ns - self._stale_since_ns >= self._config.stale_delay * 1e9:
            self._stale_since_ns = None
            return None
        return self._stale_reason

    def _is_fresh(self, stamp_ns: int, now_ns: int, timeout: float) -> bool:
        return -round(self._config.max_future * 1e9) <= now_ns - stamp_ns <= round(timeout * 1e9)

    def _points_now(self) -> F64:
        """The newest points in the base frame of now: the robot has moved since they were measured."""
        if self._odometry is None:
            return np.empty((0, 2))
        base_from_odom = self._odometry[1].inverse()
        out = np.empty((sum(len(points) for _, points, _ in self._points.values()), 2))
        row = 0
        for _, points, odom_from_then in self._points.values():
            then = base_from_odom @ odom_from_then
            row = carry_points(points, then.x, then.y, math.cos(then.yaw), math.sin(then.yaw), row, out)
        return out

    def _towards(self, target: BodyVelocity, dt: float) -> BodyVelocity:
        return limit_acceleration(self._output, target, self._limits, dt)

    def _finish(self, velocity: BodyVelocity, state: GateState, reason: str, source: str = "") -> GateStep:
        self._output = velocity
        return GateStep(velocity, state, reason, source)
