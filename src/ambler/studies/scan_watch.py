"""Follows the scans of a live robot through its nodes to the commands that know of them.

Three ways lead from a scan to a command: the gate's own look at it; the local costmap, on which the controller computes the request that the gate lets
pass; and odometry, terrain analysis and the terrain in that costmap. Whoever writes a message is asked, in his own thread, which scan he knows of then.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from ambler.core.errors import StaleInputError
from ambler.core.messages import LaserScan, Message, PointCloud, VelocityCommand
from ambler.evaluation.scan_reaction import F64, KnowingCommand, TakenScan, reaction_times, summary_ms
from ambler.nodes.controller import ControllerNode
from ambler.nodes.gate import GateNode
from ambler.runtime.context import NodeContext
from ambler.runtime.live import LiveExecutor
from ambler.runtime.tasks import FOLLOW_PATH, RECOVER
from ambler.runtime.topics import TERRAIN_MAP, VELOCITY_COMMAND, VELOCITY_REQUEST, Topic

NEVER_NS = -(1 << 62)
SAME_NS = 1_000_000  # by which the end of a cloud may differ from the stamp of its terrain: times of points are float32


class ScanWatch:
    """Watches one robot of a live executor from its construction on. Costs some microseconds per message of the topics concerned."""

    def __init__(self, executor: LiveExecutor) -> None:
        self._executor = executor
        self._context, self._gate_context = executor.context_of("controller"), executor.context_of("gate")
        controller, gate = self._context.node, self._gate_context.node
        assert isinstance(controller, ControllerNode)
        assert isinstance(gate, GateNode)
        self._controller, self._gate = controller, gate
        self._lock = threading.Lock()
        self._scans: list[TakenScan] = []
        self._terrains: list[tuple[int, int]] = []  # sent, stamp
        self._requests: dict[int, tuple[int, int]] = {}  # by stamp: scan in the costmap, motion
        self._commands: list[tuple[int, int, int]] = []  # sent, scan in the gate, stamp of the request
        self._motions: list[Any] = []
        self._send = executor.send
        executor.send = self._watched  # type: ignore[method-assign]

    def _watched(self, channel: Any, message: Message, writer: NodeContext, number: int) -> None:
        self._note(channel.topic, message)
        self._send(channel, message, writer, number)

    def _note(self, topic: Topic[Any], message: Message) -> None:
        now_ns = self._executor.now_ns
        if isinstance(message, VelocityCommand) and topic is VELOCITY_REQUEST:
            seen_ns = self._controller.seen_ns
            self._requests[message.stamp_ns] = (NEVER_NS if seen_ns is None else seen_ns, self._motion())
        elif topic is VELOCITY_COMMAND:
            seen_ns = min(self._gate.gate.seen_ns.values(), default=NEVER_NS)
            self._commands.append((now_ns, seen_ns, self._requested_ns()))
        elif isinstance(message, LaserScan | PointCloud):
            if topic is TERRAIN_MAP:
                self._terrains.append((now_ns, message.stamp_ns))
            elif topic == self._controller.scans:
                self._scans.append(TakenScan(message.stamp_ns, end_of(message), now_ns, self._motion()))

    def _requested_ns(self) -> int:
        """The stamp of the request that the gate knows of."""
        try:
            request = self._gate_context.newest(VELOCITY_REQUEST)
        except StaleInputError:
            return NEVER_NS
        return NEVER_NS if request is None else int(request.stamp_ns)

    def _motion(self) -> int:
        """The number of the path or recovery under way, 0 for none."""
        tasks = self._context.bus.tasks
        goals = (tasks[task.name].active for task in (FOLLOW_PATH, RECOVER) if task.name in tasks)
        active = next((goal for goal in goals if goal is not None and goal.is_active), None)
        if active is None:
            return 0
        with self._lock:
            if not self._motions or self._motions[-1] is not active:
                self._motions.append(active)
            return len(self._motions)

    def results(self, begin_ns: int, end_ns: int) -> dict[str, float | int | None]:
        """Return what became of the scans that ended between two instants of the executor's clock."""
        scans = [scan for scan in self._scans if begin_ns <= scan.end_ns < end_ns]
        nothing = NEVER_NS, 0
        by_gate = [KnowingCommand(sent, seen) for sent, seen, _ in self._commands]
        by_controller = [KnowingCommand(sent, *self._requests.get(asked, nothing)) for sent, _, asked in self._commands]
        through = reaction_times(scans, by_controller, in_motion=True)
        return {
            "scans": len(scans),
            "scans_in_motion": len(through),
            **summary_ms("scan_arrival", np.array([1e-9 * (scan.arrival_ns - scan.end_ns) for scan in scans])),
            **summary_ms("scan_to_gate", reaction_times(scans, by_gate, in_motion=False)),
            **summary_ms("scan_to_command", through),
            **summary_ms("scan_to_terrain_command", self._through_terrain(scans, by_controller)),
        }

    def _through_terrain(self, scans: list[TakenScan], commands: list[KnowingCommand]) -> F64:
        """As `reaction_times`, for the terrain that the costmap held when it was drawn with the scan that a command knows of."""
        if not self._terrains:
            return np.empty(0)
        sent = np.array([sent for sent, _ in self._terrains])
        arrival = {scan.stamp_ns: scan.arrival_ns for scan in self._scans}
        knowing = []
        for command in commands:
            k = int(np.searchsorted(sent, arrival.get(command.known_ns, NEVER_NS))) - 1
            known_ns = self._terrains[k][1] + SAME_NS if k >= 0 else NEVER_NS
            knowing.append(KnowingCommand(command.sent_ns, known_ns, command.motion))
        ends = [TakenScan(scan.end_ns, scan.end_ns, scan.arrival_ns, scan.motion) for scan in scans]
        return reaction_times(ends, knowing, in_motion=True)


def end_of(scan: LaserScan | PointCloud) -> int:
    """Return the instant of the last point of a scan, ns."""
    if isinstance(scan, LaserScan):
        return scan.stamp_ns + round(1e9 * scan.time_increment * max(0, len(scan.ranges) - 1))
    return scan.stamp_ns + round(1e9 * float(scan.time.max(initial=0.0)))
