"""SE(2) on arrays of poses and twists float64 (N, 3) of (x, y, yaw), for problems with thousands of poses at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def wrap(angles: F64) -> F64:
    """Bring angles into [-pi, pi)."""
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)


def compose(a_from_b: F64, b_from_c: F64) -> F64:
    """Return a_from_c."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = b_from_c[..., 0], b_from_c[..., 1]
    return np.stack(
        np.broadcast_arrays(
            a_from_b[..., 0] + c * x - s * y,
            a_from_b[..., 1] + s * x + c * y,
            wrap(a_from_b[..., 2] + b_from_c[..., 2]),
        ),
        axis=-1,
    )


def inverse(a_from_b: F64) -> F64:
    """Return b_from_a."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = a_from_b[..., 0], a_from_b[..., 1]
    return np.stack([-c * x - s * y, s * x - c * y, -a_from_b[..., 2]], axis=-1)


def exp(twists: F64) -> F64:
    """Integrate constant body twists (vx, vy, w) for unit time."""
    w = twists[..., 2]
    small = np.abs(w) < 1e-6
    safe = np.where(small, 1.0, w)
    a = np.where(small, 1.0 - w * w / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 * w, (1.0 - np.cos(safe)) / safe)
    vx, vy = twists[..., 0], twists[..., 1]
    return np.stack([a * vx - b * vy, b * vx + a * vy, wrap(w)], axis=-1)


def log(poses: F64) -> F64:
    """Return the twists that reach the poses in unit time."""
    w = wrap(poses[..., 2])
    half = 0.5 * w
    small = np.abs(w) < 1e-6
    k = np.where(small, 1.0 - half * half / 3.0, half / np.tan(np.where(small, 1.0, half)))
    x, y = poses[..., 0], poses[..., 1]
    return np.stack([k * x + half * y, -half * x + k * y, w], axis=-1)


def adjoint(a_from_b: F64) -> F64:
    """Return the matrices (N, 3, 3) that carry twists of frame b into frame a."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    out = np.zeros((*a_from_b.shape[:-1], 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = c, -s, a_from_b[..., 1]
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = s, c, -a_from_b[..., 0]
    out[..., 2, 2] = 1.0
    return out


class PlanarTrack:
    """A recorded motion: poses (N, 3) at strictly increasing times (N,) s, with constant twists between."""

    def __init__(self, times: F64, poses: F64) -> None:
        self.times = times
        self.poses = poses
        self.twists = log(compose(inverse(poses[:-1]), poses[1:])) / np.diff(times)[:, None]

    def _segment(self, times: F64) -> NDArray[np.int64]:
        return np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)

    def at(self, times: F64) -> F64:
        """Return the poses at times (M,), continued beyond both ends."""
        k = self._segment(times)
        return compose(self.poses[k], exp(self.twists[k] * (times - self.times[k])[:, None]))

    def twist_at(self, times: F64, width: float = 0.06) -> F64:
        """Return the body's twists at times (M,), averaged over `width` seconds."""
        before, after = self.at(times - 0.5 * width), self.at(times + 0.5 * width)
        return log(compose(inverse(before), after)) / width
