"""The campaign's robots, each twice: as mbocp loads it, and as the checker reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import mbocp
from mbocp.robot import Robot
from tests.checker.system import System, read_system
from tests.checker.task import Ball

__all__ = ["ROBOTS", "Loaded", "load"]


@dataclass(frozen=True, eq=False)
class Loaded:
    """A robot, the checker's system, velocity components that its tasks move, and spheres of its links."""

    robot: Robot
    system: System
    dofs: tuple[int, ...] = field(default=())
    balls: tuple[Ball, ...] = ()


@cache
def load(name: str, folder: Path) -> Loaded:
    """A robot of `ROBOTS`; files that have to be written go into `folder`."""
    loaded = ROBOTS[name](folder)
    robot, system = loaded.robot, loaded.system
    assert (robot.nq, robot.nv, robot.nu) == (system.nq, system.nv, system.nu), name
    assert robot.joint_names == tuple(system.model.names)[1:], name
    return loaded


def _example(name: str, **of_system: Any) -> Callable[[Path], Loaded]:
    def make(_: Path) -> Loaded:
        robot = mbocp.load_robot(name)
        return Loaded(robot, read_system(str(robot.source), **of_system))

    return make


def _panda(_: Path) -> Loaded:
    lock = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    robot = mbocp.load_robot("panda", lock=lock)
    return Loaded(robot, read_system(str(robot.source), lock=lock))


def _undamped(_: Path) -> Loaded:
    """The double pendulum for natural coordinates, in which the checker knows no damping."""
    robot = mbocp.load_robot("double_pendulum", damping=False)
    return Loaded(robot, read_system(str(robot.source), damping=False))


def _acrobot(_: Path) -> Loaded:
    robot = mbocp.load_robot("double_pendulum", actuated=["joint2"])
    return Loaded(robot, read_system(str(robot.source), motors=["joint2"]))


def _drone(_: Path) -> Loaded:
    robot = mbocp.load_robot("hector", actuated=["root_joint"])
    return Loaded(robot, read_system(str(robot.source), free_flyer=True, motors=["root_joint"]))


def _quadrotor(folder: Path) -> Loaded:
    """Four thrusters on the drone's body."""
    source = mbocp.load_robot("hector").source
    arm, ratio = 0.25, 0.02  # m
    corners = ((arm, 0.0, 1), (0.0, arm, -1), (-arm, 0.0, 1), (0.0, -arm, -1))
    lines = ['name = "quadrotor"', f'urdf = "{source}"', "free_flyer = true", "actuation.joints = []"]
    thrusters = []
    for i, (x, y, turn) in enumerate(corners):
        lines += ["[[actuator]]", 'type = "thruster"', 'frame = "base_link"', f'name = "rotor_{i}"']
        lines += [f"position = [{x}, {y}, 0.0]", f"torque_ratio = {turn * ratio}"]
        thrusters.append(("base_link", (0.0, 0.0, 1.0, y, -x, turn * ratio)))
    file = _write(folder / "quadrotor" / "robot.toml", "\n".join(lines) + "\n")
    system = read_system(str(source), free_flyer=True, motors=[], thrusters=thrusters)
    return Loaded(mbocp.load_robot(file), system)


def _own(name: str, *driven: str) -> Callable[[Path], Loaded]:
    """One of mbocp's folders; `driven` are the joints that tasks move."""

    def make(_: Path) -> Loaded:
        robot = mbocp.load_robot(name)
        source = Path(str(robot.source))
        system = read_system(source, toml=source.parent / "robot.toml")
        dofs = [system.model.joints[system.model.getJointId(joint)].idx_v for joint in driven]
        return Loaded(robot, system, tuple(map(int, dofs)))

    return make


def _arm(length: float, mass: float) -> Callable[[Path], Loaded]:
    """Three joints and links of a size [m] and mass [kg] of their own."""

    def make(folder: Path) -> Loaded:
        text = arm_urdf(length, mass)
        file = _write(folder / f"arm_{length:g}_{mass:g}.urdf", text)
        return Loaded(mbocp.load_robot(file), read_system(file))

    return make


def arm_urdf(length: float, mass: float) -> str:
    """Yaw, pitch, pitch."""
    lines = ['<robot name="arm"><link name="base"/>']
    parent, offset = "base", 0.0
    for i, axis in enumerate(("0 0 1", "0 1 0", "0 1 0")):
        m, size = mass / (i + 1), length / (i + 1)
        inertia = m * size**2 / 12
        lines.append(
            f'<link name="link_{i}"><inertial><origin xyz="{0.1 * size!r} 0 {size / 2!r}"/>'
            f'<mass value="{m!r}"/>'
            f'<inertia ixx="{inertia!r}" iyy="{inertia!r}" izz="{inertia / 4!r}" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>"
            f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
            f'<origin xyz="0 0 {offset!r}"/><axis xyz="{axis}"/>'
            '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
        )
        parent, offset = f"link_{i}", size
    return "".join([*lines, "</robot>"])


