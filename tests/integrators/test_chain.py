"""Derivatives joined link by link against CasADi's own of the whole graph."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest

from mbocp._arrays import Array
from mbocp.formulation.features.control_values import ControlValues
from mbocp.formulation.features.memory import Memory
from mbocp.formulation.parameter_layout import parameter_layout, pieces
from mbocp.formulation.schemes.explicit_steps import ExplicitSteps
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.stage import build_functions, state_space
from mbocp.integrators import TABLEAUX
from mbocp.integrators.chain import Affine, Chain
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.terms.kinds import ControlRate, Effort, ExactGoal, Potential, Tracking, Velocity
from mbocp.terms.point import Sizes
from tests.integrators.explicit import mechanics_of, robot_named, start_of

# --- small chains -----------------------------------------------------------------------------------------


def link(name: str, sizes: tuple[int, ...], body: Callable[..., list[ca.SX]]) -> ca.Function:
    symbols = [ca.SX.sym(f"a{i}", size) for i, size in enumerate(sizes)]
    return ca.Function(name, symbols, [ca.densify(o) for o in body(*symbols)])


def test_an_expression_scales_an_affine_vector_without_rows() -> None:
    """CasADi must not take it for a sequence: Python 3.13 tells of the row that is not there."""
    product = ca.SX.sym("h") * Chain(ca.SX.zeros(0)).root()
    assert isinstance(product, Affine)
    assert product.value.shape == (0, 1)


def test_affine_vectors_add_scale_join_and_split() -> None:
    x = ca.SX.sym("x", 4)
    chain = Chain(x)
    root = chain.root()
    first, second = root.split(2, 2)
    sum_of_halves = 2.0 * first + second - 0.5 * first
    joined = Affine.join([sum_of_halves, root.take(slice(1, 3)) + 7.0])
    function = ca.Function("f", [x], [joined.value, chain.jacobian(joined)])
    value, slope = (np.asarray(o) for o in function([1.0, 2.0, 3.0, 4.0]))
    assert np.array_equal(value.ravel(), [1.5 + 3, 3.0 + 4, 9, 10])
    assert np.array_equal(slope, [[1.5, 0, 1, 0], [0, 1.5, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0]])


def test_links_that_feed_several_others() -> None:
    """Each output is used twice, once beside the unknowns; parameters are not differentiated."""
    f = link("f", (2, 1, 1), lambda a, b, p: [ca.sin(a) * p, a[0] * a[1] * b])
    g = link("g", (2, 2), lambda a, b: [ca.vertcat(ca.exp(0.1 * a[0]) * b[1], a[1] ** 3 + b[0])])
    x, p, m = ca.SX.sym("x", 3), ca.SX.sym("p"), ca.SX.sym("m", 2)
    chain = Chain(x)
    root = chain.root()
    first, second = chain.apply(f, [root.take(slice(2)), root.take(slice(2, None))], [p])
    (third,) = chain.apply(g, [first + root.take(slice(1, None)), 3.0 * root.take(slice(2))])
    (fourth,) = chain.apply(f, [third, 2.0 * second], [p * p])[:1]
    result = fourth + third - first
    inlined = direct(f, g, x, p)
    values = [result.value, chain.jacobian(result), chain.hessian(result, m)]
    wanted = [inlined, ca.jacobian(inlined, x), ca.hessian(ca.dot(m, inlined), x)[0]]
    function = ca.Function("f", [x, p, m], [ca.densify(v) for v in (*values, *wanted)])
    rng = np.random.default_rng(0)
    for _ in range(5):
        out = [np.asarray(o) for o in function(*(rng.standard_normal(k) for k in (3, 1, 2)))]
        for got, want in zip(out[:3], out[3:], strict=True):
            assert np.allclose(got, want, rtol=1e-12, atol=1e-12)


def direct(f: ca.Function, g: ca.Function, x: ca.SX, p: ca.SX) -> ca.SX:
    first, second = f(x[:2], x[2], p)
    third = g(first + x[1:], 3 * x[:2])
    return f(third, 2 * second, p * p)[0] + third - first


def large(count: int) -> ca.Function:
    """A link of so many operations."""

    def body(a: ca.SX, p: ca.SX) -> list[ca.SX]:
        value = ca.vertcat(a[0] * p, a[1] + a[0], ca.sin(a[1]))
        for k in range(count):
            value = ca.vertcat(
                ca.sin(value[1]) + 0.1 * k, value[2] * value[0], ca.cos(value[0]) - 0.2 * value[1]
            )
        return [value[:2], value[2]]

    return link("large", (2, 1), body)


@pytest.mark.parametrize("feeds_itself", [False, True])
def test_large_links_are_called_where_one_call_gives_all(feeds_itself: bool) -> None:
    """Numbers are those of links that are written out; slopes alone are always called, values never."""
    f = large(40)
    x, p, m = ca.SX.sym("x", 4), ca.SX.sym("p"), ca.SX.sym("m", 3)
    written: list[list[ca.SX]] = []
    for may_call in (False, True):
        chain = Chain(x, may_call=may_call)
        root = chain.root()
        first = Affine.join(chain.apply(f, [root.take(slice(2))], [p]))
        of_second = (
            root.take(slice(2, None)) + first.take(slice(2)) if feeds_itself else root.take(slice(2, None))
        )
        second = Affine.join(chain.apply(f, [of_second], [p * p]))
        result = first - 2.0 * second
        parts = [result.value, chain.jacobian(result), chain.hessian(result, m)]
        written += [chain.resolve(parts[:n]) for n in (1, 2, 3)]
    made = [ca.Function("f", [x, p, m], ca.cse([ca.densify(v) for v in parts])) for parts in written]
    calls = [bool(function.find_functions()) for function in made]
    assert calls == [False, False, False, False, True, not feeds_itself]
    assert made[4].n_instructions() < made[1].n_instructions() / 3
    rng = np.random.default_rng(0)
    for _ in range(3):
        given = [rng.standard_normal(k) for k in (4, 1, 3)]
        for one, other in zip(made[:3], made[3:], strict=True):
            for got, want in zip(other.call(given), one.call(given), strict=True):
                assert np.allclose(got.full(), want.full(), rtol=1e-12, atol=1e-12)


# --- steps of a Runge-Kutta method ------------------------------------------------------------------------


def direct_step(
    mechanics: ForwardMechanics,
    scheme: str,
    lie: str,
    substeps: int,
    z: ca.SX,
    s: ca.SX,
    u: ca.SX,
    dt: ca.SX,
    gains: ca.SX,
) -> tuple[ca.SX, ca.SX]:
    """The step written down as it stands in the second paper (corrected), as one graph."""
    tableau, space, h = TABLEAUX[scheme], mechanics.space, dt / substeps
    for _ in range(substeps):
        kz: list[ca.SX] = []
        ks: list[ca.SX] = []
        for row in tableau.a:
            s_i = s + h * sum((float(a) * k for a, k in zip(row, ks, strict=True)), ca.SX(s.numel(), 1))
            if lie == "munthe_kaas":
                w = h * sum((float(a) * k for a, k in zip(row, kz, strict=True)), ca.SX(mechanics.nv, 1))
                z_i = space.integrate(z, w)
                v = mechanics.velocity(z_i, s_i, u)
                kz.append(v + space.bracket(w, v) / 2 + space.bracket(w, space.bracket(w, v)) / 12)
            else:
                z_i = z + h * sum((float(a) * k for a, k in zip(row, kz, strict=True)), ca.SX(z.numel(), 1))
                rate = space.rate(z_i, mechanics.velocity(z_i, s_i, u))
                if lie == "baumgarte":
                    rate += space.attraction(z_i, gains[0], gains[1])
                kz.append(rate)
            at, sp, co, ga = (ca.SX.sym(n, k) for n, k in zip("zsug", sizes(mechanics), strict=True))
            speed_rate = ca.Function("r", [at, sp, co, ga], [mechanics.speed_rate(at, sp, co, ga)])
            ks.append(speed_rate(z_i, s_i, u, gains[2]))
        moved = h * sum((float(b) * k for b, k in zip(tableau.b, kz, strict=True)), ca.SX(kz[0].numel(), 1))
        z = space.integrate(z, moved) if lie == "munthe_kaas" else z + moved
        s = s + h * sum((float(b) * k for b, k in zip(tableau.b, ks, strict=True)), ca.SX(s.numel(), 1))
    return z, s


def sizes(mechanics: ForwardMechanics) -> tuple[int, int, int, int]:
    return mechanics.nq, mechanics.ns, mechanics.nu, 1


STEPS = [
    # robot, rotations, scheme, lie, substeps, flat
    ("heavy top", "quaternion", "rk4", "munthe_kaas", 1, False),
    ("heavy top", "quaternion", "rk4", "munthe_kaas", 2, True),
    ("heavy top", "quaternion", "rk4", "plain", 2, True),
    ("heavy top", "quaternion", "rkf5", "baumgarte", 1, True),
    ("heavy top", "dcm", "rk4", "munthe_kaas", 1, True),
    pytest.param("heavy top", "dcm", "rkf5", "munthe_kaas", 1, False, marks=pytest.mark.slow),
    pytest.param("heavy top", "dcm", "heun", "baumgarte", 3, True, marks=pytest.mark.slow),
    ("heavy top", "dcm", "rkf5", "plain", 1, True),
    ("spherical pendulum", "quaternion", "rk4", "munthe_kaas", 2, True),
    ("hector", "quaternion", "rk4", "munthe_kaas", 1, False),
    pytest.param("hector", "dcm", "rkf5", "munthe_kaas", 2, True, marks=pytest.mark.slow),
    pytest.param("hector", "dcm", "rk4", "baumgarte", 1, True, marks=pytest.mark.slow),
    pytest.param("towed body", "quaternion", "rk4", "munthe_kaas", 1, False, marks=pytest.mark.slow),
    pytest.param("several groups", "dcm", "heun", "munthe_kaas", 1, False, marks=pytest.mark.slow),
]


@cache
def signature_of(
    name: str, rotations: str, scheme: str, lie: str, substeps: int, is_flat: bool
) -> FunctionSignature:
    robot = robot_named(name)
    cost = (Effort(), Tracking(q=True, p=False), Velocity(), Potential())
    return FunctionSignature(
        robot=robot.fingerprint,
        steps=ExplicitSteps(scheme, rotations, lie, substeps),
        goal=ExactGoal("v", 0, 0),
        cost=cost + ((ControlRate(),) if robot.nu else ()),
        is_flat=is_flat or robot.is_vector_space,
        features=(ControlValues(), *((Memory(("control",)),) if robot.nu else ())),
    )


@pytest.mark.parametrize(("name", "rotations", "scheme", "lie", "substeps", "is_flat"), STEPS)
def test_stage_derivatives_are_those_of_the_whole_graph(
    name: str, rotations: str, scheme: str, lie: str, substeps: int, is_flat: bool
) -> None:
    robot, mechanics = robot_named(name), mechanics_of(name, rotations)
    signature = signature_of(name, rotations, scheme, lie, substeps, is_flat)
    functions = build_functions(mechanics, signature)
    space = state_space(mechanics, signature)
    at, layout = space.layout, parameter_layout(signature, Sizes.of(mechanics))
    d0, d1 = ca.SX.sym("d0", at.ndx), ca.SX.sym("d1", at.ndx)
    x0, x1, u = ca.SX.sym("x0", at.nx), ca.SX.sym("x1", at.nx), ca.SX.sym("u", robot.nu)
    theta, m = ca.SX.sym("theta", sum(layout.theta.values())), ca.SX.sym("m", at.ndx)
    from_x, to_x = space.retract(x0, d0), space.retract(x1, d1)
    given = pieces(theta, layout.theta)
    controls, gains = given["force"] * u, given["gains"]
    z, s = direct_step(
        mechanics, scheme, lie, substeps, from_x[at.z], from_x[at.s], controls, given["dt"], gains
    )
    reached = ca.vertcat(z, s, u if at.nr else ca.SX(0, 1))
    c = space.difference(to_x, reached)
    unknowns = ca.vertcat(d1, d0, u)
    curvature, _ = ca.hessian(ca.dot(m, c), unknowns)
    wanted = ca.Function("wanted", [x0, x1, d0, d1, u, m, theta], [c, ca.jacobian(c, unknowns), curvature])
    for numbers in samples(name, mechanics, at.nr, sum(layout.theta.values()), sum(layout.stage.values())):
        a, b, controls, weights, horizon, stage = numbers
        zero = np.zeros(at.ndx)
        c_, J, H = (np.asarray(o) for o in wanted(a, b, zero, zero, controls, weights[: at.ndx], horizon))
        # The cost's own curvature comes with the stage's: its difference from no multipliers is the rows'.
        out = functions["complete"](a, b, [], controls, weights[: at.ndx], horizon, stage)
        none = functions["complete"](a, b, [], controls, zero, horizon, stage)
        got_H = np.asarray(ca.DM(out[4])) - np.asarray(ca.DM(none[4]))
        assert np.allclose(np.asarray(out[0]).ravel(), c_.ravel(), rtol=0, atol=1e-12)
        assert np.allclose(np.asarray(ca.DM(out[2])), J, rtol=0, atol=1e-10 * (1 + np.abs(J).max()))
        assert np.allclose(got_H, np.triu(H), rtol=0, atol=1e-10 * (1 + np.abs(H).max()))
        values = functions["values"](a, b, [], controls, horizon, stage)
        assert np.allclose(np.asarray(values[0]), np.asarray(out[0]), rtol=0, atol=1e-14)


def samples(
    name: str, mechanics: ForwardMechanics, nr: int, size_theta: int, size_rho: int
) -> list[tuple[Array, ...]]:
    """States at both ends of a step that need not fit, control, multipliers, parameters."""
    robot = robot_named(name)
    found = []
    for seed in (3, 5):
        rng = np.random.default_rng(seed)
        q, v, u = start_of(robot, seed)
        ends = []
        for move in (np.zeros(robot.nv), 0.1 * rng.standard_normal(robot.nv)):
            z = mechanics.space.coordinates(robot.integrate(q, move)[None])[0]
            ends.append(np.concatenate([z, v + move, 0.1 * rng.standard_normal(nr)]))
        theta = rng.uniform(0.1, 0.3, size_theta)
        rho = rng.uniform(0.1, 0.5, size_rho)
        found.append((*ends, 0.02 * u, rng.standard_normal(ends[0].size), theta, rho))
    return found
