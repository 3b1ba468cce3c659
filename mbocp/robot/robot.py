"""The robot: an immutable multibody model with its actuation, constraints and force elements."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import InvalidValue
from mbocp.robot import closing, drives, joints, kinematics
from mbocp.robot.closure import Closure
from mbocp.robot.constraints import Constraint
from mbocp.robot.large import working_data
from mbocp.robot.parts import Actuation, Connector, Drive, Label, Limits, QuarticSpring, SpringDamper
from mbocp.robot.resistance import JointResistance, resistance_forces
from mbocp.robot.warnings import NormalisationWarning

__all__ = ["Robot"]

_VELOCITY_UNITS = {"m": "m/s", "rad": "rad/s"}
_MOMENTUM_UNITS = {"m": "N s", "rad": "N m s"}
_ROTATIONS = ("quaternion", "dcm")
_ZERO_NORM = 1e-8  # below, the direction of a quaternion is noise
_ROUND_OFF = 1e-9  # a norm this close to 1 is mended without a word


@dataclass(frozen=True, eq=False)
class Robot:
    r"""A multibody system, immutable.

    .. math:: M(q)\,\dot v + h(q, v) + \Phi_q(q)^T \lambda = B(q)\,u + f(q, v), \qquad \Phi(q) = 0

    q lives on the Lie group of the joints (free-flyer and spherical joints: unit quaternion xyzw; continuous
    joints: cos, sin; planar joints: x, y, cos, sin), v in its tangent space (free-flyer: twist of the body in
    its own axes, linear before angular). Components of v that drives move are given:
    :math:`v = V(q)\,s + U(q)\,u` with the speeds s, and only the rows of the other components stand above.

    Parameters
    ----------
    name : str
        Name for messages and files.
    model : pin.Model
        Tree of joints and inertias, after locking, with gravity set. Not to be changed.
    visual_model : pin.GeometryModel
        Shapes and paths of the meshes that were found. The `geometry` of a mesh is an empty placeholder.
    actuation : Actuation
        B(q).
    constraints : tuple of Constraint
        Phi(q) = 0, see `mbocp.robot.constraints`.
    forces : tuple of QuarticSpring or SpringDamper
        f(q, v).
    q0 : ndarray, shape (nq,)
        Initial pose [m, rad, unit quaternion xyzw].
    limits : Limits
        Bounds on u, v and q.
    source : Path or None
        The URDF.
    trace_frames : tuple of str
        Frames that a replay traces by default.
    connectors : tuple of Connector
        What a replay draws between frames: rods and springs.
    spec : dict
        What `robot_from_spec` needs to load this robot again; JSON-able.
    description : str
        One line for a person.
    rotations : {"quaternion", "dcm"}
        How explicit schemes represent the rotations of free-flyers and ball joints in their state: four
        numbers or the nine of a direction cosine matrix. q has the quaternion in either case.
    redundant_rows : tuple of int
        Rows that the equations leave out because the others imply them; counted over all constraints.
    resistances : tuple of JointResistance
        Damping and friction of joints: the part of f(q, v) that acts on one velocity each.
    """

    name: str
    model: pin.Model
    visual_model: pin.GeometryModel
    actuation: Actuation
    constraints: tuple[Constraint, ...]
    forces: tuple[QuarticSpring | SpringDamper, ...]
    q0: Array
    limits: Limits
    source: Path | None = None
    trace_frames: tuple[str, ...] = ()
    connectors: tuple[Connector, ...] = ()
    spec: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""
    rotations: str = "quaternion"
    redundant_rows: tuple[int, ...] = ()
    resistances: tuple[JointResistance, ...] = ()

    def __post_init__(self) -> None:
        if self.rotations not in _ROTATIONS:
            allowed = " or ".join(map(repr, _ROTATIONS))
            raise InvalidValue(f"robot {self.name!r}: rotations", repr(self.rotations), allowed)
        object.__setattr__(self, "q0", frozen_array(self.q0, shape=(self.nq,), name=f"{self.name}: q0"))
        frozen_array(
            self.actuation.selection, shape=(self.nv, None), name=f"{self.name}: actuation.selection"
        )

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, nq={self.nq}, nv={self.nv}, nu={self.nu}, nc={self.nc})"

    # Dimensions and names

    @property
    def nq(self) -> int:
        """Length of q."""
        return int(self.model.nq)

    @property
    def nv(self) -> int:
        """Length of v and p."""
        return int(self.model.nv)

    @property
    def nu(self) -> int:
        """Number of controls."""
        return self.actuation.nu

    @property
    def nc(self) -> int:
        """Number of rows of the holonomic constraints that the equations keep."""
        return len(self.kept_rows)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, without the universe."""
        return joints.joint_names(self.model)

    @cached_property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames; "world" also means the first, the universe."""
        return tuple(frame.name for frame in self.model.frames)

    @cached_property
    def q_labels(self) -> tuple[Label, ...]:
        """Name and unit of each number of q."""
        return joints.position_labels(self.model)

    @cached_property
    def v_labels(self) -> tuple[Label, ...]:
        """Name and unit of each number of v."""
        return joints.velocity_labels(self.model, _VELOCITY_UNITS)

    @cached_property
    def p_labels(self) -> tuple[Label, ...]:
        """Name and unit of each number of p."""
        return joints.velocity_labels(self.model, _MOMENTUM_UNITS)

    @property
    def u_labels(self) -> tuple[Label, ...]:
        """Name and unit of each control."""
        return self.actuation.labels

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Controls that prescribe a motion."""
        return self.actuation.drives

    @cached_property
    def driven(self) -> tuple[int, ...]:
        """Velocity components that drives move, in ascending order."""
        return tuple(sorted(dof for drive in self.drives for dof in drive.dofs))

    @property
    def num_speeds(self) -> int:
        """Number of speeds s: components that no drive moves, and drives whose control is an acceleration."""
        return self.nv - len(self.driven) + sum(drive.has_state for drive in self.drives)

    @cached_property
    def speed_labels(self) -> tuple[Label, ...]:
        """Name and unit of each speed; those of v if there are no drives."""
        stated = (Label(drive.name, drive.speed_unit) for drive in self.drives if drive.has_state)
        return (*(self.v_labels[dof] for dof in drives.free_dofs(self)), *stated)

    @cached_property
    def closure_labels(self) -> tuple[Label, ...]:
        """Name and unit of each row of the constraints, the redundant ones included."""
        return tuple(label for constraint in self.constraints for label in constraint.rows)

    @cached_property
    def kept_rows(self) -> tuple[int, ...]:
        """Rows of the constraints that the equations keep, counted over all constraints in order."""
        return tuple(i for i in range(len(self.closure_labels)) if i not in self.redundant_rows)

    @cached_property
    def constraint_labels(self) -> tuple[Label, ...]:
        """Name and unit of each row that the equations keep."""
        return tuple(self.closure_labels[i] for i in self.kept_rows)

    @cached_property
    def is_vector_space(self) -> bool:
        """Whether every joint's configuration is a plain vector (nq == nv, no circles, no quaternions)."""
        return all(joints.joint_kind(self.model, j).is_vector for j in range(1, self.model.njoints))

    @property
    def has_forces(self) -> bool:
        """Whether springs, dampers or losses of joints act."""
        return bool(self.forces or self.resistances)

    @property
    def has_limits(self) -> bool:
        """Whether any effort, velocity or position is limited."""
        return self.limits.any_finite

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 over all that shapes the equations: model, actuation, constraints, forces, losses."""
        digest = hashlib.sha256(self.model.saveToString().encode())
        digest.update(self.actuation.selection.tobytes())
        for actuator in self.actuation.frame_actuators:
            digest.update(repr(actuator.frame_id).encode() + actuator.direction.tobytes())
        digest.update(repr((self.actuation.labels, self.constraints, self.forces)).encode())
        if self.redundant_rows:
            digest.update(repr(self.redundant_rows).encode())
        if self.resistances:
            digest.update(repr(self.resistances).encode())
        for drive in self.drives:
            digest.update(
                repr((drive.control, drive.dofs, drive.frame_id)).encode() + drive.direction.tobytes()
            )
        return digest.hexdigest()

    def frame_id(self, name: str) -> int:
        """Index of a frame by name; "world" is the universe. Bodies come before joints of the same name.

        Raises
        ------
        UnknownFrame
            If there is no such frame.
        """
        return kinematics.frame_id(self.model, name, self.name)

    def configuration_indices(self, joint: str) -> slice:
        """Range of a joint in q (empty for a mimic joint). Raises `UnknownJoint`."""
        return joints.configuration_slice(self.model, joints.joint_id(self.model, joint, self.name))

    def velocity_indices(self, joint: str) -> slice:
        """Range of a joint in v and p (empty for a mimic joint). Raises `UnknownJoint`."""
        return joints.velocity_slice(self.model, joints.joint_id(self.model, joint, self.name))

    # Configurations

    def neutral(self) -> Array:
        """The configuration with every joint at zero, shape (nq,)."""
        return frozen_array(pin.neutral(self.model))

    def normalise(self, q: ArrayLike, *, name: str = "q") -> Array:
        """Bring `q` onto its manifold: unit quaternions, unit cos/sin pairs.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Configuration [m, rad, quaternion xyzw].
        name : str
            What q is called in messages.

        Returns
        -------
        q : ndarray, shape (nq,)

        Raises
        ------
        DimensionMismatch
            If the length is wrong.
        InvalidValue
            If a number is not finite or a quaternion has zero norm.

        Warns
        -----
        NormalisationWarning
            If a norm differed from 1 by more than 1e-9.
        """
        array = self._vector(q, self.nq, name)
        out = array.copy()
        for joint, group in joints.unit_groups(self.model):
            norm = float(np.linalg.norm(array[group]))
            what = "quaternion" if group.stop - group.start == 4 else "cos/sin pair"
            where = f"{name}[{group.start}:{group.stop}], the {what} of joint {joint!r}"
            if norm < _ZERO_NORM:
                raise InvalidValue(where, f"norm {norm:.3g}", "a unit vector")
            if abs(norm - 1.0) > _ROUND_OFF:
                warnings.warn(
                    f"{where}: norm {norm:.6g}, normalised to 1", NormalisationWarning, stacklevel=2
                )
            out[group] /= norm
        return frozen_array(out)

    def integrate(self, q: ArrayLike, dv: ArrayLike) -> Array:
        """Move from `q` along the tangent vector `dv`: q ∘ exp(dv), shape (nq,)."""
        q, dv = self._vector(q, self.nq, "q"), self._vector(dv, self.nv, "dv")
        return frozen_array(pin.integrate(self.model, q, dv))

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Tangent vector at `q0` that leads to `q1`, shape (nv,)."""
        q0, q1 = self._vector(q0, self.nq, "q0"), self._vector(q1, self.nq, "q1")
        return frozen_array(pin.difference(self.model, q0, q1))

    # Closed loops

    def assemble(self, q: ArrayLike, *, fixed: Sequence[str] = ()) -> Array:
        """Nearest configuration that fulfils the holonomic constraints, in the norm of the mass matrix.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Configuration [m, rad, unit quaternion xyzw].
        fixed : sequence of str
            Joints that stay where they are.

        Returns
        -------
        q : ndarray, shape (nq,)
            With residuals below 1e-10 [m, rad, m^2], round-off as a rule; `q` itself without constraints.

        Raises
        ------
        LoopNotClosed
            If no configuration near `q` closes the loops, naming rows and residuals.
        UnknownJoint
            For a name in `fixed` that the robot does not have.
        """
        return frozen_array(closing.assemble(self, self._vector(q, self.nq, "q"), fixed))

    def assemble_velocity(self, q: ArrayLike, v: ArrayLike, *, fixed: Sequence[str] = ()) -> Array:
        """Nearest velocity along the holonomic constraints at `q`, in the norm of the mass matrix.

        Parameters
        ----------
        q, v : array_like, shapes (nq,), (nv,)
            Configuration that closes the loops, and velocity [m, rad, s].
        fixed : sequence of str
            Joints whose velocity stays.

        Returns
        -------
        v : ndarray, shape (nv,)
            Where the fixed joints allow no velocity along the constraints, one that violates them least.
        """
        q, v = self._vector(q, self.nq, "q"), self._vector(v, self.nv, "v")
        return frozen_array(closing.assemble_velocity(self, q, v, closing.components(self, fixed)))

    # Mechanics, numerically

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Joint-space mass matrix M(q), shape (nv, nv) [kg, kg m, kg m^2]."""
        return frozen_array(kinematics.mass_matrix(self.model, self._vector(q, self.nq, "q")))

    def momentum(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Canonical momentum p = M(q) v, shape (nv,) [N s, N m s]."""
        return frozen_array(self.mass_matrix(q) @ self._vector(v, self.nv, "v"))

    def velocity_from_momentum(self, q: ArrayLike, p: ArrayLike) -> Array:
        """Velocity v with M(q) v = p, shape (nv,) [m/s, rad/s].

        Where M is singular and constraints make up for it, the least-squares velocity that satisfies them.
        """
        q, p = self._vector(q, self.nq, "q"), self._vector(p, self.nv, "p")
        mass, jacobian = self.mass_matrix(q), self.constraint_jacobian(q)
        return frozen_array(kinematics.velocity_from_momentum(mass, jacobian, p))

    def actuation_matrix(self, q: ArrayLike) -> Array:
        """B(q), shape (nv, nu): generalised force for each control set to 1; zero for drives."""
        q = self._vector(q, self.nq, "q")
        columns = [self.actuation.selection]
        for actuator in self.actuation.frame_actuators:
            jacobian = kinematics.frame_jacobian(self.model, q, actuator.frame_id, pin.LOCAL)
            columns.append((jacobian.T @ actuator.direction)[:, None])
        columns.append(np.zeros((self.nv, len(self.drives))))
        return frozen_array(np.hstack(columns))

    def constraint_residual(self, q: ArrayLike) -> Array:
        """Phi(q), the rows that the equations keep, shape (nc,) [m, rad, m^2]."""
        return frozen_array(self.closure_residual(q)[self._kept])

    def constraint_jacobian(self, q: ArrayLike) -> Array:
        """dPhi_dq in tangent coordinates, the rows that the equations keep, shape (nc, nv)."""
        return frozen_array(self.closure_jacobian(q)[self._kept])

    def closure_residual(self, q: ArrayLike) -> Array:
        """Residual of all rows of the constraints, the redundant ones included [m, rad, m^2]."""
        return frozen_array(self._closure.residual(self._vector(q, self.nq, "q")))

    def closure_jacobian(self, q: ArrayLike) -> Array:
        """Derivative of `closure_residual` in tangent coordinates, shape (rows, nv)."""
        return frozen_array(self._closure.jacobian(self._vector(q, self.nq, "q")))

    def closure_along(self, qs: ArrayLike) -> tuple[Array, Array]:
        """`closure_residual` and `closure_jacobian` at many configurations, faster than one by one.

        Parameters
        ----------
        qs : array_like, shape (n, nq)

        Returns
        -------
        residuals : ndarray, shape (n, rows)
            [m, rad, m^2].
        jacobians : ndarray, shape (n, rows, nv)
        """
        array = frozen_array(qs, shape=(None, self.nq), name=f"robot {self.name!r}: qs")
        if not np.isfinite(array).all():
            raise InvalidValue(f"robot {self.name!r}: qs", "numbers that are not finite", "finite numbers")
        residuals, jacobians = self._closure.along(array)
        return frozen_array(residuals), frozen_array(jacobians)

    @cached_property
    def _closure(self) -> Closure:
        return Closure(self.model, self.constraints)

    @property
    def _kept(self) -> NDArray[np.intp]:
        return np.array(self.kept_rows, dtype=np.intp)

    def potential_energy(self, q: ArrayLike) -> float:
        """Potential energy of gravity and of the force elements [J]."""
        q = self._vector(q, self.nq, "q")
        return kinematics.gravity_potential(self.model, q) + kinematics.force_potential(
            self.model, q, self.forces
        )

    def force_elements(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Generalised force of springs, dampers and joints that lose energy, shape (nv,) [N, N m]."""
        q, v = self._vector(q, self.nq, "q"), self._vector(v, self.nv, "v")
        elements = kinematics.force_elements(self.model, q, v, self.forces)
        return frozen_array(elements + resistance_forces(self.resistances, v))

    # Drives

    def speed_map(self, q: ArrayLike) -> Array:
        """V(q) of v = V s + U u, shape (nv, num_speeds); the identity without drives."""
        return frozen_array(drives.speed_map(self, self._vector(q, self.nq, "q")))

    def control_velocity_map(self, q: ArrayLike) -> Array:
        """U(q) of v = V s + U u, shape (nv, nu); zero but for drives whose control is a velocity."""
        return frozen_array(drives.control_velocity_map(self, self._vector(q, self.nq, "q")))

    def speeds(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Speeds s of a velocity, shape (num_speeds,); v itself without drives.

        Raises
        ------
        InvalidValue
            If the drives do not allow this velocity, naming joints and drive.
        """
        q, v = self._vector(q, self.nq, "q"), self._vector(v, self.nv, "v")
        return frozen_array(drives.reduce_velocity(self, q, v) if self.drives else v)

    def drive_forces(
        self,
        q: ArrayLike,
        v: ArrayLike,
        a: ArrayLike,
        u: ArrayLike | None = None,
        lam: ArrayLike | None = None,
    ) -> Array:
        r"""Generalised force that each drive must supply for a motion, by inverse dynamics.

        .. math:: S(q)^T \left(M a + h - f - B u + \Phi_q^T \lambda\right)_\mathrm{dofs}

        The force on the drive's speed: its product with the speed is the power that the drive supplies.

        Parameters
        ----------
        q, v, a : array_like, shapes (nq,), (nv,), (nv,)
            Configuration, velocity and acceleration (dv/dt) [m, rad, s].
        u : array_like, shape (nu,), optional
            Controls: motors and thrusters that act beside the drives; none act by default.
        lam : array_like, shape (nc,), optional
            Multipliers of the constraints; zero by default.

        Returns
        -------
        forces : ndarray, shape (number of drives,)
            [N, N m].
        """
        q, v, a = self._vector(q, self.nq, "q"), self._vector(v, self.nv, "v"), self._vector(a, self.nv, "a")
        force = pin.rnea(self.model, working_data(self.model), q, v, a) - self.force_elements(q, v)
        if u is not None:
            force = force - self.actuation_matrix(q) @ self._vector(u, self.nu, "u")
        if lam is not None:
            force = force + self.constraint_jacobian(q).T @ self._vector(lam, self.nc, "lam")
        return frozen_array([drives.drive_column(self.model, drive, q) @ force for drive in self.drives])

    def _vector(self, value: ArrayLike, size: int, name: str) -> Array:
        array = frozen_array(value, shape=(size,), name=f"robot {self.name!r}: {name}")
        if not np.isfinite(array).all():
            raise InvalidValue(f"robot {self.name!r}: {name}", array.tolist(), "finite numbers")
        return array
