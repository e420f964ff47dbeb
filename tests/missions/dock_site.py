"""A kinematic robot, its camera and its odometry before a dock, with switches for faults: what the docking mission is tested on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import VelocityLimits
from ambler.core.se2 import SE2
from ambler.docking.detection import DockDetection
from ambler.docking.dock import Dock, DockKind
from ambler.docking.tracker import DockTracker
from ambler.missions.dock import DockMission
from ambler.missions.dock_commands import (
    DockCommand,
    DockConfig,
    DockEnded,
    DockState,
    DockView,
    LookForDock,
    Move,
    PermitApproach,
    RevokeApproach,
    StopNavigation,
)
from ambler.missions.drive_to import DriveTo
from tests.control.closed_loop import step_velocity

S = 1_000_000_000
PERIOD = 0.02
LIMITS = VelocityLimits(1.0, -0.4, 0.5, 1.0, 0.8, 0.8, 1.5, 1.2, 1.2)
OUTLINE = np.array([[0.6, -0.3], [0.9, -0.3], [0.9, 0.3], [0.6, 0.3]])
DOCK = Dock("charger", DockKind.MARKERS, SE2(5.0, 2.0, 0.6), OUTLINE)
COVARIANCE = np.diag([0.001, 0.001, 0.002]) ** 2


@dataclass
class Site:
    """A robot, its odometry (map frame turned away), a dock that charges within 3 mm of depth, and switches for faults."""

    dock: Dock = DOCK
    start: SE2 = field(default_factory=lambda: DOCK.map_from_dock @ SE2(-3.0, 0.5, 0.3))
    true_dock: SE2 = DOCK.map_from_dock
    config: DockConfig = field(default_factory=DockConfig)
    is_visible: Callable[[Site], bool] = lambda site: True
    has_power: Callable[[Site], bool] = lambda site: True
    is_held: Callable[[Site], bool] = lambda site: False
    is_fresh: Callable[[Site], bool] = lambda site: True
    navigation: str = "SUCCEEDED"
    staging_error: SE2 = field(default_factory=SE2)
    noise: float = 1.0
    seed: int = 1

    def __post_init__(self) -> None:
        self.mission, self.tracker = DockMission(self.config), DockTracker()
        self.pose, self.velocity, self.command = self.start, BodyVelocity(), BodyVelocity()
        self.rng, self.now_ns = np.random.default_rng(self.seed), 0
        self.drive: DriveTo | None = None
        self.arrival_ns = 0
        self.ended: DockEnded | None = None
        self.log: list[tuple[DockState, SE2]] = []
        self.commands: list[DockCommand] = []
        self.is_permitted = self.is_looking = False
        self.waiting: list[DockDetection] = []
        self.seen_from: list[SE2] = []
        self.deepest = -math.inf

    @property
    def dock_from_base(self) -> SE2:
        return self.true_dock.inverse() @ self.pose

    @property
    def is_touching(self) -> bool:
        d = self.dock_from_base
        return d.x > 0.0 and abs(d.y) < 0.01 and abs(d.yaw) < 0.02

    @property
    def states(self) -> list[DockState]:
        out: list[DockState] = []
        for state, _ in self.log:
            if not out or out[-1] is not state:
                out.append(state)
        return out

    def odom(self) -> SE2:
        return SE2(-3.0, 1.0, -0.8) @ self.pose

    def do(self, commands: list[DockCommand]) -> None:
        self.commands += commands
        for c in commands:
            if isinstance(c, Move):
                self.command = c.velocity
            elif isinstance(c, DriveTo):
                self.drive, self.arrival_ns = c, self.now_ns + 2 * S
            elif isinstance(c, StopNavigation):
                self.drive = None
            elif isinstance(c, LookForDock):
                self.is_looking = c.is_wanted
                self.tracker.reset()
            elif isinstance(c, PermitApproach):
                self.is_permitted = True
                assert c.odom_from_dock.distance_to(SE2(-3.0, 1.0, -0.8) @ self.true_dock) < 0.05
            elif isinstance(c, RevokeApproach):
                self.is_permitted = False
            elif isinstance(c, DockEnded):
                assert self.ended is None
                self.ended = c

    def tick(self) -> None:
        self.now_ns += round(PERIOD * S)
        if self.drive is not None and self.now_ns >= self.arrival_ns:
            drive, self.drive = self.drive, None
            if self.navigation in ("SUCCEEDED", "NEAREST_REACHED"):
                self.pose = drive.map_from_goal @ self.staging_error
            self.mission.drive_ended(drive.drive, self.navigation, "the path is blocked")
        self.velocity = v = self._obey()
        self.pose = self.pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * PERIOD)
        self.deepest = max(self.deepest, self.dock_from_base.x)
        self._see()
        track = self.tracker.track(self.now_ns, self.odom()) if self.is_looking else None
        view = DockView(
            self.now_ns, self.odom(), self.velocity, self.pose, track, self.is_touching, self.is_touching and self.has_power(self),
            self.is_held(self), self.is_fresh(self),
        )  # fmt: skip
        self.do(self.mission.update(view))
        self.log.append((self.mission.state, self.dock_from_base))

    def _obey(self) -> BodyVelocity:
        if self.is_held(self):
            return BodyVelocity()
        return step_velocity(self.velocity, self.command, LIMITS, PERIOD)

    def _see(self) -> None:
        """A camera of 12 Hz, 57 degrees wide, whose detections come 60 ms late."""
        base_from_dock = self.pose.inverse() @ self.true_dock
        marker = base_from_dock @ SE2(0.9, 0.0, 0.0)
        in_view = 0.2 < marker.x - 0.58 < 2.5 and abs(math.atan2(marker.y, marker.x - 0.58)) < 0.5
        if self.now_ns % (4 * round(PERIOD * S)) == 0 and self.is_looking and in_view and self.is_visible(self):
            noise = SE2(*(self.rng.normal(0.0, self.noise, 3) * (0.001, 0.001, 0.002)).tolist())
            self.waiting.append(DockDetection(self.now_ns, "test", base_from_dock @ noise, COVARIANCE, 1))
            self.seen_from.append(self.odom())
        while self.waiting and self.now_ns - self.waiting[0].stamp_ns >= 60_000_000:
            self.tracker.update(self.waiting.pop(0), self.seen_from.pop(0), self.now_ns)

    def run(self, seconds: float = 90.0) -> DockEnded:
        if self.ended is None and not self.mission.is_active:
            self.do(self.mission.begin(self.dock, self.now_ns))
        while self.ended is None:
            assert self.now_ns < seconds * S, f"no end after {seconds} s in {self.mission.state}: {self.mission.text}"
            self.tick()
        for _ in range(50):
            self.tick()
        assert math.hypot(self.velocity.vx, self.velocity.vy) < 1e-9, "the end of a mission stops the robot"
        assert not self.is_permitted
        assert not self.is_looking
        assert self.drive is None
        assert self.ended.text
        return self.ended
