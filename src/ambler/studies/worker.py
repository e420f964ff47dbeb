"""The process behind `pool.CaseProcess`: reads jobs from its input, writes results to its output, both pickled.

It ends with its input, and with its parent: nobody would hear of what it does.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from ambler.core.large_memory import give_back_holes, keep_memory_small
from ambler.evaluation.process_memory import forget_peak
from ambler.studies.pool import timed


def main() -> None:
    """Work until the input ends."""
    results = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    keep_memory_small()
    is_warm = False
    while True:
        try:
            function, case, folder = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        _redirect(folder)
        if not is_warm:
            _warm_up()
            is_warm = True
        gc.collect()
        give_back_holes()
        forget_peak()
        _answer(results, timed(partial(_run, function), case, folder))


def _run(function: Any, case: Any, folder: Path) -> dict[str, Any]:
    try:
        result: dict[str, Any] = function(case, folder)
        return result
    except Exception as error:  # noqa: BLE001  (whatever goes wrong in a case counts against it, not against the study)
        traceback.print_exc()
        return {"ended": "crashed", "why": f"{type(error).__name__}: {error}"}
    finally:
        sys.stdout.flush()


def _answer(results: BinaryIO, result: dict[str, Any]) -> None:
    pickle.dump(result, results)
    results.flush()


def _redirect(folder: Path) -> None:
    """Let everything that is printed go to the log of the case."""
    folder.mkdir(parents=True, exist_ok=True)
    log = os.open(folder / "case.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)


def _warm_up() -> None:
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    warm_up(imported_kernel_modules())  # else the first robot would wait for the compiler


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os.killpg(os.getpgid(0), signal.SIGKILL)


if __name__ == "__main__":
    main()
