"""Sub-pixel corners of square markers from their edges.

Each side of the black square is sampled across, at many places, in the picture without distortion; where the darkness ends there is a
point of the edge (the place at which a sharp step would have left as much dark and bright as was seen, so a symmetric blur does
not shift it). A line is fitted to each side, corners are where lines meet. Forty samples per side instead of one neighbourhood
per corner: a few times more exact than a search for the corner's saddle, and its covariance is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

STEP = 0.5  # pixels between two samples across an edge
FLOOR_PX = 0.015  # what no fit of a line is better than, pixels
LOOSE_PX = 0.8  # of a corner whose edges cannot be fitted
WHITE = 251.0  # grey from which white is cut off, which moves edges
CUT_PX = 0.15


@dataclass(frozen=True, slots=True)
class EdgeConfig:
    """`reach`: share of a cell that is sampled on both sides of an edge, at most `reach_px`; `contrast`: least step of grey;
    `inliers`: least share of the samples that must agree; `shift_px`: how far the edges are moved outwards (calibrated)."""

    reach: float = 0.42
    reach_px: float = 4.0
    contrast: float = 18.0
    inliers: float = 0.5
    shift_px: float = 0.0


def refine_corners(
    image: F32, corners_px: F64, cells: int, camera: CameraModel, config: EdgeConfig
) -> tuple[F64, F64, int]:
    """Refine corners (4, 2), clockwise in the picture, of a marker with so many cells along its side.

    Returns the corners without distortion but in pixels, float64 (4, 2), their covariance (8, 8), and how many edges were fitted.
    """
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    corners = camera.undistort(corners_px) * focal + centre
    covariance, fitted = np.eye(8) * LOOSE_PX**2, 0
    for _ in range(5):
        lines = [_fit_edge(image, corners, k, cells, camera, config) for k in range(4)]
        fitted = sum(line is not None for line in lines)
        moved, covariance = _corners_of(corners, lines, config.shift_px)
        shift = float(np.abs(moved - corners).max())
        corners = moved
        if shift < 0.05:
            break
    return corners, covariance, fitted


def _frame(corners: F64, k: int) -> tuple[F64, F64, F64, float]:
    """Return middle, direction, outward normal and half length of edge k, from corner k to the next."""
    a, b = corners[k], corners[(k + 1) % 4]
    half = 0.5 * float(np.hypot(*(b - a)))
    direction = (b - a) / (2.0 * half)
    return 0.5 * (a + b), direction, np.array([direction[1], -direction[0]]), half


def _fit_edge(
    image: F32, corners: F64, k: int, cells: int, camera: CameraModel, config: EdgeConfig
) -> tuple[float, float, F64] | None:
    """Return the edge's offset at its middle and its change per half length (pixels, outwards), with their covariance (2, 2)."""
    middle, direction, normal, half = _frame(corners, k)
    cell = 2.0 * half / cells
    reach = min(config.reach_px, max(min(2.0, 0.6 * cell), config.reach * cell))
    inside = 1.0 - max(0.08, (reach + 1.0) / max(half, 1.0))
    if inside < 0.3:
        return None
    t = np.linspace(-inside, inside, int(np.clip(1.6 * half * inside, 8, 80)))
    across = np.linspace(-reach, reach, 2 * int(np.ceil(reach / STEP)) + 1)
    points = middle + t[:, None, None] * half * direction + across[None, :, None] * normal
    rays = (points.reshape(-1, 2) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    pixels = camera.distort(rays).astype(np.float32).reshape(len(t), len(across), 2)
    grey = cv2.remap(image, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    is_in = (pixels > 0.0).all(axis=(1, 2)) & (pixels < (camera.width - 1, camera.height - 1)).all(axis=(1, 2))
    place, is_good = _step_places(np.asarray(grey, np.float32), across, t, config.contrast)
    line = _fit_line(t, place, is_good & is_in, config.inliers)
    if line is None or float(np.median(grey[:, -1])) < WHITE:
        return line
    return line[0], line[1], line[2] + np.eye(2) * CUT_PX**2


def _step_places(grey: F32, across: F64, t: F64, contrast: float) -> tuple[F64, NDArray[np.bool_]]:
    """Return where each profile (M, K) steps from dark to bright, and whether it does so clearly.

    Dark and bright are smooth along an edge, so their levels come from all profiles: those of one would be noisy.
    """
    ends = max(1, len(across) // 6)
    dark, bright = grey[:, :ends].mean(axis=1), grey[:, -ends:].mean(axis=1)
    is_good = bright - dark > contrast
    if int(is_good.sum()) < 5:
        return np.zeros(len(t)), np.zeros(len(t), np.bool_)
    smooth_dark, is_usual_dark = _smooth(dark, t, is_good)
    smooth_bright, is_usual_bright = _smooth(bright, t, is_good)
    step = smooth_bright - smooth_dark
    is_good &= is_usual_dark & is_usual_bright & (step > contrast)
    share = (grey - smooth_dark[:, None]) / np.where(step > contrast, step, 1.0)[:, None]
    width = across[1] - across[0]
    area = (share.sum(axis=1) - 0.5 * (share[:, 0] + share[:, -1])) * width
    is_good &= (share.min(axis=1) > -0.4) & (share.max(axis=1) < 1.4)
    return np.asarray(across[-1] - area, np.float64), np.asarray(is_good)


def _smooth(level: NDArray[np.floating], t: F64, is_good: NDArray[np.bool_]) -> tuple[F64, NDArray[np.bool_]]:
    """Return a parabola through the levels (M,), and which of them are not far from it."""
    keep = is_good.copy()
    smooth = np.asarray(level, np.float64)
    design = np.stack((np.ones(len(t)), t, t * t), axis=1)
    for _ in range(2):
        part = design[keep]
        smooth = design @ np.linalg.solve(part.T @ part, part.T @ level[keep])
        off = np.abs(level - smooth)
        limit = max(10.0, 4.0 * 1.4826 * float(np.median(off[keep])))
        fewer = is_good & (off < limit)
        if int(fewer.sum()) < 5:
            break
        keep = fewer
    return smooth, keep


def _fit_line(t: F64, place: F64, is_good: NDArray[np.bool_], least: float) -> tuple[float, float, F64] | None:
    """Fit place = a + b t, leaving out what is far from it; None when too few samples agree."""
    keep = is_good.copy()
    needed = max(5, round(least * len(t)))
    coefficients: F64 = np.zeros(2)
    spread = 1.0
    for k in range(4):
        if int(keep.sum()) < needed:
            return None
        if k == 0:
            coefficients = np.array([float(np.median(place[keep])), 0.0])
        else:
            coefficients = _line(t[keep], place[keep])
        error = np.abs(place - coefficients[0] - coefficients[1] * t)
        spread = 1.4826 * float(np.median(error[keep]))
        keep = is_good & (error < max(3.0 * spread, 0.25 if k == 0 else 0.05))
    design = np.column_stack((np.ones(int(keep.sum())), t[keep]))
    if int(keep.sum()) < needed or np.ptp(t[keep]) < 0.5:
        return None
    # Neighbouring samples share picture elements: about every second one is independent.
    covariance = 2.0 * max(spread, 0.02) ** 2 * np.linalg.inv(design.T @ design) + np.eye(2) * FLOOR_PX**2
    return float(coefficients[0]), float(coefficients[1]), covariance


def _line(t: F64, place: F64) -> F64:
    """Return the least-squares (a, b) of place = a + b t."""
    middle, height = t.mean(), place.mean()
    slope = float((t - middle) @ (place - height)) / max(1e-12, float((t - middle) @ (t - middle)))
    return np.array([height - slope * middle, slope])


def _corners_of(corners: F64, lines: list[tuple[float, float, F64] | None], shift_px: float) -> tuple[F64, F64]:
    """Intersect neighbouring edges; returns corners (4, 2) and covariance (8, 8)."""
    frames = [_frame(corners, k) for k in range(4)]
    normals, offsets = np.empty((4, 2)), np.empty(4)
    blocks = np.zeros((8, 8))
    for k, (line, (middle, direction, normal, half)) in enumerate(zip(lines, frames, strict=True)):
        a, b, cov = line if line is not None else (0.0, 0.0, np.eye(2) * LOOSE_PX**2)
        tilted = normal - (b / half) * direction
        normals[k] = tilted
        offsets[k] = float(tilted @ middle) + a + shift_px
        blocks[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = cov
    out, jacobian = np.empty((4, 2)), np.zeros((8, 8))
    for j in range(4):
        before = (j - 1) % 4
        inverse = np.linalg.inv(np.stack((normals[before], normals[j])))
        out[j] = inverse @ (offsets[before], offsets[j])
        # A corner lies at the end (t = 1) of the edge before it and at the start (t = -1) of its own.
        jacobian[2 * j : 2 * j + 2, 2 * before] = inverse[:, 0]
        jacobian[2 * j : 2 * j + 2, 2 * before + 1] = inverse[:, 0]
        jacobian[2 * j : 2 * j + 2, 2 * j] = inverse[:, 1]
        jacobian[2 * j : 2 * j + 2, 2 * j + 1] = -inverse[:, 1]
    return out, jacobian @ blocks @ jacobian.T
