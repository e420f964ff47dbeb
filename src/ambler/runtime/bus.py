"""The bus of one stack: its channels, its services and tasks, and who watches. Stacks of one executor share nothing but the time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ambler.core.messages import Message, Transforms
from ambler.runtime.node import GoalHandle
from ambler.runtime.stack import Stack
from ambler.runtime.topics import Topic, all_topics

if TYPE_CHECKING:
    from ambler.runtime.context import NodeContext

Tap = Callable[[Topic[Any], Message, int, str], None]
"""Sees every delivered message once: topic, message, delivery time in ns, name of the writer."""

Rank = tuple[int, str]
"""The place of a topic among those of one instant: its row in the table, then its name, which holds the instance."""

_ROWS = {topic.name: row for row, topic in enumerate(all_topics())}


@dataclass(slots=True)
class Subscription:
    """One node's interest in one topic. `can_wait`: what comes need not wake the node, but is handed over before anything else that comes later."""

    context: NodeContext
    callback: Callable[[Any], None]
    can_wait: bool = False


@dataclass(slots=True)
class TaskServer:
    """One node's offer of a task, and the goal that it works on."""

    context: NodeContext
    on_goal: Callable[[Any], None]
    on_cancel: Callable[[Any], None]
    active: GoalHandle[Any, Any, Any] | None = None


class Channel:
    """One topic, or one instance of a topic, of one stack. `kept` holds a latched topic's newest message of each writer.

    Who changes `kept` or delivers it holds `lock`, so that a late subscriber gets each message once.
    """

    def __init__(self, topic: Topic[Any]) -> None:
        self.topic = topic
        self.rank: Rank = (_ROWS.get(topic.table_name, len(_ROWS)), topic.name)
        self.is_latched = topic.delivery == "latched"
        self.subscriptions: tuple[Subscription, ...] = ()
        self.kept: dict[int, Message] = {}
        self.lock = threading.Lock()

    def keep(self, writer: int, message: Message) -> None:
        """Remember the newest message of a writer, by its place in the stack; transforms keep the newest of every edge."""
        self.kept[writer] = whole(self.kept.get(writer), message)


def whole(before: Message | None, message: Message) -> Message:
    """Return what a latched topic holds after `message`: itself, or for transforms every edge so far, the newest of each."""
    if not isinstance(before, Transforms) or not isinstance(message, Transforms):
        return message
    edges = {edge.child: edge for edge in (*before.transforms, *message.transforms)}
    return Transforms(message.stamp_ns, tuple(edges.values()))


class Bus:
    """What the nodes of one stack share."""

    def __init__(self, stack: Stack, index: int) -> None:
        self.stack = stack
        self.prefix = stack.prefix
        self.index = index
        self.services: dict[str, tuple[NodeContext, Callable[[Any], Any]]] = {}
        self.tasks: dict[str, TaskServer] = {}
        self.taps: tuple[Tap, ...] = ()
        self._channels: dict[str, Channel] = {}

    def channel(self, topic: Topic[Any]) -> Channel:
        """Return the channel of a topic, a new one at its first use."""
        channel = self._channels.get(topic.name)
        return channel if channel is not None else self._channels.setdefault(topic.name, Channel(topic))
