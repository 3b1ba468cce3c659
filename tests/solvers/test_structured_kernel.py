"""Stages that are condensed through the null space of their constraints, against the dense kernel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbocp.programme.native_modules import kernel

DT = 0.02  # [s]


@dataclass(frozen=True)
class Chain:
    """Links that hang on hinges, in director coordinates: twelve numbers a link, eleven constraints."""

    links: int = 2
    steps: int = 6
    closed: bool = False  # a rod from the last link to the ground
    remembered: bool = False  # controls of the step before belong to the state
    whole_loop: bool = False  # the loop may pivot in the last link's columns only
    costly_impulses: bool = False  # the constraints' impulses cost something

    @property
    def nq(self) -> int:
        return 12 * self.links

    @property
    def ny(self) -> int:
        return 11 * self.links + self.closed

    @property
    def nr(self) -> int:
        return self.links if self.remembered else 0

    @property
    def ndx(self) -> int:
        return 2 * self.nq + self.nr

    @property
    def groups(self) -> list[tuple[int, int, list[int]]]:
        tree = [(11 * k, 11, list(range(12 * k, 12 * k + 12))) for k in range(self.links)]
        last = list(range(12 * self.links - 12, 12 * self.links)) if self.whole_loop else []
        return [*tree, (11 * self.links, 1, last)] if self.closed else tree

    def rest(self) -> np.ndarray[Any, Any]:
        """Coordinates that satisfy the constraints: links turned by 0.3, 0.6, ... rad."""
        q, tip = [], np.zeros(3)
        for k in range(self.links):
            c, s = np.cos(0.3 * (k + 1)), np.sin(0.3 * (k + 1))
            R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            q += [tip + R @ [0.25, 0.0, 0.0], *R.T]
            tip = tip + R @ [0.5, 0.0, 0.0]
        return np.concatenate(q)

    def constraints(self, q: ca.SX) -> ca.SX:
        rows, tip, x, y = [], ca.DM.zeros(3), ca.DM([1, 0, 0]), ca.DM([0, 1, 0])
        for k in range(self.links):
            p, *d = ca.vertsplit(q[12 * k : 12 * k + 12], 3)
            rows += [(ca.dot(e, e) - 1) / 2 for e in d]
            rows += [ca.dot(d[0], d[1]), ca.dot(d[1], d[2]), ca.dot(d[2], d[0])]
            rows += [p - 0.25 * d[0] - tip, ca.dot(x, d[2]), ca.dot(y, d[2])]
            tip, x, y = p + 0.25 * d[0], d[0], d[1]
        if self.closed:
            anchor = ca.DM([0.7, -0.4, 0.0])
            length = float(ca.sumsqr(ca.DM(self.tip()) - anchor))
            rows.append((ca.sumsqr(tip - anchor) - length) / 2)
        return ca.vertcat(*rows)

    def tip(self) -> np.ndarray[Any, Any]:
        last = self.rest()[-12:]
        return last[:3] + 0.25 * last[3:6]

    def force(self, q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        """Weight, damping, and torques about the hinges' axes with their reactions."""
        f = -0.2 * v
        for k in range(self.links):
            f[12 * k + 1] -= 9.81
            for link, sign in ((k, 1), (k - 1, -1)):
                if link >= 0:
                    d = ca.vertsplit(q[12 * link + 3 : 12 * link + 12], 3)
                    for i in range(3):
                        at = slice(12 * link + 3 + 3 * i, 12 * link + 6 + 3 * i)
                        f[at] += sign * u[k] / 2 * ca.cross(d[2], d[i])
        return f

    def functions(self, ng: int) -> dict[str, ca.Function]:
        nq, nr = self.nq, self.nr
        x0, x1, y, u = (ca.SX.sym(n, k) for n, k in zip("axyu", self.sizes, strict=True))
        m, theta, rho = ca.SX.sym("m", self.ndx + self.ny), ca.SX.sym("theta", 1), ca.SX.sym("rho", 1)
        q0, v0, q1, v1 = x0[:nq], x0[nq : 2 * nq], x1[:nq], x1[nq : 2 * nq]
        mass = ca.DM([1.0] * 3 + [0.03] * 3 + [0.02] * 3 + [0.01] * 3)
        phi = self.constraints(q1)
        momentum = DT * (self.force(q1, v1, u) - 0.3 * (q1 + q0) * q1)
        momentum += -ca.repmat(mass, self.links) * (v1 - v0) - ca.jacobian(phi, q1).T @ y
        rows = [q0 + DT * v1 - q1, momentum]
        if nr:
            rows.append(u - x1[2 * nq :])
        c = ca.vertcat(*rows, phi / DT)
        cost = DT * (ca.sumsqr(u) / 2 + ca.sumsqr(v1) / 10 + rho * theta * ca.sumsqr(q1 - self.rest()))
        cost += ca.sumsqr(u - x0[2 * nq :]) if nr else 0
        cost += ca.sumsqr(y) if self.costly_impulses else 0
        z, args = ca.vertcat(x1, y, x0, u), [x0, x1, y, u]
        hessian, _ = ca.hessian(cost + ca.dot(m, c), z)
        first = [c, cost, ca.jacobian(c, z), ca.jacobian(cost, z)]
        x, d, eta, none = x0, ca.SX.sym("d", self.ndx), ca.SX.sym("eta", ng), ca.SX.sym("none", 0)
        D = np.random.default_rng(7).standard_normal((ng, 2 * nq))
        g = ca.DM(D) @ (x[: 2 * nq] - np.concatenate([self.rest(), np.zeros(nq)])) + 0.05 * ca.sumsqr(x)
        psi = ca.sumsqr(x) / 3
        end, _ = ca.hessian(psi + ca.dot(eta, g), x)
        return {
            "values": ca.Function("values", [*args, theta, rho], first[:2]),
            "jacobian": ca.Function("jacobian", [*args, theta, rho], first),
            "complete": ca.Function("complete", [*args, m, theta, rho], [*first, ca.triu(hessian)]),
            "terminal_values": ca.Function("tv", [x, none], [psi, g]),
            "terminal_complete": ca.Function(
                "tc", [x, eta, none], [psi, g, ca.jacobian(g, x), ca.jacobian(psi, x), ca.triu(end)]
            ),
            "retract": ca.Function("retract", [x, d], [x + d]),
            "difference": ca.Function("difference", [x, d], [d - x]),
        }

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        return self.ndx, self.ndx, self.ny, self.links

    def programmes(self, ng: int = 2) -> tuple[Any, Any]:
        """The same programme in a dense kernel and in one with groups, at rest."""
        native = kernel()
        load = {k: native.StageFunction.of(f) for k, f in self.functions(ng).items()}
        return self.programme(load, [], ng), self.programme(load, self.groups, ng)

    def programme(self, load: dict[str, Any], groups: list[Any], ng: int) -> Any:
        native, nc, ones = kernel(), self.ndx + self.ny, np.ones
        kind = native.Kind(
            nx=self.ndx, ndx=self.ndx, ny=self.ny, nu=self.links, nr=1, groups=groups,
            values=load["values"], jacobian=load["jacobian"], complete=load["complete"],
            scale_c=ones(nc), scale_y=ones(self.ny), scale_m=ones(nc), scale_ru=ones(self.links),
        )  # fmt: skip
        end = native.Terminal(ng=ng, values=load["terminal_values"], complete=load["terminal_complete"])
        made = native.Programme(self.steps, kind, end, load["retract"], load["difference"])
        rhos = 1.0 + 0.1 * np.arange(self.steps)
        made.set_parameters(np.array([0.7]), rhos, np.zeros(0))
        made.x = np.tile(np.concatenate([self.rest(), np.zeros(self.nq + self.nr)]), self.steps + 1)
        return made


