"""Device time becomes host time here: stamps of a counter that nobody set, drifts, wraps and sometimes jumps.

A message arrives late, never early: arrival minus stamp is the clocks' offset plus a delay of zero or more. So the offset is the
lower edge of these differences over a window, and its slope is the drift: the edge of the lower convex hull above the middle of
the window, a line that passes under all of them and nearest to them (Moon, Skelly, Towsley, INFOCOM 1999). A difference below that
line, or one that stays above it, is a jump of the device's clock: it is counted and named, and the estimate begins anew.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True, slots=True)
class DeviceClockConfig:
    """`window` (s) is how long differences are remembered, in ten slices; `jump` (s) is the smallest step that counts as one; a clock
    may drift by `drift_max` (s/s). `settle` (s) passes before a step can be told from a first message that was late; a step back by
    less than a message's distance must last `confirm` (s), for late messages look the same."""

    window: float = 10.0
    jump: float = 0.02
    drift_max: float = 5e-4
    settle: float = 1.0
    confirm: float = 1.0


class DeviceClock:
    """Learns from (device stamp, host arrival) pairs where a device's clock stands. A tick is `tick_ns` long; a counter of `bits`
    bits wraps (None: it never does). Arrivals must not run backwards: the host's clock is monotonic."""

    def __init__(self, tick_ns: int = 1, bits: int | None = None, config: DeviceClockConfig | None = None) -> None:
        self._tick_ns = tick_ns
        self._period_ns = None if bits is None else tick_ns << bits
        self._config = config if config is not None else DeviceClockConfig()
        self._is_known = False
        self._device_ns = self._arrival_ns = 0
        self._late_since_ns: int | None = None
        self.jumps = 0
        """How often the device's clock jumped."""
        self.last_jump = 0.0
        """By how much it jumped the last time, seconds, positive forwards."""

    @property
    def offset(self) -> float | None:
        """Host minus device now, seconds; None before the first message."""
        return self._offset_ns(self._device_ns) * 1e-9 if self._is_known else None

    @property
    def text(self) -> str:
        """One sentence on the last jump, empty when there was none."""
        return f"the device's clock jumped by {self.last_jump:+.3f} s" if self.jumps else ""

    def observe(self, ticks: int, arrival_ns: int) -> None:
        """Learn from a message that the device sent at `ticks` of its clock and that arrived at `arrival_ns` of the host's."""
        device_ns = self._unwrap(ticks, arrival_ns)
        difference = arrival_ns - device_ns
        if not self._is_known:
            self._restart(device_ns, arrival_ns)
            return
        step = self._step(device_ns, arrival_ns, difference)
        if step:
            self.jumps += 1
            self.last_jump = step * 1e-9
            self._restart(device_ns, arrival_ns)
            return
        self._device_ns, self._arrival_ns = device_ns, arrival_ns
        self._add(device_ns, difference)

    def to_host(self, ticks: int) -> int:
        """Return the host's instant of a device stamp near the newest one observed (within half a wrap). Raises ValueError before the
        first `observe`."""
        if not self._is_known:
            raise ValueError("nothing was observed yet")
        device_ns = self._unwrap(ticks, self._arrival_ns)
        return device_ns + self._offset_ns(device_ns)

    def _unwrap(self, ticks: int, arrival_ns: int) -> int:
        """Of all instants that the counter may mean, take the one nearest to where the device's clock must stand by now."""
        device_ns = ticks * self._tick_ns
        if self._period_ns is None or not self._is_known:
            return device_ns
        expected = self._device_ns + arrival_ns - self._arrival_ns
        return device_ns + round((expected - device_ns) / self._period_ns) * self._period_ns

    def _step(self, device_ns: int, arrival_ns: int, difference: int) -> int:
        """Return by how many ns the device's clock jumped before this message, 0 when it did not."""
        allowed = (
            self._config.jump * 1e9 + self._config.drift_max * (arrival_ns - self._arrival_ns) + abs(self._tick_ns)
        )
        expected_ns = self._device_ns + arrival_ns - self._arrival_ns
        late = difference - self._offset_ns(expected_ns)
        if device_ns < self._device_ns - allowed:
            return -late if late > 0 else device_ns - self._device_ns
        if late < -allowed and self._arrival_ns - self._begin_ns > self._config.settle * 1e9:
            return -late
        if late <= allowed:
            self._late_since_ns = None
            return 0
        if self._late_since_ns is None:
            self._late_since_ns, self._least_late = arrival_ns, late
        self._least_late = min(self._least_late, late)
        return -self._least_late if arrival_ns - self._late_since_ns > self._config.confirm * 1e9 else 0

    def _restart(self, device_ns: int, arrival_ns: int) -> None:
        self._is_known = True
        self._device_ns, self._arrival_ns = device_ns, arrival_ns
        self._begin_ns = arrival_ns
        self._late_since_ns = None
        self._least_late = 0
        # The line: difference at `_origin` and ns per ns; the slices' smallest differences, the last one still growing.
        self._origin, self._level, self._slope = device_ns, arrival_ns - device_ns, 0.0
        self._slices: deque[tuple[int, int]] = deque(maxlen=10)
        self._slice_start = device_ns
        self._lowest = (device_ns, arrival_ns - device_ns)

    def _offset_ns(self, device_ns: int) -> int:
        return self._level + round(self._slope * (device_ns - self._origin))

    def _add(self, device_ns: int, difference: int) -> None:
        if self._late_since_ns is not None:
            return
        if difference < self._lowest[1] + self._slope * (device_ns - self._lowest[0]):
            self._lowest = (device_ns, difference)
        if device_ns - self._slice_start >= self._config.window * 1e8:
            self._slices.append(self._lowest)
            self._slice_start, self._lowest = device_ns, (device_ns, difference)
            self._fit()
        self._level = min(self._level, difference - round(self._slope * (device_ns - self._origin)))

    def _fit(self) -> None:
        """Take the line through the two corners of the lower hull about the middle of the window; level while it is young."""
        first = next((i for i, s in enumerate(self._slices) if self._device_ns - s[0] <= self._config.window * 1e9), 0)
        points = [(x - self._device_ns, y) for x, y in list(self._slices)[first:]]
        hull: list[tuple[int, int]] = []
        for point in points:
            while len(hull) >= 2 and _turns_right(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)
        self._origin = self._device_ns
        lowest = min(y for _, y in points)
        self._slope, self._level = 0.0, lowest
        if len(points) < 4:
            return
        middle = (points[0][0] + points[-1][0]) / 2
        for (x0, y0), (x1, y1) in pairwise(hull):
            if x0 <= middle <= x1:
                limit = self._config.drift_max
                self._slope = min(max((y1 - y0) / (x1 - x0), -limit), limit)
                self._level = min(y - round(self._slope * x) for x, y in points)
                return


def _turns_right(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    """Say whether b lies on or above the line from a to c, so that it is no corner of the lower hull."""
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])


class DeviceStamps:
    """The stamps of one stream of messages in host time: never later than they arrived and never running backwards, whatever the
    estimate of the clock does in between. A stamp repeated by the device is repeated."""

    def __init__(self, clock: DeviceClock) -> None:
        self.clock = clock
        self._ticks: int | None = None
        self._last_ns: int | None = None

    def to_host(self, ticks: int, arrival_ns: int) -> int:
        """Return the host's instant of a device stamp of a message that arrived at `arrival_ns`."""
        if ticks == self._ticks and self._last_ns is not None:
            return self._last_ns
        stamp_ns = min(self.clock.to_host(ticks), arrival_ns)
        if self._last_ns is not None:
            stamp_ns = max(stamp_ns, self._last_ns + 1)
        self._ticks, self._last_ns = ticks, stamp_ns
        return stamp_ns
