"""Setting out slowly in company: for the first half second after a rest, no point of the robot moves faster than what causes no contact.

Who comes up unseen while a robot sets out (from a dead angle, or as a track that was just begun) reaches it within that half second:
then it has not moved towards him. Who is seen is for the yielding, which by then has had time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel


@dataclass(frozen=True, slots=True)
class SlowStartConfig:
    """Numbers of setting out, SI.

    seconds        for which a robot that sets out is slow: the half second by which a contact is judged, and what the base overshoots
    speed          m/s of its fastest point meanwhile; a contact at 0.05 m/s is caused
    wary           seconds after the last mover was near for which it is in company
    still          m/s of its fastest point below which it is at rest
    """

    seconds: float = 0.6
    speed: float = 0.035
    wary: float = 6.0
    still: float = 0.06


class SlowStart:
    """Limits the velocities of one robot while it sets out; asked at every control period."""

    def __init__(self, config: SlowStartConfig, robot: RobotModel) -> None:
        self._config = config
        self._reach = robot.circumscribed_radius
        self._company_ns: int | None = None
        self._began_ns: int | None = None

    def limited(
        self, now_ns: int, wanted: BodyVelocity, velocity: BodyVelocity, *, is_somebody_near: bool
    ) -> BodyVelocity:
        """Return what passes of a wanted velocity, on the same arc, while the base moves with `velocity`."""
        c = self._config
        if is_somebody_near:
            self._company_ns = now_ns
        is_in_company = self._company_ns is not None and now_ns - self._company_ns <= c.wary * 1e9
        if wanted == BodyVelocity() or not is_in_company:
            if self._fastest(velocity) < c.still:
                self._began_ns = None
            return wanted
        if self._began_ns is None:
            if self._fastest(velocity) >= c.still:
                return wanted  # it was on its way already
            self._began_ns = now_ns
        if now_ns - self._began_ns >= c.seconds * 1e9:
            return wanted
        share = min(1.0, c.speed / self._fastest(wanted))
        return BodyVelocity(share * wanted.vx, share * wanted.vy, share * wanted.wz)

    def _fastest(self, velocity: BodyVelocity) -> float:
        """Return the speed (m/s) of the footprint's fastest point, at most."""
        return math.hypot(velocity.vx, velocity.vy) + abs(velocity.wz) * self._reach
