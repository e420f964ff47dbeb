"""Which recovery comes next: a sequence that escalates, counts, and starts over when the robot gets on.

What did not help at a place is not tried first by the next drive from there."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass


class RecoveryAction(enum.Enum):
    """What the navigator may do to get out of trouble."""

    CLEAR = "clear"
    ROTATE = "rotate"
    BACK_UP = "back_up"
    WAIT = "wait"


@dataclass(frozen=True, slots=True)
class RecoveryStep:
    """One recovery: radians for a rotation, metres for backing up, seconds for waiting, nothing for clearing the costmaps."""

    action: RecoveryAction
    amount: float = 0.0


DEFAULT_SEQUENCE = (
    RecoveryStep(RecoveryAction.CLEAR),
    RecoveryStep(RecoveryAction.ROTATE, math.pi / 2),
    RecoveryStep(RecoveryAction.BACK_UP, 0.3),
    RecoveryStep(RecoveryAction.WAIT, 3.0),  # after the cures that cost no time: whoever stands there may leave
    RecoveryStep(RecoveryAction.CLEAR),
    RecoveryStep(RecoveryAction.BACK_UP, 0.6),
    RecoveryStep(RecoveryAction.ROTATE, 1.5 * math.pi),
)


class RecoverySequence:
    """Gives each step once; begins anew when the way that is left has become `progress` metres shorter than ever before."""

    def __init__(self, steps: tuple[RecoveryStep, ...] = DEFAULT_SEQUENCE, progress: float = 0.5) -> None:
        self._steps = steps
        self._progress = progress
        self._index = 0
        self._shortest = math.inf
        self.count = 0

    def peek(self) -> RecoveryStep | None:
        """Return the step that comes next, or None when all were tried in vain."""
        return self._steps[self._index] if self._index < len(self._steps) else None

    def continued(self) -> RecoverySequence:
        """Return a sequence for another drive from the same place: it goes on with the step that comes next, or begins anew after the last."""
        again = RecoverySequence(self._steps, self._progress)
        again._index = self._index % len(self._steps) if self._steps else 0
        return again

    def begin_anew(self) -> None:
        """Give every step once more: the robot drives to another place, or from another one. What was tried stays counted."""
        self._index, self._shortest = 0, math.inf

    def try_again(self) -> None:
        """Give every step once more from where the robot is: something else may have changed."""
        self._index = 0

    def take(self) -> None:
        """Count the next step as tried."""
        self._index += 1
        self.count += 1

    def update(self, distance_remaining: float) -> bool:
        """Tell how much way is left, metres; return whether the robot has got on."""
        if self._shortest == math.inf:
            self._shortest = distance_remaining
        elif distance_remaining < self._shortest - self._progress:
            self._shortest = distance_remaining
            self._index = 0
            return True
        return False
