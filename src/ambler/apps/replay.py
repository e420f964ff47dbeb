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
from ambler.core.robot import SensorKind
from ambler.evaluation.recording_compare import RecordingComparison, ReplayComparison
from ambler.nodes.devices.table import device_names, topics_of_kind
from ambler.nodes.operator import OperatorNode
from ambler.runtime.clock import ReplayClock
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.stack import Stack
from ambler.runtime.topics import (
    BATTERY,
    GOAL,
    ODOMETRY,
    STATIC_TRANSFORMS,
    TRANSFORMS,
    WHEEL_ODOMETRY,
    Topic,
    all_topics,
    topic_named,
)
from ambler.settings.profiles import build, load_profile
from ambler.sim.robots import robot_named
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

INPUTS: tuple[Topic[Any], ...] = (
    WHEEL_ODOMETRY,
    ODOMETRY,
    TRANSFORMS,
    STATIC_TRANSFORMS,
    BATTERY,
    GOAL,
)  # beside its sensors


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
    inputs = (*(topic for kind in SensorKind for topic in topics_of_kind(robot, kind)), *INPUTS)
    outputs = _outputs(inputs)
    comparison = ReplayComparison(read_recording(folder.recording, outputs), outputs)
    stem = (out if out is not None else folder.root / "replay") / "map"
    stem.parent.mkdir(parents=True, exist_ok=True)
    operator = OperatorNode(str(stem), lambda outcome: executor.stop())
    stack = Stack([*explorer_nodes(robot, config), operator], external=inputs)
    executor = LockstepExecutor(stack, ReplayClock(rate=rate), RunLog())
    with executor:
        executor.tap(comparison.on_message)
        executor.run(feed=_feed(folder.recording, inputs, device_names(robot)))
    return comparison.result()


def _outputs(inputs: tuple[Topic[Any], ...]) -> list[str]:
    names = {t.ros_name for t in inputs}
    return [t.ros_name for t in all_topics() if t.ros_name not in names and not t.is_truth]


def _feed(
    recording: Path, inputs: tuple[Topic[Any], ...], devices: frozenset[str]
) -> Iterator[tuple[Topic[Any], Message, int]]:
    """The messages that the nodes do not make themselves; of what many write only what devices wrote."""
    for recorded in read_recording(recording, [t.ros_name for t in inputs]):
        topic = topic_named(recorded.topic)
        if not topic.has_many_writers or recorded.writer in devices:
            yield topic, decode(topic.type, recorded.data), recorded.log_time_ns
