r"""Direct multiple shooting by interior-point methods: IPOPT and fatrop, through CasADi.

The nonlinear programme is eq. (39) of [Manara2017]_ for an explicit scheme, and the stagewise programme
itself for any other: states and controls of all nodes are unknowns. Bounds, path constraints and guards of
the end condition are inequalities.
"""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass, norm
from mbocp._processes import signal_handler
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import BoundMultipliers, Iterate
from mbocp.solvers.nlp.iteration_log import (
    IterationCallback,
    IterationLog,
    OfThread,
    advice_of,
    status_of,
    whole_lines,
)
from mbocp.solvers.nlp.nlp_functions import NlpFunctions, all_or_none, calm_or_none, parameters
from mbocp.solvers.nlp.nlp_layout import (
    NlpLayout,
    bounds_of,
    check_fatrop_takes,
    kinds_of_bounds,
    miss,
    tighten,
)
from mbocp.solvers.records import Callback, IterationRecord, Status
from mbocp.solvers.strategies.iterating import SolverResult

Watch = Callable[[IterationRecord, Array | None], object]

_THROWN = "exception was raised in the solver"
_ALONE = threading.RLock()  # solvers kept in memory and the stream that they print to are there once
_MAX_SOLVERS = 12  # solvers of different shapes kept in memory; a study with every formulation has six


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    with _ALONE:
        yield


@dataclass(frozen=True)
class InteriorPoint:
    """One run of an interior-point solver.

    Attributes
    ----------
    name : {"ipopt", "fatrop"}
    tolerance : float
        Of the solver's own error measure.
    max_iterations : int
    time_limit : float or None
        [s].
    linear_solver : {"auto", "mumps", "ma27"}
        Of IPOPT.
    allowance : int or None
        Iterations after which it is ended as if its time were over, whatever its limit; None: there is none.
    """

    name: str
    tolerance: float
    max_iterations: int
    time_limit: float | None = None
    linear_solver: str = "auto"
    allowance: int | None = None

    @property
    def title(self) -> str:
        """What it is called in output."""
        return {"ipopt": "IPOPT", "fatrop": "fatrop"}[self.name]

    def run(
        self,
        programme: StagewiseProgramme,
        iterate: Iterate,
        callback: Callback | None = None,
        phase: str = "",
        first: int = 0,
    ) -> SolverResult:
        """Solve from an iterate; its multipliers are not used. Other threads that want to do so wait.

        Raises
        ------
        ProblemError
            If there is what fatrop does not take, see `check_fatrop_takes`.
        """
        watch = None if callback is None else lambda record, _: callback(record)
        return self.run_and_watch(programme, iterate, watch, phase, first)

    @_alone()
    def run_and_watch(
        self,
        programme: StagewiseProgramme,
        iterate: Iterate,
        watch: Watch | None,
        phase: str = "",
        first: int = 0,
        begin: Callable[[IterationRecord], object] | None = None,
    ) -> SolverResult:
        """Do the same; `watch` sees the unknowns of every iteration, too, and `begin` where it begins."""
        clock, phase = time.perf_counter(), phase or self.name
        if self.name == "fatrop":
            check_fatrop_takes(programme)
        compiled = _compile(_Key.of(self, programme))
        lay, iteration_callback = compiled.layout, compiled.iteration_callback

        def callback(record: IterationRecord) -> None:
            if watch is not None:
                watch(record, iteration_callback.last)

        log = IterationLog(phase, first, callback)
        bounds = bounds_of(programme, lay)
        inner = tighten(bounds) if self.name == "fatrop" else bounds
        left = self.time_limit and clock + self.time_limit - time.perf_counter()
        iteration_callback.start(left, self.allowance)
        p = parameters(programme)
        guess, solver = _Point(_pack(iterate, lay), np.zeros(lay.num_rows)), compiled.solver()
        if begin is not None:
            begin(replace(compiled.record(guess, p, bounds)[0], iteration=first, phase=phase))
        found = _call(solver, iteration_callback, log, x0=guess.w, p=p, **inner)
        point = _last_point(found, iteration_callback, guess)
        record, lam_x = compiled.record(point, p, bounds)
        has_left = found is None
        if not (math.isfinite(record.residual) and math.isfinite(record.cost)):
            has_left, point = True, guess  # whatever the solver says, the numbers are no numbers any more
            record, lam_x = compiled.record(point, p, bounds)
        history = tuple(log.records)
        last = history[-1] if history else record
        taken = max(0, last.iteration - first) if history else 0
        record = replace(
            record,
            iteration=first + taken,
            increment=last.increment,
            step_length=last.step_length,
            wall_time_s=time.perf_counter() - clock,
            phase=phase,
        )
        stats = solver.stats() if found is not None else {}
        status = status_of(self.name, stats, iteration_callback.reason, self.max_iterations)
        if has_left and not iteration_callback.reason:
            status = Status.DIVERGED
        violations = compiled.violations(point.w, p, bounds)
        words = advice_of(status, programme, lay, violations, taken, record.residual)
        end = unpack(point.w, point.lam_g, lam_x, lay)
        return SolverResult(status, words, end, record, history or (record,))


