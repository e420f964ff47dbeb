"""A base that walks, on the bus: it stands up and sits down on request."""

from __future__ import annotations

from ambler.core.devices import Legs
from ambler.runtime.node import Node
from ambler.runtime.tasks import SIT, STAND, Nothing


class LegsNode(Node):
    """Serves `stand` and `sit`; both answer at once, the motion takes a second or two."""

    name = "legs"
    serves = (STAND, SIT)
    latency = 1e-6

    def __init__(self, legs: Legs) -> None:
        self._legs = legs

    def start(self) -> None:
        self.ctx.serve(STAND, self._on_stand)
        self.ctx.serve(SIT, self._on_sit)

    def _on_stand(self, request: Nothing) -> Nothing:
        self._legs.stand()
        return Nothing()

    def _on_sit(self, request: Nothing) -> Nothing:
        self._legs.sit()
        return Nothing()
