"""The lesson of a docking node: a robot stands in a dock, looks at it for a while, and the database learns its pose and its offset."""

from __future__ import annotations

import math
from dataclasses import replace

from ambler.core.errors import BadInputError, NotWrittenError
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.docking.database import DockDatabase
from ambler.docking.detection import DockDetection
from ambler.docking.dock import Dock
from ambler.docking.lesson import DockLesson, LessonConfig
from ambler.runtime.node import GoalHandle, TaskOutcome
from ambler.runtime.tasks import DockFeedback, TeachDockGoal, TeachDockReport

TeachHandle = GoalHandle[TeachDockGoal, DockFeedback, TeachDockReport]

AT_REST = 0.02  # m/s and rad/s up to which a robot stands


class DockTeacher:
    """One lesson at a time; `handle` is None between them."""

    def __init__(self, database: DockDatabase, config: LessonConfig) -> None:
        self._database, self._config = database, config
        self.handle: TeachHandle | None = None
        self._lesson = DockLesson(config)
        self._dock: Dock | None = None
        self._map_from_base = SE2()
        self._begun_ns = 0

    def begin(self, handle: TeachHandle, dock: Dock, map_from_base: SE2, now_ns: int) -> None:
        """Begin to teach a dock, whose detections come without any offset, where the robot stands."""
        self.handle, self._dock, self._map_from_base, self._begun_ns = handle, dock, map_from_base, now_ns
        self._lesson = DockLesson(self._config)

    def stop(self) -> TeachHandle | None:
        """Forget the lesson; returns whose it was."""
        handle, self.handle = self.handle, None
        return handle

    def see(self, detection: DockDetection) -> None:
        """Take a detection, if there is a lesson."""
        if self.handle is not None:
            self._lesson.add(detection.base_from_dock)

    def update(self, velocity: BodyVelocity, now_ns: int) -> TaskOutcome[TeachDockReport] | None:
        """Return how the lesson ended once it has: enough was seen, its time is over, or the robot moved; then the dock is saved or
        nothing is changed."""
        if math.hypot(velocity.vx, velocity.vy) > AT_REST or abs(velocity.wz) > AT_REST:
            self.stop()
            return TaskOutcome("NOT_DOCKED", "the robot moved while it was taught a dock", None)
        is_late = (now_ns - self._begun_ns) * 1e-9 > self._config.seconds
        if not (self._lesson.is_full or is_late):
            return None
        self.stop()
        assert self._dock is not None
        try:
            saved = self._database.teach(replace(self._dock, offset=self._lesson.offset()), self._map_from_base)
        except NotWrittenError as error:
            return TaskOutcome("DOCK_NOT_SAVED", str(error), None)
        except BadInputError as error:
            return TaskOutcome("DOCK_NOT_SEEN", str(error), None)
        at, off = saved.map_from_dock, saved.offset
        text = (
            f"dock {saved.name} is at {at.x:.3f}, {at.y:.3f} m, {math.degrees(at.yaw):.2f}°; detections there are moved by "
            f"{1e3 * off.x:+.1f}, {1e3 * off.y:+.1f} mm, {math.degrees(off.yaw):+.2f}° ({self._lesson.count} of them)"
        )
        return TaskOutcome("SUCCEEDED", text, TeachDockReport(at, off, self._lesson.count))