def _standing(folder: Path) -> Loaded:
    """A trunk on four legs of three joints; the feet are balls on the ground."""
    file = _write(folder / "standing" / "robot.urdf", _standing_urdf())
    loops = [
        {"type": "point", "name": f"ball_{leg}", "frames": [f"foot_{leg}", f"hold_{leg}"]} for leg in range(4)
    ]
    knees = {"hip": 0.6, "knee": -1.2}
    pose = [f"{kind}_{leg} = {angle}" for leg in range(4) for kind, angle in knees.items()]
    height = float(2 * 0.2 * np.cos(0.6))
    motors = [f"{kind}_{leg}" for leg in range(4) for kind in ("roll", "hip", "knee")]
    text = ['name = "standing"', f"actuation.joints = {motors!r}".replace("'", '"')]
    text += [f"initial.q = {{ trunk = [0.0, 0.0, {height!r}, 0, 0, 0, 1], {', '.join(pose)} }}"]
    for loop in loops:
        text += ["[[constraint]]", *(f"{k} = {v!r}".replace("'", '"') for k, v in loop.items())]
    toml = _write(folder / "standing" / "robot.toml", "\n".join(text) + "\n")
    system = read_system(file, motors=motors, loops=loops)
    first = int(system.model.joints[system.model.getJointId("trunk")].idx_v)
    return Loaded(mbocp.load_robot(toml), system, tuple(range(first, first + 6)))


def _standing_urdf() -> str:
    def link(name: str, mass: float, z: float, size: float) -> str:
        i = mass * size**2
        return (
            f'<link name="{name}"><inertial><origin xyz="0 0 {z}"/><mass value="{mass}"/><inertia ixx="{i}" '
            f'iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )

    def joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str = "") -> str:
        more = f'<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="9" velocity="9"/>' if axis else ""
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}"/>{more}</joint>'
        )

    text = ['<robot name="standing"><link name="ground"/>', link("trunk_link", 6.0, 0.0, 0.15)]
    text.append(joint("trunk", "floating", "ground", "trunk_link", "0 0 0"))
    for leg, (x, y) in enumerate(((0.2, 0.12), (0.2, -0.12), (-0.2, 0.12), (-0.2, -0.12))):
        text.append(f'<link name="hold_{leg}"/>')
        text.append(joint(f"at_{leg}", "fixed", "ground", f"hold_{leg}", f"{x} {y} 0"))
        for name, mass, z in (("side", 0.2, 0.0), ("thigh", 0.4, -0.1), ("shank", 0.2, -0.1)):
            text.append(link(f"{name}_{leg}", mass, z, 0.06))
        text.append(f'<link name="foot_{leg}"/>')
        text.append(joint(f"roll_{leg}", "revolute", "trunk_link", f"side_{leg}", f"{x} {y} 0", "1 0 0"))
        text.append(joint(f"hip_{leg}", "revolute", f"side_{leg}", f"thigh_{leg}", "0 0 0", "0 1 0"))
        text.append(joint(f"knee_{leg}", "revolute", f"thigh_{leg}", f"shank_{leg}", "0 0 -0.2", "0 1 0"))
        text.append(joint(f"toe_{leg}", "fixed", f"shank_{leg}", f"foot_{leg}", "0 0 -0.2"))
    return "".join([*text, "</robot>"])