CHAINS = {
    "one link": Chain(links=1),
    "two links": Chain(),
    "three links": Chain(links=3, steps=10),
    "a loop": Chain(links=3, closed=True),
    "a loop with columns": Chain(links=3, closed=True, whole_loop=True),
    "remembered controls": Chain(remembered=True),
    "one step": Chain(steps=1),
}


@pytest.fixture(scope="module", params=CHAINS.values(), ids=CHAINS.keys())
def made(request: pytest.FixtureRequest) -> tuple[Any, Any]:
    programmes: tuple[Any, Any] = request.param.programmes()
    return programmes


@pytest.fixture
def pair(made: tuple[Any, Any]) -> Iterator[tuple[Any, Any]]:
    """A dense and a structured programme at rest."""
    at_rest = made[0].x
    yield made
    for programme in made:
        programme.x = at_rest


def disturb(programmes: tuple[Any, Any], seed: int = 0, size: float = 0.1, start: float = 0.0) -> None:
    """The same random iterate for both; x_0 stays where it is but for `start`."""
    dense = programmes[0]
    rng = np.random.default_rng(seed)
    values = {name: size * rng.standard_normal(getattr(dense, name).size) for name in ("y", "u", "m", "eta")}
    x = dense.x + size * rng.standard_normal(dense.x.size)
    nx = x.size // (dense.num_stages + 1)
    x[:nx] = dense.x[:nx] + start * rng.standard_normal(nx)
    for programme in programmes:
        programme.x = x
        for name, value in values.items():
            setattr(programme, name, value)


