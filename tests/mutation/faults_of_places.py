"""Faults of drawn places and of what is measured in them: a place that nobody can enter, or a bar that everybody clears."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

CAMPUS = ("tests/studies/test_campus.py",)
CAMPAIGN = ("tests/studies/test_exploration_campaign.py",)

PLACES = (
    PlantedFault(
        "every seed draws the same place",
        "sim/generator/draw.py",
        "[zlib.crc32(kind.encode()), seed, attempt]",
        "[zlib.crc32(kind.encode()), 0, attempt]",
        ("tests/sim/test_generator.py::test_a_seed_is_a_place_and_another_seed_another_one",),
    ),
    PlantedFault(
        "a robot begins on the paper around a drawn house",
        "sim/floorplan.py",
        "return np.asarray(touching[regions])",
        "return np.zeros_like(free)",
        ("tests/sim/test_world_file.py::test_the_start_lies_in_the_drawn_house_and_not_on_the_paper_around_it",),
    ),
    PlantedFault(
        "a robot begins in a yard that no door leads into",
        "sim/floorplan.py",
        "    if count < 2:",
        "    if count >= 0:",
        ("tests/sim/test_world_file.py::test_the_start_lies_in_the_largest_part_of_the_floor",),
    ),
    PlantedFault(
        "a robot is put into the grey around a saved map",
        "apps/scene.py",
        "check_start(options.world, start)",
        "pass",
        ("tests/apps/test_start.py::test_a_robot_starts_on_the_floor_of_a_plan",),
    ),
    PlantedFault(
        "a robot cannot begin where the beams missed the floor",
        "sim/floorplan.py",
        "(_is_free(occupancy) | unknown & ~beyond)[iy, ix]",
        "_is_free(occupancy)[iy, ix]",
        ("tests/apps/test_start.py::test_a_robot_starts_on_the_floor_of_a_plan",),
    ),
    PlantedFault(
        "a plan is drawn with walls twice as thick",
        "sim/floorplan.py",
        "if corners[up, right] < 1.0:",
        "if corners[up, right] < 1e9:",
        ("tests/sim/test_world_file.py::test_walls_and_doors_of_a_plan_are_drawn_as_wide_as_they_are",),
    ),
    PlantedFault(
        "thin walls pass between the samples of a true map",
        "sim/truth.py",
        "least = 0.51 * spec.resolution / SAMPLES",
        "least = 0.0 * spec.resolution / SAMPLES",
        ("tests/sim/test_truth.py::test_a_wall_that_is_thinner_than_the_samples_are_apart_is_drawn",),
    ),
    PlantedFault(
        "a saved map leaks through the gaps of its walls",
        "sim/floorplan.py",
        "ends = beyond & ndimage",
        "ends = occupied & ndimage",
        ("tests/sim/test_world_file.py::test_a_saved_map_ends_where_its_author_saw_nothing",),
    ),
    PlantedFault(
        "what nobody saw is floor when a saver wrote a generous threshold",
        "wire/map_files.py",
        "return saved if np.any(saved == OCC_FREE) else served",
        "return served",
        ("tests/sim/test_world_file.py::test_a_saved_map_ends_where_its_author_saw_nothing",),
    ),
    PlantedFault(
        "people of drawn places walk through furniture",
        "sim/generator/rooms.py",
        "if not any(place.overlaps(other) for other in taken):",
        "if taken is not None:",
        ("tests/sim/test_generator.py::test_people_walk_where_nothing_stands",),
    ),
    PlantedFault(
        "furniture of drawn places stands before doors",
        "sim/generator/zones.py",
        "self._keep_clear(edge, edge.begin + middle, width)",
        "self.plan.rng.random()",
        ("tests/sim/test_generator.py::test_both_sides_of_every_door_are_reached",),
    ),
    PlantedFault(
        "pallets of drawn places stand too low to be seen",
        "sim/generator/things.py",
        'thing = solid("pallet", 1.2, 0.8, 0.35, 0.45)',
        'thing = solid("pallet", 1.2, 0.8, 0.14, 0.45)',
        ("tests/sim/test_generator.py::test_what_a_low_robot_could_run_into_crosses_the_planes_of_its_scanners",),
    ),
    PlantedFault(
        "the reachable floor goes through what hangs low",
        "sim/truth.py",
        "if s.z_min < high and s.z_max > low)",
        "if s.z_min < low and s.z_max > low)",
        ("tests/sim/test_truth.py::test_the_reachable_floor_is_that_of_a_body_from_its_underside_to_its_top",),
    ),
    PlantedFault(
        "routes through campuses turn back on the way",
        "studies/campus_route.py",
        "if there == last or (there, here) in came:",
        "if (there, here) in came:",
        ("tests/studies/test_campus.py::test_routes_run_along_ways_and_never_turn_back",),
    ),
    PlantedFault(
        "the scanner of a campus log looks beside its heading",
        "studies/campus_log.py",
        "half = 0.5 * (poses[:, 2] + offset.yaw)",
        "half = 0.49 * (poses[:, 2] + offset.yaw)",
        ("tests/studies/test_campus.py::test_beams_end_on_what_is_there",),
    ),
    PlantedFault(
        "the wheels of a campus log do not count turning",
        "studies/campus_log.py",
        "np.outer(steps[:, 2], around)",
        "np.outer(0.0 * steps[:, 2], around)",
        ("tests/studies/test_campus.py::test_odometry_counts_what_wheels_turn",),
    ),
    PlantedFault(
        "a closure is false only when both its place and its angle are",
        "evaluation/loop_errors.py",
        "self.distance > FALSE_FROM[0] or self.angle > FALSE_FROM[1]",
        "self.distance > FALSE_FROM[0] and self.angle > FALSE_FROM[1]",
        CAMPUS,
    ),
    PlantedFault(
        "a bent campus map is good",
        "studies/campus_study.py",
        'result.get("false_closures") == 0 and',
        'result.get("false_closures") == 0 or',
        CAMPUS,
    ),
    PlantedFault(
        "time in recoveries is counted to the state before",
        "evaluation/exploration_run.py",
        "pairwise(states) if a[1] in wanted",
        "pairwise(states) if b[1] in wanted",
        ("tests/evaluation/test_recovery_time.py",),
    ),
    PlantedFault(
        "fresh places may fail half of the time",
        "studies/exploration_campaign.py",
        'fresh["done"] >= DONE_LEAST * fresh["runs"]',
        'fresh["done"] >= 0.5 * fresh["runs"]',
        CAMPAIGN,
    ),
    PlantedFault(
        "development places count against the bars of fresh ones",
        "studies/exploration_campaign.py",
        'fresh = [r for r in results if r["places"] == FRESH]',
        "fresh = list(results)",
        CAMPAIGN,
    ),
    PlantedFault(
        "a map that lacks a tenth of the floor is enough",
        "apps/judgement.py",
        "share >= LEAST_COVERAGE:",
        "share >= 0.9:",
        ("tests/apps/test_judgement.py",),
    ),
    PlantedFault(
        "a world's own plan is a map of it, in another frame",
        "apps/scene.py",
        "        _refuse_plan_as_map(options.world, options.map_file)\n",
        "        pass\n",
        ("tests/apps/test_start.py",),
    ),
    PlantedFault(
        "people are drawn into each other's ways",
        "sim/generator/rooms.py",
        "taken = (*(piece.place for piece in plan.pieces), *plan.walks)",
        "taken = tuple(piece.place for piece in plan.pieces)",
        ("tests/sim/test_generator.py::test_people_do_not_meet",),
    ),
)
