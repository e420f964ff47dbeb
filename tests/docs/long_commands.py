"""The commands of the documents that take minutes to hours, or files that only their reader has: with what they are shortened, and what they say and leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.docs import own_files

NOBODY = "--exit --no-view"
CUT = r"time_limit: the time limit of \d+ s is over"
MAPPED = CUT + r".*map: runs/\S+/map\.yaml.*report: runs/\S+/report\.html"
DRIVEN = r"ended +│ time_limit.*path_length_m +│ \d+\.\d+ +│.*collisions +│ 0 .*map it: ambler lio runs/\S+/recording --truth runs/\S+/truth\.tum --out DIR"
LEFT = ("runs/LATEST/map.yaml", "runs/LATEST/map.pgm", "runs/LATEST/map.cloud.pcd", "runs/LATEST/report.html")
CLOUD = ("my_map/trajectory.tum", "my_map/cloud.pcd", "my_map/cloud.ply", "my_map/top.png", "my_map/report.html")


@dataclass(frozen=True)
class Long:
    """`more` words shorten a command, whose output fits the pattern `says`; it `writes` files that are not empty, and ends with `code` (None: 0 or 1, where the
    speed of the machine or drawn seeds decide about a bar). It runs in the folder of the command that it comes `after`, else in one of its own; `given` files are there."""

    more: str
    says: str
    writes: tuple[str, ...] = ()
    code: int | None = 0
    after: str = ""
    given: tuple[Callable[[Path], None], ...] = ()


GRAPH = "demo --world office-17 --set global_planner=visibility_graph"
TUNE = "tune space.yaml --out studies/paths --processes 2"
FIVE = "eval exploration --worlds lab_empty --robots diff --runs 5 --json summary.json"
FAULTS = "eval faults --json faults.json"
CAMPUS = "demo --robot go2 --world campus --drive built-in"
CAMPUS_CLOUD = "lio runs/LATEST/recording --truth runs/LATEST/truth.tum --out my_map"

FILES = {
    "slam2d my_bag --out my_map --scan-topic /front/scan": Long(
        "",
        r"170 scans, 17 s of data .* (99|100)\.\d % of the returns on walls",
        ("my_map/map.pgm", "my_map/map.yaml", "my_map/map.png", "my_map/trajectory.tum", "my_map/report.html"),
        given=(own_files.planar_bag,),
    ),
    "lio my_walk --out my_map": Long("", r"229 of 238 scans, 23 s and 25\.\d m in", CLOUD, given=(own_files.walk,)),
    "lio my_walk --out my_map --truth truth.tum --json walk.json": Long(
        "", r"against the reference: 0\.00\d m RMS from the start", CLOUD, given=(own_files.walk,)
    ),
    "lio my_clouds --no-imu --out my_map": Long(
        "", r"inertial measurements: none.*60 of 60 scans, 6 s and 4\.\d m in", CLOUD, given=(own_files.walk,)
    ),
    "lio my_walk --map my_map/cloud.pcd --out my_place": Long(
        "",
        r"found after \d\.\d s of the recording .* 1[5-9]\d of 238 scans have a pose in the map",
        ("my_place/trajectory.tum", "my_place/top.png", "my_place/report.html"),
        given=(own_files.walk, own_files.map_of_the_walk),
    ),
    "lio my_walk --map my_map/cloud.pcd --guess 1.5,-2,0,90 --out my_place": Long(
        "",
        r"found after 0\.\d s of the recording .* 2[12]\d of 238 scans have a pose in the map",
        ("my_place/trajectory.tum", "my_place/top.png", "my_place/report.html"),
        given=(own_files.walk, own_files.map_of_the_walk),
    ),
    "lio my_walk --grid --out my_map": Long(
        "", r"229 of 238 scans", (*CLOUD, "my_map/map.pgm", "my_map/map.yaml"), given=(own_files.walk,)
    ),
    "calibrate camera 'board_*.png' --board 7x5 --square 0.04 --out camera.yaml": Long(
        "", r"f 55[345]\.\d\d x 55[345]\.\d\d ± 0\.\d.* of 20 pictures", ("camera.yaml",), given=(own_files.board,)
    ),
    "calibrate RECORDING --robot amr_omni --out robot.yaml": Long(
        "",
        r"front_right: x 0\.60\d\d .*front_left: x 0\.60\d\d .*rear_left: x -0\.6[12]\d\d ",
        ("robot.yaml",),
        given=(own_files.drive_of_three_scanners,),
    ),
    "calibrate --simulated --robot amr_omni --out check.yaml": Long(
        "--seconds 40", r"against the truth: [0-4]\.\d\d mm, 0\.0\d\d°, [01]\.\d\d ms at worst", ("check.yaml",)
    ),
    "calibrate range near.png@0.50 far.png@2.00 mid.png@1.00 more.png@1.50 last.png@1.75 --camera camera.yaml "
    "--marker 4X4_50:3:0.15 --out robot.yaml": Long(
        "",
        r"edges are 0\.[23]\d+ ± .*\n0\.\d mm before the optical centre",
        ("robot.yaml",),
        given=(own_files.marker, own_files.camera),
    ),
    "calibrate reflectors --survey RECORDING --robot diff --out robot.yaml": Long(
        "",
        r"reflector at 2\.00\d, -2\.50\d m .*reflector at 3\.00\d, 1\.00\d m .*reflector at -3\.00\d, 2\.00\d m",
        ("robot.yaml",),
        given=(own_files.drive_past_reflectors,),
    ),
    "dock charger_1 --camera camera.yaml": Long(
        NOBODY, r"ended +│ succeeded .*collisions +│ 0 ", ("runs/LATEST/report.html",), given=(own_files.camera,)
    ),
}
"""The commands on files of the reader's own."""

