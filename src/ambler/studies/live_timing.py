"""How regularly a live robot commands its base, undisturbed and while its disk, recorder or log fails, beside an empty loop of 50 Hz; how soon its
commands know of what it sees, and how much of a processor its process takes."""

from __future__ import annotations

import errno
import multiprocessing
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.errors import AmblerError
from ambler.core.messages import VelocityCommand
from ambler.evaluation.goals import draw_goals
from ambler.nodes.steps import ExploreStep, NavigateStep
from ambler.runtime.live import LiveExecutor
from ambler.runtime.topics import VELOCITY_COMMAND
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world
from ambler.studies.processor_share import ProcessorTimes, processor_times, shares
from ambler.studies.scan_watch import ScanWatch

PERIOD = 0.02
SETTLED = 5.0  # seconds after the start from which periods count
DISTURBED_AT = 8.0  # seconds after the start at which a disturbance begins
STALL = 5.0  # seconds for which a stalled disk takes nothing

GOALS = 300  # more than anybody waits for

Disturb = Callable[[SimulatedRun], None]


def _stall(run: SimulatedRun) -> None:
    write = run.recorders[0]._mcap.write
    stalled = threading.Event()

    def slow(*values: Any, **named: Any) -> None:
        if not stalled.is_set():
            stalled.set()
            time.sleep(STALL)
        write(*values, **named)

    run.recorders[0]._mcap.write = slow  # type: ignore[method-assign]


