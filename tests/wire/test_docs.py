"""The example of docs/recording.md is run as it stands."""

import re
from pathlib import Path

PAGE = (Path(__file__).parents[2] / "docs" / "recording.md").read_text()


def test_the_example_runs(tmp_path, monkeypatch, capsys):
    found = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    monkeypatch.chdir(tmp_path)
    exec(compile(found.group(1), "recording.md", "exec"), {})
    assert capsys.readouterr().out == "/cmd_vel 1000 0.5\n"
