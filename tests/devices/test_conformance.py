"""The conformance suite over every device there is: serial, streamed, evdev, recorded, simulated."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from ambler.core.devices import Camera
from tests.devices import conformance as c
from tests.devices.rigs import (
    RECORDED,
    STREAM_MAKERS,
    joystick_rig,
    recorded_rig,
    serial_rig,
    simulated_rig,
    stream_rig,
)

Make = Callable[[Path], AbstractContextManager[Any]]
RIGS: dict[str, Make] = {
    **{f"serial_{part}": lambda folder, part=part: serial_rig(folder, part) for part in ("base", "battery")},
    **{f"stream_{part}": lambda folder, part=part: stream_rig(folder, part) for part in STREAM_MAKERS},
    "evdev_joystick": joystick_rig,
    **{f"recorded_{part}": lambda folder, part=part: recorded_rig(folder, part) for part in RECORDED},
    **{
        f"simulated_{part}": lambda _, robot=robot, part=part: simulated_rig(robot, part)
        for robot, part in (
            ("diff", "base"),
            ("diff", "lidar"),
            ("diff", "imu"),
            ("diff+ultrasonic", "range"),
            ("amr_omni", "camera"),
            ("spot+depth", "depth_camera"),
            ("diff", "battery"),
        )
    },
}
BREAKABLE = [name for name in RIGS if not name.startswith(("recorded", "simulated"))]


@pytest.fixture
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    with RIGS[request.param](tmp_path) as rig:
        if "camera" in request.param:
            _want_pictures(rig)
        yield rig


def _want_pictures(rig: Any) -> None:
    """A camera takes pictures while they are wanted: whoever reads one here wants them for the next second."""
    camera: Camera = rig.device
    read = camera.read

    def wanting(now_ns: int) -> Any:
        camera.request(now_ns + 10**9)
        return read(now_ns)

    camera.read = wanting  # type: ignore[method-assign]


every = pytest.mark.parametrize("rig", RIGS, indirect=True)


@every
def test_life(rig: Any) -> None:
    c.check_life(rig)


@every
def test_stamps(rig: Any) -> None:
    c.check_stamps(rig)


@every
def test_reading_never_waits(rig: Any) -> None:
    c.check_reading_never_waits(rig)


@pytest.mark.parametrize("rig", ["serial_base", "simulated_base"], indirect=True)
def test_base(rig: Any) -> None:
    c.check_base(rig)


@pytest.mark.parametrize("rig", BREAKABLE, indirect=True)
def test_failure(rig: Any) -> None:
    c.check_failure(rig)