@pytest.fixture
def off_the_manifold(pair: tuple[Any, Any]) -> tuple[Any, Any]:
    disturb(pair)
    return pair


def same(a: Any, b: Any, tolerance: float = 1e-10) -> bool:
    return bool(np.abs(a - b).max(initial=0.0) <= tolerance * (1e-300 + np.abs(a).max(initial=0.0)))


DIRECTION = ("dx", "dy", "du", "dm", "deta")


def test_evaluations_agree(off_the_manifold: tuple[Any, Any]) -> None:
    dense, structured = (p.evaluate() for p in off_the_manifold)
    for name in ("cost", "residual", "primal", "dual", "violation", "worst"):
        assert getattr(structured, name) == pytest.approx(getattr(dense, name), rel=1e-12)
    assert same(off_the_manifold[0].costates, off_the_manifold[1].costates, 1e-12)


@pytest.mark.parametrize(("shift", "augment"), [(0.0, 0.0), (3.0, 0.0), (0.0, 5.0), (20.0, 100.0)])
def test_newton_directions_agree(off_the_manifold: tuple[Any, Any], shift: float, augment: float) -> None:
    results, directions = [], []
    for programme in off_the_manifold:
        programme.evaluate()
        results.append(programme.factorise(shift, augment))
        directions.append(programme.solve(2))
    dense, structured = off_the_manifold
    assert results[0].ok
    assert results[1].ok
    assert results[1].negative == results[0].negative
    assert 1e-6 < results[1].smallest_pivot <= 1.0
    for name in DIRECTION:
        assert same(getattr(dense, name), getattr(structured, name)), name
    for name in ("increment", "slope", "curvature"):
        assert getattr(directions[1], name) == pytest.approx(getattr(directions[0], name), rel=1e-8)
    assert directions[1].linear_residual < 1e-11


def test_directions_with_other_shifts_agree_without_an_evaluation(off_the_manifold: tuple[Any, Any]) -> None:
    for programme in off_the_manifold:
        programme.evaluate()
    for shift, augment in ((0.0, 1.0), (3.0, 1.0), (20.0, 100.0)):
        for programme in off_the_manifold:
            assert programme.factorise(shift, augment).ok
            programme.solve(2)
        for name in DIRECTION:
            assert same(getattr(off_the_manifold[0], name), getattr(off_the_manifold[1], name)), name
        for programme in off_the_manifold:
            programme.trial(0.5)
            programme.correct(0.5)  # leaves another right-hand side behind


