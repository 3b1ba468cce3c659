"""The numbers and words of a solution, checked, and what follows from them alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import Array, IntArray, dataclass
from mbocp.exceptions import DimensionMismatch
from mbocp.integrators.controls import control_basis, controls_within
from mbocp.programme.iterate import IterateRecord
from mbocp.robot.robot_files import RobotFiles
from mbocp.solution._values import check_arrays, json_copy
from mbocp.solution.conserved import ConservedQuantity, sum_up_momenta
from mbocp.solution.details import Accuracy, Column, Labels, StartRecord, dual_columns
from mbocp.solution.later import LateField, complete
from mbocp.solution.problem_facts import Facts, PhasePlace
from mbocp.solvers.records import IterationRecord, Phase, Status
from mbocp.storage.content import QUANTITIES


def _absent() -> Array:
    return np.zeros(0)


# Numbers and words that `--json` prints under their names; numbers are sizes, those with a sign aside.
_TOLD = {"is_told": True}
_SIGNED = {**_TOLD, "is_signed": True}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SolutionData:
    """Fields of a `Solution`, which explains them; those who write, read and examine one know it so.

    What a solve has just found works most of them out when one of them is asked for, see `later`.
    """

    status: Status = field(metadata=_TOLD)
    advice: str = field(default="", metadata=_TOLD)
    solver: str = field(metadata=_TOLD)
    iterations: int = field(metadata=_TOLD)
    cost: float = field(metadata=_SIGNED)
    residual: float = field(metadata=_TOLD)
    increment: float = field(default=math.nan, metadata=_TOLD)
    constraint_violation: float = field(default=0.0, metadata=_TOLD)
    velocity_violation: float = field(default=math.nan, metadata=_TOLD)
    violation_within: float = field(default=math.nan, metadata=_TOLD)
    limit_violation: float = field(default=0.0, metadata=_TOLD)
    limit_excess: float = field(default=0.0, metadata=_TOLD)
    limit_excess_of: str = field(default="", metadata=_TOLD)
    limit_excess_time: float = field(default=math.nan, metadata=_SIGNED)
    manifold_drift: float = field(default=math.nan, metadata=_TOLD)
    manifold_drift_resimulated: float = field(default=math.nan, metadata=_TOLD)
    clearance: float = field(default=math.nan, metadata=_SIGNED)
    clearance_between: str = field(default="", metadata=_TOLD)
    clearance_time: float = field(default=math.nan, metadata=_SIGNED)
    positive_work: float = field(default=math.nan, metadata=_TOLD)
    drawn_energy: float = field(default=math.nan, metadata=_SIGNED)
    sigmas: float = field(default=math.nan, metadata=_TOLD)
    tightest: str = field(default="", metadata=_TOLD)
    unknowns: int
    wall_time_s: float = math.nan
    phases: tuple[Phase, ...] = ()
    history: tuple[IterationRecord, ...] = ()

    t: Array
    qs: Array
    vs: Array
    ps: Array
    us: Array
    lams: Array = field(default_factory=_absent)
    mus: Array
    zetas: Array = field(default_factory=_absent)
    eta: Array = field(default_factory=_absent)
    control_hamiltonians: Array = field(default_factory=_absent)
    control_momenta: Array = field(default_factory=_absent)
    control_momentum_names: tuple[str, ...] = ()
    control_momentum_meanings: tuple[str, ...] = ()
    manifold_drifts: Array = field(default_factory=_absent)
    limits_u: Array = field(default_factory=_absent)
    limits_v: Array = field(default_factory=_absent)
    limits_q: Array = field(default_factory=_absent)
    lam_us: Array = field(default_factory=_absent)
    lam_qs: Array = field(default_factory=_absent)
    lam_vs: Array = field(default_factory=_absent)
    lam_path: Array = field(default_factory=_absent)
    path_names: tuple[str, ...] = ()
    gains: Array = field(default_factory=_absent)
    sigma_qs: Array = field(default_factory=_absent)
    sigma_vs: Array = field(default_factory=_absent)
    sigma_us: Array = field(default_factory=_absent)
    u_values: Array = field(default_factory=_absent)
    u_shares: Array = field(default_factory=_absent)

    coordinates: str = ""
    scheme: str = ""
    lie: str = ""
    substeps: int = 0
    rotations: str = ""
    problem_name: str = ""
    robot_name: str = ""
    robot_spec: Mapping[str, Any] = field(default_factory=dict)
    problem_text: str = ""
    facts_kept: Facts | None = field(default=None, compare=False)
    guess_used: str = ""
    goal_error: str = ""
    starts: tuple[StartRecord, ...] = ()
    accuracy: Accuracy = field(default_factory=Accuracy)
    options: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    labels: Labels = field(default_factory=Labels)
    robot_files: RobotFiles | None = field(default=None, compare=False)
    iterate: IterateRecord | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "path_names", tuple(map(str, self.path_names)))
        given = {name: getattr(self, name) for name in QUANTITIES}
        checked = check_arrays(given, len(tuple(self.control_momentum_names)), len(self.path_names))
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if math.isnan(self.manifold_drift) and np.isfinite(self.manifold_drifts).all():
            object.__setattr__(self, "manifold_drift", float(self.manifold_drifts.max()))
        object.__setattr__(self, "control_momentum_names", tuple(map(str, self.control_momentum_names)))
        object.__setattr__(self, "control_momentum_meanings", self._meanings())
        for kind, names in _KINDS.items():
            for name in names:
                object.__setattr__(self, name, kind(getattr(self, name)))
        for name in ("robot_spec", "options", "versions"):
            object.__setattr__(self, name, json_copy(name, getattr(self, name)))
        sizes = {"q": self.nq, "v": self.nv, "p": self.nv, "u": self.nu, "mu": 2 * self.nv}
        object.__setattr__(self, "labels", self.labels.complete(**sizes, lam=self.nc, zeta=self.nc))

    def __getstate__(self) -> dict[str, Any]:
        complete(self)
        return {f.name: vars(self)[f.name] for f in fields(self)}

    @property
    def facts(self) -> Facts:
        """What the problem asked of the motion, as far as it is known."""
        return self._fit(self.facts_kept or Facts())

    def _fit(self, facts: Facts) -> Facts:
        return facts.fit(self.num_steps, {"q": self.nq, "v": self.nv, "u": self.nu})

    def columns(self, name: str) -> tuple[Column, ...]:
        """Return name and unit of each column, along the last axis, of one of the arrays."""
        words = QUANTITIES[name].columns
        kind, _, letter = words.rpartition(" ")
        if letter in Labels.__dataclass_fields__:
            columns: tuple[Column, ...] = getattr(self.labels, letter)
            return dual_columns(columns) if kind == "dual" else columns
        if words == "symmetries":
            return tuple(Column(symmetry, "cost") for symmetry in self.control_momentum_names)
        if words == "path":
            return tuple(Column(row, "") for row in self.path_names)
        if words == "numbers":
            return tuple(Column(str(i), "") for i in range(getattr(self, name).shape[-1]))
        if words == "moves":
            return self._moves()
        word, _, unit = words.partition(" ")
        return (Column(word, unit.strip("[]")),)

    def _moves(self) -> tuple[Column, ...]:
        """What gains answer: moves of (q, v), and of linear controls."""
        moves = tuple(Column(f"{part}:{v.name}", "") for part in ("q", "v") for v in self.labels.v)
        if self.gains.shape[-1] <= len(moves):
            return moves
        return moves + tuple(Column(f"u:{u.name}", "") for u in self.labels.u)

    @property
    def goal_place(self) -> int | None:
        """Place of the goal that was taken among several; None where there is one."""
        return next((start.goal for start in self.starts if start.guess == self.guess_used), None)

    @property
    def converged(self) -> bool:
        """Whether the tolerances were met, by a motion that the steps resolve."""
        return self.status is Status.CONVERGED

    @property
    def is_stationary(self) -> bool:
        """Whether the tolerances were met, even if steps do not resolve the motion or it ends elsewhere."""
        return self.status.is_stationary

    @property
    def num_steps(self) -> int:
        """Number of steps N."""
        return len(self.t) - 1

    @property
    def nq(self) -> int:
        """Numbers of a configuration."""
        return int(self.qs.shape[1])

    @property
    def nv(self) -> int:
        """Degrees of freedom, before constraints."""
        return int(self.vs.shape[1])

    @property
    def nu(self) -> int:
        """Controls."""
        return int(self.us.shape[1])

    @property
    def has_constant_controls(self) -> bool:
        """Whether controls are constant in each step."""
        return not self.u_shares.size

    @property
    def has_linear_controls(self) -> bool:
        """Whether controls are linear in each step, and continuous."""
        ends = self.u_shares.tolist() == [0.0, 1.0]
        return ends and bool((self.u_values[1:, 0] == self.u_values[:-1, 1]).all())

    @property
    def us_at_ends(self) -> Array:
        """Controls at the ends of the steps, shape (N, nu)."""
        return self.controls_within(np.ones(1))[:, 0]

    def controls_within(self, shares: Array) -> Array:
        """Controls at shares (m,) of each step, shape (N, m, nu)."""
        return controls_within(self.us, self.u_values, self.u_shares.tolist(), shares)

    @property
    def accelerations(self) -> Array:
        """Mean accelerations of the steps, shape (N, nv) [m/s^2, rad/s^2]; of impacts that before."""
        from mbocp.mechanics.motion_rates import rates_along  # mechanics, which no summary needs

        return rates_along(None, self.qs, self.vs, self.us, np.diff(self.t))["acceleration"]

    def acceleration_at(self, node: int) -> Array:
        """Acceleration at a node, shape (nv,): on the line through the means in the middles of its steps.

        With it, `start.a` of a motion that goes on from there keeps limits of jerks where this one does. At
        both ends it is the mean of the step.
        """
        after = min(node, self.num_steps - 1)
        before = max(node - 1, 0)
        lengths = np.diff(self.t)[[after, before]]
        weights = lengths / lengths.sum() if lengths.any() else np.full(2, 0.5)
        return weights @ self.accelerations[[before, after]]

    def controls_at(self, times: ArrayLike) -> Array:
        """Controls at times [s], shape (m, nu): those of the step, at a node those of the step after it.

        Parameters
        ----------
        times : array_like, shape (m,)
            As `t` counts them; what is before the first node or after the last is taken to it.
        """
        inside = np.clip(np.atleast_1d(np.asarray(times, dtype=np.float64)), self.t[0], self.t[-1])
        steps = np.clip(np.searchsorted(self.t, inside, side="right") - 1, 0, self.num_steps - 1)
        if self.has_constant_controls:
            return self.us[steps]
        return self._controls_in(steps, (inside - self.t[steps]) / np.diff(self.t)[steps])

    def _controls_in(self, steps: IntArray, shares: Array | float) -> Array:
        """Controls at shares of steps, shape (m, nu)."""
        at = np.broadcast_to(shares, len(steps))
        weights = control_basis(self.u_shares.tolist(), at)
        return np.einsum("mk,mku->mu", weights, self.u_values[steps])

    @property
    def nc(self) -> int:
        """Holonomic constraints."""
        return int(self.lams.shape[1])

    @property
    def is_vector_space(self) -> bool:
        """Whether every number of q is a length or an angle: no quaternions, no cosines and sines."""
        return all(column.unit for column in self.labels.q)

    @property
    def duration(self) -> float:
        """Length T of the horizon [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def duration_range(self) -> tuple[float, float] | None:
        """Bounds [s] between which the duration was free; None where it was given."""
        return self.facts.duration_range

    @property
    def via_times(self) -> dict[str, float]:
        """When the motion passes each via point [s], by its name."""
        return {place.name: float(self.t[place.node] - self.t[0]) for place in self.facts.via}

    @property
    def parameters(self) -> dict[str, float]:
        """Numbers of the robot that were found with the motion, by what the problem calls them."""
        return {one.name: one.value for one in self.facts.parameters}

    @property
    def named_phases(self) -> tuple[PhasePlace, ...]:
        """The phases of the motion that have names, in their order; none where there are none."""
        return self.facts.phases

    @property
    def phase_times(self) -> dict[str, tuple[float, float]]:
        """When each phase begins and ends [s], by its name."""
        t = self.t - self.t[0]
        return {p.name: (float(t[p.first]), float(t[p.last])) for p in self.named_phases}

    @property
    def control_hamiltonian(self) -> dict[str, float]:
        """Least, greatest and mean control Hamiltonian along the trajectory, eq. (11)."""
        values = self.control_hamiltonians[np.isfinite(self.control_hamiltonians)]
        if not values.size:
            return {"min": math.nan, "max": math.nan, "mean": math.nan}
        return {"min": float(values.min()), "max": float(values.max()), "mean": float(values.mean())}

    @property
    def conserved(self) -> tuple[ConservedQuantity, ...]:
        """Control momenta, eq. (15), one for each symmetry of the robot that the running cost respects."""
        return sum_up_momenta(
            self.control_momenta, self.control_momentum_names, self.control_momentum_meanings, self.mus
        )

    @property
    def control_momentum_drift(self) -> float:
        """Largest change of a control momentum, eq. (15), since the start; NaN if there is no symmetry."""
        if not self.control_momenta.size:
            return math.nan
        return float(np.max(np.abs(self.control_momenta - self.control_momenta[0])))

    @property
    def q_final(self) -> Array:
        """Configuration at the end, shape (nq,)."""
        return self.qs[-1]

    @property
    def p_final(self) -> Array:
        """Momentum at the end, shape (nv,)."""
        return self.ps[-1]

    @property
    def u_first(self) -> Array:
        """Control of the first step, shape (nu,)."""
        return self.us[0]

    @property
    def u_last(self) -> Array:
        """Control of the last step, shape (nu,)."""
        return self.us[-1]

    def _meanings(self) -> tuple[str, ...]:
        names, meanings = self.control_momentum_names, tuple(map(str, self.control_momentum_meanings))
        if meanings and len(meanings) != len(names):
            raise DimensionMismatch("control_momentum_meanings", len(meanings), len(names))
        return meanings or ("",) * len(names)


def _of_kind(kind: str) -> tuple[str, ...]:
    """Names of the fields of the summary, by their kind."""
    return tuple(f.name for f in fields(SolutionData) if f.type == kind and f.name != "problem_text")


def _with(mark: str) -> tuple[str, ...]:
    """Names of the fields that are declared so."""
    return tuple(f.name for f in fields(SolutionData) if f.metadata.get(mark))


WORDS, COUNTS, NUMBERS = _of_kind("str"), _of_kind("int"), _of_kind("float")
_RECORDS = ("phases", "history", "starts")
_KINDS: dict[type, tuple[str, ...]]
_KINDS = {str: WORDS, int: COUNTS, float: NUMBERS, tuple: _RECORDS, Status: ("status",)}
TOLD, SIGNED = _with("is_told"), _with("is_signed")
for _field in fields(SolutionData):
    setattr(SolutionData, _field.name, LateField(_field.name))
