"""What a docking mission remembers of the docking under way."""

from __future__ import annotations

from dataclasses import dataclass, field

from ambler.core.se2 import SE2
from ambler.docking.dock import Dock
from ambler.missions.dock_commands import DockResult, DockView


@dataclass
class DockRun:
    """One docking. Instants are None until they have come; `*_seconds` count without a break."""

    dock: Dock
    begun_ns: int
    view: DockView | None = None
    dt: float = 0.0
    entered_ns: int | None = None
    docking_ns: int | None = None
    attempts: int = 0
    stagings: int = 0
    drive_code: str | None = None
    drive_text: str = ""
    look: int = 0
    look_ns: int | None = None
    look_poses: list[SE2] = field(default_factory=list)
    stale_seconds: float = 0.0
    held_seconds: float = 0.0
    waited_seconds: float = 0.0
    """Seconds of the present state in which the gate held the robot."""
    settled_seconds: float = 0.0
    contact_seconds: float = 0.0
    is_contact_void: bool = False
    """Whether contact has been told without a break since where there can be none."""
    reason: str = ""
    reason_text: str = ""
    is_hopeless: bool = False
    dock_odom: SE2 | None = None
    """The dock in the odom frame by the last detections."""
    goal_odom: SE2 | None = None
    """Where a robot that backs out goes."""

    def take(self, view: DockView, longest: float) -> None:
        """Remember a view; its time step is at most `longest`."""
        last, self.view = self.view, view
        self.dt = longest if last is None else min(longest, max(1e-3, (view.now_ns - last.now_ns) * 1e-9))
        self.held_seconds = self.held_seconds + self.dt if view.is_held else 0.0
        self.waited_seconds += self.dt if view.is_held else 0.0
        if self.entered_ns is None:
            self.entered_ns = view.now_ns
        if view.track is not None:
            self.dock_odom = view.odom_from_base @ view.track.base_from_dock

    def enter(self) -> None:
        """Begin a state."""
        self.entered_ns = None if self.view is None else self.view.now_ns
        self.held_seconds = self.waited_seconds = self.settled_seconds = self.contact_seconds = 0.0

    def seconds(self, view: DockView) -> float:
        """Seconds in the present state."""
        return 0.0 if self.entered_ns is None else (view.now_ns - self.entered_ns) * 1e-9

    def result(self, attempts: int) -> DockResult:
        """Return how it went so far."""
        view = self.view
        now_ns = self.begun_ns if view is None else view.now_ns
        docking = 0.0 if self.docking_ns is None else (now_ns - self.docking_ns) * 1e-9
        return DockResult(
            attempts,
            (now_ns - self.begun_ns) * 1e-9,
            docking,
            None if view is None or view.track is None else view.track.base_from_dock,
            None if view is None else view.map_from_base,
        )
