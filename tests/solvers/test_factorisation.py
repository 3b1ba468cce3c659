"""The structured factorisation against dense linear algebra on the same KKT matrix."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from mbocp.programme.native_modules import kernel


def random_programme(seed: int, num_stages: int, ndx: int, ny: int, nu: int, ng: int):
    """Stages with random quadratic constraints and costs, of one kind, each with its own parameter."""
    rng = np.random.default_rng(seed)
    nz, nc = 2 * ndx + ny + nu, ndx + ny
    x0, x1, y, u, m = (
        ca.SX.sym(n, k) for n, k in (("x0", ndx), ("x1", ndx), ("y", ny), ("u", nu), ("m", nc))
    )
    theta, rho = ca.SX.sym("theta", 1), ca.SX.sym("rho", 1)
    z = ca.vertcat(x1, y, x0, u)
    linear = rng.standard_normal((nc, nz))
    linear[:, : ndx + ny] += 3.0 * np.eye(nc)
    curvature = [0.1 * rng.standard_normal((nz, nz)) for _ in range(nc)]
    weight = rng.standard_normal((nz, nz))
    metric = 0.3 * weight @ weight.T + np.eye(nz)
    products = ca.vertcat(*[ca.bilin(ca.DM(C), z, z) for C in curvature])
    rows = ca.DM(linear) @ z + products - theta * rho
    cost = ca.bilin(ca.DM(metric), z, z) / 2 + rho * ca.sum1(z)
    hessian, _ = ca.hessian(cost + ca.dot(m, rows), z)
    args = [x0, x1, y, u]
    jacobian = ca.jacobian(rows, z)
    functions = {
        "values": ca.Function("values", [*args, theta, rho], [rows, cost]),
        "jacobian": ca.Function(
            "jacobian", [*args, theta, rho], [rows, cost, jacobian, ca.jacobian(cost, z)]
        ),
        "complete": ca.Function(
            "complete", [*args, m, theta, rho], [rows, cost, jacobian, ca.jacobian(cost, z), ca.triu(hessian)]
        ),
    }
    x, eta, empty = ca.SX.sym("x", ndx), ca.SX.sym("eta", ng), ca.SX.sym("rho_T", 0)
    D = rng.standard_normal((ng, ndx))
    g = ca.DM(D) @ x + 0.1 * ca.sumsqr(x) - 0.5 if ng else ca.SX.zeros(0, 1)
    psi = ca.sumsqr(x) / 2
    terminal_hessian, _ = ca.hessian(psi + ca.dot(eta, g), x)
    functions["terminal_values"] = ca.Function("tv", [x, empty], [psi, ca.densify(g)])
    functions["terminal_complete"] = ca.Function(
        "tc",
        [x, eta, empty],
        [psi, ca.densify(g), ca.jacobian(g, x), ca.jacobian(psi, x), ca.triu(terminal_hessian)],
    )
    dx = ca.SX.sym("dx", ndx)
    functions["retract"] = ca.Function("retract", [x, dx], [x + dx])
    functions["difference"] = ca.Function("difference", [x, dx], [dx - x])
    native = kernel()
    load = {name: native.StageFunction.of(f) for name, f in functions.items()}
    ones = np.ones
    kind = native.Kind(
        nx=ndx, ndx=ndx, ny=ny, nu=nu, nr=1, values=load["values"], jacobian=load["jacobian"],
        complete=load["complete"], scale_c=ones(nc), scale_y=ones(ny), scale_m=ones(nc), scale_ru=ones(nu),
    )  # fmt: skip
    terminal = native.Terminal(ng=ng, values=load["terminal_values"], complete=load["terminal_complete"])
    programme = native.Programme(num_stages, kind, terminal, load["retract"], load["difference"])
    programme.set_parameters(np.array([0.7]), rng.standard_normal(num_stages), np.zeros(0))
    for name in ("x", "y", "u", "m", "eta"):
        setattr(programme, name, 0.3 * rng.standard_normal(getattr(programme, name).size))
    return programme, functions


def dense_kkt(programme, functions, num_stages: int, ndx: int, ny: int, nu: int, ng: int):
    """KKT matrix and residual in the order (x_1..x_N, y, u | m, eta), stage by stage from CasADi."""
    nc, nx_total = ndx + ny, num_stages * ndx
    n_primal = nx_total + num_stages * (ny + nu)
    size = n_primal + num_stages * nc + ng
    K, r = np.zeros((size, size)), np.zeros(size)
    xs, ys = programme.x.reshape(-1, ndx), programme.y.reshape(num_stages, ny)
    us, ms = programme.u.reshape(num_stages, nu), programme.m.reshape(num_stages, nc)
    rhos = programme_rhos(programme)
    for n in range(num_stages):
        out = functions["complete"](xs[n], xs[n + 1], ys[n], us[n], ms[n], 0.7, rhos[n])
        c, _, J, g, H = [np.asarray(ca.DM(o)) for o in out]
        H = np.triu(H) + np.triu(H, 1).T
        x_next = list(range(n * ndx, (n + 1) * ndx))
        y_at = list(range(nx_total + n * ny, nx_total + (n + 1) * ny))
        x_before = list(range((n - 1) * ndx, n * ndx)) if n else [-1] * ndx
        u_at = list(range(nx_total + num_stages * ny + n * nu, nx_total + num_stages * ny + (n + 1) * nu))
        where = np.array(x_next + y_at + x_before + u_at)
        kept = where >= 0
        rows = n_primal + n * nc + np.arange(nc)
        K[np.ix_(where[kept], where[kept])] += H[np.ix_(kept, kept)]
        K[np.ix_(rows, where[kept])] += J[:, kept]
        r[where[kept]] += (g.ravel() + J.T @ ms[n])[kept]
        r[rows] += c.ravel()
    out = functions["terminal_complete"](xs[-1], programme.eta, np.zeros(0))
    _, g, D, psi_x, H = [np.asarray(ca.DM(o)) for o in out]
    last = np.arange((num_stages - 1) * ndx, num_stages * ndx)
    rows = n_primal + num_stages * nc + np.arange(ng)
    K[np.ix_(last, last)] += np.triu(H) + np.triu(H, 1).T
    K[np.ix_(rows, last)] += D
    r[last] += psi_x.ravel() + D.T @ programme.eta
    r[rows] += g.ravel()
    K[:n_primal, n_primal:] = K[n_primal:, :n_primal].T
    return K, r, n_primal


def programme_rhos(programme):
    return programme.test_rhos


class Held:
    """A kernel programme with the parameters that it was given."""

    def __init__(self, seed, *sizes):
        self.programme, self.functions = random_programme(seed, *sizes)
        rng = np.random.default_rng(seed + 1000)
        self.test_rhos = rng.standard_normal(sizes[0])
        self.programme.set_parameters(np.array([0.7]), self.test_rhos, np.zeros(0))

    def __getattr__(self, name):
        return getattr(self.programme, name)


SIZES = [(1, 2, 0, 1, 0), (1, 3, 1, 2, 1), (6, 4, 0, 2, 3), (5, 3, 2, 1, 0), (8, 6, 1, 3, 4), (3, 5, 3, 5, 5)]


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize(("shift", "augment"), [(0.0, 0.0), (2.5, 10.0)])
def test_newton_direction_equals_the_dense_one(sizes: tuple[int, ...], shift: float, augment: float) -> None:
    """Rows of other forms, indefinite and crossed Hessians: mbocp/_native/tests/riccati.cpp."""
    held = Held(11, *sizes)
    evaluation = held.evaluate()
    K, r, n_primal = dense_kkt(held, held.functions, *sizes)
    assert evaluation.residual == pytest.approx(np.linalg.norm(r), rel=1e-12)
    states = np.arange(sizes[0] * sizes[1])
    K[states, states] += shift
    factorisation = held.factorise(shift, augment)
    assert factorisation.ok
    excess = (np.linalg.eigvalsh(K) < 0).sum() - (K.shape[0] - n_primal)
    assert factorisation.negative - sizes[-1] == excess
    direction = held.solve()
    expected = -np.linalg.solve(K, r)
    ndx = sizes[1]
    got = np.concatenate([held.dx[ndx:], held.dy, held.du, held.dm, held.deta])
    assert np.allclose(got, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert direction.increment == pytest.approx(np.linalg.norm(expected), rel=1e-9)
    assert direction.linear_residual < 1e-11


def test_gauss_newton_share_drops_the_constraints_curvature() -> None:
    held = Held(5, 4, 3, 1, 2, 2)
    held.evaluate(0.0)
    held.factorise()
    held.solve()
    without = held.dx
    m, eta = held.m, held.eta
    held.evaluate(1.0)
    held.factorise()
    held.solve()
    assert not np.allclose(without, held.dx, rtol=1e-6)
    assert np.array_equal(m, held.m)
    assert np.array_equal(eta, held.eta)


def test_dependent_end_conditions_are_called_singular() -> None:
    """Two equal rows: no augmentation may hide that."""
    _, functions = random_programme(2, 4, 3, 0, 2, 1)
    x, eta, empty = ca.SX.sym("x", 3), ca.SX.sym("eta", 2), ca.SX.sym("r", 0)
    g = ca.vertcat(x[0] - 1, x[0] - 1)
    psi = ca.SX(0)
    H, _ = ca.hessian(ca.dot(eta, g), x)
    native = kernel()
    of = native.StageFunction.of
    terminal = native.Terminal(
        ng=2,
        values=of(ca.Function("tv", [x, empty], [psi, g])),
        complete=of(
            ca.Function("tc", [x, eta, empty], [psi, g, ca.jacobian(g, x), ca.jacobian(psi, x), ca.triu(H)])
        ),
    )
    kind = native.Kind(
        nx=3, ndx=3, ny=0, nu=2, nr=1, values=of(functions["values"]),
        jacobian=of(functions["jacobian"]), complete=of(functions["complete"]),
        scale_c=np.ones(3), scale_y=np.ones(0), scale_m=np.ones(3), scale_ru=np.ones(2),
    )  # fmt: skip
    moves = [of(functions[name]) for name in ("retract", "difference")]
    programme = native.Programme(4, kind, terminal, *moves)
    programme.set_parameters(np.array([0.7]), np.zeros(4), np.zeros(0))
    programme.evaluate()
    for augment in (0.0, 10.0):
        result = programme.factorise(0.0, augment)
        assert not result.ok
        assert result.bad_stage == 4
    with pytest.raises(RuntimeError, match="factorisation failed"):
        programme.solve()


def test_wrong_lengths_are_refused() -> None:
    programme, _ = random_programme(1, 3, 2, 0, 1, 0)
    with pytest.raises(ValueError, match=r"x: got 3 numbers, expected 8"):
        programme.x = np.zeros(3)
    with pytest.raises(TypeError):
        programme.u = np.zeros((3, 1))
    with pytest.raises(ValueError, match="stage parameters"):
        programme.set_parameters(np.zeros(1), np.zeros(7), np.zeros(0))
