"""The nonlinear programme's functions against finite differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.problem import Problem
from mbocp.programme import StagewiseProgramme
from mbocp.robot import load_robot
from mbocp.solvers.nlp.nlp_functions import NlpFunctions, parameters
from mbocp.solvers.nlp.nlp_layout import NlpLayout
from tests.integrators.explicit import towed_body

UPSIDE_DOWN = [1.0, 0.5, 1.5, 0.9489846193555862, 0, 0, 0.3153223623952687]
PATH = [
    {"name": "box", "kind": "position", "frame": "base_link", "x": [-9, 9], "z": [-5, 7]},
    {"name": "tree", "kind": "distance", "frame": "base_link", "point": [3, 2, 1], "min": 0.3},
    {"name": "calm", "kind": "speed", "frame": "base_link", "max": 30.0},
]


def drone(lie: str, rotations: str) -> Problem:
    """An explicit programme with all there is: path, rate and potential, penalty and exact end, guard."""
    robot = load_robot("hector", actuated=["root_joint"], rotations=rotations)
    return Problem.create(
        robot,
        0.3,
        3,
        goal={"q": UPSIDE_DOWN, "v": [0.0] * 6, "enforce": "both"},
        cost={
            "effort": 0.5,
            "control_rate": 0.02,
            "potential": -0.3,
            "velocity": 0.7,
            "tracking": 0.4,
            "terminal": 1.3,
            "target": {"q": UPSIDE_DOWN},
        },
        path=PATH,
        limits={"effort": 50.0},
        integrator={"scheme": "rk4" if lie == "munthe_kaas" else "heun", "lie": lie},
        solver={"method": "ipopt"},
    )


def unicycle() -> Problem:
    """Drives, one of them of a velocity."""
    robot = load_robot("unicycle_pendulum", rotations="dcm")
    goal = {"q": {"base_x": 0.5, "base_y": 0.5, "pendulum": [0, 0, 0, 1]}, "v": {"pendulum": [0, 0, 0]}}
    path = [{"kind": "speed", "frame": "pendulum_tip", "max": 9.0}]
    return Problem.create(
        robot,
        0.4,
        4,
        goal=goal,
        cost={"effort": 0, "control_rate": 2e-3, "potential": -1},
        path=path,
        limits={"effort": True},
        scheme="rk4",
        solver={"method": "fatrop"},
    )


def towed(scheme: str) -> Problem:
    """Quaternions and a holonomic constraint, in coordinates."""
    robot = towed_body()
    q = np.array(robot.q0)
    q[-3:] = [0.2, 0.0, 0.1 - 1.5]
    there = robot.integrate(q, 0.3 * np.ones(robot.nv))
    path = [{"kind": "speed", "frame": "body", "max": 9.0}]
    return Problem.create(
        robot,
        0.3,
        3,
        start={"q": q},
        goal={"q": q, "v": [0.0] * robot.nv, "enforce": "exact"},
        cost={"effort": 1.0, "velocity": 0.3, "tracking": 0.2, "target": {"q": there}},
        path=path,
        scheme=scheme,
        solver={"method": "ipopt"},
    )


CASES: dict[str, tuple[Callable[[], Problem], bool]] = {
    "drone-munthe_kaas-dcm": (lambda: drone("munthe_kaas", "dcm"), True),
    "drone-munthe_kaas-quaternion": (lambda: drone("munthe_kaas", "quaternion"), False),
    "drone-baumgarte-dcm": (lambda: drone("baumgarte", "dcm"), True),
    "unicycle": (unicycle, True),
    "towed-se1": (lambda: towed("se1"), False),
    "towed-se1-lifted": (lambda: towed("se1"), True),
    "towed-midpoint-lifted": (lambda: towed("midpoint"), True),
}
SLOW = ("drone-munthe_kaas-quaternion", "drone-baumgarte-dcm", "towed-se1", "towed-midpoint-lifted")


class Nlp:
    """Functions at a point that is near no solution, and on no group."""

    def __init__(self, problem: Problem, *, wants_gaps: bool) -> None:
        self.formulation = formulate(problem)
        self.programme: StagewiseProgramme = self.formulation.programme
        self.layout = NlpLayout.of(self.programme, wants_gaps=wants_gaps)
        self.functions = NlpFunctions(self.programme, self.layout)
        self.p = parameters(self.programme)
        rng = np.random.default_rng(1)
        lay, at = self.layout, self.formulation.layout
        w = 0.1 * rng.standard_normal(lay.num_unknowns)
        w[lay.xs] += self.programme.x_start
        w[lay.x_nexts] = w[lay.xs[1:]] + 0.05 * rng.standard_normal((lay.num_steps, lay.nx))
        w[lay.xs[:, at.s]] += 1.0
        self.w = w
        self.lam_f, self.lam_g = 1.7, rng.standard_normal(lay.num_rows)

    def cost(self, w: Array) -> Array:
        return np.array([float(self.functions.f(w, self.p))])

    def rows(self, w: Array) -> Array:
        return np.asarray(self.functions.g(w, self.p)).ravel()

    def slopes(self, w: Array) -> Array:
        """Of the Lagrangian, out of gradient and Jacobian."""
        gradient = np.asarray(self.functions.gradient(has_cost=False)(w, self.p)).ravel()
        jacobian = self.functions.jac_g(w, self.p)[1]
        return self.lam_f * gradient + np.asarray(jacobian.T @ self.lam_g).ravel()


def differences(f: Callable[[Array], Array], w: Array) -> Array:
    """Jacobian by central differences of fourth order."""
    h, columns = 1e-3, []
    for i in range(w.size):
        e = h * np.eye(w.size)[i]
        columns.append((8 * (f(w + e) - f(w - e)) - (f(w + 2 * e) - f(w - 2 * e))) / (12 * h))
    return np.array(columns).T


@pytest.fixture(
    scope="module", params=[pytest.param(c, marks=[pytest.mark.slow] if c in SLOW else []) for c in CASES]
)
def nlp(request: pytest.FixtureRequest) -> Nlp:
    make, wants_gaps = CASES[request.param]
    return Nlp(make(), wants_gaps=wants_gaps)


def close(got: Any, wanted: Array, tolerance: float) -> bool:
    return bool(np.allclose(np.asarray(got), wanted, rtol=0, atol=tolerance * (1 + np.abs(wanted).max())))


def test_layout_places_everything_once(nlp: Nlp) -> None:
    lay = nlp.layout
    unknowns = [lay.xs, lay.us, lay.ys, *([lay.x_nexts] if lay.is_lifted else [])]
    assert np.array_equal(np.sort(np.concatenate([u.ravel() for u in unknowns])), np.arange(lay.num_unknowns))
    own = [lay.steps] if lay.is_lifted else []
    rows = [lay.gaps, *own, lay.start, lay.end, lay.guards, lay.path]
    assert np.array_equal(np.sort(np.concatenate([r.ravel() for r in rows])), np.arange(lay.num_rows))
    assert nlp.rows(nlp.w).size == lay.num_rows


def test_gradient(nlp: Nlp) -> None:
    f = nlp.functions
    got = np.asarray(f.gradient(has_cost=False)(nlp.w, nlp.p)).ravel()
    assert close(got, differences(nlp.cost, nlp.w)[0], 1e-8)
    cost, again = f.gradient(has_cost=True)(nlp.w, nlp.p)
    assert float(cost) == nlp.cost(nlp.w)[0]
    assert np.array_equal(np.asarray(again).ravel(), got)


def test_jacobian(nlp: Nlp) -> None:
    rows, jacobian = nlp.functions.jac_g(nlp.w, nlp.p)
    assert np.allclose(np.asarray(rows).ravel(), nlp.rows(nlp.w), rtol=0, atol=1e-13)
    assert close(jacobian, differences(nlp.rows, nlp.w), 1e-8)


def test_gradient_of_the_lagrangian(nlp: Nlp) -> None:
    f, g, slopes, zero = nlp.functions.first_order()(nlp.w, nlp.p, nlp.lam_f, nlp.lam_g)
    assert float(f) == pytest.approx(nlp.cost(nlp.w)[0], rel=1e-14)
    assert close(np.asarray(g).ravel(), nlp.rows(nlp.w), 1e-14)
    assert close(np.asarray(slopes).ravel(), nlp.slopes(nlp.w), 1e-14)
    assert zero.nnz() == zero.numel() == nlp.p.size
    assert not np.any(np.asarray(zero))


def test_hessian(nlp: Nlp) -> None:
    wanted = differences(nlp.slopes, nlp.w)
    arguments = (nlp.w, nlp.p, nlp.lam_f, nlp.lam_g)
    upper = nlp.functions.hessian(is_upper=True)(*arguments)
    assert upper.sparsity().is_triu()
    assert close(upper, np.triu(wanted), 1e-7)
    _, full = nlp.functions.hessian(is_upper=False)(*arguments)  # fatrop reads no gradient there
    assert close(full, wanted, 1e-7)


def test_the_cost_is_scaled_without_the_constraints(nlp: Nlp) -> None:
    """lam_f = 0 leaves the curvature of the rows, lam_g = 0 that of the cost; both together add up."""
    hessian = nlp.functions.hessian(is_upper=True)
    both = ca.DM(hessian(nlp.w, nlp.p, nlp.lam_f, nlp.lam_g))
    rows = hessian(nlp.w, nlp.p, 0.0, nlp.lam_g)
    cost = hessian(nlp.w, nlp.p, 1.0, 0 * nlp.lam_g)
    assert close(rows + nlp.lam_f * cost, np.asarray(both), 1e-14)


def test_stages_are_banded(nlp: Nlp) -> None:
    """Every row of a step touches its own block and the next state only; so do the rows of a node."""
    lay = nlp.layout
    pattern = nlp.functions.jac_g.sparsity_out(1)
    rows, columns = (np.array(a) for a in pattern.get_triplet())
    block = np.minimum(columns // lay.block, lay.num_steps)
    starts = [*(lay.gaps[:, 0]), lay.num_rows - lay.rows_of_node[-1]]
    node = np.searchsorted(starts, rows, side="right") - 1
    assert np.all((block == node) | (block == node + 1))
    is_gap = np.isin(rows, lay.gaps)
    assert np.all(block[~is_gap] == node[~is_gap])
    if lay.is_lifted or lay.rows_are_gaps:  # gaps x_{n+1} - F(x_n, w_n)
        ahead = is_gap & (block == node + 1)
        offset = columns[ahead] - np.minimum(block[ahead], lay.num_steps) * lay.block
        assert np.array_equal(offset, rows[ahead] - lay.gaps[node[ahead], 0])
