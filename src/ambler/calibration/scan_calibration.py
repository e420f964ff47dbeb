"""Where the scanners sit, and what their clocks are off, from about a minute of driving.

Method: each scanner's own motion against the odometry gives a first guess (`hand_eye`); then pairs of scans of the same and of
different scanners are matched, and one least-squares problem over the base's path, all mountings, all clock offsets and the
odometry's systematic errors is solved (`calibration_graph`); matching and solving repeat with the better motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.calibration import planar_arrays as se2
from ambler.calibration.calibration_graph import CalibrationGraph, OdometryModel, Pairs, Solution, jackknife
from ambler.calibration.hand_eye import CalibrationError, HandEyeGuess, guess_mounting, track_scanner
from ambler.calibration.scan_pairs import PairConfig, PreparedScan, match_pair, prepare_scan
from ambler.core.messages import LaserScan, Odometry
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3

__all__ = [
    "CalibrationConfig",
    "CalibrationError",
    "CalibrationResult",
    "OdometryModel",
    "ScannerEstimate",
    "calibrate_scanners",
]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Scanner(Protocol):
    """What must be known of a scanner: the frame of its scans, and whether it hangs upside down."""

    @property
    def frame(self) -> str: ...

    @property
    def base_from_sensor(self) -> SE3: ...


@dataclass(frozen=True, slots=True)
class CalibrationConfig:
    """`node_period`: one scan per this many seconds and scanner takes part; `own_lags` and `other_lags` (nodes back) choose the
    pairs; an estimate looser than `max_sigma` (m, rad, s) is a failure, not a result."""

    pairs: PairConfig = field(default_factory=PairConfig)
    track_period: float = 0.08
    node_period: float = 0.25
    knot_period: float = 0.2
    own_lags: tuple[int, ...] = (1, 5)
    other_lags: tuple[int, ...] = (0,)
    largest_offset: float = 0.3
    rounds: int = 2
    max_sigma: tuple[float, float, float] = (0.03, 0.02, 0.02)


@dataclass(frozen=True, slots=True)
class ScannerEstimate:
    """One scanner: its mounting in the plane, what its clock is ahead (s), and the covariance (4, 4) of (x, y, yaw, offset)."""

    frame: str
    base_from_scanner: SE2
    clock_offset: float
    covariance: F64

    @property
    def sigma(self) -> F64:
        """Standard deviations of x, y (m), yaw (rad), offset (s)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """All estimates, their joint covariance (4N, 4N), the odometry's matrix (true twist = matrix · measured twist), how many
    pairs of scans were matched, their residual RMS (m), and the misfit per degree of freedom (1: as the noise models say)."""

    scanners: tuple[ScannerEstimate, ...]
    covariance: F64
    odometry_matrix: F64
    pairs: int
    residual_rms: float
    misfit: float


def calibrate_scanners(
    scans: Mapping[str, Sequence[LaserScan]],
    odometry: Sequence[Odometry],
    scanners: Sequence[Scanner],
    model: OdometryModel,
    config: CalibrationConfig | None = None,
) -> CalibrationResult:
    """Estimate the mounting and clock offset of every scanner; of `scanners` only frame and upside-down mounting are used;
    `model` says how far the odometry is trusted.

    Drive for about a minute, forwards and backwards, with turns in both directions, among walls; nothing else should move.
    Raises CalibrationError that names the scanner and the reason.
    """
    config = config or CalibrationConfig()
    origin_ns, track = _track(odometry)
    turned = [bool(c.base_from_sensor.matrix()[2, 2] < 0) for c in scanners]
    recordings = [_usable(c, scans.get(c.frame, ()), origin_ns, track) for c in scanners]
    guesses = [
        _guess(c.frame, r, origin_ns, over, track, config)
        for c, r, over in zip(scanners, recordings, turned, strict=True)
    ]
    nodes = _Nodes.choose(recordings, origin_ns, turned, config.node_period)
    knots = np.arange(track.times[0], track.times[-1], config.knot_period)
    graph = CalibrationGraph(track, knots, nodes.scanner, nodes.middles, model)
    unknowns = graph.start(
        np.array([g.base_from_scanner for g in guesses]), np.array([g.clock_offset for g in guesses])
    )
    wanted = _choose_pairs(nodes, config)
    for _ in range(config.rounds):
        prepared = nodes.prepare(graph.sensor_twists(unknowns), origin_ns, config.pairs)
        pairs, rms = _match(prepared, wanted, graph.node_poses(unknowns), config.pairs)
        if len(pairs.target) < 20 * len(scanners):
            raise CalibrationError(
                f"only {len(pairs.target)} pairs of scans match; are the walls too far, or does all move?"
            )
        solution = graph.solve(unknowns, pairs)
        unknowns = solution.unknowns
    covariance = _honest_covariance(graph, solution, pairs, nodes.middles[pairs.source])
    return _result(scanners, solution, covariance, pairs, rms, config)


