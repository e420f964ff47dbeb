"""LiDAR-inertial odometry at sites that nobody has seen: a plate in the hand with drawn errors, along loops, through a tunnel, shaken, at rest.

The clouds are simulated (exact rays from the moving sensor, then noise and losses of `sim.sensors`); the truth is the prescribed path. Each run is judged as the
odometry told it scan by scan, and as loop closure corrected it at the end.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.apps.config import recorded_config
from ambler.bridges.recorder import Recorder
from ambler.core.errors import BadInputError
from ambler.core.messages import PointCloud, Transforms, TransformStamped
from ambler.core.se3 import SE3
from ambler.evaluation.spatial_error import SpatialError, best_motion, spatial_error
from ambler.lio.config import LioConfig
from ambler.lio.health import LioResult
from ambler.lio.loop_closure import LoopClosure
from ambler.lio.loop_match import Closure, error_of
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.offline import offline_config
from ambler.lio.turning import believed_mount
from ambler.perception.air_filter import AirFilter, AirFilterConfig
from ambler.recordings.cloud_scan import CloudScan
from ambler.runtime.topics import CLOUD, IMU, TRANSFORMS
from ambler.sim.air import Air, Airborne
from ambler.sim.hand_path import Burst, HandPath, Sway
from ambler.sim.hand_rig import BEGIN_NS, IMU_FRAME, LIDAR_FRAME, LIDARS, HandRig, RigScan
from ambler.sim.site import Site, draw_hall, draw_site, draw_tunnel, draw_twins
from ambler.sim.surface_distance import surface_distances
from ambler.studies.lio_peer import KissIcp
from ambler.studies.study import CRASHED, Study
from ambler.studies.study_settings import DEFAULTS, StudySettings
from ambler.wire.trajectory_files import write_tum_3d

F64 = NDArray[np.float64]
AIRS = {"dust": Airborne.DUST, "rain": Airborne.RAIN, "smoke": Airborne.SMOKE}
KINDS = ("site", "hall", "tunnel", "twins", "shaken", "rest", *AIRS)
LENGTHS = (70.0, 1000.0)  # metres of loops outdoors, drawn evenly in their logarithm
AIR_LENGTHS = (100.0, 200.0)
FALSE_SHARE = 0.3  # of the returns, in dust and rain
SMOKE_STEP, SMOKE_ASIDE = 12.0, (2.5, 5.0)  # metres along the way from one column of smoke to the next, and beside it
WORSE_MOST = 1.5  # times the error in clear air
HALL_LENGTHS, TUNNEL_LENGTHS, TWIN_LENGTHS = (60.0, 150.0), (100.0, 250.0), (100.0, 300.0)
REST_SECONDS = 600.0
RATE = math.radians(1000.0)  # rad/s of the bursts
SHARE_MOST = {"vlp_16": 0.1, "mid_360": 0.1, "os_64": 0.05}  # per cent of the way
SHAKEN_MOST, REST_MOST, TUNNEL_MOST, PEER_MOST = 0.1, 0.01, 1.0, 0.5
FALSE_M, FALSE_RAD = 0.3, math.radians(3.0)  # from the true relation of two keyframes on a closure is false
CLOSED_RMS, CLOSED_MAX = 0.10, 0.30  # metres with loop closure, at sites: the median of RMS errors, and any point
POINT_OR_LINE = ("rest", "tunnel")  # where the best rigid motion is not determined
SURFACE_POINTS, STRAY = 5000, 0.15  # points of a map that are judged; metres


@dataclass(frozen=True, slots=True)
class LioCase:
    """A site and a run. `length` in metres, None: drawn; `peer` runs kiss-icp on the same scans; `keeps_recording` keeps a bag and `truth.tum`."""

    kind: str
    seed: int
    lidar: str
    length: float | None = None
    peer: bool = False
    keeps_recording: bool = False
    settings: StudySettings = DEFAULTS

    @property
    def label(self) -> str:
        """A name for files and people."""
        return f"{self.kind}-{self.seed}-{self.lidar}"


def lio_study(cases: Sequence[LioCase]) -> Study[LioCase]:
    """Return the study of these runs."""
    return Study("lio", cases, run_case, _line)


def check(kinds: Sequence[str], lidars: Sequence[str]) -> None:
    """Raise BadInputError for names that are none."""
    for name, known in [*((k, KINDS) for k in kinds), *((n, tuple(LIDARS)) for n in lidars)]:
        if name not in known:
            raise BadInputError(f"{name!r}: one of {', '.join(known)}")


def make_rig(case: LioCase) -> HandRig:
    """Draw the place, the path and the plate of a case."""
    rng = np.random.default_rng([case.seed, 77])
    length, site = _place(case, rng)
    sway = Sway.none() if case.kind == "tunnel" else Sway()
    path = HandPath(site.way, speed=float(rng.uniform(1.2, 1.6)), sway=sway, is_closed=site.is_closed)
    if case.kind == "rest":
        path = replace(path, rest_after=REST_SECONDS)
    if case.kind == "shaken":
        axes = [rng.standard_normal(3) for _ in range(int(length / 14.0))]
        bursts = [
            Burst(6.0 + 8.0 * k, 3.0, _unit(axis), RATE, _unit(rng.standard_normal(3)), 3.0)
            for k, axis in enumerate(axes)
        ]
        path = replace(path, bursts=tuple(bursts))
    airs = (_air(case, site, rng),) if case.kind in AIRS else ()
    return HandRig(site.world, path, LIDARS[case.lidar], case.seed, wheels=case.kind == "tunnel", airs=airs)


def _air(case: LioCase, site: Site, rng: np.random.Generator) -> Air:
    """Return what floats: dust or rain around the scanner, or columns of smoke on both sides of the way."""
    kind = AIRS[case.kind]
    if kind is not Airborne.SMOKE:
        return Air(kind, FALSE_SHARE)
    path = HandPath(site.way, is_closed=site.is_closed)
    places = path.places(np.arange(6.0, path.length, SMOKE_STEP))
    ahead = np.gradient(places[:, :2], axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
    aside = rng.uniform(*SMOKE_ASIDE, len(places)) * rng.choice((-1.0, 1.0), len(places))
    columns = tuple((x, y) for x, y in (places[:, :2] + aside[:, None] * left).tolist())
    return Air(kind, columns=columns, base=float(places[:, 2].min()) - 1.5)


def _place(case: LioCase, rng: np.random.Generator) -> tuple[float, Site]:
    low, high = {
        "site": LENGTHS,
        "hall": HALL_LENGTHS,
        "tunnel": TUNNEL_LENGTHS,
        "twins": TWIN_LENGTHS,
        **dict.fromkeys(AIRS, AIR_LENGTHS),
    }.get(case.kind, (60.0, 90.0))
    drawn = float(np.exp(rng.uniform(math.log(low), math.log(high))))
    length = drawn if case.length is None else case.length
    draw = {"hall": draw_hall, "tunnel": draw_tunnel, "twins": draw_twins, "shaken": draw_hall}.get(
        case.kind, draw_site
    )
    return length, draw(case.seed, length)


def _unit(v: F64) -> tuple[float, float, float]:
    x, y, z = (v / np.linalg.norm(v)).tolist()
    return (x, y, z)


def run_case(case: LioCase, folder: Path) -> dict[str, Any]:
    """Draw, carry, register, compare."""
    rig = make_rig(case)
    config = offline_config(recorded_config(case.settings.profile).lio)
    loops = LoopClosure(config)
    air = _JudgedFilter(recorded_config(case.settings.profile).air)
    odometry = LidarInertialOdometry(config, rig.told_mount, SE3() if case.kind == "tunnel" else None, air)
    peer = KissIcp(config.scan.range_min, rig.lidar.range_max) if case.peer else None
    results: list[LioResult] = []
    truth, peers, update_ms, points = [], [], [], []
    loop_seconds = 0.0
    for scan in _recorded(case, rig, folder):
        begin = time.process_time()
        result = odometry.update(CloudScan(scan.cloud, scan.imu, scan.odometry))
        update_ms.append(1e3 * (time.process_time() - begin))
        air.judge(scan.is_false)
        points.append(len(scan.cloud.points))
        if peer is not None:
            peers.append(peer.update(scan.cloud) @ rig.mount.inverse())
        if result is not None:
            begin = time.process_time()
            loops.add(result)
            loop_seconds += time.process_time() - begin
            results.append(result.without_points())
            truth.append((scan.end_ns, scan.world_from_imu))
    loops.finish()
    stamps = np.array([r.stamp_ns for r in results], np.int64)
    truth_poses = [pose for _, pose in truth]
    error = spatial_error(stamps, [r.start_from_imu for r in results], stamps, truth_poses)
    standing = int(np.searchsorted(stamps, BEGIN_NS + round(rig.path.standing_from * 1e9)))
    fields = _judged(case, results, error, truth_poses, standing)
    fields |= _closed(case, rig, loops, results, truth_poses)
    fields |= air.fields()
    if case.kind in AIRS:
        fields |= _beside_clear_air(case, config, error)
    if case.kind not in POINT_OR_LINE:
        fields |= _surfaces(rig, odometry.map.points(), [r.map_from_imu for r in results], truth_poses)
    if peer is not None:
        theirs = spatial_error(stamps, peers[-len(stamps) :], stamps, truth_poses)
        fields |= {
            "peer_kiss_start_rms_m": theirs.start_rms_m,
            "peer_kiss_update_median_ms": statistics.median(peer.ms),
            "ratio_vs_kiss_error": error.start_rms_m / theirs.start_rms_m,
            "ratio_vs_kiss_time": statistics.median(update_ms) / statistics.median(peer.ms),
        }
    fields["is_met"] = fields["is_met"] and fields["false_closures"] == 0 and fields["is_converged"]
    return {
        "drawn_length_m": rig.path.length,
        "scans": len(update_ms),
        "points_mean": float(np.mean(points)),
        "update_median_ms": statistics.median(update_ms),
        "update_p95_ms": float(np.percentile(update_ms, 95.0)),
        "map_memory_mb": odometry.map.memory_mb,
        "points_lost_for_room": odometry.map.lost,
        "loop_cpu_seconds": loop_seconds,
        **fields,
    }


class _JudgedFilter:
    """The filter of the air, and how often it was right: of the points that the odometry asks about, how many were false, found and lost."""

    def __init__(self, config: AirFilterConfig) -> None:
        self._filter = AirFilter(config)
        self._asked, self._kept = np.zeros(0, np.int64), np.zeros(0, np.bool_)
        self._counts = np.zeros(4, np.int64)  # true, of them lost, false, of them found

    def keep(
        self, cloud: PointCloud, asked: NDArray[np.int64], place: Callable[[NDArray[np.int64]], NDArray[np.floating]]
    ) -> NDArray[np.bool_]:
        self._asked, self._kept = asked, self._filter.keep(cloud, asked, place)
        return self._kept

    def judge(self, is_false: NDArray[np.bool_]) -> None:
        """Compare the last answer with the truth, of all points of the cloud."""
        false, gone = is_false[self._asked], ~self._kept
        self._counts += [np.sum(~false), np.sum(gone & ~false), np.sum(false), np.sum(gone & false)]
        self._asked, self._kept = self._asked[:0], self._kept[:0]

    def fields(self) -> dict[str, Any]:
        true, lost, false, found = self._counts.tolist()
        return {
            "false_point_ratio": false / max(true + false, 1),
            "false_found_ratio": found / false if false else None,
            "true_lost_ratio": lost / max(true, 1),
        }


def _beside_clear_air(case: LioCase, config: LioConfig, error: SpatialError) -> dict[str, Any]:
    """Walk the same way in clear air, and in this air without the filter; how much worse the error is than in clear air."""
    shares: list[float] = []
    clear_rig = make_rig(case)
    clear_rig.airs = ()
    clear = _plain_run(clear_rig, config, AirFilter(), None)
    raw = _plain_run(make_rig(case), config, None, shares)
    return {
        "clear_start_rms_m": clear.start_rms_m,
        "unfiltered_start_rms_m": raw.start_rms_m,
        "false_return_ratio": float(np.mean(shares)),
        "ratio_vs_clear": error.start_rms_m / clear.start_rms_m,
        "unfiltered_ratio_vs_clear": raw.start_rms_m / clear.start_rms_m,
        "is_met": error.start_rms_m <= WORSE_MOST * clear.start_rms_m,
    }


def _plain_run(rig: HandRig, config: LioConfig, air: AirFilter | None, shares: list[float] | None) -> SpatialError:
    odometry = LidarInertialOdometry(config, rig.told_mount, None, air)
    told = []
    for scan in rig.scans():
        if shares is not None:
            shares.append(float(scan.is_false.mean()))
        result = odometry.update(CloudScan(scan.cloud, scan.imu, scan.odometry))
        if result is not None:
            told.append((result.stamp_ns, result.start_from_imu, scan.world_from_imu))
    stamps = np.array([stamp for stamp, _, _ in told], np.int64)
    return spatial_error(stamps, [pose for _, pose, _ in told], stamps, [true for _, _, true in told])


def _recorded(case: LioCase, rig: HandRig, folder: Path) -> Iterator[RigScan]:
    """Yield the scans; keep them as a recording where that is wanted."""
    recorder = None
    if case.keeps_recording:
        folder.mkdir(parents=True, exist_ok=True)
        recorder = Recorder(folder / "recording")
        edge = TransformStamped(BEGIN_NS, IMU_FRAME, LIDAR_FRAME, rig.told_mount)
        recorder.on_message(TRANSFORMS, Transforms(BEGIN_NS, (edge,)), BEGIN_NS)
    kept: list[tuple[int, SE3]] = []
    for scan in rig.scans():
        if recorder is not None:
            kept.append((scan.end_ns, scan.world_from_imu))
            for sample in scan.imu:
                recorder.on_message(IMU, sample, sample.stamp_ns)
            recorder.on_message(CLOUD, scan.cloud, scan.end_ns)
        yield scan
    if recorder is not None:
        recorder.close()
        write_tum_3d(folder / "truth.tum", [stamp for stamp, _ in kept], [pose for _, pose in kept])


def _judged(
    case: LioCase, results: Sequence[LioResult], error: SpatialError, truth: Sequence[SE3], standing: int
) -> dict[str, Any]:
    """Return what is told of each run; `standing` is the first result of the rest at its end, which is what counts where that is long."""
    way, is_rest = error.path_length_m, case.kind == "rest"
    share = 100.0 * error.start_rms_m / way
    health = [r.health for r in results]
    fields: dict[str, Any] = {
        **error.fields(),
        "start_rms_pct": share,
        "height_rms_pct": 100.0 * error.height_rms_m / way,
        "end_pct": 100.0 * error.end_m / way,
        "nees": nees(results, truth, standing if is_rest else 1),
        "rest_drift_m": _farthest([r.start_from_imu for r in results[standing:]]) if is_rest else None,
        "inlier_ratio": float(np.mean([h.inlier_ratio for h in health])),
        "degenerate": sum(h.is_degenerate for h in health),
        "lost": sum(h.is_lost for h in health),
        "at_rest": sum(h.is_at_rest for h in health),
    }
    fields["is_met"] = {
        "shaken": error.start_rms_m <= SHAKEN_MOST,
        "rest": is_rest and fields["rest_drift_m"] <= REST_MOST,
        "tunnel": fields["end_pct"] <= TUNNEL_MOST and fields["degenerate"] > 0,
        "twins": fields["lost"] == 0,  # what counts there is that nothing is closed falsely
    }.get(case.kind, share <= SHARE_MOST[case.lidar])  # in dust, smoke and rain: beside clear air
    return fields


def _closed(
    case: LioCase, rig: HandRig, loops: LoopClosure, results: Sequence[LioResult], truth: Sequence[SE3]
) -> dict[str, Any]:
    """Return the errors with loop closure and the mount as `run_offline` knows it at the end, and how many closures are false by the truth."""
    stamps = np.array([r.stamp_ns for r in results], np.int64)
    lidar_from_imu = believed_mount(results, rig.told_mount, recorded_config(case.settings.profile).lio).inverse()
    poses = [pose @ lidar_from_imu for pose in loops.corrected(stamps, [r.map_from_lidar for r in results])]
    error = spatial_error(stamps, poses, stamps, truth)
    world_from_lidar = {stamp: (pose @ rig.mount).matrix() for stamp, pose in zip(stamps.tolist(), truth, strict=True)}
    true = [world_from_lidar[frame.stamp_ns] for frame in loops.keyframes]
    is_false = [is_false_closure(c, np.linalg.inv(true[c.earlier]) @ true[c.later]) for c in loops.closures]
    fields: dict[str, Any] = {
        "closed_rms_m": error.start_rms_m,
        "closed_max_m": error.start_max_m,
        "closed_ate_rms_m": error.ate_rms_m,
        "closures": len(loops.closures),
        "closures_tried": loops.tried,
        "false_closures": sum(is_false),
        "is_converged": loops.is_converged,
    }
    if case.kind not in POINT_OR_LINE:
        surfaces = _surfaces(rig, loops.points(), poses, truth)
        fields |= {f"closed_{name}": value for name, value in surfaces.items()}
    return fields


def is_false_closure(closure: Closure, true: F64) -> bool:
    """Return whether a closure is false by the true earlier_from_later (4, 4); what it leaves free does not count."""
    error = error_of(true, closure.earlier_from_later)
    place = error[:3] - closure.weak.T @ (closure.weak @ error[:3])
    return bool(np.linalg.norm(place) > FALSE_M or np.linalg.norm(error[3:]) > FALSE_RAD)


def _surfaces(
    rig: HandRig, mapped: NDArray[np.floating], poses: Sequence[SE3], truth: Sequence[SE3]
) -> dict[str, float]:
    """Return how far points of a map (M, 3) lie from true surfaces, the best rigid motion of the way taken out.

    Points farther than `STRAY` from all are counted apart (between two surfaces, at edges).
    """
    places, known = (np.array([p.translation for p in poses]) for poses in (poses, truth))
    rotation, shift = best_motion(places, known)
    points = mapped[:: max(1, len(mapped) // SURFACE_POINTS)]
    world = points.astype(np.float64) @ rotation.T + shift
    distances = surface_distances(rig.scene, world)
    near = distances[distances < STRAY]
    return {
        "surface_rms_m": float(np.sqrt(np.mean(near**2))),
        "surface_median_m": float(np.median(distances)),
        "stray_ratio": 1.0 - len(near) / len(distances),
    }


def _farthest(poses: Sequence[SE3]) -> float:
    """Return how far the farthest of some poses lies from the first one, metres."""
    places = np.array([pose.translation for pose in poses])
    return float(np.linalg.norm(places - places[0], axis=1).max())


def nees(results: Sequence[LioResult], truth: Sequence[SE3], first: int = 1) -> float:
    """Return the mean normalized squared error of position and rotation since the first result, of the results from number `first` on, over its six degrees of freedom: 1 if the covariance says
    what errors are."""
    world_from_start = truth[0] @ results[0].start_from_imu.inverse()
    start_from_world = world_from_start.inverse()
    values = []
    for result, true in zip(results[first:], truth[first:], strict=True):
        known = start_from_world @ true
        place = np.array(known.translation) - np.array(result.start_from_imu.translation)
        turn = (result.start_from_imu.inverse() @ known).rotation
        sign = 1.0 if turn[0] >= 0.0 else -1.0
        error = np.concatenate([place, 2.0 * sign * np.array(turn[1:])])
        values.append(float(error @ np.linalg.solve(result.covariance, error)) / 6.0)
    return float(np.mean(values))


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields per kind and scanner: medians and worst values; and each run's own (`<label>.…`)."""
    fields: dict[str, Any] = {"runs": len(results), "runs_met": sum(bool(r.get("is_met")) for r in results)}
    groups = sorted({(r["kind"], r["lidar"]) for r in results})
    for kind, lidar in groups:
        own = [r for r in results if (r["kind"], r["lidar"]) == (kind, lidar)]
        for what in (
            *(
                "start_rms_m",
                "start_rms_pct",
                "start_max_m",
                "end_pct",
                "height_rms_pct",
                "nees",
                "rest_drift_m",
                "surface_rms_m",
                "stray_ratio",
                "update_median_ms",
                "closed_rms_m",
                "closed_max_m",
                "closed_ate_rms_m",
                "closed_surface_rms_m",
                "ratio_vs_clear",
                "unfiltered_ratio_vs_clear",
                "false_return_ratio",
                "false_found_ratio",
                "true_lost_ratio",
                "closed_stray_ratio",
                "loop_cpu_seconds",
            ),
            *(
                "points_mean",
                "peer_kiss_start_rms_m",
                "peer_kiss_update_median_ms",
                "ratio_vs_kiss_error",
                "ratio_vs_kiss_time",
            ),
        ):
            values = [r[what] for r in own if r.get(what) is not None and math.isfinite(r[what])]
            if values:
                fields[f"{kind}.{lidar}.{what}_median"] = statistics.median(values)
                fields[f"{kind}.{lidar}.{what}_worst"] = (min if what == "false_found_ratio" else max)(values)
        told = [r["nees"] for r in own if r.get("nees") is not None]
        if told:
            fields[f"{kind}.{lidar}.nees_mean"] = statistics.fmean(told)
        fields[f"{kind}.{lidar}.closures"] = sum(r.get("closures", 0) for r in own)
        fields[f"{kind}.{lidar}.false_closures"] = sum(r.get("false_closures", 0) for r in own)
        fields[f"{kind}.{lidar}.runs"] = len(own)
        fields[f"{kind}.{lidar}.runs_met"] = sum(bool(r.get("is_met")) for r in own)
    for r in results:
        for what in (
            "path_length_m",
            "start_rms_m",
            "start_rms_pct",
            "start_max_m",
            "end_pct",
            "height_rms_m",
            "nees",
            "closed_rms_m",
            "closed_max_m",
            "closures",
            "false_closures",
            "degenerate",
            "lost",
            "is_met",
        ):
            fields[f"{r['label']}.{what}"] = r.get(what)
    fields |= _closing(results)
    is_whole = not any(r.get("ended") == CRASHED for r in results)
    fields["is_met"] = fields["runs_met"] == len(results) and is_whole and fields.get("is_closing_met", True)
    return fields


