"""What counts as memory that grows, and the walk that is measured."""

from __future__ import annotations

import mmap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.evaluation.process_memory import memory_mb
from ambler.lio.cloud_file import CloudFile, KeptPoints
from ambler.studies.bench_memory import FLAT_MB, PASSING_MB, MemoryLog, measure_walk


def logged(held: Callable[[float], float], seconds: int = 1800) -> dict[str, float]:
    now = 0.0
    log = MemoryLog(look=lambda: held(now))
    for k in range(10 * seconds + 1):
        now = 0.1 * k
        log.note(now)
    assert len(log.seconds) == seconds // 10 + 1
    return log.fields()


def test_memory_that_settles_is_flat() -> None:
    fields = logged(lambda t: 400.0 + 300.0 * min(1.0, t / 350.0))
    assert (fields["settled_mb"], fields["growth_mb"], fields["passing_mb"]) == (700.0, 0.0, 0.0)
    assert fields["is_met"]


def test_memory_that_grows_slowly_is_told() -> None:
    """100 MB an hour are 30 MB from the middle of the second fifth of half an hour to that of the last."""
    fields = logged(lambda t: 400.0 + 100.0 * t / 3600.0)
    assert fields["growth_mb"] == pytest.approx(30.0, abs=0.5)
    assert fields["settled_mb"] == pytest.approx(415.0, abs=0.5)
    assert not fields["is_met"]


def test_what_passes_counts_when_it_is_much() -> None:
    def held(t: float, much: float) -> float:
        return 400.0 + (much if 900.0 <= t < 915.0 else 0.0)

    little, much = (logged(lambda t, m=m: held(t, m)) for m in (0.9 * PASSING_MB, 1.1 * PASSING_MB))  # type: ignore[misc]
    assert little["growth_mb"] == much["growth_mb"] == 0.0
    assert much["passing_mb"] == pytest.approx(1.1 * PASSING_MB)
    assert little["is_met"]
    assert not much["is_met"]


def test_what_a_submap_leaves_behind_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    calm = measure_walk(150.0, "mid_360", 3)
    assert abs(calm["growth_mb"]) < FLAT_MB
    assert 140.0 < calm["way_m"] < 160.0
    assert calm["start_rms_m"] < 0.15
    assert calm["keyframes"] > 25
    put, left = CloudFile.put, []

    def leak(file: CloudFile, points: NDArray[np.float32]) -> KeptPoints:
        pages = mmap.mmap(-1, 4_000_000)  # new ones: what other tests gave back would hide them
        pages.write(b"1" * len(pages))
        left.append(pages)
        return put(file, points)

    monkeypatch.setattr(CloudFile, "put", leak)
    leaking = measure_walk(150.0, "mid_360", 3)
    assert leaking["growth_mb"] > calm["growth_mb"] + 50.0
    assert not leaking["is_met"]


def test_where_the_system_tells_nothing_there_is_one_clear_error() -> None:
    with pytest.raises(BadInputError, match="told by Linux alone"):
        memory_mb(Path("/nowhere/status"))
