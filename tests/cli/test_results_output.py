"""Fields are printed in two columns and written only when asked for."""

from __future__ import annotations

import json
import time
from argparse import Namespace
from pathlib import Path

import pytest

from ambler.cli.results_output import print_fields, save_json


def test_fields_are_printed_in_columns(capsys: pytest.CaptureFixture[str]) -> None:
    print_fields({"time_ms": 1.23456, "cells": 7, "robot": "diff", "unknown": None, "is_good": True}, 10, ".2f")
    assert capsys.readouterr().out.splitlines() == [
        "time_ms    1.23",
        "cells      7",
        "robot      diff",
        "unknown    None",
        "is_good    True",
    ]
    print_fields({"time_ms": 1.25, "cells": 7}, 8, "10.3f", "10d")
    assert capsys.readouterr().out.splitlines() == ["time_ms       1.250", "cells             7"]


def test_fields_are_written_when_asked_for(tmp_path: Path) -> None:
    args = Namespace(json=None, command_line="ambler bench toy", seed=3)
    save_json(args, time.perf_counter(), {"cells": 7})
    assert list(tmp_path.iterdir()) == []
    args.json = tmp_path / "result.json"
    save_json(args, time.perf_counter() - 2.0, {"cells": 7})
    result = json.loads(args.json.read_text())
    assert (result["command"], result["seed"], result["cells"]) == ("ambler bench toy", 3, 7)
    assert 2.0 <= result["wall_seconds"] < 60.0
