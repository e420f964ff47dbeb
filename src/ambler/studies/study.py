"""One engine for all campaigns: cases run on a pool of processes, each result is kept at once, and an interrupted study goes on where it ended.

A result is known by what it depends on: the source of the whole package, what the case says, and the content of the files that it names.
So a study resumes across interruptions and across commits that change no code, a result of other code is never taken, and studies that
share a folder do not meet.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import ambler
from ambler.core.errors import BadInputError
from ambler.studies.pool import CASE_CPU, CASE_WALL, Job, Pool
from ambler.wire.atomic_file import write_whole

Result = dict[str, Any]
CRASHED = "crashed"
KEY_LENGTH = 12
SEEDS_BELOW = 1_000_000


class Case(Protocol):
    """What one run of a study depends on: a frozen dataclass of plain values, paths as text, and other such dataclasses."""

    @property
    def label(self) -> str:
        """A name for files and people, another one for each case of a study."""
        ...


C = TypeVar("C", bound=Case)


@dataclass(frozen=True, slots=True)
class Study(Generic[C]):
    """`run_case(case, folder)` is a function of a module; it may use the folder and returns plain values. `line` tells people of a result."""

    name: str
    cases: Sequence[C]
    run_case: Callable[[C, Path], Result]
    line: Callable[[Result], str]


@dataclass(slots=True)
class Spent:
    """Seconds that the cases of a campaign took, summed up: of the wall (as if one had run after the other), and of processors. A case whose result was kept counts with what it took
    when it was run, so that a campaign that was resumed tells the same as one that was not interrupted."""

    wall: float = 0.0
    cpu: float = 0.0

    def take(self, result: Result) -> Result:
        """Count a case; returns its result without what it took."""
        left = dict(result)
        self.wall += left.pop(CASE_WALL, 0.0)
        self.cpu += left.pop(CASE_CPU, 0.0)
        return left


def conduct(
    study: Study[C],
    out: Path,
    pool: Pool,
    *,
    is_fresh: bool = False,
    tell: Callable[[str], None] = print,
    spent: Spent | None = None,
) -> list[Result]:
    """Return one result per case, in their order, each with `label` and the plain values of its case; `spent` counts what all of them took.

    Those that `out` holds are taken (unless `is_fresh`), the others are run. A case whose process died, or that raised, has `ended`
    "crashed" and `why`; it is not kept. Raises BadInputError for labels that are not unique.
    """
    spent = spent or Spent()
    labels = [case.label for case in study.cases]
    if len(set(labels)) < len(labels):
        raise BadInputError(f"study {study.name}: several cases are called {_repeated(labels)}")
    folders = [out / study.name / f"{case.label}-{key_of(study, case)}" for case in study.cases]
    results: list[Result | None] = [None if is_fresh else _kept(folder) for folder in folders]
    known = sum(result is not None for result in results)
    if known:
        tell(f"{known} of {len(labels)} results are in {out / study.name} already")
    missing = [k for k, result in enumerate(results) if result is None]
    jobs = [Job(study.run_case, study.cases[k], folders[k]) for k in missing]

    def take(number: int, result: Result) -> None:
        k = missing[number]
        results[k] = whole = {**plain_values(study.cases[k]), **result, "label": labels[k]}
        if whole.get("ended") != CRASHED:
            folders[k].mkdir(parents=True, exist_ok=True)
            write_whole(folders[k] / "result.json", json.dumps(whole))
        tell(f"[{sum(r is not None for r in results)} of {len(labels)}] {labels[k]}: {_line(study, whole)}")

    pool.run(jobs, take)
    return [spent.take(result) for result in results if result is not None]


def key_of(study: Study[C], case: C) -> str:
    """Return what a result is known by: a hash of everything it depends on."""
    function = f"{study.run_case.__module__}.{study.run_case.__qualname__}"
    said = json.dumps([study.name, function, source_digest(), _said(case)], sort_keys=True)
    return hashlib.sha256(said.encode()).hexdigest()[:KEY_LENGTH]


@functools.cache
def source_digest() -> str:
    """Return a hash of everything in this package, names and contents."""
    root = Path(ambler.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def plain_values(case: Any) -> Result:
    """Return those values of a case that a table can hold, those of the records in it too: what a case that crashed is still known by. Of two
    values with one name the outer one counts."""
    values = {field.name: getattr(case, field.name) for field in dataclasses.fields(case)}
    plain: Result = {}
    for value in values.values():
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            plain |= plain_values(value)
    return plain | {name: value for name, value in values.items() if isinstance(value, str | int | float | None)}


def seeds_of(text: str, runs: int, file: Path) -> tuple[int, ...]:
    """Return the seeds of a study: `runs` from a first one on, those that are listed with commas, or with "draw" such as nobody chose, drawn once and kept
    in `file`.

    Raises BadInputError.
    """
    if runs < 1:
        raise BadInputError(f"--runs {runs}: needs at least 1")
    if text != "draw":
        listed = text.split(",")
        if not all(word.isdecimal() for word in listed):
            raise BadInputError(f"--seed {text}: whole numbers from 0 on with commas, or draw")
        if len(listed) == 1:
            return tuple(range(int(text), int(text) + runs))
        if len(listed) < runs:
            raise BadInputError(f"--seed {text}: {len(listed)} seeds for {runs} runs")
        return tuple(int(word) for word in listed[:runs])
    drawn: list[int] = json.loads(file.read_text()) if file.exists() else []
    while len(drawn) < runs:
        seed = secrets.randbelow(SEEDS_BELOW)
        drawn += [seed] if seed not in drawn else []
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, json.dumps(drawn))
    return tuple(drawn[:runs])


def _kept(folder: Path) -> Result | None:
    file = folder / "result.json"
    if not file.exists():
        return None
    result: Result = json.loads(file.read_text())
    return result


def _line(study: Study[C], result: Result) -> str:
    return f"crashed: {result.get('why')}" if result.get("ended") == CRASHED else study.line(result)


def _said(value: Any) -> Any:
    """Return a value as JSON can say it; a text that names a file, with a hash of the file."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: _said(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"": type(value).__name__, **fields}
    if isinstance(value, Mapping):
        return {str(name): _said(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_said(part) for part in value]
    if isinstance(value, str | Path):
        return _said_text(str(value))
    return value if isinstance(value, bool | int | float | None) else repr(value)


def _said_text(text: str) -> Any:
    path = Path(text)
    is_file = 0 < len(text) < 4096 and "\n" not in text and path.is_file()
    return [text, hashlib.sha256(path.read_bytes()).hexdigest()] if is_file else text


def _repeated(labels: Sequence[str]) -> str:
    return next(label for k, label in enumerate(labels) if label in labels[:k])