RUNS = {
    "dock charger_1 --teach --docks docks.yaml": Long(
        NOBODY, r"ended +│ succeeded .*collisions +│ 0 ", ("docks.yaml",)
    ),
    "demo --world lab_empty --apart": Long(
        NOBODY,
        r"ended +│ finished .*collisions +│ 0 .*real_time_factor +│ (1|0\.9\d*|1\.0\d*) ",
        ("runs/LATEST/map.yaml",),
    ),
    GRAPH: Long(f"{NOBODY} --time-limit 60", MAPPED, ("runs/LATEST/map.yaml", "runs/LATEST/map.vgraph"), code=1),
    "navigate --world office-17 --planner visibility_graph --map runs/LATEST/map.yaml -- -5.6,9.4": Long(
        NOBODY,
        r"ended +│ (succeeded|nearest_reached) .*collisions +│ 0 ",
        ("runs/LATEST/known_map.vgraph",),
        code=None,
        after=GRAPH,
    ),
    CAMPUS: Long(f"{NOBODY} --time-limit 14", DRIVEN, ("runs/LATEST/truth.tum",), code=1),
    CAMPUS_CLOUD: Long("", r"against the reference: 0\.0[0-4]\d m RMS from the start", CLOUD, after=CAMPUS),
    "demo --robot go2 --world campus --drive route.yaml --map my_map/cloud.pcd": Long(
        f"{NOBODY} --time-limit 60",
        r"ended +│ succeeded .*collisions +│ 0 .*place +│ tracking .*place_rms_m +│ 0\.0",
        ("runs/LATEST/truth.tum",),
        after=CAMPUS_CLOUD,
        given=(own_files.route,),
    ),
    "demo --robot mecanum --world campus --drive built-in": Long(
        f"{NOBODY} --time-limit 6", DRIVEN, ("runs/LATEST/truth.tum",), code=1
    ),
    "demo --robot mecanum --world garage --drive built-in --speed 1.0 --seed 3": Long(
        f"{NOBODY} --time-limit 6", DRIVEN, ("runs/LATEST/truth.tum",), code=1
    ),
    "demo --robot mecanum --world plot-17": Long(f"{NOBODY} --time-limit 6", MAPPED, LEFT, code=1),
    "demo --robot go2 --world plot-17": Long(f"{NOBODY} --time-limit 6", MAPPED, LEFT, code=1),
    "demo --robot go2 --world plot-1 --stations 8": Long(f"{NOBODY} --time-limit 12", MAPPED, LEFT, code=1),
    "demo --robot go2 --world garage": Long(f"{NOBODY} --time-limit 6", MAPPED, LEFT, code=1),
    "demo --robot go2 --world garage --then 20,0@1 --then 14,0@0": Long(
        f"{NOBODY} --time-limit 6", MAPPED, LEFT, code=1
    ),
}
"""Runs of robots: those of half a minute as they stand, the others ended early."""

