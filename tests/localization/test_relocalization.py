"""Global relocalization, ambiguity, kidnapping, people, and reflectors without a prior pose."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.localization.localizer import Localizer, Observation
from ambler.localization.particle_filter import ParticleFilter, ParticleFilterConfig
from ambler.localization.reflectors import ReflectorMap, ReflectorSurvey, recognize
from ambler.localization.relocalizer import RelocalizationState, Relocalizer, RelocalizerConfig
from ambler.localization.supervisor import LocalizationState, Supervisor, SupervisorConfig
from ambler.localization.surface_map import SurfaceMap
from ambler.registration.reflectors import DetectorConfig, detect_reflectors
from tests.localization import rooms
from tests.localization.rooms import Room, error_of


def random_pose(surfaces: SurfaceMap, room: Room, rng: np.random.Generator, clear: float = 0.4) -> SE2:
    while True:
        x, y = rng.uniform((0.5, 0.5), (room.size[0] - 0.5, room.size[1] - 0.5))
        pose = SE2(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))
        if surfaces.is_free(pose) and surfaces.distance[surfaces.spec.cell_of(x, y)] > clear:
            return pose


def small_move(surfaces: SurfaceMap, pose: SE2, rng: np.random.Generator) -> SE2:
    while True:
        angle = float(rng.uniform(-math.pi, math.pi))
        motion = SE2(0.5 * math.cos(angle), 0.5 * math.sin(angle), float(rng.uniform(-0.5, 0.5)))
        there = pose @ motion
        if surfaces.is_free(there) and surfaces.distance[surfaces.spec.cell_of(there.x, there.y)] > 0.3:
            return motion


@pytest.fixture(scope="module")
def office() -> tuple[Room, SurfaceMap]:
    room = rooms.office()
    return room, SurfaceMap.from_occupancy(*room.occupancy())


def test_finds_itself_anywhere_and_only_believes_a_second_view(office: tuple[Room, SurfaceMap]) -> None:
    room, surfaces = office
    rng = np.random.default_rng(0)
    relocalizer = Relocalizer(surfaces, RelocalizerConfig())
    found = wrong = 0
    for _ in range(20):
        relocalizer.reset()
        pose = random_pose(surfaces, room, rng)
        first = relocalizer.update(Observation(0, SE2(), room.scan(pose, rng, beams=480)))
        assert first.state is not RelocalizationState.FOUND
        again = relocalizer.update(Observation(1, SE2(), room.scan(pose, rng, beams=480)))
        assert again.state is first.state  # the same place is no second viewpoint
        motion = small_move(surfaces, pose, rng)
        answer = relocalizer.update(Observation(2, motion, room.scan(pose @ motion, rng, beams=480)))
        if answer.state is RelocalizationState.FOUND:
            error = error_of(answer.hypotheses[0].map_from_base, pose @ motion)
            is_right = math.hypot(error[0], error[1]) < 0.05 and abs(error[2]) < 0.02
            found += is_right
            wrong += not is_right
    assert wrong == 0
    assert found >= 19


@pytest.mark.parametrize(("hidden", "views"), [(0.2, 2), (0.38, 3)])
def test_the_more_people_hide_the_more_views_it_takes_where_no_other_place_comes_near(
    hidden: float, views: int, office: tuple[Room, SurfaceMap]
) -> None:
    room, surfaces = office
    rng = np.random.default_rng(5)
    relocalizer = Relocalizer(surfaces, RelocalizerConfig())
    needed = []
    for _ in range(12):
        relocalizer.reset()
        pose, odom, taken = random_pose(surfaces, room, rng, 0.8), SE2(), 0
        state = RelocalizationState.VERIFYING
        while state is not RelocalizationState.FOUND and taken < 6:
            points = room.scan(pose, rng, beams=480)
            is_hidden = np.arange(len(points)) % 50 < 50 * hidden
            points[is_hidden] *= (0.4 / np.hypot(*points[is_hidden].T))[:, None]
            answer = relocalizer.update(Observation(taken, odom, points))
            state, taken = answer.state, taken + 1
            if state is RelocalizationState.FOUND:
                assert answer.hypotheses[0].map_from_base.distance_to(pose) < 0.1
            motion = small_move(surfaces, pose, rng)
            pose, odom = pose @ motion, odom @ motion
        needed.append(taken)
    assert float(np.median(needed)) == views, needed


def test_says_that_places_look_alike_until_the_door_is_seen() -> None:
    """Two equal rooms side by side differ only in what stands far from the first viewpoint."""
    rooms_ = (rooms.box(5.0, 3.0, 0.2, 6.0), rooms.box(1.5, 5.5, 1.0, 0.5), rooms.box(6.6, 5.5, 1.0, 0.5))
    room = Room("twins", (10.0, 6.0), rooms_)
    surfaces = SurfaceMap.from_occupancy(*room.occupancy())
    rng = np.random.default_rng(1)
    relocalizer = Relocalizer(surfaces, RelocalizerConfig())
    pose = SE2(2.0, 2.5, 0.4)
    first = relocalizer.update(Observation(0, SE2(), room.scan(pose, rng)))
    assert first.state is RelocalizationState.AMBIGUOUS
    assert first.needs_movement
    assert len(first.hypotheses) >= 2
    motion = SE2(0.5, 0.0, 0.2)
    second = relocalizer.update(Observation(1, motion, room.scan(pose @ motion, rng)))
    assert second.state is RelocalizationState.AMBIGUOUS
    best = [h.map_from_base for h in second.hypotheses]
    assert any(p.distance_to(pose @ motion) < 0.05 for p in best)


def test_a_scan_of_another_building_is_found_nowhere(office: tuple[Room, SurfaceMap]) -> None:
    _, surfaces = office
    rng = np.random.default_rng(2)
    relocalizer = Relocalizer(surfaces, RelocalizerConfig())
    hall = Room("hall", (30.0, 25.0), (rooms.box(15.0, 12.0, 3.0, 2.0, 0.7),))
    answer = relocalizer.update(Observation(0, SE2(), hall.scan(SE2(8.0, 7.0, 0.3), rng)))
    assert answer.state is RelocalizationState.NOT_FOUND
    nothing = relocalizer.update(Observation(1, SE2(), np.empty((0, 2), np.float32)))
    assert nothing.state is RelocalizationState.NOT_FOUND


def make(kind: str, surfaces: SurfaceMap) -> Localizer:
    if kind == "grid_tracker":
        return GridTracker(surfaces, GridTrackerConfig())
    return ParticleFilter(surfaces, ParticleFilterConfig(), np.random.default_rng(3))


@pytest.mark.parametrize("kind", ["grid_tracker", "particles"])
def test_kidnapping_is_noticed_within_2_s_and_healed_within_10(kind: str, office: tuple[Room, SurfaceMap]) -> None:
    room, surfaces = office
    rng = np.random.default_rng(4)
    for _ in range(6):
        localizer = make(kind, surfaces)
        supervisor = Supervisor(surfaces, localizer, Relocalizer(surfaces, RelocalizerConfig()), SupervisorConfig())
        pose, odom, stamp = random_pose(surfaces, room, rng), SE2(), 0
        localizer.set_pose(stamp, odom, pose, np.eye(3) * 1e-3)
        supervisor.trust()
        for _ in range(8):
            result = supervisor.update(Observation(stamp, odom, room.scan(pose, rng, beams=360)))
            stamp += 100_000_000
        assert result.state is LocalizationState.TRACKING
        there = random_pose(surfaces, room, rng)
        while there.distance_to(pose) < 1.0:
            there = random_pose(surfaces, room, rng)
        noticed = healed = math.inf
        for k in range(100):
            turn = SE2(0.0, 0.0, 0.06)  # it turns slowly, as permitted
            there, odom = there @ turn, odom @ turn
            result = supervisor.update(Observation(stamp, odom, room.scan(there, rng, beams=360)))
            stamp += 100_000_000
            if result.state in (LocalizationState.LOST, LocalizationState.RELOCALIZING):
                noticed = min(noticed, 0.1 * (k + 1))
            elif noticed < math.inf:
                healed = 0.1 * (k + 1)
                break
        assert noticed <= 2.0
        assert healed <= 10.0
        assert result.estimate is not None
        assert result.estimate.map_from_base.distance_to(there) < 0.05


def test_people_all_around_for_a_moment_do_not_make_it_lost(office: tuple[Room, SurfaceMap]) -> None:
    room, surfaces = office
    rng = np.random.default_rng(5)
    pose, stamp = SE2(7.0, 4.0, 0.3), 0
    localizer = make("grid_tracker", surfaces)
    supervisor = Supervisor(surfaces, localizer, Relocalizer(surfaces, RelocalizerConfig()), SupervisorConfig())
    localizer.set_pose(0, SE2(), pose, np.eye(3) * 1e-3)
    supervisor.trust()
    states = set()
    for k in range(60):
        points = room.scan(pose, rng, beams=360)
        if 20 <= k < 50:  # half of the view is hidden for three seconds
            hidden = points[:, 1] > 0
            points[hidden] *= np.float32(0.5)
        result = supervisor.update(Observation(stamp, SE2(), points))
        states.add(result.state)
        stamp += 100_000_000
    assert states <= {LocalizationState.TRACKING, LocalizationState.DEGRADED}
    assert LocalizationState.DEGRADED in states
    assert result.state is LocalizationState.TRACKING


def test_reflectors_are_found_recognized_and_learned() -> None:
    room = rooms.office()
    rng = np.random.default_rng(6)
    pose = SE2(7.0, 4.0, 0.3)
    points = room.scan(pose, rng, beams=1440)
    sighting = detect_reflectors(points, room.intensities(pose, points), DetectorConfig())
    assert len(sighting.centers) >= 4
    there = pose.transform(sighting.centers)
    known = room.reflectors.positions
    away = np.hypot(*(there[:, None] - known[None]).transpose(2, 0, 1)).min(axis=1)
    assert np.median(away) < 0.015
    recognition = recognize(sighting.centers, room.reflectors)
    assert recognition.map_from_base is not None
    error = error_of(recognition.map_from_base, pose)
    assert np.hypot(error[0], error[1]) < 0.05
    survey = ReflectorSurvey()
    for k in range(12):
        at = pose @ SE2(0.1 * k, 0.0, 0.05 * k)
        seen = room.scan(at, rng, beams=1440)
        found = detect_reflectors(seen, room.intensities(at, seen), DetectorConfig())
        survey.add(found.centers, at, np.diag([1e-5, 1e-5, 1e-6]))
    learned = survey.result()
    assert len(learned.positions) >= 4
    nearest = np.hypot(*(learned.positions[:, None] - known[None]).transpose(2, 0, 1)).min(axis=1)
    assert np.median(nearest) < 0.01
    assert np.percentile(nearest, 90) < 0.03


def test_a_glint_seen_once_is_not_learned_as_a_reflector() -> None:
    """Two reflectors are seen from twelve poses, something bright (a bumper, a window) from one: it is not in the map."""
    true, survey = np.array([[4.0, 1.0], [4.0, -2.0]]), ReflectorSurvey()
    rng = np.random.default_rng(3)
    for k in range(12):
        pose = SE2(0.1 * k, 0.0, 0.1 * k)
        seen = pose.inverse().transform(true) + 0.01 * rng.standard_normal((2, 2))
        glint = pose.inverse().transform(np.array([[2.0, 2.0]]))
        survey.add(np.vstack([seen, glint]) if k == 5 else seen, pose, np.diag([1e-6, 1e-6, 1e-8]))
    learned = survey.result()
    assert learned.positions == pytest.approx(true, abs=0.01)
    assert (learned.sigmas < 0.01).all()


def test_reflectors_that_fit_twice_are_not_believed() -> None:
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    answer = recognize(SE2(1.0, 1.5, 0.3).inverse().transform(square), ReflectorMap.surveyed(square))
    assert answer.map_from_base is None
    assert "several places" in answer.text
    few = recognize(square[:2], ReflectorMap.surveyed(square))
    assert few.map_from_base is None
    with pytest.raises(BadInputError):
        ReflectorMap.surveyed(np.array([[math.nan, 0.0]]))
    with pytest.raises(BadInputError):
        detect_reflectors(np.zeros((3, 2), np.float32), np.zeros(2, np.float32), DetectorConfig())


def lost_in_the_office(office: tuple[Room, SurfaceMap]) -> tuple[Supervisor, Room, np.random.Generator]:
    """A supervisor that was told no pose."""
    (room, surfaces), rng = office, np.random.default_rng(4)
    localizer = GridTracker(surfaces, GridTrackerConfig())
    relocalizer = Relocalizer(surfaces, RelocalizerConfig())
    return Supervisor(surfaces, localizer, relocalizer, SupervisorConfig()), room, rng


def seen_at(room: Room, rng: np.random.Generator, way: float, stamp_ns: int, start: SE2) -> Observation:
    motion = SE2(way, 0.0, 0.0)
    return Observation(stamp_ns, motion, room.scan(start @ motion, rng, beams=480))


def test_a_search_in_the_background_is_carried_to_what_is_seen_by_then(office: tuple[Room, SurfaceMap]) -> None:
    supervisor, room, rng = lost_in_the_office(office)
    start = SE2(7.0, 4.0, 0.3)
    assert supervisor.step(seen_at(room, rng, 0.0, 0, start)).state is LocalizationState.RELOCALIZING
    first = supervisor.take_search()
    assert first is not None
    assert supervisor.take_search() is None, "one at a time"
    told = supervisor.commit(first())
    assert told is not None
    assert told.state is LocalizationState.RELOCALIZING, "one view is not enough"
    supervisor.step(seen_at(room, rng, 0.5, 1, start))
    second = supervisor.take_search()
    assert second is not None
    supervisor.step(seen_at(room, rng, 0.9, 2, start))  # while it searches the robot drives on
    told = supervisor.commit(second())
    assert told is not None
    assert told.state is LocalizationState.TRACKING
    assert told.stamp_ns == 2
    assert told.estimate is not None
    assert told.estimate.map_from_base.distance_to(start @ SE2(0.9, 0.0, 0.0)) < 0.02


def test_a_place_that_does_not_explain_what_is_seen_by_then_is_not_believed(office: tuple[Room, SurfaceMap]) -> None:
    supervisor, room, rng = lost_in_the_office(office)
    start = SE2(7.0, 4.0, 0.3)
    for way in (0.0, 0.5):
        supervisor.step(seen_at(room, rng, way, int(10 * way), start))
        work = supervisor.take_search()
        assert work is not None
        found = work()
        if way == 0.0:
            supervisor.commit(found)
    carried_off = Observation(9, SE2(0.55, 0.0, 0.0), room.scan(start @ SE2(-2.5, 0.5, 2.0), rng, beams=480))
    supervisor.step(carried_off)
    told = supervisor.commit(found)
    assert told is not None
    assert found.answer is not None
    assert found.answer.state is RelocalizationState.FOUND
    assert told.state is LocalizationState.RELOCALIZING
    assert told.estimate is None


def test_a_search_that_was_overtaken_is_void(office: tuple[Room, SurfaceMap]) -> None:
    supervisor, room, rng = lost_in_the_office(office)
    start = SE2(7.0, 4.0, 0.3)
    seen = seen_at(room, rng, 0.0, 0, start)
    supervisor.step(seen)
    work = supervisor.take_search()
    assert work is not None
    supervisor.localizer.set_pose(0, SE2(), start)
    supervisor.trust()
    assert supervisor.commit(work()) is None
    assert supervisor.state is LocalizationState.TRACKING
