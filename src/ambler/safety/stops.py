"""Latched stops: who caused them, whose cause is still there, and when they may be reset."""

from __future__ import annotations


class StopLatch:
    """Emergency stops and faults stay until `reset`, and `reset` is refused while any cause is held."""

    def __init__(self) -> None:
        self._causes: dict[str, str] = {}
        self._held: set[str] = set()
        self._fault = ""

    @property
    def is_stopped(self) -> bool:
        """An emergency stop is latched."""
        return bool(self._causes)

    @property
    def is_faulty(self) -> bool:
        """A fault is latched."""
        return self._fault != ""

    @property
    def is_set(self) -> bool:
        """Anything is latched."""
        return self.is_stopped or self.is_faulty

    @property
    def reason(self) -> str:
        """Every cause with its reason, in the order of arrival."""
        texts = [f"{cause}: {reason}" if reason else cause for cause, reason in self._causes.items()]
        return "; ".join(texts) if texts else self._fault

    def stop(self, cause: str, reason: str) -> None:
        """Latch a stop whose cause is over."""
        self._causes.setdefault(cause, reason)

    def hold(self, cause: str, reason: str) -> None:
        """Latch a stop whose cause lasts."""
        self.stop(cause, reason)
        self._held.add(cause)

    def release(self, cause: str) -> None:
        """Say that a held cause is gone."""
        self._held.discard(cause)

    def fault(self, reason: str) -> None:
        """Latch a fault; the first one is remembered."""
        if not self._fault:
            self._fault = reason

    def reset(self) -> tuple[bool, str]:
        """Clear everything unless a cause is still held."""
        if self._held:
            return False, f"still there: {', '.join(sorted(self._held))}"
        self._causes.clear()
        self._fault = ""
        return True, "reset; the gate is paused"
