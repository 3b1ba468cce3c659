from collections.abc import Sequence

from mbocp._arrays import Array

class StageFunction:
    @staticmethod
    def from_library(path: str, name: str) -> StageFunction: ...
    @staticmethod
    def from_string(serialised: str) -> StageFunction: ...
    @property
    def num_inputs(self) -> int: ...

class Kind:
    def __init__(
        self,
        *,
        nx: int,
        ndx: int,
        ny: int,
        nu: int,
        nr: int,
        values: StageFunction,
        jacobian: StageFunction,
        complete: StageFunction,
        scale_c: Array,
        scale_y: Array,
        scale_m: Array,
        scale_ru: Array,
        groups: Sequence[tuple[int, int, Sequence[int]]] = (),
    ) -> None: ...

class Terminal:
    def __init__(self, *, ng: int, values: StageFunction, complete: StageFunction) -> None: ...

class Evaluation:
    cost: float
    residual: float
    primal: float
    dual: float
    violation: float
    worst: float
    worst_stage: int
    worst_row: int
    finite: bool
    objective: float
    barrier_error: float
    complementarity: float

class Factorisation:
    negative: int
    smallest_pivot: float
    end_condition: float
    ok: bool
    bad_stage: int

class Direction:
    increment: float
    slope: float
    longest: float
    longest_dual: float
    curvature: float
    linear_residual: float
    finite: bool

class Trial:
    objective: float
    violation: float
    finite: bool

class Sweep:
    ok: bool
    failed_stage: int
    iterations: int
    residual: float

class Programme:
    x: Array
    y: Array
    u: Array
    m: Array
    eta: Array
    slack: Array
    z_lower: Array
    z_upper: Array
    def __init__(
        self,
        kinds: Sequence[Kind],
        stage_kind: Sequence[int],
        terminal: Terminal,
        retract: StageFunction,
        difference: StageFunction,
    ) -> None: ...
    def set_parameters(self, theta: Array, rho: Array, rho_terminal: Array) -> None: ...
    def evaluate(self, share: float = 1.0) -> Evaluation: ...
    def factorise(self, shift: float = 0.0, augment: float = 0.0) -> Factorisation: ...
    def solve(self, refinements: int = 1) -> Direction: ...
    def correct(self, alpha: float) -> Direction: ...
    def move(self, alpha: float) -> bool: ...
    def trial(self, alpha: float) -> Trial: ...
    def accept(self, alpha: float, alpha_limits: float = 1.0) -> None: ...
    def set_limits(
        self,
        *,
        x_lower: Array,
        x_upper: Array,
        u_lower: Array,
        u_upper: Array,
        path_lower: Array,
        path_upper: Array,
        path: StageFunction | None,
        num_guards: int,
        guard: StageFunction | None,
    ) -> None: ...
    def start_limits(self, barrier: float, inside: float = 1e-2) -> None: ...
    def weigh(self, barrier: float) -> Evaluation: ...
    @property
    def num_limits(self) -> int: ...
    @property
    def limit_multipliers(self) -> Array: ...
    def simulate(
        self, tolerance: float, max_iterations: int, warm: bool = False, feedback: bool = False
    ) -> Sweep: ...
    def gradient(self, auxiliary: bool = False, feedback: bool = False) -> Evaluation: ...
    def end_sensitivity(self, feedback: bool = False) -> Array: ...
    def reduced_hessian(self, shift: float = 0.0) -> Array: ...
    @property
    def num_stages(self) -> int: ...
    @property
    def num_bytes(self) -> int: ...
    @property
    def dx(self) -> Array: ...
    @property
    def dy(self) -> Array: ...
    @property
    def du(self) -> Array: ...
    @property
    def dm(self) -> Array: ...
    @property
    def deta(self) -> Array: ...
    @property
    def costates(self) -> Array: ...
    @property
    def control_gradient(self) -> Array: ...
    @property
    def control_scale(self) -> Array: ...
    @property
    def end_condition(self) -> Array: ...
    @property
    def sigma(self) -> Array: ...
    @property
    def A(self) -> Array: ...
