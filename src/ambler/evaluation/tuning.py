"""A tuning study: runs trials over cases in a pool, keeps every result in a folder, and ranks. Killed and restarted it goes on.

Every finished run is one file of one JSON line, written beside and renamed, so that a result is whole or absent. Which trials go on to
more cases follows from the results alone: an interrupted study ends with the same ranking as one that was not.
"""

from __future__ import annotations

import dataclasses
import json
import math
import statistics
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.core.errors import BadInputError
from ambler.evaluation.tuning_space import Case, Choice, TuningSpace
from ambler.settings.profiles import as_values
from ambler.wire.atomic_file import write_whole

Metrics = dict[str, Any]
Evaluate = Callable[[dict[str, Any], Case, str], Metrics]
FINISHED = "finished"
_GROWING = "trials"


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


class TuningStudy:
    """A study in a folder. `evaluate(profile, case, label)` makes the metrics of one run; it is called from several threads."""

    def __init__(self, space: TuningSpace, folder: Path) -> None:
        self.space = space
        self.folder = folder
        self.trials = space.sampled()
        self._results: dict[tuple[int, str], Metrics] = {}
        self._open()

    @property
    def done(self) -> int:
        """How many results there are."""
        return len(self._results)

    def run(self, evaluate: Evaluate, processes: int, on_result: Callable[[int, int, str], None]) -> list[Ranked]:
        """Run what is missing and return the ranking. `on_result(done, of, text)` hears of every new result."""
        cases = self.space.cases()
        going = list(range(len(self.trials)))
        planned = self._planned()
        for rung, count in enumerate(self.space.rungs()):
            wanted = [(t, case) for case in cases[:count] for t in going]
            missing = [(t, case) for t, case in wanted if (t, case.name) not in self._results]
            self._run_all(missing, evaluate, processes, lambda text: on_result(len(self._results), planned, text))
            if rung + 1 < len(self.space.rungs()):
                keep = math.ceil(len(going) / self.space.halving)
                best = [r.trial for r in self._ranked(going, count)][:keep]
                going = sorted({0, *best})
        return self.ranking()

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

    def _run_all(
        self, jobs: list[tuple[int, Case]], evaluate: Evaluate, processes: int, say: Callable[[str], None]
    ) -> None:
        with ThreadPoolExecutor(processes) as pool:
            futures = {
                pool.submit(evaluate, self.space.profile(self.trials[t]), case, self._label(t, case)): (t, case)
                for t, case in jobs
            }
            try:
                for future in as_completed(futures):
                    trial, case = futures[future]
                    metrics = future.result()
                    self._check_names(metrics)
                    self._keep(trial, case, metrics)
                    say(f"{self._label(trial, case)}: {metrics.get('ended')}")
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise

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

    def _planned(self) -> int:
        """How many results there will be when nothing fails to go on."""
        going, total, before = len(self.trials), 0, 0
        for count in self.space.rungs():
            total, before = total + going * (count - before), count
            going = math.ceil(going / self.space.halving)
        return total

    def _cases_done(self, trial: int) -> int:
        names = [case.name for case in self.space.cases()]
        return next((k for k, name in enumerate(names) if (trial, name) not in self._results), len(names))

    # The folder

    def _label(self, trial: int, case: Case) -> str:
        return f"{trial:04d}-{case.name}"

    def _open(self) -> None:
        """Make the folder, or check that it holds this study and load its results."""
        own = as_values(self.space)
        kept = self.folder / "study.json"
        if kept.exists():
            there = json.loads(kept.read_text(encoding="utf-8"))
            changed = sorted(k for k in own if k != _GROWING and json.loads(json.dumps(own[k])) != there.get(k))
            if changed:
                raise BadInputError(
                    f"{self.folder} holds another study: {', '.join(changed)} differ; choose another --out"
                )
        (self.folder / "results").mkdir(parents=True, exist_ok=True)
        write_whole(kept, json.dumps(own, indent=2) + "\n")
        for file in sorted((self.folder / "results").glob("*.jsonl")):
            record = json.loads(file.read_text(encoding="utf-8"))
            if record["trial"] < len(self.trials):
                self._results[record["trial"], record["case"]] = record["metrics"]

    def _keep(self, trial: int, case: Case, metrics: Metrics) -> None:
        record = {"trial": trial, "case": case.name, "values": self.trials[trial], "metrics": metrics}
        write_whole(self.folder / "results" / f"{self._label(trial, case)}.jsonl", json.dumps(record) + "\n")
        self._results[trial, case.name] = metrics


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
