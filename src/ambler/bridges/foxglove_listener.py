"""The callbacks of the Foxglove SDK: who subscribes, and what viewers publish. They run on threads of the SDK."""

from __future__ import annotations

from collections.abc import Callable

from foxglove.websocket import ChannelView, Client, ClientChannel, ServerListener


class ViewerListener(ServerListener):
    """Forwards subscriptions by topic, and published data together with the channel that its client advertised."""

    def __init__(
        self, on_subscribed: Callable[[str], None], on_client_data: Callable[[ClientChannel, bytes], None]
    ) -> None:
        self._on_subscribed = on_subscribed
        self._on_client_data = on_client_data
        self._advertised: dict[tuple[int, int], ClientChannel] = {}

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Tell which topic a viewer wants to see."""
        self._on_subscribed(channel.topic)

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        """Remember what a viewer is going to publish."""
        self._advertised[client.id, channel.id] = channel

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        """Forget a viewer's channel."""
        self._advertised.pop((client.id, client_channel_id), None)

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        """Hand over what a viewer published; data on a channel that it never advertised is ignored."""
        channel = self._advertised.get((client.id, client_channel_id))
        if channel is not None:
            self._on_client_data(channel, data)
