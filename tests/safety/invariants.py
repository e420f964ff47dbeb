"""What must hold for every correct velocity gate. Each check takes the module under test, so that the mutation test can hand
it a damaged one."""

import itertools
import math
import random
from types import ModuleType
from typing import Any

import numpy as np

from ambler.core.messages import GateState
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.safety.approach_permit import ApproachPermit
from ambler.safety.config import GateConfig, VelocitySource

BOX = RobotModel(
    "box",
    DriveKind.OMNI,
    np.array([[0.4, -0.2], [0.4, 0.2], [-0.4, 0.2], [-0.4, -0.2]]),
    VelocityLimits(0.8, -0.3, 0.4, 1.5, 1.0, 1.0, 2.5, 1.5, 1.5),
)
LIMITS = BOX.limits
CART = VelocityLimits(0.8, -0.3, 0.0, 1.5)
TICK_NS = 20_000_000
TOUCH = 1e-9


def cluster(x: float, y: float) -> np.ndarray:
    """Three returns of one small thing."""
    return np.array([[x, y], [x, y + 0.004], [x, y - 0.004]])


def wall_ahead(x: float) -> np.ndarray:
    y = np.linspace(-1.0, 1.0, 81)
    return np.stack((np.full_like(y, x), y), axis=1)


class Bench:
    """A gate with a clock: fresh input unless told otherwise, and requests of every kind."""

    def __init__(self, module: ModuleType, config: GateConfig | None = None, is_armed: bool = True) -> None:
        self.gate: Any = module.VelocityGate(config or GateConfig(), BOX)
        self.now_ns = 1_000_000_000
        self.points = np.array([[50.0, 0.0]])
        self.pose = SE2()
        self.has_points = self.has_odometry = True
        self.log: list[Any] = []
        if is_armed:
            assert self.gate.arm(self.now_ns)[0]

    def ask(self, vx: float, vy: float = 0.0, wz: float = 0.0, source: str = "navigation", age: float = 0.0) -> None:
        stamp = self.now_ns - round(age * 1e9)
        self.gate.request(source, stamp, BodyVelocity(vx, vy, wz), self.now_ns)

    def tick(self, ticks: int = 1, ask: tuple[float, float, float] | None = None, source: str = "navigation") -> Any:
        for _ in range(ticks):
            self.now_ns += TICK_NS
            if self.has_odometry:
                self.gate.update_odometry(self.now_ns, self.pose)
            if self.has_points:
                self.gate.update_points("laser", self.now_ns, self.points, self.pose)
            if ask is not None:
                self.ask(*ask, source=source)
            self.log.append(self.gate.step(self.now_ns))
            v = self.log[-1].velocity
            self.pose = self.pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * TICK_NS * 1e-9)
        return self.log[-1]


def is_zero(step: Any) -> bool:
    return bool(step.velocity == BodyVelocity())


# limits.py


def speeds_are_limited_on_the_same_arc(m: ModuleType) -> None:
    rng = random.Random(1)
    cases = [BodyVelocity(*(rng.uniform(-3, 3) for _ in range(3))) for _ in range(200)]
    cases += [BodyVelocity(-1.0, 0.0, 0.0), BodyVelocity(0.1, 0.0, 0.1), BodyVelocity(0.8, 0.4, 1.5)]
    for v in cases:
        w = m.limit_speed(v, LIMITS)
        assert LIMITS.vx_min - 1e-12 <= w.vx <= LIMITS.vx_max + 1e-12
        assert abs(w.vy) <= LIMITS.vy_max + 1e-12
        assert abs(w.wz) <= LIMITS.wz_max + 1e-12
        limit = LIMITS.vx_max if v.vx > 0 else -LIMITS.vx_min
        ratio = min(1.0, limit / abs(v.vx), *([0.4 / abs(v.vy)] if v.vy else []), *([1.5 / abs(v.wz)] if v.wz else []))
        speed = math.hypot(v.vx, v.vy)
        ratio = min(ratio, max(limit, 0.4) / speed)
        assert math.hypot(w.vx, w.vy) <= max(limit, 0.4) + 1e-12
        assert np.allclose([w.vx, w.vy, w.wz], [v.vx * ratio, v.vy * ratio, v.wz * ratio])


def a_missing_axis_is_left_out(m: ModuleType) -> None:
    assert m.limit_speed(BodyVelocity(0.4, 0.3, 0.2), CART) == BodyVelocity(0.4, 0.0, 0.2)
    stiff = VelocityLimits(0.8, 0.0, 0.0, 1.5)
    assert m.limit_speed(BodyVelocity(-0.4, 0.0, 0.2), stiff) == BodyVelocity(0.0, 0.0, 0.2)


def accelerations_are_limited(m: ModuleType) -> None:
    for value in (-0.5, 0.0, 0.01, 0.5):
        for target in (-0.6, -0.2, 0.0, 0.005, 0.2, 0.6):
            for dt in (0.0, 0.02, 0.1, 3.0):
                new = m.approach(value, target, 1.0, 2.0, dt)
                assert min(value, target) - 1e-12 <= new <= max(value, target) + 1e-12
                assert abs(new - value) <= 2.0 * dt + 1e-12
                assert max(0.0, abs(new) - abs(value)) <= 1.0 * dt + 1e-12
                if dt == 3.0:
                    assert new == target
    assert math.isclose(m.approach(0.5, 0.0, 1.0, 2.0, 0.1), 0.3)
    assert math.isclose(m.approach(0.0, 0.5, 1.0, 2.0, 0.1), 0.1)
    assert math.isclose(m.approach(0.2, 0.6, 1.0, 2.0, 0.1), 0.3)
    assert math.isclose(m.approach(-0.2, -0.6, 1.0, 2.0, 0.1), -0.3)
    assert math.isclose(m.approach(0.1, -0.5, 1.0, 2.0, 0.1), -0.05)
    assert math.isclose(m.approach(-0.5, -0.2, 1.0, 2.0, 0.1), -0.3)


