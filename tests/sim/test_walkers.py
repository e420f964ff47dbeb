"""The forces of people against a slow twin, written from their rules one by one."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.kernels.walkers import striving_forces

STIFFNESS, PACE, PUSH, LEAN_SPEED, DT = 20.0, 6.0, 100.0, 0.15, 0.005


@given(st.integers(0, 10_000))
@settings(max_examples=100, deadline=None)
def test_forces_are_those_of_a_spring_with_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, since = int(rng.integers(1, 6)), 0.02
    places, dofs = rng.permutation(3 * n)[: 2 * n], rng.permutation(3 * n)[: 2 * n]
    qpos, qvel = rng.normal(0.0, 2.0, 3 * n), rng.normal(0.0, 0.3, 3 * n)
    origin, wish, rate = (rng.normal(0.0, 2.0, (n, 2)) for _ in range(3))
    mass, gentle = rng.uniform(50.0, 100.0, n), rng.choice([0.0, 0.003, 0.4], n)
    before, forces = gentle.copy(), np.full(3 * n, 7.0)
    plan = np.array([since, DT, STIFFNESS, PACE, PUSH, LEAN_SPEED])
    striving_forces(qpos, qvel, places, dofs, origin, wish, rate, mass, gentle, plan, forces)
    untouched = np.setdiff1d(np.arange(3 * n), dofs)
    assert (forces[untouched] == 7.0).all(), "nothing but people is pushed"
    for k in range(n):
        here, speed = origin[k] + qpos[places[2 * k : 2 * k + 2]], qvel[dofs[2 * k : 2 * k + 2]]
        pull = STIFFNESS**2 * (wish[k] + since * rate[k] - here) + 2.0 * STIFFNESS * (rate[k] - speed)
        most = PACE
        if before[k] > 0.0 and np.hypot(*speed) > LEAN_SPEED:
            pull = -2.0 * STIFFNESS * speed
        elif before[k] > 0.0:
            most = min(PACE, PUSH / mass[k])
        pull *= min(1.0, most / np.hypot(*pull))
        assert np.allclose(forces[dofs[2 * k : 2 * k + 2]], mass[k] * pull, rtol=1e-9)
        assert np.isclose(gentle[k], max(0.0, before[k] - DT))
