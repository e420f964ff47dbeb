"""The layer rule of docs/architecture.md: a room imports only rooms of lower rows, and rooms of one row never each other."""

import ast
import importlib
from pathlib import Path

import pytest

from ambler.kernels.warmup import kernel_modules

SOURCE = Path(__file__).parents[2] / "src" / "ambler"
ROWS = [
    {"cli"},
    {"studies"},
    {"apps"},
    {"nodes"},
    {"missions", "bridges", "ops", "evaluation"},
    {"runtime", "settings"},
    {
        *("perception", "calibration", "slam2d", "lio", "localization", "maps", "costmap", "planning", "control"),
        *("safety", "exploration", "docking", "drivers", "sim"),
    },
    {"recordings", "robots"},
    {"grids", "registration", "posegraph"},
    {"wire", "kernels"},
    {"core"},
]
RANK = {room: rank for rank, row in enumerate(ROWS) for room in row}
FILES = sorted(SOURCE.rglob("*.py"))


def imported_rooms(path: Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: relative import"
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        rooms |= {n.split(".")[1] for n in names if n.startswith("ambler.")}
    return rooms & RANK.keys()


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_point_down(path: Path) -> None:
    room = path.relative_to(SOURCE).parts[0]
    if room.endswith(".py"):
        return
    assert room in RANK, f"{room} is no room of the design"
    wrong = {r for r in imported_rooms(path) if r != room and RANK[r] <= RANK[room]}
    assert not wrong, f"{path.relative_to(SOURCE)} imports {sorted(wrong)}"


def test_only_kernels_import_numba() -> None:
    offenders = [
        str(p.relative_to(SOURCE))
        for p in FILES
        if p.parent.name != "kernels" and any(w in p.read_text() for w in ("import numba", "from numba"))
    ]
    assert not offenders


def test_only_the_gate_publishes_the_velocity_command() -> None:
    writers = [
        str(p.relative_to(SOURCE)) for p in FILES if "publish(VELOCITY_COMMAND" in p.read_text().replace("topics.", "")
    ]
    assert writers in ([], ["nodes/gate.py"])


def test_every_kernel_module_can_be_warmed_up() -> None:
    names = kernel_modules()
    assert "scan_motion" in names
    lacking = [name for name in names if not hasattr(importlib.import_module(f"ambler.kernels.{name}"), "warm_up")]
    assert lacking == []
