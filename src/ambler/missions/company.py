"""People about: what is shut while they are there may be shut by them, and what seems a wall may be one of them before a door."""

from __future__ import annotations


class Company:
    """Whether people were about within `memory` s, and how often the robot has looked past them since it last saw anything new: up to `looks`
    times while something is shut, and `TURNS` times where nothing is. New is a share `NEWS` of the floor that was known: whoever walks off shows
    a square metre behind him wherever he has stood."""

    TURNS = 2
    NEWS = 0.005

    def __init__(self, memory: float, looks: int) -> None:
        self._memory_ns = round(memory * 1e9)
        self._most = looks
        self._is_here = False
        self._left_ns: int | None = None
        self.forget()

    def forget(self) -> None:
        """Begin to count anew."""
        self.looks = 0
        self._known_area = 0.0

    def meet(self, now_ns: int, *, is_here: bool) -> None:
        """Take whether anybody who moves is near the robot."""
        if self._is_here and not is_here:
            self._left_ns = now_ns
        self._is_here = is_here

    def is_about(self, now_ns: int) -> bool:
        """Whether anybody is near the robot, or was lately."""
        return self._is_here or (self._left_ns is not None and now_ns - self._left_ns <= self._memory_ns)

    def look(self, now_ns: int, known_area: float, *, is_shut: bool) -> bool:
        """Say whether to look once more before believing what the map says of a floor of so many known square metres, and count it. `is_shut`:
        there is something that cannot be reached."""
        if known_area > (1.0 + self.NEWS) * self._known_area:
            self.looks, self._known_area = 0, known_area
        if not self.is_about(now_ns) or self.looks >= (self._most if is_shut else self.TURNS):
            return False
        self.looks += 1
        return True
