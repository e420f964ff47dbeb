"""Plants each fault into a copy of the source and runs the tests that must notice: `python -m tests.mutation [--only TEXT] [--json FILE]`."""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.evaluation.results import processor_seconds, write_results
from ambler.kernels.jit import cache_folder
from tests.mutation.faults import FAULTS
from tests.mutation.planted import PACKAGE, REPOSITORY, PlantedFault

LIMIT = (
    60.0  # seconds of a processor within which a test must notice: what it takes on a machine that does nothing else
)
MOST, PATIENCE = (
    2.0 * LIMIT,
    20.0 * LIMIT,
)  # seconds of the processor and of the wall after which the tests of a fault are ended
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+::\S+)", re.MULTILINE)
KERNELS = REPOSITORY / "src" / PACKAGE / "kernels"
IMPORTED = re.compile(r"^from ambler\.kernels\.(\w+) import", re.MULTILINE)
TESTS_FAILED = 1  # pytest's exit code; a fault that only breaks the collection (2) proves nothing


@dataclass(frozen=True, slots=True)
class Notice:
    """What became of one fault: the first test that failed (None: nobody noticed), and the seconds of the processor that it took."""

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
        begun = processor_seconds()
        with self._planted(fault), tempfile.TemporaryDirectory() as name:
            cache = Path(name) if fault.room == "kernels" else None
            if cache is not None:
                link_compiled(cache, besides=reached_by(Path(fault.file).stem))
            code, output = self.run(fault.tests, cache=cache, is_limited=True)
        found = FAILED.search(output) if code == TESTS_FAILED else None
        return Notice(fault, found.group(1) if found else None, processor_seconds() - begun)

    def run(self, tests: Sequence[str], *, cache: Path | None = None, is_limited: bool = False) -> tuple[int, str]:
        """Run tests against the copy, with the compiled kernels of a cache (default: the usual ones); returns pytest's exit code (negative: it took too long) and
        what it printed."""
        options = ("-x", "-rfE", "--tb=no", "--hypothesis-profile=unshrunk", "-m", "not slow")
        command = [sys.executable, "-m", "pytest", *options, *tests]
        environment = dict(os.environ, PYTHONPATH=str(self._source), MPLBACKEND="Agg", OMP_NUM_THREADS="1")
        environment["NUMBA_CACHE_DIR"] = str(cache or cache_folder())
        try:
            done = subprocess.run(
                command,
                cwd=REPOSITORY,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=PATIENCE if is_limited else None,
                preexec_fn=_limit_processor if is_limited else None,
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


def _limit_processor() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (int(MOST), int(MOST) + 1))


def reached_by(kernel: str) -> set[str]:
    """Return the names of a kernel's file and of those that import it, directly or through others: what has to be compiled again when it changes (Numba would not do
    so for callers in other files)."""
    imports = {path.stem: IMPORTED.findall(path.read_text(encoding="utf-8")) for path in KERNELS.glob("*.py")}
    reached, found = set[str](), {kernel}
    while found != reached:
        reached = set(found)
        found |= {name for name, imported in imports.items() if reached.intersection(imported)}
    return reached


def link_compiled(cache: Path, besides: Set[str]) -> None:
    """Let a cache have the usual one's compiled kernels but those of some files."""
    for path in cache_folder().glob("*/*.nb?"):
        if path.name.split(".", 1)[0] not in besides:
            place = cache / path.parent.name
            place.mkdir(exist_ok=True)
            (place / path.name).symlink_to(path)


def results_of(notices: Sequence[Notice]) -> dict[str, Any]:
    """Return the flat fields of a run; seconds are those of a processor."""
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
        print(f"{len(tests)} groups of tests pass without a fault: {processor_seconds():.0f} s", flush=True)
        for number, fault in enumerate(faults, 1):
            notice = workshop.notice(fault)
            notices.append(notice)
            who = notice.test or "NOBODY NOTICED"
            late = "" if notice.seconds < LIMIT else " TOO SLOW"
            print(f"{number:3d} {notice.seconds:5.1f} s{late}  {fault.file}: {fault.name}\n{'':13}{who}", flush=True)
    noticed = sum(n.test is not None for n in notices)
    in_time = sum(n.test is not None and n.seconds < LIMIT for n in notices)
    print(f"{noticed} of {len(notices)} faults noticed, {in_time} of them within {LIMIT:.0f} s of a processor")
    if chosen.json is not None:
        words = " ".join(sys.argv[1:] if arguments is None else arguments)
        fields = results_of(notices)
        write_results(chosen.json, f"python -m tests.mutation {words}", None, time.monotonic() - begun, fields)
    return 0 if in_time == len(notices) else 1


if __name__ == "__main__":
    sys.exit(main())
