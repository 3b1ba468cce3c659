"""Motions that are robust and such that are not, in simulations with all that is uncertain.

`python -m benchmarks.robust --runs 1000` solves an example with `[robust]` as it is, and with limits that
leave no room, and runs both. Each run draws a start, masses of payloads and noise. Its controls are those of
the plan and the feedback, held over each step and cut off at the limits of torque. It goes on by the
fourth-order Runge-Kutta method with Pinocchio's forward dynamics: nothing of mbocp moves the robot there.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp import Problem, Solution
from mbocp._arrays import Array

__all__ = ["Runs", "robust_table", "simulate"]

EXAMPLE = Path(__file__).parents[1] / "examples" / "arms" / "robust_slalom.toml"
_FINER = 5  # steps in each of a solution
NONE = 1e-9  # standard deviations: as good as no room


@dataclass(frozen=True, eq=False)
class Runs:
    """States at the nodes of a solution, speeds within its steps, controls as the feedback asks for them.

    Attributes
    ----------
    qs, vs, us : ndarray, shapes (runs, N + 1, nq), (runs, N + 1, nv), (runs, N, nu)
    within : ndarray, shape (runs, N, finer, nv)
        Speeds; the last of each step are those at the node.
    """

    qs: Array
    vs: Array
    us: Array
    within: Array

    def away(self, problem: Problem, solution: Solution) -> tuple[Array, Array]:
        """Moves of q along its tangent, and of v, from the plan, shapes (runs, N + 1, nv)."""
        pairs = [
            [problem.robot.difference(p, q) for p, q in zip(solution.qs, run, strict=True)] for run in self.qs
        ]
        return np.array(pairs), self.vs - solution.vs

    def kept(self, problem: Problem) -> dict[str, Array]:
        """Whether each step of each run keeps limits, and its end distances, by what, shapes (runs, any)."""
        limits = problem.limits
        found = {
            "torque": ((self.us <= limits.u_upper) & (self.us >= limits.u_lower)).all(axis=2),
            "speed": ((self.within <= limits.v_upper) & (self.within >= limits.v_lower)).all(axis=(2, 3)),
        }
        if problem.clearance is not None:
            runs, nodes, nq = self.qs.shape
            least = problem.clearance.least(self.qs.reshape(-1, nq)).reshape(runs, nodes)
            found["distance"] = (least >= 0.0)[:, 1:]
        return found


def simulate(
    problem: Problem,
    solution: Solution,
    runs: int,
    *,
    seed: int = 0,
    finer: int = _FINER,
    holds_noise: bool = False,
) -> Runs:
    """Simulations of a robot without loops under the feedback of a robust solution.

    Noise is drawn for each of the finer steps, or for each of the solution, as tubes have it.
    """
    robot, robust, rng = problem.robot, problem.robust, np.random.default_rng(seed)
    assert robust is not None
    lengths, nv = np.diff(solution.t), robot.nv
    gains = solution.gains if robust.feedback == "gains" else np.zeros((len(lengths), robot.nu, 2 * nv))
    B = robot.actuation_matrix(solution.qs[0])
    within = np.zeros((len(lengths), finer, nv))
    found = Runs(*(np.zeros((runs, *rows.shape)) for rows in (solution.qs, solution.vs, solution.us, within)))
    for qs, vs, us, speeds in zip(found.qs, found.vs, found.us, found.within, strict=True):
        model = _drawn_model(problem, rng)
        data = model.createData()
        q = pin.integrate(model, solution.qs[0], robust.q * rng.standard_normal(nv))
        v = solution.vs[0] + robust.v * rng.standard_normal(nv)
        qs[0], vs[0] = q, v
        for n, length in enumerate(lengths):
            away = np.concatenate([pin.difference(model, solution.qs[n], q), v - solution.vs[n]])
            us[n] = u = solution.us[n] + gains[n] @ away
            u = np.clip(u, problem.limits.u_lower, problem.limits.u_upper)
            h = length / finer
            noise = rng.standard_normal((1 if holds_noise else finer, robot.nu))
            noise = noise * robust.tau / np.sqrt(length if holds_noise else h)
            for k in range(finer):
                tau = B @ (u + noise[k % len(noise)])
                q, v = _step(model, data, q, v, tau, h)
                speeds[n, k] = v
            qs[n + 1], vs[n + 1] = q, v
    return found


def _drawn_model(problem: Problem, rng: np.random.Generator) -> pin.Model:
    """The robot with other masses of its payloads."""
    robot, robust = problem.robot, problem.robust
    model = pin.Model(robot.model)
    for word, sizes in robust.parameters.items() if robust is not None else ():
        _, _, name, key = word.split(".", 3)
        assert key == "mass", f"{word}: masses alone are drawn"
        (payload,) = (payload for payload in robot.payloads if payload.name == name)
        frame = model.frames[model.getFrameId(payload.frame)]
        mass = payload.mass + sizes[0] * rng.standard_normal()
        here = [
            frame.placement.act(pin.Inertia(m, np.array(payload.com), np.zeros((3, 3))))
            for m in (payload.mass, mass)
        ]
        body = model.inertias[frame.parentJoint].toDynamicParameters()
        body = body - here[0].toDynamicParameters() + here[1].toDynamicParameters()
        model.inertias[frame.parentJoint] = pin.Inertia.FromDynamicParameters(body)
    return model


def _step(model: pin.Model, data: pin.Data, q: Array, v: Array, tau: Array, h: float) -> tuple[Array, Array]:
    """Classical Runge-Kutta method, along the tangent of where the step begins: right for plain joints."""

    def slope(dq: Array, dv: Array) -> tuple[Array, Array]:
        at = v + dv
        return at, pin.aba(model, data, pin.integrate(model, q, dq), at, tau - model.damping * at)

    zero = np.zeros(model.nv)
    k1 = slope(zero, zero)
    k2 = slope(h / 2 * k1[0], h / 2 * k1[1])
    k3 = slope(h / 2 * k2[0], h / 2 * k2[1])
    k4 = slope(h * k3[0], h * k3[1])
    dq, dv = (h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]) for i in (0, 1))
    return pin.integrate(model, q, dq), v + dv


def robust_table(runs: int, path: Path = EXAMPLE, sigmas: Sequence[float] = ()) -> Table:
    """How many runs leave a limit somewhere, and in the worst step of each limit."""
    problem = mbocp.load_problem(path)
    rows = []
    rooms = {f"robust, {count:g} sigmas": count for count in sigmas or (problem.robust.sigmas,)}
    for name, count in ({"as near as limits allow": NONE} | rooms).items():
        tried = problem.with_(robust={"sigmas": count})
        clock = time.perf_counter()
        solution = mbocp.solve(tried, check=True)
        spent = time.perf_counter() - clock
        kept = simulate(tried, solution, runs).kept(problem)
        left = {kind: 1.0 - nodes.all(axis=1).mean() for kind, nodes in kept.items()}
        worst = max(1.0 - float(nodes.mean(axis=0).min()) for nodes in kept.values())
        whole = 1.0 - np.hstack([*kept.values()]).all(axis=1).mean()
        shares = ", ".join(f"{kind} {100 * share:.1f} %" for kind, share in left.items())
        rows.append(
            [
                name,
                f"{solution.cost:.4g}",
                f"{spent:.2g}",
                f"{100 * whole:.1f} %",
                shares,
                f"{100 * worst:.1f} %",
            ]
        )
    columns = ["motion", "cost", "s", "runs that leave a limit", "of them", "in the worst step"]
    return Table(f"{runs} simulations of {path.stem}", columns, rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robust", description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--sigmas", type=float, nargs="+", default=(), help="in place of the problem's")
    parser.add_argument("--problem", type=Path, default=EXAMPLE)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    options = parser.parse_args(arguments)
    one_core()
    for table in (header(), robust_table(options.runs, options.problem, options.sigmas)):
        show(table, markdown=options.markdown)


if __name__ == "__main__":
    main()
