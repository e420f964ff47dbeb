"""The map as it is composed step by step is the one that is composed at once."""

import numpy as np

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.grids.probability import log_odds_table
from ambler.grids.probability_grid import InsertionConfig
from ambler.slam2d.config import RenderConfig
from ambler.slam2d.renderer import MapRenderer, PlacedSubmap
from ambler.slam2d.submaps import ActiveSubmaps, Submap
from tests.registration.room import scan_at
from tests.slam2d.drives import oval

CONFIG = RenderConfig()


def at_once(placed: list[PlacedSubmap]) -> tuple[GridSpec, np.ndarray]:
    return MapRenderer(CONFIG).render(placed)


def test_whatever_comes_ends_and_moves_the_map_is_as_if_composed_anew() -> None:
    """Submaps that take scans change at every step, finished ones are added, and now and then some move, as closures move them."""
    rng = np.random.default_rng(4)
    renderer, active = MapRenderer(CONFIG), ActiveSubmaps(InsertionConfig(), 6)
    submaps: dict[int, Submap] = {}
    moved: dict[int, SE2] = {}
    sizes = set()
    for k, pose in enumerate(oval(0.3)):
        for submap in active.insert(scan_at(pose), pose)[0]:
            submaps[submap.index] = submap
        if k % 9 == 8:
            for index in rng.choice(len(submaps), 2):
                moved[int(index)] = SE2(*rng.normal(0.0, 0.3, 2), rng.normal(0.0, 0.1))
        placed = [PlacedSubmap(s, moved.get(i, SE2()) @ s.local_from_submap) for i, s in submaps.items()]
        spec, occupancy = renderer.render(placed)
        wanted, fresh = at_once(placed)
        assert spec == wanted
        np.testing.assert_array_equal(occupancy, fresh)
        sizes.add(occupancy.shape)
    assert len(sizes) > 2
    assert sum(s.is_finished for s in submaps.values()) > 5


def test_the_map_is_what_the_sum_of_its_submaps_says() -> None:
    """A slow twin: submaps that lie on the map's own cells add their log odds; a free cell beside an occupied one counts less."""
    active, submaps = ActiveSubmaps(InsertionConfig(), 6), {}
    for pose in oval(0.3)[:20]:
        for submap in active.insert(scan_at(pose), pose)[0]:
            submaps[submap.index] = submap
    placed = [PlacedSubmap(s, s.local_from_submap) for s in submaps.values()]
    spec, occupancy = at_once(placed)
    evidence, known = np.zeros(spec.shape), np.zeros(spec.shape, bool)
    table = log_odds_table()
    for p in placed:
        cells = p.submap.grid.cells
        odds = np.where(cells > 0, table[cells].astype(float), 0.0)
        solid = np.pad(odds > 0, 1)
        beside = solid[:-2, 1:-1] | solid[2:, 1:-1] | solid[1:-1, :-2] | solid[1:-1, 2:]
        odds = np.where(beside & (odds < 0), CONFIG.beside_occupied * odds, odds)
        corner = p.submap.spec
        iy, ix = spec.cell_of(
            corner.origin_x + p.map_from_submap.x + 0.02, corner.origin_y + p.map_from_submap.y + 0.02
        )
        rows, columns = np.nonzero(cells)
        np.add.at(evidence, (rows + iy, columns + ix), odds[rows, columns])
        known[rows + iy, columns + ix] = True
    wanted = np.where(~known, -1, np.where(evidence > 0, 100, np.where(evidence < 0, 0, -1)))
    assert np.mean(wanted != occupancy) < 1e-4
    assert np.count_nonzero(occupancy == 100) > 200
