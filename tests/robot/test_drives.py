"""Drives: speeds and controls to velocities and back, and each way of giving a drive wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import (
    InvalidValue,
    MbocpError,
    RobotError,
    RobotFileError,
    UnknownFrame,
    UnknownJoint,
    UnsupportedRobot,
)
from mbocp.robot import Drive, Robot, SingularMassMatrix, describe, load_robot, robot_from_spec
from tests.robot import urdfs
from tests.robot.urdfs import link

STRAIGHT = '<origin xyz="0 0 0"/>'


def joint(
    name: str, kind: str, parent: str, child: str, axis: str = "0 0 1", extra: str = urdfs.LIMIT
) -> str:
    """A joint at the parent's origin."""
    text = urdfs.joint(name, kind, parent, child, axis=axis, extra=extra)
    return text.replace('<origin xyz="0.3 0 0.1" rpy="0.1 0.2 0.3"/>', STRAIGHT)


# Sliders x, y; on the second a cart that turns, with an arm; beside the cart a bob on a ball joint.
CART = urdfs.robot(
    *(link(name, None) for name in ("ground", "slide_x", "slide_y")),
    *(link(name) for name in ("cart", "arm", "bob")),
    joint("x", "prismatic", "ground", "slide_x", "1 0 0"),
    joint("y", "prismatic", "slide_x", "slide_y", "0 1 0"),
    joint("turn", "revolute", "slide_y", "cart"),
    urdfs.joint("shoulder", "revolute", "cart", "arm", axis="0 1 0"),
    joint("swing", "floating", "slide_y", "bob"),
)
LONG = '[[drive]]\nname = "forward"\nframe = "cart"\ndirection = [3, 4, 0]\njoints = ["x", "y"]\n'
FORWARD = LONG + 'control = "acceleration"\n'
TURN = '[[drive]]\njoint = "turn"\ncontrol = "acceleration"\nlimit = 3.5\n'
BALL = 'spherical = ["swing"]\n'


def load(folder: Path, toml: str, urdf: str = CART, **options: object) -> Robot:
    return load_robot(urdfs.write(folder, urdf, toml), **options)  # type: ignore[arg-type]


def samples(robot: Robot, count: int = 5) -> list[tuple[Array, Array, Array]]:
    """Configurations, speeds and controls at random."""
    rng = np.random.default_rng(7)
    return [
        (
            np.array(pin.integrate(robot.model, robot.neutral(), rng.uniform(-3, 3, robot.nv))),
            rng.standard_normal(robot.num_speeds),
            rng.standard_normal(robot.nu),
        )
        for _ in range(count)
    ]


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load(tmp_path_factory.mktemp("cart"), BALL + TURN + FORWARD)