def every_axis_has_its_own_limit(m: ModuleType) -> None:
    uneven = VelocityLimits(1.0, -1.0, 1.0, 9.0, ax_max=1.0, ay_max=2.0, az_max=3.0, ax_brake=4.0, ay_brake=5.0)
    up = m.limit_acceleration(BodyVelocity(), BodyVelocity(1, 1, 1), uneven, 0.1)
    assert np.allclose([up.vx, up.vy, up.wz], [0.1, 0.2, 0.3])
    down = m.limit_acceleration(BodyVelocity(1, 1, 1), BodyVelocity(), uneven, 0.1)
    assert np.allclose([down.vx, down.vy, down.wz], [0.6, 0.5, 0.7])


def turning_the_velocity_makes_it_no_faster(m: ModuleType) -> None:
    even = VelocityLimits(1.0, -1.0, 1.0, 9.0)
    turned = m.limit_acceleration(BodyVelocity(0.29, 0.08), BodyVelocity(0.3, 0.0), even, 0.002)
    assert turned.vy == m.approach(0.08, 0.0, even.ay_max, even.ay_brake, 0.002)
    assert math.isclose(math.hypot(turned.vx, turned.vy), math.hypot(0.29, 0.08))
    aside = m.limit_acceleration(BodyVelocity(0.08, -0.29), BodyVelocity(0.0, -0.3), even, 0.002)
    assert math.isclose(aside.vx, turned.vy)
    assert math.isclose(aside.vy, -turned.vx)
    rng = random.Random(2)
    for _ in range(500):
        v, w = (BodyVelocity(*(rng.uniform(-1, 1) for _ in range(3))) for _ in range(2))
        dt = rng.choice((0.001, 0.02, 0.2))
        new = m.limit_acceleration(v, w, even, dt)
        assert math.hypot(new.vx, new.vy) <= max(math.hypot(v.vx, v.vy), math.hypot(w.vx, w.vy)) + 1e-12
        for value, target, got in ((v.vx, w.vx, new.vx), (v.vy, w.vy, new.vy)):
            free = m.approach(value, target, even.ax_max, even.ax_brake, dt)
            assert min(value, free) - 1e-12 <= got <= max(value, free) + 1e-12


def numbers_are_told_from_nonsense(m: ModuleType) -> None:
    for bad in (math.nan, math.inf, -math.inf):
        for axis in range(3):
            assert not m.is_finite(BodyVelocity(*(bad if i == axis else 0.1 for i in range(3))))
    assert m.is_finite(BodyVelocity(0.1, 0.2, 0.3))
    assert m.is_still(BodyVelocity())
    for axis in range(3):
        assert not m.is_still(BodyVelocity(*(0.1 if i == axis else 0.0 for i in range(3))))
    assert m.scaled(BodyVelocity(0.2, 0.4, -0.6), 0.5) == BodyVelocity(0.1, 0.2, -0.3)


# selection.py


def priorities_and_timeouts_choose(m: ModuleType) -> None:
    sources = (VelocitySource("navigation", 10, 0.3), VelocitySource("teleop", 100, 0.4))
    s = m.SourceSelector(sources)
    nav, tele = BodyVelocity(0.1), BodyVelocity(0.2)
    assert s.select(0) is None
    assert s.take("navigation", m.VelocityRequest(1000, nav))
    assert s.select(1000) == ("navigation", nav)
    assert s.take("teleop", m.VelocityRequest(1000, tele))
    assert s.select(1000) == ("teleop", tele)
    assert s.select(1000 + 300_000_000) == ("teleop", tele)
    assert s.select(1000 + 400_000_000) == ("teleop", tele)
    assert s.take("navigation", m.VelocityRequest(1000 + 390_000_000, nav))
    assert s.select(1000 + 400_000_001) == ("navigation", nav)
    assert s.select(1000 + 690_000_000) == ("navigation", nav)
    assert s.select(1000 + 690_000_001) is None
    assert s.names == ("teleop", "navigation")


def old_requests_are_void(m: ModuleType) -> None:
    s = m.SourceSelector(GateConfig().sources)
    assert s.take("teleop", m.VelocityRequest(2000, BodyVelocity(0.1)))
    assert not s.take("teleop", m.VelocityRequest(1999, BodyVelocity(0.2)))
    assert s.select(2000) == ("teleop", BodyVelocity(0.1))
    assert s.take("teleop", m.VelocityRequest(2000, BodyVelocity(0.3)))
    s.void(3000)
    assert s.select(3000) is None
    assert not s.take("teleop", m.VelocityRequest(2999, BodyVelocity(0.2)))
    assert s.select(3000) is None
    assert s.take("teleop", m.VelocityRequest(3000, BodyVelocity(0.2)))
    try:
        s.take("nobody", m.VelocityRequest(4000, BodyVelocity()))
    except KeyError:
        return
    raise AssertionError("an unknown source was accepted")


# stops.py


def stops_stay_until_every_cause_is_gone(m: ModuleType) -> None:
    latch = m.StopLatch()
    assert not latch.is_set
    assert not latch.is_stopped
    assert not latch.is_faulty
    latch.fault("F: first")
    latch.fault("G: second")
    assert latch.is_faulty
    assert latch.is_set
    assert not latch.is_stopped
    assert latch.reason == "F: first"
    latch.stop("page", "pressed")
    latch.stop("page", "again")
    latch.hold("bumper", "")
    assert latch.is_stopped
    assert latch.reason == "page: pressed; bumper"
    is_done, text = latch.reset()
    assert not is_done
    assert "bumper" in text
    assert latch.is_stopped
    latch.release("bumper")
    assert latch.is_stopped
    assert latch.reset()[0]
    assert not latch.is_set
    assert latch.reason == ""


# protective_stop.py


