"""Functions of rotation matrices against the same functions of quaternions."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import UnsupportedRobot
from mbocp.lie import ConfigurationSpace
from mbocp.symbolic import model_functions
from mbocp.symbolic.matrices import call_with_matrices

CHAINS = {
    "free flyer": "FreeFlyer",
    "ball joint": "Spherical",
    "free flyer and arm": "FreeFlyer RX PY RUBZ",
    "two ball joints": "Spherical RZ Spherical",
    "free flyer and ball joint": "FreeFlyer Planar Spherical",
}


def model_of(kinds: str) -> pin.Model:
    rng = np.random.default_rng(1)
    model, parent = pin.Model(), 0
    for i, kind in enumerate(kinds.split()):
        placement = pin.SE3(pin.exp3(rng.standard_normal(3)), rng.standard_normal(3))
        parent = model.addJoint(parent, getattr(pin, f"JointModel{kind}")(), placement, f"{i}_{kind}")
        moments = np.diag(rng.uniform(1.0, 2.0, 3))
        model.appendBodyToJoint(parent, pin.Inertia(1.3, rng.standard_normal(3), moments), placement)
    model.addFrame(pin.Frame("tip", parent, 0, placement, pin.FrameType.OP_FRAME))
    return model


class Pair:
    """Functions of a model with quaternions and with matrices, evaluated at the same states."""

    def __init__(self, kinds: str) -> None:
        self.model = model_of(kinds)
        self.functions = model_functions(self.model)
        self.space = ConfigurationSpace(self.model, "dcm")

    def with_matrices(self, function: ca.Function) -> ca.Function:
        """The function of (z, *others)."""
        z = ca.SX.sym("z", self.space.nz)
        others = [ca.SX.sym(f"a{i}", function.sparsity_in(i)) for i in range(1, function.n_in())]
        q = ca.SX.zeros(self.model.nq)
        matrices = []
        for part in self.space.parts:
            count = part.at_q.stop - part.at_q.start
            if part.at_matrix >= 0:
                matrix = ca.reshape(z[part.at_matrix : part.at_matrix + 9], 3, 3)
                matrices.append((part.at_q.stop - 4, matrix))
                count -= 4
            if count:
                q[part.at_q.start : part.at_q.start + count] = z[part.at_z.start : part.at_z.start + count]
        return ca.Function("f", [z, *others], call_with_matrices(function, q, matrices, others))

    def states(self, function: ca.Function) -> list[tuple[Array, Array, list[Array]]]:
        rng = np.random.default_rng(2)
        found = []
        for _ in range(3):
            q = pin.integrate(self.model, pin.neutral(self.model), rng.uniform(-3, 3, self.model.nv))
            others = [rng.standard_normal(function.numel_in(i)) for i in range(1, function.n_in())]
            found.append((q, self.space.coordinates(q[None])[0], others))
        return found


@pytest.fixture(scope="module", params=CHAINS)
def pair(request: pytest.FixtureRequest) -> Pair:
    return Pair(CHAINS[request.param])


def function_named(pair: Pair, name: str) -> ca.Function:
    tip = pair.model.getFrameId("tip")
    if name == "frame_placement":
        return pair.functions.frame_placement(tip)
    if name.startswith("frame_jacobian"):
        return pair.functions.frame_jacobian(tip, name.removeprefix("frame_jacobian "))
    return getattr(pair.functions, name)


NAMES = (
    "rnea",
    "aba",
    "crba",
    "minverse",
    "potential_energy",
    "frame_placement",
    "frame_jacobian local",
    "frame_jacobian local_world_aligned",
)


@pytest.mark.parametrize("name", NAMES)
def test_matrices_and_quaternions_agree(pair: Pair, name: str) -> None:
    function = function_named(pair, name)
    of_matrices = pair.with_matrices(function)
    for q, z, others in pair.states(function):
        wanted = function.call([q, *others])
        got = of_matrices.call([z, *others])
        for g, w in zip(got, wanted, strict=True):
            scale = 1.0 + np.abs(np.asarray(w)).max()
            assert np.allclose(np.asarray(g), np.asarray(w), rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("name", ["rnea", "aba", "potential_energy"])
def test_derivatives_along_the_group_agree(pair: Pair, name: str) -> None:
    """So the dependence on the matrix is right wherever the group leads."""
    function = function_named(pair, name)
    of_matrices = pair.with_matrices(function)
    spaces = (ConfigurationSpace(pair.model), pair.space)
    v = ca.SX.sym("v", pair.model.nv)
    jacobians = []
    for space, f in zip(spaces, (function, of_matrices), strict=True):
        at = ca.SX.sym("at", space.nz)
        others = [ca.SX.sym(f"a{i}", f.sparsity_in(i)) for i in range(1, f.n_in())]
        slope = ca.jacobian(ca.vec(f.call([space.integrate(at, v), *others])[0]), v)
        jacobians.append(ca.Function("j", [at, v, *others], [ca.densify(slope)]))
    zero = np.zeros(pair.model.nv)
    for q, z, others in pair.states(function):
        wanted = np.asarray(jacobians[0](q, zero, *others))
        got = np.asarray(jacobians[1](z, zero, *others))
        assert np.allclose(got, wanted, rtol=0, atol=1e-11 * (1.0 + np.abs(wanted).max()))


def test_the_quaternion_itself_is_not_looked_at(pair: Pair) -> None:
    """Neither a root nor a case: the graph of matrices has only what the graph of quaternions has."""
    of_matrices = pair.with_matrices(pair.functions.rnea)
    used = {of_matrices.instruction_id(k) for k in range(of_matrices.n_instructions())}
    assert not used & {ca.OP_SQRT, ca.OP_IF_ELSE_ZERO, ca.OP_ACOS, ca.OP_ATAN2}


def test_a_matrix_off_the_group_goes_in_as_it_is() -> None:
    """The frame of a ball joint is the matrix itself."""
    pair = Pair("Spherical")
    function = pair.functions.frame_placement(pair.model.getFrameId("tip"))
    of_matrices = pair.with_matrices(function)
    rng = np.random.default_rng(3)
    M = rng.standard_normal((3, 3))
    joint, tip = pair.model.jointPlacements[1], pair.model.frames[pair.model.getFrameId("tip")].placement
    rotation, _ = of_matrices(M.ravel(order="F"))
    # Products of components are linear in the matrix, and Pinocchio's diagonal is 1 - 2 (y^2 + z^2).
    assert np.allclose(np.asarray(rotation), joint.rotation @ M @ tip.rotation, rtol=0, atol=1e-14)


def test_a_function_that_returns_a_quaternion_is_refused() -> None:
    pair = Pair("FreeFlyer")
    with pytest.raises(
        UnsupportedRobot, match=r"integrate of this robot does more with a quaternion .* take"
    ):
        pair.with_matrices(pair.functions.integrate)


def test_functions_that_a_quaternion_s_component_escapes_to_are_refused() -> None:
    q = ca.SX.sym("q", 4)
    R = ca.SX.sym("R", 3, 3)
    for name, expression in (
        ("root", ca.sqrt(q[3])),
        ("sum", q[0] + q[1]),
        ("scaled", 2.5 * q[2]),
        ("cubic", q[0] * q[0] * q[1]),
        ("norm", 1 / q[3]),
    ):
        function = ca.Function(name, [q], [expression])
        with pytest.raises(UnsupportedRobot, match=f"^{name} of this robot"):
            call_with_matrices(function, ca.SX.zeros(4), [(0, R)], [])
    both = ca.SX.sym("both", 8)
    mixed = ca.Function("mixed", [both], [both[0] * both[4]])
    with pytest.raises(UnsupportedRobot, match=r"^mixed"):
        call_with_matrices(mixed, ca.SX.zeros(8), [(0, R), (4, R)], [])
