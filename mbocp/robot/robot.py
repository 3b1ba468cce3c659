"""The robot: configurations, closed loops and mechanics of a multibody system, in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array
from mbocp._text import warn_caller
from mbocp.exceptions import InvalidValue
from mbocp.robot import drives, kinematics
from mbocp.robot.collision.geometry import read_geometry
from mbocp.robot.collision.spheres import LinkSpheres, link_spheres
from mbocp.robot.large import make_working_data
from mbocp.robot.loops import projection
from mbocp.robot.mechanism import Mechanism
from mbocp.robot.payload import Payload, attach
from mbocp.robot.poses.inverse_kinematics import InverseKinematics, LimitChoice, solve_inverse_kinematics
from mbocp.robot.poses.pose_rows import placements_of
from mbocp.robot.poses.target import Targets
from mbocp.robot.resistance import resistance_forces
from mbocp.robot.warnings import NormalisationWarning

_MIN_NORM = 1e-8  # below, the direction of a quaternion is noise
_SLOW = 1e-3  # [rad/s, m/s], at which friction still grows with velocity
_ROUND_OFF = 1e-9  # a norm this close to 1 is normalised without a warning


@dataclass(frozen=True, eq=False, repr=False)
class Robot(Mechanism):
    r"""A multibody system, immutable.

    .. math:: M(q)\,\dot v + h(q, v) + \Phi_q(q)^T \lambda = B(q)\,u + f(q, v), \qquad \Phi(q) = 0

    q lives on the Lie group of the joints (free-flyer and spherical joints: unit quaternion xyzw; continuous
    joints: cos, sin; planar joints: x, y, cos, sin), v in its tangent space (free-flyer: twist of the body in
    its own axes, linear before angular). Components of v that drives move are given:
    :math:`v = V(q)\,s + U(q)\,u` with the speeds s, and only the rows of the other components stand above.

    The parameters are those of `RobotModel`, in its order.
    """

    def with_payload(self, *payloads: Payload) -> Robot:
        """Copy of the robot that carries bodies, beside those that it carries already.

        Parameters
        ----------
        *payloads : Payload

        Returns
        -------
        Robot
            With the same initial pose, in which motors of elastic joints hold the weight. Its `spec` names
            all payloads.

        Raises
        ------
        UnknownFrame
            If a payload's frame does not exist.
        UnsupportedRobot
            If a payload's frame does not move, or its name is that of a frame.
        """
        model, visuals = attach(self.model, self.visual_model, payloads, self.name)
        carried = (*self.payloads, *payloads)
        spec = {**self.spec, "payload": [payload.table for payload in carried]}
        laden = replace(self, model=model, visual_model=visuals, payloads=carried, spec=spec)
        return replace(laden, q0=laden.balanced(self.q0)) if self.elastic else laden

    # Collision geometry

    @cached_property
    def collision_model(self) -> pin.GeometryModel:
        """Solid shapes of links and payloads; read when first asked for.

        Raises
        ------
        RobotFileError
            If a mesh is missing or cannot be read, or a shape has no size.
        """
        return read_geometry(self.model, self.shapes, self.payloads, self.visual_model)

    @cached_property
    def collision_spheres(self) -> tuple[LinkSpheres, ...]:
        """Spheres that cover each link's solid shapes: given, those shapes, or fitted on first use.

        Raises
        ------
        RobotFileError
            As `collision_model`.
        """
        return link_spheres(self.model, self.collision_model, self.given_spheres, self.q0, self.name)

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
        for joint, group in self.unit_groups:
            norm = float(np.linalg.norm(array[group]))
            what = "quaternion" if group.stop - group.start == 4 else "cos/sin pair"
            where = f"{name}[{group.start}:{group.stop}], the {what} of joint {joint!r}"
            if norm < _MIN_NORM:
                raise InvalidValue(where, f"norm {norm:.3g}", "a unit vector")
            if abs(norm - 1.0) > _ROUND_OFF:
                warn_caller(f"{where}: norm {norm:.6g}, normalised to 1", NormalisationWarning)
            out[group] /= norm
        return frozen_array(out)

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
        return frozen_array(projection.assemble(self, self._vector(q, self.nq, "q"), fixed))

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
        return frozen_array(projection.assemble_velocity(self, q, v, projection.components(self, fixed)))

    # Poses of frames

    def frame_placement(
        self, frame: str, q: ArrayLike | None = None, relative_to: str = kinematics.WORLD
    ) -> pin.SE3:
        """Placement of a frame: `translation` [m] and `rotation`, in the axes of a reference frame.

        Parameters
        ----------
        frame : str
        q : array_like, shape (nq,), optional
            Configuration [m, rad, unit quaternion xyzw]; the initial pose by default.
        relative_to : str
            The reference frame.
        """
        at = self.q0 if q is None else self._vector(q, self.nq, "q")
        return placements_of(self.model, at[None], [(self.frame_id(frame), self.frame_id(relative_to))])[0][0]

    def inverse_kinematics(
        self,
        targets: Targets,
        start: ArrayLike | None = None,
        *,
        fixed: Sequence[str] = (),
        branches: int | None = 1,
        restarts: int = 100,
        seed: int = 0,
        within_limits: LimitChoice = True,
        tolerance: float = 1e-9,
    ) -> InverseKinematics:
        """Configurations in which frames have given poses, closed loops closed.

        Parameters
        ----------
        targets : FrameTarget, mapping, or a sequence of them
            Poses or parts of them, all to be reached together; a mapping has the words of `FrameTarget`, and
            x, y, z, and rpy (roll, pitch, yaw about fixed axes [rad]).
        start : array_like, shape (nq,), optional
            Where the search begins and from where distances count; the initial pose by default.
        fixed : sequence of str
            Joints that stay where they are at the start.
        branches : int, optional
            The search ends with so many distinct configurations; None for all that the restarts lead to. A
            robot with more joints than the targets ask for has a continuum of which these are samples.
        restarts : int
            Random starts that are tried at most.
        seed : int
            Of the random starts.
        within_limits : bool, or pair of array_like of shape (nq,)
            Whether the joints keep to the robot's own position limits, or to other ones [rad, m].
        tolerance : float
            Of each coordinate and rotation [m, rad].

        Returns
        -------
        InverseKinematics
            Also where no configuration reaches the targets: then `reached` is False.

        Raises
        ------
        DimensionMismatch, InvalidValue, UnknownFrame
            If a target cannot be right.
        """
        q = self.q0 if start is None else self.normalise(start, name="start")
        return solve_inverse_kinematics(
            self, targets, q, fixed, branches, restarts, seed, within_limits, tolerance
        )

    # Mechanics, numerically

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

    @cached_property
    def is_load(self) -> BoolArray:
        """Velocity components of trees of bodies in which no motor or drive acts, shape (nv,)."""
        acts = np.any(self.actuation_matrix(self.q0) != 0.0, axis=1)
        acts[[*self.driven, *(joint.at_v[0] for joint in self.elastic)]] = True
        found = np.zeros(self.nv, dtype=np.bool_)
        for tree in self.model.subtrees[1:]:
            if self.model.parents[tree[0]] == 0:
                last = self.model.joints[tree[-1]]
                at = slice(self.model.idx_vs[tree[0]], last.idx_v + last.nv)
                found[at] = not acts[at].any()
        found.setflags(write=False)
        return found

    def potential_energy(self, q: ArrayLike) -> float:
        """Potential energy of gravity and of the force elements [J]."""
        q = self._vector(q, self.nq, "q")
        springs = kinematics.force_potential(self.model, q, self.forces)
        springs += sum(float(joint.energy(q)) for joint in self.elastic)
        return kinematics.gravity_potential(self.model, q) + springs

    def force_elements(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Generalised force of springs, dampers and joints that lose energy, shape (nv,) [N, N m]."""
        q, v = self._vector(q, self.nq, "q"), self._vector(v, self.nv, "v")
        total = kinematics.force_elements(self.model, q, v, self.forces)
        total += resistance_forces(self.resistances, v)
        for joint in self.elastic:
            effort, (link, motor) = float(joint.effort(q, v)), joint.at_v
            total[link] += effort
            total[motor] -= effort
        return frozen_array(total)

    def force_elements_along(self, qs: Array, vs: Array) -> Array:
        """`force_elements` at each of n states, shape (n, nv)."""
        if self.forces or self.elastic:
            return np.array([self.force_elements(q, v) for q, v in zip(qs, vs, strict=True)])
        return resistance_forces(self.resistances, vs.T).T

    def balanced(self, q: ArrayLike, given: ArrayLike | None = None) -> Array:
        """Turn the motors of elastic joints to where the robot stays at rest, shape (nq,).

        Their springs, other motors and constraints balance gravity and force elements; where these leave a
        choice, with the least forces.

        Parameters
        ----------
        q : array_like, shape (nq,)
        given : array_like of bool, shape (nv,), optional
            Motors that stay where they are; none by default.
        """
        found = np.array(self._vector(q, self.nq, "q"))
        stays = np.zeros(self.nv, dtype=np.bool_) if given is None else np.asarray(given)
        turned = np.array([not stays[joint.at_v[1]] for joint in self.elastic], dtype=np.bool_)
        if not turned.any():
            return frozen_array(found)
        link, motor = np.array([joint.at_q for joint in self.elastic]).T
        relaxed, still = found.copy(), np.zeros(self.nv)
        relaxed[motor] = found[link]
        force = pin.rnea(self.model, make_working_data(self.model), relaxed, still, still)
        force = force - self.force_elements(relaxed, still)
        springs = np.zeros((self.nv, len(self.elastic)))
        for k, joint in enumerate(self.elastic):
            springs[joint.at_v[0], k] = 1.0
        columns = np.hstack([springs, self.actuation_matrix(relaxed), self.constraint_jacobian(relaxed).T])
        rows = np.setdiff1d(np.arange(self.nv), [joint.at_v[1] for joint in self.elastic])
        efforts = np.linalg.lstsq(columns[rows], force[rows], rcond=None)[0][: len(self.elastic)]
        bent = efforts / [joint.stiffness for joint in self.elastic]
        found[motor[turned]] = (found[link] + bent)[turned]
        return frozen_array(found)

    @cached_property
    def fastest_damping(self) -> tuple[str, float]:
        """The joint that damping slows fastest, and that rate [1/s]; "" and 0 where there is none.

        Rates are eigenvalues of D v = rate M v at the initial pose, D the derivative of damping and friction.
        """
        if not (self.resistances or self.forces or self.elastic):
            return "", 0.0
        at_rest = self.force_elements(self.q0, np.zeros(self.nv))
        moved = [self.force_elements(self.q0, _SLOW * one) for one in np.eye(self.nv)]
        damping = (at_rest - np.array(moved).T) / _SLOW
        root = np.linalg.inv(np.linalg.cholesky(self.mass_matrix(self.q0)))
        rates, ways = np.linalg.eigh(root @ (damping + damping.T) / 2.0 @ root.T)
        fastest = root.T @ ways[:, -1]
        return self.v_labels[int(np.argmax(fastest * (damping @ fastest)))].name, float(rates[-1])

    # Drives

    def speed_map(self, q: ArrayLike) -> Array:
        """V(q) of v = V s + U u, shape (nv, num_speeds); the identity without drives."""
        return frozen_array(drives.speed_maps(self, self._vector(q, self.nq, "q")[None])[0])

    def control_velocity_map(self, q: ArrayLike) -> Array:
        """U(q) of v = V s + U u, shape (nv, nu); zero but for drives whose control is a velocity."""
        return frozen_array(drives.control_velocity_maps(self, self._vector(q, self.nq, "q")[None])[0])

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
        force = pin.rnea(self.model, make_working_data(self.model), q, v, a) - self.force_elements(q, v)
        if u is not None:
            force = force - self.actuation_matrix(q) @ self._vector(u, self.nu, "u")
        if lam is not None:
            force = force + self.constraint_jacobian(q).T @ self._vector(lam, self.nc, "lam")
        return frozen_array([drives.drive_column(self.model, drive, q) @ force for drive in self.drives])
