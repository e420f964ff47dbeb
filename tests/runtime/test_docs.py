"""The example of docs/runtime.md is run as it stands."""

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "runtime.md").read_text()


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    example = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[-1]
    exec(compile(example, "runtime.md", "exec"), {})
    assert capsys.readouterr().out == "armed for script\n"