def _track(odometry: Sequence[Odometry]) -> tuple[int, se2.PlanarTrack]:
    stamps = np.array([o.stamp_ns for o in odometry], np.int64)
    if len(stamps) < 10:
        raise CalibrationError("the recording holds no odometry")
    keep = np.concatenate([[True], np.diff(stamps) > 0])
    poses = np.array([o.pose.to_se2().as_array() for o in odometry])
    return int(stamps[0]), se2.PlanarTrack((stamps[keep] - stamps[0]).astype(np.float64) * 1e-9, poses[keep])


def _usable(config: Scanner, scans: Sequence[LaserScan], origin_ns: int, track: se2.PlanarTrack) -> list[LaserScan]:
    """Return the scans whose time the odometry covers, with a margin for the unknown offset."""
    margin = 0.5
    begin, end = origin_ns + margin * 1e9, origin_ns + (track.times[-1] - margin) * 1e9
    usable = [s for s in scans if begin <= s.stamp_ns <= end]
    if len(usable) < 40:
        raise CalibrationError(f"scanner {config.frame}: only {len(usable)} scans while there is odometry")
    return usable


def _thinned(scans: Sequence[LaserScan], period: float) -> list[LaserScan]:
    """Return scans that are at least `period` seconds apart."""
    out = [scans[0]]
    for scan in scans[1:]:
        if scan.stamp_ns - out[-1].stamp_ns >= period * 1e9:
            out.append(scan)
    return out


def _guess(
    frame: str,
    scans: Sequence[LaserScan],
    origin_ns: int,
    upside_down: bool,
    track: se2.PlanarTrack,
    config: CalibrationConfig,
) -> HandEyeGuess:
    motion = track_scanner(_thinned(scans, config.track_period), origin_ns, upside_down, track, config.pairs)
    return guess_mounting(frame, motion, track, config.largest_offset)


@dataclass(frozen=True, slots=True)
class _Nodes:
    """The scans that take part: flat lists over all scanners; `first[s]` is where scanner s begins."""

    scans: list[LaserScan]
    scanner: I64
    middles: F64
    upside_down: list[bool]
    first: I64

    @classmethod
    def choose(
        cls, recordings: Sequence[Sequence[LaserScan]], origin_ns: int, upside_down: list[bool], period: float
    ) -> _Nodes:
        chosen = [_thinned(r, period) for r in recordings]
        scans = [scan for part in chosen for scan in part]
        half = np.array([0.5 * (len(s.ranges) - 1) * s.time_increment for s in scans])
        stamps = np.array([s.stamp_ns - origin_ns for s in scans], np.int64).astype(np.float64) * 1e-9
        counts = [len(part) for part in chosen]
        scanner = np.repeat(np.arange(len(chosen)), counts)
        return cls(scans, scanner, stamps + half, upside_down, np.cumsum([0, *counts]))

    def prepare(self, twists: F64, origin_ns: int, config: PairConfig) -> list[PreparedScan]:
        return [
            prepare_scan(scan, origin_ns, self.upside_down[s], twist, config)
            for scan, s, twist in zip(self.scans, self.scanner.tolist(), twists, strict=True)
        ]


