"""Depth pictures as ROS has them (REP 118): millimetres in 16 bits, metres as floats, of either byte order."""

import numpy as np
import pytest

from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.wire.ros_geometry import header_to_ros
from ambler.wire.ros_messages import decode, encode
from ambler.wire.ros_types import STORE, record_class

RosImage = record_class("sensor_msgs/msg/Image")
DEPTH = np.array([[0, 300, 4000], [65535, 1, 256]], np.uint16)


def read(encoding: str, values: np.ndarray, *, is_big: bool = False, padding: int = 0) -> m.Image:
    rows = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    record = RosImage(header_to_ros(5, "depth"), *values.shape, encoding, int(is_big), rows.shape[1], rows.reshape(-1))
    return decode(m.Image, bytes(STORE.serialize_cdr(record, "sensor_msgs/msg/Image")))


def test_what_we_send_is_16uc1_in_millimetres() -> None:
    record = STORE.deserialize_cdr(encode(m.Image(5, "depth", DEPTH)), "sensor_msgs/msg/Image")
    assert (record.encoding, record.step, record.is_bigendian) == ("16UC1", 6, 0)
    np.testing.assert_array_equal(np.array(record.data).view("<u2").reshape(2, 3), DEPTH)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("padding", [0, 5])
def test_millimetres_of_others(order: str, padding: int) -> None:
    image = read("16UC1", DEPTH.astype(f"{order}u2"), is_big=order == ">", padding=padding)
    np.testing.assert_array_equal(image.depth, DEPTH)


def test_metres_become_millimetres_and_what_is_no_distance_none() -> None:
    metres = np.array([[1.2344, np.nan, np.inf], [-1.0, 70.0, 0.0004]], np.float32)
    np.testing.assert_array_equal(read("32FC1", metres).depth, [[1234, 0, 0], [0, 0, 0]])


def test_grey_is_no_depth_and_colour_is_refused() -> None:
    with pytest.raises(BadInputError, match="no distances"):
        _ = m.Image(0, "camera", np.zeros((2, 2), np.uint8)).depth
    with pytest.raises(BadInputError, match="no grey"):
        _ = m.Image(0, "camera", DEPTH).grey
    with pytest.raises(BadInputError, match="rgb8"):
        read("rgb8", np.zeros((2, 6), np.uint8))
