"""Which parameters are unknown, and which combinations of them torques depend on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import solve_triangular

from mbocp._arrays import Array, IntArray, dataclass
from mbocp.exceptions import InvalidValue, UnknownFrame
from mbocp.identification.dynamics import PER_BODY, InverseDynamics
from mbocp.problem.excite import FRICTIONS
from mbocp.robot import Robot
from mbocp.robot.named_numbers import OF_ROBOT
from mbocp.robot.parts import Label

_BODY = (
    *(("mass", "kg"), ("mx", "kg m"), ("my", "kg m"), ("mz", "kg m")),
    *((name, "kg m^2") for name in ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")),
)
OF_JOINT = f"{OF_ROBOT}joint."  # what words of joints begin with
_EXCITED = 1e-7  # part of a column of unit length that the columns before do not say
_NOTHING = 1e-8  # length of a column by the longest that is round-off, as is that of differences along loops
_STEP = 0.05  # [rad, m] of a random walk along closed loops
_SHOWN = 1e-6  # share of a parameter in a combination, by the largest


class UnknownBody(NamedTuple):
    """A rigid body whose ten parameters are unknown.

    Parameters
    ----------
    name : str
        Joint that moves it, or the payload's name.
    joint : int
        Number of that joint.
    placement : pin.SE3
        Of its axes in the joint's.
    values : ndarray, shape (10,)
        What the robot's file says.
    """

    name: str
    joint: int
    placement: pin.SE3
    values: Array


class Unknowns(NamedTuple):
    """Unknown parameters: bodies, then rotors, damping and friction of joints.

    Parameters
    ----------
    bodies : tuple of UnknownBody
    labels : tuple of Label
        Words as `mbocp.robot.named_numbers` has them, where it has some, and units.
    values : ndarray, shape (P,)
        What the file says.
    shares : ndarray, shape (all, P)
        All parameters of `InverseDynamics` are `known + shares @ values`.
    known : ndarray, shape (all,)
    """

    bodies: tuple[UnknownBody, ...]
    labels: tuple[Label, ...]
    values: Array
    shares: Array
    known: Array


@dataclass(frozen=True, eq=False)
class BaseParameters:
    r"""The combinations :math:`\beta = C\,\varphi` of parameters that torques depend on.

    Parameters
    ----------
    labels : tuple of Label
        Parameters: words and units.
    chosen : ndarray of int, shape (rank,)
        Parameters that stand for the combinations: each is in one of them alone, with the factor one.
    combinations : ndarray, shape (rank, P)
        C.
    """

    labels: tuple[Label, ...]
    chosen: IntArray
    combinations: Array

    @property
    def rank(self) -> int:
        """Number of combinations."""
        return len(self.chosen)

    @property
    def names(self) -> tuple[str, ...]:
        """Each combination in words."""
        return tuple(map(self._words, self.combinations, self.chosen))

    @property
    def alone(self) -> tuple[str, ...]:
        """Parameters that are identifiable by themselves."""
        single = (np.abs(self.combinations) > _SHOWN).sum(axis=1) == 1
        return tuple(self.labels[k].name for k in self.chosen[single])

    def _words(self, row: Array, first: int) -> str:
        others = [k for k in np.flatnonzero(np.abs(row) > _SHOWN * np.abs(row).max()) if k != first]
        terms = [f"{'+' if row[k] > 0 else '-'} {abs(row[k]):.4g} {self.labels[k].name}" for k in others]
        return " ".join([self.labels[first].name, *terms]).replace(" 1 ", " ")


def unknowns_of(
    dynamics: InverseDynamics, friction: str = "both", rotors: bool = False, payload: str | None = None
) -> Unknowns:
    """What is to be found of a robot; friction and rotors are those of joints with motors.

    Raises
    ------
    InvalidValue
        For another kind of friction.
    UnknownFrame
        For a payload that is neither one of the robot's nor a frame.
    """
    if friction not in FRICTIONS:
        raise InvalidValue.of_choice("friction", friction, FRICTIONS)
    robot, known = dynamics.robot, dynamics.values.copy()
    nv, end = robot.nv, PER_BODY * (robot.model.njoints - 1)
    if payload is not None:
        bodies = [_payload(robot, payload)]
    else:
        bodies = [
            UnknownBody(
                name, joint, pin.SE3.Identity(), known[PER_BODY * (joint - 1) : PER_BODY * joint].copy()
            )
            for joint, name in enumerate(robot.joint_names, start=1)
            if robot.model.inertias[joint].mass > 0.0
        ]
    shares, labels, values = [], [], []
    for body in bodies:
        rows = slice(PER_BODY * (body.joint - 1), PER_BODY * body.joint)
        moved = _parameter_map(body.placement)
        columns = np.zeros((len(known), PER_BODY))
        columns[rows] = moved
        known[rows] -= moved @ body.values if payload is None or _is_carried(robot, payload) else 0.0
        shares.append(columns)
        word = f"{OF_ROBOT}{'joint' if payload is None else 'payload'}.{body.name}"
        labels += [Label(f"{word}.{name}", unit) for name, unit in _BODY]
        values.append(body.values)
    driven = np.flatnonzero(robot.actuation.selection.any(axis=1))
    kinds = (
        ("rotor", rotors, ("kg m^2", "kg")),
        ("damping", friction in ("viscous", "both"), ("N m s/rad", "N s/m")),
        ("friction", friction in ("coulomb", "both"), ("N m", "N")),
    )
    for k, (kind, wanted, units) in enumerate(kinds):
        if wanted and payload is None:
            at = end + k * nv + driven
            shares.append(np.eye(len(known))[:, at])
            values.append(known[at].copy())
            labels += [
                Label(f"{OF_JOINT}{robot.joint_names[j]}.{kind}", units[robot.v_labels[j].unit == "m/s"])
                for j in driven
            ]
            known[at] = 0.0
    return Unknowns(tuple(bodies), tuple(labels), np.concatenate(values), np.hstack(shares), known)


def friction_speeds_of(dynamics: InverseDynamics, unknowns: Unknowns) -> tuple[tuple[Label, ...], Array]:
    """Name the friction speeds of unknown Coulomb friction: of joints that turn, and of those that slide.

    Returns
    -------
    labels : tuple of Label
        As problem files have them, and units.
    turning : ndarray, shape (nv, number of labels)
        One where a speed is that of a joint, else zero.
    """
    robot = dynamics.robot
    found = unknowns.shares[-robot.nv :].any(axis=1)
    units = np.where(found, [label.unit for label in robot.v_labels], "")
    kept = np.unique(units[found])
    labels = tuple(Label(f"{OF_ROBOT}friction_speed", str(unit)) for unit in kept)
    return labels, (units[:, None] == kept).astype(np.float64)


def base_parameters(
    robot: Robot,
    *,
    friction: str = "both",
    rotors: bool = False,
    payload: str | None = None,
    friction_speed: float | None = None,
) -> BaseParameters:
    """Find the combinations of parameters that some motion tells apart.

    Parameters
    ----------
    robot : Robot
    friction : {"both", "viscous", "coulomb", "none"}
        Which is unknown, in joints with motors.
    rotors : bool
        Whether the inertias of the rotors of motors are unknown.
    payload : str, optional
        Name of a payload or frame: the body there is unknown, and nothing else.
    friction_speed : float, optional
        Of the smooth Coulomb friction [rad/s, m/s].

    Raises
    ------
    UnsupportedRobot, UnknownFrame, InvalidValue
        For a robot, payload or kind of friction that it cannot be.
    """
    dynamics = InverseDynamics(robot, friction_speed)
    return base_of(dynamics, unknowns_of(dynamics, friction, rotors, payload))


def base_of(dynamics: InverseDynamics, unknowns: Unknowns) -> BaseParameters:
    """Find the combinations from the torques of random motions."""
    rng = np.random.default_rng(0)
    count = 20 + 4 * len(unknowns.labels) // dynamics.n
    near = _random_poses(dynamics, count, rng)
    y = np.array([dynamics.coordinates(q) for q in near])
    rates = rng.standard_normal((2, *y.shape))
    motion = dynamics.motion(y, 2.0 * rates[0], 5.0 * rates[1], near)
    columns = (dynamics.regressor(motion) @ unknowns.shares).reshape(-1, len(unknowns.labels))
    # Friction first: nothing else then takes its place. Masses last of each body: they are the first to be
    # grouped with others.
    order = sorted(range(len(unknowns.labels)), key=lambda k: _rank(k, PER_BODY * len(unknowns.bodies)))
    chosen, combinations = _combine(columns[:, order])
    found = np.zeros_like(combinations)
    found[:, order] = combinations
    return BaseParameters(unknowns.labels, np.array(order)[chosen], found)


def _rank(parameter: int, end: int) -> tuple[int, int, int]:
    if parameter >= end:
        return 0, 0, parameter
    body, entry = divmod(parameter, PER_BODY)
    return 1, body, entry if entry else PER_BODY


def _combine(columns: Array) -> tuple[IntArray, Array]:
    """Columns that do not follow from those before, and all columns in terms of them (Gautier 1991)."""
    size = np.linalg.norm(columns, axis=0)
    scaled = np.where(size > _NOTHING * size.max(), columns, 0.0) / np.where(size > 0.0, size, 1.0)
    basis: list[Array] = []
    chosen: list[int] = []
    for k, column in enumerate(scaled.T):
        rest = column.copy()
        for _ in range(2):  # twice is enough for orthogonality
            for other in basis:
                rest -= (other @ rest) * other
        norm = float(np.linalg.norm(rest))
        if norm > _EXCITED:
            basis.append(rest / norm)
            chosen.append(k)
    at = np.array(chosen, dtype=np.intp)
    Q = np.array(basis).T.reshape(len(columns), len(chosen))
    shares = solve_triangular(Q.T @ scaled[:, at], Q.T @ scaled)
    shares[np.abs(shares) < _EXCITED] = 0.0
    return at, shares * size / size[at][:, None]


def _random_poses(dynamics: InverseDynamics, count: int, rng: np.random.Generator) -> Array:
    """Configurations that close the loops: by a random walk, where there are some."""
    now, found = np.array(dynamics.robot.q0), []
    if not len(dynamics.dependent):
        return dynamics.place(rng.uniform(-np.pi, np.pi, (count, dynamics.n)), np.tile(now, (count, 1)))
    at, drift = dynamics.coordinates(now), rng.standard_normal(dynamics.n)
    for _ in range(40 * count):
        step = _STEP * drift / np.linalg.norm(drift)
        try:
            now = dynamics.follow((at + step)[None], now)[0]
        except InvalidValue:
            drift = rng.standard_normal(dynamics.n)
            continue
        at = at + step
        drift = drift + 0.3 * rng.standard_normal(dynamics.n)
        found.append(now)
        if len(found) == 4 * count:
            break
    if len(found) < count:
        raise InvalidValue(
            f"robot {dynamics.robot.name!r}", "loops that do not move", "a mechanism that moves"
        )
    chosen = np.linspace(0, len(found) - 1, count).astype(int)
    return np.asarray(np.array(found)[chosen])


def _payload(robot: Robot, name: str) -> UnknownBody:
    for payload in robot.payloads:
        if payload.name == name:
            frame = robot.model.frames[robot.frame_id(payload.frame)]
            body = pin.Inertia(payload.mass, np.array(payload.com), payload.inertia_matrix)
            return UnknownBody(name, int(frame.parentJoint), frame.placement, body.toDynamicParameters())
    try:
        frame = robot.model.frames[robot.frame_id(name)]
    except UnknownFrame as error:
        names = [*(payload.name for payload in robot.payloads), *robot.frame_names]
        raise UnknownFrame(name, robot.name, names) from error
    if frame.parentJoint == 0:
        raise InvalidValue("payload", repr(name), "a payload of the robot, or a frame that moves")
    ball = pin.Inertia.FromSphere(1.0, 0.05)
    return UnknownBody(name, int(frame.parentJoint), frame.placement, ball.toDynamicParameters())


def _is_carried(robot: Robot, name: str) -> bool:
    return any(payload.name == name for payload in robot.payloads)


def _parameter_map(placement: pin.SE3) -> Array:
    """Ten parameters in the axes of the joint by those in the body's, shape (10, 10)."""
    to = placement.homogeneous
    columns = [parameters_of(to @ pseudo_inertia(unit) @ to.T) for unit in np.eye(PER_BODY)]
    return np.asarray(np.array(columns).T)


def pseudo_inertia(parameters: Array) -> Array:
    """Pseudo-inertia of ten parameters, shape (4, 4): positive definite for all bodies and no others."""
    mass, first = parameters[0], parameters[1:4]
    xx, xy, yy, xz, yz, zz = parameters[4:]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = 0.5 * np.trace(about) * np.eye(3) - about
    return np.block([[second, first[:, None]], [first[None], np.array([[mass]])]])


def parameters_of(pseudo: Array) -> Array:
    """The ten parameters of a pseudo-inertia."""
    second = pseudo[:3, :3]
    about = np.trace(second) * np.eye(3) - second
    moments: Sequence[float] = [about[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    return np.array([pseudo[3, 3], *pseudo[:3, 3], *moments])
