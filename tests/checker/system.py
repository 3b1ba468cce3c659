"""Robots as Pinocchio and a few lines of NumPy see them, read from the files without mbocp."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from tests.checker.loops import Loop, loop_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["Array", "Drive", "Spring", "System", "read_system"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Spring:
    """V = c/4 (|p_a - p_b|^2 - l^2)^2."""

    frame_a: int
    frame_b: int
    coefficient: float
    length: float


@dataclass(frozen=True, eq=False)
class Drive:
    """A speed that a control prescribes ("velocity"), or whose rate it prescribes ("acceleration")."""

    control: str
    dofs: tuple[int, ...]
    frame: int | None = None
    direction: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(eq=False)
class System:
    """A multibody system with what its URDF cannot say.

    Attributes
    ----------
    selection : ndarray, shape (nv, k)
        Generalised force of each motor on a joint.
    wrenches : list of (int, ndarray)
        Frame and wrench (force, moment) in its axes, one for each thruster.
    """

    model: Any
    selection: Array
    wrenches: tuple[tuple[int, Array], ...] = ()
    springs: tuple[Spring, ...] = ()
    loops: tuple[Loop, ...] = ()
    drives: tuple[Drive, ...] = ()
    damping: Array = field(default_factory=lambda: np.zeros(0))
    kept: Array | None = None  # rows of the loops that are independent

    def __post_init__(self) -> None:
        self.data = self.model.createData()
        if not self.damping.size:
            self.damping = np.zeros(self.nv)
        self.is_vector = self.nq == self.nv
        if self.kept is None:
            self.kept = np.arange(self.num_rows)

    # The sizes stand in `mbocp.robot`, too: a checker that took them from there would believe what it checks.
    @property
    def nq(self) -> int:
        return int(self.model.nq)

    @property
    def nv(self) -> int:
        return int(self.model.nv)

    @property
    def nu(self) -> int:
        return self.selection.shape[1] + len(self.wrenches) + len(self.drives)

    @property
    def num_rows(self) -> int:
        return sum(loop.size for loop in self.loops)

    @property
    def nc(self) -> int:
        return len(self.kept)

    @property
    def has_constant_force(self) -> bool:
        """Whether forces do not depend on the configuration."""
        return not self.springs and not self.wrenches

    # Geometry

    def step(self, q: Array, dv: Array) -> Array:
        return np.asarray(pin.integrate(self.model, q, dv))

    def away(self, q0: Array, q1: Array) -> Array:
        return np.asarray(pin.difference(self.model, q0, q1))

    def place(self, q: Array) -> None:
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)

    def frame_jacobian(self, frame: int, axes: Any) -> Array:
        return np.asarray(pin.getFrameJacobian(self.model, self.data, frame, axes))

    def closure(self, q: Array) -> tuple[Array, Array]:
        """All rows of the loops and their derivative in tangent coordinates."""
        if not self.loops:
            return np.zeros(0), np.zeros((0, self.nv))
        self.place(q)
        found = [loop.rows(self) for loop in self.loops]
        return np.concatenate([f[0] for f in found]), np.vstack([f[1] for f in found])

    def Phi(self, q: Array) -> Array:
        return self.closure(q)[0][self.kept]

    def Phi_q(self, q: Array) -> Array:
        return self.closure(q)[1][self.kept]

    def choose_rows(self, q: Array) -> None:
        """Keep rows of the loops that are independent at q."""
        from scipy.linalg import qr

        jacobian = self.closure(q)[1]
        if not jacobian.size:
            return
        _, r, order = qr(jacobian.T, pivoting=True, mode="economic")
        sizes = np.abs(np.diag(r))
        self.kept = np.sort(order[: int(np.sum(sizes > 1e-8 * sizes[0]))])

    # Forces

    def actuation(self, q: Array) -> Array:
        """B(q), shape (nv, nu)."""
        columns = [self.selection]
        if self.wrenches:
            self.place(q)
            for frame, wrench in self.wrenches:
                columns.append((self.frame_jacobian(frame, pin.LOCAL).T @ wrench)[:, None])
        columns.append(np.zeros((self.nv, len(self.drives))))
        return np.hstack(columns)

    def applied(self, q: Array, v: Array, u: Array) -> Array:
        """Forces of motors, springs and dampers, shape (nv,)."""
        total = self.actuation(q) @ u - self.damping * v
        if self.springs:
            self.place(q)
            for s in self.springs:
                d, dd = self._span(s)
                total -= s.coefficient * (d @ d - s.length**2) * (d @ dd)
        return np.asarray(total)

    def _span(self, s: Spring) -> tuple[Array, Array]:
        frames = self.data.oMf
        d = frames[s.frame_a].translation - frames[s.frame_b].translation
        world = pin.LOCAL_WORLD_ALIGNED
        return d, self.frame_jacobian(s.frame_a, world)[:3] - self.frame_jacobian(s.frame_b, world)[:3]

    def potential(self, q: Array) -> float:
        energy = float(pin.computePotentialEnergy(self.model, self.data, q))
        self.place(q)
        for s in self.springs:
            d, _ = self._span(s)
            energy += s.coefficient / 4 * (d @ d - s.length**2) ** 2
        return energy

    def potential_gradient(self, q: Array) -> Array:
        zero = np.zeros(self.nv)
        gravity = np.asarray(pin.computeGeneralizedGravity(self.model, self.data, q)).copy()
        return gravity - self.applied(q, zero, np.zeros(self.nu))

    def mass(self, q: Array) -> Array:
        return np.array(pin.crba(self.model, self.data, q))

    # Speeds: v = V(q) s + U(q) u where drives prescribe some of them

    @property
    def free(self) -> list[int]:
        driven = {dof for drive in self.drives for dof in drive.dofs}
        return [i for i in range(self.nv) if i not in driven]

    @property
    def ns(self) -> int:
        return len(self.free) + sum(d.control == "acceleration" for d in self.drives)

    def _column(self, drive: Drive) -> Array:
        column = np.zeros(self.nv)
        dofs = list(drive.dofs)
        column[dofs] = 1.0
        if drive.frame is not None:
            column[dofs] = self.frame_jacobian(drive.frame, pin.LOCAL)[:3, dofs].T @ drive.direction
        return column

    def speed_maps(self, q: Array) -> tuple[Array, Array]:
        """V(q), shape (nv, ns), and U(q), shape (nv, nu)."""
        self.place(q)
        V, U = np.eye(self.nv)[:, self.free], np.zeros((self.nv, self.nu))
        first = self.nu - len(self.drives)
        for k, drive in enumerate(self.drives):
            if drive.control == "acceleration":
                V = np.hstack([V, self._column(drive)[:, None]])
            else:
                U[:, first + k] = self._column(drive)
        return V, U


def read_system(
    urdf: str | Path,
    *,
    toml: str | Path | None = None,
    free_flyer: bool = False,
    lock: dict[str, float] | None = None,
    motors: Sequence[str] | None = None,
    thrusters: Sequence[tuple[str, Sequence[float]]] = (),
    loops: Sequence[dict[str, Any]] = (),
    damping: bool = True,
) -> System:
    """A system from a URDF, and from the tables of a robot.toml beside it."""
    table: dict[str, Any] = {}
    if toml is not None:
        with Path(toml).open("rb") as file:
            table = tomllib.load(file)
    root = [pin.JointModelFreeFlyer()] if free_flyer else []
    model = pin.buildModelFromUrdf(str(urdf), *root)
    for name in table.get("spherical", ()):
        model = _with_ball_joint(model, name)
    if lock:
        q = pin.neutral(model)
        for name, value in lock.items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        model = pin.buildReducedModel(model, [model.getJointId(name) for name in lock], q)
    if "gravity" in table:
        model.gravity.linear = np.array(table["gravity"])
    names = motors if motors is not None else table.get("actuation", {}).get("joints")
    if names is None and ("drive" in table or thrusters):
        names = []
    if names is None:
        names = [n for n, j in list(zip(model.names, model.joints, strict=True))[1:] if j.nv == 1]
    rows = [*table.get("constraint", ()), *loops]
    return System(
        model,
        _selection(model, names),
        tuple((_frame(model, name), np.array(w, dtype=float)) for name, w in thrusters),
        tuple(_spring(model, s) for s in table.get("spring", ())),
        tuple(loop_of(model, row, _frame) for row in rows),
        tuple(_drive(model, d) for d in table.get("drive", ())),
        np.asarray(model.damping).copy() if damping else np.zeros(model.nv),
    )


def _frame(model: Any, name: str) -> int:
    if name == "world":
        return 0
    return int(
        model.getFrameId(name, pin.FrameType.BODY)
        if model.existFrame(name, pin.FrameType.BODY)
        else model.getFrameId(name)
    )


def _selection(model: Any, names: Sequence[str]) -> Array:
    columns = []
    for name in names:
        joint = model.joints[model.getJointId(name)]
        for k in range(joint.nv):
            columns.append(np.eye(model.nv)[joint.idx_v + k])
    return np.array(columns).reshape(len(columns), model.nv).T


def _spring(model: Any, table: dict[str, Any]) -> Spring:
    a, b = (_frame(model, name) for name in table["frames"])
    # left out by the paper's cart alone: l^2 = 1.25 m^2, see its file's comment
    length = float(table["length"]) if "length" in table else np.sqrt(1.25)
    coefficient = table.get("coefficient") or table["stiffness"] / (2 * length**2)
    return Spring(a, b, float(coefficient), length)


def _drive(model: Any, table: dict[str, Any]) -> Drive:
    names = [table["joint"]] if "joint" in table else table["joints"]
    dofs = tuple(int(model.joints[model.getJointId(name)].idx_v) for name in names)
    if "joint" in table:
        return Drive(table["control"], dofs)
    direction = np.array(table["direction"], dtype=float)
    return Drive(table["control"], dofs, _frame(model, table["frame"]), direction / np.linalg.norm(direction))


def _with_ball_joint(model: Any, name: str) -> Any:
    """The model with the floating joint `name` turned into a ball joint."""
    out = pin.Model()
    out.gravity = model.gravity
    for j in range(1, model.njoints):
        kind = pin.JointModelSpherical() if model.names[j] == name else model.joints[j]
        out.addJoint(model.parents[j], kind, model.jointPlacements[j], model.names[j])
        out.appendBodyToJoint(j, model.inertias[j], pin.SE3.Identity())
    for frame in model.frames:
        if frame.name != "universe":
            out.addFrame(frame, False)
    return out
