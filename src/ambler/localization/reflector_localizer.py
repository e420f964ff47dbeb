"""Localizes by reflectors: association by gating, triangulation by Gauss-Newton with the odometry's prediction as the prior."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.localization.errors import NoPoseError
from ambler.localization.localizer import INITIAL_COVARIANCE, Estimate, Mode, Observation
from ambler.localization.motion import OdometryNoise, predict, require_valid
from ambler.localization.reflectors import Recognition, ReflectorMap, associate, recognize
from ambler.registration.reflectors import DetectorConfig, ReflectorDetection, detect_reflectors

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ReflectorConfig:
    """`sigma`: error of a found reflector (m), besides what the sampling of its strip leaves open. `gate`: sigma of the association; `reach_most` metres at most."""

    detector: DetectorConfig = field(default_factory=DetectorConfig)
    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    sigma: float = 0.005
    gate: float = 4.0
    reach_least: float = 0.06
    reach_most: float = 0.8


class ReflectorLocalizer:
    """A `Localizer` by retro-reflectors; observations need intensities."""

    def __init__(self, reflector_map: ReflectorMap, config: ReflectorConfig) -> None:
        self.map = reflector_map
        self.config = config
        self._covariance = np.zeros((3, 3))
        self._odom_from_base = SE2()
        self._estimate: Estimate | None = None

    @property
    def estimate(self) -> Estimate | None:
        """The last estimate, or None before the first pose."""
        return self._estimate

    def set_pose(
        self, stamp_ns: int, odom_from_base: SE2, map_from_base: SE2, covariance: F64 = INITIAL_COVARIANCE
    ) -> None:
        """Start again from a pose; raises InvalidPoseError."""
        require_valid(map_from_base, covariance)
        self._covariance = covariance.copy()
        self._odom_from_base = odom_from_base
        self._estimate = Estimate(stamp_ns, map_from_base, covariance.copy(), 0.0, Mode.ODOMETRY, 0.0, False)

    def request_update(self) -> None:
        """Nothing to do: every observation is used, also while the robot stands."""

    def recognize(self, observation: Observation) -> Recognition:
        """Find the pose without a prior; nothing is changed."""
        return recognize(self._detect(observation).centers, self.map)

    def update(self, observation: Observation) -> Estimate:
        """Predict by odometry, pair reflectors, triangulate."""
        if self._estimate is None:
            raise NoPoseError("give the reflector localizer a pose first: set_pose, or recognize")
        motion = self._odom_from_base.inverse() @ observation.odom_from_base
        pose, covariance = predict(self._estimate.map_from_base, self._covariance, motion, self.config.odometry)
        self._odom_from_base, self._covariance = observation.odom_from_base, covariance
        seen = self._detect(observation)
        stamp = observation.stamp_ns
        self._estimate = Estimate(stamp, pose, covariance.copy(), 0.0, Mode.ODOMETRY, 0.0, False)
        if len(seen.centers) and len(self.map.positions):
            self._triangulate(stamp, pose, covariance, seen)
        return self._estimate

    def _detect(self, observation: Observation) -> ReflectorDetection:
        if observation.intensities is None:
            return ReflectorDetection(np.empty((0, 2)), np.empty(0))
        return detect_reflectors(observation.points_base, observation.intensities, self.config.detector)

    def _triangulate(self, stamp_ns: int, predicted: SE2, prior: F64, detection: ReflectorDetection) -> None:
        """Iterate association and a Kalman update in information form until the pose rests."""
        config = self.config
        seen = detection.centers
        information = np.linalg.inv(prior)
        pose, surprise, index = predicted, 0.0, np.full(len(seen), -1)
        state: F64 = predicted.as_array()
        posterior: F64 = prior
        far = float(np.hypot(seen[:, 0], seen[:, 1]).max())
        for k in range(6):
            spread = math.sqrt(float(np.trace(posterior[:2, :2])) + far * far * float(posterior[2, 2]))
            reach = min(config.reach_most, max(config.reach_least, config.gate * spread))
            index, _ = associate(seen, pose, self.map.positions, reach)
            used = np.flatnonzero(index >= 0)
            if len(used) == 0:
                return
            h, g, surprise = self._normal_equations(pose, seen[used], index[used], detection.sigmas[used])
            pull = predicted.as_array() - state
            pull[2] = wrap_angle(float(pull[2]))
            posterior = np.asarray(np.linalg.inv(information + h), np.float64)
            step = posterior @ (information @ pull + g)
            state = state + step
            pose = SE2(float(state[0]), float(state[1]), wrap_angle(float(state[2])))
            if k > 0 and float(np.abs(step).max()) < 1e-5:
                break
        count = int((index >= 0).sum())
        mode = Mode.FULL if count > 1 else Mode.LINE_AND_YAW
        self._covariance = 0.5 * (posterior + posterior.T)
        score = count / len(seen)
        self._estimate = Estimate(stamp_ns, pose, self._covariance.copy(), score, mode, surprise / (2 * count), True)

    def _normal_equations(self, pose: SE2, seen: F64, index: NDArray[np.int64], sigmas: F64) -> tuple[F64, F64, float]:
        """Return H (3, 3), -gradient (3,) and the squared Mahalanobis sum of map position minus seen position."""
        h, g, total = np.zeros((3, 3)), np.zeros(3), 0.0
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        for (px, py), k, sigma in zip(seen.tolist(), index.tolist(), sigmas.tolist(), strict=True):
            weight = 1.0 / (self.config.sigma**2 + sigma**2 + float(self.map.sigmas[k]) ** 2)
            rx, ry = c * px - s * py, s * px + c * py
            jacobian = np.array([[1.0, 0.0, -ry], [0.0, 1.0, rx]])
            residual = self.map.positions[k] - np.array([pose.x + rx, pose.y + ry])
            h += weight * jacobian.T @ jacobian
            g += weight * jacobian.T @ residual
            total += weight * float(residual @ residual)
        return h, g, total