def _two_arms(folder: Path) -> Loaded:
    """Two planar arms of three joints hold a box by pins: parts for mbocp, one URDF for the checker."""
    places, mass, size = {"left": -0.45, "right": 0.45}, 1.0, (0.2, 0.1, 0.06)
    file = _write(
        folder / "joined" / "arm.urdf", f'<robot name="arm"><link name="base"/>{_planar("")}</robot>'
    )
    parts = [
        {"name": "left", "robot": str(file), "position": [places["left"], 0.0, 0.0]},
        {"name": "load", "mass": mass, "box": list(size)},
        {"name": "right", "robot": str(file), "position": [places["right"], 0.0, 0.0]},
    ]
    grips = [
        {
            "type": "hinge",
            "name": f"grip_{side}",
            "frames": [f"{side}/tip", "load/body"],
            "axis": [0, 1, 0],
            "position_b": [np.sign(x) * 0.1, 0.0, 0.0],
        }
        for side, x in places.items()
    ]
    initial = {"q": {"load": [0.0, 0.0, 0.45, 0, 0, 0, 1]}}
    robot = mbocp.robot.load_parts(parts, constraint=grips, initial=initial)
    a, b, c = (side**2 for side in size)
    inertia = [mass / 12 * moment for moment in (b + c, a + c, a + b)]
    text = ['<robot name="both"><link name="ground"/><link name="load/body"><inertial>']
    text.append(f'<mass value="{mass!r}"/><inertia ixx="{inertia[0]!r}" iyy="{inertia[1]!r}" ')
    text.append(f'izz="{inertia[2]!r}" ixy="0" ixz="0" iyz="0"/></inertial></link>')
    text.append(_joint("load/root_joint", "floating", "ground", "load/body", "0 0 0"))
    for side, x in places.items():
        text.append(f'<link name="{side}/base"/>')
        text.append(_joint(f"{side}/at", "fixed", "ground", f"{side}/base", f"{x!r} 0 0"))
        text.append(_planar(f"{side}/"))
        text.append(f'<link name="hold_{side}"/>')
        text.append(
            _joint(f"hold_{side}_joint", "fixed", "load/body", f"hold_{side}", f"{np.sign(x) * 0.1} 0 0")
        )
    loops = [
        {"type": "hinge", "frames": [f"{side}/tip", f"hold_{side}"], "axis": [0, 1, 0]} for side in places
    ]
    whole = _write(folder / "joined" / "both.urdf", "".join([*text, "</robot>"]))
    motors = [f"{side}/joint_{i}" for side in places for i in range(3)]
    system = read_system(whole, motors=motors, loops=loops)
    first = int(system.model.joints[system.model.getJointId("load/root_joint")].idx_v)
    return Loaded(robot, system, (first, first + 2, first + 4))


def _planar(prefix: str) -> str:
    """Three links of 0.3 m about y."""
    lines, parent, offset = [], "base", 0.0
    for i in range(3):
        lines.append(
            f'<link name="{prefix}link_{i}"><inertial><origin xyz="0 0 0.15"/><mass value="0.8"/>'
            '<inertia ixx="0.006" iyy="0.006" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        where = f"0 0 {offset!r}"
        lines.append(
            _joint(f"{prefix}joint_{i}", "revolute", prefix + parent, f"{prefix}link_{i}", where, "0 1 0")
        )
        parent, offset = f"link_{i}", 0.3
    lines.append(f'<link name="{prefix}tip"/>')
    lines.append(_joint(f"{prefix}tip_joint", "fixed", f"{prefix}link_2", f"{prefix}tip", "0 0 0.3"))
    return "".join(lines)


def _joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str = "") -> str:
    more = f'<axis xyz="{axis}"/><limit lower="-6" upper="6" effort="50" velocity="9"/>' if axis else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/>{more}</joint>'
    )


def _guarded(folder: Path) -> Loaded:
    from tests.campaign.guarded import guarded_arm  # which takes its arm from here

    return guarded_arm(folder)


def _write(file: Path, text: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


ROBOTS: dict[str, Callable[[Path], Loaded]] = {
    "ur5": _example("ur5"),
    "panda": _panda,
    "kinova": _example("kinova"),
    "double_pendulum": _example("double_pendulum"),
    "double_pendulum_undamped": _undamped,
    "acrobot": _acrobot,
    "drone": _drone,
    "quadrotor": _quadrotor,
    "standing": _standing,
    "tiny_arm": _arm(1e-3, 1e-3),
    "huge_arm": _arm(1e3, 1e3),
    "light_arm": _arm(1.0, 1e-3),
    "heavy_arm": _arm(1.0, 1e3),
    "four_bar": _own("four_bar", "crank"),
    "five_bar": _own("five_bar", "left_shoulder", "right_shoulder"),
    "slider_crank": _own("slider_crank", "crank"),
    "parallelogram_arm": _own("parallelogram_arm", "shoulder", "crank"),
    "delta": _own("delta", "arm_1", "arm_2", "arm_3"),
    "stewart": _own("stewart", "leg_1", "leg_2", "leg_3", "leg_4", "leg_5", "leg_6"),
    "elastic_pendulum": _own("elastic_pendulum"),
    "rigid_pendulum": _own("rigid_pendulum"),
    "cart_pendulum": _own("cart_pendulum_rigid"),
    "elastic_cart": _own("cart_pendulum_elastic"),
    "two_arms": _two_arms,
    "unicycle": _own("unicycle_pendulum"),
    "guarded": _guarded,
}
