"""People as bodies of finite mass: each strives to where he wants to be; who walks into something halts, and leans on it with `PUSH`.

A critically damped spring pulls him there, with the force of a walker who changes his pace; people and walls do not touch each other,
because ways keep clear of walls and people pass each other (`sim.movers`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.walkers import striving_forces
from ambler.sim.solids import Solid

F64 = NDArray[np.float64]
STIFFNESS = 20.0  # 1/s: natural frequency of the spring
PACE = 6.0  # m/s^2 with which a person turns or halts
PUSH = 100.0  # N with which a person leans on a robot: below the 140 N that ISO/TS 15066 allows on a body
AFTER = 0.5  # seconds after a touch for which a person goes gently: an impact is no reason to take a run-up
LEAN_SPEED = 0.15  # m/s above which somebody who has walked into something brakes
SOFT = 0.04  # s: clothes and flesh; time constant of the contact
PEOPLE_BIT = 2  # people meet robots (conaffinity 3) and nothing else


def person_xml(solid: Solid, place: str, mass: float) -> str:
    """Return the body of a person that slides upright over the floor."""
    name = solid.name
    half = 0.5 * (solid.z_max - solid.z_min)
    return (
        f"<body name={quoteattr(f'{name}/person')} {place}>"
        f'<joint name={quoteattr(f"{name}/x")} type="slide" axis="1 0 0"/>'
        f'<joint name={quoteattr(f"{name}/y")} type="slide" axis="0 1 0"/>'
        f'<geom name={quoteattr(f"{name}#person")} type="cylinder" size="{0.5 * solid.size_x!r} {half!r}"'
        f' mass="{mass!r}" contype="{PEOPLE_BIT}" conaffinity="0" solref="{SOFT!r} 1"/></body>'
    )


class PushingPeople:
    """Moves the people in a MuJoCo model. Positions are (x, y) in the world."""

    def __init__(self, model: Any, data: Any, names: Sequence[str], masses: Sequence[float], dt: float) -> None:
        self.count = len(names)
        joints = [model.joint(f"{name}/{axis}").id for name in names for axis in "xy"]
        self._qpos = np.array([model.jnt_qposadr[j] for j in joints], np.int64)
        self._dofs = np.array([model.jnt_dofadr[j] for j in joints], np.int64)
        self._geoms = np.array([model.geom(f"{name}#person").id for name in names], np.int64)
        bodies = [model.body(f"{name}/person").id for name in names]
        self._origin = np.array([model.body_pos[b, :2] for b in bodies]).reshape(-1, 2)
        self._model, self._bodies = model, np.array(bodies, np.int64)
        self._middles = np.array([model.body_pos[b, 2] for b in bodies])
        self._mass = np.array(masses, np.float64)
        self._wish = self._origin.copy()
        self._rate = np.zeros_like(self._wish)
        self._data = data
        self._dt = dt
        self._since = 0.0
        self._gentle = np.zeros(self.count)
        self._plan = np.array([0.0, dt, STIFFNESS, PACE, PUSH, LEAN_SPEED])

    def head_for(self, places: Sequence[tuple[float, float]]) -> None:
        """Take where everybody wants to be now; the pace follows from the last wish."""
        wish = np.array(places).reshape(-1, 2)
        self._rate = (wish - self._wish) / self._since if self._since > 0.0 else np.zeros_like(wish)
        self._wish, self._since = wish, 0.0

    def stand_on(self, heights: F64) -> None:
        """Put everybody on ground of these heights (N,), metres, where they are now."""
        self._model.body_pos[self._bodies, 2] = self._middles + heights

    def walk(self, *, is_met: bool) -> None:
        """Set the forces of the next step; `is_met` says whether anything touches a robot, else nobody looks at contacts."""
        data, plan = self._data, self._plan
        if is_met:
            self._gentle[np.isin(self._geoms, data.contact.geom)] = AFTER
        plan[0] = self._since
        striving_forces(
            *(data.qpos, data.qvel, self._qpos, self._dofs, self._origin, self._wish, self._rate, self._mass),
            *(self._gentle, plan, data.qfrc_applied),
        )
        self._since += self._dt

    def places(self) -> list[tuple[float, float]]:
        """Return where everybody is."""
        return [(x, y) for x, y in self._here().tolist()] if self.count else []

    def _here(self) -> F64:
        return np.asarray(self._origin + self._data.qpos[self._qpos].reshape(-1, 2))
