"""Faults of the velocity gate and of its field, memory and permits."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

NUMBERS = ("tests/safety/test_numbers.py",)
FIELD = ("tests/safety/test_protective_field.py",)
GATE = ("tests/safety/test_gate.py",)
MEMORY = ("tests/safety/test_blind_memory.py",)
POINTS = ("tests/safety/test_gate_points.py",)

SAFETY = (
    PlantedFault(
        "a permit lets the robot approach ten times as fast",
        "safety/approach_permit.py",
        "SPEED = 0.3",
        "SPEED = 3.0",
        NUMBERS,
    ),
    PlantedFault(
        "a permit lasts ten times as long", "safety/approach_permit.py", "LONGEST = 2.0", "LONGEST = 20.0", NUMBERS
    ),
    PlantedFault(
        "a permit ends after ten times the way", "safety/approach_permit.py", "WAY = 0.4", "WAY = 4.0", NUMBERS
    ),
    PlantedFault(
        "a permit may hide ten times the area",
        "safety/approach_permit.py",
        "AREA_MOST = 1.5",
        "AREA_MOST = 15.0",
        NUMBERS,
    ),
    PlantedFault(
        "a permit is given ten times as far away",
        "safety/approach_permit.py",
        "FARTHEST = 2.0",
        "FARTHEST = 20.0",
        NUMBERS,
    ),
    PlantedFault(
        "a permit lets the robot push ten times as deep",
        "safety/approach_permit.py",
        "OVERRUN_MOST = 0.05",
        "OVERRUN_MOST = 0.5",
        NUMBERS,
    ),
    PlantedFault(
        "what no scanner sees any more is forgotten after 10 cm",
        "safety/config.py",
        "memory_travel: float = 12.0",
        "memory_travel: float = 0.1",
        NUMBERS,
    ),
    PlantedFault(
        "scans may be ten times as old",
        "safety/config.py",
        "points_timeout: float = 0.5",
        "points_timeout: float = 5.0",
        NUMBERS,
    ),
    PlantedFault(
        "odometry may be ten times as old",
        "safety/config.py",
        "odometry_timeout: float = 0.3",
        "odometry_timeout: float = 3.0",
        NUMBERS,
    ),
    PlantedFault(
        "a command counts for 3 s",
        "safety/config.py",
        'VelocitySource("navigation", 10, 0.3)',
        'VelocitySource("navigation", 10, 3.0)',
        NUMBERS,
    ),
    PlantedFault(
        "the base is taken to react at once",
        "safety/config.py",
        "reaction_time: float = 0.2",
        "reaction_time: float = 0.0",
        NUMBERS,
    ),
    PlantedFault(
        "motion resumes as soon as the field is clear",
        "safety/config.py",
        "resume_delay: float = 2.0",
        "resume_delay: float = 0.0",
        NUMBERS,
    ),
    PlantedFault(
        "an obstacle needs 20 points",
        "safety/config.py",
        "min_points: int = 2",
        "min_points: int = 20",
        NUMBERS,
    ),
    PlantedFault(
        "the footprint has no margin",
        "safety/field.py",
        "        self._margin = margin\n",
        "        self._margin = 0.0 * margin\n",
        FIELD,
    ),
    PlantedFault(
        "the gate lets speeds pass that the field forbids",
        "safety/gate.py",
        "GateState.ARMED, reason, source)",
        "GateState.ARMED, reason, source) if scale >= 1.0 else self._finish(velocity, GateState.ARMED, reason, source)",
        GATE,
    ),
    PlantedFault(
        "points are not carried along with the robot",
        "safety/gate.py",
        "then = base_from_odom @ odom_from_then",
        "then = odom_from_then.inverse() @ odom_from_then",
        GATE,
    ),
    PlantedFault(
        "speed limits do not keep the arc",
        "safety/limits.py",
        "return BodyVelocity(vx * scale, vy * scale, wz * scale)",
        "return BodyVelocity(vx * scale, vy * scale, wz)",
        GATE,
    ),
    PlantedFault(
        "the base brakes as it accelerates",
        "safety/limits.py",
        "time_to_end = abs(value - end) / braking",
        "time_to_end = abs(value - end) / acceleration",
        GATE,
    ),
    PlantedFault(
        "a velocity that turns is for a moment faster than before and after",
        "safety/limits.py",
        "most = max(math.hypot(current.vx, current.vy), math.hypot(target.vx, target.vy))",
        "most = math.inf",
        GATE,
    ),
    PlantedFault(
        "the last glimpse of a thing tells where it was",
        "safety/blind_memory.py",
        'fullest = np.argsort(-counts, kind="stable")',
        "fullest = np.arange(len(counts))",
        ("tests/safety/test_gate_node.py",),
    ),
    PlantedFault(
        "what is remembered is where its middle was",
        "nodes/gate.py",
        "unseen = pulled_nearer(bridged(unseen, points), UNSEEN_NEARER, *self._edges)",
        "pass",
        ("tests/safety/test_gate_node.py",),
    ),
    PlantedFault(
        "panes of glass end where their light ends",
        "nodes/gate.py",
        "for peak in self._panes.detect(scan):",
        "for peak in ():",
        ("tests/safety/test_ranges.py",),
    ),
    PlantedFault(
        "panes of glass go on through their posts",
        "perception/glass.py",
        "np.min(along[is_on_line & (along > peak.left + step)], initial=reach)",
        "reach",
        ("tests/perception/test_glass.py",),
    ),
    PlantedFault(
        "the gate remembers points with gaps between them",
        "nodes/gate.py",
        "pulled_nearer(bridged(unseen, points), ",
        "pulled_nearer(unseen, ",
        ("tests/safety/test_gate_node.py",),
    ),
    PlantedFault(
        "bridges lead over what stands between",
        "kernels/blind.py",
        "or _is_between(points, near[:found], i, j)",
        "or False",
        ("tests/safety/test_gate_node.py",),
    ),
    PlantedFault(
        "turning on the spot is no travel to the memory of blind zones",
        "safety/blind_memory.py",
        "last.distance_to(odom_from_base) + turn * self._radius",
        "last.distance_to(odom_from_base)",
        MEMORY + NUMBERS,
    ),
    PlantedFault(
        "the noise of a surface stands before it",
        "kernels/gate_points.py",
        "if held == 1 and _has_surface_behind(counts, sector, step, behind):",
        "if False:",
        POINTS,
    ),
    PlantedFault(
        "straight behind a scanner its directions end",
        "kernels/gate_points.py",
        "counts[(sector + beside) % sectors]",
        "counts[min(max(sector + beside, 0), sectors - 1)]",
        POINTS,
    ),
    PlantedFault(
        "the gate takes every point for one of the scan's begin",
        "kernels/gate_points.py",
        "angle = twist[2] * t",
        "angle = 0.0 * t",
        POINTS,
    ),
    PlantedFault(
        "what the blind zone cuts off is remembered as it was measured",
        "kernels/blind.py",
        "counts[column] >= most and nearest[column] >= least",
        "counts[column] >= most",
        ("tests/safety/test_blind_kernels.py",),
    ),
    PlantedFault(
        "a blind scanner clears what it cannot see",
        "safety/blind_memory.py",
        "sure = field.shrunk(*SLACK)",
        "sure = replace(field, range_min=0.0)",
        MEMORY,
    ),
    PlantedFault(
        "who once touched a robot holds it for ever",
        "safety/blind_memory.py",
        "is_kept &= ~(self._came & (seconds - near_at > GONE))",
        "pass",
        MEMORY,
    ),
    PlantedFault(
        "a robot with a blind side forgets who stands there",
        "safety/blind_memory.py",
        "return bool(is_seen.all())",
        "return True",
        MEMORY,
    ),
    PlantedFault(
        "what a robot drove up to counts as a visitor",
        "kernels/looks.py",
        "elif said == STOOD:\n            out[i] = WAS_THERE",
        "elif said == STOOD:\n            pass",
        MEMORY,
    ),
    PlantedFault(
        "something beside the sector that was seen there before counts as a visitor",
        "kernels/looks.py",
        "stood = stood or dx * dx + dy * dy < beside * beside",
        "stood = False",
        MEMORY,
    ),
    PlantedFault(
        "drifting odometry makes a visitor of a post",
        "kernels/looks.py",
        "max(half_bin, math.atan2(behind, r))",
        "half_bin",
        MEMORY,
    ),
    PlantedFault(
        "who comes to a robot is never told from what it drove up to",
        "safety/visitors.py",
        "if seconds - look.seconds >= AGE and travel - look.travel <= DRIVEN:",
        "if False:",
        MEMORY,
    ),
    PlantedFault(
        "a scanner that repeats itself is never stuck",
        "safety/stuck_scan.py",
        "has_moved = self._odom_from_base.distance_to(odom_from_base) > self._travel",
        "has_moved = False",
        NUMBERS,
    ),
)
