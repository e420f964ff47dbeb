"""2-D SLAM on variants of public logs: how many of those that should not matter end as well as the log itself."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import recorded_config
from ambler.core.errors import BadInputError
from ambler.evaluation.proportions import wilson_interval
from ambler.evaluation.relations import load_relations, relation_errors
from ambler.evaluation.revisits import revisit_errors
from ambler.evaluation.trajectory import trajectory_error, truth_at
from ambler.recordings.lag import with_later_odometry
from ambler.recordings.scan_recording import open_recording
from ambler.slam2d.lag_search import find_lag
from ambler.slam2d.offline import run_offline
from ambler.studies.log_variants import F64, I64, NOTHING_DRAWN, poses_of_log, varied
from ambler.studies.study import Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.wire.tum import read_tum

RELATIONS_BAR, ATE_BAR = 0.1, 0.5  # metres: a variant that is no worse is good, whatever the log itself reaches
TIMES = 2.0  # what the log itself reaches, a good variant may be off
OPEN_FROM = 1.0  # metres that a revisit or relation is off where a loop is open


@dataclass(frozen=True, slots=True)
class LogCase:
    """One variant of a log; `reference` is a .relations or a .tum file."""

    log: str
    reference: str
    kind: str
    seed: int
    is_keyframed: bool = False
    settings: StudySettings = DEFAULTS

    @property
    def place(self) -> str:
        """The log's name."""
        name = Path(self.log).name.split(".")[0]
        return f"{name}-keyframes" if self.is_keyframed else name

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.place}-{self.kind}-{self.seed}"


def cases_of(
    logs: Sequence[tuple[str, str]],
    kinds: Sequence[str],
    seeds: Sequence[int],
    *,
    is_keyframed: bool = False,
    settings: StudySettings = DEFAULTS,
) -> list[LogCase]:
    """Return every kind of variant of every log with each seed, those of which nothing is drawn with the first one only."""
    cases = []
    for log, reference in logs:
        for kind in kinds:
            draws = seeds if is_keyframed or kind not in NOTHING_DRAWN else seeds[:1]
            cases += [LogCase(log, reference, kind, seed, is_keyframed, settings) for seed in draws]
    return cases


def reference_of(log: Path) -> Path:
    """Return the relations or the poses that lie beside a log under its name; raises BadInputError."""
    for suffix in (".relations", ".tum"):
        path = log.with_name(log.name.split(".")[0] + suffix)
        if path.is_file():
            return path
    raise BadInputError(f"{log}: neither relations nor poses lie beside it ({log.name.split('.')[0]}.relations, .tum)")


def log_variants_study(cases: Sequence[LogCase]) -> Study[LogCase]:
    """Return the study of these variants."""
    return Study("variants", cases, run_case, _line)


def run_case(case: LogCase, folder: Path) -> dict[str, Any]:
    """Read, vary, map, compare."""
    recording = open_recording(Path(case.log))
    log = list(recording.scans)
    variant = varied(log, case.kind, case.seed, is_keyframed=case.is_keyframed)
    config = recorded_config(case.settings.profile).slam2d.slam
    cpu = time.process_time()
    lag = find_lag(variant.scans)
    scans = variant.scans if lag is None else with_later_odometry(variant.scans, lag.seconds)
    result = run_offline(scans, config)
    cpu_seconds = time.process_time() - cpu
    rows, poses = poses_of_log(log, variant, result.poses)
    return {
        "scans": len(variant.scans),
        "slam_cpu_seconds": cpu_seconds,
        "closures": result.loop_closures,
        "lag_s": 0.0 if lag is None else lag.seconds,
        "lag_drawn_s": variant.lag,
        **judged(Path(case.reference), np.array(recording.stamps)[rows], poses),
    }


