"""A robot is a list of nodes. Building it checks the wiring: every input has a writer, every topic one writer, every call a server."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from ambler.core.errors import StackError
from ambler.runtime.node import Node, Offers
from ambler.runtime.topics import Topic


class Stack:
    """A checked list of nodes. `external` names the topics that come from outside: a recording, a person at a screen. `prefix` tells
    the robots of one executor apart; nodes never see it, and no topic, service or task of one prefix reaches another.

    Raises StackError that lists every fault of the wiring at once.
    """

    def __init__(self, nodes: Sequence[Node], external: Iterable[Topic[Any]] = (), prefix: str = "") -> None:
        self.nodes = tuple(nodes)
        self.external = tuple(external)
        self.prefix = prefix
        faults = [*self._name_faults(), *self._topic_faults(), *self._service_faults()]
        if faults:
            raise StackError("; ".join(faults))

    def node(self, name: str) -> Node:
        """Return the node of that name; raises KeyError."""
        for node in self.nodes:
            if node.name == name:
                return node
        raise KeyError(f"the stack has no node {name!r}")

    @property
    def served(self) -> Offers:
        """Every service and task that a node of the stack serves."""
        return tuple(offer for node in self.nodes for offer in node.serves)

    @property
    def outside_offers(self) -> Offers:
        """Those of `served` that pages, bridges and other machines may offer to their users."""
        return tuple(offer for offer in self.served if offer.is_outside)

    def _name_faults(self) -> list[str]:
        names = [n.name for n in self.nodes]
        faults = [f"two nodes are called {n!r}" for n in sorted({n for n in names if names.count(n) > 1})]
        return faults + [f"{type(n).__name__} has no name" for n in self.nodes if not n.name]

    def _topic_faults(self) -> list[str]:
        writers: dict[str, list[str]] = {topic.name: ["outside"] for topic in self.external}
        for node in self.nodes:
            for topic in node.outputs:
                writers.setdefault(topic.name, []).append(node.name)
        shared = {t.name for n in self.nodes for t in n.outputs if t.has_many_writers}
        faults = [
            f"topic {name!r} has {len(who)} writers: {', '.join(who)}"
            for name, who in writers.items()
            if len(who) > 1 and name not in shared
        ]
        for node in self.nodes:
            faults += [
                f"input {topic.name!r} of {node.name} has no writer"
                for topic in node.inputs
                if topic.name not in writers
            ]
        return faults

    def _service_faults(self) -> list[str]:
        servers: dict[str, list[str]] = {}
        for node in self.nodes:
            for offer in node.serves:
                servers.setdefault(offer.name, []).append(node.name)
        faults = [
            f"{name!r} is served by {len(who)} nodes: {', '.join(who)}" for name, who in servers.items() if len(who) > 1
        ]
        for node in self.nodes:
            faults += [
                f"{node.name} calls {wanted.name!r}, which nobody serves"
                for wanted in node.calls
                if wanted.name not in servers
            ]
        return faults
