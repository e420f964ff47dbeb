"""A camera on the bus: pictures while somebody wants them, and how it projects."""

from __future__ import annotations

from ambler.core.camera import CameraModel
from ambler.core.devices import Camera
from ambler.core.messages import CameraInfo, Image
from ambler.nodes.devices.node import DeviceNode
from ambler.runtime.tasks import CAMERA_PICTURES, Nothing, PicturesRequest
from ambler.runtime.topics import STATUS, Topic

LEASE_NS = 1_000_000_000


class CameraNode(DeviceNode):
    """Publishes pictures. The robot's first camera takes them while a lease of `camera_pictures` lasts; further ones
    (`is_always_on`) all the time. `calibration` replaces what the camera says of its own projection."""

    def __init__(
        self,
        camera: Camera,
        image: Topic[Image],
        info: Topic[CameraInfo],
        calibration: CameraModel | None = None,
        *,
        is_always_on: bool = False,
    ) -> None:
        super().__init__(f"camera_{camera.frame}", (camera,))
        self._camera, self._image, self._info = camera, image, info
        self._calibration, self._is_always_on = calibration, is_always_on
        self._renew_ns = 0
        self.outputs = (image, info, STATUS)
        self.serves = () if is_always_on else (CAMERA_PICTURES,)

    def prepare(self) -> None:
        model = self._calibration or self._camera.model
        self.ctx.publish(self._info, CameraInfo(self.ctx.now_ns, self._camera.frame, model))
        if not self._is_always_on:
            self.ctx.serve(CAMERA_PICTURES, self._on_pictures)

    def poll(self) -> None:
        if (
            self._is_always_on and self.ctx.now_ns >= self._renew_ns
        ):  # half a lease ahead: a line is not filled with requests
            self._camera.request(self.ctx.now_ns + LEASE_NS)
            self._renew_ns = self.ctx.now_ns + LEASE_NS // 2
        for image in self._camera.read(self.ctx.now_ns):
            self.ctx.publish(self._image, image)

    def _on_pictures(self, request: PicturesRequest) -> Nothing:
        self._camera.request(self.ctx.now_ns + round(request.seconds * 1e9))
        return Nothing()
