"""What a foreign robot may put into a page: its own triangles and pictures, nothing else of the machine."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from mbocp.meshes import mesh_parts as parts
from mbocp.meshes.pictures import read_picture
from mbocp.meshes.triangles import binary_stl, check_single_file, read_stl
from mbocp.robot import load_robot
from mbocp.view.meshcat import visuals
from mbocp.view.replay import write_replay
from tests.view.pages import OBJ, Page, angles, read_page, stl, write_arm

PNG = b"\x89PNG\r\n\x1a\n" + b"a picture " * 90
SECRET = b"root:x:0:0: the words that nobody should see " * 20
PAINTED = "mtllib m.mtl\nvt 0 0\n" + OBJ.replace("f ", "usemtl photo\nf ", 1)
TEXTURED_DAE = """<COLLADA>
<library_images><image id="pic"><init_from>{picture}</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON><technique><phong><diffuse><texture texture="pic"/></diffuse>
</phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh><source id="s"><float_array>0 0 0 1 0 0 0 1 0</float_array>
<technique_common><accessor stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles material="m"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node>{nodes}</node></visual_scene></library_visual_scenes>
</COLLADA>"""
SHAPE = '<instance_geometry url="#g"/>'
SQUARE = TEXTURED_DAE.format(picture="a", nodes=SHAPE)


def replay(folder: Path, mesh: str, content: bytes | str | None, **options: object) -> tuple[Page, list[str]]:
    """The page of an arm with this mesh, and what was told."""
    folder.mkdir(parents=True, exist_ok=True)
    if content is not None:
        (folder / mesh).write_bytes(content if isinstance(content, bytes) else content.encode())
    arm = write_arm(folder, upper=f'<geometry><mesh filename="{mesh}"/></geometry>')
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        robot = load_robot(arm, **options)  # type: ignore[arg-type]
        page = write_replay(robot, [0.0, 1.0], [angles(0.0, 0.0), angles(1.0, 1.0)], folder / "page.html")
    return read_page(page), [str(w.message) for w in told]


def carries(page: Page, content: bytes) -> bool:
    import base64

    texts = [page.text.encode(), *page.blobs]
    coded = base64.b64encode(content)[:60]
    return any(content[:40] in text or coded in text for text in texts)


def with_picture(folder: Path, path: str, kind: str = "obj", **options: object) -> tuple[Page, list[str]]:
    """The page of an arm whose mesh wears the picture of this path."""
    folder.mkdir(parents=True, exist_ok=True)
    if kind == "dae":
        return replay(folder, "mesh.dae", TEXTURED_DAE.format(picture=path, nodes=SHAPE), **options)
    (folder / "m.mtl").write_text(f"newmtl photo\nKd 1 0 0\nmap_Kd {path}\n")
    return replay(folder, "mesh.obj", PAINTED, **options)


@pytest.mark.parametrize("kind", ["obj", "dae"])
def test_pictures_below_the_robot_are_shown(tmp_path, kind):
    (tmp_path / "robot" / "textures").mkdir(parents=True)
    (tmp_path / "robot" / "textures" / "photo.png").write_bytes(PNG)
    page, told = with_picture(tmp_path / "robot", "textures/photo.png", kind)
    assert told == []
    assert carries(page, PNG)


@pytest.mark.parametrize("kind", ["obj", "dae"])
@pytest.mark.parametrize("way", ["relative", "absolute", "link", "folder_link", "scheme"])
def test_files_elsewhere_do_not_travel(tmp_path, way, kind):
    """Neither a secret text nor a private picture, however the path leads there."""
    folder = tmp_path / "downloads" / "robot"
    folder.mkdir(parents=True)
    for number, content in enumerate((SECRET, PNG)):
        private = tmp_path / "home" / f"private{number}.png"
        private.parent.mkdir(exist_ok=True)
        private.write_bytes(content)
        (folder / f"link{number}").symlink_to(private)
        if not (folder / "inner").is_symlink():
            (folder / "inner").symlink_to(private.parent)
        path = {
            "relative": f"../../home/private{number}.png",
            "absolute": str(private),
            "link": f"link{number}",
            "folder_link": f"inner/private{number}.png",
            "scheme": f"file://{private}",
        }[way]
        page, told = with_picture(folder, path, kind)
        assert not carries(page, content)
        assert "_meshfile" in page.text or "BufferGeometry" in page.text  # the mesh itself is shown
        if (kind, way) != ("obj", "scheme"):  # an OBJ knows no addresses: there is no such file
            (message,) = told
            assert "shown without its picture" in message
            assert "is outside the robot's folders" in message


def test_what_is_no_picture_does_not_travel(tmp_path):
    """Even from the robot's own folder."""
    tmp_path.joinpath("notes.png").write_bytes(SECRET)
    page, told = with_picture(tmp_path, "notes.png")
    assert not carries(page, SECRET)
    (message,) = told
    assert "is no picture that a page shows" in message


