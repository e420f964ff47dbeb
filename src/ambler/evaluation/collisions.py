"""Collisions, judged from the ground truth: contacts that the robot causes, clustered in time.

What stands is touched by whoever moves: a contact while the robot moves is its own. People move, too: a contact with somebody who walks
is the robot's if, at any time in the half second before it, the touched point of the robot moved towards him, unless somebody else shoved it
there while it stood (`split_shoved`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Contact, VelocityCommand
from ambler.runtime.topics import VELOCITY_COMMAND
from ambler.wire.mcap_reader import read_recording

MIN_SPEED = 0.05  # m/s
GAP = 0.5  # seconds up to which contacts are one
STOOD = 0.8  # seconds: the half second before a contact, and what a base needs to stand


@dataclass(frozen=True, slots=True)
class Collision:
    """One collision, or one contact: first and last instant, what was touched first, the fastest speed (m/s) and the greatest force (N)."""

    begin_ns: int
    end_ns: int
    robot_geom: str
    other_geom: str
    speed: float
    force: float


def is_caused(contact: Contact, min_speed: float = MIN_SPEED) -> bool:
    """Say whether the robot is the cause of a contact, by its speed, or towards a person by its approach."""
    return (contact.speed if contact.approach is None else contact.approach) > min_speed


def find_collisions(
    contacts: Iterable[Contact],
    *,
    min_speed: float = MIN_SPEED,
    gap: float = GAP,
    allowed: frozenset[str] = frozenset(),
) -> tuple[Collision, ...]:
    """Return the collisions among contacts: those that the robot caused, faster than `min_speed` (m/s), with anything whose name is not
    `allowed`. Contacts at most `gap` seconds apart are one collision, whatever they touch."""
    return find_contacts((c for c in contacts if is_caused(c, min_speed)), gap=gap, allowed=allowed)


def find_contacts(
    contacts: Iterable[Contact], *, gap: float = GAP, allowed: frozenset[str] = frozenset()
) -> tuple[Collision, ...]:
    """Return all contacts with anything whose name is not `allowed`, whoever caused them; those at most `gap` seconds apart are one."""
    hits = [c for c in contacts if c.other_geom not in allowed]
    found: list[Collision] = []
    for c in sorted(hits, key=lambda c: c.stamp_ns):
        last = found[-1] if found else None
        if last is None or c.stamp_ns - last.end_ns > gap * 1e9:
            found.append(Collision(c.stamp_ns, c.stamp_ns, c.robot_geom, c.other_geom, c.speed, c.force))
        else:
            found[-1] = Collision(
                last.begin_ns,
                c.stamp_ns,
                last.robot_geom,
                last.other_geom,
                max(last.speed, c.speed),
                max(last.force, c.force),
            )
    return tuple(found)


def split_shoved(
    collisions: Sequence[Collision], contacts: Sequence[Contact], recording: Path, footprint: NDArray[np.float64]
) -> tuple[tuple[Collision, ...], tuple[Collision, ...]]:
    """Return the collisions that a robot caused, and those that it was shoved into: within the last `STOOD` seconds before, something else touched it
    that people touch or press it against, and all that its gate told it was to stand, or to move no corner of its `footprint` (N, 2) faster than what
    counts (`MIN_SPEED`). One that merely brakes too late was not shoved."""
    if not collisions:
        return (), ()
    told = [c.decode_as(VelocityCommand) for c in read_recording(recording, [VELOCITY_COMMAND.ros_name])]
    stamps_ns = np.array([v.stamp_ns for v in told], np.int64)
    x, y = footprint.T
    fastest = [np.hypot(v.vx - v.wz * y, v.vy + v.wz * x).max() for v in told]
    is_moving = np.array(fastest) > MIN_SPEED

    def is_shoved(collision: Collision) -> bool:
        begin_ns = collision.begin_ns
        is_touched = any(
            0 <= begin_ns - c.stamp_ns <= STOOD * 1e9
            and c.other_geom != collision.other_geom
            and c.approach is not None
            for c in contacts
        )
        first, last = np.searchsorted(stamps_ns, [collision.begin_ns - round(STOOD * 1e9), collision.begin_ns])
        return bool(is_touched and last > first and not is_moving[first:last].any())

    shoved = tuple(c for c in collisions if is_shoved(c))
    return tuple(c for c in collisions if c not in shoved), shoved
