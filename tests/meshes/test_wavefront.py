from __future__ import annotations

import numpy as np
import pytest

from mbocp.meshes.mesh_parts import Surface
from mbocp.meshes.triangles import read_wavefront

CORNERS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.fixture
def read(tmp_path):
    def write_and_read(text: str):
        path = tmp_path / "mesh.obj"
        path.write_text(text)
        return read_wavefront(path)

    return write_and_read


@pytest.mark.parametrize(
    "faces",
    ["f 1 2 3 4\n", "f 1 2 3\nf 1 3 4\n", "f -4 -3 -2 -1\n", "f 1/1 2/1 3/1 4/1\n", "f 1//1 2//1 3//1 4//1\n",
     "f 1/1/1 2/1/1 \\\n 3/1/1 4/1/1\n"],
)  # fmt: skip
def test_faces_cover_the_square(read, faces):
    (part,) = read(CORNERS + "vt 0.5 0.5\nvn 0 0 1\n" + faces)
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    assert 0.5 * np.cross(b - a, c - a).sum(axis=0) == pytest.approx([0.0, 0.0, 1.0])
    assert (part.uvs is not None) == ("/1" in faces.replace("//1", ""))
    assert (part.normals is not None) == (faces.count("/") > 4)


def test_objects_may_differ_in_their_attributes(read):
    (part,) = read(CORNERS + "vn 0 0 1\no one\nf 1//1 2//1 3//1\no two\nf 1 3 4\n")
    assert part.normals is None  # not known everywhere: they are computed from the triangles
    assert len(part.faces) == 2


def test_materials_give_colours(read, tmp_path):
    (tmp_path / "picture.png").write_bytes(b"")
    (tmp_path / "m.mtl").write_text(
        "newmtl red\nKd 1 0 0\nnewmtl photo\nmap_Kd picture.png\nnewmtl lost\nKd 0 1 0\nmap_Kd gone.png\n"
    )
    faces = "".join(f"usemtl {name}\nf 1 2 3\n" for name in ("red", "photo", "lost", "unknown"))
    parts = read(f"mtllib m.mtl\n{CORNERS}{faces}")
    assert [part.surface for part in parts] == [
        Surface((1.0, 0.0, 0.0)),
        Surface((1.0, 1.0, 1.0), tmp_path / "picture.png"),
        Surface((0.0, 1.0, 0.0)),
        None,
    ]


@pytest.mark.parametrize(("text", "match"), [("v 0 0 0\n", "no faces"), ("f 1 2 3\n", "without positions")])
def test_what_is_no_mesh_is_refused(read, text, match):
    with pytest.raises(ValueError, match=match):
        read(text)
