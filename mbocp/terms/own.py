"""Terms of a user's own: functions of symbolic kinematics that return a CasADi expression.

    def manipulability(at):
        J = at.jacobian("tool0")
        return -ca.sqrt(ca.det(J @ J.T))

    problem = problem.with_(terms=[running_cost(manipulability, weight=0.1)])

The function is called once, when the problem is made, with a `Kinematics`. Its expression is
differentiated twice, compiled and cached as all others are; its numbers are parameters, which never
recompile. A result keeps name, digest and numbers of a term, not its code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from functools import lru_cache
from typing import Any, Literal, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.mechanics import JointMechanics, symbols_of
from mbocp.robot import Robot
from mbocp.terms.own_kinematics import Kinematics
from mbocp.terms.point import Point
from mbocp.terms.span import Span, end_from

Role: TypeAlias = Literal["running", "terminal", "path", "end"]
ROLES: dict[str, str] = {
    "running": "running cost",
    "terminal": "terminal cost",
    "path": "path constraint",
    "end": "end condition",
}
_SYMBOLS = {"running": "uat", "terminal": "", "path": "ua", "end": ""}  # beside q and v
_KEPT = 64  # traced functions


class TermFunction(NamedTuple):
    """A term's expression as a CasADi function (q, v, u, a, t, *forces, *parameters) -> value.

    Where numbers of the robot vary they are its last argument.
    """

    function: ca.Function
    rows: int
    uses: frozenset[str]  # of u, a, t
    forces: tuple[str, ...]  # constraints whose forces and torques it looks at

    def __call__(self, at: Point, p: Mapping[str, ca.SX], wrenches: Sequence[ca.SX] = ()) -> ca.SX:
        """Value at a point, with forces and torques of constraints, and the term's parameters by name."""
        robot = at.mechanics.robot
        u = at.control if "u" in self.uses else ca.SX.zeros(robot.nu)
        a = at.joint_acceleration() if "a" in self.uses else ca.SX.zeros(robot.nv)
        t = at.time if "t" in self.uses else ca.SX(0)
        own = (at.joint_configuration(), at.joint_velocity(), u, a, t, *wrenches, *p.values())
        return self.function(*own, *([at.mechanics.numbers] if robot.varying else []))


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnTerm:
    """A cost, a path constraint or an end condition as a function in Python; see the module.

    Attributes
    ----------
    role : {"running", "terminal", "path", "end"}
    function : callable
        From `Kinematics` to a `casadi.SX`: a scalar for costs, a column for constraints.
    name : str
        What it is called in messages and results.
    weight : float
        Factor of a cost, of any sign.
    lower, upper : ndarray
        Bounds of a path constraint, one for all rows or one for each; equal ones make it an equation.
    unit : str
        Of a path constraint's rows.
    span : Span
        When a path constraint holds.
    parameters : mapping of str to ndarray
        Numbers that the function asks for by name.
    """

    role: Role
    function: Callable[[Kinematics], Any]
    name: str
    weight: float = 1.0
    lower: Array = field(default_factory=lambda: frozen_array(-np.inf))
    upper: Array = field(default_factory=lambda: frozen_array(np.inf))
    unit: str = ""
    span: Span = field(default_factory=Span)
    parameters: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        key = f"terms: {self.name}"
        if not callable(self.function):
            raise ProblemError(f"{key}: got {show(self.function)}, expected a function of the kinematics")
        if not self.name:
            raise ProblemError("terms: a term needs a name")
        if not np.isfinite(self.weight):
            raise InvalidValue(f"{key}: weight", self.weight, "a finite number")
        numbers = {n: frozen_array(value, name=f"{key}: {n}") for n, value in self.parameters.items()}
        for name, value in numbers.items():
            if value.ndim > 1 or not np.isfinite(value).all():
                raise InvalidValue(f"{key}: {name}", show(value.tolist()), "a number or a list of them")
        object.__setattr__(self, "parameters", numbers)
        self.span.check(key)
        for side in ("lower", "upper"):
            object.__setattr__(self, side, frozen_array(getattr(self, side), name=f"{key}: {side}"))

    def trace(self, robot: Robot, rotations: str = "quaternion") -> TermFunction:
        """Its expression for a robot.

        Raises
        ------
        ProblemError
            If the function asks for what there is not, or returns something else than an expression.
        """
        sizes = tuple((name, value.size) for name, value in self.parameters.items())
        return _trace(self.function, self.role, self.name, sizes, robot, rotations)

    def digest(self, robot: Robot) -> str:
        """Digest of its expression for a robot, the same wherever the same is computed."""
        return _digest(self.trace(robot).function)

    def bounds(self, robot: Robot) -> tuple[Array, Array]:
        """Lower and upper bound of each row."""
        rows = self.trace(robot).rows
        lower, upper = (np.broadcast_to(side, (rows,)) for side in (self.lower, self.upper))
        return lower, upper

    def check(self, robot: Robot) -> None:
        """Refuse what does not fit a robot."""
        traced, key = self.trace(robot), f"terms: {self.name}"
        if self.role in ("running", "terminal") and traced.rows != 1:
            raise ProblemError(f"{key}: got {traced.rows} values, expected one: a cost is a number")
        if self.role != "path":
            return
        for side in (self.lower, self.upper):
            if side.shape not in ((), (traced.rows,)):
                raise ProblemError(f"{key}: got bounds of shape {side.shape} for {traced.rows} values")
        lower, upper = self.bounds(robot)
        for lo, hi in zip(lower, upper, strict=True):
            if not lo <= hi or not (np.isfinite(lo) or np.isfinite(hi)):
                raise InvalidValue(
                    key, [float(lo), float(hi)], "a finite bound, the lower not above the upper"
                )


