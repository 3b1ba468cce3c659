"""Whether a robot is well posed: its masses at its initial pose, and what its drives move and act upon."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, null_space
from mbocp._text import quote_all
from mbocp._tolerances import DIRECTION_TOLERANCE, RANK_TOLERANCE
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot import kinematics
from mbocp.robot.drives import drive_column, name_joints
from mbocp.robot.parts import Drive
from mbocp.robot.robot import Robot
from mbocp.robot.rotors import kinds_of_ends, unit_rotors

_NUM_POSES = 16  # at which a mass matrix that may be indefinite is looked at
_NUM_SAMPLES = 5  # random configurations at which a drive is checked
_SEED = 20170
_MIN_SHARE = 1e-3  # share of the null vector from which a joint is named


class SingularMassMatrix(UnsupportedRobot):
    """Joints that move nothing with mass or inertia; `joints` has their names, `are_all` whether all do."""

    def __init__(self, robot: str, joints: list[str], eigenvalue: float, *, are_all: bool = False) -> None:
        self.robot, self.joints, self.eigenvalue, self.are_all = robot, tuple(joints), eigenvalue, are_all
        named, them = (quote_all(joints), "them") if len(joints) > 1 else (repr(joints[0]), "it")
        if are_all:
            named = "any joint"
            remedy = (
                "Give its links masses and inertias, <inertial> in a URDF; or say inertias = { density = "
                "2700 } [kg/m^3], which fills their shapes; or dynamics = false: then controls are "
                "accelerations"
            )
        else:
            lock = f"lock {them}: lock = {json.dumps(joints)}"
            remedy = f"Give the links beyond a mass and an inertia, or {lock}"
        super().__init__(
            f"robot {robot!r}: the mass matrix is singular (scaled eigenvalue {eigenvalue:.1e}), because "
            f"nothing with mass or inertia moves with {named}. {remedy}"
        )


class IndefiniteMassMatrix(UnsupportedRobot):
    """A motion with negative kinetic energy; `joints` has those that move impossible inertias."""

    def __init__(self, robot: str, joints: list[str], eigenvalue: float, where: str) -> None:
        self.robot, self.joints, self.eigenvalue = robot, tuple(joints), eigenvalue
        moved = quote_all(joints)
        named = f", because what {moved} moves has an impossible inertia" if joints else ""
        super().__init__(
            f"robot {robot!r}: the mass matrix is indefinite {where} (scaled eigenvalue {eigenvalue:.1e})"
            f"{named}: some motion has negative kinetic energy. Mend mass and inertia of these links in the "
            "URDF (principal moments must be positive, and none above the sum of the other two)"
        )


def check_mechanics(robot: Robot) -> None:
    """Check the mass matrix at the initial pose, and at others if some body's inertia is indefinite.

    Raises
    ------
    SingularMassMatrix
        Naming the joints, unless constraints make up for it.
    IndefiniteMassMatrix
        Naming the joints that move impossible inertias.
    """
    jacobian = robot.constraint_jacobian(robot.q0)
    free = list(robot.undriven)  # components that drives move need no mass
    mass = robot.mass_matrix(robot.q0)[np.ix_(free, free)]
    if jacobian.shape[0] == 0:
        _check_definite(robot, free)
    if not kinematics.is_singular(mass):
        return
    basis = null_space(jacobian[:, free], RANK_TOLERANCE)
    reduced = basis.T @ mass @ basis
    if kinematics.is_singular(reduced):
        lowest = float(kinematics.compute_scaled_spectrum(reduced)[0][0])
        if lowest < -RANK_TOLERANCE:
            raise IndefiniteMassMatrix(robot.name, _indefinite(robot), lowest, "at the initial pose")
        raise _singular(robot, mass, free)


def _check_definite(robot: Robot, free: list[int]) -> None:
    """Look for negative kinetic energy at seeded poses; only bodies with indefinite inertias can cause it."""
    joints = _indefinite(robot)
    if not joints:
        return
    steps = np.random.default_rng(0).uniform(-np.pi, np.pi, (_NUM_POSES, robot.nv))
    poses = np.array([robot.q0, *(pin.integrate(robot.model, robot.q0, step) for step in steps)])
    masses = kinematics.mass_matrices(robot.model, poses)[:, free][:, :, free]
    lowest = min(float(kinematics.compute_scaled_spectrum(mass)[0][0]) for mass in masses)
    if lowest < -RANK_TOLERANCE:
        raise IndefiniteMassMatrix(robot.name, joints, lowest, "at some poses")


def _indefinite(robot: Robot) -> list[str]:
    """Joints that move a body whose inertia about its centre of mass has a negative eigenvalue."""
    found = []
    for joint in range(1, robot.model.njoints):
        inertia = np.asarray(robot.model.inertias[joint].inertia)
        size = float(np.abs(inertia).max())
        if size > 0 and np.linalg.eigvalsh(inertia / size)[0] < -RANK_TOLERANCE:
            found.append(robot.model.names[joint])
    return found


def _singular(robot: Robot, mass: Array, free: list[int]) -> SingularMassMatrix:
    values, vectors = kinematics.compute_scaled_spectrum(mass)
    null = vectors[:, values < 10 * max(abs(values[0]), 1e-13)]
    weight = np.zeros(robot.nv)
    weight[free] = np.linalg.norm(null, axis=1)
    guilty = robot.joints_with(weight > _MIN_SHARE)
    are_all = len(guilty) == len(robot.joint_names)
    return SingularMassMatrix(robot.name, guilty, float(values[0]), are_all=are_all)


def check_accelerations(robot: Robot) -> None:
    """Check that nothing but its own motor moves a joint without dynamics, whose control is its acceleration.

    Raises
    ------
    UnsupportedRobot
        For springs and forces at frames, and for loops that join such joints and masses.
    """
    model, where = robot.model, f"robot {robot.name!r}: dynamics = false: "
    for spring in robot.forces:
        if True in kinds_of_ends(model, (spring.frame_a, spring.frame_b)):
            kind = spring.kind.removeprefix("quartic_")
            words = f"a {kind}, {spring.name!r}, acts on masses, and there are none; leave one of the two out"
            raise UnsupportedRobot(where + words)
    for constraint in robot.constraints:
        if len(kinds_of_ends(model, constraint.frame_ids, constraint.joint_ids)) > 1:
            words = f"constraint {constraint.name!r} pulls at masses, and links have none to pull back"
            raise UnsupportedRobot(f"{where}{words}; give all that it joins dynamics, or none")
    rotors = unit_rotors(model)
    for label, column in zip(robot.u_labels, robot.actuation_matrix(robot.q0).T, strict=True):
        if not label.unit.endswith("/s^2") and np.any(column[rotors] != 0.0):
            words = f"the force {label.name!r} acts on masses, and there are none; leave one of the two out"
            raise UnsupportedRobot(where + words)


def check_drives(robot: Robot) -> None:
    """Check at random configurations that drives move their frames, and act on no other component.

    Raises
    ------
    UnsupportedRobot
        If the joints of a drive do not move its frame along orthonormal directions, if they cannot move it
        along its direction, or if the acceleration of a drive whose control is a velocity would act on
        components that are not driven: that acceleration is an impulse wherever the control jumps.
    """
    for q in _random_configurations(robot) if robot.drives else ():
        for drive in robot.drives:
            if drive.frame_id is not None:
                _check_frame(robot, drive, drive.frame_id, q)
            if not drive.has_state:
                _check_impulse(robot, drive, q)


def _check_frame(robot: Robot, drive: Drive, frame_id: int, q: Array) -> None:
    jacobian = kinematics.frame_jacobian(robot.model, q, frame_id, pin.LOCAL)[:3, list(drive.dofs)]
    frame = robot.frame_names[frame_id]
    where = f"robot {robot.name!r}: drive {drive.name!r}"
    gram = jacobian.T @ jacobian
    if np.abs(gram - np.eye(len(gram))).max() > DIRECTION_TOLERANCE:
        raise UnsupportedRobot(
            f"{where}: its joints must move frame {frame!r} along orthogonal directions, at unit speed each; "
            f"{name_joints(robot, drive.dofs)} do not at every configuration. Name the joints that slide, in "
            "a row, before anything turns"
        )
    speed = float(np.linalg.norm(jacobian.T @ drive.direction))
    if abs(speed - 1.0) > DIRECTION_TOLERANCE:
        raise UnsupportedRobot(
            f"{where}: {name_joints(robot, drive.dofs)} cannot always move frame {frame!r} along direction "
            f"{drive.direction.tolist()} (only {speed:.3g} of it): name all joints that it takes, or another "
            "direction"
        )


def _check_impulse(robot: Robot, drive: Drive, q: Array) -> None:
    column, free = drive_column(robot.model, drive, q), list(robot.undriven)
    mass = robot.mass_matrix(q)
    momentum = np.abs((mass @ column)[free])
    threshold = DIRECTION_TOLERANCE * float(np.abs(mass).max())
    remedy = 'Its control is a velocity, which may jump: an impulse. Use control = "acceleration"'
    if momentum.max(initial=0.0) > threshold:
        coupled = [free[i] for i in np.flatnonzero(momentum > threshold)]
        raise UnsupportedRobot(
            f"robot {robot.name!r}: the acceleration of drive {drive.name!r} acts on joint "
            f"{name_joints(robot, coupled)}. {remedy}"
        )
    rates = robot.constraint_jacobian(q) @ column
    if np.abs(rates).max(initial=0.0) > DIRECTION_TOLERANCE:
        row = robot.constraint_labels[int(np.argmax(np.abs(rates)))]
        raise UnsupportedRobot(
            f"robot {robot.name!r}: the motion of drive {drive.name!r} pulls at constraint {row.name!r}. "
            f"{remedy}"
        )


def _random_configurations(robot: Robot) -> Iterator[Array]:
    rng = np.random.default_rng(_SEED)
    for _ in range(_NUM_SAMPLES):
        step = rng.uniform(-np.pi, np.pi, robot.nv)
        yield np.asarray(pin.integrate(robot.model, np.array(robot.q0), step), dtype=np.float64)
