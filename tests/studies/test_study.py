"""One engine for all campaigns: what it keeps, what it runs again, and what it makes of processes that die."""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambler.cli.study_options import with_seeds
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.evaluation.process_memory import peak_memory_mb
from ambler.studies import pool
from ambler.studies import study as engine
from ambler.studies.pool import ClusterPool, LocalPool, ThisProcess
from ambler.studies.study import Spent, Study, conduct, key_of, seeds_of

ORIGIN = SE2()


@dataclass(frozen=True, slots=True)
class Sum:
    """Adds; `how` says what goes wrong."""

    a: int
    b: int
    how: str = ""
    place: SE2 = ORIGIN

    @property
    def label(self) -> str:
        return f"{self.a}-{self.b}"


def add(case: Sum, folder: Path) -> dict[str, Any]:
    """Leave a mark of each run in the folder of the study."""
    marks = folder.parent / "marks.txt"
    with marks.open("a") as file:
        file.write(f"{case.label}\n")
    print("adding")
    if case.how == "raise":
        raise ValueError("too much")
    if case.how == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if case.how == "long":
        time.sleep(60.0)
    return {"ended": "finished", "sum": case.a + case.b}


def study_of(*cases: Sum, name: str = "sums") -> Study[Sum]:
    return Study(name, cases, add, lambda result: f"sum {result['sum']}")


def marks(out: Path, name: str = "sums") -> list[str]:
    return (out / name / "marks.txt").read_text().split()


@pytest.fixture
def told() -> list[str]:
    return []


def test_results_come_in_the_order_of_the_cases_with_what_the_case_says(tmp_path: Path, told: list[str]) -> None:
    cases = [Sum(k, 1) for k in range(5)]
    results = conduct(study_of(*cases), tmp_path, LocalPool(2), tell=told.append)
    assert [(r["a"], r["b"], r["sum"], r["label"]) for r in results] == [(k, 1, k + 1, f"{k}-1") for k in range(5)]
    assert sorted(marks(tmp_path)) == [f"{k}-1" for k in range(5)]
    assert told[-1].startswith("[5 of 5]")
    assert "place" not in results[0], "a table cannot hold it"
    assert results[0]["yaw"] == 0.0, "but what is plain in it"


def hold(case: Sum, folder: Path) -> dict[str, Any]:
    """Hold so many MB for a moment."""
    mb, _ = np.ones((case.a, 125_000)), folder
    return {"held": peak_memory_mb(), "shape": list(mb.shape)}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems keep the peak of a process for ever")
def test_each_case_has_the_memory_of_itself_alone(tmp_path: Path) -> None:
    cases = (Sum(300, 1), Sum(1, 1), Sum(200, 1))
    study = Study("holds", cases, hold, lambda result: "held")
    large, small, middle = (r["held"] for r in conduct(study, tmp_path, LocalPool(1), tell=lambda line: None))
    assert 270.0 < large - small < 330.0
    assert 170.0 < middle - small < 230.0


def test_a_study_goes_on_where_it_ended(tmp_path: Path, told: list[str]) -> None:
    conduct(study_of(Sum(1, 1), Sum(2, 2)), tmp_path, ThisProcess(), tell=told.append)
    results = conduct(study_of(Sum(1, 1), Sum(2, 2), Sum(3, 3)), tmp_path, ThisProcess(), tell=told.append)
    assert [r["sum"] for r in results] == [2, 4, 6]
    assert marks(tmp_path) == ["1-1", "2-2", "3-3"]
    assert any("2 of 3 results" in line for line in told)
    conduct(study_of(Sum(1, 1)), tmp_path, ThisProcess(), is_fresh=True, tell=told.append)
    assert marks(tmp_path)[-1] == "1-1"


class Clock:
    """Stands for the clock of the wall; a case of `add_slowly` takes `a` seconds of it."""

    now = 0.0

    @classmethod
    def perf_counter(cls) -> float:
        return cls.now


def add_slowly(case: Sum, folder: Path) -> dict[str, Any]:
    Clock.now += case.a
    return {"ended": "finished" if case.how != "crash" else "crashed", "sum": case.a + case.b}


def test_a_study_that_was_resumed_tells_the_time_of_all_its_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "time", Clock)
    cases = (Sum(1, 0), Sum(2, 0, "crash"), Sum(30, 0))
    walls = []
    for some, out in ((cases, "whole"), (cases[:1], "parts"), (cases, "parts"), (cases, "parts")):
        spent = Spent()
        study = Study("sums", some, add_slowly, lambda result: "")
        results = conduct(study, tmp_path / out, ThisProcess(), tell=lambda line: None, spent=spent)
        assert results[0] == {"a": 1, "b": 0, "how": "", "x": 0.0, "y": 0.0, "yaw": 0.0, "label": "1-0"} | {
            "ended": "finished",
            "sum": 1,
        }
        assert spent.cpu >= 0.0
        walls.append(spent.wall)
    assert walls == [33.0, 1.0, 33.0, 33.0], "what crashed counts, and is run again"


def test_processes_of_their_own_tell_what_their_cases_took(tmp_path: Path) -> None:
    spent = [Spent() for _ in range(2)]
    for one in spent:
        conduct(study_of(Sum(1, 1), Sum(2, 2)), tmp_path, LocalPool(1), tell=lambda line: None, spent=one)
    assert spent[0].wall > 0.0
    assert spent[0] == spent[1]
    died = Spent()
    conduct(study_of(Sum(3, 3, "die")), tmp_path, LocalPool(1), tell=lambda line: None, spent=died)
    assert died.wall > 0.0


