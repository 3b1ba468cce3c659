"""CasADi with IPOPT or fatrop, on generated and compiled C, with exact second derivatives.

Arms in inverse-dynamics form, with accelerations as controls (fewer iterations than with torques): torques
are RNEA(q, v, a), in the cost and in rows with bounds. Others with forward dynamics and their own controls.
Stage functions and their derivatives are compiled, and mapped over the stages; gradients, Jacobian and
Hessian are gathered from these by one permutation each.
"""

from __future__ import annotations

import subprocess
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from benchmarks.peers.task import Array, Task
from benchmarks.peers.tools.runs import NotSolved, Run, timed
from mbocp.lie import ConfigurationSpace
from mbocp.symbolic import model_functions

_MOST = 1000
_TOLERANCE = 1e-8
_FATROP_LIMITED = 1e-6  # with 1e-8 it goes on at the solution without an end
_INPUTS = ["x", "p", "lam_f", "lam_g"]


def run(task: Task, method: str, repeats: int) -> Run:
    """`method`: "ipopt" or "fatrop"."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        programme = _Programme(task, _compiled(task, Path(folder)), has_gaps_first=method == "fatrop")
        solver = programme.solver(method)
        arguments = programme.arguments()
        found, seconds = timed(lambda: solver(**arguments), repeats)
        stats = solver.stats()
        iterations = int(stats.get("iter_count", -1))
        if not stats["success"]:
            said = str(stats.get("return_status", "no success"))
            raise NotSolved(f"{said} after {iterations} iterations and {1e3 * min(seconds):.0f} ms")
        return programme.run(np.asarray(found["x"]).ravel(), iterations, seconds)


@dataclass(frozen=True)
class _Stage:
    """Compiled functions of z = (x, w): x is (q, v), w accelerations or controls."""

    values: ca.Function  # -> F, l, h
    first: ca.Function  # -> dF_dz, dl_dz, dh_dz
    second: ca.Function  # (z, lam_l, lam_F, lam_h) -> Hessian in z
    end: ca.Function  # (x, lam) -> g, dg_dx, Hessian


def _compiled(task: Task, folder: Path) -> _Stage:
    model, h = task.model, task.dt
    nq, nv, nu = model.nq, model.nv, task.torque_map.shape[1]
    functions, space = model_functions(model), ConfigurationSpace(model, "quaternion")
    z = ca.SX.sym("z", nq + nv + nu)
    q, v, w = ca.vertsplit(z, [0, nq, nq + nv, nq + nv + nu])
    if task.is_arm:
        u, a = functions.rnea(q, v, w), w
    else:
        u, a = w, functions.aba(q, v, ca.DM(task.torque_map) @ w)
    v1 = v + h * a
    reached = ca.vertcat(space.integrate(q, h * v1), v1)
    cost = h / 2.0 * (ca.dot(u, u) + task.weight * ca.dot(v, v))
    rows = u if task.is_limited and task.is_arm else ca.SX.zeros(0, 1)
    lam_l, lam_F, lam_h = ca.SX.sym("lam_l"), ca.SX.sym("lam_F", nq + nv), ca.SX.sym("lam_h", rows.numel())
    lagrangian = lam_l * cost + ca.dot(lam_F, reached)
    if rows.numel():
        lagrangian += ca.dot(lam_h, rows)
    x, lam = z[: nq + nv], ca.SX.sym("lam", 2 * nv)
    goal = ca.vertcat(space.difference(ca.SX(ca.DM(task.goal)), x[:nq]), x[nq:])
    made = [
        ca.Function("values", [z], [ca.densify(reached), cost, ca.densify(rows)]),
        ca.Function(
            "first", [z], [ca.jacobian(reached, z), ca.densify(ca.jacobian(cost, z)), ca.jacobian(rows, z)]
        ),
        ca.Function("second", [z, lam_l, lam_F, lam_h], [ca.hessian(lagrangian, z)[0]]),
        ca.Function("end", [x, lam], [goal, ca.jacobian(goal, x), ca.hessian(ca.dot(lam, goal), x)[0]]),
    ]
    generator = ca.CodeGenerator("stage.c")
    for function in made:
        inputs = function.sx_in()
        generator.add(ca.Function(function.name(), inputs, ca.cse(list(function.call(inputs)))))
    generator.generate(f"{folder}/")
    library = folder / "stage.so"
    command = [
        "cc",
        "-O2",
        "-march=native",
        "-fPIC",
        "-shared",
        str(folder / "stage.c"),
        "-o",
        str(library),
        "-lm",
    ]
    subprocess.run(command, check=True)
    return _Stage(*(ca.external(function.name(), str(library)) for function in made))


def _places(pattern: ca.Sparsity) -> tuple[Any, Any]:
    rows, columns = pattern.get_triplet()
    return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)


class _Entries:
    """Entries of a sparse matrix out of several vectors, gathered by one permutation."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape, self._rows, self._columns, self._values = shape, [], [], []

    def add(self, rows: Any, columns: Any, values: ca.MX) -> None:
        self._rows.append(np.ravel(rows))
        self._columns.append(np.ravel(columns))
        self._values.append(ca.vec(values))

    def matrix(self) -> ca.MX:
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        order = np.lexsort((rows, columns))
        pattern = ca.Sparsity.triplet(*self._shape, rows[order].tolist(), columns[order].tolist())
        return ca.MX(pattern, ca.vertcat(*self._values)[order.tolist()])


