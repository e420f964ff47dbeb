"""The traffic that transport is measured with has the rates it claims, and every message of it can travel."""

from collections import Counter

import numpy as np
import pytest

from ambler.evaluation.transport import robot_traffic
from ambler.wire.ros_messages import decode, encode, is_decodable


@pytest.mark.parametrize("has_cloud", [False, True])
def test_the_traffic_has_its_rates_and_survives_the_wire(has_cloud):
    delivered = list(robot_traffic(1, has_cloud=has_cloud, rng=np.random.default_rng(0)))
    rates = Counter(topic.name for topic, _, _ in delivered)
    assert rates["imu"] == rates["transforms"] == 100
    assert rates["odometry"] == 50
    assert rates["cloud" if has_cloud else "scan"] == 10
    assert rates["map"] == rates["frontiers"] == 1
    times = [time_ns for _, _, time_ns in delivered]
    assert times == sorted(times)
    for topic, message, _ in delivered:
        raw = encode(message)
        if is_decodable(topic.type) and topic.name not in ("path", "local_path"):
            assert encode(decode(topic.type, raw)) == raw
