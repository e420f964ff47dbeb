"""Replays a run's recording through the same nodes, without the simulator, and compares every output with the recorded one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ambler.apps.config import ExplorerConfig
from ambler.apps.run_folder import RunFolder
from ambler.apps.stacks import explorer_nodes
from ambler.core.errors import BadInputError
from ambler.core.messages import Message
from ambler.evaluation.recording_compare import RecordingComparison, ReplayComparison
from ambler.nodes.operator import OperatorNode
from ambler.nodes.simulator import SimulatorNode
from ambler.runtime.clock import ReplayClock
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.stack import Stack
from ambler.runtime.topics import (
    CLOUD,
    GOAL,
    IMU,
    SCAN,
    SCANNERS,
    STATIC_TRANSFORMS,
    WHEEL_ODOMETRY,
    Topic,
    all_topics,
    topic_named,
)
from ambler.settings.profiles import build, load_profile
from ambler.sim.robots import robot_named
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

BASE = SimulatorNode.name
INPUTS: tuple[Topic[Any], ...] = (SCAN, CLOUD, IMU, WHEEL_ODOMETRY, STATIC_TRANSFORMS, GOAL)
MERGED_INPUTS = (SCANNERS, *INPUTS[1:])  # of a robot whose scan is merged


def replay_run(root: Path, out: Path | None = None, rate: float | None = None) -> RecordingComparison:
    """Feed the sensors of `<root>/recording` to the nodes that `<root>/config.yaml` describes; `out` takes the saved map.

    Raises BadInputError when the folder is not that of a run.
    """
    if not (root / "config.yaml").exists():
        raise BadInputError(f"{root} is not the folder of a run: it has no config.yaml")
    folder = RunFolder(root)
    saved = load_profile(folder.config)
    try:
        robot = robot_named(saved["demo"]["robot"]).model
        config = build(ExplorerConfig, saved["explorer"])
    except (KeyError, TypeError) as error:
        raise BadInputError(f"{folder.config} is not the configuration of a run: {error}") from error
    inputs = INPUTS if len(robot.scanners) <= 1 else MERGED_INPUTS
    outputs = _outputs(inputs)
    comparison = ReplayComparison(read_recording(folder.recording, outputs), outputs)
    stem = (out if out is not None else folder.root / "replay") / "map"
    stem.parent.mkdir(parents=True, exist_ok=True)
    operator = OperatorNode(str(stem), lambda outcome: executor.stop())
    stack = Stack([*explorer_nodes(robot, config), operator], external=inputs)
    executor = LockstepExecutor(stack, ReplayClock(rate=rate), RunLog())
    with executor:
        executor.tap(comparison.on_message)
        executor.run(feed=_feed(folder.recording, inputs))
    return comparison.result()


def _outputs(inputs: tuple[Topic[Any], ...]) -> list[str]:
    names = {t.ros_name for t in inputs}
    return [t.ros_name for t in all_topics() if t.ros_name not in names and not t.is_truth]


def _feed(recording: Path, inputs: tuple[Topic[Any], ...]) -> Iterator[tuple[Topic[Any], Message, int]]:
    """The messages that the nodes do not make themselves; of the transforms those that the base wrote."""
    for recorded in read_recording(recording, [t.ros_name for t in inputs]):
        topic = topic_named(recorded.topic)
        if not topic.has_many_writers or recorded.writer == BASE:
            yield topic, decode(topic.type, recorded.data), recorded.log_time_ns
