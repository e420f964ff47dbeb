"""The parts of the live view alone: rates, the queue of a slow client, and the layout that is shipped."""

import asyncio
import json
import math
import re
import time
from importlib import resources
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.frames import Frame, Opcode

from ambler.bridges.foxglove import CLIENT_TOPICS
from ambler.bridges.foxglove_front import SUBPROTOCOL, FrameQueue
from ambler.bridges.large_frames import LargeFrameDeflate
from ambler.bridges.view_rates import EVENT_BACKLOG, Outbox
from ambler.core import messages as m
from ambler.core.se3 import SE3
from ambler.runtime import topics
from ambler.wire.ros_messages import ros_type_of
from ambler.wire.ros_types import STORE
from ambler.wire.ros_viewers import viewer_definition


def command(k):
    return m.VelocityCommand(k, float(k))


def test_only_the_newest_message_waits_and_rates_count_in_wall_time():
    box = Outbox(topics.VELOCITY_COMMAND, rate_hz=10.0)
    for k in range(5):
        box.put(command(k), k)
    assert [message.stamp_ns for message, _ in box.take(100.0)] == [4]
    box.put(command(5), 5)
    assert box.take(100.05) == []
    assert [message.stamp_ns for message, _ in box.take(100.11)] == [5]
    assert box.take(200.0) == []
    assert (box.counts.sent, box.counts.skipped) == (2, 4)


def test_events_are_all_shown_up_to_a_bounded_backlog():
    box = Outbox(topics.STATUS, rate_hz=math.inf)
    for k in range(EVENT_BACKLOG + 7):
        box.put(m.Status(k, "node", "CODE", "text"), k)
    assert [time_ns for _, time_ns in box.take(0.0)] == list(range(7, EVENT_BACKLOG + 7))
    assert box.counts.skipped == 7


def test_transforms_are_merged_to_the_newest_of_every_edge():
    box = Outbox(topics.TRANSFORMS)
    for k in range(4):
        child = "base" if k % 2 == 0 else "odom"
        box.put(m.Transforms(k, (m.TransformStamped(k, "up", child, SE3((float(k), 0.0, 0.0))),)), k)
    [(tree, time_ns)] = box.take(0.0)
    assert time_ns == 3
    assert {edge.child: edge.stamp_ns for edge in tree.transforms} == {"base": 2, "odom": 3}
    assert box.take(1.0) == []


def test_a_full_slot_keeps_the_newest_frame_and_control_overtakes_data():
    async def run():
        frames = FrameQueue()
        frames.set_depth(2, 3)
        for k in range(5):
            frames.put_data(1, f"scan {k}")
            frames.put_data(2, f"status {k}")
        frames.put_control("advertise")
        taken = [await frames.take() for _ in range(5)]
        return taken, frames.dropped

    taken, dropped = asyncio.run(run())
    assert taken == ["advertise", "scan 4", "status 2", "status 3", "status 4"]
    assert dropped == 6


class SlowLine:
    """A line of so many bytes per second, in its own time; odometry comes at 30 Hz and three grids at 1 Hz."""

    def __init__(self, bytes_per_second, grid_bytes):
        self.now = 0.0
        self._rate, self._grid_bytes, self._begun = bytes_per_second, grid_bytes, 0
        self.frames = FrameQueue(lambda: self.now)

    def run(self, seconds):
        """Return (topic, time) of what arrived."""
        arrived = []
        while self.now < seconds:
            self._put_what_has_come()
            frame = asyncio.run(self.frames.take())
            self.now += len(frame) / self._rate
            self.frames.note_sent(frame, len(frame) / self._rate)
            arrived.append((frame[:1], self.now))
            self.now = max(self.now, self._begun / 30)
        return arrived

    def _put_what_has_come(self):
        while self._begun / 30 <= self.now:
            self.frames.put_data(1, b"o" * 700)
            if self._begun % 30 == 0:
                for grid in (2, 3, 4):
                    self.frames.put_data(grid, bytes([grid]) * self._grid_bytes)
            self._begun += 1


@pytest.mark.parametrize(("grid_bytes", "gap", "share"), [(100_000, 3.4, 0.4), (20_000, 0.75, 0.4)])
def test_on_a_slow_line_small_frames_go_before_grids_and_grids_still_come(grid_bytes, gap, share):
    """30 kB/s with grids of 100 kB: each takes 3.3 s, then odometry flows at its rate for as long."""
    arrived = SlowLine(30e3, grid_bytes).run(60.0)
    small = [time for kind, time in arrived if kind == b"o"]
    assert arrived[0][0] == b"o"
    assert max(b - a for a, b in pairwise(small)) < gap  # one grid at most between two of them
    assert len(small) > share * 60.0 * 30.0
    kinds = [kind for kind, _ in arrived if kind != b"o"]
    assert len(kinds) * grid_bytes > 0.3 * 60.0 * 30e3
    assert len(set(kinds)) == 3


def test_a_large_frame_waits_for_its_time_though_nothing_else_comes():
    async def run():
        frames = FrameQueue()
        frames.note_sent(b"g" * 100_000, 0.05)
        frames.put_data(1, b"g" * 100_000)
        begin = time.monotonic()
        await frames.take()
        return time.monotonic() - begin

    assert 0.04 < asyncio.run(run()) < 2.0


