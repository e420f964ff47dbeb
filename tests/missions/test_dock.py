"""The docking mission on a kinematic robot before a dock: it docks, and every fault leads to a retry or to a named failure, never to a
robot that goes on moving."""

from __future__ import annotations

import inspect
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.docking.detection import DockDetection
from ambler.docking.dock import Contacts
from ambler.missions import dock
from ambler.missions.dock import DockMission
from ambler.missions.dock_commands import DockState, RevokeApproach, StopCharging
from ambler.missions.drive_to import DriveTo
from ambler.runtime.tasks import DOCK_FAILURES
from tests.missions.dock_site import COVARIANCE, DOCK, S, Site


def test_it_docks_within_millimetres_and_seconds() -> None:
    """Ten starts with full noise; the time counts from where the dock is in view, about a metre away."""
    errors, turns, times = [], [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        off = SE2(rng.uniform(-0.08, 0.08), rng.uniform(-0.08, 0.08), rng.uniform(-0.08, 0.08))
        site = Site(staging_error=off, seed=seed)
        ended = site.run()
        assert ended.code == "SUCCEEDED"
        assert ended.result.attempts == 1
        d = site.dock_from_base
        errors.append(math.hypot(d.x, d.y))
        turns.append(abs(d.yaw))
        times.append(ended.result.docking_seconds)
    assert np.percentile(errors, 95) < 0.003
    assert np.percentile(turns, 95) < math.radians(0.1)
    assert np.median(times) < 8.0
    assert site.states == [
        DockState.STAGING, *([DockState.SEARCHING] if DockState.SEARCHING in site.states else []),
        DockState.ALIGNING, DockState.APPROACHING, DockState.CONFIRMING, DockState.DOCKED,
    ]  # fmt: skip


def test_a_dock_without_contacts_ends_by_the_pose() -> None:
    site = Site(dock=replace(DOCK, contacts=Contacts.NONE))
    assert site.run().code == "SUCCEEDED"
    assert math.hypot(site.dock_from_base.x, site.dock_from_base.y) < 0.005
    assert site.deepest < 0.006


def test_a_switch_needs_no_charge() -> None:
    site = Site(dock=replace(DOCK, contacts=Contacts.SWITCH), has_power=lambda site: False)
    assert site.run().code == "SUCCEEDED"


def test_a_dock_that_was_moved_is_docked_where_it_is() -> None:
    moved = DOCK.map_from_dock @ SE2(0.05, -0.12, 0.15)
    site = Site(true_dock=moved)
    assert site.run().code == "SUCCEEDED"
    assert abs(site.dock_from_base.y) < 0.003


def test_a_dock_out_of_view_is_searched_for_by_turning() -> None:
    site = Site(staging_error=SE2(0.0, 0.0, 0.75))
    assert site.run().code == "SUCCEEDED"
    assert DockState.SEARCHING in site.states


def test_a_dock_that_is_never_seen_fails_after_a_second_staging() -> None:
    site = Site(is_visible=lambda site: False)
    ended = site.run(200.0)
    assert ended.code == "DOCK_NOT_SEEN"
    assert "charger was not seen" in ended.text
    assert sum(isinstance(c, DriveTo) for c in site.commands) == 2
    assert site.states[:4] == [DockState.STAGING, DockState.SEARCHING, DockState.STAGING, DockState.SEARCHING]


def test_a_dock_that_is_hidden_for_a_while_is_waited_for() -> None:
    site = Site(is_visible=lambda site: site.now_ns > 12 * S)
    assert site.run().code == "SUCCEEDED"


def test_a_marker_that_vanishes_far_away_leads_back_and_again() -> None:
    site = Site()
    hidden: list[int] = []

    def is_visible(s: Site) -> bool:
        if s.mission.state is DockState.APPROACHING and s.dock_from_base.x > -0.7 and not hidden:
            hidden.append(s.now_ns)
        return not hidden or s.now_ns > hidden[0] + 6 * S

    site.is_visible = is_visible
    ended = site.run()
    assert ended.code == "SUCCEEDED"
    assert ended.result.attempts == 2
    assert DockState.BACKING_OUT in site.states


def test_a_robot_that_sees_its_dock_no_more_goes_on_by_a_hand_and_not_by_a_step() -> None:
    """Hidden for good 0.7 m before the contact: 10 cm blind and the way of braking, not the half metre that odometry might carry it."""
    hidden: list[float] = []

    def is_visible(s: Site) -> bool:
        if s.mission.state is DockState.APPROACHING and s.dock_from_base.x > -0.7:
            hidden.append(s.dock_from_base.x)
        return not hidden

    site = Site(is_visible=is_visible)
    assert site.run(200.0).code in ("DOCK_LOST", "DOCK_NOT_SEEN")
    assert hidden
    assert -0.7 < site.deepest < -0.5


def test_a_marker_that_vanishes_near_the_contact_is_gone_without() -> None:
    """The camera loses sight of it in the last 20 cm: odometry carries the robot in."""
    site = Site(is_visible=lambda site: site.dock_from_base.x < -0.2)
    ended = site.run()
    assert ended.code == "SUCCEEDED"
    assert ended.result.attempts == 1
    assert abs(site.dock_from_base.y) < 0.006


@pytest.mark.parametrize(("contact", "code"), [(True, "NO_CHARGE"), (False, "NO_CONTACT")])
def test_without_charge_it_tries_three_times_and_leaves(contact: bool, code: str) -> None:
    site = Site(has_power=lambda site: False) if contact else Unreachable()
    ended = site.run(200.0)
    assert ended.code == code
    assert ended.result.attempts == 3
    assert "(3 attempts)" in ended.text
    assert site.dock_from_base.x == pytest.approx(-1.0, abs=0.08), "it stands before the dock again"
    assert site.deepest < 0.03


class Unreachable(Site):
    """A dock whose contacts never meet."""

    @property
    def is_touching(self) -> bool:
        return False


class Full(Site):
    """A battery that is full says so everywhere."""

    @property
    def is_touching(self) -> bool:
        return True


@pytest.mark.parametrize("contacts", [Contacts.CHARGE, Contacts.SWITCH])
def test_contact_that_is_told_away_from_the_dock_is_none(contacts: Contacts) -> None:
    """A robot whose battery tells contact all the time goes on to the docked pose."""
    site = Full(dock=replace(DOCK, contacts=contacts))
    assert site.run().code == "SUCCEEDED"
    assert abs(site.dock_from_base.x) < 0.012
    assert abs(site.dock_from_base.y) < 0.005


def test_outside_the_limits_it_backs_out_and_tries_again() -> None:
    """Somebody pushes the robot aside shortly before the contact, once."""
    site = Site()
    pushed: list[int] = []

    def push(s: Site) -> bool:
        if s.mission.state is DockState.APPROACHING and s.dock_from_base.x > -0.2 and not pushed:
            pushed.append(1)
            s.pose = s.pose @ SE2(0.0, 0.05, 0.06)
            s.tracker.reset()
            for k in range(3):
                see = DockDetection(s.now_ns - 3 + k, "test", s.pose.inverse() @ s.true_dock, COVARIANCE, 1)
                s.tracker.update(see, s.odom(), s.now_ns)
        return True

    site.is_visible = push
    ended = site.run()
    assert ended.code == "SUCCEEDED"
    assert ended.result.attempts == 2
    assert sum(isinstance(c, RevokeApproach) for c in site.commands) >= 2
    assert math.hypot(site.dock_from_base.x, site.dock_from_base.y) < 0.004


def test_something_in_the_way_is_named() -> None:
    site = Site(is_held=lambda site: site.mission.state is DockState.APPROACHING and site.dock_from_base.x > -0.5)
    ended = site.run(200.0)
    assert ended.code == "BLOCKED"
    assert "between robot and dock" in ended.text
    assert ended.result.attempts == 3
    behind = Site(
        is_held=lambda s: (
            s.mission.state is DockState.BACKING_OUT
            or (s.mission.state is DockState.APPROACHING and s.dock_from_base.x > -0.5)
        )
    )
    ended = behind.run(200.0)
    assert ended.code == "BLOCKED"
    assert "cannot back out" in ended.text


class Passing:
    """Somebody who stands in the way, and hides the dock, for so many seconds from when the robot is near."""

    def __init__(self, seconds: float, *, hides: bool) -> None:
        self.seconds, self.hides, self.begun_ns = seconds, hides, -1

    def is_there(self, site: Site) -> bool:
        if self.begun_ns < 0 and site.mission.state is DockState.APPROACHING and site.dock_from_base.x > -0.7:
            self.begun_ns = site.now_ns
        return self.begun_ns >= 0 and (site.now_ns - self.begun_ns) * 1e-9 < self.seconds


@pytest.mark.parametrize("hides", [False, True])
def test_who_passes_is_waited_for_without_a_failed_attempt(*, hides: bool) -> None:
    for seconds in (4.0, 7.0):
        passing = Passing(seconds, hides=hides)
        site = Site(is_held=passing.is_there, is_visible=lambda s, p=passing: not (p.hides and p.is_there(s)))
        ended = site.run(100.0)
        assert ended.code == "SUCCEEDED"
        assert ended.result.attempts == 1
        assert math.hypot(site.dock_from_base.x, site.dock_from_base.y) < 0.004


@pytest.mark.parametrize(("code", "named"), [("NO_VALID_PATH", "NAVIGATION_FAILED"), ("LOST", "LOST")])
def test_a_staging_pose_that_is_not_reached(code: str, named: str) -> None:
    ended = Site(navigation=code).run()
    assert ended.code == named
    assert code in ended.text


def test_beside_an_occupied_staging_pose_the_dock_is_looked_for_as_well() -> None:
    site = Site(navigation="NEAREST_REACHED", staging_error=SE2(-0.2, 0.15, 0.3))
    assert site.run().code == "SUCCEEDED"


def test_stale_input_stops_at_once_and_fails() -> None:
    site = Site(is_fresh=lambda site: site.dock_from_base.x < -0.6)
    ended = site.run()
    assert ended.code == "STALE_INPUT"
    assert site.dock_from_base.x < -0.5


STATES = [
    s
    for s in DockState
    if s not in (DockState.IDLE, DockState.DOCKED, DockState.UNDOCKED, DockState.FAILED, DockState.CANCELLED)
]


@pytest.mark.parametrize("state", STATES, ids=lambda s: s.name)
def test_it_can_be_cancelled_in_every_state(state: DockState) -> None:
    site = Site(has_power=lambda site: False)
    if state is DockState.SEARCHING:
        site.staging_error = SE2(0.0, 0.0, 0.75)
    if state is DockState.UNDOCKING:
        site.pose = site.true_dock
        site.do(site.mission.begin_undock(site.dock, 0))
    else:
        site.do(site.mission.begin(site.dock, 0))
    for _ in range(10_000):
        if site.mission.state is state and len(site.log) > 3 and [s for s, _ in site.log[-4:]] == [state] * 4:
            break
        site.tick()
    assert site.mission.state is state
    site.do(site.mission.cancel())
    assert site.mission.state is DockState.CANCELLED
    ended = site.run()
    assert ended.code == "CANCELLED"
    assert site.mission.cancel() == [], "a second cancel is no news"


def test_cancelling_at_random_instants_leaves_the_robot_at_rest() -> None:
    rng = np.random.default_rng(11)
    for seed in range(12):
        site = Site(seed=seed, staging_error=SE2(0.05, -0.05, 0.1))
        site.do(site.mission.begin(site.dock, 0))
        for _ in range(int(rng.integers(1, 700))):
            site.tick()
        site.do(site.mission.cancel())
        assert site.run().code in ("CANCELLED", "SUCCEEDED")


def test_a_new_docking_preempts_the_one_under_way() -> None:
    site = Site()
    site.do(site.mission.begin(site.dock, 0))
    while site.mission.state is not DockState.APPROACHING:
        site.tick()
    site.do(site.mission.cancel())
    site.ended = None
    assert site.run().code == "SUCCEEDED"


def test_undocking_stops_the_charge_and_backs_out_to_the_staging_pose() -> None:
    site = Site()
    site.run()
    site.ended, site.commands = None, []
    site.has_power = lambda s: not any(isinstance(c, StopCharging) for c in s.commands)
    site.do(site.mission.begin_undock(site.dock, site.now_ns))
    ended = site.run(120.0)
    assert ended.code == "SUCCEEDED"
    assert site.mission.state is DockState.UNDOCKED
    d = site.dock_from_base
    assert math.hypot(d.x + 1.0, d.y) < 0.08
    stuck = Site(start=DOCK.map_from_dock @ SE2(0.002, 0.0, 0.0))
    stuck.do(stuck.mission.begin_undock(stuck.dock, 0))
    assert stuck.run().code == "TIMEOUT", "a charger that does not stop keeps the robot"
    held = Site(start=DOCK.map_from_dock, is_held=lambda s: True)
    held.do(held.mission.begin_undock(held.dock, 0))
    assert held.run().code == "BLOCKED"


def test_every_failure_has_a_listed_name() -> None:
    """Whatever code stands in the mission's source is one that its task declares."""
    codes = set(re.findall(r'"([A-Z][A-Z_]+)"', inspect.getsource(dock)))
    assert len(codes) > 8
    assert codes <= {*DOCK_FAILURES, "SUCCEEDED", "CANCELLED"}


def test_a_mission_that_did_not_begin_has_nothing_to_cancel() -> None:
    assert DockMission().cancel() == []
    assert DockMission().attempts == 0
