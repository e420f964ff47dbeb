"""The battery on the bus."""

from __future__ import annotations

from ambler.core.devices import Battery
from ambler.nodes.devices.node import DeviceNode
from ambler.runtime.tasks import STOP_CHARGING, Nothing
from ambler.runtime.topics import BATTERY, STATUS


class BatteryNode(DeviceNode):
    """Publishes the state of the battery; ends charging on request."""

    outputs = (BATTERY, STATUS)
    serves = (STOP_CHARGING,)

    def __init__(self, battery: Battery) -> None:
        super().__init__("battery", (battery,))
        self._battery = battery

    def prepare(self) -> None:
        self.ctx.serve(STOP_CHARGING, self._on_stop_charging)

    def poll(self) -> None:
        for state in self._battery.read(self.ctx.now_ns):
            self.ctx.publish(BATTERY, state)

    def _on_stop_charging(self, request: Nothing) -> Nothing:
        self._battery.stop_charging()
        return Nothing()