def test_maps_are_compressed_for_viewers_that_can_and_clouds_are_not():
    grid, noise = bytes(500_000), np.random.default_rng(1).bytes(500_000)
    deflate = LargeFrameDeflate(True, True, 15, 15, {"level": 1})
    sent = [deflate.encode(Frame(Opcode.BINARY, data)) for data in (grid, noise, grid[:1000])]
    assert [frame.rsv1 for frame in sent] == [True, False, False]
    assert len(sent[0].data) < 5_000
    assert [bytes(frame.data) for frame in sent[1:]] == [noise, grid[:1000]]


@pytest.mark.parametrize("topic", topics.all_topics(), ids=lambda topic: topic.name)
def test_definitions_are_those_that_viewers_load(topic):
    """Viewers load those of Humble, for every distribution since, and show an alert for each type that differs."""
    known = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    ros_type = ros_type_of(topic.type)
    parsed = get_types_from_msg(viewer_definition(ros_type), ros_type)
    for name, definition in parsed.items():
        if not name.startswith("ambler_msgs/"):
            assert definition == known[name]


def leaves(node):
    return {node} if isinstance(node, str) else leaves(node["first"]) | leaves(node["second"])


def has_field(ros_type, path):
    """Say whether a dotted path of fields exists in a ROS type."""
    for name in path.split("."):
        fields = dict(STORE.fielddefs[ros_type][1])
        if name not in fields:
            return False
        ros_type = fields[name][1]
        if not isinstance(ros_type, str) or ros_type not in STORE.fielddefs:
            ros_type = "std_msgs/msg/Empty"
    return True


LAYOUT_TEXT = (resources.files("ambler.bridges") / "layouts" / "ambler.json").read_text()
PANELS = json.loads(LAYOUT_TEXT)["configById"]
SCENES = ("3D!scene", "3D!follow")


def test_every_panel_is_shown_once_and_has_its_title_for_both_families_of_viewers():
    shown = leaves(json.loads(LAYOUT_TEXT)["layout"])
    in_tabs = {tab["layout"] for name in shown for tab in PANELS[name].get("tabs", [])}
    assert shown | in_tabs == set(PANELS)
    assert in_tabs == set(SCENES)
    for name, panel in PANELS.items():
        if "tabs" not in panel:
            assert panel["foxglovePanelTitle"] == panel["lichtblickPanelTitle"] != "", name


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_legible(name):
    """Flat colours need a field, or viewers colour by range; labels of all frontiers and lines between far frames cover rooms."""
    shown = PANELS[name]["topics"]
    for settings in shown.values():
        assert settings.get("colorMode") != "flat" or settings["colorField"]
    assert shown["/scan"]["colorField"] == "range"
    assert shown["/robot_description"]["visible"]
    assert shown["/map"]["alpha"] < 1.0
    assert shown["/footprint"]["color"] != "#ffffffff"
    assert shown["/frontiers"]["namespaces"] == {"reason": {"visible": False}}
    assert not any(PANELS[name]["transforms"][f"frame:{frame}"]["visible"] for frame in ("map", "odom"))


def test_goals_are_clicked_in_the_frame_of_the_map_only():
    """A viewer publishes in the frame that it displays; one that moves with the robot is none for goals."""
    scene, follow = (PANELS[name] for name in SCENES)
    assert (scene["followTf"], scene["publish"]["poseTopic"]) == ("map", topics.GOAL.ros_name)
    assert (follow["followTf"], follow["followMode"]) == ("base", "follow-position")
    assert not {value for key, value in follow["publish"].items() if key.endswith("Topic")} & set(CLIENT_TOPICS)


def test_legends_lie_beside_plots_and_silence_is_called_no_data():
    plots = [panel for name, panel in PANELS.items() if name.startswith("Plot!")]
    assert {plot["legendDisplay"] for plot in plots} == {"left"}
    assert all(len(path["label"]) <= 12 for plot in plots for path in plot["paths"])
    assert PANELS["Indicator!gate"]["fallbackLabel"] == "no data"


def test_the_layout_names_only_topics_and_fields_that_exist():
    text, panels = LAYOUT_TEXT, PANELS
    known = {topic.ros_name: ros_type_of(topic.type) for topic in topics.all_topics()}
    for name in SCENES:
        assert set(panels[name]["topics"]) <= set(known)
        for wanted in ("/map", "/scan", "/local_costmap/costmap", "/frontiers", "/plan", "/footprint"):
            assert panels[name]["topics"][wanted]["visible"]
    paths = [p["value"] for panel in panels.values() for p in panel.get("paths", [])] + [
        panels["Indicator!gate"]["path"]
    ]
    for path in paths:
        name, _, field = path.partition(".")
        assert has_field(known[name], field), path
    states = {rule["rawValue"]: rule["label"].replace(" ", "_") for rule in panels["Indicator!gate"]["rules"]}
    assert states == {str(int(state)): state.name for state in m.GateState}
    assert not re.search(r"https?://", text)


@pytest.mark.parametrize(("field", "exists"), [("twist.linear.x", True), ("twist.linear.w", False)])
def test_the_check_of_fields_can_fail(field, exists):
    assert has_field("geometry_msgs/msg/TwistStamped", field) == exists


def test_the_docs_name_every_topic_that_viewers_may_publish_on():
    page = (Path(__file__).parents[2] / "docs" / "live_view.md").read_text()
    assert all(f"`{name}`" in page for name in CLIENT_TOPICS)
    assert str(SUBPROTOCOL) in page
