"""What the campaign in made maps counts: moving and resting apart, per determined direction, and bars that crashed drives miss."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.evaluation.localization_quality import LocalizationErrors
from ambler.sim.faults import Fault, people_that_fit
from ambler.sim.robots import robot_named
from ambler.sim.solids import Shape, Solid
from ambler.sim.world import BodySpec, SimulationConfig, World
from ambler.sim.world_file import load_world
from ambler.studies.made_drives import MADE_METHODS, judged, nees, people_fault, rms
from ambler.studies.made_map import is_mapped
from ambler.studies.made_maps_study import summarize

S = 1_000_000_000


def errors(rows: list[tuple[float, float, float]], nees_of: list[float]) -> LocalizationErrors:
    """An estimate per second from 1 s on."""
    stamps = np.arange(1, len(rows) + 1) * float(S)
    return LocalizationErrors(stamps, np.array(rows), np.ones((len(rows), 3)), np.array(nees_of))


def test_moving_and_resting_poses_are_counted_apart_by_what_they_determine() -> None:
    stamps = np.arange(0, 50) * (S // 10)
    x = np.where(stamps < 2.5 * S, 0.0, (stamps - 2.5 * S) * 1e-9 * 0.5)
    truth = np.column_stack([x, np.zeros(50), np.zeros(50)])
    both, across = np.eye(2), np.diag([0.0, 1.0])
    told = errors([(0.03, 0.04, 0.0), (0.03, 0.04, 0.0), (0.5, 0.02, 0.0), (0.5, 0.02, 0.0)], [1.0, 3.0, 5.0, 7.0])
    drive = judged(told, stamps, truth, np.array([0.0, 2.0, 3.0, 4.5]) * S, np.array([both, both, across, across]))
    assert drive.is_moving.tolist() == [False, False, True, True]
    fields = {f"tracker.{name}": value for name, value in drive.fields().items()}
    assert rms(fields, "tracker", "rest") == pytest.approx(math.sqrt(0.5 * (0.03**2 + 0.04**2)))
    assert rms(fields, "tracker", "moving") == pytest.approx(0.02)  # along the corridor nothing was determined
    assert nees(fields, "tracker", "rest") == pytest.approx(2.0)
    assert nees(fields, "tracker", "moving") == pytest.approx(6.0)
    assert fields["tracker.moving_error_max_m"] == pytest.approx(math.hypot(0.5, 0.02))


def drive_result(world: str, error: float, mean_nees: float, poses: int = 100) -> dict[str, object]:
    out: dict[str, object] = {"world": f"{world}-day1", "label": world}
    for method in (m.name for m in MADE_METHODS):
        for how in ("moving", "rest"):
            prefix = f"{method}.{how}_"
            out |= {
                f"{prefix}poses": poses,
                f"{prefix}squares_m2": 2.0 * poses * error**2,
                f"{prefix}directions": 2.0 * poses,
                f"{prefix}nees_sum": mean_nees * poses,
                f"{prefix}error_max_m": 3.0 * error,
            }
    return out


def map_result(world: str) -> dict[str, object]:
    names = ("ate_rms_m", "ate_unaligned_rms_m", "bend_m", "bend_rad", "keyframes", "path_length_m")
    return {"world": world, **dict.fromkeys(names, 1.0)}


def lost(found: float | None, wrong: int = 0) -> dict[str, object]:
    return {"world": "flat-1-day1", "found": found, "wrong": wrong}


def test_the_bars_are_those_of_all_drives_together() -> None:
    maps = [map_result("flat-1"), map_result("office-2")]
    good = [drive_result("flat-1", 0.010, 0.8), drive_result("office-2", 0.014, 1.8)]
    fields = summarize(maps, good, [lost(2.0)] * 40)
    assert fields["tracker.error_rms_m"] == pytest.approx(math.sqrt(0.5 * (0.010**2 + 0.014**2)))
    assert fields["tracker.error_rms_worst_drive_m"] == pytest.approx(0.014)
    assert fields["tracker.static.nees_mean"] == pytest.approx(1.3)
    assert fields["flat-1.tracker.error_rms_m"] == pytest.approx(0.010)
    assert all(fields[name] for name in fields if name.startswith("bars."))
    for driven, started, missed in (
        ([drive_result("flat-1", 0.016, 1.0)], [lost(2.0)] * 40, "bars.tracker.error"),
        ([drive_result("flat-1", 0.010, 2.1)], [lost(2.0)] * 40, "bars.tracker.static.nees"),
        ([drive_result("flat-1", 0.010, 0.4)], [lost(2.0)] * 40, "bars.particles_scan.nees"),
        ([*good, {"label": "x", "ended": "crashed", "why": "no room"}], [lost(2.0)] * 40, "bars.tracker.error"),
        (good, [*[lost(2.0)] * 39, lost(2.0, wrong=1)], "bars.relocalization"),
        (good, [*[lost(2.0)] * 38, lost(None), lost(5.5)], "bars.relocalization"),
    ):
        assert not summarize(maps, driven, started)[missed], missed


def test_starts_where_the_map_knows_nothing_count_apart_but_wrong_ones_always() -> None:
    maps, good = [map_result("flat-1")], [drive_result("flat-1", 0.010, 0.8)]
    outside = {**lost(None), "is_mapped": False}
    fields = summarize(maps, good, [*[lost(2.0)] * 38, outside, outside])
    assert fields["bars.relocalization"]
    assert fields["relocalization.runs"] == 38
    assert fields["relocalization.unmapped"] == 2
    assert fields["relocalization.success_ratio_with_unmapped"] == pytest.approx(0.95)
    fields = summarize(maps, good, [*[lost(2.0)] * 38, {**lost(2.0, wrong=1), "is_mapped": False}])
    assert fields["relocalization.wrong"] == 1
    assert not fields["bars.relocalization"]


def test_only_known_cells_are_a_place_of_the_map() -> None:
    cells = np.array([[0, 100, -1, -1]], np.int8)
    spec = GridSpec(0.5, 4, 1, 10.0, 20.0)
    assert [is_mapped(cells, spec, SE2(10.25 + 0.5 * k, 20.25, 1.0)) for k in range(4)] == [True, True, False, False]
    assert not is_mapped(cells, spec, SE2(9.0, 20.25, 0.0))


def test_as_many_people_walk_about_as_there_is_room_for() -> None:
    world = load_world("two_rooms")
    everybody = people_that_fit(world, 3, (world.start,), 6)
    assert people_fault(6, world, 3, world.start) == ("people@6",)
    assert everybody == 6
    closet = replace(world, solids=(*world.solids, *boxes_beside(world.start)))
    assert people_that_fit(closet, 3, (closet.start,), 6) == 0
    assert people_fault(6, closet, 3, closet.start) == ()
    assert people_fault(0, world, 3, world.start) == ()


def test_people_that_fit_do_find_their_ways() -> None:
    """A robot that starts behind furniture shares its floor with nobody, though the rest of the office has room for many."""
    office = load_world("office")
    shut_in = office.start @ SE2(-4.0, 0.0, 0.0)
    world = replace(office, solids=(*office.solids, *boxes_beside(shut_in, 0.6)), people=())
    faults = tuple(Fault.parse(text) for text in people_fault(6, world, 7122, shut_in))
    assert faults == ()
    assert people_fault(6, world, 7122, world.start) == ("people@6",)
    for start, told, people in ((shut_in, faults, 0), (world.start, (Fault.parse("people@6"),), 6)):
        simulated = World(world, [BodySpec("robot", robot_named("diff"), start)], SimulationConfig(7122, faults=told))
        assert len(simulated.spec.people) == people


def boxes_beside(start: SE2, half: float = 1.5) -> list[Solid]:
    """Four walls of twice `half` metres around a pose."""
    return [
        Solid(
            f"closet{k}",
            Shape.BOX,
            start @ SE2(0.0, 0.0, 0.5 * math.pi * k) @ SE2(half, 0.0, 0.0),
            0.1,
            2.0 * half + 0.1,
            0.0,
            2.0,
        )
        for k in range(4)
    ]


def test_a_campaign_in_which_every_drive_crashed_says_why() -> None:
    with pytest.raises(BadInputError, match="every drive crashed: no room"):
        summarize([map_result("flat-1")], [{"label": "x", "ended": "crashed", "why": "no room"}], [])