def _choose_pairs(nodes: _Nodes, config: CalibrationConfig) -> list[tuple[int, int]]:
    """Return (target, source) node indices: earlier scans of the same scanner, and of the others at about the same time."""
    pairs = []
    count = len(nodes.first) - 1
    for s in range(count):
        for i in range(nodes.first[s], nodes.first[s + 1]):
            pairs += [(i - lag, i) for lag in config.own_lags if i - lag >= nodes.first[s]]
            for other in range(count):
                if other == s:
                    continue
                begin, end = int(nodes.first[other]), int(nodes.first[other + 1])
                near = begin + int(np.argmin(np.abs(nodes.middles[begin:end] - nodes.middles[i])))
                pairs += [
                    (near - lag, i) for lag in config.other_lags if near - lag >= begin and (lag > 0 or other < s)
                ]
    return pairs


def _match(
    prepared: list[PreparedScan], wanted: list[tuple[int, int]], poses: F64, config: PairConfig
) -> tuple[Pairs, float]:
    """Match the wanted pairs from the present guess of the scanners' poses; returns those that fit and their residual RMS."""
    targets, sources = np.array(wanted, np.int64).T
    guesses = se2.compose(se2.inverse(poses[targets]), poses[sources])
    rows, matches = [], []
    for k, (target, source) in enumerate(wanted):
        match = match_pair(prepared[target], prepared[source], guesses[k], config)
        if match is not None:
            rows.append(k)
            matches.append(match)
    if not matches:
        raise CalibrationError("no two scans match each other")
    pairs = Pairs(
        targets[rows],
        sources[rows],
        np.array([m.target_from_source for m in matches]),
        np.array([m.information for m in matches]),
    )
    return pairs, float(np.sqrt(np.mean([m.rms**2 for m in matches])))


def _honest_covariance(graph: CalibrationGraph, solution: Solution, pairs: Pairs, times: F64) -> F64:
    """Scale the noise models' covariance, parameter by parameter, to what leaving out stretches of time shows, if larger."""
    measured = jackknife(graph, solution, pairs, times)
    ratio = np.sqrt(np.maximum(measured / np.diag(solution.covariance), max(solution.misfit, 1.0)))
    return np.asarray(solution.covariance * np.outer(ratio, ratio))


def _result(
    scanners: Sequence[Scanner],
    solution: Solution,
    covariance: F64,
    pairs: Pairs,
    rms: float,
    config: CalibrationConfig,
) -> CalibrationResult:
    estimates = []
    for s, scanner in enumerate(scanners):
        block = covariance[4 * s : 4 * s + 4, 4 * s : 4 * s + 4]
        mount = SE2.from_array(solution.unknowns.mounts[s])
        turn = np.eye(4)
        c, n = np.cos(mount.yaw), np.sin(mount.yaw)
        turn[:2, :2] = [[c, -n], [n, c]]
        estimate = ScannerEstimate(scanner.frame, mount, float(solution.unknowns.offsets[s]), turn @ block @ turn.T)
        limits = np.array([config.max_sigma[0], config.max_sigma[0], config.max_sigma[1], config.max_sigma[2]])
        if (estimate.sigma > limits).any():
            worst = ("x", "y", "yaw", "clock offset")[int(np.argmax(estimate.sigma / limits))]
            raise CalibrationError(
                f"scanner {scanner.frame}: the motion does not tell its {worst}; turn and drive more, in both directions"
            )
        estimates.append(estimate)
    return CalibrationResult(
        tuple(estimates), covariance, solution.unknowns.matrix, len(pairs.target), rms, solution.misfit
    )
