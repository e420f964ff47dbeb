"""The ranking of a tuning study: what each trial came to over its cases, what it breaks, and which trials go on to more cases.

All of it follows from the results alone: an interrupted study ends with the same ranking as one that was not.
"""

from __future__ import annotations

import dataclasses
import json
import math
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.core.errors import BadInputError
from ambler.evaluation.tuning_space import Case, Choice, TuningSpace
from ambler.settings.profiles import as_values
from ambler.wire.atomic_file import write_whole

Metrics = dict[str, Any]
FINISHED = "finished"


@dataclass(frozen=True, slots=True)
class Ranked:
    """One trial's place: its values by parameter, the cases it has run, its objective (1 times the sum of weights for the defaults; inf
    when it breaks a constraint) and what it breaks."""

    trial: int
    values: dict[str, Choice]
    cases: int
    objective: float
    broken: tuple[str, ...]
    metrics: dict[str, float]

    @property
    def is_valid(self) -> bool:
        """Whether it keeps every constraint."""
        return not self.broken


class TrialResults:
    """What the trials of a space have shown so far, and the ranking that follows from it alone."""

    def __init__(self, space: TuningSpace) -> None:
        self.space = space
        self.trials = space.sampled()
        self._results: dict[tuple[int, str], Metrics] = {}

    def add(self, trial: int, case: Case, metrics: Metrics) -> None:
        """Take the result of one run; raises BadInputError when a finished one lacks what the space weighs."""
        self._check_names(metrics)
        self._results[trial, case.name] = metrics

    def going_on(self, going: Iterable[int], cases: int) -> list[int]:
        """Return the trials that go on to more cases: the best 1/`halving` of those that were going, and the defaults."""
        ranked = self._ranked(going, cases)
        keep = math.ceil(len(ranked) / self.space.halving)
        return sorted({0, *(r.trial for r in ranked[:keep])})

    def ranking(self) -> list[Ranked]:
        """Return all trials, best first: valid before invalid, those with more cases first."""
        counts = [self._cases_done(t) for t in range(len(self.trials))]
        ranked: list[Ranked] = []
        for count in sorted(set(counts), reverse=True):
            ranked += self._ranked([t for t, c in enumerate(counts) if c == count], count) if count else []
        return sorted(ranked, key=lambda r: not r.is_valid)

    def _ranked(self, trials: Iterable[int], count: int) -> list[Ranked]:
        return sorted(
            (self._judge(t, self.space.cases()[:count]) for t in trials),
            key=lambda r: (not r.is_valid, len(r.broken), r.objective, r.trial),
        )

    def _judge(self, trial: int, cases: list[Case]) -> Ranked:
        broken: list[str] = []
        sums: list[float] = []
        for case in cases:
            metrics = self._results[trial, case.name]
            broken += [f"{case.name}: {text}" for text in self._breaks(metrics)]
            if metrics.get("ended") == FINISHED:
                sums.append(sum(w * self._relative(name, metrics, case) for name, w in self.space.objective.items()))
        means = {
            name: statistics.fmean(float(self._results[trial, c.name][name]) for c in cases)
            for name in self.space.objective
            if all(_is_number(self._results[trial, c.name].get(name)) for c in cases)
        }
        objective = statistics.fmean(sums) if sums and not broken else math.inf
        return Ranked(trial, self.trials[trial], len(cases), objective, tuple(broken), means)

    def _breaks(self, metrics: Metrics) -> list[str]:
        if metrics.get("ended") != FINISHED:
            return [f"ended {metrics.get('ended')}"]
        out = []
        for name, bound in self.space.constraints.items():
            value = metrics.get(name)
            if value is None or not _is_number(value):
                out.append(f"{name} is unknown")
            elif not bound.min <= value <= bound.max:
                out.append(f"{name} = {value:.4g}")
        return out

    def _relative(self, name: str, metrics: Metrics, case: Case) -> float:
        """Return a metric divided by its value under the defaults; by the median of all finished trials where those failed."""
        default = self._results[0, case.name]
        if default.get("ended") == FINISHED and _is_number(default.get(name)):
            reference = float(default[name])
        else:
            finished = [m for (_, c), m in sorted(self._results.items()) if c == case.name]
            values = [float(m[name]) for m in finished if m.get("ended") == FINISHED and _is_number(m.get(name))]
            reference = statistics.median(values)
        return float(metrics[name]) / reference if reference else 1.0

    def _check_names(self, metrics: Metrics) -> None:
        if metrics.get("ended") != FINISHED:
            return
        for name in (*self.space.objective, *self.space.constraints):
            if name not in metrics:
                numbers = ", ".join(sorted(k for k, v in metrics.items() if _is_number(v)))
                raise BadInputError(f"the study weighs {name!r}, but a run tells only {numbers}")
        for name in self.space.objective:
            if not _is_number(metrics[name]):
                raise BadInputError(f"the study weighs {name!r}, which is {metrics[name]!r} in a finished run")

    def _cases_done(self, trial: int) -> int:
        names = [case.name for case in self.space.cases()]
        return next((k for k, name in enumerate(names) if (trial, name) not in self._results), len(names))


def ranking_lines(ranking: Iterable[Ranked]) -> Iterable[str]:
    """Yield one JSON line per trial; an infinite objective becomes null."""
    for ranked in ranking:
        record = dataclasses.asdict(ranked)
        if not math.isfinite(ranked.objective):
            record["objective"] = None
        yield json.dumps(record)


def write_ranking(path: Path, ranking: Iterable[Ranked]) -> None:
    """Write the ranking as JSON lines, whole or not at all."""
    write_whole(path, "".join(line + "\n" for line in ranking_lines(ranking)))


def write_best(path: Path, profile: Mapping[str, Any], heading: str) -> None:
    """Save a profile for `ambler demo --profile`; `heading` says in one line where it comes from."""
    import yaml

    write_whole(path, f"# {heading}\n" + yaml.safe_dump(as_values(profile), sort_keys=True, allow_unicode=True))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
