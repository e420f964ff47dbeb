"""Faults of the terrain analysis, and of what becomes of it."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

GROUND = ("tests/perception/test_terrain.py",)
LAYER = ("tests/costmap/test_terrain_layer.py",)
MAP = ("tests/perception/test_ground_map.py",)
WALK = ("tests/safety/test_floor_walk.py",)
LEANING = ("tests/safety/test_leaning_cloud.py",)
FLOOR_MEMORY = ("tests/safety/test_floor_memory.py",)
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
    PlantedFault(
        "obstacles weigh no more than ground",
        "kernels/ground_map.py",
        "GROUND_MOST, OBSTACLE_MOST = 4, -6",
        "GROUND_MOST, OBSTACLE_MOST = 4, -1",
        ("tests/perception/test_ground_map.py::test_what_left_is_free_again_after_some_looks_and_not_after_one", *MAP),
    ),
    PlantedFault(
        "what is assumed stays",
        "kernels/ground_map.py",
        "                was = UNKNOWN\n",
        "                was = ASSUMED\n",
        (
            "tests/perception/test_ground_map.py::test_ground_too_near_for_a_level_lidar_is_assumed_until_the_robot_is_away",
        ),
    ),
    PlantedFault(
        "ground is assumed behind walls",
        "kernels/ground_map.py",
        "                    is_open = False\n",
        "                    is_open = True\n",
        ("tests/perception/test_ground_map.py::test_nothing_is_assumed_behind_a_wall",),
    ),
    PlantedFault(
        "roofs are ground",
        "perception/ground_map.py",
        "kernels.keep_joined(",
        "(lambda *_: None)(",
        ("tests/perception/test_ground_map.py::test_a_roof_beside_the_ground_is_no_ground",),
    ),
    PlantedFault(
        "an upper deck is drawn over the lower one",
        "kernels/ground_map.py",
        "if kind != 0 and not is_other:",
        "if kind != 0:",
        ("tests/perception/test_ground_map.py::test_some_ground_of_another_level_does_not_change_this_one",),
    ),
    PlantedFault(
        "another level is looked for on this one",
        "perception/ground_map.py",
        "out[inner][beyond & (out[inner] == OCC_UNKNOWN)] = OCC_OCCUPIED",
        "pass",
        ("tests/perception/test_ground_map.py::test_what_another_level_knows_beyond_shared_ground_is_closed",),
    ),
    PlantedFault(
        "where the robot stood is forgotten",
        "kernels/ground_map.py",
        "is_other = is_other or is_far or firm[iy, ix] != 0",
        "is_other = is_other or is_far",
        MAP,
    ),
    PlantedFault(
        "whatever lies beside the robot is firm",
        "kernels/ground_map.py",
        "elif 0 < evidence[iy, ix] != ASSUMED and is_in_plane:",
        "elif 0 < evidence[iy, ix] != ASSUMED:",
        (
            "tests/perception/test_ground_map.py::test_ground_beside_a_robot_that_lies_lower_than_its_wheels_is_not_firm",
        ),
    ),
    PlantedFault(
        "drops are believed from afar",
        "kernels/ground_map.py",
        "is_other = is_other or is_far or firm",
        "is_other = is_other or firm",
        (
            "tests/perception/test_ground_map.py::test_a_drop_seen_from_afar_is_looked_at_and_one_seen_from_near_is_believed",
        ),
    ),
    PlantedFault(
        "a deck seen from the ramp makes a level",
        "perception/ground_map.py",
        "if not here.is_contradicted or self._give_back(here.level_height, base):",
        "if not here.is_contradicted:",
        MAP,
    ),
    PlantedFault(
        "decks are given away under the robot",
        "perception/ground_map.py",
        " and not (level.firm[only_here] > 0).any():",
        ":",
        ("tests/perception/test_ground_map.py::test_a_deck_on_which_the_robot_has_stood_is_not_given_away",),
    ),
    PlantedFault(
        "passages are only where levels began",
        "perception/ground_map.py",
        "                self._meet_others(window, map_from_odom, rise, base)\n",
        "",
        ("tests/perception/test_ground_map.py::test_where_two_levels_meet_is_remembered_as_a_passage",),
    ),
    PlantedFault(
        "firm ground is not remembered by the terrain",
        "perception/terrain.py",
        "        self._memory[iy, ix] = points[is_inside, 2]\n",
        "",
        ("tests/perception/test_terrain.py::test_a_ramp_that_was_driven_is_ground_where_it_cannot_be_seen",),
    ),
    PlantedFault(
        "a ramp goes on for ever",
        "kernels/terrain_ground.py",
        "rise = min(0.0, (near_z - run_z) / (near_r - run_r))",
        "rise = (near_z - run_z) / (near_r - run_r)",
        ("tests/perception/test_terrain.py::test_ground_may_level_off_behind_a_crest",),
    ),
    PlantedFault(
        "the gate's floor creeps up walls",
        "kernels/floor_walk.py",
        "least = min(least, low - slope * far + TOLERANCE)",
        "least = low - slope * far + TOLERANCE",
        WALK,
    ),
    PlantedFault(
        "the gate's floor memory outlives a jump of odometry",
        "safety/floor_memory.py",
        "            is_again[:] = True\n",
        "            pass\n",
        FLOOR_MEMORY,
    ),
    PlantedFault(
        "a gap without floor begins below the robot",
        "kernels/floor_walk.py",
        "low, max(far, under), False",
        "low, far, False",
        WALK,
    ),
    PlantedFault(
        "the gate does not see who stands behind a tilted scanner",
        "safety/points.py",
        "is_in_band |= is_lowest",
        "is_in_band |= False & is_lowest",
        LEANING,
    ),
    PlantedFault(
        "the gate stops before what hangs over it",
        "safety/points.py",
        "is_in_band |= is_lowest & (heights",
        "is_in_band |= (heights",
        LEANING,
    ),
    PlantedFault(
        "the gate takes the robot's legs for floor",
        "safety/floor_memory.py",
        "is_beyond = points[:, 0] ** 2 + points[:, 1] ** 2 > under * under",
        "is_beyond = points[:, 0] ** 2 >= 0.0",
        FLOOR_MEMORY,
    ),
    PlantedFault(
        "remembered floor keeps the height that it had from its first place",
        "safety/floor_memory.py",
        "return np.asarray(odom_from_level.inverse().transform(kept))",
        "return np.asarray(odom_from_level.inverse().transform(kept) * (1, 1, 0) + kept * (0, 0, 1))",
        FLOOR_MEMORY,
    ),
    PlantedFault(
        "what is hidden beside a robot stays at the height of where it was seen",
        "safety/blind_memory.py",
        "_moved(odom_from_base.inverse(), self._means_odom, -height)",
        "_moved(odom_from_base.inverse(), self._means_odom, 0.0)",
        ("tests/safety/test_blind_memory.py",),
    ),
    PlantedFault(
        "the gate's floor rises by any slope",
        "kernels/floor_walk.py",
        "if far - last <= gap:",
        "if True:",
        WALK,
    ),
    PlantedFault(
        "the floor inside walls counts as reached",
        "sim/reachable_ground.py",
        "        _hollow_out(solid, spec, heights)",
        "        pass",
        ("tests/sim/test_reachable_ground.py", "tests/evaluation/test_site_quality.py"),
    ),
    PlantedFault(
        "ground at any height covers a site",
        "evaluation/site_quality.py",
        "(occupancy[iy, ix] == OCC_FREE) & same",
        "(occupancy[iy, ix] == OCC_FREE)",
        ("tests/evaluation/test_site_quality.py::test_ground_of_another_level_and_ground_behind_walls_do_not_count",),
    ),
    PlantedFault(
        "every surface of a site is seen",
        "evaluation/site_quality.py",
        "surface_coverage=_share(is_seen)",
        "surface_coverage=1.0",
        ("tests/evaluation/test_site_quality.py::test_what_is_missing_counts",),
    ),
    PlantedFault(
        "the robot never goes back to a level",
        "missions/explore.py",
        "return {k for k in open_on if",
        "return {k for k in () if",
        ("tests/missions/test_explore_levels.py",),
    ),
)
