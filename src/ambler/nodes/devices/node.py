"""What the nodes of all devices share: the device's life, reading in its rhythm, and telling changes of its health."""

from __future__ import annotations

import json
from collections.abc import Sequence

from ambler.core.devices import Announces, Device, DeviceHealth, DeviceState
from ambler.core.messages import Status
from ambler.runtime.node import Node
from ambler.runtime.topics import STATUS

HEALTH_PERIOD = 0.25
FAILED, RECOVERED, CLOCK_JUMPED = "DEVICE_FAILED", "DEVICE_RECOVERED", "DEVICE_CLOCK_JUMPED"


class DeviceNode(Node):
    """Opens its devices in `start` (a device that cannot be opened raises DeviceError there), reads them, closes them at the end."""

    latency = 1e-6

    def __init__(self, name: str, devices: Sequence[Device]) -> None:
        self.name = name
        self._devices = tuple(devices)
        self._known = {d.name: DeviceHealth(DeviceState.OPEN) for d in devices}

    def start(self) -> None:
        for device in self._devices:
            device.open()
        self.prepare()
        for device in self._devices:
            if isinstance(device, Announces):
                device.announce(lambda: self.ctx.after(0.0, self.poll))
        periods = [d.poll_period for d in self._devices if not isinstance(d, Announces)]
        if periods:
            self.ctx.timer(min(periods), self.poll)
        self.poll()
        self.ctx.timer(HEALTH_PERIOD, self._look_after)

    def stop(self) -> None:
        for device in self._devices:
            device.close()

    def prepare(self) -> None:
        """Subscribe, serve and publish what is known from the start; the devices are open."""

    def poll(self) -> None:
        """Read the devices and publish what came."""

    def _look_after(self) -> None:
        for device in self._devices:
            health, known = device.health(), self._known[device.name]
            if health.state is not known.state:
                is_failed = health.state is DeviceState.FAILED
                text = health.text or f"{device.name} is {health.state.value}"
                self._tell(FAILED if is_failed else RECOVERED, device.name, text, health)
            if health.clock_jumps > known.clock_jumps:
                self._tell(CLOCK_JUMPED, device.name, f"the clock of {device.name} jumped", health)
            self._known[device.name] = health

    def _tell(self, code: str, device: str, text: str, health: DeviceHealth) -> None:
        fields = {
            "device": device,
            "messages": health.messages,
            "lost": health.lost,
            "clock_jumps": health.clock_jumps,
            "clock_offset": health.clock_offset,
        }
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, text, json.dumps(fields)))
        self.ctx.log(code, text, **fields)
