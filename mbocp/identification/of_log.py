"""`identify`: parameters of a robot from a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp._text import list_names
from mbocp.exceptions import LogError
from mbocp.identification.advice import MOST_NAMES, ask, describe
from mbocp.identification.consistent import fit_consistent
from mbocp.identification.dynamics import PER_BODY, InverseDynamics
from mbocp.identification.likelihood import MaximumLikelihood, Measurements, estimate, knots_for, smooth
from mbocp.identification.robot_log import Log, read_log
from mbocp.identification.unknown_parameters import (
    BaseParameters,
    UnknownBody,
    Unknowns,
    base_of,
    friction_speeds_of,
    unknowns_of,
)
from mbocp.problem.limits import ask_degrees, with_question
from mbocp.robot import Robot, load_robot
from mbocp.robot.parts import Label
from mbocp.robot.resistance import JointResistance

_HELD_OUT = 0.2  # share of a log


@dataclass(frozen=True, eq=False)
class Residuals:
    """Torques that the parameters do not explain.

    Parameters
    ----------
    t : ndarray, shape (K,)
        [s].
    torques, residuals, before : ndarray, shape (K, n)
        Measured; measured less those of the parameters found; and less those of the file's [N m, N].
    """

    t: Array
    torques: Array
    residuals: Array
    before: Array

    @property
    def rms(self) -> Array:
        """Root mean square of the residuals of each joint, shape (n,)."""
        return np.asarray(np.sqrt((self.residuals**2).mean(axis=0)))

    @property
    def rms_before(self) -> Array:
        """That with the file's parameters."""
        return np.asarray(np.sqrt((self.before**2).mean(axis=0)))


@dataclass(frozen=True, eq=False)
class Identification:
    """What a log says of a robot.

    Parameters
    ----------
    robot : Robot
        That it began from.
    joints : tuple of str
        Independent joints: those of residuals, noise and offsets.
    labels : tuple of Label
        Parameters: of each body mass, first moments and moments of inertia about the joint's origin, in the
        joint's axes; then of joints rotor inertia, damping and friction.
    values, sd, covariance, file_values : ndarray, shapes (P,), (P,), (P, P), (P,)
        Parameters of real bodies; what the file says counts as a measurement in their standard deviations.
    base : BaseParameters
        Combinations that torques depend on.
    base_values, base_sd, base_covariance : ndarray, shapes (rank,), (rank,), (rank, rank)
        Their estimates from the log alone.
    speed_labels : tuple of Label
        Speeds over which Coulomb friction turns: of joints that turn, and of those that slide, if it is
        unknown and `friction_speed` was not given.
    speeds, speed_sd, file_speeds : ndarray, shape (len(speed_labels),)
        [rad/s, m/s]
    offsets, offset_sd : ndarray, shape (n,)
        True less measured position of each independent joint; zero unless asked for [rad, m].
    position_noise, torque_noise : ndarray, shape (n,)
        Standard deviations of measurements [rad, m; N m, N].
    fitted, held_out : Residuals
        On the samples of the fit, and on others.
    messages : tuple of str
        What to know before the numbers are used.
    dynamics : InverseDynamics
        With these friction speeds.
    unknowns : Unknowns
    """

    robot: Robot
    joints: tuple[str, ...]
    labels: tuple[Label, ...]
    values: Array
    sd: Array
    covariance: Array
    file_values: Array
    base: BaseParameters
    base_values: Array
    base_sd: Array
    base_covariance: Array
    speed_labels: tuple[Label, ...]
    speeds: Array
    speed_sd: Array
    file_speeds: Array
    offsets: Array
    offset_sd: Array
    position_noise: Array
    torque_noise: Array
    fitted: Residuals
    held_out: Residuals
    messages: tuple[str, ...]
    dynamics: InverseDynamics
    unknowns: Unknowns

    def __repr__(self) -> str:
        found = zip(self.labels, self.values, self.sd, strict=True)
        rows = [f"{label.name}  {value:.4g} +- {1.96 * sd:.2g} {label.unit}" for label, value, sd in found]
        return "\n".join([f"<Identification of {self.robot.name}: {len(self.values)} parameters>", *rows])

    @property
    def bodies(self) -> tuple[tuple[UnknownBody, pin.Inertia], ...]:
        """Bodies that were unknown, and what they are now: mass, centre of mass, inertia about it."""
        parts = self.values[: PER_BODY * len(self.unknowns.bodies)].reshape(-1, PER_BODY)
        return tuple(
            (body, pin.Inertia.FromDynamicParameters(part))
            for body, part in zip(self.unknowns.bodies, parts, strict=True)
        )

    @property
    def identified(self) -> Robot:
        """The robot with the numbers found, for use in Python; problem files take what `save` writes."""
        dynamics, robot = self.dynamics, self.robot
        everything = self.unknowns.known + self.unknowns.shares @ self.values
        damping, friction = everything[-2 * robot.nv :].reshape(2, -1)
        losses = tuple(
            JointResistance(
                robot.v_labels[dof].name,
                dof,
                1.0,
                float(damping[dof]),
                float(friction[dof]),
                float(dynamics.speeds[dof]),
            )
            for dof in range(robot.nv)
            if damping[dof] or friction[dof]
        )
        return replace(robot, model=dynamics.with_values(everything), resistances=losses)

    def save(self, path: str | Path) -> Path:
        """Write the robot's URDF with the numbers found.

        Raises
        ------
        RobotFileError
            If it has none, or the file cannot be written.
        """
        from mbocp.identification.urdf_writer import write_urdf

        everything = self.unknowns.known + self.unknowns.shares @ self.values
        return write_urdf(self.dynamics, self.unknowns, everything, Path(path))


