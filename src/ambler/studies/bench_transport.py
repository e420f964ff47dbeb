"""`ambler bench transport`: encoding beside rosbags, what a recording costs, the live view's toll."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.core.messages import Message
    from ambler.evaluation.transport import Delivered
    from ambler.wire.ros_messages import Codec

BAR_SCAN_ENCODE_MS = 0.05
BAR_CLOUD_ENCODE_MS = 0.3
SECONDS = 10


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("transport", help="encode messages, record them, show them to nobody")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; exit 1 when encoding misses its bars."""
    import numpy as np

    from ambler.evaluation.results import write_results
    from ambler.evaluation.transport import robot_traffic

    begin = time.perf_counter()
    fields: dict[str, Any] = {}
    for robot, has_cloud in (("diff", False), ("spot", True)):
        traffic = list(robot_traffic(SECONDS, has_cloud=has_cloud, rng=np.random.default_rng(args.seed)))
        fields.update(_codec_fields(traffic, args.runs))
        fields.update({f"{robot}_{name}": value for name, value in _recording_fields(traffic).items()})
        fields[f"{robot}_unwatched_view_ms_per_s"] = _view_toll_ms(traffic)
    for key, value in sorted(fields.items()):
        print(f"{key:42} {value:.4f}")
    if args.json is not None:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    is_good = fields["scan_encode_ms"] <= BAR_SCAN_ENCODE_MS and fields["cloud_encode_ms"] <= BAR_CLOUD_ENCODE_MS
    return 0 if is_good else 1


def _codec_fields(traffic: list[Delivered], runs: int) -> dict[str, float]:
    """Time one message of each topic; rosbags is the peer for the bytes, our records included on both sides."""
    from ambler.wire import ros_messages

    fields: dict[str, float] = {}
    for topic, message in {topic.name: (topic, message) for topic, message, _ in traffic}.values():
        codec = ros_messages.codec_of(topic.type)
        raw = ros_messages.encode(message)
        ours = _median_ms(runs, partial(ros_messages.encode, message))
        peer = _median_ms(runs, partial(_encode_with_rosbags, codec, message))
        fields[f"{topic.name}_encode_ms"] = ours
        fields[f"{topic.name}_peer_rosbags_encode_ms"] = peer
        if codec.from_ros is not None:
            fields[f"{topic.name}_decode_ms"] = _median_ms(runs, partial(ros_messages.decode, topic.type, raw))
    return fields


def _encode_with_rosbags(codec: Codec, message: Message) -> bytes:
    from ambler.wire.ros_types import STORE

    return bytes(STORE.serialize_cdr(codec.to_ros(message), codec.ros_type))


def _recording_fields(traffic: list[Delivered]) -> dict[str, float]:
    """Processor time and bytes per second of traffic, encoding included."""
    import tempfile

    from ambler.bridges.recorder import Recorder
    from ambler.wire.ros_messages import message_definition, ros_type_of

    for topic, _, _ in traffic:
        message_definition(ros_type_of(topic.type))  # made once per process, so outside of the measurement
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder) / "recording")
        started = time.process_time()
        for topic, message, time_ns in traffic:
            recorder.on_message(topic, message, time_ns)
        recorder.close()
        ours = time.process_time() - started
        size = sum(file.stat().st_size for file in recorder.folder.iterdir())
    return {
        "messages_per_s": len(traffic) / SECONDS,
        "recording_cpu_ms_per_s": 1e3 * ours / SECONDS,
        "recording_kb_per_s": 1e-3 * size / SECONDS,
    }


def _view_toll_ms(traffic: list[Delivered]) -> float:
    from ambler.bridges.foxglove import FoxgloveBridge

    bridge = FoxgloveBridge(port=0)
    started = time.perf_counter()
    for topic, message, time_ns in traffic:
        bridge.on_message(topic, message, time_ns)
    toll = time.perf_counter() - started
    bridge.close()
    return 1e3 * toll / SECONDS


def _median_ms(runs: int, work: Callable[[], object]) -> float:
    import statistics

    times = []
    for _ in range(runs + 1):
        started = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - started))
    return statistics.median(times[1:])