def test_directions_from_a_start_off_the_manifold_agree(pair: tuple[Any, Any]) -> None:
    disturb(pair, seed=3, size=0.05, start=0.05)
    for programme in pair:
        programme.evaluate()
        assert programme.factorise(1.0, 1.0).ok
        assert programme.solve(2).linear_residual < 1e-11
    for name in DIRECTION:
        assert same(getattr(pair[0], name), getattr(pair[1], name)), name


def test_directions_after_gauss_newton_and_indefinite_hessians_agree(
    off_the_manifold: tuple[Any, Any],
) -> None:
    for share, size in ((0.0, 1.0), (1.0, -30.0), (1.0, 30.0)):
        results = []
        for programme in off_the_manifold:
            programme.m = size * np.random.default_rng(5).standard_normal(programme.m.size)
            programme.evaluate(share)
            results.append(programme.factorise())
            assert results[-1].ok
            programme.solve(3)
        assert results[0].negative == results[1].negative
        for name in DIRECTION:
            assert same(getattr(off_the_manifold[0], name), getattr(off_the_manifold[1], name), 1e-8), name


def test_several_inertias_agree() -> None:
    made = Chain().programmes()
    found = set()
    for seed in range(8):
        disturb(made, seed)
        counts = []
        for programme in made:
            programme.m = 10.0 * programme.m * seed
            programme.evaluate()
            counts.append(programme.factorise().negative)
        assert counts[0] == counts[1]
        found.add(counts[0])
    assert len(found) > 1


def test_second_order_corrections_and_accepted_iterates_agree(off_the_manifold: tuple[Any, Any]) -> None:
    trials = []
    for programme in off_the_manifold:
        programme.evaluate()
        programme.factorise(1.0, 1.0)
        programme.solve(2)
        programme.trial(0.5)
        programme.correct(0.5)
        trials.append(programme.trial(1.0))
        programme.accept(0.7)
    dense, structured = off_the_manifold
    for name in (*DIRECTION, "x", "y", "u", "m", "eta"):
        assert same(getattr(dense, name), getattr(structured, name)), name
    assert trials[1].violation == pytest.approx(trials[0].violation, rel=1e-9)
    assert trials[1].objective == pytest.approx(trials[0].objective, rel=1e-9)


@pytest.mark.parametrize("warm", [False, True])
def test_sweeps_agree(pair: tuple[Any, Any], warm: bool) -> None:
    disturb(pair, seed=2, size=0.03)
    for programme in pair:
        assert programme.simulate(1e-12, 30, warm=warm).ok
    for name in ("x", "y"):
        assert same(getattr(pair[0], name), getattr(pair[1], name), 1e-9), name


def test_closed_loops_agree_to_first_order(pair: tuple[Any, Any]) -> None:
    """To first order, gains over some entries of a state answer what the constraints allow like all."""
    disturb(pair, seed=2, size=0.03)
    change = 1e-5 * np.random.default_rng(4).standard_normal(pair[0].u.size)
    deviations = []
    for programme in pair:
        assert programme.simulate(1e-13, 30).ok
        planned, u = programme.x, programme.u
        programme.evaluate()
        assert programme.factorise(1.0, 1.0).ok
        programme.u = u + change
        assert programme.simulate(1e-13, 30, warm=True, feedback=True).ok
        deviations.append((programme.x - planned, programme.u - u))
    for one, other in zip(*deviations, strict=True):
        assert same(one, other, 1e-4)