def identify(
    robot: Robot | str | Path,
    log: Log | str | Path,
    *,
    held_out: Log | str | Path | None = None,
    friction: str = "both",
    rotors: bool = False,
    payload: str | None = None,
    offsets: bool = False,
    torque_constants: Mapping[str, float] | None = None,
    friction_speed: float | None = None,
) -> Identification:
    r"""Find masses, inertias and friction of a robot from a recorded motion.

    Parameters
    ----------
    robot : Robot, str or Path
        A robot that does not float: its loops may close.
    log : Log, str or Path
        Positions and torques, or motor currents, of joints with motors; velocities and accelerations if they
        were measured. Files: `mbocp.identification.read_log`.
    held_out : Log, str or Path, optional
        On which the result is tested; the last fifth of `log` by default.
    friction : {"both", "viscous", "coulomb", "none"}
        Which is unknown, in joints with motors; the rest is as the robot has it.
    rotors : bool
        Whether rotor inertias are unknown.
    payload : str, optional
        Name of a payload of the robot, or of a frame: this body alone is unknown.
    offsets : bool
        Whether positions have unknown offsets, of about 0.1 rad or m at most.
    torque_constants : mapping of str to float, optional
        Torque at the joint by motor current [N m/A, N/A], of joints whose current was measured.
    friction_speed : float, optional
        w_s of the Coulomb friction F tanh(v / w_s) [rad/s, m/s]; by default it is found, too, or the robot's
        where the log does not tell it.

    Returns
    -------
    Identification

    Raises
    ------
    LogError, InvalidValue, UnknownJoint
        For what the log lacks or has wrong, by name.
    UnsupportedRobot
        For joints and actuators that it does not take.
    """
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    log = log if isinstance(log, Log) else read_log(log)
    dynamics = InverseDynamics(robot, friction_speed)
    unknowns = unknowns_of(dynamics, friction, rotors, payload)
    constants = dict(torque_constants or {})
    messages: list[str] = []
    data = measure_log(log, dynamics, constants, messages)
    if held_out is None:
        cut = int((1.0 - _HELD_OUT) * len(data.t))
        data, other = data.part(slice(cut)), data.part(slice(cut, None))
    else:
        held_out = held_out if isinstance(held_out, Log) else read_log(held_out)
        other = measure_log(held_out, dynamics, constants, [])
    base = base_of(dynamics, unknowns)
    speed_labels, turning = friction_speeds_of(dynamics, unknowns)
    if friction_speed is not None:
        speed_labels, turning = (), turning[:, :0]
    found = estimate(dynamics, unknowns, base, data, turning=turning, offsets=offsets)
    real = fit_consistent(unknowns, base, found.beta, found.covariance)
    everything = unknowns.known + unknowns.shares @ real.values
    sd = np.sqrt(np.diag(found.covariance))
    messages += describe(base, found, real.distance)
    fitted = _residuals(dynamics, found, data, everything, found.motion.qs)
    given = fitted.torques - fitted.before
    messages += ask(dynamics, found.motion, fitted.t, fitted.torques, given, fitted.residuals)
    return Identification(
        robot,
        dynamics.names,
        unknowns.labels,
        frozen_array(real.values),
        frozen_array(real.sd),
        frozen_array(real.covariance),
        frozen_array(unknowns.values),
        base,
        frozen_array(found.beta),
        frozen_array(sd),
        frozen_array(found.covariance),
        speed_labels,
        frozen_array(found.speeds),
        frozen_array(found.speed_sd),
        frozen_array(found.file_speeds),
        frozen_array(found.offsets),
        frozen_array(found.offset_sd),
        frozen_array(found.position_noise),
        frozen_array(found.torque_noise),
        fitted,
        _residuals(dynamics, found, other, everything),
        tuple(messages),
        found.dynamics,
        unknowns,
    )


