"""`ambler bench nodes` names every node of both runs with its declared latency, and fails when one is late."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.studies import bench_nodes


class Ticking(Node):
    """Works for a while at every tick."""

    latency = 0.002

    def __init__(self, name: str, work: float) -> None:
        self.name = name
        self._work = work

    def start(self) -> None:
        self.ctx.timer(0.1, self._tick)

    def _tick(self) -> None:
        until = time.thread_time() + self._work
        while time.thread_time() < until:
            pass


class Run:
    """What `bench_nodes` needs of a run."""

    def __init__(self) -> None:
        self.executor = LockstepExecutor(Stack([Ticking("quick", 0.0), Ticking("slow", 0.004)]))

    def run(self, seconds: float) -> None:
        self.executor.run(seconds)

    def close(self) -> None:
        self.executor.close()


def test_a_node_that_works_longer_than_it_declares_is_named() -> None:
    fields = bench_nodes.callback_times("toy", Run(), 3.0)
    assert fields["toy.slow.declared_ms"] == pytest.approx(2.0)
    assert 4.0 <= fields["toy.slow.median_ms"] <= fields["toy.slow.max_ms"]
    assert fields["toy.slow.late_ratio"] > 0.9
    assert fields["toy.quick.median_ms"] < 1.0
    assert bench_nodes.late_nodes(fields)[-1] == "toy.slow"
    assert "LATE" in bench_nodes.table(fields).splitlines()[-1]


def test_the_dock_run_of_the_benchmark_can_be_built(tmp_path: Path) -> None:
    office, dock = bench_nodes.build_runs("diff", 0, tmp_path)
    try:
        assert {"odometry", "slam2d", "gate"} <= {c.node.name for c in office.executor.contexts}
        assert {"odometry", "localization", "docking"} <= {c.node.name for c in dock.executor.contexts}
    finally:
        for run in (office, dock):
            run.recorders[0].close()  # `run` would have
            run.close()
