"""Runs LiDAR-inertial odometry and loop closure over a whole recording: a pose for every scan, the cloud of all, and what whoever uses it should know.

A recording is known to its end before anything is told of its beginning, so the LiDAR's mount, which the filter refines on the way, is that of the end for all poses; the
one that was told, if the recording hardly turned about all axes.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.protocols import CloudFilter
from ambler.core.se3 import SE3
from ambler.lio.cloud_file import CloudFile, KeptPoints
from ambler.lio.config import LioConfig
from ambler.lio.health import LioResult
from ambler.lio.hole import Hole
from ambler.lio.loop_closure import LoopClosure
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.turning import believed_mount, is_turned
from ambler.recordings.cloud_scan import CloudScan

CELL = 1 << 20
WAITING = 2_000_000  # points that are thinned out at once
DUSTY = 0.08  # share of points taken out that is worth a warning: grass and far floor lose 0.05
DOUBTFUL = (
    0.1  # share of the poses that were lost, or contradict the IMU, from which on nobody may take the map for one
)
VAGUE, VAGUE_M = 0.1, 1.0  # of the way, and metres: who may be that far off has no map
FAINT_MOST = 0.25  # share of the poses that believe what hardly any plane faces, which is worth a warning
CLOCK_OFF = 3.0  # standard deviations that the LiDAR's clock is told to, from which on what was learned of it is worth a warning
CLOCK_OFF_UNTURNED = 10.0  # the same of what hardly turned, which says little of the clock
LOOPLESS_M = 100.0  # of way without a closure that are worth a warning


@dataclass(frozen=True, slots=True, eq=False)
class OfflineLio:
    """`poses` are map_from_imu at `stamps_ns` int64 (N,), the ends of the scans, with `covariances` (N, 6, 6); `cloud` float32 (M, 3) are points in the map, one per
    cell. `odometry` are the poses before loop closure, whose covariances these are; `links` float64 (K, 2, 3) are the places that loop closures join, `is_converged` says whether
    their graph was solved, `loop_seconds` is the processor time that they took. Counts are scans; `update_ms` float64 (N,) is the processor time of each update; `cut` why the recording could not be read to its end; `left_out` how many messages had stamps out of order; `holes` are times in which nothing was measured; `false_ratio` the share of the points that floated in the air; `faint` how many scans moved along directions that hardly any plane faces, and told it all the same; `clock_off` how many seconds the LiDAR's stamps were found to lag behind the IMU's, None where that is about what was told: within 6 ms, or within 20 ms where it hardly turned (on wheels 6 to 8 ms were found that were not there);
    `unknown_speed` float64 (K, 3) are unit vectors in the map along which nobody knew how fast it began, nor learned it later."""

    stamps_ns: NDArray[np.int64]
    poses: tuple[SE3, ...]
    covariances: NDArray[np.float64]
    cloud: NDArray[np.float32]
    update_ms: NDArray[np.float64]
    scans: int
    skipped: int
    degenerate: int
    lost: int
    at_rest: int
    biased: int
    gaps: int
    inlier_ratio: float
    residual_m: float | None
    note: str
    map_mb: float
    voxels: int
    odometry: tuple[SE3, ...]
    links: NDArray[np.float64]
    is_converged: bool
    seeks_loops: bool
    loop_seconds: float
    imu_from_lidar: SE3
    cut: str = ""
    false_ratio: float = 0.0
    left_out: int = 0
    contradicted: int = 0
    holes: tuple[Hole, ...] = ()
    clock_off: float | None = None
    unknown_speed: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    began_at_rest: bool = True
    faint: int = 0

    @property
    def is_sure(self) -> bool:
        """Whether the map may be what was there: hardly a scan was lost or contradicted the IMU, no place is uncertain by a tenth of the way, the speed at the start is known, and after every hole the place was found again."""
        is_followed = self.lost <= DOUBTFUL * len(self.poses) and not (self._is_contradicted or self._is_vague)
        return is_followed and len(self.unknown_speed) == 0 and all(hole.is_regained for hole in self.holes)

    @property
    def _is_contradicted(self) -> bool:
        return self.contradicted > DOUBTFUL * len(self.poses)

    @property
    def _is_faint(self) -> bool:
        return self.faint > FAINT_MOST * len(self.poses)

    @property
    def _is_vague(self) -> bool:
        return self.degenerate > 0 and self.doubt > max(VAGUE_M, VAGUE * self.path_length)

    @property
    def _causes(self) -> str:
        """What contradictions may come from, in words."""
        causes = "a wrong sign of its forces, a wrong mount, or clouds whose stamps or times of points are off"
        if self.began_at_rest:
            return causes
        return f"it began in motion, or shaken too much to be known to stand: its speed or its lean at the start may be wrong; else {causes}"

    @property
    def path_length(self) -> float:
        """Metres from scan to scan."""
        places = np.array([pose.translation for pose in self.poses])
        return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()) if len(places) > 1 else 0.0

    @property
    def doubt(self) -> float:
        """The greatest standard deviation (m) of a position in any direction, before loop closure."""
        return (
            float(np.sqrt(np.linalg.eigvalsh(self.covariances[:, :3, :3])[:, -1].max()))
            if len(self.covariances)
            else 0.0
        )

    def warnings(self) -> list[str]:
        """Return what whoever uses the map should know, in words."""
        out = []
        if self.cut:
            out.append(f"the recording ends early, what came before is mapped: {self.cut}")
        if self.left_out:
            out.append(f"{self.left_out} messages were left out: their stamps are out of order")
        if self.skipped:
            out.append(f"{self.skipped} of {self.scans} scans gave no pose (before the start, empty, or out of order)")
        if self.degenerate:
            out.append(
                f"{self.degenerate} scans left a direction to the inertial measurements: the place says too little"
                f" (standard deviation of a position: {self.doubt:.2f} m at worst)"
                + self._is_vague
                * ", and the map is not to be trusted (wheels may tell what is missing: --odom-topic)"
            )
        if self._is_faint:
            out.append(
                f"in {self.faint} scans hardly any planes face some direction: floors and walls that lean a little look like that, and the way along it may be off by far more than is told"
                " (in the open or in a stairwell with few rings: look at the map, add wheels, --odom-topic, or take a scanner that sees more)"
            )
        if self.lost:
            out.append(
                f"{self.lost} scans fitted nothing in the map: the trajectory is not to be trusted from there on"
            )
        if len(self.unknown_speed):
            along = " and ".join(f"({x:.2f}, {y:.2f}, {z:.2f})" for x, y, z in self.unknown_speed)
            out.append(
                f"the speed at the start is unknown along {along} in the map: it began in motion, and the scans show too little there to tell how fast it goes;"
                " the map is not to be trusted (begin at rest, or where something stands across the way)"
            )
        if self._is_contradicted:
            out.append(
                f"{self.contradicted} scans fit badly, and elsewhere than the IMU leads: the map is not to be trusted ({self._causes})"
            )
        for hole in self.holes:
            said = f"nothing was measured for {hole.end - hole.begin:.1f} s"
            if hole.is_regained:
                out.append(f"{said}: the place was found again in the map, {hole.scans} scans after it gave no pose")
            else:
                out.append(
                    f"{said}, and the place was not found again in the map ({hole.text}): the last {hole.scans} scans are lost, and not in the map"
                )
        if self.clock_off is not None and self.is_sure:  # of a map that is none nothing is learned
            out.append(
                f"the LiDAR's clock was found to lag {self.clock_off:.3f} s behind the IMU's, which nobody told: with --set lio.lidar_clock={self.clock_off:.3f} the map is more exact"
            )
        if self.biased:
            out.append(f"a bias of the IMU reached its limit in {self.biased} scans: unit, mount or clock may be wrong")
        if self.seeks_loops and len(self.links) == 0 and self.path_length >= LOOPLESS_M:
            out.append(f"no loop closure in {self.path_length:.0f} m: the map's drift is uncorrected")
        if not self.is_converged:
            out.append("the pose graph did not converge: the corrected map is not to be trusted")
        if self.false_ratio > DUSTY:
            out.append(
                f"{100.0 * self.false_ratio:.0f} % of the points floated in the air (dust, smoke, rain) and were left out"
            )
        if self.gaps:
            out.append(f"{self.gaps} gaps between inertial measurements")
        if self.residual_m is not None and self.residual_m < 0.004:
            out.append(
                "residuals are smaller than any LiDAR's noise: planes turn with the points, the map may stick to the sensor"
            )
        return out


def run_offline(
    scans: Iterable[CloudScan],
    config: LioConfig,
    imu_from_lidar: SE3 | None = None,
    imu_from_base: SE3 | None = None,
    *,
    cell: float = 0.1,
    on_scan: Callable[[], None] | None = None,
    air: CloudFilter | None = None,
) -> OfflineLio:
    """Map all scans; the cloud keeps one point per cell of `cell` metres. `on_scan` is called after each; `air` takes out what floats.

    Raises LioInputError when the measurements cannot be what they are said to be, BadInputError when nothing could be mapped.
    """
    asked, config = config, offline_config(config)
    odometry = LidarInertialOdometry(config, imu_from_lidar, imu_from_base, air)
    told_mount = odometry.state.mount
    loops = LoopClosure(config)
    layers = _Layers(cell, config.loops.keyframe_m)
    results: list[tuple[LioResult, float]] = []
    count, cut, loop_seconds = 0, "", 0.0
    try:
        for result, ms in _walk(odometry, scans, on_scan):
            count += 1
            if result is not None:
                layers.add(len(results), result)
                begin = time.process_time()
                if config.loops.is_used:
                    loops.add(result)
                loop_seconds += time.process_time() - begin
                results.append((result.without_points(), ms))
    except BadInputError as error:
        if not results:
            raise
        cut = str(error)
    if not results:
        began = odometry.start
        why = "the filter never began" if began is None else "no scan holds points within the ranges"
        raise BadInputError(f"nothing could be mapped: {count} scans, {why}{odometry.refused_text}")
    if config.loops.is_used:
        loops.finish()
    stamps_ns = np.array([result.stamp_ns for result, _ in results], np.int64)
    last = results[-1][0]
    followed = [result for result, _ in results]
    mount = believed_mount(followed, told_mount, asked)
    start_from_map = SE3() if mount is told_mount else last.start_from_map
    lidar_from_imu = mount.inverse()
    turn, shift = start_from_map.matrix()[:3, :3], start_from_map.matrix()[:3, 3]
    of_lidar = [result.map_from_lidar for result, _ in results]
    closed = [start_from_map @ pose for pose in loops.corrected(stamps_ns, of_lidar)]
    health = [result.health for result, _ in results]
    residuals = [h.residual_m for h in health if h.residual_m is not None]
    assert odometry.start is not None
    clock = odometry.state.clock
    clock_off = CLOCK_OFF if asked.estimates_clock or is_turned(followed, asked) else CLOCK_OFF_UNTURNED
    is_clock_off = abs(clock - config.lidar_clock) > clock_off * config.clock_sigma
    return OfflineLio(
        stamps_ns=stamps_ns,
        poses=tuple(pose @ lidar_from_imu for pose in closed),
        covariances=np.array([result.covariance for result, _ in results]),
        cloud=layers.points(closed),
        update_ms=np.array([ms for _, ms in results]),
        scans=count,
        skipped=count - len(results),
        degenerate=sum(h.is_degenerate for h in health),
        lost=sum(h.is_lost for h in health),
        at_rest=sum(h.is_at_rest for h in health),
        biased=sum(h.is_biased for h in health),
        gaps=sum(h.imu_gap > config.imu.gap_most for h in health) if config.has_imu else 0,
        inlier_ratio=float(np.mean([h.inlier_ratio for h in health])),
        residual_m=float(np.median(residuals)) if residuals else None,
        note=odometry.start.note,
        map_mb=odometry.map.memory_mb,
        voxels=len(odometry.map),
        odometry=tuple(start_from_map @ pose @ lidar_from_imu for pose in of_lidar),
        links=loops.links() @ turn.T + shift,
        is_converged=loops.is_converged,
        seeks_loops=config.loops.is_used,
        loop_seconds=loop_seconds,
        imu_from_lidar=mount,
        cut=cut,
        false_ratio=float(np.mean([h.false_ratio for h in health])),
        left_out=odometry.left_out,
        contradicted=sum(h.is_contradicted for h in health),
        holes=tuple(odometry.holes),
        clock_off=clock if is_clock_off else None,
        unknown_speed=odometry.unknown_speed @ turn.T,
        began_at_rest=odometry.start.is_rest or not config.has_imu,
        faint=sum(h.is_faint for h in health),
    )


def offline_config(config: LioConfig) -> LioConfig:
    """Return the configuration for a whole recording: the mount is refined where that is wanted and an IMU is there."""
    if config.has_imu and config.refines_mount and not config.estimates_mount:
        config = replace(config, estimates_mount=True, mount_sigma=config.refined_sigma)
        if not config.estimates_clock:
            config = replace(config, estimates_clock=True, clock_sigma=config.refined_clock)
    return config


def _walk(
    odometry: LidarInertialOdometry, scans: Iterable[CloudScan], on_scan: Callable[[], None] | None
) -> Iterator[tuple[LioResult | None, float]]:
    """Yield each scan's result and the milliseconds of processor time that it took."""
    for scan in scans:
        begin = time.process_time()
        result = odometry.update(scan)
        yield result, 1e3 * (time.process_time() - begin)
        if on_scan is not None:
            on_scan()


