"""The forces with which people strive to where they want to be (`sim.pushing`)."""

import math

import numpy as np

from ambler.kernels.jit import jit


@jit
def striving_forces(qpos, qvel, places, dofs, origin, wish, rate, mass, gentle, plan, forces):
    """Write the forces float64 (degrees of freedom,) of one step at those of people; counts what is left of `gentle` float64 (N,) seconds down.

    `qpos`, `qvel` are all positions and velocities of the model, `places` and `dofs` int64 (2 N,) where x and y of people lie in them, `origin`, `wish` (m) and `rate` (m/s) float64 (N, 2), `mass` float64 (N,).
    `plan` is (seconds since the wish, dt, stiffness, pace, push, lean speed), as `sim.pushing` names them.
    """
    since, dt, stiffness, pace, push, lean_speed = plan[0], plan[1], plan[2], plan[3], plan[4], plan[5]
    for n in range(wish.shape[0]):
        vx, vy = qvel[dofs[2 * n]], qvel[dofs[2 * n + 1]]
        x, y = origin[n, 0] + qpos[places[2 * n]], origin[n, 1] + qpos[places[2 * n + 1]]
        is_gentle = gentle[n] > 0.0
        is_halting = is_gentle and math.hypot(vx, vy) > lean_speed
        if is_halting:
            px, py = -2.0 * stiffness * vx, -2.0 * stiffness * vy
        else:
            px = stiffness * stiffness * (wish[n, 0] + rate[n, 0] * since - x) + 2.0 * stiffness * (rate[n, 0] - vx)
            py = stiffness * stiffness * (wish[n, 1] + rate[n, 1] * since - y) + 2.0 * stiffness * (rate[n, 1] - vy)
        most = min(pace, push / mass[n]) if is_gentle and not is_halting else pace
        share = min(1.0, most / max(math.hypot(px, py), 1e-9))
        forces[dofs[2 * n]] = mass[n] * px * share
        forces[dofs[2 * n + 1]] = mass[n] * py * share
        gentle[n] = max(0.0, gentle[n] - dt)


def warm_up() -> None:
    """Compile every kernel of this module."""
    two, index = np.zeros((1, 2)), np.array([0, 1])
    args = (two.copy(), two.copy(), two.copy(), np.ones(1), np.zeros(1), np.ones(6))
    striving_forces(np.zeros(2), np.zeros(2), index, index, *args[:3], args[3], args[4], args[5], np.zeros(2))
