"""Whole explorations in a small world, shared by the tests that judge them."""

from pathlib import Path

import pytest

from ambler.apps.demo import Demo, DemoOptions
from ambler.apps.run_folder import RunFolder
from ambler.kernels.warmup import imported_kernel_modules, warm_up


@pytest.fixture(scope="session", autouse=True)
def warm_kernels() -> None:
    warm_up(imported_kernel_modules())


def explore(root: Path, options: DemoOptions) -> Demo:
    """Run one demonstration and release it; its folder and outcome stay."""
    demo = Demo(options, RunFolder(root))
    try:
        demo.run()
    finally:
        demo.close()
    return demo


@pytest.fixture(scope="session")
def lab_run(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """One exploration of `lab_empty` with `diff`, in lockstep."""
    return explore(tmp_path_factory.mktemp("lab"), DemoOptions(world="lab_empty", port=None))