def running_cost(
    function: Callable[[Kinematics], Any], *, weight: float = 1.0, name: str = "", **parameters: ArrayLike
) -> OwnTerm:
    """Cost per second, where the scheme evaluates the running cost.

    Parameters
    ----------
    function : callable
        From `Kinematics`, with u, a, t and forces, to a scalar `casadi.SX`.
    weight : float
        Factor, of any sign; it never recompiles.
    name : str
        Default: that of the function.
    **parameters
        Numbers or lists that the function asks for by name (``at["name"]``); they never recompile.
    """
    return _make("running", function, name, parameters, weight=weight)


def terminal_cost(
    function: Callable[[Kinematics], Any], *, weight: float = 1.0, name: str = "", **parameters: ArrayLike
) -> OwnTerm:
    """Cost of the last state: a function of q and v. See `running_cost`."""
    return _make("terminal", function, name, parameters, weight=weight)


def path_constraint(
    function: Callable[[Kinematics], Any],
    *,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
    equals: ArrayLike | None = None,
    since: float | str | Mapping[str, float] | None = None,
    until: float | str | Mapping[str, float] | None = None,
    unit: str = "",
    name: str = "",
    **parameters: ArrayLike,
) -> OwnTerm:
    """Bounds at the nodes 1..N, on a function of q, v, and of u and a of the step that ends there.

    Parameters
    ----------
    function : callable
        From `Kinematics` to a column.
    lower, upper : float or array_like
        One for all rows, or one for each.
    equals : float or array_like, optional
        Makes it an equation.
    since, until : float, str or mapping, optional
        At the nodes from one to the other only, both included: times [s], names of via points, or parts of
        the horizon, ``{"share": 0.5}``.
    unit : str
        Of the rows, for messages.
    name, **parameters
        See `running_cost`.
    """
    if equals is not None:
        lower = upper = equals
    sides = {"lower": frozen_array(lower), "upper": frozen_array(upper)}
    span = Span(end_from(since), end_from(until))
    return _make("path", function, name, parameters, unit=unit, span=span, **sides)


def end_condition(
    function: Callable[[Kinematics], Any], *, name: str = "", **parameters: ArrayLike
) -> OwnTerm:
    """Rows that are zero in the last state: a function of q and v. See `running_cost`."""
    return _make("end", function, name, parameters)


def _make(
    role: Role,
    function: Callable[[Kinematics], Any],
    name: str,
    parameters: Mapping[str, ArrayLike],
    **others: Any,
) -> OwnTerm:
    named = name or getattr(function, "__name__", "") or type(function).__name__
    numbers = {key: frozen_array(value, name=f"terms: {named}: {key}") for key, value in parameters.items()}
    return OwnTerm(role=role, function=function, name=named, parameters=numbers, **others)


@lru_cache(maxsize=_KEPT)
def _trace(
    function: Callable[[Kinematics], Any],
    role: str,
    name: str,
    sizes: tuple[tuple[str, int], ...],
    robot: Robot,
    rotations: str,
) -> TermFunction:
    mechanics = JointMechanics(robot, rotations, numbers=symbols_of(robot))
    symbols = {
        "q": ca.SX.sym("q", mechanics.nq),
        "v": ca.SX.sym("v", robot.nv),
        "u": ca.SX.sym("u", robot.nu),
        "a": ca.SX.sym("a", robot.nv),
        "t": ca.SX.sym("t"),
    }
    numbers = {key: ca.SX.sym(key, size) for key, size in sizes}
    here = {key: symbols[key] for key in _SYMBOLS[role]}
    where = f"terms: {name}: a {ROLES[role]}"
    wrenches: dict[str, ca.SX] | None = {} if role == "running" else None
    at = Kinematics(robot, where, symbols["q"], symbols["v"], here, numbers, mechanics, wrenches)
    value = _expression(function(at), name)
    forces = wrenches or {}
    given = [*symbols.values(), *forces.values(), *numbers.values()]
    arguments = [*given, *([mechanics.numbers] if robot.varying else [])]
    free = [s.name() for s in ca.symvar(value) if not any(ca.depends_on(s, a) for a in arguments)]
    if free:
        raise ProblemError(f"terms: {name}: {', '.join(free[:3])} is no parameter: ask for it as at['name']")
    uses = frozenset(key for key in here if ca.depends_on(value, symbols[key]))
    return TermFunction(ca.Function("term", arguments, [value]), int(value.numel()), uses, tuple(forces))


def _expression(value: Any, name: str) -> ca.SX:
    if isinstance(value, (list, tuple)):
        value = ca.vertcat(*value)
    if isinstance(value, (int, float, ca.DM)):
        value = ca.SX(value)
    if not isinstance(value, ca.SX) or value.shape[1] != 1 or not value.shape[0]:
        got = f"a matrix {value.shape}" if isinstance(value, ca.SX) else show(value)
        raise ProblemError(f"terms: {name}: the function returns {got}, expected a casadi.SX, one column")
    return ca.densify(value)


@lru_cache(maxsize=_KEPT)
def _digest(function: ca.Function) -> str:
    return hashlib.sha256(function.serialize().encode()).hexdigest()[:32]
