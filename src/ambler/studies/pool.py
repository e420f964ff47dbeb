"""Where the cases of a study run: processes on this machine, or the workers of a Dask cluster. The results are the same.

Each process works off one case after the other; one that dies takes its case with it and nothing else.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ambler.core.errors import BadInputError
from ambler.evaluation.results import processor_seconds

Result = dict[str, Any]
OnResult = Callable[[int, Result], None]
PATIENCE = 20.0  # seconds that a process gets to end its run in order
RETRIES = 3  # of a case whose cluster worker was lost
CASE_WALL, CASE_CPU = "case_wall_seconds", "case_cpu_seconds"  # in every result of a pool: what the case took


@dataclass(frozen=True, slots=True)
class Job:
    """A function of a module, its case, and the folder that it may use."""

    function: Callable[[Any, Path], Result]
    case: Any
    folder: Path


def timed(function: Callable[[Any, Path], Result], case: Any, folder: Path) -> Result:
    """Run a case; its result tells also the seconds of the wall and of processors (of this process and its ended children) that it took."""
    wall, cpu = time.perf_counter(), processor_seconds()
    result = function(case, folder)
    return {**result, CASE_WALL: time.perf_counter() - wall, CASE_CPU: processor_seconds() - cpu}


class Pool(Protocol):
    """Runs jobs somewhere."""

    def run(self, jobs: Sequence[Job], on_result: OnResult) -> None:
        """Run all jobs and call back with the number of each and its result, in the order in which they end, in the caller's thread."""
        ...


class CaseProcess:
    """A process that runs jobs, one after the other; what they print goes to `case.log` in their folders."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "ambler.studies.worker"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
        )

    def run(self, job: Job) -> Result:
        """Run a job and return its result; `ended` "crashed" when the process died."""
        begin, jobs, results = time.perf_counter(), self._process.stdin, self._process.stdout
        assert jobs is not None
        assert results is not None
        try:
            pickle.dump((job.function, job.case, job.folder), jobs)
            jobs.flush()
            result: Result = pickle.load(results)
        except (EOFError, OSError, pickle.UnpicklingError):
            code = self._process.wait()
            cause = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            seconds = time.perf_counter() - begin
            return {"ended": "crashed", "why": f"its process ended: {cause}", CASE_WALL: seconds}
        return result

    @property
    def is_alive(self) -> bool:
        """Whether it can run another job."""
        return self._process.poll() is None

    def close(self) -> None:
        """End it; a run under way is ended in order, if it does that soon."""
        if self.is_alive:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGTERM)
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


class ThisProcess:
    """Runs jobs one after the other where it is called, and lets every error pass: for a debugger, and for tests."""

    def run(self, jobs: Sequence[Job], on_result: OnResult) -> None:
        """See Pool."""
        for number, job in enumerate(jobs):
            job.folder.mkdir(parents=True, exist_ok=True)
            on_result(number, timed(job.function, job.case, job.folder))


class LocalPool:
    """`processes` processes on this machine. A signal ends the study: the jobs under way are given up."""

    def __init__(self, processes: int = 1) -> None:
        if processes < 1:
            raise BadInputError(f"--processes {processes}: needs at least 1")
        self._count = processes

    def run(self, jobs: Sequence[Job], on_result: OnResult) -> None:
        """See Pool."""
        waiting, done = queue.SimpleQueue[tuple[int, Job]](), queue.SimpleQueue[tuple[int, Result]]()
        for numbered in enumerate(jobs):
            waiting.put(numbered)
        is_over = threading.Event()
        threads = [
            threading.Thread(target=_work_off, args=(waiting, done, is_over), daemon=True)
            for _ in range(min(self._count, len(jobs)))
        ]
        for thread in threads:
            thread.start()
        try:
            for _ in jobs:
                on_result(*_next(done))
        finally:
            is_over.set()
            for thread in threads:
                thread.join()


def _next(done: queue.SimpleQueue[tuple[int, Result]]) -> tuple[int, Result]:
    while True:  # short waits: a signal is only heard between them
        with suppress(queue.Empty):
            return done.get(timeout=0.5)


def _work_off(
    waiting: queue.SimpleQueue[tuple[int, Job]], done: queue.SimpleQueue[tuple[int, Result]], is_over: threading.Event
) -> None:
    """Run waiting jobs in a process, and in a new one after it died, until there are none or all is over."""
    process: CaseProcess | None = None
    try:
        while not is_over.is_set():
            number, job = waiting.get_nowait()
            if process is not None and not process.is_alive:
                process.close()
                process = None
            process = process or CaseProcess()
            watcher = _ended_when(is_over, process)
            done.put((number, process.run(job)))
            watcher.set()
    except queue.Empty:
        pass
    finally:
        if process is not None:
            process.close()


def _ended_when(is_over: threading.Event, process: CaseProcess) -> threading.Event:
    """End a process as soon as all is over, unless the returned event was set before."""
    is_done = threading.Event()

    def watch() -> None:
        while not is_done.is_set():
            if is_over.wait(0.2):
                process.close()
                return

    threading.Thread(target=watch, daemon=True).start()
    return is_done


class ClusterPool:
    """The workers of a Dask cluster, for one study; `address` is that of its scheduler. A case whose worker is lost is run on another."""

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client  # type: ignore[import-untyped,unused-ignore]
        except ModuleNotFoundError as error:
            raise BadInputError("--cluster needs Dask (the extra `cluster`)") from error
        try:
            self._client: Any = Client(address, timeout=10.0)  # type: ignore[no-untyped-call,unused-ignore]
        except (OSError, ValueError) as error:
            raise BadInputError(f"--cluster {address}: no scheduler answers there") from error

    def run(self, jobs: Sequence[Job], on_result: OnResult) -> None:
        """See Pool."""
        from distributed import as_completed

        futures = [self._client.submit(run_apart, job, pure=False, retries=RETRIES) for job in jobs]
        numbers = {future.key: k for k, future in enumerate(futures)}
        try:
            for future in as_completed(futures):  # type: ignore[no-untyped-call,unused-ignore]
                result = future.result() if future.status == "finished" else _lost(future)
                on_result(numbers[future.key], result)
        finally:
            self._client.cancel(futures)
            self._client.close()


def _lost(future: Any) -> Result:
    return {"ended": "crashed", "why": f"its worker was lost: {future.exception()}"}


def run_apart(job: Job) -> Result:
    """Run one job in a process of its own."""
    process = CaseProcess()
    try:
        return process.run(job)
    finally:
        process.close()