def _fill(run: SimulatedRun) -> None:
    def full(*values: Any, **named: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    run.recorders[0]._mcap.write = full  # type: ignore[method-assign]


def _break_recorder(run: SimulatedRun) -> None:
    def broken(*values: Any, **named: Any) -> None:
        raise RuntimeError("injected")

    run.recorders[0]._mcap.write = broken  # type: ignore[method-assign]


def _break_log(run: SimulatedRun) -> None:
    def broken(*values: Any, **named: Any) -> None:
        raise RuntimeError("injected")

    run.log.write = broken  # type: ignore[method-assign]


DISTURBANCES: dict[str, Disturb | None] = {
    "none": None,
    "stalled_disk": _stall,
    "full_disk": _fill,
    "recorder_raises": _break_recorder,
    "log_raises": _break_log,
}


def busy(options: RunOptions) -> RunOptions:
    """Let a robot explore, and then drive to one random goal after the other until its time is over."""
    goals = draw_goals(
        load_world(options.world), robot_named(options.robot), GOALS, np.random.default_rng(options.seed)
    )
    return replace(options, steps=(ExploreStep(), *(NavigateStep(goal) for goal in goals)))


def measure_live(options: RunOptions, seconds: float, out: Path, disturbance: str) -> dict[str, float | str | None]:
    """Run a live robot for `seconds` beside an empty loop; returns the periods (ms) of both, from `SETTLED` s on until the last command,
    which comes when the program has been ended and the map is saved; how soon commands knew of the scans that ended from then until `seconds`
    are over (`ScanWatch`), and how much of a processor core the process of the robot took meanwhile (`shares`)."""
    disturb = DISTURBANCES[disturbance]
    run = SimulatedRun(options, RunFolder.new(out, f"live-{disturbance}"))
    executor = run.executor
    assert isinstance(executor, LiveExecutor)
    stamps: list[int] = []

    def watch(topic: Any, message: Any, time_ns: int, writer: str) -> None:
        if topic is VELOCITY_COMMAND and isinstance(message, VelocityCommand):
            stamps.append(message.stamp_ns)

    executor.tap(watch)
    scans = ScanWatch(executor)
    times: list[tuple[int, ProcessorTimes]] = []
    theirs, ours = multiprocessing.Pipe()
    loop = multiprocessing.get_context("spawn").Process(target=_empty_loop, args=(seconds, theirs), daemon=True)
    loop.start()
    timers = [
        threading.Timer(DISTURBED_AT, lambda: None if disturb is None else disturb(run)),
        *(threading.Timer(at, lambda: times.append((executor.now_ns, processor_times()))) for at in (SETTLED, seconds)),
    ]
    for timer in timers:
        timer.start()
    try:
        run.run(seconds)
    finally:
        for timer in timers:
            timer.cancel()
        run.close()
    empty = np.array(ours.recv()) if ours.poll(10.0) else np.zeros(0)
    instants = 1e-9 * np.array(stamps, np.float64)
    return {
        "command_seconds": float(instants[-1] - instants[0]) if len(instants) else 0.0,
        **_periods("command", instants),
        **_periods("empty_loop", empty),
        **_while_settled(scans, times),
        "load_average": os.getloadavg()[0],
        "ended": run.ended,
        "troubles": ", ".join(sorted(executor.troubles.counts)) or None,
    }


def _while_settled(scans: ScanWatch, times: list[tuple[int, ProcessorTimes]]) -> dict[str, float | None]:
    """Return what was measured between the two instants; of a run that ended before the second there is nothing to tell."""
    if len(times) < 2:
        return {}
    (begin_ns, begin), (end_ns, end) = times
    return {**scans.results(begin_ns, end_ns), **shares(begin, end)}


def stop_after_failure(options: RunOptions, out: Path, *, log_raises: bool) -> dict[str, float | bool | None]:
    """Let a node fail while the robot drives live; returns seconds until the command was zero for good, and whether the run told it."""
    run = SimulatedRun(options, RunFolder.new(out, "live-failure"))
    commands: list[tuple[int, float]] = []
    failed_ns: list[int] = []

    def watch(topic: Any, message: Any, time_ns: int, writer: str) -> None:
        if topic is VELOCITY_COMMAND:
            commands.append((message.stamp_ns, abs(message.vx) + abs(message.vy) + abs(message.wz)))

    def fail() -> None:
        failed_ns.append(run.executor.now_ns)
        raise RuntimeError("injected")

    run.executor.tap(watch)
    victim = run.executor.context_of("planner")
    timer = threading.Timer(DISTURBED_AT, lambda: run.executor.post(victim, 0, fail))
    timer.start()
    if log_raises:
        _break_log(run)
    try:
        run.run(3.0 * DISTURBED_AT)
    except AmblerError:
        pass
    finally:
        timer.cancel()
        run.close()
    later = [(stamp, speed) for stamp, speed in commands if failed_ns and stamp >= failed_ns[0]]
    moving = [stamp for stamp, speed in later if speed > 0.0]
    return {
        "first_slower_s": None if not later else (later[0][0] - failed_ns[0]) * 1e-9,
        "stopped_s": None if not later else ((moving[-1] if moving else failed_ns[0]) - failed_ns[0]) * 1e-9 + PERIOD,
        "is_told": run.executor.failure is not None,
    }


def _empty_loop(seconds: float, answer: Connection) -> None:
    """Wake up every 20 ms and note when."""
    begin = time.monotonic()
    instants, due = [], begin + PERIOD
    while due < begin + seconds:
        time.sleep(max(0.0, due - time.monotonic()))
        instants.append(time.monotonic())
        due += PERIOD
    answer.send(instants)


def _periods(name: str, instants: NDArray[np.float64]) -> dict[str, float | str | None]:
    """Return median, percentiles and maximum (ms) of the periods after the robot has settled; None when there are none."""
    names = ("median", "p99", "p999", "max")
    instants = instants[instants > instants[0] + SETTLED] if len(instants) else instants
    if len(instants) < 2:
        return {f"{name}_{what}_ms": None for what in names}
    periods = 1e3 * np.diff(instants)
    values = [float(np.percentile(periods, share)) for share in (50.0, 99.0, 99.9, 100.0)]
    return {f"{name}_{what}_ms": value for what, value in zip(names, values, strict=True)}
