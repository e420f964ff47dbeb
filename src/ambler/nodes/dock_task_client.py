"""Carries out the commands of a docking mission: goals to the navigator, requests to the gate, the camera and the charger."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ambler.core.messages import VelocityCommand
from ambler.core.protocols import BodyVelocity
from ambler.missions.dock_commands import (
    DockCommand,
    DockEnded,
    LookForDock,
    Move,
    PermitApproach,
    RevokeApproach,
    StopCharging,
    StopNavigation,
)
from ambler.missions.drive_to import DriveTo
from ambler.runtime.node import Context, GoalTicket, TaskOutcome
from ambler.runtime.tasks import (
    CAMERA_PICTURES,
    NAVIGATE,
    PERMIT_APPROACH,
    REVOKE_APPROACH,
    STOP_CHARGING,
    ApproachRequest,
    NavigateGoal,
    NavigateResult,
    Nothing,
    PicturesRequest,
)
from ambler.runtime.topics import DOCKING_REQUEST

PERMIT_NS = 100_000_000
LEASE = 0.5  # seconds for which pictures are asked at a time; renewed at half of it
NEVER_NS = -(1 << 62)


class DockTaskClient:
    """`drive_ended` hears the ends of drives, `look` whether the dock is wanted to be seen, `ended` the end of the mission."""

    def __init__(
        self,
        ctx: Context,
        drive_ended: Callable[[int, str, str], None],
        look: Callable[[LookForDock], None],
        ended: Callable[[DockEnded], None],
    ) -> None:
        self._ctx = ctx
        self._drive_ended, self._look, self._ended = drive_ended, look, ended
        self._ticket: GoalTicket | None = None
        self._leased_ns = self._permitted_ns = NEVER_NS

    def do(self, commands: list[DockCommand]) -> None:
        """Carry out commands, in their order."""
        for command in commands:
            if isinstance(command, Move):
                self._send(command.velocity)
            elif isinstance(command, DriveTo):
                self._navigate(command)
            elif isinstance(command, StopNavigation):
                self._stop_navigation()
            elif isinstance(command, LookForDock):
                self._look(command)
            elif isinstance(command, PermitApproach):
                self._permit(command)
            elif isinstance(command, RevokeApproach):
                self._permitted_ns = NEVER_NS
                self._ctx.call(REVOKE_APPROACH, Nothing(), _ignore)
            elif isinstance(command, StopCharging):
                self._ctx.call(STOP_CHARGING, Nothing(), _ignore)
            else:
                self._ended(command)

    def lease_pictures(self) -> None:
        """Ask the camera for pictures for a moment."""
        now_ns = self._ctx.now_ns
        if now_ns - self._leased_ns >= 0.5 * LEASE * 1e9:
            self._leased_ns = now_ns
            self._ctx.call(CAMERA_PICTURES, PicturesRequest(LEASE), _ignore)

    def _send(self, v: BodyVelocity) -> None:
        self._ctx.publish(DOCKING_REQUEST, VelocityCommand(self._ctx.now_ns, v.vx, v.vy, v.wz))

    def _navigate(self, command: DriveTo) -> None:
        def over(outcome: TaskOutcome[NavigateResult]) -> None:
            self._drive_ended(command.drive, outcome.code, outcome.text)

        goal = NavigateGoal(command.map_from_goal, command.xy_tolerance, command.yaw_tolerance)
        self._ticket = self._ctx.send_goal(NAVIGATE, goal, over)

    def _stop_navigation(self) -> None:
        ticket, self._ticket = self._ticket, None
        if ticket is not None:
            ticket.cancel()

    def _permit(self, command: PermitApproach) -> None:
        """Renew the permission ten times a second; the mission asks for it at every update."""
        now_ns = self._ctx.now_ns
        if now_ns - self._permitted_ns < PERMIT_NS:
            return
        self._permitted_ns = now_ns
        outline = np.array(command.outline)
        request = ApproachRequest(command.odom_from_dock, outline, command.overrun, command.seconds)
        self._ctx.call(PERMIT_APPROACH, request, _ignore)


def _ignore(reply: object) -> None:
    """What a service says is seen in what happens next: no picture, no permission, no end of the current."""
