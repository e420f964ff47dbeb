"""A viewer connects to a running robot, sees it, and sends it somewhere with one click."""

import json
import threading
from pathlib import Path

import pytest

from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.messages import Odometry, PoseStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.runtime.lockstep import LockstepExecutor
from ambler.wire.ros_messages import decode, encode
from tests.bridges.viewer import Viewer

pytestmark = pytest.mark.live

GOAL = SE2(1.5, 1.0, 1.57)


@pytest.mark.parametrize("encoding", ["cdr", "json"])
def test_a_clicked_goal_drives_the_robot_there(encoding: str, tmp_path: Path) -> None:
    demo = SimulatedRun(RunOptions(world="lab_empty", port=0, time_limit=90.0), RunFolder(tmp_path / "run"))
    demo.executor.contexts[-1].is_failed = True  # nobody explores: the operator node is switched off
    gate = demo.executor.stack.node("gate")
    seen: dict[str, int] = {}
    truth: list[SE2] = []

    def watch(viewer: Viewer) -> None:
        for topic in ("/map", "/scan", "/tf", "/cmd_vel", "/ground_truth/pose"):
            viewer.subscribe(topic)
        pose = PoseStamped(0, "map", SE3.from_se2(GOAL))
        payload = encode(pose) if encoding == "cdr" else _json_pose(GOAL)
        while not stop.is_set():
            try:
                frame = viewer.receive(timeout=2.0)
            except TimeoutError:  # the run is over
                return
            if frame is None:
                continue
            topic, _, data = frame
            seen[topic] = seen.get(topic, 0) + 1
            if topic == "/cmd_vel" and seen[topic] == 20 and "/map" in seen:  # as a person would, who sees the map
                viewer.publish("/goal_pose", encoding, "geometry_msgs/PoseStamped", payload)
            if topic == "/ground_truth/pose":
                truth.append(demo.scene.start.inverse() @ decode(Odometry, data).pose.to_se2())
                if truth[-1].distance_to(GOAL) < 0.25:
                    demo.executor.stop()

    assert isinstance(demo.executor, LockstepExecutor)
    demo.executor.clock.pace(6.0)
    demo.executor.contexts[0].after(1.0, lambda: gate.gate.arm(demo.executor.now_ns))  # type: ignore[attr-defined]
    stop = threading.Event()
    runner = threading.Thread(target=demo.run)
    runner.start()
    try:
        while demo.view is None and runner.is_alive():
            runner.join(0.05)
        assert demo.view is not None
        with Viewer(demo.view.port) as viewer:
            watcher = threading.Thread(target=watch, args=(viewer,), daemon=True)
            watcher.start()
            runner.join()
            stop.set()
            watcher.join(12.0)
    finally:
        demo.close()
    assert truth, "the viewer saw where the robot is"
    assert min(p.distance_to(GOAL) for p in truth) < 0.25
    assert all(seen.get(topic, 0) > 0 for topic in ("/map", "/scan", "/tf", "/cmd_vel"))


def _json_pose(pose: SE2) -> bytes:
    q = SE3.from_se2(pose).rotation
    return json.dumps(
        {
            "header": {"stamp": {"sec": 0, "nsec": 0}, "frame_id": "map"},
            "pose": {
                "position": {"x": pose.x, "y": pose.y, "z": 0.0},
                "orientation": {"w": q[0], "x": q[1], "y": q[2], "z": q[3]},
            },
        }
    ).encode()
