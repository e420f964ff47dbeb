"""When a controller acts: once a period, and in step with what it sees, so that a view is acted on when it is there and not up to a period later."""

from __future__ import annotations

from collections import deque
from statistics import median

KEPT = 5  # intervals between views of which the median tells when the next one comes
GRACE = 0.25  # of a period, for a view that is late
LATE_NS = 2_000_000  # by which an act may come late without moving those that follow


class SightRhythm:
    """Ask `wait_ns` how long it is until the next act, and `see` of every new view whether to act on it at once; tell it of every act.

    A view is acted on at once unless the last act was less than half a period ago; an act waits for a view that is expected within half a period after it. So acts
    follow one another by a period on average, whatever the rhythm of the views, and without views exactly.
    """

    def __init__(self, period: float) -> None:
        self._period_ns = round(period * 1e9)
        self._acted_ns: int | None = None
        self._seen_ns: int | None = None
        self._between_ns: deque[int] = deque(maxlen=KEPT)

    def act(self, now_ns: int) -> None:
        """Take down that it acts now."""
        due_ns = None if self._acted_ns is None else self._acted_ns + self._period_ns
        is_in_time = due_ns is not None and 0 <= now_ns - due_ns < LATE_NS
        self._acted_ns = due_ns if is_in_time else now_ns

    def see(self, now_ns: int) -> bool:
        """Take down that a new view is there; returns whether to act on it at once."""
        if self._seen_ns is not None:
            self._between_ns.append(now_ns - self._seen_ns)
        self._seen_ns = now_ns
        if self._acted_ns is None:
            return True
        early = min(self._period_ns, self._interval_ns()) // 2
        return now_ns - self._acted_ns >= self._period_ns - early

    def wait_ns(self, now_ns: int) -> int:
        """Return how long it is until the next act unless a view comes before, 0 when it is time."""
        if self._acted_ns is None:
            return 0
        due_ns = self._acted_ns + self._period_ns
        if now_ns < due_ns:
            return due_ns - now_ns
        return max(0, self._patience_ns(due_ns) - now_ns)

    def _interval_ns(self) -> int:
        return int(median(self._between_ns)) if self._between_ns else self._period_ns

    def _patience_ns(self, due_ns: int) -> int:
        """Until when an act that is due waits for the view that is expected."""
        if self._seen_ns is None or not self._between_ns:
            return due_ns
        half_ns = self._period_ns // 2
        expected_ns = self._seen_ns + self._interval_ns()
        if abs(expected_ns - due_ns) > half_ns:
            return due_ns
        return min(expected_ns + round(GRACE * self._period_ns), due_ns + half_ns)
