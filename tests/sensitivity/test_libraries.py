"""Optima as functions in JAX and PyTorch, by these libraries' own checks of derivatives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.autodiff.solution_map import SolutionMap
from mbocp.exceptions import DimensionMismatch

EXAMPLES = Path(__file__).parents[2] / "examples"
WORDS = ["start.q", "horizon.duration", "cost.effort"]


@pytest.fixture(scope="module")
def problem():
    """An arm within limits."""
    return mbocp.load_problem(EXAMPLES / "arms/ur5_limits.toml").with_(steps=16, solver={"tolerance": 1e-12})


@pytest.mark.parametrize(
    ("example", "words", "steps"),
    [
        ("free_flyer/drone_flip.toml", ["start.q", "goal.q", "horizon.duration"], 24),
        ("arms/payload.toml", ["robot.payload.crate.mass", "robot.payload.crate.com", "goal.q"], 12),
        ("arms/ur5_limits.toml", ["limits.velocity.upper", "start.v"], 16),
        ("arms/ur5_fastest.toml", ["goal.frame.tool0.position", "goal.frame.tool0.orientation"], None),
    ],
)
def test_products_agree_with_differences_of_values(example, words, steps):
    """In plain numbers, of quaternions, too, which values off the unit sphere stand for."""
    read = mbocp.load_problem(EXAMPLES / example).with_(solver={"tolerance": 1e-12})
    found = SolutionMap.of(read.with_(steps=steps) if steps else read, words)
    rng = np.random.default_rng(0)
    moves = [rng.normal(size=value.shape) for value in found.values]
    bars = {name: rng.normal(size=shape) for name, shape in found.shapes.items()}
    if "fastest" in example:  # of the rest a barrier leaves too much for differences to be so good
        bars = {name: bar * (name in ("cost", "t")) for name, bar in bars.items()}
    h = 1e-4

    def along(size):
        out = found([value + size * move for value, move in zip(found.values, moves, strict=True)])
        return sum(np.sum(bars[name] * value) for name, value in out.items())

    expected = (8 * (along(h) - along(-h)) - (along(2 * h) - along(-2 * h))) / (12 * h)
    pushed = sum(np.sum(bars[n] * value) for n, value in found.push(found.values, moves).items())
    pulled = sum(np.sum(m * g) for m, g in zip(moves, found.pull(found.values, bars), strict=True))
    assert pushed == pytest.approx(expected, rel=1e-5)
    assert pulled == pytest.approx(pushed, rel=1e-7)


def test_neighbours_have_the_steps_that_an_accuracy_has_found():
    found = SolutionMap.of(mbocp.load_problem(EXAMPLES / "arms/accurate_lift.toml"), ["start.v"])
    (value,) = found.values
    out = found([value + 1e-3])
    assert {name: np.shape(given) for name, given in out.items()} == found.shapes


def test_what_a_limit_holds_stays(problem):
    """Of a right-hand side that limits bear alone, nothing is left but round-off."""
    found = SolutionMap.of(problem, WORDS)
    room = problem.limits.v_upper - found.first.vs
    node, joint = np.unravel_index(room.argmin(), room.shape)
    bars = {name: np.zeros(shape) for name, shape in found.shapes.items()}
    bars["vs"][node, joint] = 1.0
    for gradient in found.pull(found.values, bars):
        assert np.abs(gradient).max() < 1e-12


def test_at_the_problems_own_numbers_nothing_is_solved_again(problem, monkeypatch):
    found = SolutionMap.of(problem, WORDS)
    monkeypatch.setattr("mbocp.autodiff.solution_map.solve", None)
    assert np.array_equal(found(found.values)["us"], found.first.us)


def test_jax_has_derivatives_in_both_directions_and_batches(problem):
    jax = pytest.importorskip("jax")
    from jax.test_util import check_grads

    from mbocp.autodiff.jax import solve

    with jax.enable_x64(True):
        found = solve(problem, WORDS)
        given = [jax.numpy.array(v) for v in (problem.q_start, problem.duration, problem.cost.effort)]

        def loss(*values):
            out = found(*values)
            return 1e-3 * ((out["us"] ** 2).sum() + out["cost"]) + out["vs"][3].sum() + out["t"][4]

        check_grads(loss, given, order=1, modes=["fwd", "rev"], eps=1e-5, rtol=1e-5)
        starts = given[0] + 0.01 * jax.numpy.arange(2.0)[:, None]
        batch = jax.jit(jax.vmap(jax.grad(loss), in_axes=(0, None, None)))(starts, *given[1:])
        assert np.allclose(batch, [jax.grad(loss)(start, *given[1:]) for start in starts], rtol=1e-9)
        assert found(starts, *given[1:])["us"].shape == (2, 16, 6)
        with pytest.raises(DimensionMismatch, match=r"start\.q"):
            found(given[0][:3], *given[1:])
        with pytest.raises(NotImplementedError, match="first derivatives"):
            jax.hessian(loss)(*given)


@pytest.mark.filterwarnings("ignore:.*torch.jit.script:FutureWarning")  # PyTorch's own
def test_torch_has_derivatives_in_both_directions_and_batches(problem):
    torch = pytest.importorskip("torch")
    from mbocp.autodiff.torch import solve

    found = solve(problem, WORDS)
    values = (problem.q_start, problem.duration, problem.cost.effort)
    given = [torch.tensor(np.array(v), dtype=torch.float64, requires_grad=True) for v in values]

    def some(*values):
        out = found(*values)
        return torch.cat([out["us"][3], out["vs"][5], out["t"][4:5], 1e-3 * out["cost"][None]])

    assert torch.autograd.gradcheck(some, given, eps=1e-5, rtol=1e-5, atol=1e-6, check_forward_ad=True)
    starts = torch.tensor(problem.q_start + 0.01 * np.arange(2)[:, None], requires_grad=True)
    rest = [value.detach() for value in given[1:]]

    def size(start):
        return (found(start, *rest)["us"] ** 2).sum()

    size(starts).backward()
    assert torch.allclose(torch.func.vmap(torch.func.grad(size))(starts.detach()), starts.grad, rtol=1e-9)
    with pytest.raises(DimensionMismatch, match=r"start\.q"):
        found(given[0][:3], *rest)


def test_a_row_without_an_optimum_is_told_and_is_nan(problem):
    from mbocp.autodiff.solution_map import Batches, UnsolvedWarning

    batches = Batches(SolutionMap.of(problem, ["limits.velocity.upper"]))
    (own,) = batches.of_one.values
    with pytest.warns(UnsolvedWarning, match="row 1 of the batch is NaN"):
        rows = batches.solve(np.array([own, np.full_like(own, -10.0)]))
    assert np.isfinite(rows[0]).all()
    assert np.isnan(rows[1]).all()
