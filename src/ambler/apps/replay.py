"""Replays a run's recording through the same nodes, without devices, and compares every output with the recorded one.

What is fed follows from the nodes: all that none of them writes, so what devices and the outside wrote, outside calls among it. Ground
truth is left out. Services of devices are answered as the devices' nodes did.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambler.apps.config import RobotConfig
from ambler.apps.programs import steps_from_values
from ambler.apps.robot import Site, robot_nodes
from ambler.apps.run_folder import RunFolder
from ambler.apps.saved_site import is_site, load_site
from ambler.core.errors import BadInputError
from ambler.core.messages import Message, Odometry, PoseStamped, Transforms, TransformStamped
from ambler.core.se3 import SE3
from ambler.docking.database import DockDatabase
from ambler.evaluation.pose_difference import PoseDifference, pose_difference
from ambler.evaluation.recording_compare import RecordingComparison, ReplayComparison
from ambler.nodes.devices.node import DeviceNode
from ambler.nodes.operator import OperatorConfig, OperatorNode
from ambler.nodes.steps import ExploreStep, ProgramEnd, Step
from ambler.runtime.clock import ReplayClock
from ambler.runtime.executor import NodeFailedError
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    CAMERA_PICTURES,
    SAVE_CLOUD,
    SAVE_GLASS,
    SAVE_GRAPH,
    SAVE_STATIONS,
    STOP_CHARGING,
    Nothing,
)
from ambler.runtime.topics import LOCALIZED_POSE, SLAM_POSE, TRANSFORMS, Topic, all_topics, topic_named
from ambler.settings.profiles import build, load_profile
from ambler.sim.robots import robot_named
from ambler.wire.graph_files import graph_file, load_graph
from ambler.wire.map_files import load_map
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

_Edge = tuple[int, str, SE3]


@dataclass(frozen=True)
class Replay:
    """What a replay found. Of a live run, whose nodes ran in parallel, outputs cannot be equal: `poses` then says how far the poses that
    were told lie apart, None for a run in lockstep."""

    comparison: RecordingComparison
    poses: PoseDifference | None

    @property
    def is_good(self) -> bool:
        """Whether all outputs are equal, or those of a live run within their tolerances."""
        return self.comparison.is_equal if self.poses is None else self.poses.is_within


class RecordedServicesNode(Node):
    """Answers what the nodes of devices served: the recording already holds what came of it."""

    name = "recorded_devices"
    serves = (CAMERA_PICTURES, STOP_CHARGING)
    latency = DeviceNode.latency

    def start(self) -> None:
        """Serve."""
        self.ctx.serve(CAMERA_PICTURES, lambda request: Nothing())
        self.ctx.serve(STOP_CHARGING, lambda request: Nothing())


def replay_run(root: Path, out: Path | None = None, rate: float | None = None) -> Replay:
    """Feed what devices and the outside put into `<root>/recording` to the nodes that `<root>/config.yaml` describes; `out` takes what
    the replay saves (None: `<root>/replay`).

    Raises BadInputError when the folder is not that of a run.
    """
    if not (root / "config.yaml").exists():
        raise BadInputError(f"{root} is not the folder of a run: it has no config.yaml")
    folder = RunFolder(root)
    out = out if out is not None else root / "replay"
    out.mkdir(parents=True, exist_ok=True)
    saved = load_profile(folder.config)
    if "route" in saved:
        raise BadInputError(
            f"{root} is a drive along a route, in which nothing thought: map its recording with `ambler lio`"
        )
    try:
        nodes = _nodes(saved, folder, out)
        is_live = bool(saved["run"]["is_realtime"] or saved["run"]["is_apart"])
    except (KeyError, TypeError) as error:
        raise BadInputError(f"{folder.config} is not the configuration of a run: {error}") from error
    operator, finish = _operator(saved, nodes, out)
    stack = Stack([*nodes, RecordedServicesNode(), operator], external=_inputs([*nodes, operator]))
    names = frozenset(node.name for node in stack.nodes)
    written = dict.fromkeys(t for node in stack.nodes for t in node.outputs)
    outputs = [topic.ros_name for topic in written if not topic.is_bulk]  # what is for nodes only was not recorded
    comparison = ReplayComparison(read_recording(folder.recording, outputs), outputs)
    poses: list[tuple[int, PoseStamped | Odometry]] = []
    first_ns, last_ns = _span(folder.recording)
    begin_ns = first_ns if saved["run"]["is_apart"] else 0  # by the system's clock
    executor = LockstepExecutor(stack, ReplayClock(begin_ns, rate), RunLog())

    def stop_at_the_end() -> None:  # one of a team may be done long before the others
        if executor.now_ns >= last_ns:
            executor.stop()

    finish.append(stop_at_the_end)

    def watch(topic: Topic[Any], message: Message, time_ns: int, writer: str) -> None:
        if not topic.is_bulk:
            comparison.on_message(topic, message, time_ns, writer)
        if topic in (SLAM_POSE, LOCALIZED_POSE) and isinstance(message, PoseStamped | Odometry):
            poses.append((message.stamp_ns, message))

    with executor:
        executor.tap(watch)
        try:
            executor.run((last_ns - begin_ns) * 1e-9, _feed(folder.recording, names))
        except NodeFailedError as failure:
            raise BadInputError(f"the replay of {root} ended early: {failure}") from failure
    return Replay(comparison.result(), pose_difference(folder.recording, poses) if is_live else None)


def _nodes(saved: dict[str, Any], folder: RunFolder, out: Path) -> list[Node]:
    robot = robot_named(saved["run"]["robot"]).model
    known = folder.known_map_stem.with_suffix(".yaml")
    docks = None
    if folder.first_docks.exists():
        shutil.copyfile(folder.first_docks, out / "docks.yaml")
        docks = DockDatabase.load(out / "docks.yaml")
    config = build(RobotConfig, saved["robot"])
    graph = graph_file(folder.known_map_stem)
    kept = load_graph(graph) if graph.exists() else None
    if is_site(known):
        site = Site(None, docks, kept, load_site(known, config.lio.localize.map))
    else:
        site = Site(load_map(known) if known.exists() else None, docks, kept)
    return robot_nodes(robot, config, site, int(saved["run"]["seed"]))


def _operator(saved: dict[str, Any], nodes: Sequence[Node], out: Path) -> tuple[OperatorNode, list[Any]]:
    """Return the operator, and the list of what is called when its program ends."""
    steps: tuple[Step, ...] = steps_from_values(saved["steps"])
    makes_map = bool(saved["run"].get("is_unknown")) or (bool(steps) and isinstance(steps[0], ExploreStep))
    served = {offer for node in nodes for offer in node.serves}
    config = OperatorConfig(may_turn=bool(saved["run"]["may_turn"]))
    if makes_map:
        saves = tuple(service for service in (SAVE_GLASS, SAVE_GRAPH, SAVE_CLOUD, SAVE_STATIONS) if service in served)
        config = OperatorConfig(str(out / "map"), saves)
    called: list[Any] = []

    def finish(end: ProgramEnd) -> None:
        for callback in called:
            callback()

    return OperatorNode(steps, config, finish), called


def _span(recording: Path) -> tuple[int, int]:
    """When the first and the last message of a recording were delivered."""
    times = [recorded.log_time_ns for recorded in read_recording(recording)]
    return (min(times), max(times)) if times else (0, 0)


def _inputs(nodes: Sequence[Node]) -> tuple[Topic[Any], ...]:
    """Return what may be fed: every topic that no node writes, and those that many may write."""
    written = {topic for node in nodes for topic in node.outputs}
    return tuple(t for t in all_topics() if not t.is_truth and (t not in written or t.has_many_writers))


def _feed(recording: Path, names: frozenset[str]) -> Iterator[tuple[Topic[Any], Message, int]]:
    """The messages that the nodes do not make themselves, in the order of their delivery."""
    known: dict[str, _Edge] = {}
    for recorded in read_recording(recording):
        if recorded.topic == TRANSFORMS.ros_name:
            news = _news(known, decode(Transforms, recorded.data))
            if recorded.writer not in names:
                yield TRANSFORMS, news, recorded.log_time_ns
            continue
        if recorded.writer in names:
            continue
        topic = topic_named(recorded.topic)
        if not topic.is_truth:
            yield topic, decode(topic.type, recorded.data), recorded.log_time_ns


def _news(known: dict[str, _Edge], message: Transforms) -> Transforms:
    """Return the edges that a recorded message told, without those of others that the recorder repeated in it; `known` holds the newest
    by their children."""
    told = tuple(edge for edge in message.transforms if known.get(edge.child) != _values(edge))
    known.update((edge.child, _values(edge)) for edge in told)
    return Transforms(message.stamp_ns, told)


def _values(edge: TransformStamped) -> _Edge:
    return edge.stamp_ns, edge.parent, edge.parent_from_child
