"""The docking mission: staging, looking for the dock, aligning before it, going in, confirming; back out and again when it fails.

It knows neither bus nor clock. `begin` or `begin_undock`, `update` (at the rate of control), `drive_ended` and `cancel` return
commands for the caller to carry out. Every state that moves the robot itself commands a velocity at every update; whatever ends the
mission stops the robot, takes back the permission to approach and says why in one sentence.
"""

from __future__ import annotations

import math

from ambler.control.planar_position import PlanarPhase, PlanarPositionController, PlanarStep
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2, wrap_angle
from ambler.docking.dock import Contacts, Dock
from ambler.docking.tracker import DockTrack
from ambler.missions.dock_commands import (
    ENDS,
    DockCommand,
    DockConfig,
    DockEnded,
    DockState,
    DockView,
    LookForDock,
    Move,
    PermitApproach,
    RevokeApproach,
    StopCharging,
    StopNavigation,
)
from ambler.missions.dock_run import DockRun
from ambler.missions.drive_to import DriveTo
from ambler.runtime.tasks import NEAREST_REACHED

STILL = Move(BodyVelocity())
MAX_DT = 0.1
HIDDEN = "the dock was hidden by who stood in the way: looking for it"
STOP_CHARGING_TIME = 3.0  # seconds that the current may take to end before the robot leaves