def a_protective_stop_holds_frees_and_resumes(m: ModuleType) -> None:
    ahead, back, spin = BodyVelocity(0.5), BodyVelocity(-0.2), BodyVelocity(0.0, 0.0, 0.5)
    stop = m.ProtectiveStop(0.1, 0.3, 2.0)
    assert not stop.update(0, ahead, 0.1, ahead, 0.1)
    assert stop.update(0, ahead, 0.099, ahead, 0.099)
    assert stop.blocked == ahead
    assert stop.update(10**9, ahead, 1.0, ahead, 0.29)
    assert not stop.update(2 * 10**9, back, 1.0, back, 1.0), "a motion that leads away must pass at once"
    assert not stop.update(2 * 10**9, spin, 1.0, spin, 1.0)
    assert stop.update(2 * 10**9, back, 0.99, back, 0.99), "one that is not free itself must wait"
    assert stop.update(2 * 10**9, BodyVelocity(), 1.0, BodyVelocity(), 0.2)
    assert stop.update(3 * 10**9, ahead, 1.0, ahead, 0.3)
    assert stop.update(4 * 10**9, ahead, 1.0, ahead, 0.29)
    assert stop.update(5 * 10**9, ahead, 1.0, ahead, 0.3)
    assert stop.update(7 * 10**9 - 1, ahead, 1.0, ahead, 0.3)
    assert not stop.update(7 * 10**9, ahead, 1.0, ahead, 0.3)
    assert not stop.update(7 * 10**9 + 1, ahead, 1.0, ahead, 0.2)
    braking = m.ProtectiveStop(0.1, 0.3, 2.0)
    assert braking.update(0, ahead, 0.0, BodyVelocity(), 1.0)
    assert braking.blocked == ahead
    braking.reset()
    assert braking.blocked == BodyVelocity()
    assert not braking.update(0, ahead, 1.0, ahead, 0.2)


def leading_away_means_no_component_along(m: ModuleType) -> None:
    ahead = BodyVelocity(0.5, 0.0, 0.2)
    assert m.leads_away(BodyVelocity(-0.1), ahead)
    assert m.leads_away(BodyVelocity(0.0, 0.3), ahead)
    assert m.leads_away(BodyVelocity(0.0, 0.0, -0.3), ahead)
    assert not m.leads_away(BodyVelocity(0.0, 0.0, 0.3), ahead)
    assert not m.leads_away(BodyVelocity(0.1, 0.0, -0.3), ahead)
    assert not m.leads_away(BodyVelocity(-0.1, 0.4), BodyVelocity(0.4, 0.4))
    assert m.leads_away(BodyVelocity(-0.4, 0.1), BodyVelocity(0.4, 0.4))


# field.py


def the_field_grows_with_the_speed(m: ModuleType) -> None:
    last = -1.0
    for vx in np.linspace(0.0, 0.8, 33):
        v = BodyVelocity(float(vx))
        reach = float(vx) * m.stopping_time(1.0, 0.2, m.braking_time(v, LIMITS))
        assert math.isclose(reach, vx * 0.2 + vx * vx / (2 * LIMITS.ax_brake), abs_tol=1e-12)
        assert reach >= last
        last = reach
    assert math.isclose(m.braking_time(BodyVelocity(-0.3, 0.4, 0.5), LIMITS), max(0.2, 0.4 / 1.5, 0.2))
    assert math.isclose(m.braking_time(BodyVelocity(0.0, 0.1, 1.0), LIMITS), 0.4)
    assert math.isclose(m.braking_time(BodyVelocity(-0.3), LIMITS), 0.2)
    assert math.isclose(m.stopping_time(0.5, 0.2, 0.4), 0.15)


def the_safe_speed_just_stops(m: ModuleType) -> None:
    for reaction in (0.0, 0.1, 0.3):
        for braking in (0.0, 0.2, 1.0):
            full = m.stopping_time(1.0, reaction, braking)
            last = 0.0
            for contact in np.linspace(0.0, full * 0.999, 20):
                s = m.safe_scale(float(contact), reaction, braking)
                assert last <= s <= 1.0
                last = s
                if full > 0.0:
                    assert math.isclose(m.stopping_time(s, reaction, braking), contact, abs_tol=1e-9)
            assert m.safe_scale(full, reaction, braking) == 1.0
            assert m.safe_scale(math.inf, reaction, braking) == 1.0


def the_field_looks_only_where_the_motion_leads(m: ModuleType) -> None:
    field = m.ProtectiveField(BOX, 0.2, 0.03, 2, 0.05)
    ahead, back, left = BodyVelocity(0.5), BodyVelocity(-0.3), BodyVelocity(0.0, 0.3)
    near = cluster(0.42, 0.0)
    assert field.free_scale(ahead, near) < 0.01
    assert field.free_scale(back, near) == 1.0
    assert field.free_scale(left, near) == 1.0
    assert field.free_scale(BodyVelocity(), near) == 1.0
    assert field.free_scale(BodyVelocity(0.0, 0.0, 1.0), cluster(0.3, 0.25)) < 0.5
    assert field.free_scale(BodyVelocity(0.0, 0.0, -1.0), cluster(-0.3, 0.25)) < 0.5
    assert field.free_scale(BodyVelocity(0.0, 0.0, 1.0), cluster(0.5, 0.0)) == 1.0
    inside = cluster(0.38, 0.0)
    assert field.free_scale(ahead, inside) < 0.01
    assert field.free_scale(back, inside) == 1.0
    assert field.free_scale(ahead, cluster(0.2, 0.0)) == 1.0, "deep inside is the robot itself"
    assert field.free_scale(ahead, near[:1]) == 1.0, "one point alone is noise"
    assert field.free_scale(ahead, near[:2]) < 0.01
    assert field.free_scale(ahead, np.empty((0, 2))) == 1.0


def the_field_is_as_long_as_the_way_to_stop(m: ModuleType) -> None:
    field = m.ProtectiveField(BOX, 0.2, 0.03, 2, 0.05)
    for v in (0.1, 0.4, 0.8):
        way = v * 0.2 + v * v / (2 * LIMITS.ax_brake)
        front = 0.4 + 0.03 + way
        assert field.free_scale(BodyVelocity(v), cluster(front + 1e-6, 0.0)) == 1.0
        assert field.free_scale(BodyVelocity(v), cluster(front - 1e-6, 0.0)) < 1.0
    last = -1.0
    for x in np.linspace(0.4, 1.2, 60):
        scale = field.free_scale(BodyVelocity(0.8), cluster(float(x), 0.1))
        assert scale >= last - 1e-12
        last = scale
    assert last == 1.0


# approach_permit.py


DOCK = np.array([[0.45, -0.3], [0.8, -0.3], [0.8, 0.3], [0.45, 0.3]])
SECOND = 1_000_000_000


