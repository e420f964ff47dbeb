"""Relocalization in a saved cloud on another day: maps made by `ambler lio`'s own run at drawn places, then random starts with a tenth of
the solids moved or gone, each with a guess and without any; and, told the map of another place, nothing must be found.

The truth is told in the map where the map was made: by the true pose of the mapping walk that was nearest, so that what the map itself is bent by is
not counted as an error of localization in it.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import recorded_config
from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.evaluation.proportions import wilson_interval
from ambler.lio.cloud_localizer import CloudLocalizer
from ambler.lio.cloud_map import CloudMap
from ambler.lio.cloud_match import apart
from ambler.lio.cloud_relocalizer import CloudState
from ambler.lio.config import LioConfig
from ambler.lio.health import LioResult
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.offline import run_offline
from ambler.recordings.cloud_scan import CloudScan
from ambler.sim.decks import draw_decks
from ambler.sim.hand_path import HandPath
from ambler.sim.hand_rig import LIDARS, HandRig
from ambler.sim.other_day import change_site
from ambler.sim.site import Site, draw_hall, draw_site
from ambler.studies.study import CRASHED, Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.wire.cloud_files import write_cloud

F64 = NDArray[np.float64]
KINDS = {"site": draw_site, "hall": draw_hall, "decks": draw_decks}
LENGTHS = {"site": (150.0, 300.0), "hall": (70.0, 130.0), "decks": (190.0, 240.0)}
WALK = (18.0, 26.0)  # metres from a start
ASIDE = 0.9  # metres beside the way of the map
SHARE = 0.1  # of the solids
FALSE_M, FALSE_DEG = 0.5, 5.0
SECONDS_MOST = 10.0
WAYS = ("guess", "none", "foreign")
BARS = {"guess": 59 / 60, "none": 54 / 60}  # that nothing is found in a foreign map is told, not asked for
FOREIGN_SEED, FOREIGN_SECONDS = 1_000_003, 6.0  # another place of the same kind, in which nothing must be found


@dataclass(frozen=True, slots=True)
class CloudRelocalizationCase:
    """One map and `starts` starts in it. A guess is off by up to `guess_way` m and `guess_turn_deg`; `walk` in metres from each start, None: drawn; `foreign` looks for each in the map of another
    place, too."""

    kind: str
    seed: int
    lidar: str
    starts: int
    walk: float | None = None
    foreign: bool = False
    guess_way: float = 2.0
    guess_turn_deg: float = 30.0
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.kind}-{self.seed}-{self.lidar}"


@dataclass(frozen=True, slots=True)
class MadeMap:
    """A saved cloud, and where the walk that made it truly was (`true`, map_from_imu told as `poses`)."""

    cloud: CloudMap
    poses: tuple[SE3, ...]
    true: tuple[SE3, ...]

    def truth(self, world_from_imu: SE3) -> SE3:
        """Return map_from_imu of a true pose in the world."""
        places = np.array([p.translation for p in self.true])
        k = int(np.argmin(((places - world_from_imu.translation) ** 2).sum(axis=1)))
        return self.poses[k] @ self.true[k].inverse() @ world_from_imu


@dataclass(slots=True)
class Follower:
    """One localizer on a walk, and what it said: errors (m, rad) of all poses told, when and how far off it believed itself found, and how many poses it told that were `wrong`."""

    localizer: CloudLocalizer
    errors: list[tuple[float, float]]
    states: dict[str, int]
    cpu: float = 0.0
    found_after: float | None = None
    found_cpu: float = 0.0
    found_m: float = 0.0
    found_deg: float = 0.0
    wrong: int = 0


def cloud_relocalization_study(cases: Sequence[CloudRelocalizationCase]) -> Study[CloudRelocalizationCase]:
    """Return the study of these maps."""
    return Study("relocalization3d", cases, run_case, _line)


def check(kinds: Sequence[str], lidar: str) -> None:
    """Raise BadInputError for names that are none."""
    for name, known in [*((k, tuple(KINDS)) for k in kinds), (lidar, tuple(LIDARS))]:
        if name not in known:
            raise BadInputError(f"{name!r}: one of {', '.join(known)}")


def run_case(case: CloudRelocalizationCase, folder: Path) -> dict[str, Any]:
    """Make the map, change the place, start in it again and again."""
    config = recorded_config(case.settings.profile).lio
    rng = np.random.default_rng([case.seed, 88])
    low, high = LENGTHS[case.kind]
    site = KINDS[case.kind](case.seed, float(rng.uniform(low, high)))
    made, mapped = make_map(case, site, config, folder)
    changed, solids = change_site(site, SHARE, rng)
    foreign = None
    if case.foreign:
        elsewhere = KINDS[case.kind](case.seed + FOREIGN_SEED, float(rng.uniform(low, high)))
        foreign = make_map(case, elsewhere, config, folder / "foreign")[0].cloud
    starts = [_start(case, made, foreign, changed, config, number) for number in range(case.starts)]
    fields: dict[str, Any] = {"map_points": len(made.cloud.points), "solids_changed": solids, **mapped}
    for way, told in starts[0].items():
        fields |= {f"{way}.{name}": [s[way][name] for s in starts] for name in told}
    return fields


def make_map(
    case: CloudRelocalizationCase, site: Site, config: LioConfig, folder: Path
) -> tuple[MadeMap, dict[str, float]]:
    """Map a site as `ambler lio` does, through a file, and prepare the cloud for localization."""
    path = HandPath(site.way, is_closed=site.is_closed)
    rig = HandRig(site.world, path, LIDARS[case.lidar], case.seed)
    known: dict[int, SE3] = {}

    def scans() -> Any:
        for scan in rig.scans():
            known[scan.end_ns] = scan.world_from_imu
            yield CloudScan(scan.cloud, scan.imu, scan.odometry)

    result = run_offline(scans(), config, rig.told_mount)
    folder.mkdir(parents=True, exist_ok=True)
    write_cloud(folder / "cloud.pcd", result.cloud)
    true = tuple(known[int(stamp)] for stamp in result.stamps_ns)
    begin = time.process_time()
    cloud = CloudMap.load(folder / "cloud.pcd", config.localize.map)
    return MadeMap(cloud, result.poses, true), {"way_m": path.length, "map_prepare_s": time.process_time() - begin}


def draw_walk(site: Site, rng: np.random.Generator, metres: float | None = None) -> HandPath:
    """Draw a walk from a random place of the way on, beside it, half of them against it; closed ways are gone round again where it is longer."""
    whole = HandPath(site.way, is_closed=site.is_closed)
    length = float(rng.uniform(*WALK)) if metres is None else metres
    length = length if site.is_closed else min(length, whole.length)
    begin = float(rng.uniform(0.0, whole.length - (0.0 if site.is_closed else length)))
    along = begin + np.arange(0.0, length + 2.0, 2.0)
    places = whole.places(along % whole.length if site.is_closed else np.minimum(along, whole.length))
    if rng.random() < 0.5:
        places = places[::-1]
    ahead = np.gradient(places[:, :2], axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
    places[:, :2] += float(rng.uniform(-ASIDE, ASIDE)) * left
    return HandPath(places, rest=1.5, is_closed=False, speed=float(rng.uniform(1.0, 1.6)))


def _start(
    case: CloudRelocalizationCase, made: MadeMap, foreign: CloudMap | None, site: Site, config: LioConfig, number: int
) -> dict[str, Any]:
    """Walk from one start with all localizers on the same odometry."""
    rng = np.random.default_rng([case.seed, 89, number])
    path = draw_walk(site, rng, case.walk)
    rig = HandRig(site.world, path, LIDARS[case.lidar], int(rng.integers(1 << 30)))
    off = _guess_error(case, rng)
    odometry = LidarInertialOdometry(config, rig.told_mount)
    followers: dict[str, Follower] = {}
    first_ns = 0
    for scan in rig.scans():
        result = odometry.update(CloudScan(scan.cloud, scan.imu, scan.odometry))
        if result is None:
            continue
        truth = made.truth(scan.world_from_imu)
        if not followers:
            first_ns = result.stamp_ns
            guess = SE3(tuple(np.add(truth.translation, off[:3]).tolist()), truth.rotation)
            guess = guess @ SE3.from_rpy((0.0, 0.0, 0.0), 0.0, 0.0, float(off[3]))
            told = [("guess", made.cloud, guess), ("none", made.cloud, None)]
            told += [("foreign", foreign, None)] if foreign is not None else []
            followers = {way: Follower(CloudLocalizer(cloud, config.localize, g), [], {}) for way, cloud, g in told}
        seconds = 1e-9 * (result.stamp_ns - first_ns)
        for way, follower in followers.items():
            if way != "foreign" or seconds < FOREIGN_SECONDS:
                _follow(follower, result, truth, seconds)
    return {way: _told(way, follower) for way, follower in followers.items()}


def _guess_error(case: CloudRelocalizationCase, rng: np.random.Generator) -> F64:
    """Draw what a guess is off by: within a ball, and in heading."""
    direction = rng.standard_normal(3) * [1.0, 1.0, 0.3]
    far = case.guess_way * float(rng.uniform(0.0, 1.0)) ** 0.5
    turn = math.radians(case.guess_turn_deg) * float(rng.uniform(-1.0, 1.0))
    return np.append(far * direction / np.linalg.norm(direction), turn)


def _follow(follower: Follower, result: LioResult, truth: SE3, seconds: float) -> None:
    begin = time.process_time()
    pose = follower.localizer.update(result)
    follower.cpu += time.process_time() - begin
    follower.states[pose.state.name] = follower.states.get(pose.state.name, 0) + 1
    if pose.map_from_imu is None:
        return
    off, turn = apart(truth, pose.map_from_imu)
    follower.errors.append((off, math.degrees(turn)))
    follower.wrong += off > FALSE_M or math.degrees(turn) > FALSE_DEG
    if follower.found_after is None:
        follower.found_after, follower.found_cpu = seconds, follower.cpu
        follower.found_m, follower.found_deg = off, math.degrees(turn)


def _told(way: str, follower: Follower) -> dict[str, Any]:
    """Return what one localizer did on one walk. `seconds` until found: those of the data and, on top, all that was computed meanwhile."""
    is_found = follower.found_after is not None
    seconds = (follower.found_after or 0.0) + follower.found_cpu if is_found else None
    later = [off for off, _ in follower.errors[30:]] if is_found else []
    is_in_time = seconds is not None and (way == "guess" or seconds <= SECONDS_MOST)
    wrong = int(is_found) if way == "foreign" else follower.wrong
    return {
        "success": not is_found if way == "foreign" else bool(is_in_time and not wrong),
        "false": wrong,
        "seconds": seconds,
        "cpu": follower.found_cpu if is_found else follower.cpu,
        "error_m": follower.found_m if is_found else None,
        "error_deg": follower.found_deg if is_found else None,
        "track_rms_m": float(np.sqrt(np.mean(np.square(later)))) if later else None,
        "track_max_m": max(later) if later else None,
        "track_end_rms_m": float(np.sqrt(np.mean(np.square(later[-100:])))) if later else None,
        "ambiguous": follower.states.get(CloudState.AMBIGUOUS.name, 0) > 0,
        "lost": follower.states.get(CloudState.LOST.name, 0) > 0,
    }


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields over all maps, per kind, and each map's own counts."""
    whole = [r for r in results if r.get("ended") != CRASHED]
    fields: dict[str, Any] = {"maps": len(results), "is_met": len(whole) == len(results) and bool(whole)}
    for way in (way for way in WAYS if whole and f"{way}.success" in whole[0]):
        told = _counted(whole, way)
        fields |= {f"{way}.{name}": value for name, value in told.items()}
        if way in BARS:
            fields["is_met"] &= bool(told["false"] == 0 and told["success_ratio"] >= BARS[way] - 1e-9)
        for kind in sorted({r["kind"] for r in whole}):
            own = _counted([r for r in whole if r["kind"] == kind], way)
            fields |= {f"{kind}.{way}.{name}": value for name, value in own.items()}
    for r in whole:
        fields |= {
            f"{r['label']}.{name}": r[name] for name in ("way_m", "map_points", "map_prepare_s", "solids_changed")
        }
    return fields


