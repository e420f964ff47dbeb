"""The Python of README and of the pages on costmaps, control and recordings is run as it stands."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize(
    ("page", "count"), [("costmap.md", 2), ("control.md", 2), ("recording.md", 2), ("../README.md", 1)]
)
def test_the_examples_run(page: str, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)
    assert len(found) == count
    for text in found:
        exec(compile(text, page, "exec"), {})