STUDIES = {
    "bench terrain --runs 200 --json terrain.json": Long("--runs 10", r"near_update_ms +\d+\.\d+", code=None),
    "bench far --json docs/results/bench_far.json": Long("--runs 10", r"paths_found +10\n", code=None),
    "bench odometry": Long("--seconds 12", r"robot_seconds +7\n.*ended +time_limit", code=None),
    "bench memory walk": Long("--length 300", r"growth_mb +-?\d.*keyframes +\d\d"),
    "bench lio": Long("--runs 10", r"20k_hz +\d.*65k_hz +\d", code=None),
    "bench live --robot go2 --world plot-1 --seconds 60 --json live.json": Long(
        "--seconds 8", r"none\n +command_seconds +[6-8]\.\d\n.*ended +time_limit"
    ),
    "bench door --json docs/results/bench_door.json": Long(
        "--requests 40 --world lab_empty",
        r"lockstep: calls 32, goals 8, answered 40, .*is_replay_equal True\n.*live: calls 32, goals 8, answered 40, ",
    ),
    "bench exploration": Long(
        "--no-plans --worlds lab_empty", r"lab_empty: tour \d+/\d+/\d+ m 100\.0%, nearest .* greedy .*places +1\n"
    ),
    TUNE: Long(
        "--processes 1",
        r"best: trial \d, [\d.]+ against 2\.2000 of the defaults",
        (
            "studies/paths/best.yaml",
            "studies/paths/ranking.jsonl",
            "studies/paths/report.html",
            "studies/paths/effects.png",
        ),
        given=(own_files.space,),
    ),
    "demo --profile studies/paths/best.yaml": Long(f"{NOBODY} --time-limit 2", MAPPED, code=1, after=TUNE),
    FIVE: Long("--runs 1", r"lab_empty-diff-tour-0: finished, 0 collisions"),
    "eval exploration --worlds lab_empty --robots diff --runs 9": Long(
        "--runs 2", r"1 of 2 results are in runs/exploration already", after=FIVE
    ),
    "eval exploration --worlds office --seed draw --runs 3": Long(
        "--robots diff --time-limit 2", r"\[3 of 3\] .*: time_limit, 0 collisions", code=1
    ),
    "eval exploration --worlds office --processes 4": Long(
        "--processes 1 --runs 1 --time-limit 2", r"\[2 of 2\] .*: time_limit, 0 collisions", code=1
    ),
    "eval exploration --worlds lab_empty --runs 40 --cluster tcp://127.0.0.1:8786": Long(
        "--runs 1 --robots diff --time-limit 2", r"\[1 of 1\] .*: time_limit, 0 collisions", code=1
    ),
    "eval crowd --runs 30 --people 10 --seed draw --json crowd.json": Long(
        "--runs 2 --time-limit 4",
        r"\[2 of 2\] office-(diff|amr_omni)-\S+: time_limit, 0 collisions of 0 contacts, 0 shoved into, 4 s",
        code=1,
    ),
    "eval crowd --worlds office --robots diff --runs 2 --people 4 --stubborn 4": Long(
        "--time-limit 4",
        r"\[2 of 2\] office-(diff|amr_omni)-\S+: time_limit, 0 collisions of 0 contacts, 0 shoved into, 4 s",
        code=1,
    ),
    "eval crowd --worlds 'office-*' 'ward-*' --seed draw": Long(
        "--runs 1 --time-limit 4",
        r"\[1 of 1\] office-\d+-diff-\S+: time_limit, 0 collisions of 0 contacts, 0 shoved into, 4 s",
        code=1,
    ),
    "eval glass --json glass.json": Long(
        "--runs 1 --robots diff --time-limit 5",
        r"ring-0: time_limit, 0 collisions.*light-0: time_limit.*found_ratio_worst ",
        code=1,
    ),
    "eval overhangs --seed draw --runs 10 --json docs/results/overhangs.json": Long(
        "--runs 1 --physics kinematic",
        r"auto-kinematic-\d+: [34] of 4 goals, 0 collisions.*with_voxels.runs +1\n.*without.runs +1\n",
        code=None,
    ),
    "eval unknown --runs 20 --seed draw --json docs/results/unknown.json": Long(
        "--runs 1 --kinds flat",
        r"visibility_graph-any: succeeded, .*grid-any: succeeded, .*ratio_vs_grid +│ [01]\.\d",
        code=None,
    ),
    "eval ground --seed draw --runs 10 --json ground.json": Long(
        "--runs 1",
        r"\[10 of 10\] go2-slope-\d+: slope of 15 degrees: .*mecanum\.flat_points +[1-9]\d{3}\n.*crashed +0\n",
        code=None,
    ),
    "eval lio --kinds dust,smoke,rain --lidars mid_360 --seed draw": Long(
        "--runs 1 --kinds dust --length 30", r"dust-\d+-mid_360: 3\d m: 0\.0\d+ m RMS", code=None
    ),
    "eval docking --imperfections exact --runs 60 --fault-runs 20 --json docs/results/docking.json": Long(
        "--runs 1 --fault-runs 1 --looks 2 --only sights --only random --only faults --fault light",
        r"charger_1-random-\d+: .*charger_1-light-\d+: .*\| final error, 95 % \| ± 10 mm \| \d+\.\d\d mm",
        code=None,
    ),
    "eval docking --world dock_room --only random --runs 100 --seed draw --json docs/results/docking_drawn.json": Long(
        "--runs 1", r"charger_1-random-\d+: .*charger_1-taught-\d+: .*\| final error, 95 % \| ± 10 mm \| \d", code=None
    ),
    "eval docking --world dock_shapes --dock charger_v": Long(
        "--runs 1 --looks 2",
        r"charger_v-random-0: SUCCEEDED in 1 .*charger_v-taught-0: SUCCEEDED in 1 .*\| final error, worst \| not told \| \d\.\d\d mm",
    ),
    FAULTS: Long("--only scanner_dead --robots diff", r"scanner_dead.*passed"),
    "eval faults --runs 2": Long(
        "--only scanner_dead --robots diff", r"1 of 2 results are in runs/faults already.*passed", after=FAULTS
    ),
    "eval faults --only people,glass --runs 5": Long(
        "--runs 1 --robots diff",
        r"people-diff-0: \w+, 0 collisions.*glass-diff\+ultrasonic-0: \w+, 0 collisions",
        code=None,
    ),
    "eval sites --seed draw --runs 4 --json sites.json": Long(
        "--runs 1 --kinds plot --robots go2 --time-limit 3",
        r"plot-\d+-go2: time_limit, 0 collisions.*plot\.go2\.runs +1\n.*surface_coverage_ratio_median +0\.(0[1-9]|[1-9])",
        code=1,
    ),
    "eval return --kinds plot --robots go2 --seed draw --runs 10 --json return.json": Long(
        "--runs 1 --way-points 1 --time-limit 6 --return-time-limit 6",
        r"plot-\d+-go2: explored: time_limit; .* of 1 way-points; 0 collisions",
        code=1,
    ),
}
"""Measurements and studies, with few cases and short runs."""

LONG = FILES | RUNS | STUDIES
