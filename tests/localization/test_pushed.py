"""Somebody walks into a robot that stands: it is moved by a quarter of a metre, and its wheels tell nothing of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.localization.grid_tracker import GridTracker, GridTrackerConfig
from ambler.localization.localizer import Localizer, Observation
from ambler.localization.particle_filter import ParticleFilter, ParticleFilterConfig
from ambler.localization.surface_map import SurfaceMap
from tests.localization import rooms

S = 1_000_000_000
SURE = np.diag([1e-4, 1e-4, 1e-5])


def made(kind: str, surfaces: SurfaceMap) -> Localizer:
    if kind == "tracker":
        return GridTracker(surfaces, GridTrackerConfig())
    return ParticleFilter(surfaces, ParticleFilterConfig(), np.random.default_rng(1))


@pytest.mark.parametrize("kind", ["tracker", "particles"])
def test_a_robot_that_is_pushed_is_where_its_scans_say_and_not_its_wheels(kind: str) -> None:
    """Four scans of 0.1 s, 7 cm and 2 degrees in each, odometry stands still; then it rests at the new place."""
    room, rng = rooms.office(), np.random.default_rng(3)
    localizer, pose, odom = made(kind, SurfaceMap.from_occupancy(*room.occupancy())), SE2(7.0, 4.0, 0.3), SE2()
    localizer.set_pose(0, odom, pose, SURE)
    for k in range(1, 40):
        pose = pose @ SE2(-0.07, 0.0, -0.035) if 20 < k <= 24 else pose
        estimate = localizer.update(Observation(k * S // 10, odom, room.scan(pose, rng, beams=360)))
        error = rooms.error_of(estimate.map_from_base, pose)
        if k > 3:
            assert math.hypot(error[0], error[1]) < 0.02, f"scan {k}"


def test_particles_that_stand_while_the_robot_is_pushed_do_not_draw_it_to_the_next_post_of_a_fence() -> None:
    """Posts every 0.35 m: matched from where the particles are, the pushed robot would be a post farther on."""
    posts = [rooms.box(1.0 + 0.35 * k, y, 0.1, 0.1) for k in range(34) for y in (0.5, 2.5)]
    room, rng = rooms.Room("fence", (14.0, 3.0), tuple(posts)), np.random.default_rng(3)
    particles, pose = made("particles", SurfaceMap.from_occupancy(*room.occupancy())), SE2(7.1, 1.5, 0.1)
    particles.set_pose(0, SE2(), pose, SURE)
    for k in range(1, 30):
        pose = pose @ SE2(-0.08, 0.0, 0.0) if 20 < k <= 23 else pose
        estimate = particles.update(Observation(k * S // 10, SE2(), room.scan(pose, rng, beams=360)))
        error = rooms.error_of(estimate.map_from_base, pose)
        assert k <= 3 or math.hypot(error[0], error[1]) < 0.02, f"scan {k}"


def test_one_scan_that_fits_elsewhere_does_not_carry_the_told_pose_there() -> None:
    """A quarter of the particles are in another room (as after doubt), and one scan looks like that room."""
    room, rng = rooms.office(), np.random.default_rng(3)
    config = ParticleFilterConfig()
    particles = ParticleFilter(SurfaceMap.from_occupancy(*room.occupancy()), config, np.random.default_rng(1))
    here, there = SE2(7.0, 4.0, 0.3), SE2(1.8, 4.4, -1.0)
    particles.set_pose(0, SE2(), here, SURE)
    for k in range(1, 4):
        particles.update(Observation(k * S // 10, SE2(), room.scan(here, rng, beams=360)))
    particles._particles[::4] = there.as_array() + 0.02 * rng.standard_normal((len(particles._particles[::4]), 3))
    told = particles.update(Observation(S // 2, SE2(), room.scan(there, rng, beams=360)))
    assert told.map_from_base.distance_to(here) < 0.5
    for k in range(6, 30):
        particles.request_update()
        told = particles.update(Observation(k * S // 10, SE2(), room.scan(there, rng, beams=360)))
    assert told.map_from_base.distance_to(there) < 0.05, "what is seen again and again is believed"


def test_while_a_match_is_refused_what_is_told_covers_it() -> None:
    """0.4 m within one scan is faster than anybody walks: not believed, but it may be true, and that is told."""
    room, rng = rooms.office(), np.random.default_rng(3)
    tracker, pose = made("tracker", SurfaceMap.from_occupancy(*room.occupancy())), SE2(7.0, 4.0, 0.3)
    tracker.set_pose(0, SE2(), pose, SURE)
    for k in range(1, 5):
        assert tracker.update(Observation(k * S // 10, SE2(), room.scan(pose, rng, beams=360))).is_updated
    aside = pose @ SE2(0.4, 0.0, 0.0)
    told = tracker.update(Observation(S // 2, SE2(), room.scan(aside, rng, beams=360)))
    assert not told.is_updated
    error = rooms.error_of(told.map_from_base, aside)
    assert error @ np.linalg.solve(told.covariance, error) / 3.0 < 2.0


@pytest.mark.parametrize("kind", ["tracker", "particles"])
@pytest.mark.parametrize("speed", [0.3, 0.8])
def test_somebody_who_is_drawn_in_the_map_and_walks_along_does_not_take_the_robot_along(
    kind: str, speed: float
) -> None:
    """A corridor of which two posts tell how far along it the robot is; beside the robot somebody stood when the map was made. He stands there again, and
    walks on as the robot does, or faster. Particles may lose the posts among his returns, but then they say so."""
    posts = (rooms.box(14.0, 0.1, 0.2, 0.2), rooms.box(27.0, 2.9, 0.2, 0.2))
    rng, start = np.random.default_rng(3), SE2(20.0, 1.2, 0.4)

    def corridor(x: float) -> rooms.Room:
        return rooms.Room("corridor", (40.0, 3.0), (*posts, rooms.box(x, 1.7, 0.4, 0.4)))

    localizer = made(kind, SurfaceMap.from_occupancy(*corridor(20.0).occupancy()))
    localizer.set_pose(0, SE2(), start, SURE)
    for k in range(1, 60):
        pose = SE2(20.0 + 0.03 * k, 1.2, 0.4 + 0.03 * k)
        scan = corridor(20.0 + 0.1 * speed * max(0, k - 15)).scan(pose, rng, reach=12.0)
        estimate = localizer.update(Observation(k * S // 10, start.inverse() @ pose, scan))
        error = rooms.error_of(estimate.map_from_base, pose)
        assert error @ np.linalg.solve(estimate.covariance, error) / 3.0 < 5.0, f"scan {k}"
        assert kind == "particles" or k <= 3 or math.hypot(error[0], error[1]) < 0.03, f"scan {k}"
