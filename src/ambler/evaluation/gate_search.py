"""Random searches for counterexamples to the velocity gate's promises: its protective field alone, case by case, and the whole gate, run by run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import GateState
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.kernels import gate_search as kernels
from ambler.safety.config import GateConfig
from ambler.safety.gate import VelocityGate
from ambler.safety.limits import limit_acceleration, limit_speed

F64 = NDArray[np.float64]

BLOCK = 20_000
TICK_NS, TICKS = 20_000_000, 12
FIELD_CASES_PER_RUN = 2000  # cases of the field for one run of the whole gate
GATE_PROPERTIES = ("finite", "limited", "raised", "bent")
"""Of an output: it is finite; within the robot's limits; no axis above what the acceleration limits made of the request; on its arc."""


@dataclass
class GateSearchResult:
    """`violations` per property; `grazes`: cases in which a point grazed the margin and rounding decided; `example`: the first bad case."""

    cases: int = 0
    gate_runs: int = 0
    gate_moving: int = 0
    grazes: int = 0
    violations: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys((*kernels.PROPERTIES, *GATE_PROPERTIES), 0)
    )
    example: str = ""

    @property
    def counterexamples(self) -> int:
        """Cases and runs that broke a promise."""
        return sum(self.violations.values())

    def blame(self, name: str, example: str) -> None:
        """Count a counterexample and keep the first."""
        self.violations[name] += 1
        self.example = self.example or f"{name}: {example}"


def search_gate(
    runs: int, seed: int, progress: Callable[[int], None] = lambda done: None, config: GateConfig | None = None
) -> GateSearchResult:
    """Check `runs` random cases of the field, whose numbers are drawn too, and one run of the whole gate, told `config`, for every 2000 of
    them; `progress` hears how many are done."""
    result = GateSearchResult()
    for block in range(math.ceil(runs / BLOCK)):
        rng = np.random.default_rng([seed, block])
        cases = min(BLOCK, runs - block * BLOCK)
        _search_field(rng.random((cases, kernels.CHANCES)), f"seed {seed}, block {block}", result)
        for _ in range(max(1, cases // FIELD_CASES_PER_RUN)):
            check_gate(rng, result, config)
        progress(result.cases)
    return result


def _search_field(chances: F64, where: str, result: GateSearchResult) -> None:
    corners, points = np.empty((kernels.EDGES_MOST, 2)), np.empty((kernels.POINTS_MOST, 2))
    counts, grazes = np.zeros(len(kernels.PROPERTIES), np.int64), np.zeros(1, np.int64)
    twist, numbers = np.empty(3), np.empty(7)
    row = 0
    while row < len(chances):
        at, edges, count, failed = kernels.search(chances[row:], counts, grazes, corners, points, twist, numbers)
        row += at + 1
        if failed >= 0:
            case = f"{where}, row {row - 1}: twist {twist.tolist()}, numbers {numbers.tolist()}"
            shapes = f"footprint {corners[:edges].tolist()}, points {points[:count].tolist()}"
            result.blame(kernels.PROPERTIES[failed], f"{case}, {shapes}")
    result.cases += len(chances)
    result.grazes += int(grazes[0])


def check_gate(rng: np.random.Generator, result: GateSearchResult, config: GateConfig | None = None) -> None:
    """Drive a gate for a moment among random points, with requests that change at random, and judge every output."""
    robot = _drawn_robot(rng)
    gate = VelocityGate(replace(config if config is not None else GateConfig(), stale_delay=0.0), robot)
    limits = robot.limits
    gate.arm(0)
    pose, last = SE2(), BodyVelocity()
    world = rng.uniform(-3.0, 3.0, (int(rng.integers(2, 60)), 2))
    wanted = BodyVelocity()
    result.gate_runs += 1
    for tick, now_ns in _ticks():
        if rng.random() < 0.3:
            wanted = BodyVelocity(*(rng.uniform(-2.0, 2.0, 3) * (rng.random(3) < 0.7)).tolist())
        gate.update_odometry(now_ns, pose)
        gate.update_points("scanner", now_ns, pose.inverse().transform(world), pose)
        gate.request("navigation", now_ns, wanted, now_ns)
        step = gate.step(now_ns)
        dt = 0.0 if tick == 0 else TICK_NS * 1e-9
        most = limit_acceleration(last, limit_speed(wanted, limits), limits, dt)
        name = broken_promise(step.velocity, most, limits)
        if name is not None:
            result.blame(name, f"{step.velocity} of {most}, wanted {wanted}, {limits}")
        result.gate_moving += step.state == GateState.ARMED and step.velocity != BodyVelocity()
        last = step.velocity
        pose = pose @ SE2.exp(np.array([last.vx, last.vy, last.wz]) * TICK_NS * 1e-9)


def broken_promise(out: BodyVelocity, most: BodyVelocity, limits: VelocityLimits) -> str | None:
    """Say which promise an output breaks, given the velocity `most` that could be output if nothing were in the way; None for none."""
    a, b = np.array([out.vx, out.vy, out.wz]), np.array([most.vx, most.vy, most.wz])
    if not np.isfinite(a).all():
        return "finite"
    if not limits.vx_min - 1e-9 <= out.vx <= limits.vx_max + 1e-9 or np.any(
        np.abs(a[1:]) > np.array([limits.vy_max, limits.wz_max]) + 1e-9
    ):
        return "limited"
    if np.any(a * b < 0.0) or np.any(np.abs(a) > np.abs(b) + 1e-12):
        return "raised"
    return "bent" if np.abs(np.cross(a, b)).max() > 1e-9 else None


def _ticks() -> Iterator[tuple[int, int]]:
    return ((tick, 1_000_000_000 + tick * TICK_NS) for tick in range(TICKS))


def _drawn_robot(rng: np.random.Generator) -> RobotModel:
    length, width = rng.uniform(0.15, 0.6, 2)
    footprint = np.array([[length, -width], [length, width], [-length, width], [-length, -width]])
    is_omni = rng.random() < 0.5
    limits = VelocityLimits(
        rng.uniform(0.3, 1.5),
        -rng.uniform(0.1, 0.5),
        rng.uniform(0.1, 0.8) if is_omni else 0.0,
        *rng.uniform(0.5, 2.0, 1),
        *rng.uniform(0.5, 3.0, 5),
    )
    return RobotModel("drawn", DriveKind.OMNI if is_omni else DriveKind.DIFFERENTIAL, footprint, limits)
