"""Where things are in the map frame, from the transforms on the bus."""

from __future__ import annotations

from ambler.core.errors import TransformError
from ambler.core.messages import Transforms
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.core.transforms import TransformTree


class MapFrames:
    """The `Frames` of whoever feeds the layers of a global costmap."""

    def __init__(self) -> None:
        self._tree = TransformTree()
        self._map_from_odom: SE2 | None = None

    def add(self, message: Transforms) -> None:
        """Take edges of the tree at their stamps."""
        for edge in message.transforms:
            self._tree.set(edge.parent, edge.child, edge.stamp_ns, edge.parent_from_child)
            if (edge.parent, edge.child) == ("map", "odom"):
                self._map_from_odom = edge.parent_from_child.to_se2()

    def add_static(self, message: Transforms) -> None:
        """Take edges that hold for all times."""
        for edge in message.transforms:
            self._tree.set_static(edge.parent, edge.child, edge.parent_from_child)

    def newest_map_from_base(self) -> SE2:
        """Return the newest pose of the base; raises TransformError."""
        return self._tree.lookup("map", "base").to_se2()

    @property
    def map_from_base(self) -> SE2 | None:
        """The newest pose of the base, None while it is not known."""
        try:
            return self.newest_map_from_base()
        except TransformError:
            return None

    def costmap_from(self, frame: str, stamp_ns: int) -> SE2:
        """Return where the base or a sensor was, or where odometry has its origin now, in the map frame; raises TransformError."""
        if frame == "map":
            return SE2()
        if frame == "odom":
            return self._known_map_from_odom()
        return self._known_map_from_odom() @ self._tree.lookup("odom", frame, stamp_ns).to_se2()

    def spatial_from(self, frame: str, stamp_ns: int) -> SE3:
        """Return where the base or a sensor was in the map frame, with its height and lean; raises TransformError."""
        return SE3.from_se2(self._known_map_from_odom()) @ self._tree.lookup("odom", frame, stamp_ns)

    def _known_map_from_odom(self) -> SE2:
        if self._map_from_odom is None:
            raise TransformError("map_from_odom: nobody has told it yet")
        return self._map_from_odom
