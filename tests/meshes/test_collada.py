from __future__ import annotations

import numpy as np
import pytest

from mbocp.meshes.collada import read_collada
from mbocp.meshes.mesh_parts import Surface
from mbocp.robot import load_robot
from mbocp.view.replay import write_replay
from tests.view.pages import angles, read_page, write_arm

SQUARE = "0 0 0  1 0 0  1 1 0  0 1 0"


def source(name: str, numbers: str, stride: int) -> str:
    return (
        f'<source id="{name}"><float_array id="{name}-a">{numbers}</float_array><technique_common>'
        f'<accessor source="#{name}-a" stride="{stride}"/></technique_common></source>'
    )


def effect(name: str, diffuse: str) -> tuple[str, str]:
    profile = (
        '<newparam sid="s"><surface type="2D"><init_from>pic</init_from></surface></newparam>'
        '<newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>'
        f'<technique sid="c"><phong><diffuse>{diffuse}</diffuse>'
        "<transparency><float>0.9</float></transparency></phong></technique>"
    )
    return (
        f'<effect id="{name}-fx"><profile_COMMON>{profile}</profile_COMMON></effect>',
        f'<material id="{name}"><instance_effect url="#{name}-fx"/></material>',
    )


def collada(primitives: str, *, nodes: str = "", colours: dict[str, str] | None = None) -> str:
    made = [effect(name, diffuse) for name, diffuse in (colours or {}).items()]
    effects, materials = "".join(e for e, _ in made), "".join(m for _, m in made)
    bound = "".join(f'<instance_material symbol="{n}" target="#{n}"/>' for n in colours or {})
    bind = f"<bind_material><technique_common>{bound}</technique_common></bind_material>"
    instance = f'<instance_geometry url="#g">{bind}</instance_geometry>'
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        '<asset><unit name="metre" meter="1"/><up_axis>Y_UP</up_axis></asset>'
        '<library_images><image id="pic"><init_from>my%20pic.png</init_from></image></library_images>'
        f"<library_effects>{effects}</library_effects><library_materials>{materials}</library_materials>"
        f'<library_geometries><geometry id="g"><mesh>{source("p", SQUARE, 3)}{source("n", "0 0 1", 3)}'
        f"{source('w', '0 0 1 0 1 1 0 1', 2)}"
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f"{primitives}</mesh></geometry></library_geometries>"
        f'<library_visual_scenes><visual_scene id="scene"><node>{nodes}{instance}</node></visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene></COLLADA>'
    )


VERTEX = '<input semantic="VERTEX" source="#v" offset="0"/>'
NORMAL = '<input semantic="NORMAL" source="#n" offset="1"/>'
TEXCOORD = '<input semantic="TEXCOORD" source="#w" offset="1" set="0"/>'
TRIANGLES = f'<triangles count="2" material="a">{VERTEX}<p>0 1 2  0 2 3</p></triangles>'


def area(parts) -> np.ndarray:
    """Sum of the triangles' area vectors."""
    total = np.zeros(3)
    for part in parts:
        a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
        total += 0.5 * np.cross(b - a, c - a).sum(axis=0)
    return total


@pytest.fixture
def read(tmp_path):
    def write_and_read(text: str):
        path = tmp_path / "mesh.dae"
        path.write_text(text)
        return read_collada(path)

    return write_and_read


@pytest.mark.parametrize(
    "primitive",
    [
        TRIANGLES,
        f'<triangles count="2">{VERTEX}{NORMAL}<p>0 0 1 0 2 0  0 0 2 0 3 0</p></triangles>',
        f'<polylist count="1">{VERTEX}<vcount>4</vcount><p>0 1 2 3</p></polylist>',
        f'<polylist count="2">{VERTEX}<vcount>3 3</vcount><p>0 1 2 0 2 3</p></polylist>',
        f'<polygons count="1">{VERTEX}<p>0 1 2 3</p></polygons>',
        f'<tristrips count="1">{VERTEX}<p>0 1 3 2</p></tristrips>',
        f'<lines count="1">{VERTEX}<p>0 1</p></lines>{TRIANGLES}',
    ],
    ids=[
        "triangles",
        "normals",
        "polylist",
        "polylist of triangles",
        "polygons",
        "tristrips",
        "lines beside",
    ],
)
def test_every_primitive_covers_the_square_once(read, primitive):
    assert area(read(collada(primitive))) == pytest.approx([0.0, 0.0, 1.0])


def test_unit_counts_and_up_axis_does_not(read):
    (part,) = read(collada(TRIANGLES).replace('meter="1"', 'meter="0.001"'))
    assert part.vertices.max(axis=0) == pytest.approx([0.001, 0.001, 0.0])


@pytest.mark.parametrize("length", ["1", "1e-200", "1e200", "1e308"])
def test_node_transformations_multiply_in_order(read, length):
    """An axis has a direction, however long it is."""
    steps = f"<translate>0 0 5</translate><rotate>0 0 {length} 90</rotate><scale>2 1 1</scale>"
    (part,) = read(collada(TRIANGLES, nodes=steps))
    assert part.vertices.min(axis=0) == pytest.approx([-1.0, 0.0, 5.0])
    assert part.vertices.max(axis=0) == pytest.approx([0.0, 2.0, 5.0])