def test_pictures_of_a_package_are_shown(tmp_path):
    """Beside urdf/, and in a folder with a package.xml; package_dirs of a foreign file are no reason."""
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "photo.png").write_bytes(PNG)
    (tmp_path / "photo.png").write_bytes(PNG)
    page, told = with_picture(tmp_path / "urdf", "../photo.png")
    assert told == []
    assert carries(page, PNG)
    deep, path = tmp_path / "deep" / "robots", "../../other/photo.png"
    page, told = with_picture(deep, path, package_dirs=[tmp_path / "other"])
    assert not carries(page, PNG)
    assert "is outside the robot's folders" in told[0]
    (tmp_path / "package.xml").touch()
    page, told = with_picture(deep, path)
    assert (told, carries(page, PNG)) == ([], True)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (PNG, "png"),
        (b"\xff\xd8\xff\xe0 ...", "jpeg"),
        (b"GIF89a...", "gif"),
        (b"RIFF\0\0\0\0WEBPVP8 ", "webp"),
        (b"BM" + (30).to_bytes(4, "little") + b"\0" * 8 + (40).to_bytes(4, "little") + b"\0" * 12, "bmp"),
        (b"BM, which is how a letter may begin, too", None),
        (b"", None),
        (b"<svg/>", None),
    ],
)
def test_pictures_are_known_by_their_first_bytes(tmp_path, content, kind):
    path = tmp_path / "a"
    path.write_bytes(content)
    if kind is None:
        with pytest.raises(Exception, match="is no picture"):
            read_picture(path, (tmp_path,))
    else:
        assert read_picture(path, (tmp_path,)).kind == kind


def test_a_mesh_that_is_another_file_does_not_travel(tmp_path):
    """Not by its path, not by a link, and not behind or between triangles."""
    (tmp_path / "secret").write_bytes(SECRET)
    folder = tmp_path / "robot"
    folder.mkdir()
    for number, suffix in enumerate(("stl", "obj", "dae", "ply", "glb", "dat")):
        (folder / f"mesh{number}.{suffix}").symlink_to(tmp_path / "secret")
        page, told = replay(folder, f"mesh{number}.{suffix}", None)
        assert not carries(page, SECRET)
        assert any("cannot be read" in message for message in told)
    hidden = SECRET[:80] + stl()[80:] + SECRET
    page, told = replay(folder, "hidden.stl", hidden)
    assert told == []
    assert not carries(page, SECRET)
    assert (
        page.value(page.objects()["/replay/world/robot/shoulder/0_upper_0"]["geometries"][0]["data"]).size
        == 134
    )


def obj(*vertices: str, faces: str = "f 1 2 3") -> str:
    return "".join(f"v {v}\n" for v in vertices) + faces


