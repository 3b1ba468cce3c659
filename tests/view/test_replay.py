from __future__ import annotations

import re
import warnings

import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import ReplayError, ResultFileError, UnknownFrame
from mbocp.robot import FrameTarget, MissingMeshWarning, load_robot
from mbocp.view.replay import write_replay
from tests.view.pages import OBJ, Page, angles, read_page, stl, write_arm

BOX = '<geometry><box size="0.1 0.1 1"/></geometry><material name="m"><color rgba="1 0.5 0 1"/></material>'


@pytest.fixture(scope="module")
def ur5_page(tmp_path_factory):
    robot = load_robot("ur5")
    t = np.linspace(0.0, 1.5, 31)
    qs = np.linspace(0.0, 1.0, 31)[:, None] * np.array([1.0, -1.2, 0.8, 0.3, -0.5, 0.2])
    path = write_replay(robot, t, qs, tmp_path_factory.mktemp("ur5") / "ur5.html", title="A <reach> & back")
    return robot, t, qs, read_page(path)


def shown(folder, robot, t, qs, **options) -> Page:
    return read_page(write_replay(robot, t, qs, folder / "replay.html", **options))


def test_page_loads_nothing_from_elsewhere(ur5_page):
    page = ur5_page[3]
    assert "<link" not in page.text
    assert not re.search(r"<(script|img|iframe)[^>]*\ssrc=", page.text)
    assert not re.search(r"@import|url\(\s*['\"]?(http|file|//)", page.text)
    player = page.text[page.text.index("Unpacks the scene") :]
    assert not re.search(r"https?://|wss?://", player)
    assert "MeshCat" in page.text


def test_every_visual_is_drawn_below_its_joint(ur5_page):
    robot, _, _, page = ur5_page
    drawn = page.objects("/replay/world/robot")
    assert len(drawn) == len(robot.visual_model.geometryObjects) == 7
    for visual in robot.visual_model.geometryObjects:
        joint = robot.model.names[visual.parentJoint]
        assert any(path.startswith(f"/replay/world/robot/{joint}/") and visual.name in path for path in drawn)


def test_animation_is_forward_kinematics_at_true_speed(ur5_page):
    robot, t, qs, page = ur5_page
    data = robot.model.createData()
    tracks = page.tracks()
    for key in (0, 17, -1):
        for j in range(1, robot.model.njoints):
            node = f"/replay/world/robot/{robot.model.names[j]}"
            times, positions = tracks[node, "position"]
            quaternions = tracks[node, "quaternion"][1]
            q = np.array([np.interp(times[key], t, column) for column in qs.T])
            pin.forwardKinematics(robot.model, data, q)
            expected = pin.SE3ToXYZQUAT(data.oMi[j])
            assert positions[key] == pytest.approx(expected[:3], abs=1e-6)
            assert abs(quaternions[key] @ expected[3:]) == pytest.approx(1.0, abs=1e-6)
            assert times[0] == 0.0
            assert times[-1] == pytest.approx(1.5)
    clip = page.scene["animation"]["animations"][0]["clip"]
    assert clip["fps"] == 1  # key times are seconds
    assert clip["duration"] >= 1.5
    assert page.scene["speed"] == 1.0
    assert page.scene["animation"]["options"]["play"] is True


def test_trace_follows_the_frame(ur5_page):
    robot, _, qs, page = ur5_page
    (path, tube), *others = page.objects("/replay/world/trace").items()
    assert not others
    assert path.endswith(robot.trace_frames[0])
    points = page.value(tube["geometries"][0]["data"]["attributes"]["position"]["array"]).reshape(-1, 3)
    data = robot.model.createData()
    for q, end in ((qs[0], points[-2]), (qs[-1], points[-1])):  # the caps' centres
        pin.framesForwardKinematics(robot.model, data, q)
        frame = data.oMf[robot.frame_id(robot.trace_frames[0])]
        assert end == pytest.approx(frame.translation, abs=1e-5)


def test_title_is_text_not_markup(ur5_page):
    page = ur5_page[3]
    assert "<title>A &lt;reach&gt; &amp; back</title>" in page.text
    assert "<reach>" not in page.text


