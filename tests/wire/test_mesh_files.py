"""OBJ, STL and PLY: the same tetrahedron in every dialect, and one sentence for every kind of damage."""

import struct
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.wire.mesh_files import read_mesh

VERTICES = np.array([[0.0, 0, 0], [1.5, 0, 0], [0, 1, 0], [0, 0, -2]])
TRIANGLES = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
CORNERS = VERTICES[TRIANGLES]

OBJ = """# a comment
o thing
v 0 0 0
v 1.5 0 0 1.0
v 0 1 0
v 0 0 -2
vn 0 0 1
f 1//1 2//1 3//1
f 1/1 4/2 2/3
f -4 -2 -1
f 2 4 3
"""
PLY_HEAD = """ply
format {} 1.0
comment made by hand
element vertex 4
property float x
property float y
property float z
property uchar red
element face 4
property list uchar int vertex_indices
end_header
"""
PLY_TEXT = PLY_HEAD.format("ascii") + "0 0 0 9\n1.5 0 0 9\n0 1 0 9\n0 0 -2 9\n3 0 1 2\n3 0 3 1\n3 0 2 3\n3 1 3 2\n"


def stl_text() -> bytes:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t) + "endloop\nendfacet\n"
        for t in CORNERS
    )
    return f"solid thing\n{facets}endsolid thing\n".encode()


def stl_binary() -> bytes:
    facets = b"".join(struct.pack("<12fH", 0, 0, 1, *t.ravel(), 0) for t in CORNERS)
    return b"solid is no promise of text".ljust(80, b" ") + struct.pack("<I", len(CORNERS)) + facets


def ply_binary(order: str) -> bytes:
    name = "binary_little_endian" if order == "<" else "binary_big_endian"
    body = b"".join(struct.pack(f"{order}3fB", *v, 9) for v in VERTICES)
    return PLY_HEAD.format(name).encode() + body + b"".join(struct.pack(f"{order}B3i", 3, *t) for t in TRIANGLES)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.obj", OBJ.encode()),
        ("a.stl", stl_text()),
        ("b.STL", stl_binary()),
        ("a.ply", PLY_TEXT.encode()),
        ("b.ply", ply_binary("<")),
        ("c.ply", ply_binary(">")),
    ],
)
def test_the_same_triangles_come_out_of_every_dialect(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    vertices, triangles = read_mesh(tmp_path / name)
    assert (vertices.shape, vertices.dtype, triangles.dtype) == ((4, 3), np.float64, np.int32)
    np.testing.assert_array_equal(vertices[triangles], CORNERS)


def test_faces_with_more_corners_become_fans(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0.5 2 0\nv 0 1 0\nf 1 2 3 4 5\n")
    _, triangles = read_mesh(tmp_path / "a.obj")
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.obj", b"v 0 0\nf 1 1 1\n"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n"),
        ("a.obj", b"v 0 0 0\nf 0 0 0\n"),
        ("a.obj", b"v 0 0 0\nf 1 1\n"),
        ("a.obj", b"v 0 0 nan\nf 1 1 1\n"),
        ("a.obj", b"\xff\xfe\x00"),
        ("a.obj", b""),
        ("a.stl", stl_binary()[:-7]),
        ("a.stl", stl_text()[:150]),
        ("a.stl", b""),
        ("a.ply", PLY_TEXT[:-8].encode()),
        ("a.ply", PLY_TEXT.replace("list uchar", "list strange").encode()),
        ("a.ply", PLY_TEXT.replace("3 1 3 2", "3 1 3 7").encode()),
        ("a.ply", PLY_TEXT.replace("format ascii 1.0\n", "").encode()),
        ("a.ply", PLY_TEXT.replace("end_header", "").encode()),
        ("a.ply", PLY_TEXT.replace("ply\n", "plx\n", 1).encode()),
        ("a.ply", ply_binary("<")[:-3]),
        ("a.ply", PLY_TEXT.replace("float z", "float w").encode()),
        ("a.xyz", b"0 0 0"),
    ],
)
def test_broken_files_are_refused_in_one_sentence(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(BadInputError, match=rf"^\S+{name}: ") as caught:
        read_mesh(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"a\.obj: cannot be read"):
        read_mesh(tmp_path / "a.obj")