class _Layers:
    """The cloud in stretches of the way, each in the frame of the LiDAR at its beginning, so that it can be laid when the poses are known."""

    def __init__(self, cell: float, step: float) -> None:
        self._cell, self._step = cell, step
        self._file = CloudFile()
        self._ended: list[tuple[int, KeptPoints]] = []
        self._open: tuple[int, SE3, _Cells] | None = None

    def add(self, number: int, result: LioResult) -> None:
        """Add the points of scan `number`."""
        pose = result.map_from_lidar
        if self._open is None or math.dist(pose.translation, self._open[1].translation) >= self._step:
            self._end()
            self._open = (number, pose, _Cells(self._cell))
        _, begin, cells = self._open
        cells.add((begin.inverse() @ result.map_from_imu).transform(result.points_imu))

    def points(self, poses: Sequence[SE3]) -> NDArray[np.float32]:
        """Return all points float32 (M, 3), laid with the LiDAR's poses of all scans."""
        self._end()
        cells = _Cells(self._cell)
        for number, layer in self._ended:
            cells.add(poses[number].transform(layer.read()))
        return cells.points()

    def _end(self) -> None:
        if self._open is not None:
            number, _, cells = self._open
            self._ended.append((number, self._file.put(cells.points())))
            self._open = None


class _Cells:
    """One point per cell: the first."""

    def __init__(self, size: float) -> None:
        self._size = size
        self._keys = np.empty(0, np.int64)  # in their order
        self._parts: list[NDArray[np.float32]] = []
        self._waiting: list[NDArray[np.float64]] = []

    def add(self, points: NDArray[np.float64]) -> None:
        self._waiting.append(points)
        if sum(map(len, self._waiting)) >= WAITING:
            self._settle()

    def points(self) -> NDArray[np.float32]:
        self._settle()
        return np.concatenate(self._parts) if self._parts else np.zeros((0, 3), np.float32)

    def _settle(self) -> None:
        if not self._waiting:
            return
        points = np.concatenate(self._waiting)
        self._waiting.clear()
        cells = np.floor(points / self._size).astype(np.int64) + CELL
        keys = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
        keys, first = np.unique(keys, return_index=True)
        place = np.asarray(np.searchsorted(self._keys, keys))
        is_new = np.append(self._keys, -1)[place] != keys
        self._keys = np.insert(self._keys, place[is_new], keys[is_new])
        self._parts.append(points[first[is_new]].astype(np.float32))
