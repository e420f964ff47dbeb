"""A driver of one's own: the battery of the computer itself, as Linux tells it. Run it: `python examples/own_driver.py`."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ambler.apps.robot import Parts
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.devices import DeviceHealth, DeviceState
from ambler.core.errors import DeviceError
from ambler.core.messages import BatteryState, PowerSupply
from ambler.core.se2 import SE2
from ambler.nodes.steps import NavigateStep
from ambler.wire.mcap_reader import read_recording

SUPPLIES = {"Charging": PowerSupply.CHARGING, "Discharging": PowerSupply.DISCHARGING, "Full": PowerSupply.FULL}


class LinuxBattery:
    """A `Battery` (core.devices) read from a folder such as /sys/class/power_supply/BAT0: volts, amperes and the share that is left."""

    poll_period = 1.0

    def __init__(self, folder: Path, name: str = "battery") -> None:
        self.name = name
        self._folder = folder
        self._health = DeviceHealth(DeviceState.CLOSED)

    def open(self) -> None:
        if not (self._folder / "capacity").is_file():
            raise DeviceError(f"{self._folder} is no battery: it has no file `capacity`")
        self._health = DeviceHealth(DeviceState.OPEN)

    def health(self) -> DeviceHealth:
        return self._health

    def close(self) -> None:
        self._health = DeviceHealth(DeviceState.CLOSED)

    def stop_charging(self) -> None:
        """Do nothing: this charger obeys nobody."""

    def read(self, now_ns: int) -> Sequence[BatteryState]:
        if self._health.state is not DeviceState.OPEN:
            return ()
        try:
            share = float(self._text("capacity")) / 100.0
            volts, amperes = float(self._text("voltage_now")) * 1e-6, float(self._text("current_now")) * 1e-6
            supply = SUPPLIES.get(self._text("status"), PowerSupply.UNKNOWN)
        except (OSError, ValueError) as error:
            self._health = DeviceHealth(DeviceState.FAILED, f"{self.name}: {error}", self._health.messages)
            return ()
        self._health = replace(self._health, messages=self._health.messages + 1)
        current = amperes if supply is PowerSupply.CHARGING else -amperes
        return (BatteryState(now_ns, "base", volts, current, share, supply),)

    def _text(self, name: str) -> str:
        return (self._folder / name).read_text(encoding="ascii").strip()


def main(out: Path, battery: Path) -> dict[str, object]:
    """Drive a simulated robot whose battery is real; returns what its last message said."""
    options = RunOptions((NavigateStep(SE2(1.5, 0.0, 0.0)),), "lab_empty", "diff", port=None, time_limit=60.0)
    parts = Parts(devices=lambda devices: replace(devices, battery=LinuxBattery(battery)))
    run = SimulatedRun(options, RunFolder(out), parts=parts)
    try:
        run.run()
    finally:
        run.close()
    told = [m.decode_as(BatteryState) for m in read_recording(run.robot.folder.recording, ["/battery_state"])]
    last = told[-1]
    return {
        "ended": run.ended,
        "messages": len(told),
        "voltage": last.voltage,
        "share": last.share,
        "supply": last.supply,
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        where = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("/sys/class/power_supply/BAT0")
        print(main(Path(folder) / "run", where))