@pytest.mark.parametrize(
    ("name", "duration"), [("ur5", 0.0), ("elastic_pendulum", 2.0), ("hector", 1.0), ("double_pendulum", 3.0)]
)
def test_camera_holds_the_whole_motion(tmp_path, name, duration):
    robot = load_robot(name)
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, duration, 20) if duration else np.zeros(1)
    step = rng.uniform(-0.1, 0.1, robot.nv)
    qs = np.array([robot.integrate(robot.q0, k * step) for k in range(len(t))])
    page = shown(tmp_path, robot, t, qs)
    target = -page.transform("/replay")[:3, 3]
    offset = np.array(page.scene["camera"]["offset"])
    assert page.property("/Cameras/default/rotated/<object>", "position") == pytest.approx(
        [offset[0], offset[2], -offset[1]]
    )
    back = offset / np.linalg.norm(offset)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    half = np.tan(np.deg2rad(page.property("/Cameras/default/rotated/<object>", "fov")) / 2.0)
    data = robot.model.createData()
    for q in qs:
        pin.framesForwardKinematics(robot.model, data, q)
        for frame in [*data.oMf[1:], *data.oMi[1:]]:
            seen = target + offset - frame.translation
            depth, side, height = seen @ back, -seen @ right, -seen @ np.cross(back, right)
            assert depth > page.property("/Cameras/default/rotated/<object>", "near")
            assert abs(height) < half * depth
            assert abs(side) < half * 1.5 * depth


def test_meshes_keep_scale_and_colour(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "b.stl").write_bytes(stl())
    red = '<material name="r"><color rgba="1 0 0 0.5"/></material>'
    arm = write_arm(
        tmp_path,
        base=f'<geometry><mesh filename="a.obj" scale="0.1 -0.2 0.3"/></geometry>{red}',
        upper='<origin xyz="0 0 0.5"/><geometry><mesh filename="b.stl" scale="2 2 2"/></geometry>',
        lower=BOX,
    )
    page = shown(tmp_path, load_robot(arm), [0.0, 1.0], [angles(0, 0), angles(1, 1)])
    objects = page.objects("/replay/world/robot")
    base, upper, lower = (
        next(o for p, o in objects.items() if n in p) for n in ("base_0", "upper_0", "lower_0")
    )
    assert np.diag(np.reshape(base["object"]["matrix"], (4, 4))) == pytest.approx([0.1, -0.2, 0.3, 1.0])
    assert np.diag(np.reshape(upper["object"]["matrix"], (4, 4))) == pytest.approx([2.0, 2.0, 2.0, 1.0])
    assert base["materials"][0]["color"] == 0xFF0000
    assert base["materials"][0]["opacity"] == 0.5
    assert lower["materials"][0]["color"] == 0xFF8000
    corners = page.value(base["geometries"][0]["data"]["attributes"]["position"]["array"]).reshape(-1, 3)
    assert corners.max(axis=0) == pytest.approx([1.0, 1.0, 2.0])
    assert page.value(upper["geometries"][0]["data"]).tobytes() == stl()
    for path in page.commands("set_transform", "/replay/world"):  # what is animated is a placement, no scale
        rotation = page.transform(path)[:3, :3]
        assert rotation.T @ rotation == pytest.approx(np.eye(3), abs=1e-9)
    assert page.transform(next(p for p in objects if "upper_0" in p))[:3, 3] == pytest.approx([0, 0, 0.5])


def test_equal_meshes_are_stored_once_and_equal_motions_give_equal_files(tmp_path):
    robot = load_robot("iris")  # four rotors, two meshes
    qs = np.array([robot.q0, robot.integrate(robot.q0, np.full(robot.nv, 0.1))])
    page = shown(tmp_path, robot, [0.0, 1.0], qs)
    rotors = [o for p, o in page.objects("/replay/world/robot").items() if "rotor" in p]
    stored = {o["geometries"][0]["data"]["attributes"]["position"]["array"]["$blob"] for o in rotors}
    assert (len(rotors), len(stored)) == (4, 2)
    assert shown(tmp_path, robot, [0.0, 1.0], qs).text == page.text


