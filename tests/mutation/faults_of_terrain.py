"""Faults of the terrain analysis, and of what becomes of it."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

GROUND = ("tests/perception/test_terrain.py",)
LAYER = ("tests/costmap/test_terrain_layer.py",)
NODE = ("tests/perception/test_terrain_node.py",)

TERRAIN = (
    PlantedFault(
        "everything seen is ground",
        "kernels/terrain_ground.py",
        "is_ground = abs(off) <= climb",
        "is_ground = True",
        ("tests/perception/test_terrain.py::test_the_floor_below_a_table_stays_ground", *GROUND),
    ),
    PlantedFault(
        "nothing is forgotten that rays go through",
        "kernels/terrain_columns.py",
        "return 1.0 if nearest > away + margin * (1.0 + away * 0.1) else 0.0",
        "return 0.0",
        ("tests/perception/test_terrain.py::test_who_walks_away_is_forgotten",),
    ),
    PlantedFault(
        "drops are looked for upwards",
        "kernels/terrain_ground.py",
        "off = expected - low",
        "off = low - expected",
        ("tests/perception/test_terrain.py::test_a_drop_is_seen_before_the_robot_is_near",),
    ),
    PlantedFault(
        "slopes explain no step",
        "kernels/terrain_ground.py",
        "    most = 0.0\n    if not math.isnan(beside):",
        "    most = fall = 0.0\n    if not math.isnan(beside):",
        ("tests/perception/test_terrain.py::test_a_slope_of_15_degrees_is_ground_and_one_of_28_is_not",),
    ),
    PlantedFault(
        "a slope is stairs",
        "kernels/terrain_ground.py",
        "if rises >= 3 and treads >= rises - 1 and between < rises:",
        "if rises >= 1:",
        ("tests/perception/test_terrain.py::test_stairs_are_recognized_and_crossed_only_by_who_climbs",),
    ),
    PlantedFault(
        "what hangs above the robot is in its way",
        "perception/terrain.py",
        "limits = np.array([c.step, c.clearance,",
        "limits = np.array([c.step, c.clearance + 1.0,",
        (
            "tests/perception/test_terrain.py::test_what_hangs_lower_than_the_robot_is_an_obstacle_and_what_hangs_higher_is_not",
        ),
    ),
    PlantedFault(
        "the window keeps what it left",
        "perception/terrain.py",
        "columns.forget_left(",
        "(lambda *_: None)(",
        ("tests/perception/test_terrain.py::test_what_lies_behind_is_forgotten_with_the_window",),
    ),
    PlantedFault(
        "ground is not freed",
        "costmap/terrain_layer.py",
        "self._fill(master, spec, self._points[ground], cost[ground], round(c.cell / r))",
        "pass",
        LAYER,
    ),
    PlantedFault(
        "the wide terrain is told twice as often",
        "nodes/terrain.py",
        "if self._count % (2 * WIDE_EVERY) == 0:",
        "if self._count % WIDE_EVERY == 0:",
        NODE,
    ),
)
