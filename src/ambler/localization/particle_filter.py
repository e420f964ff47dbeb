"""Monte-Carlo localization with adaptive particle count (AMCL: Fox 2001, Thrun et al., Probabilistic Robotics 8.3).

Particles carry the hypotheses; the pose that is told is the heaviest cluster, refined by matching every scan to the map's surfaces
(`matcher`) with the cluster as the prior. So it is as precise as the scan, and as uncertain along a corridor as its particles.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.robot import DriveKind
from ambler.core.se2 import SE2
from ambler.core.units import Radians
from ambler.kernels import likelihood_field as field_kernel
from ambler.kernels import particles as kernel
from ambler.localization.errors import NoPoseError
from ambler.localization.localizer import INITIAL_COVARIANCE, Estimate, Mode, Observation
from ambler.localization.matcher import MatcherConfig, MatchResult, ScanMatcher, fuse
from ambler.localization.motion import OdometryNoise, predict, require_valid
from ambler.localization.surface_map import SurfaceMap

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

NEAR = 0.5  # metres, besides three sigma, within which a match belongs to the cluster
SEED_SIGMA = (0.05, 0.03)  # metres, radians


class SensorModel(enum.Enum):
    """How particles are weighed."""

    LIKELIHOOD_FIELD = "likelihood_field"
    BEAM = "beam"


@dataclass(frozen=True, slots=True)
class ParticleFilterConfig:
    """Names and meanings of AMCL. `update_way`, `update_turn`: motion between two weighings (m, rad); `alphas` variances per squared
    motion; `beam_trust`: share of a beam's log likelihood that counts, since neighbouring beams err together; `recovery_*`: rates of
    the slow and fast means of the likelihood; `gate`: largest surprise of a refinement that is believed; `bin_size` of KLD sampling and clusters (m, rad)."""

    drive: DriveKind = DriveKind.DIFFERENTIAL
    sensor_model: SensorModel = SensorModel.LIKELIHOOD_FIELD
    particles_least: int = 300
    particles_most: int = 2000
    kld_error: float = 0.05
    kld_quantile: float = 2.326
    bin_size: tuple[float, float] = (0.5, math.pi / 18)
    alphas: tuple[float, float, float, float, float] = (0.05, 0.02, 0.05, 0.02, 0.05)
    update_way: float = 0.15
    update_turn: Radians = 0.15
    max_beams: int = 60
    beam_trust: float = 0.3
    sigma_hit: float = 0.1
    z_hit: float = 0.9
    z_rand: float = 0.1
    z_short: float = 0.05
    z_max: float = 0.05
    rate_short: float = 0.5
    range_most: float = 25.0
    resample_below: float = 0.5
    recovery_slow: float = 0.01
    recovery_fast: float = 0.2
    min_score: float = 0.3
    gate: float = 25.0
    matcher: MatcherConfig = field(default_factory=MatcherConfig)
    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    depth_sigma: float = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class ParticleCloud:
    """The particles float64 (N, 3) of (x, y, yaw) and their weights (N,); copies."""

    poses: F64
    weights: F64


class ParticleFilter:
    """A `Localizer` by particles."""

    def __init__(self, surface_map: SurfaceMap, config: ParticleFilterConfig, rng: np.random.Generator) -> None:
        self.map = surface_map
        self.config = config
        self._rng = rng
        self._matcher = ScanMatcher(surface_map, config.matcher)
        self._field = np.empty(surface_map.spec.shape, np.float32)
        field_kernel.log_likelihood_field(
            surface_map.distance, config.sigma_hit, config.z_hit, config.z_rand, self._field
        )
        self._particles, self._weights = np.empty((0, 3)), np.empty(0)
        most = config.particles_most
        self._keys = np.empty((most, 3), np.int64)
        self._table = np.empty(1 << (2 * most - 1).bit_length(), np.int64)
        self._label, self._todo = np.empty(most, np.int64), np.empty(most, np.int64)
        self._bin_weight = np.empty(most)
        self._depth, self._depth_variance = 0.0, (config.depth_sigma * surface_map.spec.resolution) ** 2
        self._slow = self._fast = 0.0
        self._odom_of_particles = self._odom_of_estimate = SE2()
        self._carried = np.zeros(3)
        self._is_requested = False
        self._estimate: Estimate | None = None

    @property
    def estimate(self) -> Estimate | None:
        """The last estimate, or None before the first pose."""
        return self._estimate

    @property
    def cloud(self) -> ParticleCloud:
        """The present particles."""
        return ParticleCloud(self._particles.copy(), self._weights.copy())

    def set_pose(
        self, stamp_ns: int, odom_from_base: SE2, map_from_base: SE2, covariance: F64 = INITIAL_COVARIANCE
    ) -> None:
        """Start again with particles about a pose; raises InvalidPoseError. The next observation is used even at rest."""
        require_valid(map_from_base, covariance)
        count = self.config.particles_most
        noise = self._rng.standard_normal((count, 3)) @ np.linalg.cholesky(covariance).T
        self._start(stamp_ns, odom_from_base, map_from_base.as_array() + noise)
        self._estimate = Estimate(stamp_ns, map_from_base, covariance.copy(), 0.0, Mode.ODOMETRY, 0.0, False)

    def scatter(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Start again with particles all over the free space (AMCL's global localization)."""
        poses = self._random_poses(self.config.particles_most)
        self._start(stamp_ns, odom_from_base, poses)
        mean, spread = poses.mean(axis=0), np.diag(poses.var(axis=0))
        self._estimate = Estimate(stamp_ns, SE2.from_array(mean), spread, 0.0, Mode.ODOMETRY, 0.0, False)

    def request_update(self) -> None:
        """Weigh the particles by the next observation even if the robot has not moved."""
        self._is_requested = True

    def update(self, observation: Observation) -> Estimate:
        """Move, weigh and resample when the robot has moved far enough; refine the pose with every observation."""
        if self._estimate is None:
            raise NoPoseError("give the particle filter a pose first: set_pose, scatter, or a relocalization")
        config = self.config
        motion = self._odom_of_particles.inverse() @ observation.odom_from_base
        way, turn = math.hypot(motion.x, motion.y), abs(motion.yaw)
        is_due = self._is_requested or way >= config.update_way or turn >= config.update_turn
        points = self._matcher.thin(observation.points_base)
        since = self._odom_of_estimate.inverse() @ observation.odom_from_base
        self._carried = (self._estimate.map_from_base @ since).as_array()
        self._odom_of_estimate = observation.odom_from_base
        if not is_due:
            mean, covariance = self._cluster()
            pose, covariance = predict(SE2.from_array(mean), covariance, motion, config.odometry)
            return self._tell(observation.stamp_ns, pose.as_array(), covariance, points, 0.0, motion)
        self._move(motion)
        self._odom_of_particles = observation.odom_from_base
        self._is_requested = False
        mean, covariance = self._cluster()
        if len(points) >= config.matcher.min_weight:
            expected = np.append(self._carried, self._depth)[None]
            self._weigh(
                self._matcher.without_lone_thing(points, self._matcher.match(points, expected, self._depth_variance))
            )
            weighed_mean, _ = self._cluster()
            self._resample()
            # The spread is that before this scan, so that the scan counts once; the place is where the scan puts the cluster.
            is_wide = covariance[0, 0] + covariance[1, 1] > 0.05 or covariance[2, 2] > 0.01
            if is_wide:
                mean, covariance = weighed_mean, covariance + np.diag([0.01, 0.01, 0.003])
        novelty = min(1.0, way / 0.7 + turn / 0.5)
        return self._tell(observation.stamp_ns, mean, covariance, points, novelty, SE2())

    def _start(self, stamp_ns: int, odom_from_base: SE2, poses: F64) -> None:
        self._particles = np.ascontiguousarray(poses)
        self._particles[:, 2] = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
        self._weights = np.full(len(poses), 1.0 / len(poses))
        self._odom_of_particles = self._odom_of_estimate = odom_from_base
        self._slow = self._fast = 0.0
        self._is_requested = True

    def _random_poses(self, count: int) -> F64:
        """Poses drawn evenly from the free cells of the map."""
        free = np.flatnonzero((self.map.cells >= 0) & (self.map.cells < 50))
        chosen = self._rng.choice(free, count)
        spec = self.map.spec
        out = np.empty((count, 3))
        out[:, 0] = spec.origin_x + (chosen % spec.width + self._rng.random(count)) * spec.resolution
        out[:, 1] = spec.origin_y + (chosen // spec.width + self._rng.random(count)) * spec.resolution
        out[:, 2] = self._rng.uniform(-math.pi, math.pi, count)
        return out

    def _move(self, motion: SE2) -> None:
        noise = self._rng.standard_normal((len(self._particles), 3))
        alphas = np.array(self.config.alphas)
        move = kernel.move_omni if self.config.drive is DriveKind.OMNI else kernel.move_differential
        move(self._particles, motion.as_array(), alphas, noise)

    def _weigh(self, points: F32) -> None:
        config = self.config
        beams = np.linspace(0, len(points) - 1, min(config.max_beams, len(points))).astype(np.int64)
        chosen = np.ascontiguousarray(points[beams])
        log_weights = np.empty(len(self._particles))
        if config.sensor_model is SensorModel.BEAM:
            model = np.array(
                [
                    config.z_hit,
                    config.z_short,
                    config.z_max,
                    config.z_rand,
                    config.sigma_hit,
                    config.rate_short,
                    config.range_most,
                ]
            )
            field_kernel.weigh_by_beams(
                self.map.cells, self.map.frame, self._particles, chosen, model, config.beam_trust, log_weights
            )
        else:
            outside = math.log(config.z_rand)
            field_kernel.weigh_by_field(
                self._field, self.map.frame, self._particles, chosen, outside, config.beam_trust, log_weights
            )
        mean_log = kernel.normalize(log_weights, self._weights)
        likelihood = math.exp(mean_log / (config.beam_trust * len(chosen)))
        if self._slow == 0.0:
            self._slow = self._fast = likelihood
        self._slow += config.recovery_slow * (likelihood - self._slow)
        self._fast += config.recovery_fast * (likelihood - self._fast)

    def _resample(self) -> None:
        """Draw anew when the weights have become uneven or the fitting number of particles has changed much."""
        config = self.config
        lost = max(0.0, 1.0 - self._fast / self._slow) if config.recovery_fast > 0.0 else 0.0
        lost = lost if lost > 0.02 else 0.0
        count = len(self._particles)
        wanted = min(config.particles_most, max(config.particles_least, self._kld_bound(self._occupied)))
        effective = 1.0 / float(np.square(self._weights).sum())
        if effective > config.resample_below * count and 0.8 * count <= wanted <= 1.25 * count and lost == 0.0:
            return
        if lost > 0.0:
            wanted = config.particles_most
        chosen = np.empty(wanted, np.int64)
        kernel.resample_systematic(self._weights, self._rng.random(), chosen)
        self._particles = self._particles[chosen]
        if lost > 0.0:
            random = self._rng.random(wanted) < lost
            self._particles[random] = self._random_poses(int(random.sum()))
        self._weights = np.full(wanted, 1.0 / wanted)

    def _kld_bound(self, bins: int) -> int:
        """Particles after which the sampled distribution over `bins` is within `kld_error` of the true one (Fox 2001, eq. 10)."""
        if bins < 2:
            return self.config.particles_least
        a = 2.0 / (9.0 * (bins - 1))
        cube = (1.0 - a + math.sqrt(a) * self.config.kld_quantile) ** 3
        return math.ceil((bins - 1) / (2.0 * self.config.kld_error) * cube)

    def _cluster(self) -> tuple[F64, F64]:
        """Return mean (3,) and covariance (3, 3) of the heaviest cluster, with a floor of half a centimetre and 0.2 degrees."""
        count = len(self._particles)
        bins = np.empty(count, np.int64)
        size = np.array(self.config.bin_size)
        occupied = kernel.assign_bins(self._particles, size, self._keys, self._table, bins)
        self._occupied = occupied
        turn_bins = round(2.0 * math.pi / size[1])
        cluster, _ = kernel.heaviest_cluster(
            self._weights,
            self._keys,
            self._table,
            bins,
            occupied,
            turn_bins,
            self._label,
            self._todo,
            self._bin_weight,
        )
        mean, covariance = np.empty(3), np.empty((3, 3))
        kernel.moments(self._particles, self._weights, bins, self._label, cluster, mean, covariance)
        return mean, covariance + np.diag([2.5e-5, 2.5e-5, 1e-5])

    def _tell(
        self, stamp_ns: int, mean: F64, covariance: F64, points: F32, novelty: float, since_particles: SE2
    ) -> Estimate:
        """Refine a predicted cluster by the scan and remember the estimate; `since_particles`: motion since the particles moved."""
        config = self.config
        match = self._match(mean, covariance, points, since_particles)
        if match is None or match.score < config.min_score or match.determined == 0:
            score = 0.0 if match is None else match.score
            pose = SE2.from_array(mean)
            self._estimate = Estimate(stamp_ns, pose, covariance.copy(), score, Mode.ODOMETRY, 0.0, novelty > 0.0)
            return self._estimate
        prior = np.append(mean, self._depth)
        prior_covariance = np.zeros((4, 4))
        prior_covariance[:3, :3] = covariance
        prior_covariance[3, 3] = self._depth_variance
        fusion = fuse(prior, prior_covariance, match)
        if fusion.surprise > config.gate:
            if not self._explains_more(match, prior, points):
                pose, surprise = SE2.from_array(mean), fusion.surprise
                self._estimate = Estimate(
                    stamp_ns, pose, covariance.copy(), match.score, Mode.ODOMETRY, surprise, False
                )
                return self._estimate
            # Too few particles came near the true pose: seed some there, and give their spread to the prior.
            self._seed(match.map_from_base @ since_particles.inverse())
            prior_covariance[:3, :3] += np.diag([SEED_SIGMA[0] ** 2, SEED_SIGMA[0] ** 2, SEED_SIGMA[1] ** 2])
            prior_covariance[:2, :2] += np.eye(2) * SE2.from_array(mean).distance_to(match.map_from_base) ** 2
            fusion = fuse(prior, prior_covariance, match)
        if novelty > 0.0:
            self._learn_depth(match)
            self._matcher.learn(novelty)
        mode = Mode(match.determined)
        self._estimate = Estimate(
            stamp_ns, fusion.map_from_base, fusion.published, match.score, mode, fusion.surprise, True
        )
        return self._estimate

    def _learn_depth(self, match: MatchResult) -> None:
        """Take what the walls alone tell of the depth. The particles' spread must not: it comes from the same scans, and where only one
        wall is seen it would slowly move the depth, and with it every pose."""
        information = match.information()
        pose = np.linalg.pinv(information[:3, :3], rcond=1e-9, hermitian=True)
        told = max(0.0, float(information[3, 3] - information[3, :3] @ pose @ information[:3, 3]))
        variance = 1.0 / (1.0 / self._depth_variance + told)
        self._depth += variance * told * (float(match.state[3]) - self._depth)
        self._depth_variance = max(variance, match.map_noise / 6.0)

    def _explains_more(self, match: MatchResult, prior: F64, points: F32) -> bool:
        """Tell whether a match makes the points clearly more likely than a prior float64 (4,) does: near by as the matcher sees it, farther off by the
        likelihood field."""
        return self._matcher.explains_more(match, prior, points) or self._is_likelier(match.state, prior, points)

    def _is_likelier(self, state: F64, prior: F64, points: F32) -> bool:
        """Tell whether the likelihood field finds the points clearly likelier at one state float64 (4,) than at another."""
        both = np.stack([state[:3], prior[:3]])
        logs, outside = np.empty(2), math.log(self.config.z_rand)
        field_kernel.weigh_by_field(self._field, self.map.frame, both, points, outside, 1.0 / len(points), logs)
        return bool(logs[0] > logs[1] + 0.05)

    def _seed(self, pose: SE2) -> None:
        """Put every fourth particle near a pose; all weigh the same until the next scan, which weighs them although the robot may stand: odometry
        tells nothing of a push."""
        self._is_requested = True
        count = len(self._particles)
        chosen = np.arange(0, count, 4)
        sigma = np.array([SEED_SIGMA[0], SEED_SIGMA[0], SEED_SIGMA[1]])
        self._particles[chosen] = pose.as_array() + sigma * self._rng.standard_normal((len(chosen), 3))
        self._weights = np.full(count, 1.0 / count)

    def _match(self, mean: F64, covariance: F64, points: F32, since_particles: SE2) -> MatchResult | None:
        """Match from the cluster and from the pose told last; where that explains little, from other particles, too. A place that is no part of the
        cluster is not told for one scan that fits better there: particles are put there, and further scans weigh them."""
        if len(points) < self.config.matcher.min_weight:
            return None
        # A push moves the robot while its particles stand until it drives again: the pose told last, carried by odometry, is nearer then.
        starts = np.column_stack([np.stack([mean, self._carried]), np.full(2, self._depth)])
        match = self._matcher.match(points, starts, self._depth_variance)
        if match.score >= 0.5 or covariance[0, 0] + covariance[1, 1] > 25.0:
            return match
        heaviest = np.argsort(-self._weights, kind="stable")[:: max(1, len(self._weights) // 12)][:12]
        starts = np.column_stack([self._particles[heaviest], np.full(len(heaviest), self._depth)])
        other = self._matcher.match(points, starts, self._depth_variance)
        if other.cost >= match.cost:
            return match
        reach = NEAR + 3.0 * math.sqrt(covariance[0, 0] + covariance[1, 1])
        if other.map_from_base.distance_to(SE2.from_array(mean)) <= reach:
            return other
        if self._is_likelier(other.state, np.append(mean, self._depth), points):
            self._seed(other.map_from_base @ since_particles.inverse())
        return match
