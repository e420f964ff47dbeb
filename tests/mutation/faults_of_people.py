"""Faults of giving way to people: whom, where to, and for how long."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

GIVING_WAY = ("tests/missions/test_giving_way.py",)
MOVERS = ("tests/perception/test_mover_tracker.py",)
REFUGE = ("tests/planning/test_refuge.py",)
PURSUIT = ("tests/control/test_omni_pursuit.py",)

PEOPLE = (
    PlantedFault(
        "who has walked into a robot leans on it with all his weight",
        "kernels/walkers.py",
        "most = min(pace, push / mass[n])",
        "most = min(pace, 10.0 * push / mass[n])",
        ("tests/sim/test_walkers.py",),
    ),
    PlantedFault(
        "a bar that rays meet now and then moves",
        "kernels/movers.py",
        "if states[k] == FREE and misses[k] < GONE and",
        "if False and misses[k] < GONE and",
        MOVERS,
    ),
    PlantedFault(
        "who stops takes the points of who stands beside him",
        "perception/mover_tracker.py",
        "range(SETTLING)",
        "range(1)",
        MOVERS,
    ),
    PlantedFault(
        "who stops settles among what stood there before him",
        "perception/mover_tracker.py",
        "is_nearest & came.is_new & (to",
        "is_nearest & (to",
        MOVERS,
    ),
    PlantedFault(
        "who stops is measured with what stood there before him",
        "perception/mover_tracker.py",
        "his = is_new if np.count_nonzero(is_new) >= c.min_points else near",
        "his = near",
        MOVERS,
    ),
    PlantedFault(
        "who stands and is thought to move follows the edge that moved last",
        "perception/mover_tracker.py",
        "2 * np.count_nonzero(his & came.is_old) <= np.count_nonzero(his)",
        "2 * np.count_nonzero(his & came.is_old) <= np.count_nonzero(his) or math.hypot(*track.velocity) >= c.speed_min",
        MOVERS,
    ),
    PlantedFault(
        "a silence that flickers keeps somebody for ever",
        "perception/mover_tracker.py",
        "if t.is_mover and now - t.measured <= self._config.hides]",
        "if t.is_mover]",
        ("tests/perception/test_silent_sectors.py",),
    ),
    PlantedFault(
        "who comes into sight again where he hid is a stranger",
        "perception/mover_tracker.py",
        "            self._note_hidden(place, now)\n",
        "            pass\n",
        ("tests/perception/test_silent_sectors.py",),
    ),
    PlantedFault(
        "who walks behind the robot holds it up",
        "missions/giving_way.py",
        "is_before &= (places - here) @ towards > 0.0",
        "is_before &= np.isfinite(towards).all()",
        GIVING_WAY,
    ),
    PlantedFault(
        "whoever is near holds the robot up at once",
        "missions/giving_way.py",
        "return not gets_on and self",
        "return self",
        GIVING_WAY,
    ),
    PlantedFault(
        "the time between two drives counts as being held up",
        "missions/giving_way.py",
        "[(t + gap_ns, x, y) for",
        "[(t, x, y) for",
        GIVING_WAY,
    ),
    PlantedFault(
        "between two drives the robot forgets who held it up",
        "missions/giving_way.py",
        "trail = [] if is_over else",
        "trail = [] if gap_ns > 0 else",
        GIVING_WAY,
    ),
    PlantedFault(
        "somebody's way is the line to the robot, wherever he walked",
        "missions/giving_way.py",
        "if him.along is None else him.along",
        "if True else him.along",
        GIVING_WAY,
    ),
    PlantedFault(
        "who has turned round is past",
        "missions/giving_way.py",
        "walk.lengthwise(him.place[None])[0] > self._ahead + c.past",
        "walk.lengthwise(him.place[None])[0] != self._ahead",
        GIVING_WAY,
    ),
    PlantedFault(
        "the robot stands aside as long as somebody is there",
        "missions/giving_way.py",
        "is_past or now_ns > self._until_ns or",
        "is_past or",
        GIVING_WAY,
    ),
    PlantedFault(
        "each time it waits as long as the first time",
        "missions/giving_way.py",
        "gone = c.gone * 2.0 ** (self._times - 1)",
        "gone = c.gone",
        GIVING_WAY,
    ),
    PlantedFault(
        "the robot stands aside all day",
        "missions/giving_way.py",
        "rate = -1.0 if self._is_spending else self._share",
        "rate = self._share",
        GIVING_WAY,
    ),
    PlantedFault(
        "what fails on the way aside ends it",
        "missions/navigate.py",
        "self._refuge = refuge  # he,",
        "self._go_on()  # he,",
        GIVING_WAY,
    ),
    PlantedFault(
        "a place to stand aside is looked for again and again where there is none",
        "missions/navigate.py",
        "self._asides = self._config.giving_way.tries  # until",
        "self._asides += 0  # until",
        GIVING_WAY,
    ),
    PlantedFault(
        "a robot gets aside through the person",
        "planning/refuge.py",
        "closed[np.hypot(x[None, :], y[:, None]) < c.person + robot.inscribed_radius] = COST_LETHAL",
        "closed[:0] = COST_LETHAL",
        REFUGE,
    ),
    PlantedFault(
        "a robot stands aside where people walk",
        "planning/refuge.py",
        "is_far = away >= robot.inscribed_radius + c.least",
        "is_far = away >= 0.0",
        REFUGE,
    ),
    PlantedFault(
        "a robot stands aside across somebody's way",
        "planning/refuge.py",
        "is_aside = (room >= c.least) & np.isfinite(cost)",
        "is_aside = np.isfinite(cost)",
        REFUGE,
    ),
    PlantedFault(
        "a robot stands aside in the wall",
        "planning/refuge.py",
        "if lethal_cells_inside(sums,",
        "if -lethal_cells_inside(sums,",
        REFUGE,
    ),
    PlantedFault(
        "a base that moves in all directions stays in a niche that it cannot turn in",
        "control/omni_pursuit.py",
        "if not self._is_omni or lim.vx_min >= 0.0:",
        "if True:",
        PURSUIT,
    ),
)
