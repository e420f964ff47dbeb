"""Whether a robot gets on: towards its target, and at all; and whether drives fail because of where they begin."""

from __future__ import annotations

import math

from ambler.core.se2 import SE2


class Progress:
    """Since when the robot is no nearer to its target (`nearer_ns`), and since when it stands (`moved_ns`); `step` metres are progress."""

    def __init__(self, step: float, now_ns: int) -> None:
        self._step = step
        self._still_at = SE2()
        self.resume(now_ns)

    @property
    def since_ns(self) -> int:
        """Since when there has been none of either kind: a change of the target begins only the former anew."""
        return min(self.nearer_ns, self.moved_ns)

    def resume(self, now_ns: int) -> None:
        """Somebody else drove, or the robot was not allowed to: count from now."""
        self.aim(now_ns)
        self.moved_ns = now_ns

    def aim(self, now_ns: int) -> None:
        """Another target."""
        self._best = math.inf
        self.nearer_ns = now_ns

    def set_out(self, map_from_base: SE2, now_ns: int) -> None:
        """The robot begins to drive."""
        self._still_at, self.moved_ns = map_from_base, now_ns

    def note_motion(self, map_from_base: SE2, now_ns: int) -> None:
        """Take where the robot is."""
        if self._still_at.distance_to(map_from_base) > self._step:
            self.set_out(map_from_base, now_ns)

    def note_distance(self, distance: float, now_ns: int) -> None:
        """Take how far the target is along the way, in metres."""
        if distance < self._best - self._step:
            if math.isfinite(self._best):
                self.moved_ns = now_ns
            self._best = distance
            self.nearer_ns = now_ns


class FailedDrives:
    """Drives that failed one after the other without the robot getting away from where the first of them began: `count`, and since when (`since_ns`)."""

    def __init__(self, apart: float, stuck_distance: float) -> None:
        self._apart, self._stuck_distance = apart, stuck_distance
        self._from = SE2()
        self._goals: list[SE2] = []
        self.count = 0
        self.since_ns = 0

    @property
    def goals(self) -> int:
        """To how many places they led, places at least `apart` metres from one another."""
        return len(self._goals)

    def add(self, goal: SE2, map_from_base: SE2, now_ns: int) -> None:
        """A drive to `goal` failed; the robot is at `map_from_base`."""
        if self.count and self._from.distance_to(map_from_base) > self._stuck_distance:
            self.forget()
        if self.count == 0:
            self._from, self.since_ns = map_from_base, now_ns
        self.count += 1
        if all(goal.distance_to(place) > self._apart for place in self._goals):
            self._goals.append(goal)

    def forget(self) -> None:
        """The robot got on."""
        self.count = 0
        self._goals.clear()
