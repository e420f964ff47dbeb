"""The study of relocalization in saved clouds: another day, walks, its counts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.lio.cloud_relocalizer import CloudState
from ambler.sim.decks import STOREY, draw_decks
from ambler.sim.hand_path import HandPath
from ambler.sim.other_day import change_site
from ambler.sim.scene import build_scene
from ambler.sim.site import draw_hall, draw_site
from ambler.studies import cloud_relocalization_study as study


def test_a_tenth_of_the_solids_is_elsewhere_or_gone_and_none_stands_in_the_way() -> None:
    site = draw_site(4, 200.0)
    changed, count = change_site(site, 0.1, np.random.default_rng(3))
    before, after = set(site.world.solids), set(changed.world.solids)
    assert count == pytest.approx(0.1 * len(before), abs=2.0)
    assert len(before - after) == count
    assert 0 < len(after - before) < count
    for solid in after - before:
        pose = solid.world_from_solid
        clear = np.hypot(site.way[:, 0] - pose.x, site.way[:, 1] - pose.y).min()
        assert clear > 0.5 * min(solid.size_x, solid.size_y) + 0.5
    assert {s.name for s in before - after}.isdisjoint({s.name for s in before if s.name.startswith("house")})
    trunks = {s.name.split("-")[1] for s in after if s.name.startswith("trunk")}
    assert trunks == {s.name.split("-")[1] for s in after if s.name.startswith("crown")}


@pytest.mark.parametrize("seed", range(4))
def test_the_way_through_the_decks_is_free_and_climbs_a_storey(seed: int) -> None:
    site = draw_decks(seed, 215.0)
    path = HandPath(site.way, is_closed=False)
    assert path.length == pytest.approx(215.0, rel=0.25)
    places = path.places(np.arange(0.0, path.length, 0.25))
    assert np.ptp(places[:, 2]) == pytest.approx(STOREY, abs=0.1)
    scene = build_scene(site.world)
    for direction in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)):
        found, _, _ = scene.cast(places, np.tile(direction, (len(places), 1)), 50.0)
        assert found.min() > 0.5  # nothing is walked through, ramp and slabs lie below


def test_walks_lie_beside_the_way_and_go_on_round_closed_ones() -> None:
    site = draw_hall(2, 60.0)
    whole = HandPath(site.way).places(np.arange(0.0, 60.0, 0.1))
    for seed in range(6):
        walk = study.draw_walk(site, np.random.default_rng(seed))
        assert study.WALK[0] - 1.0 < walk.length < study.WALK[1] + 4.0
        off = [np.hypot(*(whole[:, :2] - p[:2]).T).min() for p in walk.way]
        assert max(off) < study.ASIDE + 0.2
    assert study.draw_walk(site, np.random.default_rng(1), 150.0).length > 140.0


def test_the_truth_is_told_where_the_map_is_bent() -> None:
    true = tuple(SE3((float(x), 0.0, 0.0)) for x in range(10))
    poses = tuple(SE3((float(x), 0.01 * x * x, 0.0)) for x in range(10))
    made = study.MadeMap(None, poses, true)  # type: ignore[arg-type]
    assert made.truth(SE3((7.2, 0.5, 0.0))).translation == pytest.approx((7.2, 0.5 + 0.49, 0.0))


def test_a_wrong_pose_and_a_late_one_are_no_success() -> None:
    def follower(off: float, after: float, cpu: float = 0.5) -> study.Follower:
        wrong = off > study.FALSE_M
        return study.Follower(None, [(off, 0.1)] * 60, {"FOUND": 1}, cpu, after, cpu, off, 0.1, wrong)  # type: ignore[arg-type]

    assert study._told("none", follower(0.1, 5.0))["success"]
    assert not study._told("none", follower(0.7, 5.0))["success"]
    assert not study._told("none", follower(0.1, 9.8))["success"]  # what was computed counts
    assert study._told("guess", follower(0.1, 12.0))["success"]
    assert study._told("foreign", follower(0.1, 3.0)) | {"success": False, "false": 1} == study._told(
        "foreign", follower(0.1, 3.0)
    )
    assert study._told("foreign", study.Follower(None, [], {CloudState.AMBIGUOUS.name: 2}))["success"]  # type: ignore[arg-type]


def test_one_false_place_misses_the_bar() -> None:
    def told(false: list[int], success: list[bool]) -> dict[str, object]:
        names = {
            "success": success,
            "false": false,
            "ambiguous": [False] * 2,
            "lost": [False] * 2,
            "seconds": [1.0, None],
        }
        empty = dict.fromkeys(
            ("cpu", "error_m", "error_deg", "track_rms_m", "track_max_m", "track_end_rms_m"), [None] * 2
        )
        values = {f"{way}.{name}": v for way in study.WAYS for name, v in (names | empty).items()}
        return {
            "kind": "hall",
            "label": "hall-1",
            "way_m": 1.0,
            "map_points": 5,
            "map_prepare_s": 0.1,
            "solids_changed": 1,
            **values,
        }

    good = study.summarize([told([0, 0], [True, True])])
    assert good["is_met"] is True
    assert good["none.starts"] == 2
    assert good["none.success_interval_low"] < 0.5
    assert study.summarize([told([0, 1], [True, True])])["is_met"] is False
    assert study.summarize([told([0, 0], [True, False])])["is_met"] is False


def test_unknown_names_are_refused() -> None:
    study.check(["site", "decks"], "mid_360")
    for kinds, lidar in ((["moon"], "mid_360"), (["hall"], "radar")):
        with pytest.raises(BadInputError, match="one of"):
            study.check(kinds, lidar)


def test_guesses_are_off_by_what_was_asked_for() -> None:
    case = study.CloudRelocalizationCase("hall", 1, "mid_360", 1)
    offs = np.array([study._guess_error(case, np.random.default_rng(k)) for k in range(300)])
    far = np.linalg.norm(offs[:, :3], axis=1)
    assert far.max() <= 2.0 < 1.02 * far.max()
    assert np.abs(offs[:, 3]).max() <= math.radians(30.0) < 1.05 * np.abs(offs[:, 3]).max()
