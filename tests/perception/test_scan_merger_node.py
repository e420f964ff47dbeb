"""The merger's node with a hand-made context: it publishes in time and tells when a scanner fails and comes back."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ambler.core.messages import LaserScan, Message, Odometry, Status
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.nodes.scan_merger import ScanMergerNode
from ambler.perception.merger import MergerConfig, ScannerConfig
from ambler.runtime import topics


class HandMadeContext:
    """Remembers what the node subscribed, published and logged."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.published: list[tuple[str, Message]] = []
        self.tick: Callable[[], None] = lambda: None
        self.codes: list[str] = []

    def subscribe(self, topic: Any, callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def publish(self, topic: Any, message: Message) -> None:
        self.published.append((topic.name, message))

    def timer(self, period: float, callback: Callable[[], None], *, phase: float = 0.0) -> None:
        self.tick = callback

    def log(self, code: str, text: str, **fields: Any) -> None:
        self.codes.append(code)


def start_node() -> tuple[ScanMergerNode, HandMadeContext]:
    scanners = tuple(ScannerConfig.planar(f, SE2(0.4, y, 0.0)) for f, y in (("left", 0.3), ("right", -0.3)))
    node, context = ScanMergerNode(MergerConfig(scanners)), HandMadeContext()
    node.ctx = context  # type: ignore[assignment]
    node.start()
    return node, context


def run(context: HandMadeContext, begin: float, end: float, alive: tuple[str, ...]) -> None:
    """Ten scans and a hundred odometry messages a second, and the node's timer."""
    for step in range(round(begin * 100), round(end * 100)):
        context.now_ns = step * 10_000_000
        zeros = np.zeros((6, 6))
        context.callbacks["odometry"](
            Odometry(context.now_ns, "odom", "base", SE3(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), zeros, zeros.copy())
        )
        context.tick()
        for k, frame in enumerate(("left", "right")):
            if frame in alive and step % 10 == 3 + 2 * k:
                ranges = np.full(181, 2.0, np.float32)
                scan = LaserScan(
                    context.now_ns, frame, -math.pi / 2, math.radians(1), 0.0, 0.1, 0.05, 20.0, ranges, ranges[:0]
                )
                context.callbacks["scanners"](scan)


def test_a_scanner_that_stops_is_named_and_the_other_goes_on() -> None:
    _, context = start_node()
    run(context, 0.0, 1.0, ("left", "right"))
    scans = [m for name, m in context.published if name == "scan"]
    assert len(scans) == 10
    assert context.codes == []
    run(context, 1.0, 2.0, ("left",))
    assert context.codes == ["SCANNER_STALE"]
    run(context, 2.0, 3.0, ("left", "right"))
    assert context.codes == ["SCANNER_STALE", "SCANNER_BACK"]
    stamps = [m.stamp_ns for name, m in context.published if name == "scan" and isinstance(m, LaserScan)]
    assert len(stamps) >= 28
    assert (np.diff(stamps) > 0).all()
    statuses = [m for _, m in context.published if isinstance(m, Status)]
    assert statuses[0].text == "scanner right is dropped from the merged scan: stale"


def test_without_any_scanner_the_node_says_so_once() -> None:
    _, context = start_node()
    run(context, 0.0, 1.0, ("left", "right"))
    run(context, 1.0, 2.0, ())
    assert context.codes == ["MERGER_STARVED"]
    run(context, 2.0, 2.5, ("left", "right"))
    assert context.codes == ["MERGER_STARVED", "MERGER_FED", "SCANNER_STALE", "SCANNER_BACK"]


def test_the_node_declares_what_it_uses() -> None:
    node, context = start_node()
    assert set(context.callbacks) == {t.name for t in node.inputs}
    run(context, 0.0, 0.5, ("left", "right"))
    assert {name for name, _ in context.published} <= {t.name for t in node.outputs}
    assert topics.SCANNERS.has_many_writers
