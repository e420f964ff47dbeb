"""Faults of the visibility graph and of drives over several levels: sight, votes, levels, passages, unknown ground, files."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

GRAPH = ("tests/planning/test_visibility_graph.py",)
CONFORMANCE = ("tests/planning/test_conformance.py",)
PLANNER = ("tests/planning/test_planner_node.py",)
LEVELS = ("tests/missions/test_navigate_levels.py",)
WALLS = ("tests/planning/test_wall_ends.py",)
FILES = ("tests/wire/test_graph_files.py",)

GRAPHS = (
    PlantedFault(
        "edges that obstacles block stay in use",
        "planning/visibility_graph.py",
        "changes.dirty, TILE, self.config.least",
        "changes.freed, TILE, self.config.least",
        GRAPH,
    ),
    PlantedFault(
        "nodes that a freed place lets see each other stay strangers",
        "planning/visibility_graph.py",
        "        if not freed.any():\n            return\n",
        "        if True:\n            return\n",
        GRAPH,
    ),
    PlantedFault(
        "the clearance is measured only where obstacles changed",
        "planning/clearance_map.py",
        "self._measure(*grown(changed, CAP, spec))",
        "self._measure(*grown(changed, 1, spec))",
        GRAPH,
    ),
    PlantedFault(
        "all levels share one graph",
        "planning/visibility_planner.py",
        "self._level, self._goal = level, None",
        "self._goal = None",
        GRAPH,
    ),
    PlantedFault(
        "a way goes on from one level to another",
        "planning/visibility_graph.py",
        "before[0] != floor or ",
        "",
        GRAPH,
    ),
    PlantedFault(
        "a robot that was put elsewhere has driven there",
        "planning/visibility_graph.py",
        " or math.hypot(x - before[1], y - before[2]) > LEAP",
        "",
        GRAPH,
    ),
    PlantedFault(
        "a saved graph forgets what is still to be done",
        "planning/graph_state.py",
        'graph.waiting = arrays["waiting"].tolist()',
        "graph.waiting = []",
        GRAPH,
    ),
    PlantedFault(
        "a loaded graph keeps prices that nobody asks any more",
        "planning/graph_state.py",
        "if not is_alike:",
        "if False:",
        GRAPH,
    ),
    PlantedFault(
        "a planner plans on the costs of the level before",
        "nodes/planner.py",
        "if self._levels is not None and self._levels.active != self._level:",
        "if False:",
        PLANNER,
    ),
    PlantedFault(
        "what stood on one level stands on the other",
        "nodes/planner.py",
        "        self._level = self._levels.active\n        self._costmap.clear()\n",
        "        self._level = self._levels.active\n",
        PLANNER,
    ),
    PlantedFault(
        "a goal on another level is driven to on this one",
        "missions/navigate.py",
        "if level is None or level == active:",
        "if True:",
        LEVELS,
    ),
    PlantedFault(
        "the next level is asked for wherever the robot is",
        "missions/navigate.py",
        "distance <= self._config.level_near",
        "distance <= 1e9",
        LEVELS,
    ),
    PlantedFault(
        "a passage is tried for ever",
        "missions/level_route.py",
        "self._tried[hop.key] += 1",
        "self._tried[hop.key] += 0",
        LEVELS,
    ),
    PlantedFault(
        "what lies behind a passage does not matter",
        "missions/level_route.py",
        "if here == level and metres + place.distance_to(goal) < shortest:",
        "if metres + place.distance_to(goal) < shortest:",
        LEVELS,
    ),
    PlantedFault(
        "the goal is given up while unknown ground is left",
        "planning/visibility_planner.py",
        "        if dark and is_goal_free:",
        "        if False:",
        GRAPH,
    ),
    PlantedFault(
        "the way changes with every step",
        "planning/visibility_planner.py",
        "if kept is not None and found[1] > kept[1] * (1.0 - self.config.hysteresis):",
        "if False:",
        GRAPH,
    ),
    PlantedFault(
        "behind a cupboard is as good as open ground",
        "planning/clearance_map.py",
        "self._filled[y0:y1, x0:x1] = opened[rows, columns] == 0",
        "self._filled[y0:y1, x0:x1] = 0",
        GRAPH,
    ),
    PlantedFault(
        "walls go on through doors that were seen",
        "kernels/wall_ends.py",
        "if cost < blocked or (cost == lethal and t > MARGIN):",
        "if cost == lethal and t > MARGIN:",
        WALLS,
    ),
    PlantedFault(
        "walls go on backwards",
        "kernels/wall_ends.py",
        "    if along > 0.0:\n",
        "    if along < 0.0:\n",
        WALLS,
    ),
    PlantedFault(
        "edges keep the price that they had before a wall was supposed there",
        "planning/clearance_map.py",
        "other |= (self.hidden[part] != hidden) & (cells == UNKNOWN)",
        "pass",
        WALLS,
    ),
    PlantedFault(
        "unknown cells are entered without leave",
        "planning/visibility_planner.py",
        "table[COST_UNKNOWN] = UNKNOWN if is_unknown_allowed else FORBIDDEN",
        "table[COST_UNKNOWN] = UNKNOWN",
        CONFORMANCE,
    ),
    PlantedFault(
        "a narrow way counts as none",
        "planning/visibility_planner.py",
        "        if found is None:\n            found = self._cell_by_cell(spec, begin, end)\n",
        "",
        CONFORMANCE,
    ),
    PlantedFault(
        "a damaged graph is believed",
        "wire/graph_files.py",
        "if hashlib.sha256(content).digest() != raw[len(MAGIC) : len(MAGIC) + 32]:",
        "if False:",
        FILES,
    ),
)
