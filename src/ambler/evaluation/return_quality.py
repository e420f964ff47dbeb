"""How a robot came back to a site: when and how exactly it found out where it was, and where it truly stood when it said that it had reached a way-point.

A map that a robot made is bent by centimetres, so a place in the world has no one place in it: the true pose in the map is that of the pose nearest by which the
exploration told, composed with the true pose relative to it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ambler.core.errors import BadInputError
from ambler.core.messages import Contact, Odometry, PoseStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.collisions import find_collisions
from ambler.evaluation.spatial_error import truth_at
from ambler.runtime.topics import CONTACT, LOCALIZED_POSE, SLAM_POSE, TRUE_POSE
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

GAP = 0.2  # seconds between true poses
STRIDE = 0.25  # metres between two poses of the exploration that truth is told by
FALSE_M, FALSE_DEG = 0.5, 5.0  # a pose that is told and farther off is a wrong place
SAME_HEIGHT = 0.7  # metres between the ground of a way-point and a robot that stands on its level
OPERATOR, DRIVE = "operator", "STEP_NAVIGATE"


@dataclass(frozen=True, slots=True, eq=False)
class ExploredTruth:
    """Poses of the base that an exploration told in its map, and where it truly was in the world then."""

    told: Sequence[SE3]
    true: Sequence[SE3]

    def __post_init__(self) -> None:
        if len(self.told) == 0 or len(self.told) != len(self.true):
            raise BadInputError(f"{len(self.told)} poses of an exploration, and the truth of {len(self.true)}")

    @classmethod
    def of_recording(cls, recording: Path) -> ExploredTruth:
        """Read an exploration; raises BadInputError where it told no pose."""
        told: list[PoseStamped] = []
        true: list[Odometry] = []
        for recorded in read_recording(recording, [SLAM_POSE.ros_name, TRUE_POSE.ros_name]):
            if recorded.topic == TRUE_POSE.ros_name:
                true.append(decode(Odometry, recorded.data))
            else:
                pose = decode(PoseStamped, recorded.data)
                if not told or math.dist(pose.pose.translation, told[-1].pose.translation) > STRIDE:
                    told.append(pose)
        stamps, poses = np.array([t.stamp_ns for t in true], np.int64), [t.pose for t in true]
        pairs = [(t.pose, truth_at(t.stamp_ns, stamps, poses, GAP)) for t in told]
        known = [(pose, truth) for pose, truth in pairs if truth is not None]
        return cls([pose for pose, _ in known], [truth for _, truth in known])

    def in_map(self, world_from_bases: Sequence[SE3]) -> list[SE3]:
        """Return true poses of the world in the map."""
        tree = cKDTree(np.array([pose.translation for pose in self.true]))
        places = np.array([pose.translation for pose in world_from_bases]).reshape(-1, 3)
        nearest = np.asarray(tree.query(places)[1], np.int64).reshape(-1).tolist()
        return [self.told[k] @ self.true[k].inverse() @ pose for k, pose in zip(nearest, world_from_bases, strict=True)]


@dataclass(frozen=True, slots=True)
class WayPoint:
    """Where a robot was sent to in the map, and how high (m) the ground is there."""

    map_from_goal: SE2
    height: float


@dataclass(frozen=True, slots=True)
class Arrival:
    """How a drive ended: the robot's `code`, and how far it truly stood from the way-point, `error` m on the plane, `off_height` m above its ground."""

    code: str
    error: float
    off_height: float

    def is_there(self, tolerance: float) -> bool:
        """Say whether the robot said that it had arrived, and truly had."""
        return self.code == "SUCCEEDED" and self.error <= tolerance and abs(self.off_height) <= SAME_HEIGHT


@dataclass(frozen=True, slots=True)
class ReturnQuality:
    """`found_s`: seconds after it was switched on when the first pose in the map was told, which was off by `found_m` and `found_deg`; None where none was. `track_rms_m`, `track_max_m` of all that
    were told, of which `wrong` were of another place. `arrivals` in the order of the way-points, those that were begun."""

    found_s: float | None
    found_m: float | None
    found_deg: float | None
    track_rms_m: float | None
    track_max_m: float | None
    poses: int
    wrong: int
    arrivals: tuple[Arrival, ...]
    collisions: int
    path_length_m: float


def judge_return(recording: Path, log: Path, truth: ExploredTruth, way_points: Sequence[WayPoint]) -> ReturnQuality:
    """Compare what a robot said in a later run, in its recording and its log, with where it truly was. Raises BadInputError when they cannot be read."""
    true: list[Odometry] = []
    told: list[Odometry] = []
    contacts: list[Contact] = []
    wanted = (TRUE_POSE, LOCALIZED_POSE, CONTACT)
    for recorded in read_recording(recording, [topic.ros_name for topic in wanted]):
        if recorded.topic == CONTACT.ros_name:
            contacts.append(decode(Contact, recorded.data))
        else:
            (true if recorded.topic == TRUE_POSE.ros_name else told).append(decode(Odometry, recorded.data))
    if not true:
        raise BadInputError(f"{recording}: tells no true pose")
    stamps, poses = np.array([t.stamp_ns for t in true], np.int64), [t.pose for t in true]
    pairs = [(t, at) for t in told if (at := truth_at(t.stamp_ns, stamps, poses, GAP)) is not None]
    in_map = truth.in_map([at for _, at in pairs])
    off = [_apart(t.pose, known) for (t, _), known in zip(pairs, in_map, strict=True)]
    metres: NDArray[np.float64] = np.array([m for m, _ in off])
    places = np.array([pose.translation for pose in poses[::10]])
    ends = drive_ends(log)
    last = [int(np.argmin(np.abs(stamps - stamp_ns))) for stamp_ns, _ in ends]
    stood = truth.in_map([poses[k] for k in last])
    return ReturnQuality(
        found_s=1e-9 * (pairs[0][0].stamp_ns - int(stamps[0])) if off else None,
        found_m=off[0][0] if off else None,
        found_deg=off[0][1] if off else None,
        track_rms_m=float(np.sqrt(np.mean(metres**2))) if off else None,
        track_max_m=float(metres.max()) if off else None,
        poses=len(off),
        wrong=sum(m > FALSE_M or deg > FALSE_DEG for m, deg in off),
        arrivals=tuple(_arrival(*told) for told in zip(ends, way_points, stood, strict=False)),
        collisions=len(find_collisions(contacts)),
        path_length_m=float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()),
    )


def drive_ends(log: Path) -> list[tuple[int, str]]:
    """Return when (ns) each drive that the operator began was over, and its code, from the log of a run: the last word of a program comes too late for its
    recording. Raises BadInputError."""
    try:
        lines = [json.loads(text) for text in log.read_text(encoding="utf-8").splitlines()]
        own = [(int(each["stamp_ns"]), str(each["code"])) for each in lines if each["node"] == OPERATOR]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInputError(f"{log}: is not the log of a run: {error}") from error
    return [end for begin, end in pairwise(own) if begin[1] == DRIVE]


def _arrival(end: tuple[int, str], way_point: WayPoint, map_from_base: SE3) -> Arrival:
    """Compare where a robot truly stood when a drive was over with where it was sent to."""
    goal, (x, y, z) = way_point.map_from_goal, map_from_base.translation
    return Arrival(end[1], math.hypot(x - goal.x, y - goal.y), z - way_point.height)


def _apart(a: SE3, b: SE3) -> tuple[float, float]:
    """Return metres and degrees between two poses."""
    w, x, y, z = (a.inverse() @ b).rotation
    turn = 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))
    return math.dist(a.translation, b.translation), math.degrees(turn)
