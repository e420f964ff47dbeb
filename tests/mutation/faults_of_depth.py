"""Faults of depth cameras and of the voxels that they fill."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

CAMERA = ("tests/sim/test_depth_camera.py",)
LAYER = ("tests/costmap/test_voxel_layer.py",)
WIRE = ("tests/wire/test_depth_pictures.py",)

DEPTH = (
    PlantedFault(
        "noise of depth grows with the distance only",
        "kernels/depth_picture.py",
        "z += sigma * z * z * normals[v, u]",
        "z += sigma * z * normals[v, u]",
        CAMERA,
    ),
    PlantedFault(
        "depth pictures have no flying elements",
        "kernels/depth_picture.py",
        "z += (other - z) * (chance - shadow) / flying",
        "z += 0.0",
        CAMERA,
    ),
    PlantedFault(
        "depth pictures have no losses beside edges",
        "kernels/depth_picture.py",
        "if chance < shadow:",
        "if chance < 0.0:",
        CAMERA,
    ),
    PlantedFault(
        "a depth picture holds the range along the ray",
        "kernels/depth_picture.py",
        "z = distance[v, u] * along[v, u]",
        "z = distance[v, u] * 1.0",
        CAMERA,
    ),
    PlantedFault(
        "depth is sent in centimetres",
        "wire/ros_camera.py",
        "np.rint(1000.0 * np.where",
        "np.rint(100.0 * np.where",
        WIRE,
    ),
    PlantedFault(
        "one hit marks a voxel",
        "costmap/voxel_layer.py",
        "enough: int = 3",
        "enough: int = 2",
        LAYER,
    ),
    PlantedFault(
        "voxels are never cleared",
        "kernels/voxels.py",
        "                            score -= 1\n",
        "                            score -= 0\n",
        LAYER,
    ),
    PlantedFault(
        "voxels are cleared behind what hides them",
        "kernels/voxels.py",
        "if seen < beyond:",
        "if seen < 0.0:",
        LAYER,
    ),
    PlantedFault(
        "rays of one direction clear flat surfaces",
        "kernels/voxels.py",
        "    for dv in range(2):\n        for du in range(2):\n            seen",
        "    for dv in range(1, 2):\n        for du in range(2):\n            seen",
        LAYER,
    ),
    PlantedFault(
        "far floor counts like near floor",
        "costmap/voxel_layer.py",
        "lean: float = math.radians(4.5)",
        "lean: float = math.radians(1.0)",
        LAYER,
    ),
    PlantedFault(
        "what hangs over the robot is an obstacle",
        "kernels/voxels.py",
        "if over > top or over < doubt",
        "if over < doubt",
        LAYER,
    ),
    PlantedFault(
        "the ground of a slope is not taken for the floor",
        "kernels/voxels.py",
        "over = z - ground[iy, ix]",
        "over = z - floor",
        LAYER,
    ),
    PlantedFault(
        "a cloud is placed where it began",
        "kernels/voxels.py",
        "k = min(max(int(times[i] / step + 0.5), 0), last)",
        "k = 0",
        LAYER,
    ),
    PlantedFault(
        "where the robot stands voxels stay",
        "kernels/voxels.py",
        "            if is_in:\n",
        "            if not is_in:\n",
        LAYER,
    ),
)
