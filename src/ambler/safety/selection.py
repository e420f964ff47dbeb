"""Who drives: the newest request of every source, and the choice by priority among those that are fresh."""

from __future__ import annotations

from dataclasses import dataclass

from ambler.core.protocols import BodyVelocity
from ambler.safety.config import VelocitySource


@dataclass(frozen=True, slots=True)
class VelocityRequest:
    """What a source asked for, and when."""

    stamp_ns: int
    velocity: BodyVelocity


class SourceSelector:
    """Remembers requests and selects one. Requests issued before the last `void` are gone for good."""

    def __init__(self, sources: tuple[VelocitySource, ...]) -> None:
        self._sources = sorted(sources, key=lambda s: (-s.priority, s.name))
        self._newest: dict[str, VelocityRequest] = {}
        self._valid_from_ns = 0

    @property
    def names(self) -> tuple[str, ...]:
        """The sources, highest priority first."""
        return tuple(s.name for s in self._sources)

    def take(self, source: str, request: VelocityRequest) -> bool:
        """Remember a request; returns False when it is older than the last one of this source or void. Raises KeyError."""
        if source not in self.names:
            raise KeyError(f"the gate knows no source {source!r}, only {self.names}")
        last = self._newest.get(source)
        if request.stamp_ns < self._valid_from_ns or (last is not None and request.stamp_ns < last.stamp_ns):
            return False
        self._newest[source] = request
        return True

    def void(self, now_ns: int) -> None:
        """Forget every request, and refuse those that were issued before now."""
        self._newest.clear()
        self._valid_from_ns = now_ns

    def select(self, now_ns: int) -> tuple[str, BodyVelocity] | None:
        """Return the name and the wanted velocity of the source that drives, or None."""
        for source in self._sources:
            request = self._newest.get(source.name)
            if request is not None and now_ns - request.stamp_ns <= source.timeout * 1e9:
                return source.name, request.velocity
        return None
