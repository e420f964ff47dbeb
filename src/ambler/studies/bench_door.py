"""Four strangers at the outside door of a robot that drives: a thousand calls and goals from four threads, in both executors.

Every answer is compared with its question; a run in lockstep is repeated from its recording, in which the order of the requests is given.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import TimeoutError as WaitingTimeoutError
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.replay import replay_run
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.errors import AmblerError
from ambler.core.messages import Odometry, VelocityCommand
from ambler.core.requests import EndProgramRequest, GateReply, GateRequest, PlanReply, PlanRequest
from ambler.core.se2 import SE2
from ambler.evaluation.goals import draw_goals
from ambler.nodes.steps import NavigateStep
from ambler.runtime.door import RunEndedError
from ambler.runtime.executor import Executor
from ambler.runtime.tasks import ARM, COMPUTE_PATH, END_PROGRAM, NAVIGATE, NavigateGoal
from ambler.runtime.topics import TRUE_POSE, VELOCITY_COMMAND
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world

STRANGERS = 4
GOALS = 300  # of the robot's own program, which every goal of a stranger interrupts
PATIENCE = 120.0  # seconds for one answer: later it counts as lost
PAUSE = 0.05  # seconds between two requests of one stranger
SAME = 1e-6  # metres


@dataclass(slots=True)
class _Told:
    """What one stranger got: seconds until each call was answered, how goals ended, and what was wrong."""

    waits: list[float] = field(default_factory=list)
    codes: Counter[str] = field(default_factory=Counter)
    calls: int = 0
    goals: int = 0
    refused: int = 0
    lost: int = 0
    wrong: int = 0


def measure(
    options: RunOptions, requests: int, out: Path, tell: Callable[[str], None], executors: Sequence[str]
) -> dict[str, Any]:
    """Let the robot drive its own program while each of four threads makes a quarter of the `requests`; returns `<executor>.<what>`."""
    fields: dict[str, Any] = {}
    for name in executors:
        found = _visit(replace(options, is_realtime=name == "live"), requests // STRANGERS, out, name)
        fields |= {f"{name}.{what}": value for what, value in found.items()}
        tell(f"{name}: " + ", ".join(f"{what} {value}" for what, value in found.items()))
    fields["bars.door"] = all(
        fields[f"{name}.lost"] == fields[f"{name}.wrong"] == 0
        and fields[f"{name}.answered"] == STRANGERS * (requests // STRANGERS)
        and fields.get(f"{name}.is_replay_equal", True)
        for name in executors
    )
    return fields


def _visit(options: RunOptions, each: int, out: Path, name: str) -> dict[str, Any]:
    world, robot = load_world(options.world), robot_named(options.robot)
    own, theirs = (np.random.default_rng((options.seed, k)) for k in range(2))
    steps = tuple(NavigateStep(goal) for goal in draw_goals(world, robot, GOALS, own))
    places = draw_goals(world, robot, STRANGERS * each, theirs)
    run = SimulatedRun(replace(options, steps=steps), RunFolder.new(out, f"door-{name}"))
    drives, way = threading.Event(), _Way()

    def watch(topic: Any, message: Any, time_ns: int, writer: str) -> None:
        if topic is VELOCITY_COMMAND and isinstance(message, VelocityCommand) and message.vx != 0.0:
            drives.set()
        elif topic is TRUE_POSE:
            way.add(message)

    run.executor.tap(watch)
    told = [_Told() for _ in range(STRANGERS)]
    threads = [
        threading.Thread(target=_ask, args=(run.executor, drives, places[k::STRANGERS], k, told[k]))
        for k in range(STRANGERS)
    ]

    def end() -> None:
        for thread in threads:
            thread.join()
        run.executor.call(END_PROGRAM, EndProgramRequest("DONE", "the strangers have left"))

    for thread in (*threads, usher := threading.Thread(target=end)):
        thread.start()
    try:
        run.run()
    finally:
        run.close()  # answers whoever still waits
        usher.join()
    whole = _sum(told)
    found = {**whole, "driven_m": way.length, "seconds": 1e-9 * run.executor.now_ns, "ended": run.ended}
    if not options.is_realtime:
        found["is_replay_equal"] = replay_run(run.folder.root).is_good
    return found


class _Way:
    """How far the robot has come."""

    def __init__(self) -> None:
        self.length = 0.0
        self._last: SE2 | None = None

    def add(self, truth: Odometry) -> None:
        here = truth.pose.to_se2()
        self.length += 0.0 if self._last is None else self._last.distance_to(here)
        self._last = here


def _ask(executor: Executor, drives: threading.Event, places: Sequence[SE2], who: int, told: _Told) -> None:
    """Ask for a path, ask the gate, and every fifth time send the robot somewhere, which ends what anybody else wanted of it; every second goal is called off soon
    after, and the last one at the end."""
    drives.wait(PATIENCE)
    tickets = []
    for k, place in enumerate(places):
        begin = time.monotonic()
        try:
            if k % 5 == 4:
                tickets.append(executor.send_goal(NAVIGATE, NavigateGoal(place)))
                told.goals += 1
            else:
                told.calls += 1
                told.wrong += not (_asks_path if k % 2 else _asks_gate)(executor, place, f"{who}.{k}")
                told.waits.append(time.monotonic() - begin)
            if k % 10 == 5 and tickets:
                tickets[-1].cancel()
        except (WaitingTimeoutError, RunEndedError):
            told.lost += 1
        except AmblerError:  # an answer, too: it has a name
            told.refused += 1
        time.sleep(PAUSE)
    for ticket in tickets[-1:]:
        ticket.cancel()
    for ticket in tickets:
        try:
            told.codes[ticket.outcome.result(PATIENCE).code] += 1
        except (WaitingTimeoutError, AmblerError):  # of a goal only an outcome is an answer
            told.lost += 1


def _asks_path(executor: Executor, place: SE2, _: str) -> bool:
    """Ask for a path; say whether the answer leads where it was asked to."""
    reply: PlanReply = executor.call(COMPUTE_PATH, PlanRequest(place)).result(PATIENCE)
    x, y, _yaw = reply.path.poses[-1]
    return abs(place.distance_to(SE2(float(x), float(y), 0.0)) - reply.goal_distance) <= SAME


def _asks_gate(executor: Executor, _: SE2, why: str) -> bool:
    """Ask the gate to arm; say whether it did."""
    reply: GateReply = executor.call(ARM, GateRequest("stranger", why)).result(PATIENCE)
    return reply.is_done


def _sum(told: Sequence[_Told]) -> dict[str, Any]:
    waits = 1e3 * np.array([wait for one in told for wait in one.waits])
    goals = sum((one.codes for one in told), Counter[str]())
    refused = sum(one.refused for one in told)
    return {
        "calls": sum(one.calls for one in told),
        "goals": sum(one.goals for one in told),
        "answered": len(waits) + refused + goals.total(),
        "refused": refused,
        "lost": sum(one.lost for one in told),
        "wrong": sum(one.wrong for one in told),
        "call_median_ms": float(np.median(waits)) if len(waits) else None,
        "call_p99_ms": float(np.percentile(waits, 99.0)) if len(waits) else None,
        **{f"goals_{code.lower()}": count for code, count in sorted(goals.items())},
    }
