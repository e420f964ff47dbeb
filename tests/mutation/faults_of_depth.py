"""Faults of depth cameras, of the voxels that they fill, and of what orders from outside do."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

LAYER = ("tests/costmap/test_voxel_layer.py",)
WIRE = ("tests/wire/test_depth_pictures.py",)
LAYERS = ("tests/costmap/test_layers.py",)
ORDERS = ("tests/scenarios/test_orders.py",)

DEPTH = (
    PlantedFault(
        "noise of depth grows with the distance only",
        "kernels/depth_picture.py",
        "z += sigma * z * z * normals[v, u]",
        "z += sigma * z * normals[v, u]",
        ("tests/sim/test_depth_camera.py::test_noise_grows_with_the_square_of_the_distance",),
    ),
    PlantedFault(
        "depth pictures have no flying elements",
        "kernels/depth_picture.py",
        "z += (other - z) * (chance - shadow) / flying",
        "z += 0.0",
        ("tests/sim/test_depth_camera.py::test_beside_an_edge_elements_fly_between_the_two_surfaces_or_are_lost",),
    ),
    PlantedFault(
        "depth pictures have no losses beside edges",
        "kernels/depth_picture.py",
        "if chance < shadow:",
        "if chance < 0.0:",
        ("tests/sim/test_depth_camera.py::test_beside_an_edge_elements_fly_between_the_two_surfaces_or_are_lost",),
    ),
    PlantedFault(
        "a depth picture holds the range along the ray",
        "kernels/depth_picture.py",
        "z = distance[v, u] * along[v, u]",
        "z = distance[v, u] * 1.0",
        ("tests/sim/test_depth_camera.py::test_floor_and_walls_lie_where_geometry_puts_them",),
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
        (
            "tests/costmap/test_voxel_layer.py::test_what_has_gone_vanishes_within_a_second_and_what_is_out_of_view_stays",
        ),
    ),
    PlantedFault(
        "voxels are cleared behind what hides them",
        "kernels/voxels.py",
        "if seen < beyond:",
        "if seen < 0.0:",
        ("tests/costmap/test_voxel_layer.py::test_what_is_hidden_behind_something_nearer_stays",),
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
        "lean: Radians = math.radians(4.5)",
        "lean: Radians = math.radians(1.0)",
        LAYER,
    ),
    PlantedFault(
        "what hangs over the robot is an obstacle",
        "kernels/voxels.py",
        "if over > band.top or over < band.doubt",
        "if over < band.doubt",
        LAYER,
    ),
    PlantedFault(
        "the ground of a slope is not taken for the floor",
        "kernels/voxels.py",
        "over = z - ground[iy, ix]",
        "over = z - band.floor",
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
    PlantedFault(
        "a boundary has no sides",
        "costmap/blocked_layer.py",
        "np.roll(corners, -1, axis=0)",
        "np.roll(corners, 0, axis=0)",
        LAYERS,
    ),
    PlantedFault(
        "clearing around a place forgets everything",
        "costmap/layer.py",
        "np.hypot(xs[None, :], ys[:, None]) <= radius",
        "np.hypot(xs[None, :], ys[:, None]) <= 1e9",
        LAYERS,
    ),
    PlantedFault(
        "the terrain forgets all but what it shall forget",
        "perception/terrain.py",
        "(iy[:, None] + 0.5) * cell - y) <= radius",
        "(iy[:, None] + 0.5) * cell - y) > radius",
        ("tests/perception/test_terrain.py::test_what_shall_be_forgotten_is_and_nothing_else",),
    ),
    PlantedFault(
        "an order of speed is not obeyed",
        "nodes/controller.py",
        "share = most / speed",
        "share = 1.0",
        ("tests/scenarios/test_orders.py::test_a_speed_is_kept", *ORDERS),
    ),
    PlantedFault(
        "a robot that is ordered to stand thinks that it is stuck",
        "nodes/controller.py",
        "self._is_held or self._stop_order != 0 or",
        "self._is_held or",
        ("tests/scenarios/test_orders.py::test_a_stop_of_the_first_kind_holds_the_way_and_not_the_turning",),
    ),
    PlantedFault(
        "viewers may order speeds that are no numbers",
        "bridges/client_orders.py",
        "math.isfinite(message.value) and message.value >= 0.0",
        "message.value is not None",
        ("tests/bridges/test_client_orders.py",),
    ),
    PlantedFault(
        "a boundary's sides are drawn however far they go",
        "costmap/blocked_layer.py",
        "        if first <= last:\n            a, b = a + first * (b - a), a + last * (b - a)\n",
        "        if True:\n",
        ("tests/costmap/test_layers.py::test_of_a_huge_boundary_only_what_the_grid_holds_is_drawn",),
    ),
    PlantedFault(
        "viewers may tell places beyond every site",
        "bridges/client_orders.py",
        "FARTHEST = 1e5",
        "FARTHEST = 1e8",
        ("tests/bridges/test_client_orders.py",),
    ),
    PlantedFault(
        "one stamp that jumps ahead leaves out all that follows",
        "recordings/cloud_scan.py",
        "if message.stamp_ns == 0 or self.last_ns < message.stamp_ns - JUMP_NS:",
        "if message.stamp_ns == 0:",
        ("tests/recordings/test_cloud_recording.py::test_one_stamp_that_jumps_ahead_does_not_leave_out_what_follows",),
    ),
    PlantedFault(
        "a message that was stamped before there was a clock is one like all",
        "recordings/cloud_scan.py",
        "return ahead_ns > 0 and (self.last_ns >= 0 or ahead_ns <= BEFORE_NS)",
        "return ahead_ns > 0",
        ("tests/recordings/test_cloud_recording.py::test_messages_before_a_driver_has_a_clock_are_left_out",),
    ),
    PlantedFault(
        "edges do not know where in the rolled arrays their window begins",
        "kernels/terrain_edges.py",
        "cx0, cy0 = (first[0] // 2) % m, (first[1] // 2) % m\n    evidence",
        "cx0, cy0 = 0, 0\n    evidence",
        ("tests/perception/test_terrain.py::test_a_hole_in_an_edge_is_closed_unless_level_ground_is_seen_in_it",),
    ),
    PlantedFault(
        "each round of a robot adds to the visibility graph",
        "planning/visibility_graph.py",
        "AGAIN = 0.3 ",
        "AGAIN = 0.0 ",
        ("tests/planning/test_visibility_graph.py::test_rounds_add_no_nodes_without_end",),
    ),
)