class _Point(NamedTuple):
    """Unknowns, and the multipliers of the rows."""

    w: Array
    lam_g: Array


def _call(
    solver: ca.Function, iteration_callback: IterationCallback, log: IterationLog, **arguments: Any
) -> dict[str, Any] | None:
    """Run a solver object; None where it threw since numbers were not finite, or since it was ended.

    Raises
    ------
    Exception
        What the callback of the log raised, but for Ctrl-C.
    """
    printed = contextlib.redirect_stdout(OfThread(log))
    found: dict[str, Any] | None = None
    with _interruptible(iteration_callback, log), printed, whole_lines():
        try:
            found = solver(**arguments)
        except RuntimeError as error:  # of fatrop
            if not iteration_callback.reason and _THROWN not in str(error):
                raise
    if log.failure is not None and not isinstance(log.failure, KeyboardInterrupt):
        raise log.failure
    return found


def _last_point(found: dict[str, Any] | None, iteration_callback: IterationCallback, guess: _Point) -> _Point:
    """Where a solver ended; of one that was ended, what it asked for last."""
    lam_g = guess.lam_g if found is None else np.array(found["lam_g"]).ravel()
    if found is not None and not iteration_callback.reason:
        return _Point(np.array(found["x"]).ravel(), lam_g)
    return _Point(guess.w if iteration_callback.last is None else iteration_callback.last, lam_g)


@dataclass(frozen=True)
class _Key:
    """What a solver object depends on; two programmes with the same key share it."""

    name: str
    tolerance: float
    max_iterations: int
    linear_solver: str
    libraries: tuple[str, str]
    layout: NlpLayout
    structure: tuple[bytes, ...]  # which numbers are weights, and which sides of rows are bounds
    programme: StagewiseProgramme = field(compare=False)

    @classmethod
    def of(cls, options: InteriorPoint, programme: StagewiseProgramme) -> _Key:
        weights = (programme.theta_weights.tobytes(), programme.terminal_weights.tobytes())
        return cls(
            options.name,
            options.tolerance,
            options.max_iterations,
            options.linear_solver,
            (programme.functions.identity, programme.end_functions.identity),
            NlpLayout.of(programme, wants_gaps=options.name == "fatrop"),
            (*weights, kinds_of_bounds(programme)),
            programme,
        )


class _SolverFunctions:
    """The functions of a solver object.

    The object itself is made anew for every run of IPOPT, which takes milliseconds: CasADi holds the
    factorisation of its last run until it goes, many times the size of the functions. That of fatrop takes
    seconds where the horizon is long, and is kept.
    """

    def __init__(self, key: _Key) -> None:
        self.layout = key.layout
        functions = NlpFunctions(key.programme, key.layout)
        self.functions, self.iteration_callback = functions, IterationCallback(key.layout.num_unknowns)
        is_ipopt = key.name == "ipopt"
        w, p = ca.MX.sym("x", functions.f.numel_in(0)), ca.MX.sym("p", functions.f.numel_in(1))
        rows, jacobian = functions.jac_g(w, p)
        guarded = all_or_none(ca.MX(jacobian.sparsity(), jacobian.nz[:] + self.iteration_callback(w)))
        if not is_ipopt and key.layout.rows_are_gaps:
            guarded = calm_or_none(guarded, key.layout)
        self.gradient = functions.gradient(has_cost=False)
        cache = {
            "nlp_f": functions.f,
            "nlp_g": functions.g,
            "nlp_grad_f": functions.gradient(has_cost=True) if is_ipopt else self.gradient,
            "nlp_jac_g": ca.Function("nlp_jac_g", [w, p], [rows, guarded], ["x", "p"], ["g", "jac_g_x"]),
            "nlp_hess_l": functions.hessian(is_upper=is_ipopt),
            "nlp_grad": functions.first_order(),
        }
        options = {
            "cache": cache,
            "calc_lam_p": False,
            "calc_lam_x": False,
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": False,  # steps into the void are the line search's business
            **(_ipopt_options(key) if is_ipopt else _fatrop_options(key)),
        }
        problem = {"x": w, "p": p, "f": functions.f(w, p), "g": functions.g(w, p)}
        self._arguments = (key.name, problem, options)
        self._kept = None if is_ipopt else self._make()

    def solver(self) -> ca.Function:
        """The solver object of one run."""
        return self._make() if self._kept is None else self._kept

    def _make(self) -> ca.Function:
        return ca.nlpsol("solver", *self._arguments)

    def record(self, point: _Point, p: Array, bounds: dict[str, Array]) -> tuple[IterationRecord, Array]:
        """Cost and residuals at a point, computed anew, and the multipliers of the bounds on unknowns.

        These are what stationarity leaves for them. What counts as residual is a multiplier's product with
        the distance from its bound; or the multiplier alone where it is farther than 1, or there is none.
        """
        w, lam_g = point
        rows, jacobian = self.functions.jac_g(w, p)
        slopes: Array = np.array(self.gradient(w, p) + jacobian.T @ lam_g).ravel()
        g: Array = np.array(rows).ravel()
        distance = np.where(slopes > 0.0, w - bounds["lbx"], bounds["ubx"] - w)
        lam_x = np.where(np.isfinite(bounds["lbx"]) | np.isfinite(bounds["ubx"]), -slopes, 0.0)
        left = np.abs(slopes) * np.minimum(1.0, np.abs(distance))
        row_distance = np.where(lam_g < 0.0, g - bounds["lbg"], bounds["ubg"] - g)
        unused = np.abs(lam_g) * np.minimum(1.0, np.abs(row_distance))
        beyond = np.concatenate([miss(w, bounds, "x"), miss(g, bounds, "g")])
        primal, dual = norm(beyond), norm(np.concatenate([left, unused]))
        record = IterationRecord(
            iteration=0,
            residual=math.hypot(primal, dual),
            cost=float(self.functions.f(w, p)),
            primal=primal,
            dual=dual,
        )
        return record, lam_x

    def violations(self, w: Array, p: Array, bounds: dict[str, Array]) -> Array:
        """By how much each row misses its bounds, shape (num_rows,)."""
        return miss(np.array(self.functions.g(w, p)).ravel(), bounds, "g")


