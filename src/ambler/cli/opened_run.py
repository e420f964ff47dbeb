"""What comes before and after every simulated run: check, read the world, build the run in a new folder, and close it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from ambler.apps.run import Run
    from ambler.apps.run_folder import RunFolder
    from ambler.apps.scene import RunOptions

SceneT = TypeVar("SceneT")
RunT = TypeVar("RunT", bound="Run")


@contextmanager
def opened_run(
    args: argparse.Namespace,
    options: RunOptions,
    verb: str,
    read_scene: Callable[[], SceneT],
    build: Callable[[SceneT, RunFolder], RunT],
) -> Iterator[RunT]:
    """Give a run that is set up and in view; nothing is left of it when it cannot be set up. Raises BadInputError with one sentence."""
    from ambler.apps.console import Stages
    from ambler.apps.run_folder import RunFolder
    from ambler.bridges.foxglove_front import check_port
    from ambler.cli.run_options import check_outputs
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    if options.port is not None:
        check_port(options.host, options.port)
    with Stages() as stages:
        stages.begin(f"reading the world {options.world}")
        scene = read_scene()
    check_outputs(args.json, args.out)
    warm_up(imported_kernel_modules())
    folder = RunFolder.new(args.out, f"{verb}-{Path(args.world).stem}-{Path(args.robot).stem}-{args.seed}")
    try:
        with Stages() as stages:
            stages.begin("setting up the world and the robot")
            run = build(scene, folder)
    except BaseException:
        folder.remove()
        raise
    try:
        folder.link_latest()
        if run.view is not None:
            print(f"live view: Foxglove on ws://{options.host}:{run.view.port}  (docs/live_view.md)", flush=True)
        yield run
    finally:
        run.close()


def is_kept_alive(args: argparse.Namespace, run: Run) -> bool:
    """Say whether the robot lives on for its viewers."""
    from ambler.cli.run_options import is_attended

    return is_attended(args) and run.view is not None and run.executor.failure is None and not run.is_interrupted
