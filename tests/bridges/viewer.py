"""A viewer as Foxglove is one: speaks the WebSocket protocol by itself, so that the bridge is tested from outside."""

import json
import struct
import time

from websockets.sync.client import connect

TIMEOUT = 10.0


class Viewer:
    """One connection; text operations are gathered by kind, data frames are returned one by one."""

    def __init__(self, port, *, path="/", headers=None, sock=None, compression=None):
        self._connection = connect(
            f"ws://127.0.0.1:{port}{path}",
            subprotocols=["foxglove.sdk.v1"],
            additional_headers=headers,
            compression=compression,
            max_size=None,
            sock=sock,
        )
        self.socket = self._connection.__enter__()
        self.info = {}
        self.channels = {}
        self.warnings = []
        self.times = []
        self._topics = {}
        self._published = 0

    def __enter__(self):
        return self

    def __exit__(self, *reason):
        self._connection.__exit__(*reason)

    def receive(self, timeout=TIMEOUT):
        """Return the next data frame as (topic, log time, payload); None for any other frame."""
        frame = self.socket.recv(timeout=timeout)
        if isinstance(frame, str):
            self._take_text(json.loads(frame))
            return None
        if frame[0] == 2:
            self.times.append(struct.unpack_from("<Q", frame, 1)[0])
            return None
        assert frame[0] == 1
        subscription, log_time = struct.unpack_from("<IQ", frame, 1)
        return self._topics[subscription], log_time, frame[13:]

    def wait_for(self, condition):
        """Receive until the condition holds."""
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < deadline, "the viewer waited in vain"
            self.receive()

    def next_data(self, topic):
        """Return (log time, payload) of the next frame of a topic."""
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            frame = self.receive()
            if frame is not None and frame[0] == topic:
                return frame[1:]
        raise AssertionError(f"nothing came on {topic}")

    def subscribe(self, topic):
        self.wait_for(lambda: topic in self.channels)
        subscription = len(self._topics) + 100
        self._topics[subscription] = topic
        wanted = [{"id": subscription, "channelId": self.channels[topic]["id"]}]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def publish(self, topic, encoding, schema, payload):
        self._published += 1
        channel = {"id": self._published, "topic": topic, "encoding": encoding, "schemaName": schema}
        self.socket.send(json.dumps({"op": "advertise", "channels": [channel]}))
        self.socket.send(struct.pack("<BI", 1, self._published) + payload)

    def _take_text(self, operation):
        if operation["op"] == "serverInfo":
            self.info = operation
        elif operation["op"] == "advertise":
            self.channels.update({channel["topic"]: channel for channel in operation["channels"]})
        elif operation["op"] == "status":
            self.warnings.append(operation["message"])