def _counted(results: Sequence[dict[str, Any]], way: str) -> dict[str, Any]:
    def all_of(name: str) -> list[Any]:
        return [value for r in results for value in r[f"{way}.{name}"] if value is not None]

    success, false = all_of("success"), all_of("false")
    runs, good, wrong = len(success), sum(success), sum(value > 0 for value in false)
    low, high = wilson_interval(good, runs)
    fields: dict[str, Any] = {
        "starts": runs,
        "success": good,
        "success_ratio": good / max(runs, 1),
        "success_interval_low": low,
        "success_interval_high": high,
        "false": wrong,
        "false_interval_high": wilson_interval(wrong, runs)[1],
        "ambiguous": sum(all_of("ambiguous")),
        "lost": sum(all_of("lost")),
    }
    for name in ("seconds", "cpu", "error_m", "error_deg", "track_rms_m", "track_max_m", "track_end_rms_m"):
        values = all_of(name)
        if values:
            fields |= {f"{name}_median": statistics.median(values), f"{name}_worst": max(values)}
    return fields


def _line(result: dict[str, Any]) -> str:
    parts = []
    for way in (way for way in WAYS if f"{way}.success" in result):
        told = _counted([result], way)
        parts.append(
            f"{way}: {told['success']} of {told['starts']}, {told['false']} false,"
            f" {told.get('seconds_median', math.nan):.1f} s, {told.get('track_rms_m_median', math.nan):.3f} m"
        )
    return f"{result['way_m']:.0f} m, {result['map_points']} points; {'; '.join(parts)}"
