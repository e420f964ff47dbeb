"""What truly happens in the simulator, for judges and viewers; no algorithm may read it."""

from __future__ import annotations

from ambler.core.messages import Contact
from ambler.nodes.devices.node import DeviceNode
from ambler.runtime.topics import CONTACT, STATUS, TRUE_MAP, TRUE_POSE, TRUE_START
from ambler.sim.ground_truth import GroundTruth

MAP_RESOLUTION = 0.05


class TruthNode(DeviceNode):
    """Publishes the start pose and the map once (`has_map`), poses and contacts as they happen, all in the frame `world`."""

    outputs = (TRUE_POSE, TRUE_START, TRUE_MAP, CONTACT, STATUS)

    def __init__(self, truth: GroundTruth, *, has_map: bool = True) -> None:
        super().__init__("truth", (truth,))
        self._truth, self._has_map = truth, has_map

    def prepare(self) -> None:
        now_ns = self.ctx.now_ns
        self.ctx.publish(TRUE_START, self._truth.start_pose(now_ns))
        if self._has_map:
            self.ctx.publish(TRUE_MAP, self._truth.grid(now_ns, MAP_RESOLUTION))

    def poll(self) -> None:
        for told in self._truth.read(self.ctx.now_ns):
            if isinstance(told, Contact):
                self.ctx.publish(CONTACT, told)
            else:
                self.ctx.publish(TRUE_POSE, told)
