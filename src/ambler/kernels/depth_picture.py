"""What a stereo depth camera makes of exact distances, for the simulator's sensors only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ambler.kernels.jit import jit


class DepthErrors(NamedTuple):
    """What a camera makes of exact distances, as in `sim.sensors.DepthCameraSpec`: depth from `near` to `reach` metres, patches of `patch` elements' side that
    are lost with probability `patch_loss`, no depth on surfaces met at a cosine below `grazing`."""

    sigma: float
    near: float
    reach: float
    dropout: float
    patch: int
    patch_loss: float
    grazing: float
    edge: float
    shadow: float
    flying: float


@jit
def to_depth(distance, cosine, along, normals, uniforms, patches, errors, out):
    """Turn exact distances float32 (H, W) along rays, whose parts along the axis are `along` float64 (H, W), into depth uint16 (H, W) in
    millimetres, 0 where there is none.

    `normals`, `uniforms` float32 (H, W) and `patches` float32 (h, w), one for `patch` elements' squares, are the chance. An element is beside an edge when its left or upper neighbour lies `edge` metres nearer or farther.
    """
    sigma, near, reach, dropout, patch, patch_loss, grazing, edge, shadow, flying = errors
    height, width = distance.shape
    for v in range(height):
        for u in range(width):
            out[v, u] = 0
            z = distance[v, u] * along[v, u]
            if not z <= reach or z < near:
                continue
            if cosine[v, u] < grazing or patches[v // patch, u // patch] < patch_loss:
                continue
            chance = uniforms[v, u]
            if chance < dropout:
                continue
            chance = (chance - dropout) / (1.0 - dropout)
            left = distance[v, u - 1] * along[v, u - 1] if u > 0 else z
            above = distance[v - 1, u] * along[v - 1, u] if v > 0 else z
            other = left if abs(left - z) > edge else above
            if abs(other - z) > edge:
                if chance < shadow:
                    continue
                if chance < shadow + flying and other <= reach:
                    z += (other - z) * (chance - shadow) / flying
            z += sigma * z * z * normals[v, u]
            if near <= z <= reach:
                out[v, u] = np.uint16(round(1000.0 * z))


def warm_up() -> None:
    """Compile or load every kernel with its real argument types."""
    f32, f64 = np.ones((2, 2), np.float32), np.ones((2, 2))
    to_depth(
        *(f32, f32, f64, f32, f32, f32, DepthErrors(0.002, 0.3, 10.0, 0.0, 6, 0.0, 0.0, 0.1, 0.0, 0.0)),
        np.zeros((2, 2), np.uint16),
    )
