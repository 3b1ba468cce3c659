"""Small URDFs for the tests."""

from __future__ import annotations

from pathlib import Path

INERTIAL = (
    '<inertial><origin xyz="0.1 0.02 0.2"/><mass value="{mass}"/>'
    '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0.001" izz="0.04"/></inertial>'
)
LIMIT = '<limit lower="-1" upper="2" effort="3" velocity="4"/>'


def link(name: str, mass: float | str | None = 1.0, extra: str = "") -> str:
    inertial = "" if mass is None else INERTIAL.format(mass=mass)
    return f'<link name="{name}">{inertial}{extra}</link>'


def joint(name: str, kind: str, parent: str, child: str, *, axis: str = "0 0 1", extra: str = LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0.3 0 0.1" rpy="0.1 0.2 0.3"/>'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>{extra}</joint>'
    )


def mimic(leader: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return LIMIT + f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


def losses(damping: float | str = 0.0, friction: float | str = 0.0) -> str:
    return f'<dynamics damping="{damping}" friction="{friction}"/>'


def robot(*parts: str, name: str = "test") -> str:
    return f'<?xml version="1.0"?>\n<robot name="{name}">{"".join(parts)}</robot>'


def chain(*kinds: str, name: str = "test") -> str:
    """A base and one link for each joint type in `kinds`: joints j1, j2, ..., links l1, l2, ..."""
    links = [link("base")] + [link(f"l{i}") for i in range(1, len(kinds) + 1)]
    joints = [
        joint(
            f"j{i}",
            kind,
            "base" if i == 1 else f"l{i - 1}",
            f"l{i}",
            axis="0.2 0.9 0.4" if i % 2 else "0 0 1",
        )
        for i, kind in enumerate(kinds, start=1)
    ]
    return robot(*links, *joints, name=name)


def write(folder: Path, urdf: str, toml: str | None = None) -> Path:
    """Write robot.urdf, and robot.toml if given; return the path to load."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(urdf)
    if toml is None:
        return folder / "robot.urdf"
    (folder / "robot.toml").write_text(toml)
    return folder / "robot.toml"
