"""Faults of the visibility graph: sight, votes, floors, unknown ground, files."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

GRAPH = ("tests/planning/test_visibility_graph.py",)
CONFORMANCE = ("tests/planning/test_conformance.py",)
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
        "whoever passed stays on the map",
        "planning/terrain_floors.py",
        "np.where(is_passed, -1, 0)",
        "np.where(is_passed, 0, 0)",
        GRAPH,
    ),
    PlantedFault(
        "one look through a wall opens it",
        "planning/terrain_floors.py",
        "np.where(is_passed, -1, 0)",
        "np.where(is_passed, -9, 0)",
        GRAPH,
    ),
    PlantedFault(
        "all floors are one",
        "planning/terrain_floors.py",
        "if away and min(away) <= 0.5 * self.config.floor_height:",
        "if away:",
        GRAPH,
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
