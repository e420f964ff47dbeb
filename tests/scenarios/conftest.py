"""Whole explorations in a small world, shared by the tests that judge them."""

from pathlib import Path

import pytest

from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.kernels.warmup import imported_kernel_modules, warm_up


@pytest.fixture(scope="session", autouse=True)
def warm_kernels() -> None:
    warm_up(imported_kernel_modules())


def explore(root: Path, options: RunOptions) -> SimulatedRun:
    """Run one program and release it; its folder and its end stay."""
    demo = SimulatedRun(options, RunFolder(root))
    try:
        demo.run()
    finally:
        demo.close()
    return demo


@pytest.fixture(scope="session")
def lab_run(tmp_path_factory: pytest.TempPathFactory) -> SimulatedRun:
    """One exploration of `lab_empty` with `diff`, in lockstep."""
    return explore(tmp_path_factory.mktemp("lab"), RunOptions(world="lab_empty", port=None))
