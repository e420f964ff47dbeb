"""Motions that the velocity gate has held where the robot stands: they are not asked for again while it stands there.

A costmap of 5 cm knows neither where a corner touches nor what the gate remembers of places that no sensor sees. A planner that asks for the same turn again and again is held
again and again, beside a way out that it does not ask for. Motions are told apart by where they lead: ahead or back, left or right, turning left or right, or not.
"""

from __future__ import annotations

from dataclasses import dataclass

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2, wrap_angle

Kind = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class HeldMotionsConfig:
    """Numbers, SI. `held`: seconds that a kind of motion is held before it is refused, for `refused` seconds and while the robot stays within `away` metres and `turned` radians.
    A stop holds whatever is wanted for `delay` seconds after what it began with (`gate.resume_delay` and a little), so another motion is blamed only when that has passed. Less than `still` m/s or `straight` rad/s
    is no motion."""

    held: float = 0.6
    refused: float = 30.0
    away: float = 0.15
    turned: float = 0.26
    delay: float = 2.4
    still: float = 0.02
    straight: float = 0.1


class HeldMotions:
    """Feed it once a cycle; ask it before a motion is wanted."""

    def __init__(self, config: HeldMotionsConfig | None = None) -> None:
        self._config = config if config is not None else HeldMotionsConfig()
        self._here: SE2 | None = None
        self._last_s = 0.0
        self._was_held = False
        self._wanted: Kind = (0, 0, 0)
        self._wanted_since = 0.0
        self._blamed: Kind | None = None
        self._seconds: dict[Kind, float] = {}
        self._until: dict[Kind, float] = {}

    def update(self, seconds: float, here: SE2, wanted: BodyVelocity, *, is_held: bool) -> None:
        """Take what was wanted in the last cycle, and whether the gate holds it. `seconds` from any beginning; `here` in a frame that does not jump."""
        c, dt = self._config, min(seconds - self._last_s, 0.2)
        self._last_s = seconds
        if self._here is None or _is_off(self._here, here, c.away, c.turned):
            self._here = here
            self._seconds.clear()
            self._until.clear()
        kind = self._kind(wanted)
        if kind != self._wanted:
            self._wanted, self._wanted_since = kind, seconds
        if is_held and (not self._was_held or seconds - self._wanted_since > c.delay):
            self._blamed = kind
        self._was_held = is_held
        if is_held and kind == self._blamed and any(kind):
            self._seconds[kind] = self._seconds.get(kind, 0.0) + dt
            if self._seconds[kind] >= c.held:
                self._seconds[kind] = 0.0
                self._until[kind] = seconds + c.refused

    def refuses(self, wanted: BodyVelocity) -> bool:
        """Say whether the gate has held such a motion here."""
        return bool(self._until) and self._until.get(self._kind(wanted), -1.0) > self._last_s

    def _kind(self, v: BodyVelocity) -> Kind:
        c = self._config
        return _sign(v.vx, c.still), _sign(v.vy, c.still), _sign(v.wz, c.straight)


def _sign(value: float, least: float) -> int:
    return 0 if abs(value) < least else (1 if value > 0.0 else -1)


def _is_off(then: SE2, now: SE2, away: float, turned: float) -> bool:
    return then.distance_to(now) > away or abs(wrap_angle(now.yaw - then.yaw)) > turned
