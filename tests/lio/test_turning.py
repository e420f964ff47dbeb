"""How much a recording turned about which axes, and what is believed of a mount that hardly turned."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig
from ambler.lio.offline import run_offline
from ambler.lio.turning import least_turn
from ambler.sim.hand_path import HandPath, Sway
from ambler.sim.hand_rig import HandRig
from ambler.sim.site import draw_hall
from tests.lio.carried import SMALL, scans_of

STAMPS_NS = np.arange(0, 60_000_000_000, 100_000_000)


def swayed(roll: float, pitch: float, yaw: float) -> list[SE3]:
    """Turned to and fro by so many radians, 6 s each way, for 20 s about one axis, then about the next."""
    t = STAMPS_NS * 1e-9
    sine = np.sin(math.pi * t / 6.0)
    angles = np.where((t // 20.0).astype(int)[:, None] == np.arange(3), sine[:, None] * (roll, pitch, yaw), 0.0)
    return [SE3.from_rpy((0.0, 0.0, 0.0), *row) for row in angles.tolist()]


def test_who_turns_about_the_vertical_only_did_not_turn_about_all_axes() -> None:
    spun = [
        SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, 0.5 * k) for k in range(len(STAMPS_NS))
    ]  # beyond half a turn: other signs
    assert least_turn(STAMPS_NS, spun) < 1e-6


@pytest.mark.parametrize("least", [0.05, 0.2])
def test_the_axis_about_which_it_turned_least_counts(least: float) -> None:
    """Over 3 s a sine of 6 s each way is one of √2 of its height, whose RMS is the height; a third of the time."""
    for angles in ((least, 0.3, 0.3), (0.3, least, 0.3), (0.3, 0.3, least)):
        assert math.isclose(least_turn(STAMPS_NS, swayed(*angles)), least / math.sqrt(3.0), rel_tol=0.15)


def test_the_sign_of_a_quaternion_is_no_turn() -> None:
    rng = np.random.default_rng(1)
    shaken = [SE3.from_rpy((0.0, 0.0, 0.0), *rng.normal(0.0, 0.001, 3)).rotation for _ in STAMPS_NS]
    signs = rng.choice((-1.0, 1.0), len(shaken)).tolist()
    poses = [SE3((0.0, 0.0, 0.0), (s * w, s * x, s * y, s * z)) for s, (w, x, y, z) in zip(signs, shaken, strict=True)]
    assert least_turn(STAMPS_NS, poses) < 0.003


def test_what_was_not_followed_for_long_tells_nothing() -> None:
    assert least_turn(STAMPS_NS[:20], swayed(0.1, 0.1, 0.1)[:20]) == 0.0


def test_what_happened_in_a_hole_is_no_turn() -> None:
    """Level for 15 s, then nothing for a minute, then level again with a lean about one axis, and so on."""
    leans = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    poses = [SE3.from_rpy((0.0, 0.0, 0.0), *lean) for lean in leans for _ in range(150)]
    assert least_turn(STAMPS_NS, poses) > 0.03
    assert least_turn(STAMPS_NS + np.repeat(np.arange(4), 150) * 60_000_000_000, poses) < 1e-9


def test_the_mount_of_what_hardly_turned_stays_as_it_was_told() -> None:
    """On a floor the lean of the IMU's axes looks like one of the mount."""
    site = draw_hall(3, 25.0)
    rig = HandRig(site.world, HandPath(site.way, sway=Sway.none()), SMALL, 3)
    scans = tuple(rig.scans())
    flat, asked = (
        run_offline(scans_of(scans), config, rig.told_mount)
        for config in (LioConfig(), replace(LioConfig(), estimates_mount=True))
    )
    assert flat.imu_from_lidar == rig.told_mount
    assert asked.imu_from_lidar != rig.told_mount
    assert flat.clock_off is None