def only_the_outline_is_left_out_and_only_for_a_while(m: ModuleType) -> None:
    field, here, dock = m.ApproachField(LIMITS, 0.2), SE2(1.0, 2.0, 0.5), SE2(1.0, 2.0, 0.5) @ SE2(0.3, 0.0, 0.0)
    far = here @ SE2(-m.WAY, 0.0, 0.0)
    inside, foot, beside = (0.9, 0.0), (0.60, 0.0), (0.9, 0.45)
    points = np.array([inside, foot, beside])
    assert np.array_equal(field.remaining(points, here, 0), points), "without a permit every point counts"
    assert not field.is_valid(here, 0)
    is_given, _ = field.permit(m.ApproachPermit(dock, DOCK, 0.02, SECOND), here, 0)
    assert is_given
    assert field.is_valid(here, SECOND - 1)
    assert field.is_valid(far @ SE2(1e-9, 0.0, 0.0), 0)
    assert not field.is_valid(far @ SE2(-1e-9, 0.0, 0.0), 0), "it ends after some way"
    assert np.array_equal(field.remaining(points, here, SECOND - 1), [foot, beside])
    assert np.array_equal(field.remaining(points, here, SECOND), points), "it ends by itself"
    assert not field.is_valid(here, SECOND)
    assert len(field.remaining(np.empty((0, 2)), here, 0)) == 0
    rim = np.array([[0.3 + 0.45 - 0.029, 0.0], [0.3 + 0.45 - 0.031, 0.0]])
    assert np.array_equal(field.remaining(rim, here, 0), rim[1:]), "noise of the dock's surface is the dock's"
    moved = here @ SE2(0.1, 0.0, 0.0)
    assert np.array_equal(field.remaining(points - [0.1, 0.0], moved, 0), points[1:] - [0.1, 0.0])
    field.revoke()
    assert np.array_equal(field.remaining(points, here, 0), points)


def a_permitted_robot_is_slow_and_goes_only_so_deep(m: ModuleType) -> None:
    field, fast = m.ApproachField(LIMITS, 0.2), BodyVelocity(0.8, 0.4, 0.2)
    assert field.limited(fast, SE2(), 0) == fast
    assert field.permit(m.ApproachPermit(SE2(), DOCK, 0.02, SECOND), SE2(-0.5, 0.0, 0.0), 0)[0]
    slow = field.limited(fast, SE2(-0.5, 0.0, 0.0), 0)
    assert math.isclose(math.hypot(slow.vx, slow.vy), m.SPEED)
    assert math.isclose(slow.wz / slow.vx, 0.25)
    assert math.isclose(field.limited(BodyVelocity(0.01, 0.0, -1.5), SE2(-0.5, 0.0, 0.0), 0).wz, -m.TURN)
    creeping = BodyVelocity(0.1, 0.05, 0.1)
    assert field.limited(creeping, SE2(-0.5, 0.0, 0.0), 0) == creeping
    assert field.limited(fast, SE2(-0.5, 0.0, 0.0), SECOND) == fast
    assert field.permit(m.ApproachPermit(SE2(), DOCK, 0.02, SECOND), SE2(-0.3, 0.0, 0.0), 0)[0]
    last = 1.0
    for x in np.linspace(-0.3, 0.02, 40):
        v = field.limited(BodyVelocity(0.3), SE2(float(x), 0.0, 0.0), 0).vx
        assert v <= last
        assert v * 0.2 + v * v / (2 * LIMITS.ax_brake) <= 0.02 - x + 1e-9, "it can stop at the overrun"
        last = v
    assert last == 0.0
    deep = SE2(0.03, 0.0, 0.0)
    assert field.limited(BodyVelocity(0.1), deep, 0) == BodyVelocity()
    assert field.limited(BodyVelocity(-0.1), deep, 0) == BodyVelocity(-0.1)
    assert field.limited(BodyVelocity(0.0, 0.1), deep, 0) == BodyVelocity(0.0, 0.1)
    turned = SE2(0.02, 0.0, 0.15)
    assert field.limited(BodyVelocity(0.1, 0.9), turned, 0).vy > 0.0, "its left leads out of the dock"
    assert field.limited(BodyVelocity(0.1, 0.5), turned, 0) == BodyVelocity()


def a_permit_holds_in_its_corridor_only(m: ModuleType) -> None:
    dock, inside = SE2(1.0, 2.0, 0.5), np.array([[0.6, 0.0], [0.62, 0.0]])

    def at(x: float, y: float, yaw: float, velocity: BodyVelocity) -> tuple[bool, BodyVelocity]:
        field, here = m.ApproachField(LIMITS, 0.2), dock @ SE2(x, y, yaw)
        assert field.permit(m.ApproachPermit(dock, DOCK, 0.02, SECOND), here, 0)[0]
        seen = here.inverse().transform(dock.transform(inside))
        is_left_out = len(field.remaining(seen, here, 0)) == 0
        assert is_left_out == field.is_valid(here, 0)
        return is_left_out, field.limited(velocity, here, 0)

    fast = BodyVelocity(0.8, 0.4, 0.2)
    for x, width in ((0.01, m.SIDE), (0.0, m.SIDE), (-0.5, m.SIDE + 0.5 * m.FLARE)):
        for side in (-1.0, 1.0):
            assert at(x, side * (width - 1e-6), 0.0, fast)[0]
            assert at(x, side * (width + 1e-6), 0.0, fast) == (False, fast), (
                "beside it nothing is permitted, nor limited"
            )
    for side in (-1.0, 1.0):
        assert at(0.0, 0.0, side * (m.ASKEW - 1e-6), fast)[0]
        assert not at(0.0, 0.0, side * (m.ASKEW + 1e-6), fast)[0]
        assert at(0.0, 0.0, side * (2.0 * math.pi - 0.1), fast)[0], "angles have no seam"
        for gap in np.linspace(1e-9, 0.05, 20):
            v = at(0.0, side * (m.SIDE - gap), 0.0, BodyVelocity(0.0, side * 0.3))[1].vy * side
            assert -1e-12 <= v * 0.2 + v * v / (2 * LIMITS.ay_brake) <= gap + 1e-9, "it can stop at the sides"
            assert at(0.0, side * (m.SIDE - gap), 0.0, BodyVelocity(0.0, -side * 0.01))[1].vy == -side * 0.01
            w = at(-0.3, 0.0, side * (m.ASKEW - gap), BodyVelocity(0.0, 0.0, side * 0.5))[1].wz * side
            assert -1e-12 <= w * 0.2 + w * w / (2 * LIMITS.az_max) <= gap + 1e-9
            assert at(-0.3, 0.0, side * (m.ASKEW - gap), BodyVelocity(0.0, 0.0, -side * 0.1))[1].wz == -side * 0.1
        # A tenth of a second before the edge, at the speed that remains, along the narrowing funnel.
        edge = side * (m.SIDE + 0.5 * m.FLARE - 0.002)
        v = at(-0.5, edge, 0.0, BodyVelocity(0.3))[1].vx
        assert 0.0 < v * m.FLARE * 0.2 <= 0.002 + 1e-9
        assert at(-0.5, edge, 0.0, BodyVelocity(-0.2))[1].vx == -0.2
        beside = SE2(0.0, side * (m.SIDE - 1e-6), 0.0)
        assert math.isclose(m.time_in_corridor(beside, BodyVelocity(0.01), 0.02), 2.0), (
            "at the dock the sides are parallel"
        )
    turned = 0.1
    slanted = m.time_in_corridor(SE2(-0.5, 0.0, turned), BodyVelocity(0.1, 0.05), 0.02)
    inwards = 0.1 * math.cos(turned) - 0.05 * math.sin(turned)
    left = 0.1 * math.sin(turned) + 0.05 * math.cos(turned)
    assert math.isclose(slanted, min(0.52 / inwards, (m.SIDE + 0.5 * m.FLARE) / (m.FLARE * inwards + left)))
    assert m.time_in_corridor(SE2(), BodyVelocity(-0.1), 0.02) == math.inf