def test_coarse_motion_is_interpolated_on_the_manifold(tmp_path):
    arm = load_robot(write_arm(tmp_path, upper=BOX, lower=BOX))
    page = shown(
        tmp_path, arm, [0.0, 1.0], [angles(3.0, 0.0), angles(-3.0, 0.0)]
    )  # through pi, not through 0
    times, quaternions = page.tracks()["/replay/world/robot/shoulder", "quaternion"]
    assert len(times) == 61
    middle = quaternions[30]
    assert abs(middle) == pytest.approx([0.0, 1.0, 0.0, 0.0], abs=1e-6)  # half a turn about y
    assert np.linalg.norm(quaternions, axis=1) == pytest.approx(np.ones(61), abs=1e-6)


def test_dense_motion_is_thinned_to_the_screen(tmp_path):
    arm = load_robot(write_arm(tmp_path, upper=BOX, lower=BOX))
    t = np.linspace(5.0, 7.0, 20001)
    qs = np.array([angles(a, -a) for a in np.linspace(0.0, 1.0, 20001)])
    times, positions = shown(tmp_path, arm, t, qs).tracks()["/replay/world/robot/elbow", "position"]
    assert len(times) == 121
    assert (times[0], times[-1]) == (0.0, pytest.approx(2.0))
    assert positions[-1] == pytest.approx([np.sin(1.0), 0.0, 0.2 + np.cos(1.0)], abs=1e-6)


def test_slow_motion_shows_more_poses(tmp_path):
    arm = load_robot(write_arm(tmp_path, upper=BOX, lower=BOX))
    page = shown(tmp_path, arm, [0.0, 1.0], [angles(0, 0), angles(1, 1)], speed=0.1)
    times, _ = page.tracks()["/replay/world/robot/elbow", "position"]
    assert (len(times), times[-1], page.scene["speed"]) == (601, pytest.approx(1.0), 0.1)


def test_spring_stretches_with_the_motion(tmp_path):
    robot = load_robot("elastic_pendulum")
    qs = np.array([[0.0, 0.0, -3.0], [0.0, 4.0, -3.0], [6.0, 0.0, -8.0]])
    page = shown(tmp_path, robot, [0.0, 0.5, 1.0], qs)
    ((node, coil),) = page.objects("/replay/world/connectors").items()
    points = page.value(coil["geometries"][0]["data"]["attributes"]["position"]["array"]).reshape(-1, 3)
    tracks = page.tracks()
    times, scales = tracks[node, "scale"]
    for time, bob in ((0.0, qs[0]), (0.5, qs[1]), (1.0, qs[2])):
        k = int(np.argmin(abs(times - time)))
        turn = pin.XYZQUATToSE3(np.array([0.0, 0.0, 0.0, *tracks[node, "quaternion"][1][k]]))
        tip = turn.rotation @ (scales[k] * points[-1])
        assert tip == pytest.approx(bob, abs=1e-5)
    assert (node, "position") not in tracks  # it hangs on the world


def test_missing_mesh_and_no_mesh_become_sticks(tmp_path):
    arm = write_arm(tmp_path, upper='<geometry><mesh filename="none.stl"/></geometry>', lower=BOX)
    with pytest.warns(MissingMeshWarning):
        robot = load_robot(arm)
    objects = shown(tmp_path, robot, [0.0, 1.0], [angles(0, 0), angles(1, 1)]).objects("/replay/world/robot")
    assert {path.split("/")[4] for path in objects if "stick" in path} == {"shoulder"}

    bare = load_robot(write_arm(tmp_path))
    objects = shown(tmp_path, bare, [0.0, 1.0], [angles(0, 0), angles(1, 1)]).objects("/replay/world/robot")
    assert {path.split("/")[4] for path in objects} >= {"shoulder", "elbow"}


def test_broken_mesh_warns_and_becomes_a_stick(tmp_path):
    (tmp_path / "broken.dae").write_text("<COLLADA>")
    arm = load_robot(
        write_arm(tmp_path, upper='<geometry><mesh filename="broken.dae"/></geometry>', lower=BOX)
    )
    with pytest.warns(UserWarning, match=r"broken\.dae: mesh of 'upper_0' cannot be read"):
        page = shown(tmp_path, arm, [0.0, 1.0], [angles(0, 0), angles(1, 1)])
    assert any("shoulder/stick" in path for path in page.objects())


