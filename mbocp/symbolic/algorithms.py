"""The functions of one model, built when they are first asked for, and compared with numeric Pinocchio.

The comparison is the last line of defence against a native part that does not fit.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp.exceptions import InvalidValue, NativeMismatch, UnknownFrame
from mbocp.symbolic.bridge import bridge, native_constraint
from mbocp.symbolic.model_numbers import ModelNumber, values_of, with_values

Reference: TypeAlias = Literal["local", "world", "local_world_aligned"]

_REFERENCES: dict[str, int] = {
    "world": int(pin.ReferenceFrame.WORLD),
    "local": int(pin.ReferenceFrame.LOCAL),
    "local_world_aligned": int(pin.ReferenceFrame.LOCAL_WORLD_ALIGNED),
}
# Round-off of a recursion over a hundred joints stays below this, relative to the largest joint force;
# numbers read through a foreign memory layout do not.
TOLERANCE = 1e-8

_CACHE_SIZE = 16  # models; a humanoid's graphs are some ten megabytes
_cache: dict[str, ModelFunctions] = {}


class _Algorithm(cached_property[ca.Function]):
    """An algorithm of the kernel that goes by the name of an attribute."""

    def __init__(self, words: str, *, of_mass: str = "") -> None:
        super().__init__(self._of)
        self.__doc__, self._of_mass = words, of_mass

    def _of(self, functions: ModelFunctions) -> ca.Function:
        if self._of_mass:
            functions._require_mass(self._of_mass)
        return functions._build(str(self.attrname))


class ModelFunctions:
    """Pinocchio's algorithms for one model, as `casadi.Function` over SX.

    Each attribute is built when it is first used and kept. Called with numbers a function computes, called
    with SX it inlines its graph, called with MX it becomes a call node. Matrices are dense. Configurations q
    are Pinocchio's (nq,) (quaternions xyzw, cosine and sine of continuous joints), velocities v its tangent
    vectors (nv,): of a free-flyer in the body frame, linear before angular.

    Mimic joints work in every function, `aba` and `minverse` included.

    Parameters
    ----------
    model : pinocchio.Model
        The model; `model_functions` keeps one object for each.
    given : sequence of ModelNumber
        Numbers of the model that every function takes as its last argument, shape (len(given),), in place of
        those of the model; none by default, and no such argument.

    Attributes
    ----------
    given : tuple of ModelNumber
    nq, nv : int
        Sizes of configuration and velocity.
    frames : tuple of str
        Names of the frames, in Pinocchio's order.
    """

    rnea = _Algorithm("Inverse dynamics, (q, v, a) -> tau (nv,) [N, N m].")
    nonlinear_effects = _Algorithm("Coriolis, centrifugal and gravity terms, (q, v) -> b (nv,) [N, N m].")
    gravity = _Algorithm("Gravity terms, q -> g (nv,) [N, N m].")
    aba = _Algorithm("Forward dynamics, (q, v, tau) -> a (nv,) [m/s^2, rad/s^2].")
    minverse = _Algorithm("Inverse of the inertia matrix, q -> M^-1 (nv, nv), full.")
    crba = _Algorithm(
        "Joint-space inertia matrix, q -> M (nv, nv), full and symmetric, armature included [kg, kg m^2]."
    )
    kinetic_energy = _Algorithm("Kinetic energy, (q, v) -> T [J].")
    potential_energy = _Algorithm("Potential energy of gravity, q -> V [J].")
    center_of_mass = _Algorithm(
        "Centre of mass in the world frame, q -> c (3,) [m]; InvalidValue if nothing that moves has mass.",
        of_mass="centre of mass",
    )
    centroidal_momentum = _Algorithm(
        "Momentum about the centre of mass, world axes, linear first, (q, v) -> h (6,) [kg m/s, N m s]; "
        "InvalidValue if nothing that moves has mass.",
        of_mass="momentum about the centre of mass",
    )
    integrate = _Algorithm(
        "The configuration reached from q with the tangent vector v in unit time, (q, v) -> q1 (nq,)."
    )
    difference = _Algorithm("The tangent vector that leads from q0 to q1 in unit time, (q0, q1) -> v (nv,).")
    dintegrate = _Algorithm(
        "Jacobians of `integrate` in tangent coordinates, (q, v) -> J_q (nv, nv), J_v (nv, nv)."
    )

    def __init__(self, model: pin.Model, given: Sequence[ModelNumber] = ()) -> None:
        self.given = tuple(given)
        native = [bridge().ModelNumber(*number) for number in self.given]
        self._robot = bridge().Robot(model.saveToString(), *([native] if native else []))
        self._name = str(model.name)
        self._mass = sum(float(inertia.mass) for inertia in list(model.inertias)[1:])
        self._joints = tuple(str(name) for name in model.names)
        self._requested: dict[tuple[str, int, str], ca.Function] = {}
        self.frames: tuple[str, ...] = tuple(str(frame.name) for frame in model.frames)
        self.nq: int = self._robot.nq
        self.nv: int = self._robot.nv

    def __repr__(self) -> str:
        return f"ModelFunctions({self._name!r}, nq={self.nq}, nv={self.nv})"

    def frame_placement(self, frame: str | int) -> ca.Function:
        """Placement of a frame in the world, q -> R (3, 3), p (3,) [m].

        Parameters
        ----------
        frame : str or int
            Name, or index as in `pinocchio.Model.frames`. Of several frames of one name the first is meant.

        Raises
        ------
        UnknownFrame
            If the model has no such frame.
        """
        index = self._frame_index(frame)
        return self._request("placement", index, "", lambda: self._robot.frame_placement(index))

    def frame_jacobian(self, frame: str | int, reference: Reference = "local") -> ca.Function:
        """Jacobian of a frame, q -> J (6, nv), so that its velocity is J v, linear before angular.

        Parameters
        ----------
        frame : str or int
            Name or index.
        reference : {"local", "world", "local_world_aligned"}
            Axes and point of the velocity, as in `pinocchio.ReferenceFrame`.
        """
        index, rf = self._frame_index(frame), _reference(reference)
        return self._request("jacobian", index, reference, lambda: self._robot.frame_jacobian(index, rf))

    def frame_velocity(self, frame: str | int, reference: Reference = "local") -> ca.Function:
        """Velocity of a frame, (q, v) -> twist (6,), linear before angular [m/s, rad/s]."""
        index, rf = self._frame_index(frame), _reference(reference)
        return self._request("velocity", index, reference, lambda: self._robot.frame_velocity(index, rf))

    def constraint_jacobian(self, constraints: Sequence[pin.RigidConstraintModel]) -> ca.Function:
        """Jacobian of rigid constraints, q -> J (nc, nv), their rows one below the other.

        Parameters
        ----------
        constraints : sequence of pinocchio.RigidConstraintModel
            3-D (two points coincide) or 6-D (two frames coincide), in the local or the local-world-aligned
            frame: the rows are those of `pinocchio.getConstraintJacobian`.

        Raises
        ------
        InvalidValue, UnknownJoint
            If a constraint is of another kind, or names a joint that the model does not have.
        """
        rows = [native_constraint(constraint, self._joints, self._name) for constraint in constraints]
        return ca.Function.deserialize(self._robot.constraint_jacobian(rows))

    def _require_mass(self, what: str) -> None:
        if not self._mass > 0.0:
            raise InvalidValue(f"{self._name}: {what}: mass", self._mass, "a robot whose bodies have mass")

    def _build(self, name: str) -> ca.Function:
        return ca.Function.deserialize(self._robot.function(name))

    def _request(self, kind: str, index: int, reference: str, build: Callable[[], str]) -> ca.Function:
        key = (kind, index, reference)
        if key not in self._requested:
            self._requested[key] = ca.Function.deserialize(build())
        return self._requested[key]

    def _frame_index(self, frame: str | int) -> int:
        if isinstance(frame, str):
            if frame not in self.frames:
                raise UnknownFrame(frame, self._name, self.frames)
            return self.frames.index(frame)
        index = operator.index(frame)
        if not 0 <= index < len(self.frames):
            raise UnknownFrame(f"#{index}", self._name, self.frames)
        return index


def _reference(reference: str) -> int:
    if reference not in _REFERENCES:
        raise InvalidValue("reference", repr(reference), " or ".join(repr(name) for name in _REFERENCES))
    return _REFERENCES[reference]


def model_functions(model: pin.Model, given: Sequence[ModelNumber] = ()) -> ModelFunctions:
    """Return the functions of `model`, self-tested: the same object for equal models.

    Parameters
    ----------
    model : pinocchio.Model
        Any model. It is copied: a model that was changed has other functions.
    given : sequence of ModelNumber
        Numbers that the functions take as their last argument: models that differ in these alone share them.

    Raises
    ------
    NativeMismatch
        If the native part does not fit the installed Pinocchio or CasADi.
    """
    key = text_without(model, given)
    functions = _cache.pop(key, None)
    if functions is None:
        functions = ModelFunctions(model, given)
        _compare(model, functions)
    _cache[key] = functions  # the latest last
    while len(_cache) > _CACHE_SIZE:
        _cache.pop(next(iter(_cache)))
    return functions


def text_without(model: pin.Model, given: Sequence[ModelNumber]) -> str:
    """All numbers of a model but those that are given, and which these are; without any, all of it."""
    if not given:
        return str(model.saveToString())
    others = with_values(model, given, np.zeros(len(given)))
    for frame in others.frames:
        frame.inertia = pin.Inertia.Zero()  # what is told of a body's parts; no equation knows it
    return f"{others.saveToString()} {[tuple(number) for number in given]}"


def self_test(model: pin.Model) -> None:
    """Check the symbolic inverse dynamics of `model` against `pinocchio.aba` at a random state.

    Symbolic RNEA must undo numeric ABA. Where ABA does not apply (mimic joints, massless bodies) numeric RNEA
    takes its place. `model_functions` has done this once for each model of the process; a mechanics needs
    RNEA anyway, so it costs little more than one evaluation.

    Raises
    ------
    NativeMismatch
        If the two disagree.
    """
    _compare(model, model_functions(model))


def _compare(model: pin.Model, functions: ModelFunctions) -> None:
    rng = np.random.default_rng(0)
    data = pin.Data(model)  # model.createData() would make it twice, and copy
    # Pinocchio's own generator of random configurations is left alone: its state is the user's.
    numbers = [values_of(model, functions.given)] if functions.given else []
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
    v, a = rng.standard_normal((2, model.nv))
    tau = np.array(functions.rnea(q, v, a, *numbers)).ravel()
    reference = pin.rnea(model, data, q, v, a)
    if not len(model.mimicking_joints):
        acceleration = pin.aba(model, data, q, v, tau)
        if np.isfinite(acceleration).all():
            reference = np.array(functions.rnea(q, v, acceleration, *numbers)).ravel()
    error = float(np.abs(tau - reference).max(initial=0.0))
    scale = max(1.0, float(np.abs(tau).max(initial=0.0)))
    if not error <= TOLERANCE * scale:  # written so that NaN fails
        raise NativeMismatch(
            f"mbocp's native part does not agree with the installed Pinocchio {pin.__version__} on model "
            f"{model.name!r}: joint forces differ by {error:.3g} of {scale:.3g} [N, N m]. Reinstall mbocp, "
            "so that it is compiled against this Pinocchio"
        )
