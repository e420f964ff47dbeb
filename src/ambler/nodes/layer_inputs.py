"""What feeds the layers of a costmap: topics, and what a layer makes of their messages.

The usual layers have their topics here. A layer of one's own brings its `LayerInput`s with it; the nodes treat all alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from ambler.core.errors import BadInputError, StaleInputError, TransformError
from ambler.core.messages import GlassWalls, JudgedEcho, Message, Path, PointCloud, Polygon
from ambler.core.se2 import SE2
from ambler.costmap.blocked_layer import AddedLayer, BlockedLayer, BoundaryLayer
from ambler.costmap.glass_layer import GlassLayer
from ambler.costmap.layer import Frames, Layer
from ambler.costmap.range_layer import RangeCone, RangeLayer
from ambler.costmap.terrain_layer import TerrainLayer
from ambler.runtime.topics import ADDED_OBSTACLES, BLOCKED, BOUNDARY, ECHOES, GLASS, TERRAIN_MAP, Topic

M = TypeVar("M", bound=Message)

UNPLACED = (TransformError, StaleInputError)
"""What a feed raises for a message of a moment without a pose: it cannot be placed, and is dropped."""
CONE_SLACK = 0.05  # metres before an echo that a cone does not clear


@dataclass(frozen=True, slots=True)
class LayerInput(Generic[M]):
    """Messages of `topic` go to `feed`, with the frames to place them; one for which it raises `UNPLACED` is dropped.

    `is_required`: without a writer the stack is refused, and while the topic is stale a controller stands still.
    """

    topic: Topic[M]
    feed: Callable[[M, Frames], object]
    is_required: bool = False


def usual_inputs(layers: Sequence[Layer], *, needs_echoes: bool = False) -> tuple[LayerInput[Any], ...]:
    """Return the inputs of those layers that this package knows: echoes for cones, glass for glass, blocked ways, what people added, the
    boundary, terrain."""
    inputs: list[LayerInput[Any]] = []
    for layer in layers:
        if isinstance(layer, RangeLayer):
            inputs.append(LayerInput(ECHOES, _cone_feed(layer), needs_echoes))
        elif isinstance(layer, GlassLayer):
            inputs.append(LayerInput(GLASS, _glass_feed(layer)))
        elif isinstance(layer, BlockedLayer):
            inputs.append(LayerInput(BLOCKED, _blocked_feed(layer)))
        elif isinstance(layer, AddedLayer):
            inputs.append(LayerInput(ADDED_OBSTACLES, _added_feed(layer)))
        elif isinstance(layer, BoundaryLayer):
            inputs.append(LayerInput(BOUNDARY, _boundary_feed(layer)))
        elif isinstance(layer, TerrainLayer):
            inputs.append(LayerInput(TERRAIN_MAP, _terrain_feed(layer), is_required=True))
    return tuple(inputs)


def cone_of(echo: JudgedEcho, costmap_from_sensor: SE2) -> RangeCone:
    """Return the cone of an echo for a range layer."""
    pose = costmap_from_sensor
    distance = echo.distance if echo.is_unexplained else math.inf
    return RangeCone(pose.x, pose.y, pose.yaw, echo.half_angle, echo.free - CONE_SLACK, distance)


def _cone_feed(layer: RangeLayer) -> Callable[[JudgedEcho, Frames], None]:
    def feed(echo: JudgedEcho, frames: Frames) -> None:
        pose = frames.costmap_from(echo.frame, echo.stamp_ns) @ echo.pose.to_se2()
        layer.add([cone_of(echo, pose)], echo.stamp_ns * 1e-9)

    return feed


def _glass_feed(layer: GlassLayer) -> Callable[[GlassWalls, Frames], None]:
    def feed(glass: GlassWalls, frames: Frames) -> None:
        layer.set_segments(glass.segments)

    return feed


def _blocked_feed(layer: BlockedLayer) -> Callable[[Path, Frames], None]:
    def feed(places: Path, frames: Frames) -> None:
        layer.set_points(places.poses[:, :2])

    return feed


def _added_feed(layer: AddedLayer) -> Callable[[PointCloud, Frames], None]:
    def feed(cloud: PointCloud, frames: Frames) -> None:
        _check_map(cloud.frame)
        layer.set_points(cloud.points[np.isfinite(cloud.points).all(axis=1), :2])

    return feed


def _boundary_feed(layer: BoundaryLayer) -> Callable[[Polygon, Frames], None]:
    def feed(polygon: Polygon, frames: Frames) -> None:
        _check_map(polygon.frame)
        try:
            layer.set_corners(polygon.points[:, :2])
        except BadInputError as error:
            raise TransformError(str(error)) from error

    return feed


def _check_map(frame: str) -> None:
    if frame != "map":
        raise TransformError(f"map_from_{frame}: what people add is told in the frame map")


def _terrain_feed(layer: TerrainLayer) -> Callable[[PointCloud, Frames], None]:
    def feed(terrain: PointCloud, frames: Frames) -> None:
        points = frames.costmap_from(terrain.frame, terrain.stamp_ns).transform(
            terrain.points[:, :2].astype(np.float64)
        )
        layer.set_terrain(points, terrain.intensity, terrain.ring > 0)

    return feed