def _closing(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return what loop closure made of all sites together, and whether that meets its bar; nothing without any."""
    sites = [r for r in results if r["kind"] == "site" and r.get("closed_rms_m") is not None]
    if not sites:
        return {}
    median, worst = statistics.median(r["closed_rms_m"] for r in sites), max(r["closed_max_m"] for r in sites)
    false = sum(r["false_closures"] for r in sites)
    return {
        "closed_rms_median_m": median,
        "closed_max_worst_m": worst,
        "loop_closures": sum(r["closures"] for r in sites),
        "false_closures": false,
        "is_closing_met": median <= CLOSED_RMS and worst <= CLOSED_MAX and false == 0,
    }


def _line(result: dict[str, Any]) -> str:
    peer = result.get("peer_kiss_start_rms_m")
    return (
        f"{result['path_length_m']:.0f} m: {result['start_rms_m']:.3f} m RMS ({result['start_rms_pct']:.3f} %), worst {result['start_max_m']:.3f} m,"
        f" {result['update_median_ms']:.1f} ms of {result['points_mean']:.0f} points, {result['degenerate']} degenerate, NEES {result['nees']:.2f};"
        f" closed {result['closed_rms_m']:.3f} m, worst {result['closed_max_m']:.3f} m, {result['closures']} closures ({result['false_closures']} false)"
        + (f", kiss-icp {peer:.3f} m" if peer is not None else "")
    )
