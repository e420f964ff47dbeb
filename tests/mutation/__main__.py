"""Plants each fault into a copy of the source and runs the tests that must notice: `python -m tests.mutation [--only TEXT] [--json FILE]`."""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.evaluation.results import write_results
from tests.mutation.faults import FAULTS
from tests.mutation.planted import PACKAGE, REPOSITORY, PlantedFault

LIMIT = 60.0  # seconds within which a test must notice
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+::\S+)", re.MULTILINE)
TESTS_FAILED = 1  # pytest's exit code; a fault that only breaks the collection (2) proves nothing


@dataclass(frozen=True, slots=True)
class Notice:
    """What became of one fault: the first test that failed (None: nobody noticed), and seconds."""

    fault: PlantedFault
    test: str | None
    seconds: float


class Workshop:
    """A copy of the source, into which one fault at a time is planted.

    Its place is always the same: the compiled kernels of earlier runs are found by it.
    """

    def __init__(self) -> None:
        key = zlib.crc32(str(REPOSITORY).encode())
        self._root = Path(tempfile.gettempdir()) / f"ambler_mutation_{os.getuid()}_{key:08x}"
        self._source = self._root / "src"

    def __enter__(self) -> Workshop:
        shutil.rmtree(self._root, ignore_errors=True)
        shutil.copytree(
            REPOSITORY / "src", self._source, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info", "*.pyc")
        )
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._root, ignore_errors=True)

    def notice(self, fault: PlantedFault) -> Notice:
        """Plant a fault, run its tests until one fails, and take it out again."""
        begun = time.monotonic()
        with self._planted(fault):
            code, output = self.run(fault.tests, has_other_kernels=fault.room == "kernels", limit=2.0 * LIMIT)
        found = FAILED.search(output) if code == TESTS_FAILED else None
        return Notice(fault, found.group(1) if found else None, time.monotonic() - begun)

    def run(
        self, tests: Sequence[str], *, has_other_kernels: bool = False, limit: float | None = None
    ) -> tuple[int, str]:
        """Run tests against the copy; returns pytest's exit code (-1: not within the limit) and what it printed.

        Changed kernels get a cache of their own, else compiled callers in other files would outlive the fault.
        """
        options = ("-x", "-rfE", "--tb=no", "--hypothesis-profile=unshrunk", "-m", "not slow")
        command = [sys.executable, "-m", "pytest", *options, *tests]
        environment = dict(os.environ, PYTHONPATH=str(self._source), MPLBACKEND="Agg", OMP_NUM_THREADS="1")
        with tempfile.TemporaryDirectory() as cache:
            if has_other_kernels:
                environment["NUMBA_CACHE_DIR"] = cache
            try:
                done = subprocess.run(
                    command,
                    cwd=REPOSITORY,
                    env=environment,
                    capture_output=True,
                    text=True,
                    check=False,
                    timeout=limit,
                )
            except subprocess.TimeoutExpired:
                return -1, ""
        return done.returncode, done.stdout

    @contextmanager
    def _planted(self, fault: PlantedFault) -> Iterator[None]:
        path = self._source / PACKAGE / fault.file
        original = path.read_text(encoding="utf-8")
        times = path.stat()
        compiled = Path(importlib.util.cache_from_source(str(path)))
        try:
            path.write_text(fault.planted(original), encoding="utf-8")
            compiled.unlink(missing_ok=True)
            yield
        finally:
            path.write_text(original, encoding="utf-8")
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            compiled.unlink(missing_ok=True)


def results_of(notices: Sequence[Notice]) -> dict[str, Any]:
    """Return the flat fields of a run."""
    fields: dict[str, Any] = {
        "faults": len(notices),
        "noticed": sum(n.test is not None for n in notices),
        "slowest_seconds": round(max(n.seconds for n in notices), 1),
    }
    for room in sorted({n.fault.room for n in notices}):
        fields[f"faults_{room}"] = sum(n.fault.room == room for n in notices)
    for number, n in enumerate(notices, 1):
        fields[f"fault_{number:03d}"] = n.fault.name
        fields[f"fault_{number:03d}_noticed_by"] = n.test
        fields[f"fault_{number:03d}_s"] = round(n.seconds, 1)
    return fields


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the faults; returns 0 when every one was noticed in time, 1 otherwise, 2 when no fault was chosen."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--only", default="", metavar="TEXT", help="only faults with this text in their name or file")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result")
    chosen = parser.parse_args(arguments)
    begun = time.monotonic()
    faults = [f for f in FAULTS if chosen.only.lower() in f"{f.name} {f.file}".lower()]
    if not faults:
        print(f"no fault has {chosen.only!r} in its name or file")
        return 2
    notices: list[Notice] = []
    with Workshop() as workshop:
        tests = list(dict.fromkeys(test for fault in faults for test in fault.tests))
        code, output = workshop.run(tests)
        if code != 0:
            print(f"the tests fail without any fault:\n{output}")
            return 1
        print(f"{len(tests)} groups of tests pass without a fault: {time.monotonic() - begun:.0f} s", flush=True)
        for number, fault in enumerate(faults, 1):
            notice = workshop.notice(fault)
            notices.append(notice)
            who = notice.test or "NOBODY NOTICED"
            late = "" if notice.seconds < LIMIT else " TOO SLOW"
            print(f"{number:3d} {notice.seconds:5.1f} s{late}  {fault.file}: {fault.name}\n{'':13}{who}", flush=True)
    noticed = sum(n.test is not None for n in notices)
    in_time = sum(n.test is not None and n.seconds < LIMIT for n in notices)
    print(f"{noticed} of {len(notices)} faults noticed, {in_time} of them within {LIMIT:.0f} s")
    if chosen.json is not None:
        words = " ".join(sys.argv[1:] if arguments is None else arguments)
        fields = results_of(notices)
        write_results(chosen.json, f"python -m tests.mutation {words}", None, time.monotonic() - begun, fields)
    return 0 if in_time == len(notices) else 1


if __name__ == "__main__":
    sys.exit(main())
