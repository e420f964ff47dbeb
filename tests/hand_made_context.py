"""A context made by hand for single nodes: time, timers, and a list of everything that was published."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Any

from ambler.runtime.node import Node
from ambler.runtime.topics import Topic


class HandMadeContext:
    """Time, timers and a list of everything published, with the time of publishing."""

    def __init__(self) -> None:
        self.now_ns = 5_000_000_000
        self.published: list[tuple[int, Topic[Any], Any]] = []
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.services: dict[str, Callable[[Any], Any]] = {}
        self.tasks: dict[str, tuple[Callable[[Any], None], Callable[[Any], None]]] = {}
        self.logged: list[tuple[str, str]] = []
        self._due: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def serve(self, service: Any, handler: Callable[[Any], Any]) -> None:
        self.services[service.name] = handler

    def serve_task(self, task: Any, on_goal: Callable[[Any], None], on_cancel: Callable[[Any], None]) -> None:
        """Remember what begins and what cancels a goal."""
        self.tasks[task.name] = (on_goal, on_cancel)

    def log(self, code: str, text: str, **fields: Any) -> None:
        self.logged.append((code, text))

    def publish(self, topic: Topic[Any], message: Any) -> None:
        self.published.append((self.now_ns, topic, message))

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (self.now_ns + round(delay * 1e9), self._count, callback))

    def background(
        self, work: Callable[[], Any], duration: float, done: Callable[[Any], None], kind: Any = None
    ) -> None:
        """Work at once; what it gave is handed over `duration` later."""
        value = work()
        self.after(duration, lambda: done(value))

    def timer(self, period: float, callback: Callable[[], None], *, phase: float = 0.0) -> None:
        def fire() -> None:
            self.after(period, fire)
            callback()

        self.after(period + phase, fire)

    def run(self, seconds: float) -> None:
        end = self.now_ns + round(seconds * 1e9)
        while self._due and self._due[0][0] <= end:
            self.now_ns, _, callback = heapq.heappop(self._due)
            callback()
        self.now_ns = end

    def start(self, node: Node) -> None:
        """Start a node in this context."""
        node.ctx = self  # type: ignore[assignment]
        node.start()

    def messages(self, topic: Topic[Any]) -> list[Any]:
        return [message for _, t, message in self.published if t == topic]
