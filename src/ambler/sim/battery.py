"""A battery that drains and charges, and contacts that close only where the robot stands within tolerance.

Voltage is a straight line over the charge plus the drop over an inner resistance; the charge is the integral of the current.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ambler.core.messages import BatteryState, PowerSupply
from ambler.core.se2 import SE2, wrap_angle
from ambler.sim.solids import SimDock


@dataclass(frozen=True, slots=True)
class BatterySpec:
    """`empty` and `full` volts at rest, ohms inside; amperes while standing, per m/s, and from a charger, which begins `delay` seconds
    after the contact closed. `depth`, `side`, `askew`: where contacts close: at least so deep (m), at most so far beside (m)
    and turned (rad). `period` of the messages; a change of the supply is told at once."""

    capacity_ah: float = 40.0
    empty: float = 44.0
    full: float = 53.0
    resistance: float = 0.03
    idle_current: float = 2.0
    drive_current: float = 9.0
    charge_current: float = 20.0
    delay: float = 0.15
    depth: float = -0.001
    side: float = 0.01
    askew: float = math.radians(1.0)
    period: float = 0.2


class Battery:
    """Starts with `share` of its charge; `update` once per tick."""

    def __init__(self, spec: BatterySpec, docks: Sequence[SimDock], share: float = 0.6) -> None:
        self.spec = spec
        self.share = share
        self._contacts_from_world = tuple(SE2(-dock.contact) @ dock.world_from_dock.inverse() for dock in docks)
        self._current = -spec.idle_current
        self._closed_for: float | None = None
        self._is_stopped = False
        self._told: tuple[float, PowerSupply] | None = None
        self._seconds = 0.0

    @property
    def has_contact(self) -> bool:
        """Whether the contacts of a dock are closed."""
        return self._closed_for is not None

    def stop_charging(self) -> None:
        """Let no current flow until the contacts have opened."""
        self._is_stopped = True

    def update(self, world_from_base: SE2, speed: float, dt: float, *, has_power: bool) -> None:
        """Advance by `dt` seconds; docks without power close contacts but give no current."""
        self._seconds += dt
        if any(self._meets(contacts_from_world @ world_from_base) for contacts_from_world in self._contacts_from_world):
            self._closed_for = dt if self._closed_for is None else self._closed_for + dt
        else:
            self._closed_for, self._is_stopped = None, False
        spec = self.spec
        is_fed = has_power and not self._is_stopped and self._closed_for is not None and self._closed_for > spec.delay
        drain = spec.idle_current + spec.drive_current * abs(speed)
        self._current = (spec.charge_current if is_fed and self.share < 1.0 else 0.0) - (0.0 if is_fed else drain)
        self.share = min(1.0, max(0.0, self.share + self._current * dt / (3600.0 * spec.capacity_ah)))

    def told(self, stamp_ns: int) -> BatteryState | None:
        """Return the message that is due now, or None."""
        supply = self._supply()
        last = self._told
        if last is not None and supply is last[1] and self._seconds - last[0] < self.spec.period - 1e-9:
            return None
        self._told = (self._seconds, supply)
        rest = self.spec.empty + self.share * (self.spec.full - self.spec.empty)
        voltage = rest + self.spec.resistance * self._current
        return BatteryState(stamp_ns, "base", voltage, self._current, self.share, supply)

    def _meets(self, contacts_from_base: SE2) -> bool:
        s = self.spec
        is_deep = s.depth <= contacts_from_base.x < 0.05
        return is_deep and abs(contacts_from_base.y) <= s.side and abs(wrap_angle(contacts_from_base.yaw)) <= s.askew

    def _supply(self) -> PowerSupply:
        if self._closed_for is None:
            return PowerSupply.DISCHARGING
        if self.share >= 1.0:
            return PowerSupply.FULL
        return PowerSupply.CHARGING if self._current > 0.0 else PowerSupply.NOT_CHARGING