@pytest.mark.parametrize("auxiliary", [False, True])
def test_adjoints_agree(pair: tuple[Any, Any], auxiliary: bool) -> None:
    disturb(pair, seed=6, size=0.03)
    swept = []
    for programme in pair:
        assert programme.simulate(1e-13, 30).ok
        swept.append(programme.gradient(auxiliary))
    dense, structured = pair
    assert swept[1].residual == pytest.approx(swept[0].residual, rel=1e-9)
    for name in ("m", "costates", "control_gradient", *(("sigma", "A") if auxiliary else ())):
        assert same(getattr(dense, name), getattr(structured, name), 1e-9), name
    assert same(dense.end_sensitivity(), structured.end_sensitivity(), 1e-9)
    for programme in pair:
        programme.evaluate()
    assert same(dense.reduced_hessian(0.5), structured.reduced_hessian(0.5), 1e-9)


def test_adjoint_of_the_closed_loop_is_the_derivative_of_its_sweep() -> None:
    programme = Chain(links=2, steps=5).programmes()[1]
    rng = np.random.default_rng(8)
    programme.u = 0.1 * rng.standard_normal(programme.u.size)
    programme.eta = rng.standard_normal(programme.eta.size)
    assert programme.simulate(1e-13, 30).ok
    programme.evaluate()
    assert programme.factorise(1.0, 1.0).ok
    planned, u = programme.x, programme.u

    def lagrangian(controls: np.ndarray[Any, Any]) -> float:
        programme.x, programme.u = planned, controls
        assert programme.simulate(1e-13, 30, warm=True, feedback=True).ok
        return float(programme.gradient().cost + programme.eta @ programme.end_condition)

    direction, h = rng.standard_normal(u.size), 1e-5
    slope = (lagrangian(u + h * direction) - lagrangian(u - h * direction)) / (2 * h)
    lagrangian(u)
    programme.gradient(feedback=True)
    assert programme.control_gradient @ direction == pytest.approx(slope, rel=1e-7)


def test_memory_is_that_of_sparse_blocks() -> None:
    dense, structured = Chain(links=3).programmes()
    assert structured.num_bytes < 0.25 * dense.num_bytes


def test_dependent_constraints_are_singular() -> None:
    chain = Chain(links=1)
    functions = chain.functions(1)
    native = kernel()
    load = {k: native.StageFunction.of(f) for k, f in functions.items()}
    programme = chain.programme(load, chain.groups, 1)
    x = programme.x.reshape(-1, chain.ndx)
    x[3, 3:12] = 0.0  # without directors there is nothing to keep orthogonal
    programme.x = x.ravel()
    programme.evaluate()
    result = programme.factorise()
    assert not result.ok
    assert result.bad_stage == 2
    with pytest.raises(RuntimeError, match="factorisation failed"):
        programme.solve()


WRONG_GROUPS = {
    "constraint 10 has to be in one": [(0, 10, list(range(12)))],
    "constraint 3 has to be in one": [(0, 11, list(range(12))), (3, 1, [])],
    "rows beyond the 11 constraints": [(0, 12, list(range(12)))],
    "there is no column 12": [(0, 11, list(range(1, 13)))],
    "more rows than columns": [(0, 11, list(range(10)))],
}


@pytest.mark.parametrize("message", WRONG_GROUPS)
def test_wrong_groups_are_refused(message: str) -> None:
    chain = Chain(links=1)
    native = kernel()
    load = {k: native.StageFunction.of(f) for k, f in chain.functions(1).items()}
    with pytest.raises(ValueError, match=message):
        chain.programme(load, WRONG_GROUPS[message], 1)


def test_costs_of_the_impulses_are_refused() -> None:
    with pytest.raises(ValueError, match="the Hessian couples algebraic unknowns with more than q"):
        Chain(links=1, costly_impulses=True).programmes()


def test_order_of_the_groups_does_not_matter() -> None:
    chain = Chain(links=3)
    native = kernel()
    load = {k: native.StageFunction.of(f) for k, f in chain.functions(2).items()}
    made = (chain.programme(load, chain.groups, 2), chain.programme(load, chain.groups[::-1], 2))
    disturb(made)
    for programme in made:
        programme.evaluate()
        assert programme.factorise().ok
        programme.solve(2)
    for name in DIRECTION:
        assert same(getattr(made[0], name), getattr(made[1], name)), name
