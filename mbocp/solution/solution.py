"""The result of a solve: trajectories, multipliers, history, and what it took."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, InvalidValue, ResultFileError
from mbocp.solution._values import checked_arrays, json_copy, same
from mbocp.solution.conserved import ConservedQuantity, conserved_quantities
from mbocp.solution.export import solution_dict, write_csv
from mbocp.solution.files import read_content, write_content
from mbocp.solution.limits import ActiveLimit, active_limits
from mbocp.solution.problem_text import integrator_of, limits_of
from mbocp.solution.records import IterationRecord, Labels, Phase, Status
from mbocp.solution.stored import ARRAYS, COUNTS, NUMBERS, OPTIONAL, WORDS, content_of, fields_of

__all__ = ["Solution"]


def _absent() -> Array:
    return np.zeros(0)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Solution:
    r"""Trajectories, multipliers and history of a solved (or not quite solved) optimal control problem.

    The numbers satisfy, for n = 1, ..., N,

    .. math::
        F(x_{n-1}, x_n, \lambda_n, u_{n-1}) = 0, \qquad \Phi(q_n) = 0, \qquad g_T(x_N) = 0,

    with the multipliers :math:`\mu_{n-1}`, :math:`\zeta_{n-1}` and :math:`\eta`, to within `residual`.

    Attributes
    ----------
    status : Status
        How the solve ended; `converged` says whether well, `advice` what to do if not.
    advice, solver, guess_used : str
    iterations, unknowns : int
        Iterations of the solver; numbers that it solved for.
    cost : float
        Objective J, eq. (7).
    residual, increment : float
        Norms at the end.
    constraint_violation : float
        Largest holonomic constraint along the trajectory [m^2, m, rad].
    velocity_violation : float
        Largest rate of one, :math:`|\Phi_q v|`: the hidden constraint, which is kept to O(dt).
    wall_time_s : float
        Duration of the whole solve [s].
    phases : tuple of Phase
    history : tuple of IterationRecord
    t : ndarray, shape (N + 1,)
        Time of the nodes [s].
    qs : ndarray, shape (N + 1, nq)
        Configuration [m, rad, unit quaternion xyzw, cos/sin].
    vs, ps : ndarray, shape (N + 1, nv)
        Velocity [m/s, rad/s] and momentum [kg m/s, N m s].
    us : ndarray, shape (N, nu)
        Control; `us[n]` acts from node n to n + 1.
    lams, zetas : ndarray, shape (N, nc)
        Multipliers of the constraints and their adjoints; `lams[n]` is :math:`\lambda_{n+1}`, `zetas[n]` is
        :math:`\zeta_n`.
    mus : ndarray, shape (N + 1, 2 nv)
        Adjoint of the state, :math:`\mu_n = (\mu^q_n, \mu^p_n)`; for scheme SE1 the multipliers of the
        step from node n to n + 1.
    eta : ndarray, shape (ng,)
        Multiplier of the exact end condition.
    control_hamiltonians : ndarray, shape (N,)
        Eq. (11); NaN if nobody evaluated it.
    control_momenta : ndarray, shape (N + 1, k)
        Eq. (15), a column for each symmetry in `control_momentum_names`.
    control_momentum_names, control_momentum_meanings : tuple of str
        Symmetry of each control momentum, and what it is in terms of the adjoints; "" if nobody says.
    coordinates : str
        In which the mechanics were written, see `mbocp.problem.Problem`. With "natural" the constraints, of
        `lams` and `zetas`, are those of rigid bodies and joints, too.
    scheme, lie, rotations : str
        Integrator, see `mbocp.problem.Problem` and `mbocp.robot.Robot`; what is left out is what
        `problem_text` says.
    substeps : int
        Steps of an explicit scheme within one of the N.
    manifold_drifts : ndarray, shape (N + 1,)
        How far the rotations of the integrator's state are from their manifold: the largest
        :math:`|\,|q| - 1|` or :math:`\|R^T R - I\|_F`; NaN if nobody evaluated it.
    manifold_drift, manifold_drift_resimulated : float
        The largest of them; and the largest when the start is integrated anew with the controls, which shows
        the integrator without the tolerance of the solver. NaN where not computed.
    limits_u, limits_v, limits_q : ndarray, shape (2, nu), (2, nv), (2, nq)
        Lower and upper limits of the problem, infinite where there are none; what is left out is what
        `problem_text` says.
    limit_violation : float
        By how much the motion leaves limits and path constraints at most, in their own units.
    lam_us, lam_qs, lam_vs : ndarray, shape (N, nu), (N + 1, nq), (N + 1, nv)
        Multipliers of the limits: positive at an active upper one, negative at a lower one, zero where
        nothing is active.
    lam_path : ndarray, shape (N, nh)
        Multipliers of the path constraints at the nodes 1, ..., N, with the same signs.
    path_names : tuple of str
        Name of each column of `lam_path`.
    problem_name, robot_name : str
    robot_spec : dict
        Arguments with which `load_robot` loads the robot again.
    problem_text : str
        The problem file (TOML) as it was solved.
    options, versions : dict
        Options of the solver; versions of what took part.
    labels : Labels
        Name and unit of every column.

    Raises
    ------
    DimensionMismatch
        If the shapes do not fit together.
    InvalidValue
        If `options`, `versions` or `robot_spec` hold what JSON cannot.
    """

    status: Status
    advice: str = ""
    solver: str
    iterations: int
    cost: float
    residual: float
    increment: float = math.nan
    constraint_violation: float = 0.0
    velocity_violation: float = math.nan
    limit_violation: float = 0.0
    manifold_drift: float = math.nan
    manifold_drift_resimulated: float = math.nan
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

    coordinates: str = ""
    scheme: str = ""
    lie: str = ""
    substeps: int = 0
    rotations: str = ""
    problem_name: str = ""
    robot_name: str = ""
    robot_spec: Mapping[str, Any] = field(default_factory=dict)
    problem_text: str = ""
    guess_used: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    labels: Labels = field(default_factory=Labels)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path_names", tuple(map(str, self.path_names)))
        given = {name: getattr(self, name) for name in (*ARRAYS, *OPTIONAL)}
        for name, limits in limits_of(self.problem_text).items():
            given[name] = given[name] if np.size(given[name]) else limits
        checked = checked_arrays(given, len(tuple(self.control_momentum_names)), len(self.path_names))
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        for name, word in integrator_of(self.problem_text).items():
            object.__setattr__(self, name, getattr(self, name) or word)
        if math.isnan(self.manifold_drift) and np.isfinite(self.manifold_drifts).all():
            object.__setattr__(self, "manifold_drift", float(self.manifold_drifts.max()))
        object.__setattr__(self, "status", Status(self.status))
        object.__setattr__(self, "control_momentum_names", tuple(map(str, self.control_momentum_names)))
        object.__setattr__(self, "control_momentum_meanings", self._meanings())
        object.__setattr__(self, "phases", tuple(self.phases))
        object.__setattr__(self, "history", tuple(self.history))
        for name in WORDS:
            object.__setattr__(self, name, str(getattr(self, name)))
        for name in NUMBERS:
            object.__setattr__(self, name, float(getattr(self, name)))
        for name in COUNTS:
            object.__setattr__(self, name, int(getattr(self, name)))
        for name in ("robot_spec", "options", "versions"):
            object.__setattr__(self, name, json_copy(name, getattr(self, name)))
        sizes = {"q": self.nq, "v": self.nv, "p": self.nv, "u": self.nu, "mu": 2 * self.nv}
        object.__setattr__(self, "labels", self.labels.completed(**sizes, lam=self.nc, zeta=self.nc))

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
    def control_hamiltonian(self) -> dict[str, float]:
        """Least, greatest and mean control Hamiltonian along the trajectory, eq. (11)."""
        values = self.control_hamiltonians[np.isfinite(self.control_hamiltonians)]
        if not values.size:
            return {"min": math.nan, "max": math.nan, "mean": math.nan}
        return {"min": float(values.min()), "max": float(values.max()), "mean": float(values.mean())}

    @property
    def conserved(self) -> tuple[ConservedQuantity, ...]:
        """Control momenta, eq. (15), one for each symmetry of the robot that the running cost respects."""
        return conserved_quantities(
            self.control_momenta, self.control_momentum_names, self.control_momentum_meanings, self.mus
        )

    @property
    def control_momentum_drift(self) -> float:
        """Largest change of a control momentum, eq. (15), since the start; NaN if there is no symmetry."""
        if not self.control_momenta.size:
            return math.nan
        return float(np.max(np.abs(self.control_momenta - self.control_momenta[0])))

    @property
    def active_limits(self) -> tuple[ActiveLimit, ...]:
        """Limits and path constraints of the problem that the motion touches."""
        return active_limits(self)

    @property
    def q_final(self) -> Array:
        """Configuration at the end, shape (nq,)."""
        q_final: Array = self.qs[-1]
        return q_final

    @property
    def p_final(self) -> Array:
        """Momentum at the end, shape (nv,)."""
        p_final: Array = self.ps[-1]
        return p_final

    @property
    def u_first(self) -> Array:
        """Control of the first step, shape (nu,)."""
        u_first: Array = self.us[0]
        return u_first

    @property
    def u_last(self) -> Array:
        """Control of the last step, shape (nu,)."""
        u_last: Array = self.us[-1]
        return u_last

    def _meanings(self) -> tuple[str, ...]:
        names, meanings = self.control_momentum_names, tuple(map(str, self.control_momentum_meanings))
        if meanings and len(meanings) != len(names):
            raise DimensionMismatch("control_momentum_meanings", len(meanings), len(names))
        return meanings or ("",) * len(names)

    def __repr__(self) -> str:
        name = self.problem_name or self.robot_name or "unnamed"
        return (
            f"<Solution {name}: {self.status} after {self.iterations} iterations of {self.solver}, "
            f"cost {self.cost:.9g}, residual {self.residual:.1e}, N = {self.num_steps}>"
        )

    def equals(self, other: object) -> bool:
        """Whether `other` is a solution with exactly the same content; NaN equals NaN."""
        if not isinstance(other, Solution):
            return False
        return all(same(getattr(self, f.name), getattr(other, f.name)) for f in dataclasses.fields(self))

    def __eq__(self, other: object) -> bool:
        return self.equals(other) if isinstance(other, Solution) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # equal by content, and the content is long

    def to_dict(self) -> dict[str, Any]:
        """Return the summary that `mbocp solve --json` prints, as plain Python values."""
        return solution_dict(self)

    def to_json(self, indent: int | None = None) -> str:
        """Return the summary that `mbocp solve --json` prints; NaN and infinity are null."""
        return json.dumps(self.to_dict(), indent=indent, allow_nan=False)

    def to_csv(self, path: str | Path) -> Path:
        """Write all trajectories into one table, a row for each node, `name [unit]` in the first line."""
        return write_csv(self, path)

    def save(self, path: str | Path) -> Path:
        """Write everything into one self-describing HDF5 file; an interrupted save leaves the old file whole.

        Raises
        ------
        ResultFileError
            If the file cannot be written.
        """
        return write_content(path, content_of(self))

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read what `save` wrote; the result equals what was saved.

        Raises
        ------
        ResultFileError
            If there is no such file, it is not a result of mbocp, it is damaged, or a newer mbocp wrote it.
        """
        content = read_content(path)
        try:
            return cls(**fields_of(content))
        except (DimensionMismatch, InvalidValue) as error:
            raise ResultFileError(path, f"is damaged: its parts do not fit together ({error})") from error