class _Programme:
    """x_0, w_0, x_1, ..., x_N under the gaps x_{k+1} - F(x_k, w_k), the start, rows of stages and the end."""

    def __init__(self, task: Task, stage: _Stage, *, has_gaps_first: bool) -> None:
        self.task, self.stage = task, stage
        self.nq, self.nv = task.model.nq, task.model.nv
        self.nx, self.nw = self.nq + self.nv, task.torque_map.shape[1]
        self.nz, self.N = self.nx + self.nw, task.num_steps
        self.nh = stage.values.numel_out(2)
        self.n = self.N * self.nz + self.nx
        per = self.nx + self.nh
        at = np.arange(self.N) * per + (np.arange(self.N) > 0) * self.nx
        self.gaps = at[:, None] + np.arange(self.nx)
        self.start = np.arange(self.nx) + self.nx  # behind the first gap
        self.rows = at[:, None] + self.nx + (np.arange(self.N) == 0)[:, None] * self.nx + np.arange(self.nh)
        self.m = self.N * per + self.nx + 2 * self.nv
        self.end = np.arange(self.m - 2 * self.nv, self.m)
        self.zs = np.arange(self.N)[:, None] * self.nz + np.arange(self.nz)
        self.xs = np.arange(self.N + 1)[:, None] * self.nz + np.arange(self.nx)

    @cached_property
    def _symbols(self) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
        w = ca.MX.sym("w", self.n)
        Z = ca.reshape(w[: self.N * self.nz], self.nz, self.N)
        last = w[self.N * self.nz :]
        nodes = ca.horzcat(Z[: self.nx, 1:], last)
        return w, Z, nodes, last

    def _values(self) -> tuple[ca.MX, ca.MX]:
        _, Z, nodes, last = self._symbols
        F, cost, h = self.stage.values.map(self.N)(Z)
        of_stages = ca.vertcat(nodes - F, h) if self.nh else nodes - F
        x0 = ca.DM(np.concatenate([self.task.q0, np.zeros(self.nv)]))
        start = Z[: self.nx, 0] - x0
        first = [of_stages[: self.nx, 0], start, of_stages[self.nx :, 0]]
        end = self.stage.end(last, ca.DM.zeros(2 * self.nv))[0]
        return ca.sum2(cost), ca.vertcat(*first, ca.vec(of_stages[:, 1:]), end)

    def _slopes(self) -> tuple[ca.MX, ca.MX]:
        _, Z, _, last = self._symbols
        dF, dl, dh = self.stage.first.map(self.N)(Z)
        gradient = ca.vertcat(ca.vec(ca.reshape(dl, self.nz, self.N)), ca.MX.zeros(self.nx))
        entries = _Entries((self.m, self.n))
        rows, columns = _places(self.stage.first.sparsity_out(0))
        entries.add(self.gaps[:, rows], self.zs[:, columns], -dF.nz[:])
        entries.add(self.gaps, self.xs[1:], ca.MX.ones(self.gaps.size))
        entries.add(self.start, self.xs[0], ca.MX.ones(self.nx))
        if self.nh:
            rows, columns = _places(self.stage.first.sparsity_out(2))
            entries.add(self.rows[:, rows], self.zs[:, columns], dh.nz[:])
        rows, columns = _places(self.stage.end.sparsity_out(1))
        of_end = self.stage.end(last, ca.DM.zeros(2 * self.nv))[1]
        entries.add(self.end[rows], self.xs[-1][columns], of_end.nz[:])
        return gradient, entries.matrix()

    def _curvature(self, lam_f: ca.MX, lam_g: ca.MX, *, is_upper: bool) -> ca.MX:
        _, Z, _, last = self._symbols
        lam_F = -ca.reshape(lam_g[self.gaps.ravel().tolist()], self.nx, self.N)
        lam_h = ca.MX(0, self.N)
        if self.nh:
            lam_h = ca.reshape(lam_g[self.rows.ravel().tolist()], self.nh, self.N)
        blocks = self.stage.second.map(self.N)(Z, ca.repmat(lam_f, 1, self.N), lam_F, lam_h)
        entries = _Entries((self.n, self.n))
        for pattern, places, values in (
            (self.stage.second.sparsity_out(0), self.zs, blocks),
            (self.stage.end.sparsity_out(2), self.xs[-1:], self.stage.end(last, lam_g[self.end.tolist()])[2]),
        ):
            rows, columns = _places(pattern)
            kept = np.flatnonzero(rows <= columns) if is_upper else np.arange(len(rows))
            count = len(places)
            numbers = (np.arange(count)[:, None] * len(rows) + kept).ravel()
            entries.add(places[:, rows[kept]], places[:, columns[kept]], values.nz[numbers.tolist()])
        return entries.matrix()

    def solver(self, method: str) -> ca.Function:
        """Solver object of CasADi, whose functions are given, none derived."""
        w, p = self._symbols[0], ca.MX.sym("p", 0)
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.m)
        (f, g), (gradient, jacobian) = self._values(), self._slopes()
        is_ipopt = method == "ipopt"
        hessian = self._curvature(lam_f, lam_g, is_upper=is_ipopt)
        of_lagrangian = [w, p, lam_f, lam_g]
        second = ca.Function("nlp_hess_l", of_lagrangian, [hessian], _INPUTS, ["triu_hess_gamma_x_x"])
        of_cost = ca.Function("nlp_grad_f", [w, p], [f, gradient], ["x", "p"], ["f", "grad_f_x"])
        if not is_ipopt:
            outputs = [ca.MX.zeros(self.n), hessian]
            names = ["grad_gamma_x", "hess_gamma_x_x"]
            second = ca.Function("nlp_hess_l", of_lagrangian, outputs, _INPUTS, names)
            of_cost = ca.Function("nlp_grad_f", [w, p], [gradient], ["x", "p"], ["grad_f_x"])
        slopes = lam_f * gradient + ca.mtimes(jacobian.T, lam_g)
        cache = {
            "nlp_f": ca.Function("nlp_f", [w, p], [f], ["x", "p"], ["f"]),
            "nlp_g": ca.Function("nlp_g", [w, p], [g], ["x", "p"], ["g"]),
            "nlp_grad_f": of_cost,
            "nlp_jac_g": ca.Function("nlp_jac_g", [w, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
            "nlp_hess_l": second,
            "nlp_grad": ca.Function(
                "nlp_grad",
                of_lagrangian,
                [f, g, slopes, ca.MX.zeros(0)],
                _INPUTS,
                ["f", "g", "grad_gamma_x", "grad_gamma_p"],
            ),
        }
        options: dict[str, Any] = {
            "cache": cache,
            "calc_lam_p": False,
            "calc_lam_x": False,
            "print_time": False,
        }
        options |= {"error_on_fail": False}
        if is_ipopt:
            options |= {
                "ipopt.tol": _TOLERANCE,
                "ipopt.max_iter": _MOST,
                "ipopt.print_level": 0,
                "ipopt.sb": "yes",
            }
        else:
            equality = np.ones(self.m, dtype=bool)
            equality[self.rows.ravel()] = False
            ng = [self.nh + self.nx] + [self.nh] * (self.N - 1) + [2 * self.nv]
            options |= {
                "structure_detection": "manual",
                "N": self.N,
                "nx": [self.nx] * (self.N + 1),
                "nu": [self.nw] * self.N + [0],
                "ng": ng,
                "equality": equality.tolist(),
                "fatrop.tolerance": _FATROP_LIMITED if self.nh else _TOLERANCE,
                "fatrop.max_iter": _MOST,
                "fatrop.print_level": 0,
                "fatrop.tiny_step_tol": 0.0,  # 1.1.8 keeps multipliers with tiny steps, and does not end
            }
        nlp = {"x": w, "p": p, "f": cache["nlp_f"](w, p), "g": cache["nlp_g"](w, p)}
        return ca.nlpsol("solver", method, nlp, options)

    def arguments(self) -> dict[str, Any]:
        """Guess and bounds."""
        task = self.task
        w = np.zeros(self.n)
        x0 = np.concatenate([task.q0, np.zeros(self.nv)])
        w[self.xs] = x0
        if not task.is_arm:
            w[self.zs[:, self.nx :]] = task.holding()
        lower, upper = np.zeros(self.m), np.zeros(self.m)
        if self.nh:
            lower[self.rows], upper[self.rows] = -task.limits, task.limits
        return {"x0": w, "lbg": lower, "ubg": upper}

    def run(self, w: Array, iterations: int, seconds: list[float]) -> Run:
        """Trajectory of the unknowns."""
        xs, ws = w[self.xs], w[self.zs[:, self.nx :]]
        qs, vs, us = xs[:, : self.nq], xs[:, self.nq :], ws
        if self.task.is_arm:
            model, data = self.task.model, self.task.model.createData()
            us = np.array(
                [pin.rnea(model, data, q, v, a).copy() for q, v, a in zip(qs, vs, ws, strict=False)]
            )
        return Run(qs, vs, us, iterations, seconds)