class DockMission:
    """One docking or undocking at a time. `state` and `text` may be read by anyone."""

    def __init__(self, config: DockConfig | None = None) -> None:
        self.config = config if config is not None else DockConfig()
        self.state = DockState.IDLE
        self.text = ""
        self._controller = PlanarPositionController(self.config.planar)
        self._drive = 0
        self._run: DockRun | None = None

    @property
    def is_active(self) -> bool:
        """Whether a docking or undocking is under way."""
        return self.state is not DockState.IDLE and self.state not in ENDS

    @property
    def attempts(self) -> int:
        """Failed final approaches so far."""
        return 0 if self._run is None else self._run.attempts

    @property
    def distance(self) -> float | None:
        """Metres to the docked pose by the last detection, None when the dock is not known."""
        view = self._run.view if self._run is not None else None
        track = None if view is None else view.track
        return None if track is None else math.hypot(track.base_from_dock.x, track.base_from_dock.y)

    def begin(self, dock: Dock, now_ns: int) -> list[DockCommand]:
        """Start to dock; what was under way is ended without a word, so the caller cancels it first if somebody waits for it."""
        self._run = DockRun(dock, now_ns)
        self._controller.reset()
        self._enter(DockState.STAGING, f"to the staging pose of {dock.name}")
        return [LookForDock(True), *self._to_staging()]

    def begin_undock(self, dock: Dock, now_ns: int) -> list[DockCommand]:
        """Start to leave the dock in which the robot stands."""
        self._run = DockRun(dock, now_ns)
        self._controller.reset()
        self._enter(DockState.UNDOCKING, f"leaving {dock.name}")
        return [StopCharging(), RevokeApproach()]

    def drive_ended(self, drive: int, code: str, text: str) -> None:
        """Take the end of a drive; those of earlier drives are no news."""
        if drive == self._drive and self.is_active:
            self._now.drive_code, self._now.drive_text = code, text

    def cancel(self) -> list[DockCommand]:
        """End at once; the robot stands where it is."""
        if not self.is_active:
            return []
        return self._end(DockState.CANCELLED, "CANCELLED", "cancelled on request")

    def update(self, view: DockView) -> list[DockCommand]:
        """Look at the world and decide."""
        if not self.is_active:
            return []
        self._now.take(view, MAX_DT)
        stop = self._watch(view)
        if stop is not None:
            return stop
        steps = {
            DockState.STAGING: self._staging,
            DockState.SEARCHING: self._searching,
            DockState.ALIGNING: self._aligning,
            DockState.APPROACHING: self._approaching,
            DockState.CONFIRMING: self._confirming,
            DockState.BACKING_OUT: self._backing_out,
            DockState.UNDOCKING: self._undocking,
        }
        return steps[self.state](view)

    # One method per state.

    def _staging(self, view: DockView) -> list[DockCommand]:
        """Until the navigator has arrived, or the dock is seen well enough from near."""
        code, self._now.drive_code = self._now.drive_code, None
        track = self._fresh_track(view)
        if track is not None and track.sightings >= self.config.align_sightings and self._is_before(track):
            return [StopNavigation(), *self._align(view, "the dock is in view")]
        if code is None:
            return []
        if code not in (
            "SUCCEEDED",
            NEAREST_REACHED,
        ):  # beside the staging pose the dock may be seen as well; if not, that is said
            name = "LOST" if code == "LOST" else "NAVIGATION_FAILED"
            return self._end(
                DockState.FAILED, name, f"the staging pose was not reached, {code}: {self._now.drive_text}"
            )
        return self._search(view)

    def _searching(self, view: DockView) -> list[DockCommand]:
        """Turn and move a little, looking for a while from every pose."""
        c = self.config
        if self._fresh_track(view) is not None:
            return self._align(view, "the dock is in view")
        if self._now.seconds(view) > c.search_timeout or self._now.look >= len(self._now.look_poses):
            if self._now.stagings < c.stagings:
                self._enter(DockState.STAGING, "the dock is not in view: to the staging pose once more")
                return [STILL, *self._to_staging()]
            text = f"dock {self._now.dock.name} was not seen from its staging pose within {self._now.stagings} searches"
            return self._fail_or_back(view, "DOCK_NOT_SEEN", text)
        target = view.odom_from_base.inverse() @ self._now.look_poses[self._now.look]
        step = self._steer(view, target)
        is_there = math.hypot(target.x, target.y) < 0.03 and abs(target.yaw) < 0.03
        if self._now.look_ns is None and (is_there or self._now.held_seconds > 1.0):
            self._now.look_ns = view.now_ns
        if self._now.look_ns is not None:
            if (view.now_ns - self._now.look_ns) * 1e-9 > c.look_time:
                self._now.look, self._now.look_ns = self._now.look + 1, None
            return [STILL]
        return [Move(step.velocity)]

    def _aligning(self, view: DockView) -> list[DockCommand]:
        """Stand on the dock's line at the approach distance."""
        c, track = self.config, self._fresh_track(view)
        if track is None:
            return self._search(view, "the dock was lost while aligning")
        if self._now.seconds(view) > c.align_timeout:
            return self._attempt_failed(view, "TIMEOUT", "the robot did not come to stand before the dock in time")
        target = track.base_from_dock @ SE2(-self._now.dock.approach_distance, 0.0, 0.0)
        step = self._steer(view, target)
        x, y, yaw = step.error
        # What lies between the robot and the dock's line counts; how far before the dock it stands counts little.
        is_before = -3.0 * c.align_xy < x < c.staging_near
        is_there = abs(y) < c.align_xy and abs(yaw) < c.align_yaw and is_before
        if is_there and track.sightings >= c.align_sightings:
            self._enter(DockState.APPROACHING, f"going in, attempt {self.attempts + 1} of {c.attempts}")
            return self._approaching(view)
        return [Move(step.velocity)]

    def _approaching(self, view: DockView) -> list[DockCommand]:
        """Go in, until contacts meet or the pose is reached."""
        c, track = self.config, view.track
        if self._is_contact_made(view):
            self._enter(DockState.CONFIRMING, "contact")
            return self._confirming(view)
        was_hidden = self._now.waited_seconds > 0.0 and self._is_outside(view, c.blind_distance)
        if track is None and was_hidden:
            return self._search(view, HIDDEN)
        if track is None:
            return self._attempt_failed(view, "DOCK_LOST", "the dock vanished during the final approach")
        dock = track.base_from_dock
        left = -dock.inverse().x
        is_waiting = view.is_held and self._now.held_seconds <= c.wait_time
        is_old = track.travel > c.lost_travel or (track.age > c.lost_age and not is_waiting)
        if is_old and track.travel <= c.lost_travel and was_hidden:
            return self._search(view, HIDDEN)
        if is_old and (left > c.blind_distance or track.travel > c.blind_push):
            return self._attempt_failed(
                view, "DOCK_LOST", f"the dock vanished {max(left, 0.0):.2f} m before the contact"
            )
        y, yaw = dock.inverse().y, dock.yaw
        if left < c.limit_at and (abs(y) > c.limit_y or abs(yaw) > c.limit_yaw):
            text = f"{y * 1e3:.0f} mm and {math.degrees(yaw):.1f}° beside the line, {max(left, 0.0):.2f} m before the contact"
            return self._attempt_failed(view, "OUTSIDE_LIMITS", text)
        if self._now.seconds(view) - self._now.waited_seconds > c.approach_timeout:
            return self._attempt_failed(
                view, "TIMEOUT", f"still {max(left, 0.0):.2f} m before the contact after {c.approach_timeout:.0f} s"
            )
        if self._now.held_seconds > c.wait_time:
            return self._attempt_failed(
                view, "BLOCKED", f"something stands between robot and dock, {max(left, 0.0):.2f} m before the contact"
            )
        push = 0.0 if self._now.dock.contacts is Contacts.NONE else c.overrun
        share = c.final_share if left < c.final_distance else 1.0
        step = self._steer(view, dock @ SE2(push, 0.0, 0.0), share)
        self._now.settled_seconds = self._now.settled_seconds + self._now.dt if self._is_settled(step, view) else 0.0
        if self._now.settled_seconds >= c.settle_time:
            if self._now.dock.contacts is Contacts.NONE:
                return self._end(DockState.DOCKED, "SUCCEEDED", f"docked at {self._now.dock.name}")
            self._enter(DockState.CONFIRMING, "at the docked pose, waiting for contact")
            return self._confirming(view)
        permit = PermitApproach(view.odom_from_base @ dock, self._now.dock.outline, c.overrun + 0.02, c.permit_time)
        return [permit, Move(step.velocity)]

    def _confirming(self, view: DockView) -> list[DockCommand]:
        """Stand still until contact and charge have lasted."""
        c = self.config
        self._now.contact_seconds = self._now.contact_seconds + self._now.dt if self._is_confirmed(view) else 0.0
        if self._now.contact_seconds >= c.contact_time:
            return self._end(DockState.DOCKED, "SUCCEEDED", f"docked at {self._now.dock.name}")
        if self._now.seconds(view) > c.confirm_time:
            if view.has_contact:
                text = f"the contacts meet, but no current flows within {c.confirm_time:.0f} s"
                return self._attempt_failed(view, "NO_CHARGE", text)
            return self._attempt_failed(
                view, "NO_CONTACT", f"no contact within {c.confirm_time:.0f} s at the docked pose"
            )
        return [STILL]

    def _backing_out(self, view: DockView) -> list[DockCommand]:
        """Straight back to the approach distance, then again, or the end."""
        step, is_back = self._leave(view)
        if is_back:
            if self.attempts >= self.config.attempts or self._now.is_hopeless:
                return self._end(
                    DockState.FAILED, self._now.reason, f"{self._now.reason_text} ({self.attempts} attempts)"
                )
            return self._search(view, f"once more: {self._now.reason_text}")
        if self._now.held_seconds > self.config.blocked_time or self._now.seconds(view) > self.config.back_timeout:
            text = (
                f"the robot cannot back out of {self._now.dock.name} after {self._now.reason}: {self._now.reason_text}"
            )
            return self._end(DockState.FAILED, "BLOCKED", text)
        return [Move(step.velocity)]

    def _undocking(self, view: DockView) -> list[DockCommand]:
        """Straight back to the staging pose once the current has ended."""
        if view.is_charging and self._now.goal_odom is None:
            if self._now.seconds(view) > STOP_CHARGING_TIME:
                return self._end(DockState.FAILED, "TIMEOUT", "the charger does not stop")
            return [STILL]
        if self._now.goal_odom is None:
            self._now.goal_odom = view.odom_from_base @ SE2(-self._now.dock.approach_distance, 0.0, 0.0)
            self._now.entered_ns = view.now_ns
        step, is_back = self._leave(view)
        if is_back:
            return self._end(DockState.UNDOCKED, "SUCCEEDED", f"left {self._now.dock.name}")
        if self._now.held_seconds > self.config.blocked_time:
            return self._end(DockState.FAILED, "BLOCKED", f"something stands behind the robot in {self._now.dock.name}")
        if self._now.seconds(view) > self.config.back_timeout:
            return self._end(DockState.FAILED, "TIMEOUT", f"the robot did not leave {self._now.dock.name} in time")
        return [Move(step.velocity)]

    # What several states share.

    @property
    def _now(self) -> DockRun:
        assert self._run is not None
        return self._run

    def _enter(self, state: DockState, text: str) -> None:
        self.state, self.text = state, text
        self._now.enter()

    def _watch(self, view: DockView) -> list[DockCommand] | None:
        """Stand while input is stale, fail when it stays so; count how long the gate holds the robot."""
        if view.is_fresh or self.state is DockState.STAGING:
            self._now.stale_seconds = 0.0
            return None
        self._now.stale_seconds += self._now.dt
        self._controller.reset()
        if self._now.stale_seconds > self.config.stale_time:
            return self._end(
                DockState.FAILED, "STALE_INPUT", f"no fresh odometry or scan for {self._now.stale_seconds:.1f} s"
            )
        return [STILL]

    def _to_staging(self) -> list[DockCommand]:
        self._now.stagings += 1
        self._drive += 1
        self._now.drive_code = None
        c = self.config
        return [DriveTo(self._drive, self._now.dock.map_from_staging, c.staging_xy, c.staging_yaw)]

    def _is_outside(self, view: DockView, left: float) -> bool:
        """Whether the robot is still more than `left` metres before the dock's pose."""
        dock = self._now.dock_odom
        return dock is not None and (dock.inverse() @ view.odom_from_base).x < -left

    def _fresh_track(self, view: DockView) -> DockTrack | None:
        """Return the dock if it was seen lately."""
        track = view.track
        return None if track is None or track.age > self.config.lost_age else track

    def _is_before(self, track: DockTrack) -> bool:
        """Whether the robot stands before the dock, near enough to align without navigation."""
        base = track.base_from_dock.inverse()
        near = self.config.staging_near
        is_ahead = abs(base.x + self._now.dock.approach_distance) < near and abs(base.y) < near
        return is_ahead and abs(base.yaw) < 0.5

    def _search(self, view: DockView, text: str = "looking for the dock") -> list[DockCommand]:
        c = self.config
        self._controller.reset()
        here = view.odom_from_base
        moves = [SE2(0.0, y, 0.0) for y in c.search_moves]
        self._now.look_poses = [here @ pose for pose in (*(SE2(0.0, 0.0, a) for a in c.search_turns), *moves, SE2())]
        self._now.look, self._now.look_ns = 0, None
        self._enter(DockState.SEARCHING, text)
        return [STILL]

    def _align(self, view: DockView, text: str) -> list[DockCommand]:
        self._controller.reset()
        if self._now.docking_ns is None:
            self._now.docking_ns = view.now_ns
        self._enter(DockState.ALIGNING, text)
        return self._aligning(view)

    def _steer(
        self, view: DockView, base_from_target: SE2, speed_share: float = 1.0, can_turn: bool = True
    ) -> PlanarStep:
        return self._controller.compute_command(
            base_from_target, view.velocity, self._now.dt, None if can_turn else _never, speed_share
        )

    def _is_contact_made(self, view: DockView) -> bool:
        """Whether contacts met where they can: a battery that is full says "full" on the way, too."""
        is_told = bool(view.has_contact) or bool(view.is_charging)
        is_away = self._is_outside(view, self.config.contact_at)
        self._now.is_contact_void = is_told and (is_away or self._now.is_contact_void)
        return is_told and not self._now.is_contact_void and self._now.dock.contacts is not Contacts.NONE

    def _is_confirmed(self, view: DockView) -> bool:
        if self._now.dock.contacts is Contacts.CHARGE:
            return bool(view.is_charging)
        return bool(view.has_contact)

    def _is_settled(self, step: PlanarStep, view: DockView) -> bool:
        c, (x, y, yaw) = self.config, step.error
        is_near = math.hypot(x, y) < c.settle_xy and abs(yaw) < c.settle_yaw
        is_at_rest = math.hypot(view.velocity.vx, view.velocity.vy) < 0.01 and abs(view.velocity.wz) < 0.02
        return (is_near or step.phase is PlanarPhase.HOLDING) and is_at_rest

    def _attempt_failed(self, view: DockView, reason: str, text: str) -> list[DockCommand]:
        self._now.attempts += 1
        return self._back_out(view, reason, text)

    def _fail_or_back(self, view: DockView, reason: str, text: str) -> list[DockCommand]:
        """Fail; from near a dock whose place was once known back out first."""
        if self.attempts == 0:
            return self._end(DockState.FAILED, reason, text)
        self._now.is_hopeless = True
        return self._back_out(view, reason, text)

    def _back_out(self, view: DockView, reason: str, text: str) -> list[DockCommand]:
        self._now.reason, self._now.reason_text = reason, text
        self._controller.reset()
        staging = SE2(-self._now.dock.approach_distance, 0.0, 0.0)
        if self._now.dock_odom is not None:
            self._now.goal_odom = self._now.dock_odom @ staging
        else:
            self._now.goal_odom = view.odom_from_base @ SE2(-0.5 * self._now.dock.approach_distance, 0.0, 0.0)
        self._enter(DockState.BACKING_OUT, f"{reason}: {text}")
        return [STILL, RevokeApproach()]

    def _leave(self, view: DockView) -> tuple[PlanarStep, bool]:
        """Steer back without turning on the spot: the footprint may still be inside the dock."""
        assert self._now.goal_odom is not None
        target = view.odom_from_base.inverse() @ self._now.goal_odom
        step = self._steer(view, target, can_turn=False)
        is_back = math.hypot(target.x, target.y) < self.config.back_xy and abs(wrap_angle(target.yaw)) < 0.1
        return step, is_back

    def _end(self, state: DockState, code: str, text: str) -> list[DockCommand]:
        self._enter(state, text)
        result = self._now.result(self.attempts + (state is DockState.DOCKED))
        return [StopNavigation(), STILL, RevokeApproach(), LookForDock(False), DockEnded(code, text, result)]


def _never(angle: float) -> bool:
    """The footprint cannot turn here."""
    return False
