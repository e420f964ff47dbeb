"""Live robots, run by run: explored with the simulator in another process, a cable pulled on the way, and every verb in real time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.judgement import judge
from ambler.apps.replay import replay_run
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import FIRST, SimulatedRun
from ambler.core.errors import BadInputError
from ambler.core.messages import GateState, GateStatus, VelocityCommand
from ambler.core.se2 import SE2
from ambler.nodes.steps import DockStep, ExploreStep, NavigateStep, UndockStep
from ambler.runtime.topics import GATE_STATUS, VELOCITY_COMMAND
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings

APART, CABLE = "apart", "cable"
PULLED_AT = 8.0  # seconds after the start, from which a cable is pulled as soon as the robot is fast
FAST = 0.6  # m/s commanded for half a second
WATCHED = 4.0  # seconds after that
GOALS = (NavigateStep(SE2(3.0, 1.5, 0.0)), NavigateStep(SE2(0.0, 0.0, 1.57)))
VERBS: dict[str, Callable[[int], RunOptions]] = {
    "explore": lambda seed: RunOptions((ExploreStep(),), "lab_empty", "diff", seed, port=None, time_limit=120.0),
    "navigate": lambda seed: RunOptions(GOALS, "lab_empty", "amr_omni", seed, port=None, time_limit=90.0),
    "navigate_lost": lambda seed: RunOptions(
        GOALS, "lab_empty", "amr_omni", seed, is_lost=True, may_turn=True, port=None, time_limit=90.0
    ),
    "dock": lambda seed: RunOptions(
        (DockStep("charger_1"),), "dock_room", "amr_omni", seed, port=None, time_limit=90.0
    ),
    "undock": lambda seed: RunOptions(
        (UndockStep("charger_1"),), "dock_room", "amr_omni", seed, starts_docked="charger_1", port=None, time_limit=60.0
    ),
}


@dataclass(frozen=True, slots=True)
class LiveCase:
    """One live run: a verb in real time, an exploration with its simulator `apart`, or that with its `cable` pulled."""

    kind: str
    seed: int
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.kind}-{self.seed}"

    @property
    def options(self) -> RunOptions:
        """What the run is told."""
        if self.kind == CABLE:
            return self.settings.applied_to(cable_options(self.seed))
        if self.kind == APART:
            return self.settings.applied_to(replace(VERBS["explore"](self.seed), is_apart=True))
        return self.settings.applied_to(replace(VERBS[self.kind](self.seed), is_realtime=True))


def live_study(cases: Sequence[LiveCase]) -> Study[LiveCase]:
    """Return the study of these runs, which should have the machine to themselves."""
    return Study("live", cases, run_case, _line)


def run_case(case: LiveCase, out: Path) -> dict[str, Any]:
    """Run live and judge."""
    if case.kind == CABLE:
        return pull_cable(case.options, out)
    return run_live(case.options, out, replays=case.kind == APART)


def is_good(result: dict[str, Any]) -> bool:
    """Say whether a run ended well, without a collision; of a pulled cable, whether the base stood."""
    if result["kind"] == CABLE:
        return result.get("base_stood_s") is not None
    return result.get("ended") in ("finished", "succeeded") and not result.get("collisions")


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<kind>.<what>`."""
    fields: dict[str, Any] = {}
    for kind in dict.fromkeys(r["kind"] for r in results):
        members = [r for r in results if r["kind"] == kind]
        fields |= _cables(members) if kind == CABLE else _summary(kind, members)
    return fields


def _cables(members: list[dict[str, Any]]) -> dict[str, Any]:
    told = ("speed_mps", "gate_refused_s", "commands_ended_s", "base_stood_s")
    return {**{f"cable.{name}_max": worst([m.get(name) for m in members]) for name in told}, "cable.runs": len(members)}


def _summary(name: str, results: list[dict[str, Any]]) -> dict[str, Any]:
    ended = [r["ended"] for r in results]
    fields: dict[str, Any] = {
        f"{name}.runs": len(results),
        f"{name}.succeeded": sum(e in ("finished", "succeeded") for e in ended),
        f"{name}.ended": ", ".join(sorted(set(ended))),
        f"{name}.collisions": sum(r.get("collisions") or 0 for r in results),
        f"{name}.lost_messages": sum(r.get("lost_messages") or 0 for r in results),
        f"{name}.seconds_median": worst([r.get("sim_seconds") for r in results], share=50.0),
    }
    if name == APART:
        fields["apart.replays_within"] = sum(bool(r.get("is_replay_within")) for r in results)
        fields["apart.pose_difference_p95_m"] = worst([r.get("pose_difference_p95_m") for r in results])
    return fields


