"""Disks that are full or stalled, and recorders, taps, listeners and logs that raise, neither delay nor prevent a stop."""

import json
import os
import re
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from ambler.bridges.recorder import Recorder
from ambler.core.messages import VelocityCommand
from ambler.runtime.clock import SystemClock
from ambler.runtime.executor import Executor, NodeFailedError
from ambler.runtime.live import LiveExecutor
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.log import RunLog
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.topics import TELEOP_REQUEST
from ambler.wire.mcap_file import McapRecorder
from ambler.wire.mcap_reader import read_recording
from tests.runtime.toys import Bomb, Filter, Source

pytestmark = pytest.mark.live

EXECUTORS = [LockstepExecutor, LiveExecutor]


class BrokenLog(RunLog):
    """A log of somebody else's making that raises whatever it is told."""

    def write(self, stamp_ns: int, node: str, code: str, text: str, **fields: Any) -> None:
        raise OSError(28, "No space left on device")


class Talker(Source):
    """Logs at every tick."""

    def _tick(self) -> None:
        super()._tick()
        self.ctx.log("TICK", "one more", number=self.sent)


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_log_that_raises_reaches_no_node_and_prevents_no_stop(executor_type: type[Executor]) -> None:
    """A full log disk made a failing node go unnoticed."""
    reasons: list[str] = []
    talker = Talker()
    with executor_type(Stack([talker, Bomb()]), log=BrokenLog(), on_failure=reasons.append) as executor:  # type: ignore[abstract]
        with pytest.raises(NodeFailedError, match="bomb failed"):
            executor.run(10.0)
        assert len(reasons) == 1
        assert talker.sent > 5
        assert not executor.context_of("source").is_failed
        assert executor.troubles.counts["LOG_FAILED"] >= talker.sent
        assert "No space left" in executor.troubles.texts["LOG_FAILED"]


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_the_robot_is_stopped_before_anything_is_told(executor_type: type[Executor]) -> None:
    order: list[str] = []
    log = RunLog()

    class SlowLog(RunLog):
        def write(self, stamp_ns: int, node: str, code: str, text: str, **fields: Any) -> None:
            order.append(code)

    log = SlowLog()
    executor = executor_type(Stack([Bomb()]), log=log, on_failure=lambda reason: order.append("stop"))  # type: ignore[abstract]
    with executor, pytest.raises(NodeFailedError):
        executor.run(10.0)
    assert order == ["stop", "NODE_FAILED"]


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_stop_that_fails_still_ends_the_run(executor_type: type[Executor]) -> None:
    def no_gate(reason: str) -> None:
        raise KeyError("gate")

    with executor_type(Stack([Bomb(), Source()]), on_failure=no_gate) as executor:  # type: ignore[abstract]
        with pytest.raises(NodeFailedError, match="bomb failed"):
            executor.run(10.0)
        assert executor.troubles.counts == {"STOP_FAILED": 1}


class Unspeakable(Exception):
    def __str__(self) -> str:
        raise RuntimeError("not even this")


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_an_error_that_cannot_say_its_text_stops_the_robot_as_well(executor_type: type[Executor]) -> None:
    class Weird(Bomb):
        def _tick(self) -> None:
            raise Unspeakable

    with executor_type(Stack([Weird()])) as executor, pytest.raises(NodeFailedError, match="Unspeakable"):  # type: ignore[abstract]
        executor.run(10.0)


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_tap_that_raises_is_told_once_and_not_asked_again(executor_type: type[Executor]) -> None:
    calls: list[str] = []
    source = Source()
    records: list[dict[str, Any]] = []
    log = RunLog()
    log.listen(records.append)

    def broken(*shown: Any) -> None:
        calls.append("broken")
        raise ValueError("what is this?")

    with executor_type(Stack([source, Filter()]), log=log) as executor:  # type: ignore[abstract]
        executor.tap(broken)
        executor.tap(lambda *shown: calls.append("good"))
        executor.run(0.5)
        assert calls.count("broken") == 1
        assert calls.count("good") > source.sent
        assert executor.troubles.counts == {"TAP_FAILED": 1}
    assert [r["text"] for r in records if r["code"] == "TAP_FAILED"] == ["ValueError: what is this?"]


def test_a_tap_that_stalls_delays_no_delivery_live() -> None:
    release, source, heard = threading.Event(), Source(), Filter()
    executor = LiveExecutor(Stack([source, heard]))
    executor.tap(lambda *shown: release.wait(30.0))
    runner = threading.Thread(target=lambda: executor.run(1.0))
    started = time.monotonic()
    runner.start()
    while getattr(source, "sent", 0) < 15:
        time.sleep(0.01)
        assert time.monotonic() - started < 20.0
    ages = [t for t, _ in heard.heard]
    release.set()
    runner.join()
    executor.close()
    assert len(ages) >= 14