def test_the_floor_is_below_whatever_way_gravity_points(tmp_path):
    arm = load_robot(write_arm(tmp_path, upper=BOX, lower=BOX), gravity=(9.81, 0.0, 0.0))
    page = shown(tmp_path, arm, [0.0, 1.0], [angles(0, 0), angles(1, 1)])
    assert page.transform("/replay/world")[:3, :3] @ [1.0, 0.0, 0.0] == pytest.approx(
        [0.0, 0.0, -1.0], abs=1e-12
    )
    weightless = load_robot(write_arm(tmp_path, upper=BOX, lower=BOX), gravity=(0.0, 0.0, 0.0))
    page = shown(tmp_path, weightless, [0.0, 1.0], [angles(0, 0), angles(1, 1)])
    assert page.transform("/replay/world") == pytest.approx(np.eye(4))


def test_one_pose_is_a_picture(tmp_path):
    page = shown(tmp_path, load_robot(write_arm(tmp_path, upper=BOX)), [0.0], [angles(0.3, 0.1)])
    assert page.scene["animation"] is None
    assert "one pose" in page.text


@pytest.mark.parametrize(
    ("t", "qs", "options", "match"),
    [
        ([0.0, 1.0], [angles(0, 0)], {}, "one configuration for each time"),
        ([0.0, 1.0], [[0.0, 0.0], [0.0, 0.0]], {}, r"expected \(any, 4\)"),
        ([0.0, 0.0], [angles(0, 0)] * 2, {}, "increasing times"),
        ([0.0, 1.0], [angles(0, 0), angles(0, np.nan)], {}, "NaN or infinity at step 1"),
        ([0.0, 1.0], [angles(0, 0)] * 2, {"speed": 0.0}, "speed: got 0.0, expected a positive number"),
        ([], np.empty((0, 4)), {}, "one configuration for each time"),
    ],
)
def test_bad_input_is_refused(tmp_path, t, qs, options, match):
    arm = load_robot(write_arm(tmp_path))
    with pytest.raises(ReplayError, match=match):
        write_replay(arm, t, qs, tmp_path / "replay.html", **options)
    assert not (tmp_path / "replay.html").exists()


def test_unknown_trace_frame_is_named(tmp_path):
    arm = load_robot(write_arm(tmp_path))
    with pytest.raises(UnknownFrame, match="did you mean 'tip'"):
        write_replay(arm, [0.0], [angles(0, 0)], tmp_path / "replay.html", trace=["tipp"])


def test_failed_writing_leaves_the_old_file(tmp_path, monkeypatch):
    arm = load_robot(write_arm(tmp_path, upper=BOX))
    target = tmp_path / "replay.html"
    target.write_text("old")
    with pytest.raises(ResultFileError, match="does not exist"):
        write_replay(arm, [0.0], [angles(0, 0)], tmp_path / "nowhere" / "replay.html")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(ResultFileError, match="No space left on device"):
        write_replay(arm, [0.0], [angles(0, 0)], target)
    assert target.read_text() == "old"
    assert {p.name for p in tmp_path.iterdir()} == {"arm.urdf", "replay.html"}


def test_nothing_warns_for_a_whole_robot(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot = load_robot("kinova")
        write_replay(robot, [0.0], [robot.q0], tmp_path / "kinova.html")


def test_goals_of_frames_are_drawn_as_axes(tmp_path):
    robot = load_robot("ur5")
    qs = np.array([robot.q0, robot.integrate(robot.q0, [0.1, -0.5, 0.4, 0.0, 0.2, 0.0])])
    goals = [
        FrameTarget(name="tool0", position=[0.3, None, 0.5], axis=[0, 0, 1], direction=[0, 0, -1]),
        FrameTarget(name="tool0", orientation=[0, 0, 0, 1], relative_to="forearm_link"),
    ]
    page = read_page(write_replay(robot, [0.0, 1.0], qs, tmp_path / "goal.html", goals=goals))
    assert len(page.objects("/replay/world/goals")) == 6
    placed = page.transform("/replay/world/goals/0_tool0")
    reached = robot.frame_placement("tool0", qs[-1])
    assert placed[:3, 3] == pytest.approx([0.3, reached.translation[1], 0.5])
    assert placed[:3, 2] == pytest.approx([0, 0, -1])
    relative = page.transform("/replay/world/goals/1_tool0")
    assert relative[:3, :3] == pytest.approx(robot.frame_placement("forearm_link", qs[-1]).rotation)
    assert relative[:3, 3] == pytest.approx(reached.translation)