@pytest.fixture(scope="module")
def turntable(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """The same without the arm, whose turning may jump: nothing feels it."""
    toml = 'lock = ["shoulder"]\n' + BALL + TURN.replace("acceleration", "velocity") + FORWARD
    return load(tmp_path_factory.mktemp("turntable"), toml)


def test_without_drives_speeds_are_velocities() -> None:
    robot = load_robot("solo12")
    q, v = robot.q0, np.arange(float(robot.nv))
    assert (robot.drives, robot.driven, robot.num_speeds) == ((), (), robot.nv)
    assert robot.speed_labels == robot.v_labels
    np.testing.assert_array_equal(robot.speed_map(q), np.eye(robot.nv))
    np.testing.assert_array_equal(robot.control_velocity_map(q), np.zeros((robot.nv, robot.nu)))
    np.testing.assert_array_equal(robot.speeds(q, v), v)
    assert robot.drive_forces(q, v, v).shape == (0,)


def test_what_a_robot_with_drives_has(cart: Robot, turntable: Robot) -> None:
    # Pinocchio's order: x, y, swing (3), turn, shoulder; the motor of "shoulder" is the URDF's.
    assert cart.joint_names == ("x", "y", "swing", "turn", "shoulder")
    assert [str(label) for label in cart.u_labels] == ["shoulder [N m]", "turn [rad/s^2]", "forward [m/s^2]"]
    assert cart.driven == (0, 1, 5)
    assert [str(label) for label in cart.speed_labels] == [
        "swing.wx [rad/s]", "swing.wy [rad/s]", "swing.wz [rad/s]", "shoulder [rad/s]",
        "turn [rad/s]", "forward [m/s]",
    ]  # fmt: skip
    np.testing.assert_array_equal(cart.limits.effort, [3.0, 3.5, np.inf])
    assert cart.actuation.selection.shape == (7, 1)
    assert [str(label) for label in turntable.u_labels] == ["turn [rad/s]", "forward [m/s^2]"]
    assert turntable.num_speeds == 4
    np.testing.assert_array_equal(cart.drives[1].direction, [0.6, 0.8, 0.0])


def test_the_limit_of_a_joints_speed_is_the_urdfs(tmp_path: Path) -> None:
    toml = BALL + 'lock = ["shoulder"]\n[[drive]]\njoint = "turn"\ncontrol = "velocity"\n' + FORWARD
    robot = load(tmp_path, toml)
    np.testing.assert_array_equal(robot.limits.effort, [4.0, np.inf])
    assert robot.u_labels[0].unit == "rad/s"


def test_a_drive_moves_its_frame_along_its_direction(cart: Robot) -> None:
    forward = cart.num_speeds - 1
    frame = cart.frame_id("cart")
    for q, _, _ in samples(cart):
        data = cart.model.createData()
        v = cart.speed_map(q)[:, forward]
        pin.forwardKinematics(cart.model, data, q, v)
        pin.updateFramePlacements(cart.model, data)
        velocity = pin.getFrameVelocity(cart.model, data, frame, pin.LOCAL)
        np.testing.assert_allclose(velocity.linear, cart.drives[1].direction, atol=1e-14)


@pytest.mark.parametrize("name", ["cart", "turntable"])
def test_speeds_and_velocities(name: str, request: pytest.FixtureRequest) -> None:
    robot: Robot = request.getfixturevalue(name)
    for q, s, u in samples(robot):
        V, U = robot.speed_map(q), robot.control_velocity_map(q)
        assert (V.shape, U.shape) == ((robot.nv, robot.num_speeds), (robot.nv, robot.nu))
        np.testing.assert_allclose(V.T @ V, np.eye(robot.num_speeds), atol=1e-14)
        np.testing.assert_allclose(V.T @ U, 0.0, atol=1e-14)
        np.testing.assert_allclose(robot.speeds(q, V @ s + U @ u), s, atol=1e-13)


def test_velocities_that_drives_do_not_allow(cart: Robot) -> None:
    v = np.zeros(cart.nv)
    v[:2] = 0.8, -0.6  # across the direction at the initial pose
    with pytest.raises(
        InvalidValue, match=r"v of 'x', 'y': got x = 0.8, y = -0.6, .* drive 'forward' allows, such as"
    ):
        cart.speeds(cart.q0, v)


def test_drives_have_no_column_in_the_actuation(cart: Robot) -> None:
    B = cart.actuation_matrix(cart.q0)
    assert B.shape == (cart.nv, cart.nu)
    np.testing.assert_array_equal(B[:, 1:], 0.0)
    np.testing.assert_array_equal(B[:, 0], np.eye(cart.nv)[6])


def test_forces_of_drives_supply_the_power(cart: Robot) -> None:
    """Rate of the energy: power of the drives and of the motor."""
    rng = np.random.default_rng(3)
    step = 1e-5
    for q, s, u in samples(cart, 3):
        V = cart.speed_map(q)
        v = V @ s
        ahead = np.array(pin.integrate(cart.model, q, step * v))
        behind = np.array(pin.integrate(cart.model, q, -step * v))
        ds = rng.standard_normal(cart.num_speeds)
        a = V @ ds + (cart.speed_map(ahead) - cart.speed_map(behind)) @ s / (2 * step)
        # What the undriven joints need beyond the motor is supplied by nobody: take it from the balance.
        needed = pin.rnea(cart.model, cart.model.createData(), q, v, a)
        free = [dof for dof in range(cart.nv) if dof not in cart.driven]
        power = needed[free] @ v[free] + cart.drive_forces(q, v, a) @ s[-2:]
        rate = (_energy(cart, ahead, v + step * a) - _energy(cart, behind, v - step * a)) / (2 * step)
        np.testing.assert_allclose(power, rate, rtol=1e-6)
        acting = cart.drive_forces(q, v, a, u=u)  # the motor of the shoulder does not act on what drives move
        np.testing.assert_allclose(acting, cart.drive_forces(q, v, a), rtol=1e-12)


def _energy(robot: Robot, q: Array, v: Array) -> float:
    return float(0.5 * v @ robot.mass_matrix(q) @ v + robot.potential_energy(q))


def test_forces_of_drives_with_springs_rods_and_thrusters(tmp_path: Path) -> None:
    toml = (
        BALL + TURN + FORWARD + '[[spring]]\nframes = ["cart", "world"]\nstiffness = 4.0\nlength = 0.7\n'
        '[[constraint]]\ntype = "rod"\nframes = ["arm", "bob"]\nlength = 0.3\n'
        '[[actuator]]\ntype = "thruster"\nframe = "arm"\n[initial]\nq = {x = 0.3}\n'
    ).replace('frames = ["arm", "bob"]\nlength = 0.3\n', 'frames = ["arm", "world"]\n')
    robot = load(tmp_path, toml)
    (q, s, u) = samples(robot)[0]
    v, a, lam = robot.speed_map(q) @ s, np.arange(float(robot.nv)), np.array([0.7])
    motion = pin.rnea(robot.model, robot.model.createData(), q, v, a)
    total = motion - robot.force_elements(q, v) - robot.actuation_matrix(q) @ u
    total += robot.constraint_jacobian(q).T @ lam
    S = robot.speed_map(q)[:, -2:]
    np.testing.assert_allclose(robot.drive_forces(q, v, a, u, lam), S.T @ total, rtol=1e-12)


def test_driven_joints_need_no_mass(tmp_path: Path) -> None:
    urdf = urdfs.robot(
        link("ground"), link("rail", None), link("bob"),
        joint("slide", "prismatic", "ground", "rail", "1 0 0"),
        joint("empty", "prismatic", "rail", "nothing", "0 1 0"),
        link("nothing", None),
        joint("pivot", "revolute", "rail", "bob", "0 1 0"),
    )  # fmt: skip
    robot = load(tmp_path, '[[drive]]\njoint = "empty"\ncontrol = "velocity"\n', urdf)
    assert robot.driven == (1,)
    with pytest.raises(SingularMassMatrix, match="moves with 'empty'"):
        load(tmp_path, "", urdf)


def test_fingerprint(cart: Robot, tmp_path: Path) -> None:
    same = load(tmp_path, BALL + TURN + FORWARD, rotations="dcm")
    assert same.fingerprint == cart.fingerprint
    prints = {
        load(tmp_path, BALL + toml).fingerprint
        for toml in (
            "",
            TURN + FORWARD,
            TURN + FORWARD.replace("3, 4", "4, 3"),
            TURN + FORWARD.replace('"x", "y"', '"y", "x"'),
            FORWARD + TURN,
            FORWARD,
        )
    }
    assert len(prints) == 6


def test_describe(cart: Robot, turntable: Robot) -> None:
    facts = describe(cart)
    assert facts["rotations"] == "quaternion"
    assert [joint["driven"] for joint in facts["joints"]] == [True, True, False, True, False]
    assert [joint["actuated"] for joint in facts["joints"]] == [False] * 4 + [True]
    turn, forward = facts["drives"]
    assert turn == {
        "name": "turn", "control": "acceleration", "unit": "rad/s^2", "joints": ["turn"], "frame": None,
        "direction": None,
    }  # fmt: skip
    assert (forward["joints"], forward["frame"]) == (["x", "y"], "cart")
    assert [speed["name"] for speed in describe(turntable)["speeds"]][-1] == "forward"


# Rotations


def test_rotations(tmp_path: Path) -> None:
    robot = load(tmp_path, BALL)
    assert robot.rotations == "quaternion"
    assert load(tmp_path, BALL + 'rotations = "dcm"\n').rotations == "dcm"
    assert load(tmp_path, BALL + 'rotations = "dcm"\n', rotations="quaternion").rotations == "quaternion"
    for rotations in ("quaternion", "dcm"):
        again = robot_from_spec(load_robot(tmp_path, rotations=rotations).spec)
        assert again.rotations == rotations
    assert robot_from_spec({"name": "solo12", "rotations": "dcm"}).rotations == "dcm"
    with pytest.raises(InvalidValue, match=r"rotations: got 'euler', expected \"quaternion\" \| \"dcm\""):
        load(tmp_path, BALL, rotations="euler")
    with pytest.raises(RobotFileError, match=r"rotations: got 'euler', expected \"quaternion\" \| \"dcm\""):
        load(tmp_path, 'rotations = "euler"\n')


# Ball joints


def test_a_ball_joint_moves_like_the_floating_joint_that_does_not_slide(tmp_path: Path) -> None:
    floating, ball = load(tmp_path, ""), load(tmp_path, BALL)
    kept = [0, 1, 5, 6, 7, 8, 9]  # without the three displacements
    assert (ball.nq, ball.nv) == (floating.nq - 3, floating.nv - 3)
    assert ball.frame_names == floating.frame_names
    for q, v, a in [(q, *np.random.default_rng(1).standard_normal((2, 7))) for q, _, _ in samples(ball)]:
        big_v, big_a = np.zeros((2, floating.nv))
        big_v[kept], big_a[kept] = v, a
        big_q = np.insert(q, 2, np.zeros(3))
        wanted = pin.rnea(floating.model, floating.model.createData(), big_q, big_v, big_a)[kept]
        np.testing.assert_array_equal(pin.rnea(ball.model, ball.model.createData(), q, v, a), wanted)
        np.testing.assert_array_equal(ball.mass_matrix(q), floating.mass_matrix(big_q)[np.ix_(kept, kept)])
    for limit in ("velocity", "position_lower", "position_upper"):
        theirs = getattr(floating.limits, limit)
        np.testing.assert_array_equal(getattr(ball.limits, limit)[-2:], theirs[-2:])


@pytest.mark.parametrize(
    ("toml", "error", "match"),
    [
        ('spherical = ["swinging"]\n', UnknownJoint, "no joint 'swinging': did you mean 'swing'"),
        ('spherical = ["turn"]\n', UnsupportedRobot, "joint 'turn' is revolute: give it type=\"floating\""),
        (
            'free_flyer = true\nspherical = ["root_joint"]\n',
            UnsupportedRobot,
            "'root_joint' is the free-flyer",
        ),
    ],
)
def test_ball_joints_that_cannot_be(tmp_path: Path, toml: str, error: type[RobotError], match: str) -> None:
    with pytest.raises(error, match=match):
        load(tmp_path, toml)


def test_ball_joints_beside_mimic_joints(tmp_path: Path) -> None:
    follower = joint("elbow", "revolute", "arm", "hand", extra=urdfs.mimic("shoulder"))
    urdf = CART.replace("</robot>", link("hand") + follower + "</robot>")
    with pytest.raises(UnsupportedRobot, match="'swing' cannot be a ball joint beside mimic joint 'elbow'"):
        load(tmp_path, BALL, urdf)
    assert load(tmp_path, BALL, urdf, mimic=False).nv == 8


# Locking and refusals


def test_a_drive_of_a_locked_joint_is_left_out(tmp_path: Path) -> None:
    robot = load(tmp_path, BALL + TURN + FORWARD, lock=["turn"])
    assert [drive.name for drive in robot.drives] == ["forward"]
    assert load(tmp_path, BALL + TURN + FORWARD, lock=["x", "y"]).driven == (3,)
    with pytest.raises(RobotFileError, match=r"drive\[1\]\.joints: joint 'x' is locked: lock all"):
        load(tmp_path, BALL + TURN + FORWARD, lock=["x"])


WRONG: dict[str, tuple[str, type[MbocpError], str]] = {
    "unknown joint": (
        TURN.replace('"turn"', '"tern"'), UnknownJoint, "no joint 'tern': did you mean 'turn'"
    ),
    "unknown joint of a frame": (
        FORWARD.replace('"y"', '"z"'), UnknownJoint, "no joint 'z': valid names"
    ),
    "unknown frame": (FORWARD.replace('"cart"', '"card"'), UnknownFrame, "no frame 'card': did you mean"),
    "fixed frame": (
        FORWARD.replace('"cart"', '"ground"'),
        RobotFileError, r"drive\[0\]\.frame: frame 'ground' is fixed to the world",
    ),
    "twice": (
        TURN + TURN.replace("[[drive]]", '[[drive]]\nname = "b"'),
        RobotFileError, r"drive\[1\]\.joint: joint 'turn' is already moved by drive 'turn'",
    ),
    "named twice": (
        FORWARD.replace('"y"', '"x"'), RobotFileError, r"drive\[0\]\.joints: joint 'x' is named twice"
    ),
    "same name": (
        TURN + FORWARD.replace('"forward"', '"turn"'),
        RobotFileError, "actuator or drive: the name 'turn' is given twice",
    ),
    "motor": (
        TURN + '[actuation]\njoints = ["turn"]\n',
        RobotFileError, r"drive\[0\]\.joint: joint 'turn' has a motor, too: .* Take it out of \[actuation\]",
    ),
    "several velocities": (
        TURN.replace('"turn"', '"swing"'),
        RobotFileError, r"drive\[0\]\.joint: joint 'swing' is spherical and has 3 velocities: drive one of",
    ),
    "not orthonormal": (
        FORWARD.replace('["x", "y"]', '["x", "shoulder"]').replace('"cart"', '"arm"'),
        UnsupportedRobot, "drive 'forward': .* frame 'arm' along orthogonal directions, .*; 'x', 'shoulder'",
    ),
    "out of reach": (
        FORWARD.replace("[3, 4, 0]", "[0, 0, 2]"),
        UnsupportedRobot, r"'x', 'y' cannot always move frame 'cart' along direction \[0.0, 0.0, 1.0\]",
    ),
    "one slider": (
        FORWARD.replace('["x", "y"]', '["x"]'),
        UnsupportedRobot, "'x' cannot always move frame 'cart' along direction",
    ),
    "impulse": (
        TURN.replace('"acceleration"', '"velocity"') + FORWARD,
        UnsupportedRobot, "drive 'turn' acts on joint 'shoulder'. .* Use control = \"acceleration\"",
    ),
    "impulse of a frame": (
        FORWARD.replace('"acceleration"', '"velocity"'),
        UnsupportedRobot, "drive 'forward' acts on joint 'swing', 'turn', 'shoulder'.",
    ),
    "neither": (
        '[[drive]]\ncontrol = "velocity"\n',
        RobotFileError, r"drive\[0\]: give either joint, or frame with direction and joints",
    ),
    "both": (TURN + 'frame = "cart"\n', RobotFileError, r"drive\[0\]: give either joint, or frame"),
    "a joint's direction": (
        TURN + "direction = [1, 0, 0]\n", RobotFileError, r"drive\[0\]: direction and joints go with frame"
    ),
    "a frame without joints": (
        '[[drive]]\nframe = "cart"\ncontrol = "velocity"\n',
        RobotFileError, r"drive\[0\]: frame needs direction \(in its own axes\) and joints",
    ),
    "no direction": (
        FORWARD.replace("3, 4", "0, 0"), RobotFileError, r"drive\[0\]\.direction: must not be zero"
    ),
    "direction too long to have a length": (
        FORWARD.replace("3, 4", "1, 1e308"), RobotFileError, r"drive\[0\]\.direction\[1\]: got 1e\+308"
    ),
    "direction too short to have a length": (
        FORWARD.replace("3, 4", "0, 1e-320"), RobotFileError, r"drive\[0\]\.direction: must not be zero"
    ),
    "no control": (LONG, RobotFileError, r"drive\[0\]\.control: this key is required"),
    "force": (
        LONG + 'control = "force"\n',
        RobotFileError, r"drive\[0\]\.control: got 'force', expected \"velocity\" \| \"acceleration\"",
    ),
    "limit": (
        TURN.replace("3.5", "-1"), RobotFileError, r"drive\[0\]\.limit: got -1: Input should be greater"
    ),
    "unknown key": (
        FORWARD + "axis = [1, 0, 0]\n", RobotFileError, r"drive\[0\]\.axis: unknown key; valid names: name"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_drives_are_refused(tmp_path: Path, case: str) -> None:
    toml, error, match = WRONG[case]
    with pytest.raises(error, match=match):
        load(tmp_path, BALL + toml)


def test_a_driven_follower_is_refused(tmp_path: Path) -> None:
    follower = joint("elbow", "revolute", "arm", "hand", extra=urdfs.mimic("shoulder"))
    urdf = CART.replace("</robot>", link("hand") + follower + "</robot>")
    with pytest.raises(UnsupportedRobot, match="joint 'elbow' mimics 'shoulder' and has no position"):
        load(tmp_path, TURN.replace('"turn"', '"elbow"'), urdf)


def test_a_velocity_drive_that_pulls_at_a_rod_is_refused(tmp_path: Path) -> None:
    toml = BALL + 'lock = ["shoulder"]\n' + TURN.replace("acceleration", "velocity") + FORWARD
    toml += '[[constraint]]\ntype = "rod"\nname = "tie"\nframes = ["arm", "world"]\n'
    with pytest.raises(UnsupportedRobot, match="motion of drive 'turn' pulls at constraint 'tie'"):
        load(tmp_path, toml + "[initial]\nq = { x = 1.0, y = 1.0 }\n")


def test_a_drive_checks_itself() -> None:
    with pytest.raises(InvalidValue, match="drive 'a': control: got 'force', expected 'velocity' or"):
        Drive("a", "force", (0,))
    with pytest.raises(InvalidValue, match=r"drive 'a': dofs: got \(0, 1\), expected one for a joint"):
        Drive("a", "velocity", (0, 1))
    with pytest.raises(InvalidValue, match=r"drive 'a': dofs: got \(\)"):
        Drive("a", "velocity", (), 1)
