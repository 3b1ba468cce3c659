"""URDFs with loops, for the tests: each is a tree, and frames that a robot.toml joins."""

from __future__ import annotations

from pathlib import Path

from mbocp.robot import Robot, load_robot

_BOX = (
    '<inertial><origin xyz="{x} 0 0"/><mass value="1.2"/>'
    '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0.001" izz="0.03"/></inertial>'
)
CRANK, COUPLER, ROCKER, GROUND = 0.3, 0.8, 0.6, 0.9  # [m]

MOTOR = '[actuation]\njoints = ["crank"]\n'
HINGE = (
    '[[constraint]]\ntype = "hinge"\nname = "pin"\nframes = ["coupler_end", "rocker_end"]\naxis = [0, 1, 0]\n'
)
POINT = '[[constraint]]\ntype = "point"\nname = "pin"\nframes = ["coupler_end", "rocker_end"]\n'
WELD = '[[constraint]]\ntype = "weld"\nname = "pin"\nframes = ["coupler_end", "rocker_end"]\n'
ROD = '[[constraint]]\ntype = "rod"\nname = "{name}"\nframes = ["coupler_end", "world"]\nlength = {length}\n'
OPEN_POSE = "[initial]\nq = { crank = 1.0, coupler = -0.5, rocker = 1.6 }\n"  # to two digits only


def link(name: str, length: float) -> str:
    return f'<link name="{name}">{_BOX.format(x=length / 2)}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    xyz: str = "0 0 0",
    *,
    kind: str = "revolute",
    axis: str = "0 -1 0",
    rpy: str = "0 0 0",
) -> str:
    limit = "" if kind in ("fixed", "continuous") else '<limit effort="9" velocity="9" lower="-9" upper="9"/>'
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def tip(name: str, parent: str, length: float, rpy: str = "0 0 0") -> str:
    """A frame at the end of a link."""
    mount = joint(f"{name}_mount", parent, name, f"{length} 0 0", kind="fixed", rpy=rpy)
    return f'<link name="{name}"/>{mount}'


def four_bar(*, wrist: bool = False, tilt: str = "0 0 0", kind: str = "revolute") -> str:
    """Crank and coupler from the left, rocker from the right, in the x-z plane turned by `tilt`.

    With `wrist`, a fourth hinge is between the coupler and its end: then the ends may be welded.
    """
    parts = [
        '<link name="base"/>',
        joint("mount", "base", "frame", kind="fixed", rpy=tilt),
        '<link name="frame"/>',
        link("crank_link", CRANK),
        link("coupler_link", COUPLER),
        link("rocker_link", ROCKER),
        joint("crank", "frame", "crank_link", kind=kind),
        joint("coupler", "crank_link", "coupler_link", f"{CRANK} 0 0", kind=kind),
        joint("rocker", "frame", "rocker_link", f"{GROUND} 0 0", kind=kind),
        tip("rocker_end", "rocker_link", ROCKER),
    ]
    if wrist:
        parts += [link("hand", 0.1), joint("wrist", "coupler_link", "hand", f"{COUPLER} 0 0", kind=kind)]
        parts += [tip("coupler_end", "hand", 0.0)]
    else:
        parts += [tip("coupler_end", "coupler_link", COUPLER)]
    return f'<robot name="four_bar">{"".join(parts)}</robot>'


def load(folder: Path, urdf: str, toml: str, **options: object) -> Robot:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(urdf)
    (folder / "robot.toml").write_text(toml)
    return load_robot(folder, **options)  # type: ignore[arg-type]
