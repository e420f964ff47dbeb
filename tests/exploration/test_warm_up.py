"""No kernel compiles while the explorer looks: the warm-up knows every type that reaches it."""

import numpy as np

from ambler.core.grid import GridSpec
from ambler.core.messages import CostGrid, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.exploration.strategies import strategy_named
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.kernels import frontier, frontier_value, graph_search, tour
from ambler.planning.distance import distance_field


def signatures() -> dict[str, int]:
    return {
        name: len(kernel.signatures)
        for module in (frontier, frontier_value, graph_search, tour)
        for name, kernel in vars(module).items()
        if hasattr(kernel, "signatures")
    }


def test_two_looks_and_a_choice_compile_nothing() -> None:
    frontier.warm_up()
    frontier_value.warm_up()
    graph_search.warm_up()
    tour.warm_up()
    before = signatures()
    spec = GridSpec(0.05, 120, 100, 0.0, 0.0)
    occupancy = np.full(spec.shape, -1, np.int8)
    occupancy[20:80, 20:100] = 0
    occupancy[20:80, 60] = 100
    occupancy[45:55, 60] = 0
    survey = FrontierSurvey(SurveyConfig(), distance_field)
    strategy = strategy_named("tour", distance_field)
    for k in range(2):
        grown = occupancy.copy()
        grown[30:60, 15 - k : 20] = 0
        costs = np.where(grown < 0, 255, np.where(grown > 50, 254, 0)).astype(np.uint8)
        looked = survey.update(OccupancyGrid(0, "map", spec, grown), CostGrid(0, "map", spec, costs), SE2(2.0, 2.5))
        assert looked.open
        strategy.costs(looked, SE2(2.0, 2.5))
    assert signatures() == before
