"""The example of docs/docking.md is run as it stands."""

import re
from pathlib import Path

PAGE = (Path(__file__).parents[2] / "docs" / "docking.md").read_text()


def test_the_example_runs() -> None:
    found = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    exec(compile(found.group(1), "docking.md", "exec"), {})