@lru_cache(maxsize=_MAX_SOLVERS)
def _compile(key: _Key) -> _SolverFunctions:
    return _SolverFunctions(key)


def _ipopt_options(key: _Key) -> dict[str, Any]:
    options: dict[str, Any] = {
        "ipopt.tol": key.tolerance,
        "ipopt.max_iter": key.max_iterations,
        "ipopt.print_level": 5,
        "ipopt.sb": "yes",
        "ipopt.nlp_scaling_method": "none",
        "ipopt.bound_relax_factor": 0.0,  # limits are limits
        "ipopt.constr_viol_tol": min(1e-4, 10 * key.tolerance),
    }
    if key.linear_solver != "auto":
        options["ipopt.linear_solver"] = key.linear_solver
    return options


def _fatrop_options(key: _Key) -> dict[str, Any]:
    lay = key.layout
    bounds = key.programme.bounds
    equality = np.ones(lay.num_rows, dtype=bool)
    equality[lay.path] = bounds.path_lower == bounds.path_upper
    equality[lay.guards] = False
    return {
        "structure_detection": "manual",
        "N": lay.num_steps,
        "nx": [lay.nx] * (lay.num_steps + 1),
        "nu": [lay.nw] * lay.num_steps + [0],
        "ng": list(lay.rows_of_node),
        "equality": equality.tolist(),
        "fatrop.tolerance": key.tolerance,
        "fatrop.max_iter": key.max_iterations - 1,  # it takes one more
        "fatrop.print_level": 5,
        # Its short cut for tiny steps leaves the multipliers of equations as they are (1.1.8: the step length
        # that it computes is local to a block), and the last barrier parameters are never reached.
        "fatrop.tiny_step_tol": 0.0,
    }


def _pack(iterate: Iterate, lay: NlpLayout) -> Array:
    w = np.zeros(lay.num_unknowns)
    w[lay.xs], w[lay.us], w[lay.ys] = iterate.xs, iterate.us, iterate.ys
    w[lay.x_nexts] = iterate.xs[1:]
    return w


def unpack(w: Array, lam_g: Array, lam_x: Array, lay: NlpLayout) -> Iterate:
    """Return unknowns and multipliers as an iterate."""
    lam_xs = lam_x[lay.xs]
    return Iterate(
        xs=w[lay.xs],
        ys=w[lay.ys],
        us=w[lay.us],
        ms=lay.sign * lam_g[lay.steps],
        eta=lam_g[lay.end],
        bounds=BoundMultipliers(xs=lam_xs, us=lam_x[lay.us], path=lam_g[lay.path], guard=lam_g[lay.guards]),
    )


@contextlib.contextmanager
def _interruptible(iteration_callback: IterationCallback, log: IterationLog) -> Iterator[None]:
    """Let Ctrl-C, or what the callback raises, end the solver in its next iteration, with what it has."""
    pressed: list[int] = []
    iteration_callback.is_wanted = lambda: not pressed and log.failure is None
    try:
        with signal_handler(signal.SIGINT, lambda number, frame: pressed.append(number)):
            yield
    finally:
        iteration_callback.is_wanted = lambda: True