def renewing_moves_no_dock_and_ends_some_day(m: ModuleType) -> None:
    near = SE2(-0.5, 0.0, 0.0)

    def second(dock: SE2, now_ns: int) -> bool:
        field = m.ApproachField(LIMITS, 0.2)
        assert field.permit(m.ApproachPermit(SE2(), DOCK, 0.02, SECOND), near, 0)[0]
        return bool(field.permit(m.ApproachPermit(dock, DOCK, 0.02, now_ns + SECOND), near, now_ns)[0])

    assert second(SE2(m.WANDER[0] - 1e-9, 0.0, m.WANDER[1] - 1e-9), SECOND // 2)
    assert not second(SE2(0.0, m.WANDER[0] + 1e-6, 0.0), SECOND // 2)
    assert not second(SE2(0.0, 0.0, -m.WANDER[1] - 1e-6), SECOND)
    assert second(SE2(0.2, 0.0, 0.0), SECOND + 1), "after its end a new one begins"
    field = m.ApproachField(LIMITS, 0.2)
    step, last = SECOND // 2, round(m.SERIES * SECOND)
    for now_ns in range(0, last + 1, step):
        dock = SE2(0.15 * now_ns / last, 0.0, 0.0) if now_ns < last // 2 else SE2()
        assert field.permit(m.ApproachPermit(dock, DOCK, 0.02, now_ns + SECOND), near, now_ns)[0]
    assert not field.permit(m.ApproachPermit(SE2(), DOCK, 0.02, last + step + SECOND), near, last + step)[0]
    assert not field.is_valid(near, last + step)
    wandering = m.ApproachField(LIMITS, 0.2)
    given = [
        wandering.permit(m.ApproachPermit(SE2(0.06 * k, 0.0, 0.0), DOCK, 0.02, k * step + SECOND), near, k * step)[0]
        for k in range(3)
    ]
    assert given == [True, True, False], "what counts is where the dock was first"
    wandering.revoke()
    assert wandering.permit(m.ApproachPermit(SE2(0.3, 0.0, 0.0), DOCK, 0.02, SECOND), near, 0)[0]


def odd_permits_are_refused(m: ModuleType) -> None:
    near = SE2(-0.5, 0.0, 0.0)
    good = (SE2(), DOCK, 0.02, SECOND)
    bad = [
        (SE2(math.nan, 0.0, 0.0), DOCK, 0.02, SECOND),
        (SE2(), np.full((4, 2), np.inf), 0.02, SECOND),
        (SE2(), DOCK, math.nan, SECOND),
        (SE2(), DOCK[::-1], 0.02, SECOND),
        (SE2(), DOCK[:2], 0.02, SECOND),
        (SE2(), np.zeros((4, 3)), 0.02, SECOND),
        (SE2(), np.zeros(4), 0.02, SECOND),
        (SE2(), DOCK * [1.0, 3.4], 0.02, SECOND),
        (SE2(), DOCK * [4.0, 1.9] + [0.0, 0.0], 0.02, SECOND),
        (SE2(), DOCK, 0.051, SECOND),
        (SE2(), DOCK, -0.051, SECOND),
        (SE2(), DOCK, 0.02, round(m.LONGEST * SECOND) + 1),
        (SE2(1.51, 0.0, 0.0), DOCK, 0.02, SECOND),
        (SE2(), DOCK - [0.45, 0.0], 0.02, SECOND),
    ]
    for values in bad:
        field = m.ApproachField(LIMITS, 0.2)
        assert field.permit(m.ApproachPermit(*good), near, 0)[0]
        is_given, why = field.permit(m.ApproachPermit(*values), near, 0)
        assert not is_given
        assert why
        assert not field.is_valid(near, 0), "a bad permit ends the one before"
    largest = [
        (SE2(), DOCK * [1.0, 3.3], 0.02, SECOND),
        (SE2(), DOCK * [4.0, 1.7], 0.02, SECOND),
        (SE2(), DOCK, 0.05, SECOND),
        (SE2(), DOCK, -0.05, SECOND),
        (SE2(), DOCK, 0.02, round(m.LONGEST * SECOND)),
        (SE2(1.5, 0.0, 0.0), DOCK, 0.02, SECOND),
        (SE2(), DOCK - [0.4499, 0.0], 0.02, SECOND),
    ]
    for values in largest:
        assert m.ApproachField(LIMITS, 0.2).permit(m.ApproachPermit(*values), near, 0)[0]


# gate.py


def a_permit_lets_the_robot_touch_the_dock_and_nothing_else(m: ModuleType) -> None:
    front = np.stack((np.full(61, 1.0), np.linspace(-0.3, 0.3, 61)), axis=1)
    outline = np.array([[0.4, -0.3], [0.8, -0.3], [0.8, 0.3], [0.4, 0.3]])

    def go(foot: np.ndarray, ask: tuple[float, float, float], is_permitted: bool) -> Any:
        b = Bench(m)
        world = np.concatenate((front, foot))
        for _ in range(300):
            b.points = b.pose.inverse().transform(world)
            if is_permitted and b.now_ns % (20 * TICK_NS) == 0:
                assert b.gate.permit_approach(
                    ApproachPermit(SE2(0.6, 0.0, 0.0), outline, 0.01, b.now_ns + SECOND), b.now_ns
                )[0]
            b.tick(1, ask)
        return b

    nobody = np.empty((0, 2))
    assert go(nobody, (0.2, 0.0, 0.0), False).pose.x < 0.575
    docked = go(nobody, (0.8, 0.0, 0.0), True)
    assert 0.6 < docked.pose.x < 0.6101, "it touches the dock and is held at the overrun"
    assert max(s.velocity.vx for s in docked.log) <= 0.3 + 1e-9
    blocked = go(cluster(0.8, 0.1), (0.2, 0.0, 0.0), True)
    assert blocked.pose.x < 0.4, "a foot before the dock still stops it"
    assert any(s.state == GateState.PROTECTIVE_STOP for s in blocked.log)
    for end in ("pause", "revoke", "stop", "expire"):
        b = Bench(m)
        b.tick(1)
        permit = ApproachPermit(SE2(0.3, 0.0, 0.0), outline, 0.01, b.now_ns + SECOND)
        assert b.gate.permit_approach(permit, b.now_ns)[0]
        b.points = cluster(0.75, 0.0)
        if end == "pause":
            b.gate.pause(b.now_ns, "PAUSED: test")
            b.gate.arm(b.now_ns)
        elif end == "revoke":
            b.gate.revoke_approach()
        elif end == "stop":
            b.gate.emergency_stop(b.now_ns, "page", "pressed")
            b.gate.reset(b.now_ns)
            b.gate.arm(b.now_ns)
        else:
            b.tick(51)
        b.points = cluster(0.41, 0.0)
        assert b.tick(10, (0.2, 0.0, 0.0)).state == GateState.PROTECTIVE_STOP
    fresh = m.VelocityGate(GateConfig(), BOX)
    assert not fresh.permit_approach(ApproachPermit(SE2(), DOCK, 0.01, SECOND), 0)[0], "no odometry, no permit"


def it_starts_paused_and_moves_only_when_armed(m: ModuleType) -> None:
    b = Bench(m, is_armed=False)
    assert is_zero(b.tick(20, (0.5, 0, 0)))
    assert b.log[-1].state == GateState.PAUSED
    assert b.gate.arm(b.now_ns)[0]
    assert is_zero(b.tick()), "a request from before arming is void"
    step = b.tick(100, (0.5, 0.0, 0.0))
    assert step.velocity == BodyVelocity(0.5)
    assert step.state == GateState.ARMED
    assert step.source == "navigation"
    assert step.reason == ""
    b.gate.pause(b.now_ns, "PAUSED: test")
    step = b.tick(1, (0.5, 0.0, 0.0))
    assert 0.0 < step.velocity.vx < 0.5
    assert step.state == GateState.PAUSED
    assert is_zero(b.tick(20, (0.5, 0.0, 0.0)))


def arming_twice_changes_nothing(m: ModuleType) -> None:
    b = Bench(m)
    b.tick(50, (0.5, 0.0, 0.0))
    assert b.gate.arm(b.now_ns + 5)[0]
    assert b.tick().velocity == BodyVelocity(0.5)


def output_respects_all_limits(m: ModuleType) -> None:
    rng = random.Random(7)
    b = Bench(m)
    last = BodyVelocity()
    for _ in range(400):
        ask = None if rng.random() < 0.2 else tuple(rng.uniform(-4, 4) for _ in range(3))
        v = b.tick(1, ask).velocity
        assert LIMITS.vx_min - 1e-9 <= v.vx <= LIMITS.vx_max + 1e-9
        assert abs(v.vy) <= LIMITS.vy_max + 1e-9
        assert abs(v.wz) <= LIMITS.wz_max + 1e-9
        assert abs(v.vx - last.vx) <= 1.5 * 0.02 + 1e-9
        assert abs(v.vx) - abs(last.vx) <= 1.0 * 0.02 + 1e-9
        assert abs(v.wz - last.wz) <= 2.5 * 0.02 + 1e-9
        last = v


def a_long_step_uses_little_acceleration(m: ModuleType) -> None:
    b = Bench(m)
    b.tick(5, (0.0, 0.0, 0.0))
    b.now_ns += 180_000_000
    assert b.tick(1, (0.8, 0.0, 0.0)).velocity.vx <= 0.05 + 1e-9


def sources_run_out(m: ModuleType) -> None:
    b = Bench(m)
    b.tick(60, (0.8, 0.0, 0.0))
    assert b.tick(15).velocity == BodyVelocity(0.8)
    assert b.tick(1).velocity.vx < 0.8
    last = b.tick(40)
    assert is_zero(last)
    assert last.state == GateState.ARMED
    assert last.reason.startswith("IDLE")
    b.tick(30, (0.2, 0.0, 0.0), "teleop")
    assert b.tick(1, (0.8, 0.0, 0.0)).source == "teleop"


def nonsense_stops_for_good(m: ModuleType) -> None:
    for bad in (math.nan, math.inf, -math.inf):
        for axis in range(3):
            b = Bench(m)
            b.tick(50, (0.5, 0.0, 0.0))
            b.ask(*(bad if i == axis else 0.1 for i in range(3)))
            step = b.tick(1, (0.5, 0.0, 0.0))
            assert is_zero(step)
            assert step.state == GateState.FAULT
            assert "NOT_FINITE" in step.reason
            assert is_zero(b.tick(200, (0.5, 0.0, 0.0)))
            assert not b.gate.arm(b.now_ns)[0]
            assert b.gate.reset(b.now_ns)[0]
            assert is_zero(b.tick(20, (0.5, 0.0, 0.0)))
            assert b.log[-1].state == GateState.PAUSED
            assert b.gate.arm(b.now_ns)[0]
            assert b.tick(60, (0.5, 0.0, 0.0)).velocity == BodyVelocity(0.5)


def odd_stamps_are_refused(m: ModuleType) -> None:
    b = Bench(m)
    b.tick(50, (0.5, 0.0, 0.0))
    b.ask(0.5, age=-0.09)
    assert b.tick().state == GateState.ARMED
    b.ask(0.5, age=-0.11)
    assert b.tick().state == GateState.FAULT
    b = Bench(m)
    b.gate.update_odometry(b.now_ns, SE2(math.nan, 0.0, 0.0))
    assert b.tick().state == GateState.FAULT
    b = Bench(m)
    b.tick(50, (0.5, 0.0, 0.0))
    b.now_ns -= 2 * TICK_NS
    step = b.tick(1, (0.5, 0.0, 0.0))
    assert is_zero(step)
    assert step.state == GateState.EMERGENCY_STOP
    assert "CLOCK_JUMP" in step.reason


def an_emergency_stop_is_latched(m: ModuleType) -> None:
    b = Bench(m)
    b.tick(60, (0.8, 0.0, 0.0))
    b.gate.emergency_stop(b.now_ns, "page", "pressed")
    step = b.tick(1, (0.8, 0.0, 0.0))
    assert is_zero(step), "an emergency stop does not ramp"
    assert step.state == GateState.EMERGENCY_STOP
    assert not b.gate.arm(b.now_ns)[0]
    assert is_zero(b.tick(200, (0.8, 0.0, 0.0)))
    b.gate.hold_stop(b.now_ns, "bumper", "pressed in")
    assert not b.gate.reset(b.now_ns)[0]
    assert b.tick().state == GateState.EMERGENCY_STOP
    b.gate.release_stop("bumper")
    assert b.tick().state == GateState.EMERGENCY_STOP
    assert b.gate.reset(b.now_ns)[0]
    step = b.tick(50, (0.8, 0.0, 0.0))
    assert is_zero(step)
    assert step.state == GateState.PAUSED
    b.gate.arm(b.now_ns)
    assert b.tick(60, (0.8, 0.0, 0.0)).velocity == BodyVelocity(0.8)


def a_base_on_its_side_does_not_move(m: ModuleType) -> None:
    b = Bench(m)

    def lean(seconds: float, degrees: float) -> Any:
        for _ in range(round(seconds / 0.02)):
            step = b.tick(1, (0.8, 0.0, 0.0))
            b.gate.update_lean(b.now_ns, math.radians(degrees))
        return step

    assert lean(2.0, 40.0).velocity == BodyVelocity(0.8), "on stairs it drives"
    lean(0.2, 80.0)
    assert lean(1.0, 5.0).velocity == BodyVelocity(0.8), "one lean that nobody can have says nothing"
    step = lean(0.5, 80.0)
    assert is_zero(step)
    assert step.state == GateState.FAULT
    assert "TIPPED_OVER" in step.reason
    b.gate.reset(b.now_ns)
    b.gate.arm(b.now_ns)
    assert lean(0.04, 80.0).state == GateState.FAULT, "it still lies there"
    assert lean(1.0, 5.0).state == GateState.FAULT
    assert b.gate.reset(b.now_ns)[0]
    b.gate.arm(b.now_ns)
    assert lean(2.0, 5.0).velocity == BodyVelocity(0.8)
    b = Bench(m)
    assert lean(0.2, 80.0).state == GateState.ARMED, "from the first moment on it takes as long"
    assert lean(0.5, math.nan).state == GateState.FAULT, "what is not known is not upright"


def stale_input_stops(m: ModuleType) -> None:
    for name in ("has_points", "has_odometry"):
        b = Bench(m)
        b.tick(60, (0.8, 0.0, 0.0))
        setattr(b, name, False)
        timeout = 25 if name == "has_points" else 15
        step = b.tick(timeout, (0.8, 0.0, 0.0))
        assert step.velocity == BodyVelocity(0.8)
        step = b.tick(1, (0.8, 0.0, 0.0))
        assert step.state == GateState.FAULT
        assert "STALE" in step.reason
        assert is_zero(step), "it sees nothing: the base stops as hard as it can"
        setattr(b, name, True)
        step = b.tick(24, (0.8, 0.0, 0.0))
        assert is_zero(step), "it waits until the input has been fresh for a while"
        assert b.tick(10, (0.8, 0.0, 0.0)).velocity.vx > 0.0
    for name in ("has_points", "has_odometry"):
        b = Bench(m)
        setattr(b, name, False)
        assert is_zero(b.tick(30, (0.5, 0.0, 0.0))), "never seen is as bad as old"
    b = Bench(m)
    b.gate.update_points("roof", b.now_ns, b.points, b.pose)
    assert "roof" in b.tick(30, (0.5, 0.0, 0.0)).reason


def input_from_the_future_is_stale(m: ModuleType) -> None:
    b = Bench(m)
    b.tick(10)
    b.has_points = False
    b.gate.update_points("laser", b.now_ns + 10**12, b.points, b.pose)
    assert b.tick().state == GateState.FAULT


def a_pose_from_the_future_is_replaced(m: ModuleType) -> None:
    b = Bench(m)
    b.tick(10)
    b.gate.update_odometry(b.now_ns - TICK_NS, SE2(5.0, 0.0))
    assert b.gate._odometry == (b.now_ns, b.pose), "one that is merely older is not taken"
    b.gate.update_odometry(b.now_ns + 10**12, SE2(5.0, 0.0))
    assert b.tick(60, (0.5, 0.0, 0.0)).velocity.vx > 0.0
    assert b.gate._odometry[0] == b.now_ns


def a_starved_gate_stops(m: ModuleType) -> None:
    b = Bench(m)
    b.tick(60, (0.5, 0.0, 0.0))
    b.now_ns += 230_000_000
    assert b.tick(1, (0.5, 0.0, 0.0)).state == GateState.ARMED
    b.now_ns += 240_000_000
    step = b.tick(1, (0.5, 0.0, 0.0))
    assert step.state == GateState.FAULT
    assert "STARVED" in step.reason
    assert b.tick(40, (0.5, 0.0, 0.0)).state == GateState.ARMED


def it_never_touches_a_wall(m: ModuleType) -> None:
    for ask in ((0.8, 0.0, 0.0), (0.5, 0.1, 0.0), (0.5, 0.0, -0.2)):
        b = Bench(m)
        wall = wall_ahead(1.2)
        for _ in range(150):
            b.points = b.pose.inverse().transform(wall)
            b.tick(1, ask)
            near = b.pose.inverse().transform(wall)
            outside = np.maximum(np.abs(near[:, 0]) - 0.4, np.abs(near[:, 1]) - 0.2)
            assert outside.min() > TOUCH
        assert b.pose.distance_to(SE2()) > 0.5
        assert any(s.state == GateState.PROTECTIVE_STOP for s in b.log)


def it_brakes_gently_and_backs_off_at_once(m: ModuleType) -> None:
    b = Bench(m)
    wall = wall_ahead(1.8)
    while b.now_ns < 5_000_000_000:
        b.points = b.pose.inverse().transform(wall)
        b.tick(1, (0.8, 0.0, 0.0))
        if b.log[-1].state == GateState.PROTECTIVE_STOP:
            break
    speeds = [s.velocity.vx for s in b.log]
    assert max(speeds) > 0.7
    assert min(b - a for a, b in itertools.pairwise(speeds)) > -0.1
    assert any(s.reason.startswith("SLOWED") for s in b.log)
    assert 1.8 - 0.4 - b.pose.x < 0.06
    b.points = b.pose.inverse().transform(wall)
    step = b.tick(1, (-0.2, 0.0, 0.0))
    assert step.velocity.vx < 0.0, "backing off is free at once"
    assert step.state == GateState.ARMED


def it_resumes_after_a_while(m: ModuleType) -> None:
    b = Bench(m)
    b.points = cluster(0.42, 0.0)
    assert b.tick(5, (0.5, 0.0, 0.0)).state == GateState.PROTECTIVE_STOP
    b.points = np.array([[50.0, 0.0]])
    assert is_zero(b.tick(100, (0.5, 0.0, 0.0)))
    assert b.tick(2, (0.5, 0.0, 0.0)).velocity.vx > 0.0
    b = Bench(m)
    b.points = cluster(0.42, 0.0)
    b.tick(5, (0.5, 0.0, 0.0))
    assert b.tick(150).state == GateState.PROTECTIVE_STOP, "asking for nothing does not clear the field"
    b.points = np.array([[50.0, 0.0]])
    assert b.tick(105).state == GateState.ARMED


def points_move_with_the_odometry(m: ModuleType) -> None:
    b = Bench(m)
    b.points = cluster(1.0, 0.0)
    b.tick(1)
    b.has_points = False
    b.pose = SE2(0.57, 0.0, 0.0)
    b.tick(20, (0.0, 0.0, 0.0))
    assert b.tick(1, (0.5, 0.0, 0.0)).state == GateState.PROTECTIVE_STOP


def an_order_to_stop_holds_as_long_as_it_stands(m: ModuleType) -> None:
    wanted = (0.5, 0.2, 0.6)
    for level, sees in ((0, True), (1, True), (2, True), (7, True), (-1, True), (2, False)):
        bench = Bench(m)
        bench.tick(100, wanted)
        assert bench.log[-1].velocity.vx > 0.3
        bench.gate.order_stop(level)
        bench.has_points = sees
        step = bench.tick(100, wanted)
        v = step.velocity
        if not sees:
            assert step.state is GateState.FAULT, "a blind gate says so, whatever was ordered"
            assert is_zero(step)
        elif level == 0:
            assert v.vx > 0.3
        elif level == 1:
            assert (v.vx, v.vy) == (0.0, 0.0)
            assert v.wz > 0.3
        else:
            assert is_zero(step)
            assert step.state is GateState.PAUSED
        begun = bench.log[100:]
        changes = [a.velocity.vx - b.velocity.vx for a, b in itertools.pairwise(begun)]
        assert not sees or max(changes) <= LIMITS.ax_brake * 0.02 + 1e-9, "it brakes gently"
        bench.has_points = True
        bench.gate.order_stop(0)
        assert bench.tick(200, wanted).velocity.vx > 0.3, "it latches nothing"
    bench = Bench(m, is_armed=False)
    bench.gate.order_stop(0)
    assert is_zero(bench.tick(20, wanted)), "the end of an order arms nothing"
    latched = Bench(m)
    latched.tick(50, wanted)
    latched.gate.emergency_stop(latched.now_ns, "page", "a button")
    latched.gate.order_stop(2)
    latched.gate.order_stop(0)
    assert latched.tick(20, wanted).state is GateState.EMERGENCY_STOP


CHECKS = {
    "limits": (
        speeds_are_limited_on_the_same_arc,
        a_missing_axis_is_left_out,
        accelerations_are_limited,
        every_axis_has_its_own_limit,
        turning_the_velocity_makes_it_no_faster,
        numbers_are_told_from_nonsense,
    ),
    "selection": (priorities_and_timeouts_choose, old_requests_are_void),
    "stops": (stops_stay_until_every_cause_is_gone,),
    "protective_stop": (a_protective_stop_holds_frees_and_resumes, leading_away_means_no_component_along),
    "field": (
        the_field_grows_with_the_speed,
        the_safe_speed_just_stops,
        the_field_looks_only_where_the_motion_leads,
        the_field_is_as_long_as_the_way_to_stop,
    ),
    "approach_permit": (
        only_the_outline_is_left_out_and_only_for_a_while,
        a_permitted_robot_is_slow_and_goes_only_so_deep,
        a_permit_holds_in_its_corridor_only,
        renewing_moves_no_dock_and_ends_some_day,
        odd_permits_are_refused,
    ),
    "gate": (
        it_starts_paused_and_moves_only_when_armed,
        a_permit_lets_the_robot_touch_the_dock_and_nothing_else,
        arming_twice_changes_nothing,
        output_respects_all_limits,
        a_long_step_uses_little_acceleration,
        sources_run_out,
        nonsense_stops_for_good,
        odd_stamps_are_refused,
        an_emergency_stop_is_latched,
        a_base_on_its_side_does_not_move,
        stale_input_stops,
        input_from_the_future_is_stale,
        a_pose_from_the_future_is_replaced,
        a_starved_gate_stops,
        it_never_touches_a_wall,
        it_brakes_gently_and_backs_off_at_once,
        it_resumes_after_a_while,
        points_move_with_the_odometry,
        an_order_to_stop_holds_as_long_as_it_stands,
    ),
}
