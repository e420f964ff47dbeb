"""The peak of a process's memory is its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ambler.evaluation.process_memory import STATUS, peak_memory_mb

HOLD = "import numpy; held = numpy.ones({numbers}); del held"
ASK = "from ambler.evaluation.process_memory import peak_memory_mb; print(peak_memory_mb())"


def told_by_another(*, numbers: int) -> float:
    """Return the peak of a process that has held so many floating point numbers of 8 bytes, MB."""
    code = f"{HOLD.format(numbers=numbers)}; {ASK}"
    return float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


def test_what_was_held_once_counts() -> None:
    assert told_by_another(numbers=50_000_000) - told_by_another(numbers=0) == pytest.approx(400.0, abs=20.0)


@pytest.mark.skipif(not STATUS.exists(), reason="only Linux tells a process's own peak")
def test_what_the_process_that_started_it_holds_does_not_count() -> None:
    held = np.ones(75_000_000)
    assert told_by_another(numbers=0) < 0.5 * held.nbytes * 1e-6 < peak_memory_mb()


def test_without_that_file_something_is_told(tmp_path: Path) -> None:
    assert peak_memory_mb(tmp_path / "none") > 10.0