@pytest.mark.parametrize("steps", ["<scale>1e308 1 1</scale>" * 2 + "<scale>0 1 1</scale>"])
def test_placements_beyond_all_numbers_are_refused(read, steps):
    with pytest.raises(ValueError, match="a placement is not finite"):
        read(collada(TRIANGLES, nodes=steps))


def test_mirror_keeps_the_outside_out(read):
    (part,) = read(collada(f'<triangles count="1">{VERTEX}{NORMAL}<p>0 0 1 0 2 0</p></triangles>',
                           nodes="<matrix>-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix>"))  # fmt: skip
    a, b, c = part.vertices[part.faces[0]]
    assert np.cross(b - a, c - a) @ part.normals[0] > 0.0


def test_colours_and_pictures(read, tmp_path):
    two = TRIANGLES + TRIANGLES.replace('"a"', '"b"').replace(VERTEX, VERTEX + TEXCOORD).replace(
        "0 1 2  0 2 3", "0 0 1 1 2 2"
    )
    colours = {"a": "<color>1 0.5 0 1</color>", "b": '<texture texture="t" texcoord="uv"/>'}
    plain, pictured = read(collada(two, colours=colours))
    assert plain.surface == Surface((1.0, 0.5, 0.0))
    assert plain.uvs is None
    assert pictured.surface.image is None  # the file is missing
    (tmp_path / "my pic.png").write_bytes(b"picture")
    plain, pictured = read(collada(two, colours=colours))
    assert pictured.surface.image == tmp_path / "my pic.png"
    assert pictured.uvs.shape == (3, 2)


@pytest.mark.parametrize(
    ("colour", "urdf", "expected"),
    [
        ("1 0 0 1", True, 0xFF0000),  # it paints itself: RViz, too, lets it
        ("0.8 0.8 0.8 1", True, 0x0000FF),  # an exporter's grey gives way to the URDF
        ("0.8 0.8 0.8 1", False, 0xCCCCCC),
    ],
)
def test_a_grey_mesh_takes_the_colour_of_the_urdf(tmp_path, colour, urdf, expected):
    (tmp_path / "m.dae").write_text(collada(TRIANGLES, colours={"a": f"<color>{colour}</color>"}))
    blue = '<material name="b"><color rgba="0 0 1 1"/></material>' if urdf else ""
    arm = write_arm(tmp_path, upper=f'<geometry><mesh filename="m.dae"/></geometry>{blue}')
    page = read_page(write_replay(load_robot(arm), [0.0], [angles(0, 0)], tmp_path / "r.html"))
    drawn = next(o for path, o in page.objects().items() if "upper_0" in path)
    assert [material["color"] for material in drawn["materials"]] == [expected]
    assert drawn["materials"][0]["opacity"] == 1.0  # exporters' transparency is not to be trusted


def test_parts_with_and_without_texture_share_one_geometry(tmp_path):
    two = TRIANGLES + TRIANGLES.replace('"a"', '"b"').replace(VERTEX, VERTEX + TEXCOORD).replace(
        "0 1 2  0 2 3", "0 0 1 1 2 2"
    )
    colours = {"a": "<color>0 0 0 1</color>", "b": '<texture texture="t" texcoord="uv"/>'}
    (tmp_path / "m.dae").write_text(collada(two, colours=colours))
    (tmp_path / "my pic.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"x" * 600)
    arm = write_arm(tmp_path, upper='<geometry><mesh filename="m.dae"/></geometry>')
    page = read_page(write_replay(load_robot(arm), [0.0], [angles(0, 0)], tmp_path / "r.html"))
    drawn = next(o for path, o in page.objects().items() if "upper_0" in path)
    data = drawn["geometries"][0]["data"]
    assert [(g["start"], g["count"]) for g in data["groups"]] == [(0, 6), (6, 3)]
    counts = {len(page.value(a["array"])) // a["itemSize"] for a in data["attributes"].values()}
    assert counts == {7}
    assert set(data["attributes"]) == {"position", "normal", "uv"}
    assert page.value(drawn["images"][0]["url"]).startswith("data:image/png;base64,")
    assert len(drawn["object"]["material"]) == 2


@pytest.mark.parametrize("stride", [0, 2**32])
def test_strides_that_no_mesh_has_are_refused(read, stride):
    with pytest.raises(ValueError, match=f"a stride of {stride}"):
        read(collada(TRIANGLES).replace('stride="3"', f'stride="{stride}"'))


def test_a_file_without_its_data_is_refused(read):
    text = collada(f'<triangles count="1">{VERTEX}{TEXCOORD}<p>0 0 1 1 2 2</p></triangles>')
    with pytest.raises(ValueError, match="no data '#w'"):
        read(text.replace('<source id="w">', '<source id="gone">'))
