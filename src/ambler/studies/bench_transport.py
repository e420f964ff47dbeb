"""Encoding beside rosbags, what a recording costs, the live view's toll."""

from __future__ import annotations

import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from ambler.bridges.foxglove import FoxgloveBridge
from ambler.bridges.recorder import Recorder
from ambler.core.messages import Message
from ambler.evaluation.transport import Delivered, robot_traffic
from ambler.studies.timing import median_ms
from ambler.wire import ros_messages
from ambler.wire.ros_messages import Codec, message_definition, ros_type_of
from ambler.wire.ros_types import STORE

BAR_SCAN_ENCODE_MS = 0.05
BAR_CLOUD_ENCODE_MS = 0.3
SECONDS = 10


def measure(runs: int, seed: int) -> dict[str, float]:
    """Return times of codecs, medians of `runs`, and what a recording and a view that nobody watches cost per second."""
    fields: dict[str, float] = {}
    for robot, has_cloud in (("diff", False), ("spot", True)):
        traffic = list(robot_traffic(SECONDS, has_cloud=has_cloud, rng=np.random.default_rng(seed)))
        fields |= _codec_fields(traffic, runs)
        fields |= {f"{robot}_{name}": value for name, value in _recording_fields(traffic).items()}
        fields[f"{robot}_unwatched_view_ms_per_s"] = _view_toll_ms(traffic)
    return fields


def meets_bars(fields: dict[str, float]) -> bool:
    """Whether scans and clouds are encoded quickly enough."""
    return fields["scan_encode_ms"] <= BAR_SCAN_ENCODE_MS and fields["cloud_encode_ms"] <= BAR_CLOUD_ENCODE_MS


def _codec_fields(traffic: list[Delivered], runs: int) -> dict[str, float]:
    """Time one message of each topic; rosbags is the peer for the bytes, our records included on both sides."""
    fields: dict[str, float] = {}
    for topic, message in {topic.name: (topic, message) for topic, message, _ in traffic}.values():
        codec = ros_messages.codec_of(topic.type)
        raw = ros_messages.encode(message)
        ours = median_ms(partial(ros_messages.encode, message), runs, uncounted_runs=1)
        peer = median_ms(partial(_encode_with_rosbags, codec, message), runs, uncounted_runs=1)
        fields[f"{topic.name}_encode_ms"] = ours
        fields[f"{topic.name}_peer_rosbags_encode_ms"] = peer
        if codec.from_ros is not None:
            fields[f"{topic.name}_decode_ms"] = median_ms(
                partial(ros_messages.decode, topic.type, raw), runs, uncounted_runs=1
            )
    return fields


def _encode_with_rosbags(codec: Codec, message: Message) -> bytes:
    return bytes(STORE.serialize_cdr(codec.to_ros(message), codec.ros_type))


def _recording_fields(traffic: list[Delivered]) -> dict[str, float]:
    """Processor time and bytes per second of traffic, encoding included."""
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
    bridge = FoxgloveBridge(port=0)
    started = time.perf_counter()
    for topic, message, time_ns in traffic:
        bridge.on_message(topic, message, time_ns)
    toll = time.perf_counter() - started
    bridge.close()
    return 1e3 * toll / SECONDS
