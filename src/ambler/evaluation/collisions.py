"""Collisions, judged from the ground truth: contacts of the robot while it moves, clustered in time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ambler.core.messages import Contact


@dataclass(frozen=True, slots=True)
class Collision:
    """One collision: first and last contact, what was touched first, the fastest speed (m/s) and the greatest force (N)."""

    begin_ns: int
    end_ns: int
    robot_geom: str
    other_geom: str
    speed: float
    force: float


def find_collisions(
    contacts: Iterable[Contact],
    *,
    min_speed: float = 0.05,
    gap: float = 0.5,
    allowed: frozenset[str] = frozenset(),
) -> tuple[Collision, ...]:
    """Return the collisions among contacts: those faster than `min_speed` (m/s) with anything whose name is not `allowed`.

    Contacts at most `gap` seconds apart are one collision, whatever they touch.
    """
    hits = [c for c in contacts if c.speed > min_speed and c.other_geom not in allowed]
    collisions: list[Collision] = []
    for c in sorted(hits, key=lambda c: c.stamp_ns):
        last = collisions[-1] if collisions else None
        if last is None or c.stamp_ns - last.end_ns > gap * 1e9:
            collisions.append(Collision(c.stamp_ns, c.stamp_ns, c.robot_geom, c.other_geom, c.speed, c.force))
        else:
            collisions[-1] = Collision(
                last.begin_ns,
                c.stamp_ns,
                last.robot_geom,
                last.other_geom,
                max(last.speed, c.speed),
                max(last.force, c.force),
            )
    return tuple(collisions)
