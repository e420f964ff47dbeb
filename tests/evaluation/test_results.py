"""Result files are flat and honest, and the README's table is made of nothing else."""

import json
import subprocess
import sys
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

from ambler.evaluation import results
from ambler.evaluation.results import write_results
from ambler.evaluation.results_table import (
    HEADLINES,
    ROWS,
    Row,
    results_table,
    update_docking,
    update_page,
    update_readme,
)

REPOSITORY = Path(__file__).parents[2]


def test_results_carry_their_origin_and_unknown_is_null(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "r.json"
    write_results(path, "ambler x", 3, 1.5, {"a_m": np.float64(0.25), "b": float("nan"), "c": None, "d": np.int64(4)})
    result = json.loads(path.read_text())
    assert {"command", "version", "commit", "is_dirty", "date", "machine", "seed", "wall_seconds"} <= result.keys()
    assert result["cpu_seconds"] > 0.0
    assert (result["a_m"], result["b"], result["c"], result["d"], result["seed"]) == (0.25, None, None, 4, 3)


def test_a_result_knows_its_commit_and_whether_the_code_was_changed(tmp_path: Path) -> None:
    """The same file as a package of three checkouts: clean, changed, and none at all."""
    script = "import json, sys; sys.path.insert(0, '.'); from state import code_state; print(json.dumps(code_state()))"

    def state_in(root: Path) -> dict[str, object]:
        words, folder = [sys.executable, "-c", script], root / "pkg/evaluation"
        told = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True)
        return json.loads(told.stdout)  # type: ignore[no-any-return]

    def git(root: Path, *words: str) -> str:
        name = ("-c", "user.name=a", "-c", "user.email=a@b")
        return subprocess.run(
            ["git", *name, *words], cwd=root, capture_output=True, text=True, check=True
        ).stdout.strip()

    source = Path(results.__file__).read_text()
    for name in ("clean", "changed", "none"):
        package = tmp_path / name / "pkg"
        (package / "evaluation").mkdir(parents=True)
        (package / "__init__.py").touch()
        (package / ".gitignore").write_text("__pycache__/\n")
        (package / "evaluation" / "state.py").write_text(source)
        if name != "none":
            git(package, "init", "-q")
            git(package, "add", ".")
            git(package, "commit", "-qm", "x")
    (tmp_path / "changed/pkg/__init__.py").write_text("# changed\n")
    assert state_in(tmp_path / "clean") == {
        "commit": git(tmp_path / "clean/pkg", "rev-parse", "HEAD"),
        "is_dirty": False,
    }
    assert state_in(tmp_path / "changed")["is_dirty"] is True
    assert state_in(tmp_path / "none") == {"commit": None, "is_dirty": None}


def test_nested_results_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="'a' is not flat"):
        write_results(tmp_path / "r.json", "ambler x", 0, 0.0, {"a": [1]})
    assert not list(tmp_path.iterdir())


def test_the_table_says_what_was_not_measured(tmp_path: Path) -> None:
    fields = {"inflation_60_ms": 0.0812}
    write_results(tmp_path / "bench_costmap.json", "ambler bench costmap", 0, 1.0, fields)
    table = results_table(tmp_path)
    assert "| 0.081 ms (" in table
    assert table.count("not measured yet") == len(ROWS) - 1


@pytest.mark.parametrize(("cases", "found", "misses"), [(10**7, 0, False), (10**7, 1, True), (10**6, 0, True)])
def test_a_row_that_misses_its_bar_says_so(tmp_path: Path, cases: int, found: int, misses: bool) -> None:
    write_results(tmp_path / "gate_search.json", "ambler eval gate", 0, 1.0, {"cases": cases, "counterexamples": found})
    assert ("misses the bar" in results_table(tmp_path)) == misses


RESULTS = Path(__file__).parents[2] / "docs" / "results"
REPORTED = {"odometry_husky.json"}  # told without a bar


@pytest.mark.parametrize("row", [r for r in ROWS if r.file not in REPORTED], ids=lambda row: str(row.what)[:40])
def test_every_bar_is_judged(row: Row) -> None:
    """A row that passed whatever was measured would claim what nobody checked."""
    if not (RESULTS / row.file).exists():
        pytest.skip(f"{row.file} is not measured yet, and the table says so")
    measured = json.loads((RESULTS / row.file).read_text())
    fields = {name.replace(".", "_"): value for name, value in measured.items()}
    named = {name for _, name, _, _ in Formatter().parse(row.text) if name}
    if named - set(fields):
        pytest.skip(f"{row.file} is of a day before this row: the table calls it incomplete")
    assert isinstance(row.is_met(fields), bool)

    def forced(value: float) -> dict[str, object]:
        return {k: value if isinstance(v, int | float) and not isinstance(v, bool) else v for k, v in fields.items()}

    assert not (row.is_met(forced(0.0)) and row.is_met(forced(1e9)))


def test_only_the_text_between_the_marks_is_replaced(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text("before\n<!-- results -->\nold\n<!-- /results -->\nafter\n")
    update_readme(readme, tmp_path)
    text = readme.read_text()
    assert text.startswith("before\n<!-- results -->\n| what")
    assert text.endswith("<!-- /results -->\nafter\n")
    assert "old" not in text
    assert text.count("not measured yet") == len(HEADLINES)


def test_the_headlines_are_rows_of_the_page_with_links_from_the_readme(tmp_path: Path) -> None:
    update_page(tmp_path / "results.md", RESULTS)
    page = (tmp_path / "results.md").read_text().splitlines()
    headlines = [line for line in results_table(RESULTS, "docs/results", HEADLINES).splitlines() if "json))" in line]
    assert len(headlines) == len(HEADLINES)
    for line in headlines:
        assert line.replace("(docs/results/", "(results/") in page


def test_the_page_on_docking_shows_what_was_measured(tmp_path: Path) -> None:
    page = tmp_path / "docking.md"
    written = (REPOSITORY / "docs" / "docking.md").read_text()
    page.write_text(written)
    update_docking(page, REPOSITORY / "docs" / "results")
    assert page.read_text() == written, "`ambler eval results` was not run"
    measured = json.loads((REPOSITORY / "docs" / "results" / "docking.json").read_text())
    assert f"| final error, worst | not told | {1e3 * measured['position_error_max_m']:.2f} mm |" in written
    assert "reflectors |" in written


def test_a_command_names_public_recordings_wherever_they_lie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMBLER_DATA", "/some/where")
    told = write_results(tmp_path / "r.json", "ambler slam2d /some/where/intel.clf", 0, 1.0, {})
    assert told["command"] == "ambler slam2d $AMBLER_DATA/intel.clf"
    monkeypatch.delenv("AMBLER_DATA")
    assert write_results(tmp_path / "r.json", "ambler demo", 0, 1.0, {})["command"] == "ambler demo"
