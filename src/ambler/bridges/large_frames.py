"""Compression of what is large and can be compressed (permessage-deflate, which every browser offers): a map of half a megabyte, which
on a slow line holds up all that comes after it, becomes some kilobytes. Scans and clouds hardly shrink and go as they are."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

from websockets.extensions.permessage_deflate import PerMessageDeflate, ServerPerMessageDeflateFactory
from websockets.frames import Frame
from websockets.typing import ExtensionParameter

LARGE_BYTES = 1 << 13  # grids, clouds, pictures; transforms, odometry, commands and the gate have less than 1 KiB
_LEVEL = 1
_SAMPLE_BYTES = 1 << 12
_WORTH_IT = 0.5  # what is left of a sample from the middle


class LargeFrameDeflate(PerMessageDeflate):
    """Compresses large frames, every message on its own, and leaves others as they are."""

    def encode(self, frame: Frame) -> Frame:
        """Return the frame as it is sent."""
        return super().encode(frame) if _is_worth_it(bytes(frame.data)) else frame


class LargeFrameFactory(ServerPerMessageDeflateFactory):
    """Offers the compression to a client that asks for it."""

    def __init__(self) -> None:
        super().__init__(server_no_context_takeover=True, compress_settings={"level": _LEVEL})

    def process_request_params(
        self, params: Sequence[ExtensionParameter], accepted_extensions: Sequence[object]
    ) -> tuple[list[ExtensionParameter], PerMessageDeflate]:
        """Answer what the client proposed."""
        answer, agreed = super().process_request_params(params, accepted_extensions)  # type: ignore[arg-type]
        bits = (agreed.remote_max_window_bits, agreed.local_max_window_bits)
        takeovers = (agreed.remote_no_context_takeover, agreed.local_no_context_takeover)
        return answer, LargeFrameDeflate(*takeovers, *bits, agreed.compress_settings)


def _is_worth_it(data: bytes) -> bool:
    if len(data) <= LARGE_BYTES:
        return False
    middle = len(data) // 2
    sample = data[middle : middle + _SAMPLE_BYTES]
    return len(zlib.compress(sample, _LEVEL)) < _WORTH_IT * len(sample)
