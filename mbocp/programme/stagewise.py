r"""A discretised optimal control problem as solvers see it: functions, sizes, structure and parameters.

minimise    sum_n l_n(x_{n-1}, x_n, u_{n-1}) + psi(x_N)
subject to  c_n(x_{n-1}, x_n, y_n, u_{n-1}) = 0
            g_T(x_N) = 0,  x_0 given

Nothing here knows of robots: what a state consists of is the formulation's affair.

Units: a robot of other masses moves in the same way under controls that are as much larger. So forces have a
unit that changes no motion: with controls, algebraic unknowns and the momentum balance counted in a unit of
force :math:`F`, and the cost in a unit :math:`1/\kappa`,

.. math:: u = F u', \qquad y = F y', \qquad c_p = F c_p', \qquad l' = \kappa\, l, \qquad
          m' = \kappa\, m, \qquad m_p' = \kappa F\, m_p,

an arm of a ton and a kilometre (1e8 N m) is to a solver what one of a kilogram and a metre is. Both units are
powers of two, so that nothing is lost on the way there and back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, replace

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass, frozen_mask
from mbocp.programme.bounds import StateBounds
from mbocp.programme.compilation import CompiledFunctions


@dataclass(frozen=True)
class Units:
    """Units for a programme, and the entries that count in them.

    Attributes
    ----------
    force : float
        F [N, N m].
    cost : float
        kappa, what costs are multiplied with.
    theta, terminal : ndarray of bool
        Entries of the programme's parameters that hold F, or with which the end condition's rows of momenta
        are multiplied.
    x, u, y, rows, end_rows : ndarray of bool
        Entries of states, controls, algebraic unknowns, rows of a step and of the end condition that are
        forces or momenta.
    """

    force: float
    cost: float
    theta: BoolArray = field(compare=False)
    terminal: BoolArray = field(compare=False)
    x: BoolArray = field(compare=False)
    u: BoolArray = field(compare=False)
    y: BoolArray = field(compare=False)
    rows: BoolArray = field(compare=False)
    end_rows: BoolArray = field(compare=False)

    def __post_init__(self) -> None:
        for name in ("theta", "terminal", "x", "u", "y", "rows", "end_rows"):
            mask = np.asarray(getattr(self, name))
            object.__setattr__(self, name, frozen_mask(mask, size=mask.size))

    @property
    def are_users(self) -> bool:
        """Whether nothing is counted otherwise than by the user."""
        return self.force == 1.0 and self.cost == 1.0


@dataclass(frozen=True)
class StageKind:
    """Dimensions of a stage, and the factors from its rows and unknowns to the paper's.

    Attributes
    ----------
    nx, ndx, ny, nu, nr : int
        State, its tangent, algebraic unknowns, controls, stage parameters.
    scale_c : ndarray, shape (ndx + ny,)
        From the rows of c to those of eqs. (24), (25): constraints are kept as Phi / dt.
    scale_y : ndarray, shape (ny,)
        From impulses to the multipliers lambda [1/s].
    scale_m : ndarray, shape (ndx + ny,)
        From the rows' multipliers to (mu, dt zeta): zeta itself carries round-off of the size 1e-16 / dt^2,
        which no step can bring down.
    scale_ru : ndarray, shape (nu,)
        From the gradient in u to grad_u H of eq. (28) [1/s].
    turning : ndarray, shape (ndx,)
        Angle by unit of each entry of a state's tangent; 0 for what is no angle. Steps are kept small by it.
    groups : tuple of (int, int, tuple of int)
        Constraints in the order in which they can be eliminated, in natural coordinates body by body: first
        row among the constraints, number of rows, and the coordinates that they are solved for.
    """

    nx: int
    ndx: int
    ny: int
    nu: int
    nr: int
    scale_c: Array
    scale_y: Array
    scale_m: Array
    scale_ru: Array
    turning: Array
    groups: tuple[tuple[int, int, tuple[int, ...]], ...] = ()


@dataclass(frozen=True)
class StagewiseProgramme:
    """Functions, dimensions, structure and parameters of a discretised optimal control problem.

    Attributes
    ----------
    num_steps : int
        N.
    kind : StageKind
        Of all stages, which differ in their numbers alone.
    ng : int
        Rows of the end condition.
    num_guards : int
        Rows of what guards it; they must not be negative.
    functions, end_functions : CompiledFunctions
        Where the functions of the stages and of the end are.
    theta, rho, rho_terminal : ndarray
        Parameters: of the horizon, stage after stage, of the end.
    theta_weights, terminal_weights : ndarray of bool
        Which entries of theta and rho_terminal the costs are linear in.
    x_start : ndarray, shape (nx,)
        The given state x_0, as the scheme takes it.
    bounds : StateBounds
        On states, controls and path functions; only interior-point solvers keep them.
    rows_are_gaps : bool
        Whether the rows of a step are F(x_{n-1}, u_{n-1}) - x_n: the gap to the state that it reaches.
    dt : float
        Step length [s], or the guess of a free one.
    control_weight : float
        Smallest second derivative of the running cost in a control, the unit of regularisation.
    describe_row : callable
        (stage, row) -> words for messages; stage -1 is the end condition, and rows beyond those of a stage
        or of the end condition are its limits or guards.
    units : Units
        In which its numbers would be of ordinary size; it is counted as the user does.
    path_names : tuple of str
        Of the path functions, for messages.
    has_free_lengths : bool
        Whether step lengths are unknowns, so that messages count steps and name no times.
    easing : ndarray, shape of theta, or None
        What may be added to theta to make a programme of fewer minima, one of which leads to a good one of
        this when it fades; None: nothing does.
    """

    num_steps: int
    kind: StageKind
    ng: int
    num_guards: int
    functions: CompiledFunctions
    end_functions: CompiledFunctions
    theta: Array
    rho: Array
    rho_terminal: Array
    theta_weights: BoolArray
    terminal_weights: BoolArray
    x_start: Array
    bounds: StateBounds
    rows_are_gaps: bool
    dt: float
    control_weight: float
    describe_row: Callable[[int, int], str] = field(compare=False)
    units: Units
    path_names: tuple[str, ...] = ()
    has_free_lengths: bool = False
    easing: Array | None = None

    def compile(self) -> StagewiseProgramme:
        """The same programme with compiled functions, unless there is no compiler; see `load_functions`.

        Raises
        ------
        CompilationError
            If the compiler refuses the generated code, or nothing can be written.
        """
        functions, end_functions = self.functions.compile(), self.end_functions.compile()
        return replace(self, functions=functions, end_functions=end_functions)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of an iterate's arrays, by their names."""
        N, kind = self.num_steps, self.kind
        return {
            "xs": (N + 1, kind.nx),
            "ys": (N, kind.ny),
            "us": (N, kind.nu),
            "ms": (N, kind.ndx + kind.ny),
            "eta": (self.ng,),
        }

    def describe_step(self, stage: int) -> str:
        """Words for a stage."""
        if self.has_free_lengths:
            return f"in step {stage + 1} of {self.num_steps}"
        return f"in the step to t = {(stage + 1) * self.dt:g} s"

    def describe_node(self, node: int) -> str:
        """Words for the time of a node."""
        if self.has_free_lengths:
            return f"after step {node} of {self.num_steps}"
        return f"at t = {node * self.dt:g} s"

    def describe_path(self, row: int) -> str:
        """Words for a path constraint."""
        return f"path constraint {self.path_names[row]!r}"

    @property
    def num_unknowns(self) -> int:
        """What Newton's method solves for: mu_0..mu_{N-1}, zeta, y_1..y_N (tangent), lambda, u, eta.

        The paper's DOF column also counts mu_N and a control u_N that nothing needs.
        """
        per_stage = 2 * (self.kind.ndx + self.kind.ny) + self.kind.nu
        return self.num_steps * per_stage + self.ng