def test_results_of_other_code_or_other_cases_are_never_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for digest in ("one", "one", "other", "one"):
        monkeypatch.setattr(engine, "source_digest", lambda digest=digest: digest)
        conduct(study_of(Sum(1, 1)), tmp_path, ThisProcess(), tell=lambda line: None)
    assert marks(tmp_path) == ["1-1", "1-1"], "once per code"
    conduct(study_of(Sum(1, 1, place=SE2(0.1, 0.0, 0.0))), tmp_path, ThisProcess(), tell=lambda line: None)
    assert len(marks(tmp_path)) == 3, "a value inside of the case counts"
    conduct(study_of(Sum(1, 1), name="others"), tmp_path, ThisProcess(), tell=lambda line: None)
    assert marks(tmp_path, "others") == ["1-1"], "two studies in one folder"


def test_a_file_that_a_case_names_counts_with_its_content(tmp_path: Path) -> None:
    world = tmp_path / "world.yaml"
    case = Sum(1, 1, how=str(world))
    keys = set()
    for text in (None, "a", "b", "a"):
        if text is not None:
            world.write_text(text)
        keys.add(key_of(study_of(case), case))
    assert len(keys) == 3


def test_the_source_is_part_of_every_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "ambler"
    package.mkdir()
    init = package / "__init__.py"
    monkeypatch.setattr(engine, "ambler", type("Fake", (), {"__file__": str(init)}))
    digests = []
    for text in ("x = 1", "x = 2", "x = 1"):
        init.write_text(text)
        engine.source_digest.cache_clear()
        digests.append(engine.source_digest())
    engine.source_digest.cache_clear()
    assert digests[0] == digests[2] != digests[1]


def test_what_raises_or_dies_counts_as_crashed_and_is_run_again(tmp_path: Path, told: list[str]) -> None:
    cases = (Sum(1, 1, "raise"), Sum(2, 2, "die"), Sum(3, 3), Sum(4, 4))
    for _ in range(2):
        results = conduct(study_of(*cases), tmp_path, LocalPool(1), tell=told.append)
        assert [r["ended"] for r in results] == ["crashed", "crashed", "finished", "finished"]
        assert "ValueError: too much" in results[0]["why"]
        assert "SIGKILL" in results[1]["why"]
        assert results[0]["label"] == "1-1"
    assert sorted(marks(tmp_path)) == ["1-1", "1-1", "2-2", "2-2", "3-3", "4-4"]
    logs = [path.read_text() for path in tmp_path.rglob("case.log")]
    assert len(logs) == 4
    assert sum("adding" in log for log in logs) >= 3, "what was printed by a process that is killed may be lost"
    assert any("Traceback" in log for log in logs)


class Stopped(Exception):
    """Stands for a signal."""


def test_an_interrupted_study_ends_soon_and_keeps_what_was_done(tmp_path: Path) -> None:
    def tell(line: str) -> None:
        raise Stopped

    begun = time.monotonic()
    with pytest.raises(Stopped):
        conduct(study_of(Sum(1, 1), Sum(2, 2, "long")), tmp_path, LocalPool(2), tell=tell)
    assert time.monotonic() - begun < 40.0, "the other case was ended"
    kept = [json.loads(path.read_text())["label"] for path in tmp_path.rglob("result.json")]
    assert kept == ["1-1"]


def test_cases_need_names_of_their_own(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="several cases are called 1-1"):
        conduct(study_of(Sum(1, 1), Sum(1, 1)), tmp_path, ThisProcess())


def test_seeds_that_nobody_chose_are_drawn_once(tmp_path: Path) -> None:
    file = tmp_path / "deep" / "seeds.json"
    drawn = seeds_of("draw", 3, file)
    assert seeds_of("draw", 5, file)[:3] == drawn
    assert len(set(seeds_of("draw", 5, file))) == 5
    assert seeds_of("7", 3, file) == (7, 8, 9)
    assert seeds_of("7,3,90", 2, file) == (7, 3)
    for text, runs in (("-1", 3), ("x", 3), ("0", 0), ("7,3", 3), ("7,,3", 2), ("7,draw", 2)):
        with pytest.raises(BadInputError):
            seeds_of(text, runs, file)


def test_the_command_of_a_result_names_the_seeds_that_were_drawn(tmp_path: Path) -> None:
    drawn = seeds_of("draw", 3, tmp_path / "seeds.json")
    listed = ",".join(map(str, drawn))
    for told in ("--seed draw", "--seed=draw"):
        command = with_seeds(f"ambler eval ground {told} --runs 3 --out 'a b'", listed)
        assert "draw" not in command
        assert "'a b'" in command
        again = re.search(r"--seed[ =](\S+)", command)
        assert again is not None
        assert seeds_of(again.group(1), 3, tmp_path / "other.json") == drawn
    assert with_seeds("ambler eval draw --seed 4", "4,5") == "ambler eval draw --seed 4"


@pytest.mark.filterwarnings("ignore")  # Dask's own, when ports are taken and sockets collected
def test_a_cluster_gives_the_same_results_when_a_worker_is_lost(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed (the extra `cluster`)")
    cases = [Sum(k, k) for k in range(6)]
    local = conduct(study_of(*cases), tmp_path / "local", LocalPool(2), tell=lambda line: None)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", host="127.0.0.1"
    ) as cluster:
        victim = next(iter(cluster.workers.values())).process.pid
        threading.Timer(1.0, os.kill, (victim, signal.SIGKILL)).start()
        workers = ClusterPool(cluster.scheduler_address)
        apart = conduct(study_of(*cases), tmp_path / "cluster", workers, tell=lambda line: None)
    assert apart == local


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_is_not_there_is_one_sentence() -> None:
    pytest.importorskip("distributed", reason="Dask is not installed (the extra `cluster`)")
    with pytest.raises(BadInputError, match="no scheduler answers"):
        ClusterPool("tcp://127.0.0.1:1")