def measure_log(
    log: Log, dynamics: InverseDynamics, constants: Mapping[str, float], messages: list[str]
) -> Measurements:
    """What a log has of the robot's independent joints and motors.

    Raises
    ------
    LogError
        For a missing column, and positions that the robot cannot have.
    UnknownJoint
        For a torque constant of a joint without a motor.
    """
    robot = dynamics.robot
    known = {*robot.joint_names, *(frame.name for frame in robot.model.frames)}
    others = list_names([joint for joint in log.joints if joint not in known], MOST_NAMES)
    for name in constants:
        if name not in [label.name for label in robot.u_labels]:
            raise robot.unknown_joint(name, [label.name for label in robot.u_labels])
    if others:
        messages.append(f"columns of {others} are not used: the robot has no such joint")
    unused = [n for n in log.joints if "q" in log.joints[n] and n in known.difference(dynamics.names)]
    if unused:
        messages.append(
            f"positions of {list_names(unused, MOST_NAMES)} are not used: loops or locks decide them"
        )
    positions = [_position(log, robot, name, others) for name in dynamics.names]
    rates = [
        np.stack([log.joints[name][kind] for name in dynamics.names], axis=1)
        if all(kind in log.joints[name] for name in dynamics.names)
        else None
        for kind in ("v", "a")
    ]
    controls = [_torque(log, label.name, constants) for label in robot.u_labels]
    return Measurements(log.t, (np.stack(positions, axis=1), rates[0], rates[1]), np.stack(controls, axis=1))


def _position(log: Log, robot: Robot, name: str, others: str) -> Array:
    """Positions of a joint; `others` names columns of joints that the robot does not have."""
    column, source = log.joints.get(name, {}).get("q"), Path(log.source)
    if column is None:
        question = f"it has {others}, which the robot does not have" if others else ""
        words = f"no column {name}.q: record the position of joint {name!r}, or lock it"
        raise LogError(source, with_question(words, question))
    if np.ptp(column) == 0.0:
        raise LogError(source, f"{name}.q: the joint does not move: move it, or lock it")
    return _unwrap(robot, name, column, source)


def _torque(log: Log, name: str, constants: Mapping[str, float]) -> Array:
    columns, source = log.joints.get(name, {}), Path(log.source)
    for kind in columns.keys() & {"tau", "current"}:
        if np.ptp(columns[kind]) == 0.0:
            raise LogError(source, f"{name}.{kind}: it does not change: record it, or take the motor away")
    if "tau" in columns:
        return columns["tau"]
    if "current" not in columns:
        raise LogError(source, f"no column {name}.tau: its torque, or its current, is needed")
    if name not in constants:
        raise LogError(source, f"{name}.current: give the torque constant of this joint [N m/A, N/A]")
    return np.asarray(constants[name] * columns["current"])


def _unwrap(robot: Robot, name: str, column: Array, source: Path) -> Array:
    """Positions of a joint without jumps of whole turns, if they are within reach."""
    where = robot.configuration_indices(name)
    if where.stop - where.start == 2:
        return np.asarray(np.unwrap(column))
    lower, upper = (
        float(bounds[where.start]) for bounds in (robot.limits.position_lower, robot.limits.position_upper)
    )
    worst = float(column[np.abs(column).argmax()])
    unit = "m" if robot.v_labels[robot.velocity_indices(name).start].unit == "m/s" else "rad"
    question = ask_degrees(worst, lower, upper, unit)
    if question:
        raise LogError(
            source,
            with_question(f"{name}.q: got {worst:.6g}, expected {lower:.4g} to {upper:.4g} rad", question),
        )
    return column


def _residuals(
    file: InverseDynamics,
    found: MaximumLikelihood,
    data: Measurements,
    everything: Array,
    near: Array | None = None,
) -> Residuals:
    """Along a spline through the positions: torques have no part in it."""
    y, yd, ydd, _ = smooth(data, knots_for(data))
    y, dynamics = y + found.offsets, found.dynamics
    motion = dynamics.motion(y, yd, ydd, dynamics.follow(y) if near is None else near)
    torques = dynamics.compute_applied_torques(motion, data.u)
    left, before = (
        torques - each.regressor(motion) @ values
        for each, values in ((dynamics, everything), (file, file.values))
    )
    return Residuals(data.t, torques, left, before)
