"""The driver of docs/drivers.md passes the conformance suite as it stands, and the tables agree with the code."""

import os
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ambler.drivers.serial_frame import Frame, FrameKind, encode_frame
from ambler.drivers.stream_frame import StreamKind
from tests.devices import conformance
from tests.devices.fakes import HOST, Stepper
from tests.devices.rigs import LiveRig

PAGE = (Path(__file__).parents[2] / "docs" / "drivers.md").read_text()


def example() -> dict[str, Any]:
    found = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    names: dict[str, Any] = {}
    exec(compile(found.group(1), "drivers.md", "exec"), names)
    return names


@pytest.mark.parametrize(
    "check",
    [
        conformance.check_life,
        conformance.check_stamps,
        conformance.check_reading_never_waits,
        conformance.check_failure,
    ],
)
def test_the_example_is_a_device(check: Callable[[Any], None], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "line")
    ends = [os.open(tmp_path / "line", os.O_RDWR | os.O_NONBLOCK)]
    lock = threading.Lock()

    def send(now_ns: int) -> None:
        with lock:
            for end in ends:
                os.write(end, b"%d 1.25\n" % ((now_ns // 1000 + 2**31) % 2**32))

    def end() -> None:
        with lock:
            os.close(ends.pop())

    rig = LiveRig(example()["LineRangeSensor"](tmp_path / "line", "front", "front_range"))
    rig.breaks = end
    with Stepper(send, HOST):
        check(rig)
        rig.device.close()
    for fd in ends:
        os.close(fd)


def test_the_tables_name_every_kind_of_frame() -> None:
    told = {int(number, 16): name for number, name in re.findall(r"\| (0x\d+) ([a-z ]+?) \|", PAGE)}
    assert told == {int(kind): kind.name.lower().replace("_", " ") for kind in FrameKind}
    streamed = {int(number): name for number, name in re.findall(r"\| (\d+) ([a-z ]+?) \|", PAGE)}
    assert streamed == {int(kind): kind.name.lower().replace("_", " ") for kind in StreamKind}


def test_the_size_of_an_odometry_on_the_line() -> None:
    size = len(encode_frame(Frame(FrameKind.ODOMETRY, 0, 0, bytes(108))))
    assert f"takes {size} bytes" in PAGE
    assert f"{50 * size * 10 / 115200:.0%}".replace("%", " %") in PAGE