def judged(reference: Path, stamps: F64, poses: F64) -> dict[str, Any]:
    """Return `error_m`, the mean error of the relations or the root mean square of aligned positions; `bar_m`; and `open_ratio`, the share of relations or
    revisits that are off by a metre or more."""
    if reference.suffix == ".relations":
        errors = relation_errors(load_relations(reference), stamps.tolist(), poses).translation
        return {
            "error_m": float(errors.mean()),
            "bar_m": RELATIONS_BAR,
            "open_ratio": float(np.mean(errors > OPEN_FROM)),
        }
    truth_stamps, truth = read_tum(reference)
    ns, truth_ns = (_nanoseconds(s) for s in (stamps, np.asarray(truth_stamps)))
    order = np.argsort(ns, kind="stable")
    ns, poses = ns[order], poses[order]
    gap = 2.0 * float(np.median(np.diff(truth_stamps)))
    is_known, there = truth_at(ns, truth_ns, truth, gap)
    off = revisit_errors(poses[is_known], there[is_known]).errors
    return {
        "error_m": trajectory_error(ns, poses, truth_ns, truth, max_gap=gap).ate_rms_m,
        "bar_m": ATE_BAR,
        "open_ratio": float(np.mean(off > OPEN_FROM)) if len(off) else 0.0,
    }


def is_good(result: dict[str, Any], unvaried_m: float) -> bool:
    """Say whether a variant ends no worse than the bar, or than twice what the log itself reaches where that is no worse than the bar."""
    bar = result.get("bar_m", 0.0)
    return bool(result.get("error_m", math.inf) <= max(bar, TIMES * min(unvaried_m, bar)))


def summarize(results: Sequence[dict[str, Any]], places: Sequence[str]) -> dict[str, Any]:
    """Return flat fields: how many variants are good of all, of each place and of each kind; medians and worst values; each variant's error."""
    unvaried = {p: r.get("error_m", 0.0) for p, r in zip(places, results, strict=True) if r["kind"] == "as_recorded"}
    good = [is_good(r, unvaried.get(p, 0.0)) for p, r in zip(places, results, strict=True)]
    low, high = wilson_interval(sum(good), len(good))
    fields: dict[str, Any] = {
        "runs": len(good),
        "variants_good": sum(good),
        "variants_good_ratio": sum(good) / len(good),
        "variants_good_ratio_low_95": low,
        "variants_good_ratio_high_95": high,
        "variants_open": sum(r.get("open_ratio", 1.0) > 0.0 for r in results),
    }
    for names in (places, [r["kind"] for r in results]):
        for name in dict.fromkeys(names):
            which = [k for k, other in enumerate(names) if other == name]
            errors = [results[k].get("error_m", float("inf")) for k in which]
            fields |= {
                f"{name}.runs": len(which),
                f"{name}.good": sum(good[k] for k in which),
                f"{name}.error_median_m": statistics.median(errors),
                f"{name}.error_worst_m": max(errors),
            }
    return fields | _lag_errors(results, places) | {f"{r['label']}.error_m": r.get("error_m") for r in results}


def _lag_errors(results: Sequence[dict[str, Any]], places: Sequence[str]) -> dict[str, Any]:
    """Return by how much the lags of late scans were found beside those that were drawn, and that of the log itself, seconds."""
    own = {p: r.get("lag_s", math.inf) for p, r in zip(places, results, strict=True) if r["kind"] == "as_recorded"}
    errors = [
        abs(r.get("lag_s", math.inf) - r.get("lag_drawn_s", 0.0) - own[p])
        for p, r in zip(places, results, strict=True)
        if r["kind"] == "late" and p in own
    ]
    return (
        {"late.lag_error_median_s": statistics.median(errors), "late.lag_error_worst_s": max(errors)} if errors else {}
    )


def _nanoseconds(seconds: F64) -> I64:
    return np.asarray(np.rint(seconds * 1e9), np.int64)


def _line(result: dict[str, Any]) -> str:
    rate = result["scans"] / result["slam_cpu_seconds"]
    return f"{result['error_m']:.3f} m, {100 * result['open_ratio']:.0f} % of revisits open, {result['closures']} closures, {rate:.0f} scans/s"