WRONG = {
    "not a number": ("m.obj", obj("0 0 0", "1 0 nan", "0 1 0"), "a corner is not finite"),
    "infinite": ("m.obj", obj("0 0 0", "1e400 0 0", "0 1 0"), "a corner is not finite"),
    "huge": ("m.obj", obj("0 0 0", "1e30 0 0", "0 1 0"), "a corner is not finite, or beyond 1e"),
    "corner that is not there": ("m.obj", obj("0 0 0", faces="f 1 2 3"), "out of range"),
    "huge corner number": ("m.obj", obj("0 0 0", faces=f"f 1 1 1{'0' * 30}"), "which is not there"),
    "no triangle": ("m.obj", obj("0 0 0", "1 0 0", faces="f 1 2"), "no triangles in it"),
    "empty STL": ("m.stl", b"", "shorter than a header"),
    "STL of no triangle": ("m.stl", b"\0" * 84, "no triangles in it"),
    "STL that is cut off": ("m.stl", stl()[:-1], "declares 1 triangles and has room for 0"),
    "STL of billions": ("m.stl", b"\0" * 80 + b"\xff" * 4 + b"\0" * 50, "declares 4294967295 triangles"),
    "STL that is not finite": ("m.stl", stl(float("nan")), "a corner is not finite"),
    "STL with a signalling NaN": (
        "m.stl", stl()[:100] + b"\x01\x00\x80\x7f" + stl()[104:], "a corner is not finite"),
    "text STL": ("m.stl", "solid a\nvertex 0 0 0\nvertex 1 0 0\n", "not three a triangle"),
    "text STL of words": ("m.stl", "solid a\n" + 3 * "vertex a b c\n", "could not convert"),
    "node within itself": (
        "m.dae",
        TEXTURED_DAE.format(picture="a", nodes='<node id="n"><instance_node url="#n"/></node>'),
        "64 within each other",
    ),
    "nodes that repeat each other": (
        "m.dae",
        TEXTURED_DAE.format(
            picture="a",
            nodes="".join(
                f'<node id="n{k}">' + 9 * f'<instance_node url="#n{k + 1}"/>' + "</node>" for k in range(9)
            ),
        ),
        "more than 20000 nodes",
    ),
    "stride of zero": ("m.dae", SQUARE.replace('stride="3"', 'stride="0"'),
                       "a stride of 0"),
    "negative corner": ("m.dae", SQUARE.replace("0 1 2<", "0 1 -2<"),
                        "negative number"),
    "placement that is not finite": (
        "m.dae",
        SQUARE.replace(
            "<instance_geometry", "<scale>nan 1 1</scale><instance_geometry"),
        "a placement is not finite"),
    "encoding that nobody knows": (
        "m.dae", '<?xml version="1.0" encoding="nonsense"?>' + SQUARE, "unknown encoding: nonsense"),
    "corner beyond 64 bits": ("m.dae", SQUARE.replace("0 1 2<", f"0 1 1{'0' * 30}<"), "more than 64 bits"),
    "polygon of billions": (
        "m.dae",
        SQUARE.replace("triangles", "polylist").replace("<p>", "<vcount>4000000000000</vcount><p>"),
        "more corners than the 3",
    ),
    "a scene that reads other files": ("m.glb", b"glTF\2\0\0\0\0\0\0\0\x1e\0\0\0JSON" + json.dumps(
        {"buffers": [{"uri": "/etc/x"}]}).encode().ljust(30), "in other files|JSON is broken"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_broken_meshes_become_sticks(tmp_path, case):
    name, content, reason = WRONG[case]
    page, told = replay(tmp_path, name, content)
    assert any(reason.split("|")[0] in message or reason.split("|")[-1] in message for message in told), told
    assert all("drawn as a stick" in message for message in told)
    assert any("stick" in path for path in page.objects())


def test_numbers_that_only_colour_are_left_out(tmp_path):
    """NaN in normals and colours hides nothing of the mesh."""
    (tmp_path / "m.mtl").write_text("newmtl photo\nKd nan 0 0\n")
    text = PAINTED + "\nvn nan 0 0\n"
    page, told = replay(tmp_path, "mesh.obj", text.replace("f 1 3 2", "f 1//1 3//1 2//1"))
    assert told == []
    drawn = page.objects()["/replay/world/robot/shoulder/0_upper_0"]
    for attribute in drawn["geometries"][0]["data"]["attributes"].values():
        assert np.isfinite(page.value(attribute["array"])).all()


def test_sizes_are_bounded(tmp_path, monkeypatch):
    for module in ("triangles", "collada"):
        monkeypatch.setattr(f"mbocp.meshes.{module}.MESH_LIMIT", 100)
    _, told = replay(tmp_path, "m.stl", stl())
    assert "m.stl: mesh of 'upper_0' cannot be read: has 0.0 MB, expected an STL mesh of at most" in told[0]
    monkeypatch.undo()
    monkeypatch.setattr(visuals, "SCENE_LIMIT", 10)
    _, told = replay(tmp_path, "m.obj", OBJ)
    assert "all meshes and pictures have more than" in told[0]
    assert parts.MESH_LIMIT == 2**26


def test_stl_of_both_kinds(tmp_path):
    corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    text = f"solid a\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid\n"
    (tmp_path / "text.stl").write_text(text)
    (tmp_path / "binary.stl").write_bytes(stl())
    (tmp_path / "solid.stl").write_bytes(b"solid" + stl()[5:])  # a binary one may begin so, too
    for name in ("text", "binary", "solid"):
        (part,) = read_stl(tmp_path / f"{name}.stl")
        np.testing.assert_array_equal(part.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    again = binary_stl(read_stl(tmp_path / "text.stl")[0])
    np.testing.assert_array_equal(np.frombuffer(again, "<f4", 3, 84), [0, 0, 1])
    assert len(again) == len(stl())


def test_formats_that_are_not_known(tmp_path):
    (tmp_path / "m.gltf").write_text("{}")
    with pytest.raises(ValueError, match=r"convert it to one of \.stl, \.dae, \.obj, \.ply"):
        check_single_file(tmp_path / "m.gltf")
    (tmp_path / "m.ply").write_text("{}")
    with pytest.raises(ValueError, match=r"is no \.ply file"):
        check_single_file(tmp_path / "m.ply")