def _line(result: dict[str, Any]) -> str:
    if result["kind"] == CABLE:
        return f"stood after {result['base_stood_s']:.2f} s"
    return f"{result['ended']}, {result['collisions']} collisions"


def run_live(options: RunOptions, out: Path, *, replays: bool = False) -> dict[str, Any]:
    """Run live and judge; with `replays` also say how the poses of its recording come out when it is replayed."""
    run = SimulatedRun(options, RunFolder.new(out, "live"))
    try:
        run.run()
        fields = judge(run).fields
    finally:
        run.close()
    fields["lost_messages"] = sum(_drops(run).values())
    if replays:
        replay = replay_run(run.folder.root)
        fields["is_replay_within"] = replay.is_good
        fields["pose_difference_p95_m"] = None if replay.poses is None else replay.poses.p95_m
    return fields


def cable_options(seed: int) -> RunOptions:
    """Return the run of a live robot whose cable is pulled."""
    return RunOptions((ExploreStep(),), "office", "diff", seed, is_apart=True, port=None, time_limit=10.0 * PULLED_AT)


def pull_cable(options: RunOptions, out: Path) -> dict[str, float | None]:
    """Pull the cable of the base of a live robot on its way: seconds until the gate refused to drive on and commanded nothing any more, and
    until the base stood, by the ground truth."""
    run = SimulatedRun(options, RunFolder.new(out, "cable"))
    told: dict[str, list[tuple[int, float]]] = {"gate": [], "command": [], "forward": []}
    pulled: list[int] = []
    is_over = threading.Event()

    def watch(topic: Any, message: Any, time_ns: int, writer: str) -> None:
        if topic is VELOCITY_COMMAND and isinstance(message, VelocityCommand):
            told["command"].append((message.stamp_ns, abs(message.vx) + abs(message.wz)))
            told["forward"].append((message.stamp_ns, message.vx))
        elif topic is GATE_STATUS and isinstance(message, GateStatus):
            told["gate"].append((message.stamp_ns, float(message.state is GateState.ARMED)))

    def is_fast() -> bool:
        return min((speed for _, speed in told["forward"][-25:]), default=0.0) >= FAST

    def pull() -> None:
        assert run.simulator is not None
        while not is_fast() and not is_over.wait(0.02):
            pass
        if not is_over.is_set():
            pulled.append(run.executor.now_ns)
            run.simulator.unplug(FIRST)
            is_over.wait(WATCHED)
            run.executor.stop()

    run.executor.tap(watch)
    timer = threading.Timer(PULLED_AT, pull)
    timer.start()
    try:
        run.run()
        record = judge(run).record
    finally:
        is_over.set()
        timer.cancel()
        run.close()
    if not pulled:
        raise BadInputError(f"seed {options.seed}: the robot was never fast for half a second, so no cable was pulled")
    after = record.true_stamps_ns > pulled[0]
    still = record.true_stamps_ns[after][record.speeds[after] > 0.02]
    return {
        "speed_mps": float(record.speeds[after][0]) if after.any() else None,
        "gate_refused_s": _first(told["gate"], pulled[0], lambda armed: armed == 0.0),
        "commands_ended_s": _last(told["command"], pulled[0]),
        "base_stood_s": (int(still[-1]) - pulled[0]) * 1e-9 if len(still) else 0.0,
    }


def _first(rows: list[tuple[int, float]], since_ns: int, is_wanted: Callable[[float], bool]) -> float | None:
    return next(((t - since_ns) * 1e-9 for t, v in rows if t >= since_ns and is_wanted(v)), None)


def _last(rows: list[tuple[int, float]], since_ns: int) -> float:
    moving = [t for t, v in rows if t >= since_ns and v > 0.0]
    return (moving[-1] - since_ns) * 1e-9 if moving else 0.0


def _drops(run: SimulatedRun) -> dict[str, int]:
    drops: dict[str, int] = getattr(run.executor, "drops", {})
    return drops


def worst(values: list[float | None], *, share: float = 100.0) -> float | None:
    """Return a percentile of those values that are known, None when none is."""
    known = [v for v in values if v is not None]
    return float(np.percentile(known, share)) if known else None
