"""The protective stop: what happens when the field leaves almost nothing of the wanted speed.

It holds the robot until the field along the wanted motion has been clear for a while. A motion that leads away from the blocked
one and is itself free passes at once, so a robot in front of a wall is never wedged there.
"""

from __future__ import annotations

from ambler.core.protocols import BodyVelocity
from ambler.safety.limits import STILL, is_still


def leads_away(velocity: BodyVelocity, blocked: BodyVelocity) -> bool:
    """Say whether a motion has no component along the blocked one."""
    along_x, along_y, along_turn = velocity.vx * blocked.vx, velocity.vy * blocked.vy, velocity.wz * blocked.wz
    return along_x + along_y <= 0.0 and along_turn <= 0.0


class ProtectiveStop:
    """Holds, frees and resumes."""

    def __init__(self, stop_scale: float, resume_scale: float, resume_delay: float) -> None:
        self._stop_scale = stop_scale
        self._resume_scale = resume_scale
        self._resume_delay_ns = int(resume_delay * 1e9)
        self.blocked = STILL
        self._is_active = False
        self._clear_since_ns: int | None = None

    def reset(self) -> None:
        """Forget the stop."""
        self.blocked, self._is_active, self._clear_since_ns = STILL, False, None

    def update(
        self, now_ns: int, velocity: BodyVelocity, scale: float, wanted: BodyVelocity, wanted_scale: float
    ) -> bool:
        """Return whether the robot must stand.

        `scale` is what the field leaves of the `velocity` that would be output now, `wanted_scale` what it leaves of the
        `wanted` one (or of the blocked one while nothing is wanted).
        """
        if scale < self._stop_scale:
            self.blocked = velocity if is_still(wanted) else wanted
            self._is_active, self._clear_since_ns = True, None
            return True
        if not self._is_active:
            return False
        if leads_away(wanted, self.blocked) and scale >= 1.0 and not is_still(wanted):
            return False
        if wanted_scale < self._resume_scale:
            self._clear_since_ns = None
        elif self._clear_since_ns is None:
            self._clear_since_ns = now_ns
        elif now_ns - self._clear_since_ns >= self._resume_delay_ns:
            self.reset()
            return False
        return True
