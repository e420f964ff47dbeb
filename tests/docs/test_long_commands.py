"""The long commands of README and docs, shortened: each ends as it should, says what it should, and leaves the files that it names."""

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from ambler.cli.main import main
from tests.docs.commands import BLOCKS, ROOT, lengthened
from tests.docs.long_commands import LONG

PROVENANCE = ("command", "version", "commit", "is_dirty", "date", "machine", "seed", "wall_seconds", "cpu_seconds")


@dataclass(frozen=True)
class Outcome:
    """How a command ended, in which folder, what it printed, how large the files are that it should leave, and what it wrote on `--json`."""

    folder: Path
    words: list[str]
    code: int
    printed: str
    sizes: dict[str, int]
    fields: dict[str, Any] | None


Ran = Callable[[str], Outcome]


def execute(text: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> Outcome:
    """Run a command in its folder, which is the working one: as a shell does, with the files that a pattern fits."""
    words: list[str] = []
    for word in lengthened(BLOCKS[text], LONG[text].more.split()):
        words += (sorted(path.name for path in folder.glob(word)) if "*" in word else []) or [word]
    capsys.readouterr()
    code = main(words)
    printed = capsys.readouterr().out
    sizes = {name: path.stat().st_size for name in LONG[text].writes if (path := folder / name).is_file()}
    result = folder / words[words.index("--json") + 1] if "--json" in words else None
    fields = json.loads(result.read_text()) if result is not None and result.is_file() else None
    return Outcome(folder, words, code, printed, sizes, fields)


@contextmanager
def workers(words: tuple[str, ...]) -> Iterator[None]:
    """Have a scheduler with a worker where the command says that there is one."""
    if "--cluster" not in words:
        yield
        return
    distributed = pytest.importorskip("distributed", reason="Dask is not installed (the extra `cluster`)")
    host, port = words[words.index("--cluster") + 1].removeprefix("tcp://").split(":")
    with distributed.LocalCluster(1, threads_per_worker=1, host=host, scheduler_port=int(port), dashboard_address=":0"):
        yield


@pytest.fixture(scope="module")
def done() -> dict[str, Outcome]:
    """The commands that were run: one that others come after runs once."""
    return {}


@pytest.fixture
def ran(
    done: dict[str, Outcome],
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Ran:
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "src"))  # studies start processes, from another folder

    def run(text: str) -> Outcome:
        if text not in done:
            after = LONG[text].after
            folder = run(after).folder if after else tmp_path_factory.mktemp("long")
            for give in LONG[text].given:
                give(folder)
            monkeypatch.chdir(folder)
            with workers(BLOCKS[text].words):
                done[text] = execute(text, folder, capsys)
        return done[text]

    return run


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Dask's own, when sockets are collected
@pytest.mark.parametrize("text", LONG, ids=str)
def test_long_commands_run(text: str, ran: Ran) -> None:
    outcome, long = ran(text), LONG[text]
    assert outcome.code == long.code if long.code is not None else outcome.code in (0, 1), outcome.printed
    assert re.search(long.says, outcome.printed, re.DOTALL), outcome.printed
    assert ": crashed" not in outcome.printed, outcome.printed
    assert [name for name in long.writes if not outcome.sizes.get(name)] == []
    if "--json" in outcome.words:
        assert outcome.fields is not None
        verb = [word for word in outcome.words[:2] if not word.startswith("-")]
        assert outcome.fields["command"].startswith(" ".join(("ambler", *verb)))
        assert [name for name in PROVENANCE if name not in outcome.fields] == []
        assert outcome.fields["seed"] is not None
        assert outcome.words[0] != "eval" or re.fullmatch(r"\d+(,\d+)*", str(outcome.fields["seeds"]))


def test_long_commands_must_say_something() -> None:
    """A pattern that anything fits would test nothing."""
    assert [text for text, long in LONG.items() if not long.says or re.search(long.says, "")] == []
