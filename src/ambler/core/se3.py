"""Rigid motions of space, SE(3): translation in metres and a unit quaternion (w, x, y, z)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import F64, SE2

Quaternion = tuple[float, float, float, float]
Vector3 = tuple[float, float, float]


def quaternion_multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product of two (w, x, y, z) quaternions."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@dataclass(frozen=True, slots=True)
class SE3:
    """A pose of one frame in another."""

    translation: Vector3 = (0.0, 0.0, 0.0)
    rotation: Quaternion = (1.0, 0.0, 0.0, 0.0)

    def __matmul__(self, other: SE3) -> SE3:
        x, y, z = self.rotate(other.translation)
        tx, ty, tz = self.translation
        qw, qx, qy, qz = quaternion_multiply(self.rotation, other.rotation)
        n = math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        return SE3((tx + x, ty + y, tz + z), (qw / n, qx / n, qy / n, qz / n))

    def rotate(self, v: Vector3) -> Vector3:
        """Rotate a vector of the child frame into the parent frame."""
        w, qx, qy, qz = self.rotation
        vx, vy, vz = v
        tx, ty, tz = 2 * (qy * vz - qz * vy), 2 * (qz * vx - qx * vz), 2 * (qx * vy - qy * vx)
        return (
            vx + w * tx + qy * tz - qz * ty,
            vy + w * ty + qz * tx - qx * tz,
            vz + w * tz + qx * ty - qy * tx,
        )

    def inverse(self) -> SE3:
        w, x, y, z = self.rotation
        turned = SE3((0.0, 0.0, 0.0), (w, -x, -y, -z))
        tx, ty, tz = turned.rotate(self.translation)
        return SE3((-tx, -ty, -tz), turned.rotation)

    def matrix(self) -> F64:
        """Return the homogeneous matrix, float64 (4, 4)."""
        out = np.eye(4)
        w, x, y, z = self.rotation
        out[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        out[:3, 3] = self.translation
        return out

    def transform(self, points: NDArray[np.floating]) -> F64:
        """Map points (N, 3) of the child frame into the parent frame; returns float64 (N, 3)."""
        m = self.matrix()
        return np.asarray(points @ m[:3, :3].T + m[:3, 3])

    def to_se2(self) -> SE2:
        """Project onto the plane: x, y and the heading of the x axis."""
        w, x, y, z = self.rotation
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return SE2(self.translation[0], self.translation[1], yaw)

    @classmethod
    def from_se2(cls, pose: SE2, z: float = 0.0) -> SE3:
        """Lift a planar pose to height z, level."""
        return cls((pose.x, pose.y, z), (math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2)))

    @classmethod
    def from_rpy(cls, translation: Vector3, roll: float, pitch: float, yaw: float) -> SE3:
        """Build from fixed-axis roll, pitch, yaw in radians (the convention of URDF)."""
        cr, sr = math.cos(roll / 2), math.sin(roll / 2)
        cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
        cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
        q = (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
        return cls(translation, q)

    def interpolate(self, other: SE3, ratio: float) -> SE3:
        """Blend linearly in translation and by spherical interpolation in rotation; 0 is here, 1 is `other`."""
        a, b = self.rotation, other.rotation
        dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
        sign = -1.0 if dot < 0 else 1.0
        dot = min(1.0, abs(dot))
        if dot > 0.9995:
            wa, wb = 1.0 - ratio, ratio
        else:
            angle = math.acos(dot)
            wa, wb = math.sin((1 - ratio) * angle) / math.sin(angle), math.sin(ratio * angle) / math.sin(angle)
        wb *= sign
        q = (wa * a[0] + wb * b[0], wa * a[1] + wb * b[1], wa * a[2] + wb * b[2], wa * a[3] + wb * b[3])
        n = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
        ta, tb = self.translation, other.translation
        t = (
            ta[0] + ratio * (tb[0] - ta[0]),
            ta[1] + ratio * (tb[1] - ta[1]),
            ta[2] + ratio * (tb[2] - ta[2]),
        )
        return SE3(t, (q[0] / n, q[1] / n, q[2] / n, q[3] / n))
