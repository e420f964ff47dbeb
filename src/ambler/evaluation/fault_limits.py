"""What a run under a fault must still do: nothing is touched, and the result stays within limits or the failure has a name.

The limits are stated before the run; `broken_limits` holds a run against them. Standing still is judged from the true speed in the recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ambler.evaluation.exploration_run import ExplorationRecord

BRAKING = 1.2  # seconds from the beginning of a fault until the robot stands: stale after 0.5 s, then braking
STANDING = 0.02  # m/s


@dataclass(frozen=True, slots=True)
class FaultLimits:
    """`ends`: how the run may end (`finished`, or the lower-case code of a failure). `coverage`: least and greatest share of the floor
    that is known at the end; the greatest shows that the fault was there. `ate_rms_max`: metres. `says`: codes or words that the log must
    hold. `stands`: (begin, end) seconds between which the robot must come to rest and stand."""

    ends: tuple[str, ...] = ("finished",)
    coverage: tuple[float, float] | None = None
    ate_rms_max: float | None = None
    says: tuple[str, ...] = ()
    stands: tuple[float, float] | None = None

    def __str__(self) -> str:
        """One line for tables."""
        parts = [" or ".join(self.ends)]
        if self.coverage is not None:
            low, high = self.coverage
            parts.append(f"coverage ≥ {low:.0%}" if high >= 1.0 else f"coverage {low:.0%} … {high:.0%}")
        if self.ate_rms_max is not None:
            parts.append(f"error ≤ {100.0 * self.ate_rms_max:.0f} cm")
        if self.stands is not None:
            parts.append("stands")
        return ", ".join([*parts, *(f"says {word}" for word in self.says)])


@dataclass(frozen=True, slots=True)
class FaultOutcome:
    """What a run did. Unknown values are None; `top_speed` (m/s) is that of the time in which the robot must stand."""

    ended: str
    collisions: int | None
    coverage_ratio: float | None = None
    ate_rms_m: float | None = None
    top_speed: float | None = None
    log: str = ""


def broken_limits(limits: FaultLimits, outcome: FaultOutcome) -> tuple[str, ...]:
    """Return a sentence for every limit that does not hold; none means passed. What is unknown does not hold."""
    broken: list[str] = []
    if outcome.collisions != 0:
        broken.append(f"{'unknown' if outcome.collisions is None else outcome.collisions} collisions")
    if outcome.ended not in limits.ends:
        broken.append(f"ended as {outcome.ended}")
    if limits.coverage is not None and not _is_within(outcome.coverage_ratio, *limits.coverage):
        broken.append(f"coverage is {_text(outcome.coverage_ratio)}")
    if limits.ate_rms_max is not None and not _is_within(outcome.ate_rms_m, 0.0, limits.ate_rms_max):
        broken.append(f"trajectory error is {_text(outcome.ate_rms_m)} m")
    if limits.stands is not None and not _is_within(outcome.top_speed, 0.0, STANDING):
        broken.append(f"drove at {_text(outcome.top_speed)} m/s while it must stand")
    return (*broken, *(f"the log does not say {word}" for word in limits.says if word not in outcome.log))


def top_speed_while_standing(record: ExplorationRecord, stands: tuple[float, float]) -> float | None:
    """Return the greatest true speed (m/s) from `BRAKING` after the beginning to the end; None when the recording has nothing of that time."""
    seconds = record.true_stamps_ns * 1e-9
    during = record.speeds[(seconds >= stands[0] + BRAKING) & (seconds < stands[1])]
    return float(np.max(during)) if len(during) else None


def _is_within(value: float | None, low: float, high: float) -> bool:
    return value is not None and math.isfinite(value) and low <= value <= high


def _text(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f}"
