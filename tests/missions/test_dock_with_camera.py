"""The whole docking in closed loop: rendered pictures, marker detection, filter, mission, position control and the velocity gate, with
odometry that errs by 1 % and a dock whose front lies nearer than the gate's margin."""

from __future__ import annotations

import math

import numpy as np

from ambler.core.messages import GateState
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.docking.detection import DockObservation
from ambler.docking.marker_dock import MarkerDockDetector
from ambler.missions.dock_commands import DockCommand, DockState, PermitApproach, RevokeApproach
from ambler.perception.fiducials import FiducialDetector
from ambler.safety.approach_permit import ApproachPermit
from ambler.safety.config import GateConfig
from ambler.safety.gate import VelocityGate
from ambler.sim.camera import CameraSpec, PrintCamera, marker_print
from ambler.sim.robots import robot_named
from tests.docking.docks import BASE_FROM_CAMERA, FRONT, MARKER_DOCK
from tests.missions.dock_site import PERIOD, S, Site

FRONT_SURFACE = np.stack((np.full(121, 0.62), np.linspace(-0.3, 0.3, 121)), axis=1)


class GateSite(Site):
    """A site with a real gate, and odometry with a scale error."""

    def __init__(self, seed: int, staging_error: SE2, foot: SE2 | None = None) -> None:
        dock = MARKER_DOCK
        self._true_odom, self._odom = None, SE2(-3.0, 1.0, -0.8)
        super().__init__(
            dock, dock.map_from_dock @ SE2(-2.0, 0.3, 0.2), dock.map_from_dock, staging_error=staging_error, seed=seed
        )
        self.gate = VelocityGate(GateConfig(), robot_named("amr_omni").model)
        self.gate.update_odometry(0, self.odom())
        assert self.gate.arm(0)[0]
        self.gate_state = GateState.ARMED
        self.surface = dock.map_from_dock.transform(FRONT_SURFACE)
        if foot is not None:
            place = dock.map_from_dock @ foot
            around = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01], [0.01, 0.01]])
            self.surface = np.vstack((self.surface, around + np.array([place.x, place.y])))
        self.is_held = lambda site: site.gate_state is GateState.PROTECTIVE_STOP  # type: ignore[attr-defined]

    def odom(self) -> SE2:
        """Every step is measured 1 % too long and drifts by half a degree per metre."""
        if self._true_odom is None:
            self._true_odom = self.pose
        step = self._true_odom.inverse() @ self.pose
        self._true_odom = self.pose
        way = math.hypot(step.x, step.y)
        if way < 0.1:
            step = SE2(1.01 * step.x, 1.01 * step.y, 1.01 * step.yaw + math.radians(0.5) * way)
        self._odom = self._odom @ step
        return self._odom

    def do(self, commands: list[DockCommand]) -> None:
        others: list[DockCommand] = []
        for c in commands:
            if isinstance(c, PermitApproach):
                expires_ns = self.now_ns + round(c.seconds * S)
                permit = ApproachPermit(c.odom_from_dock, c.outline, c.overrun, expires_ns)
                assert self.gate.permit_approach(permit, self.now_ns) == (True, "the dock may be approached")
            else:
                if isinstance(c, RevokeApproach):
                    self.gate.revoke_approach()
                others.append(c)
        super().do(others)

    def _obey(self) -> BodyVelocity:
        self.gate.update_odometry(self.now_ns, self.odom())
        self.gate.update_points("laser", self.now_ns, self.pose.inverse().transform(self.surface), self.odom())
        self.gate.request("navigation", self.now_ns, self.command, self.now_ns)
        step = self.gate.step(self.now_ns)
        self.gate_state = step.state
        return step.velocity


class CameraSite(GateSite):
    """A site with a real camera too."""

    def __init__(self, seed: int, staging_error: SE2) -> None:
        super().__init__(seed, staging_error)
        self.camera = PrintCamera(CameraSpec(samples=2), np.random.default_rng(seed))
        finder = FiducialDetector(FRONT, [m.spec for m in self.dock.markers])
        self.detector = MarkerDockDetector(self.dock, finder, BASE_FROM_CAMERA)
        self.pictures: list[tuple[int, SE2, np.ndarray]] = []

    def _see(self) -> None:
        if self.now_ns % (4 * round(PERIOD * S)) == 0 and self.is_looking and self.drive is None:
            pose = SE3.from_se2(self.pose.inverse() @ self.true_dock)
            prints = [
                marker_print(m.spec.dictionary, m.spec.number, m.spec.size, pose @ m.dock_from_marker)
                for m in self.dock.markers
            ]
            self.pictures.append((self.now_ns, self.odom(), self.camera.take([BASE_FROM_CAMERA], prints)))
        while self.pictures and self.now_ns - self.pictures[0][0] >= 60_000_000:
            stamp_ns, odom_from_base, image = self.pictures.pop(0)
            prior = self.tracker.expected(odom_from_base)
            detection = self.detector.detect(DockObservation(stamp_ns, image), prior)
            if detection is not None:
                self.tracker.update(detection, odom_from_base, self.now_ns)


def test_pictures_lead_the_robot_into_the_dock() -> None:
    for seed in range(1):
        rng = np.random.default_rng(100 + seed)
        off = SE2(rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1))
        site = CameraSite(seed, off)
        ended = site.run()
        assert ended.code == "SUCCEEDED", ended.text
        assert ended.result.attempts == 1
        d = site.dock_from_base
        assert math.hypot(d.x, d.y) < 0.003
        assert abs(d.yaw) < math.radians(0.1)
        assert ended.result.docking_seconds < 9.0


def test_a_foot_before_the_dock_stops_the_robot() -> None:
    """It stands 10 cm before the dock's front: outside of the outline, so the permit does not cover it."""
    site = GateSite(3, SE2(), SE2(0.52, 0.2, 0.0))
    site.do(site.mission.begin(site.dock, 0))
    while site.mission.state is not DockState.BACKING_OUT and site.ended is None:
        site.tick()
    assert site.mission.text.startswith("BLOCKED")
    assert site.deepest < -0.08, "the front of the robot stays before the foot"
