"""The result of a solve: trajectories, multipliers, history, and what it took."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, ResultFileError
from mbocp.solution._values import checked_arrays, json_copy, same
from mbocp.solution.conserved import ConservedQuantity, conserved_quantities
from mbocp.solution.export import solution_dict, write_csv
from mbocp.solution.files import FileContent, read_content, write_content
from mbocp.solution.records import Column, IterationRecord, Labels, Phase, Status

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["Solution"]

_ARRAYS = (
    "t",
    "qs",
    "vs",
    "ps",
    "us",
    "lams",
    "mus",
    "zetas",
    "eta",
    "control_hamiltonians",
    "control_momenta",
)
_STRUCTURES = ("phases", "history", "robot_spec", "options", "versions")
_NUMBERS = ("cost", "residual", "increment", "constraint_violation", "wall_time_s")
_COUNTS = ("iterations", "unknowns")
_WORDS = ("advice", "solver", "problem_name", "robot_name", "guess_used")


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

    problem_name: str = ""
    robot_name: str = ""
    robot_spec: Mapping[str, Any] = field(default_factory=dict)
    problem_text: str = ""
    guess_used: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    labels: Labels = field(default_factory=Labels)

    def __post_init__(self) -> None:
        given = {name: getattr(self, name) for name in _ARRAYS}
        for name, value in checked_arrays(given, len(tuple(self.control_momentum_names))).items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "status", Status(self.status))
        object.__setattr__(self, "control_momentum_names", tuple(map(str, self.control_momentum_names)))
        object.__setattr__(self, "control_momentum_meanings", self._meanings())
        object.__setattr__(self, "phases", tuple(self.phases))
        object.__setattr__(self, "history", tuple(self.history))
        for name in _NUMBERS:
            object.__setattr__(self, name, float(getattr(self, name)))
        for name in _COUNTS:
            object.__setattr__(self, name, int(getattr(self, name)))
        for name in ("robot_spec", "options", "versions"):
            object.__setattr__(self, name, json_copy(name, getattr(self, name)))
        sizes = {"q": self.nq, "v": self.nv, "p": self.nv, "u": self.nu, "mu": 2 * self.nv}
        object.__setattr__(self, "labels", self.labels.completed(**sizes, lam=self.nc, zeta=self.nc))

    @property
    def converged(self) -> bool:
        """Whether the tolerances were met."""
        return self.status is Status.CONVERGED

    @property
    def num_steps(self) -> int:
        """Number of steps N."""
        return len(self.t) - 1

    @property
    def scheme(self) -> str:
        """Scheme of the problem that was solved: "se1", "se2" or "midpoint"; "" if its text is not TOML."""
        try:
            problem = tomllib.loads(self.problem_text)
        except tomllib.TOMLDecodeError:
            return ""
        return str(problem.get("integrator", {}).get("scheme", "se1"))

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
        momenta = tuple(Column(name, "cost") for name in self.control_momentum_names)
        columns = {
            **{f"{name}s": getattr(self.labels, name) for name in ("q", "v", "p", "u", "lam", "mu", "zeta")},
            "t": (Column("t", "s"),),
            "eta": tuple(Column(str(i), "") for i in range(len(self.eta))),
            "control_hamiltonians": (Column("H", "cost/s"),),
            "control_momenta": momenta,
        }
        summary = {name: getattr(self, name) for name in (*_WORDS, *_COUNTS, *_NUMBERS)}
        structures = {name: getattr(self, name) for name in _STRUCTURES}
        for name in ("phases", "history"):
            structures[name] = [dataclasses.asdict(record) for record in structures[name]]
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        summary["status"] = str(self.status)
        texts = {"problem_text": self.problem_text}
        meanings = {"control_momenta": self.control_momentum_meanings}
        return write_content(path, FileContent(arrays, columns, summary, structures, texts, meanings))

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read what `save` wrote; the result equals what was saved.

        Raises
        ------
        ResultFileError
            If there is no such file, it is not a result of mbocp, it is damaged, or a newer mbocp wrote it.
        """
        content = read_content(path)
        fields: dict[str, Any] = {**content.arrays, **content.summary, **content.structures, **content.texts}
        try:
            fields["phases"] = tuple(Phase(**record) for record in fields["phases"])
            fields["history"] = tuple(IterationRecord(**record) for record in fields["history"])
            fields["labels"] = Labels(
                **{name: content.columns[f"{name}s"] for name in ("q", "v", "p", "u", "lam", "mu", "zeta")}
            )
            fields["control_momentum_names"] = tuple(c.name for c in content.columns["control_momenta"])
            fields["control_momentum_meanings"] = content.meanings.get("control_momenta", ())
            return cls(**fields)
        except (KeyError, TypeError, ValueError, DimensionMismatch) as error:
            raise ResultFileError(path, f"is damaged: its parts do not fit together ({error})") from error