class FullDisk(McapRecorder):
    """Takes ten messages, refuses one, and would take more again."""

    refusals = 0

    def write(self, *args: Any, **kwargs: Any) -> None:
        if self.message_count == 10 and not self.refusals:
            self.refusals += 1
            raise OSError(28, "No space left on device")
        super().write(*args, **kwargs)


@pytest.mark.parametrize("executor_type", EXECUTORS)
def test_a_full_disk_ends_the_recording_and_not_the_run(
    executor_type: type[Executor], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ambler.bridges.recorder.McapRecorder", FullDisk)
    source = Source()
    with executor_type(Stack([source, Filter()])) as executor:  # type: ignore[abstract]
        recorder = Recorder(tmp_path / "run", executor.troubles.note, is_lossy=executor_type is LiveExecutor)
        executor.tap(recorder.on_message)
        executor.run(1.0)
        recorder.close()
        assert source.sent >= 15
        assert executor.troubles.counts == {"RECORDING_FAILED": 1}
    assert recorder.failure == "OSError: [Errno 28] No space left on device"
    assert len(list(read_recording(tmp_path / "run"))) == 10, "what was written before can be read"


def test_what_still_waits_when_a_recording_fails_is_not_written_behind_the_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ambler.bridges.recorder.McapRecorder", FullDisk)
    recorder = Recorder(tmp_path / "run")
    for i, command in enumerate(commands(50)):
        recorder._conveyor.put((TELEOP_REQUEST, command, i, ""))
    recorder.close()
    assert [r.decode_as(VelocityCommand).vx for r in read_recording(tmp_path / "run")] == [float(i) for i in range(10)]


class StalledDisk(McapRecorder):
    """Takes nothing before `release` is set."""

    release = threading.Event()

    def write(self, *args: Any, **kwargs: Any) -> None:
        self.release.wait(30.0)
        super().write(*args, **kwargs)


def commands(count: int) -> list[VelocityCommand]:
    return [VelocityCommand(i, float(i)) for i in range(count)]


def test_live_a_stalled_disk_loses_and_counts_messages_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ambler.bridges.recorder.McapRecorder", StalledDisk)
    StalledDisk.release.clear()
    told: list[tuple[str, str]] = []
    recorder = Recorder(tmp_path / "run", lambda *what: told.append(what), is_lossy=True, capacity=100)
    started = time.monotonic()
    for i, command in enumerate(commands(500)):
        recorder.on_message(TELEOP_REQUEST, command, i)
    assert time.monotonic() - started < 5.0, "nobody waits for the disk"
    StalledDisk.release.set()
    recorder.close()
    lost = recorder.drops["/cmd_vel_teleop"]
    assert 399 <= lost <= 400, "the hundred that wait, and the one under way"
    assert told == [
        (
            "RECORDING_INCOMPLETE",
            f"the recording lacks messages that the disk was too slow for: {lost} of /cmd_vel_teleop",
        )
    ]
    kept = [r.decode_as(VelocityCommand).vx for r in read_recording(tmp_path / "run")]
    assert kept == [float(i) for i in range(500 - lost)], "in their order"


def test_in_lockstep_a_stalled_disk_makes_the_run_wait_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ambler.bridges.recorder.McapRecorder", StalledDisk)
    StalledDisk.release.clear()
    recorder = Recorder(tmp_path / "run", capacity=100)
    done = threading.Event()

    def record() -> None:
        for i, command in enumerate(commands(500)):
            recorder.on_message(TELEOP_REQUEST, command, i)
        done.set()

    thread = threading.Thread(target=record)
    thread.start()
    assert not done.wait(0.2)
    StalledDisk.release.set()
    thread.join()
    recorder.close()
    assert [r.decode_as(VelocityCommand).vx for r in read_recording(tmp_path / "run")] == [float(i) for i in range(500)]
    assert recorder.drops == {}


class Full:
    """A file on a full disk: takes half of one line, then nothing until it has space again."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream
        self.is_full = True

    def write(self, data: bytes) -> int:
        if not self.is_full:
            return int(self.stream.write(data))
        raise OSError(28, "No space left on device")

    def close(self) -> None:
        self.stream.close()


def test_a_full_log_disk_loses_lines_counts_them_and_goes_on_when_there_is_space(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "log.jsonl", "run")
    log.write(1, "node", "FIRST", "before")
    assert log.flush()
    assert log._file is not None
    full = log._file._stream = Full(log._file._stream)  # type: ignore[assignment]
    log.write(2, "node", "SECOND", "lost")
    assert log.flush()
    full.stream.write(b'{"torn')  # type: ignore[attr-defined]
    log._file._is_torn, full.is_full = True, False  # type: ignore[attr-defined]
    log.write(3, "node", "THIRD", "after")
    log.close()
    lines = (tmp_path / "log.jsonl").read_text().splitlines()
    assert [json.loads(line)["code"] for line in (lines[0], *lines[2:])] == ["FIRST", "THIRD", "LOG_LINES_LOST"]
    assert log.lost == 1


def test_a_listener_that_raises_does_not_keep_the_line_from_others(tmp_path: Path) -> None:
    log, heard = RunLog(), list[str]()
    log.listen(lambda record: 1 // 0)
    log.listen(lambda record: heard.append(record["code"]))
    log.write(1, "node", "A", "")
    log.write(2, "node", "B", "", field=object())
    log.close()
    assert heard == ["A", "B"]
    assert log.troubles == {"listener: ZeroDivisionError": 2}
    log.write(3, "node", "C", "")
    assert heard == ["A", "B"]


def test_the_log_has_a_size_limit(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "log.jsonl", max_bytes=1000)
    for i in range(100):
        log.write(i, "node", "LINE", "x" * 20)
    log.close()
    assert 900 < (tmp_path / "log.1.jsonl").stat().st_size <= 1000
    assert (tmp_path / "log.jsonl").stat().st_size <= 1000
    text = "".join((tmp_path / name).read_text() for name in ("log.1.jsonl", "log.jsonl"))
    kept = [json.loads(line) for line in text.splitlines()]
    assert [r["stamp_ns"] for r in kept] == list(range(100 - len(kept), 100)), "the newest, without a gap"


def test_live_a_log_that_stalls_drops_and_counts_lines() -> None:
    release, heard = threading.Event(), list[int]()

    def stalled(record: dict[str, Any]) -> None:
        release.wait(30.0)
        heard.append(record["stamp_ns"])

    log = RunLog()
    log.listen(stalled)
    LiveExecutor(Stack([Source()]), log=log).close()
    for i in range(6000):
        log.write(i, "node", "LINE", "")
    release.set()
    log.close()
    assert heard == list(range(len(heard)))
    assert log.lost == 6000 - len(heard) > 1000


class Restless(Node):
    """Notes when it is called, every 20 ms, as the gate is."""

    name = "restless"

    def start(self) -> None:
        self.ticks: list[int] = []
        self.ctx.timer(0.02, lambda: self.ticks.append(self.ctx.now_ns))


def test_a_live_timer_does_not_drift_and_leaves_out_what_it_missed() -> None:
    class Stumbling(Restless):
        def start(self) -> None:
            super().start()
            self.ctx.after(0.1, lambda: time.sleep(0.13))

    node = Stumbling()
    executor = LiveExecutor(Stack([node]))
    executor.run(0.6)
    executor.close()
    phases = [tick % 20_000_000 for tick in node.ticks]
    grid = sorted(phases)[len(phases) // 2]
    late = [(phase - grid + 10_000_000) % 20_000_000 - 10_000_000 for phase in phases]
    assert sum(abs(off) < 5_000_000 for off in late) > 0.7 * len(late), "they keep to their grid"
    assert 18 <= len(node.ticks) <= 26, "some six were missed, and are not made up for in a burst"
    gaps = [b - a for a, b in zip(node.ticks, node.ticks[1:], strict=False)]
    assert max(gaps) > 100_000_000


def test_a_live_run_keeps_its_time_when_the_time_of_day_jumps_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    true_time, jump = time.time_ns, [0]
    monkeypatch.setattr("ambler.runtime.clock.time.time_ns", lambda: true_time() + jump[0])

    class Setter(Restless):
        def start(self) -> None:
            super().start()
            self.ctx.after(0.3, lambda: jump.__setitem__(0, 3_600_000_000_000))

    node = Setter()
    executor = LiveExecutor(Stack([node]), SystemClock(from_zero=False))
    assert abs(executor.now_ns - true_time()) < 1_000_000_000
    executor.run(1.3)
    executor.close()
    assert executor.troubles.counts == {"CLOCK_JUMPED": 1}
    told = re.search(r"moved by ([+-][\d.]+) s", executor.troubles.texts["CLOCK_JUMPED"])
    assert told is not None
    assert float(told[1]) == pytest.approx(3600.0, abs=0.2), "beside it, the two clocks are read one after the other"
    assert node.ticks[-1] - node.ticks[0] < 3_000_000_000


def test_live_the_threads_that_command_go_before_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []
    monkeypatch.setattr(
        "ambler.runtime.live.os.setpriority",
        lambda which, who, priority: asked.append((threading.current_thread().name, priority)),
    )

    class Wheel(Restless):
        name = "wheel"
        commands = True

    class Thinker(Restless):
        def start(self) -> None:
            super().start()
            self.ctx.background(lambda: 1, 0.01, lambda one: None)

    executor = LiveExecutor(Stack([Wheel(), Thinker()]))
    executor.run(0.2)
    executor.close()
    here = threading.current_thread().name
    raised, *behind, back = asked
    assert (raised, back) == ((here, -10), (here, os.getpriority(os.PRIO_PROCESS, 0))), (
        "of this thread; others inherit it"
    )
    assert sorted(behind) == [("background-mapping_0", -5), ("outside", -5), ("restless", -5)]
