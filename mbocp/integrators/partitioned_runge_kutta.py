r"""Symplectic partitioned Runge-Kutta methods on the cotangent bundle of the joints' Lie group.

A step takes place in exponential coordinates about its first node, :math:`q = q_0 \exp(\xi)`. There the
Lagrangian is :math:`\ell(\xi, \eta) = L(q_0 \exp \xi, D_\xi\,\eta)` with the rate :math:`\eta = \dot\xi` and
:math:`v = D_\xi\,\eta`, :math:`D_\xi = \mathrm{dexp}_{-\xi}`; and momenta and forces are

.. math::
    \pi = \partial_\eta \ell = D_\xi^T M v, \qquad
    \dot\pi = \partial_\xi \ell + D_\xi^T f = D_\xi^T (\partial_q L + f) + (\partial_\xi D_\xi \eta)^T M v.

The discrete Lagrangian :math:`h \sum_i b_i\,\ell(\xi_i, \eta_i)` with

.. math::
    \xi_i = h \sum_j a_{ij}\,\eta_j, \qquad \xi_1 = h \sum_j b_j\,\eta_j, \qquad q_1 = q_0 \exp(\xi_1)

is that of a symplectic pair ([Hairer2006]_, section VI.6.3), of its order in every such chart. It is
stationary in the rates of the stages, and its derivatives in :math:`q_0` and :math:`q_1` are :math:`-p_0` and
:math:`p_1 = M v_1`, where the chart moves along with :math:`q_0`:

.. math::
    \pi_i &= \pi_0 + h \sum_j \hat a_{ij}\,\dot\pi_j, \qquad
        \pi_0 = D_{\xi_1}^T p_1 - h \sum_j b_j\,\dot\pi_j, \\
    p_0 &= \mathrm{Ad}_{\exp(-\xi_1)}^T p_1
        - h \sum_j b_j\,\mathrm{Ad}_{\exp(-\xi_j)}^T (\partial_q L + f)_j.

The last row balances momenta in the axes of :math:`q_0`. So momenta along motions from the left are kept to
round-off, and the canonical form is where :math:`b_i \hat a_{ij} + b_j a_{ji} = b_i b_j` ([Hairer2006]_,
theorem VI.4.6). Where configurations are vectors :math:`\pi_0` is :math:`p_0`, and the rows are those of the
partitioned method. On groups these are methods of the kind of [Bogfjellmo2016]_ that come from
Runge-Kutta-Munthe-Kaas methods, written with velocities.

Holonomic constraints act at the stages, with impulses as unknowns; the tableau's first stage is the first
node then and its last stage the second, as those of the Lobatto IIIA-IIIB pair are
([Jay1996]_, [Hairer2006]_, section VII.1.4):

.. math::
    \dot\pi_j \leftarrow \dot\pi_j - D_{\xi_j}^T \Phi_q(Q_j)^T \Lambda_j, \qquad
    \Phi(Q_i) = 0 \quad (i = 2 \dots s), \qquad \Phi_q(q_1)\,v_1 = 0.

With two stages this is RATTLE.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca

from mbocp.integrators.chain import Affine, Chain, add_weighted, dense_function
from mbocp.integrators.pairs import PAIRS, Pair
from mbocp.mechanics import JointMechanics

Length = Affine | ca.SX  # of a step: an unknown, or given


class ChainNode(NamedTuple):
    """A state as links of a chain."""

    q: Affine  # (nq,) [m, rad, quaternion xyzw]
    v: Affine  # (nv,) [m/s, rad/s]


class Stage(NamedTuple):
    """Unknowns of a stage: its rate, and the impulses h Lambda of the constraints at it."""

    rate: Affine  # (nv,) eta [m/s, rad/s]
    impulse: Affine  # (nc,) [N s, N m s]


class PartitionedRows(NamedTuple):
    """Residual of a step, and the states in which its forces act.

    Attributes
    ----------
    kinematic : Affine, shape (nv,), or (nq,) where coordinates are compared
    momentum : Affine, shape (nv,)
        [N s, N m s].
    stages : tuple of Affine, shapes (nv,)
        Momenta of the stages [N s, N m s].
    constraints : tuple of Affine, shapes (nc,)
        Phi / h of the stages but the first, and Phi_q v at the end; empty without constraints.
    points : tuple of ChainNode
        Configurations and velocities of the stages.
    """

    kinematic: Affine
    momentum: Affine
    stages: tuple[Affine, ...]
    constraints: tuple[Affine, ...]
    points: tuple[ChainNode, ...]


class PartitionedStep:
    """Equations of one step of a method.

    Parameters
    ----------
    mechanics : JointMechanics
    scheme : str
        One of `mbocp.integrators.pairs.PAIRS`.
    compares_coordinates : bool
        Whether the kinematic rows are differences of coordinates, not tangent vectors.
    """

    def __init__(self, mechanics: JointMechanics, scheme: str, *, compares_coordinates: bool) -> None:
        self._mechanics, self._pair = mechanics, PAIRS[scheme]
        self._links = _Links(mechanics)
        self._compares_coordinates = compares_coordinates

    @property
    def pair(self) -> Pair:
        """Coefficients."""
        return self._pair

    def __call__(
        self,
        chain: Chain,
        before: ChainNode,
        after: ChainNode,
        stages: Sequence[Stage],
        us: Sequence[Affine],
        h: Length,
        found: Sequence[Affine] = (),
    ) -> PartitionedRows:
        """Rows of a step.

        Parameters
        ----------
        chain : Chain
        before, after : ChainNode
        stages : sequence of Stage
        us : sequence of Affine
            Controls at the stages [N, N m].
        h : Affine or casadi.SX
            Length [s].
        found : sequence of Affine
            Numbers of the robot that are found, where there are some.
        """
        pair, links = self._pair, self._links
        (p0,) = chain.apply(links.momentum, [before.q, before.v, *found], links.given)
        rates = [stage.rate for stage in stages]
        momenta, slopes, carried, points = [], [], [], []
        for row, stage, u in zip(pair.a, stages, us, strict=True):
            xi = links.times(chain, h, add_weighted(row, rates))
            point = ChainNode(links.move(chain, before.q, xi), links.velocity(chain, xi, stage.rate))
            p, force = chain.apply(links.body, [point.q, point.v, u, *found], links.given)
            push = links.pushes(chain, point.q, stage.impulse, found) if self._mechanics.nc else ()
            pulled = links.pull_back(chain, xi, stage.rate, p, force, *push)
            momenta.append(pulled.momentum)
            slopes.append(_add(links.times(chain, h, pulled.slope), pulled.pushed))
            carried.append(_add(links.times(chain, h, pulled.carried), pulled.carried_push))
            points.append(point)
        xi = links.times(chain, h, add_weighted(pair.b, rates))
        reached = links.move(chain, before.q, xi)
        (p1,) = chain.apply(links.momentum, [after.q, after.v, *found], links.given)
        in_chart, at_start = links.covectors(chain, xi, p1)
        # The same where configurations are vectors, but for the order in which unknowns are eliminated.
        begun = (
            p0 if self._mechanics.is_vector_space else in_chart + add_weighted([-b for b in pair.b], slopes)
        )
        return PartitionedRows(
            kinematic=self._gap(chain, after.q, reached),
            momentum=p0 + add_weighted(pair.b, carried) - at_start,
            stages=tuple(
                begun + add_weighted(row, slopes) - own for row, own in zip(pair.a_hat, momenta, strict=True)
            ),
            constraints=self._constraints(chain, [point.q for point in points[1:-1]], after, h, found),
            points=tuple(points),
        )

    def _gap(self, chain: Chain, q: Affine, reached: Affine) -> Affine:
        if self._compares_coordinates:
            return reached - q
        return chain.apply(self._links.difference, [q, reached])[0]

    def _constraints(
        self, chain: Chain, between: Sequence[Affine], after: ChainNode, h: Length, found: Sequence[Affine]
    ) -> tuple[Affine, ...]:
        if not self._mechanics.nc:
            return ()
        places = [self._links.places(chain, q, h, found) for q in (*between, after.q)]
        return (*places, *chain.apply(self._links.drift, [after.q, after.v, *found], self._links.given))


class _StageForces(NamedTuple):
    """Momenta and forces at a stage in the coordinates, and forces in the axes of the first node.

    What constraints push is None where there are none.
    """

    momentum: Affine
    slope: Affine
    carried: Affine
    pushed: Affine | None = None
    carried_push: Affine | None = None


class _Links:
    """The functions that a step is made of. Where configurations are vectors, coordinates are plain sums."""

    def __init__(self, mechanics: JointMechanics) -> None:
        self._is_plain, nv, nc = mechanics.is_vector_space, mechanics.nv, mechanics.nc
        given = [mechanics.fixed] if mechanics.fixed.numel() else []
        self.given = tuple(given)
        found = [mechanics.found] if mechanics.found.numel() else []
        more = [*found, *given]
        q, v, u = ca.SX.sym("q", mechanics.nq), ca.SX.sym("v", nv), ca.SX.sym("u", mechanics.nu)
        xi, eta, p, h = ca.SX.sym("xi", nv), ca.SX.sym("eta", nv), ca.SX.sym("p", nv), ca.SX.sym("h")
        other, f, c = ca.SX.sym("other", mechanics.nq), ca.SX.sym("f", nv), ca.SX.sym("c", nv)
        energy = mechanics.kinetic_energy(q, v)
        along = mechanics.tangent_map(q).T @ ca.gradient(energy, q)
        force = along - mechanics.gravity(q) + mechanics.force(q, v, u)
        self.momentum = dense_function("momentum", [q, v, *more], [ca.gradient(energy, v)])
        self.body = dense_function("body", [q, v, u, *more], [ca.gradient(energy, v), force])
        self.difference = dense_function("difference", [q, other], [mechanics.difference(q, other)])
        self._moved = dense_function("moved", [q, xi], [mechanics.integrate(q, xi)])
        self._scaled = dense_function("scaled", [h, v], [h * v])
        velocity = mechanics.space.dexp(xi, eta)
        work = ca.dot(velocity, p)
        bent = ca.gradient(work, xi)
        bracket = mechanics.space.bracket(xi, eta)

        def pull(covector: ca.SX) -> tuple[ca.SX, ca.SX]:
            """D' c, and Ad' c = c - ad' D' c, since Ad of exp(-xi) is 1 - D ad."""
            in_chart = ca.jtimes(velocity, eta, covector, True)
            return in_chart, covector - ca.jtimes(bracket, eta, in_chart, True)

        (pulled, carried), (pushed, carried_push) = pull(f), pull(c)
        free = [ca.gradient(work, eta), pulled + bent, carried]
        self._velocity = dense_function("velocity", [xi, eta], [velocity])
        self._free = dense_function("free", [xi, eta, p, f], free)
        self._held = dense_function("held", [xi, eta, p, f, c], [*free, pushed, carried_push])
        self._covectors = dense_function("covectors", [xi, p], list(pull(p)))
        if nc:
            impulse, jacobian = ca.SX.sym("impulse", nc), mechanics.constraint_jacobian(q)
            self._push = dense_function("push", [q, impulse, *more], [-jacobian.T @ impulse])
            self.drift = dense_function("drift", [q, v, *more], [jacobian @ v])
            self._places = dense_function("places", [q, *found, h, *given], [mechanics.constraints(q) / h])

    def move(self, chain: Chain, q: Affine, xi: Affine) -> Affine:
        """Configuration q exp(xi)."""
        return q + xi if self._is_plain else chain.apply(self._moved, [q, xi])[0]

    def velocity(self, chain: Chain, xi: Affine, eta: Affine) -> Affine:
        """Velocity of a rate of the coordinates."""
        return eta if self._is_plain else chain.apply(self._velocity, [xi, eta])[0]

    def pull_back(
        self, chain: Chain, xi: Affine, eta: Affine, p: Affine, force: Affine, *push: Affine
    ) -> _StageForces:
        """Momentum and forces of the body frame in the coordinates."""
        if self._is_plain:
            return _StageForces(p, force, force, *push, *push)
        return _StageForces(*chain.apply(self._held if push else self._free, [xi, eta, p, force, *push]))

    def covectors(self, chain: Chain, xi: Affine, p: Affine) -> tuple[Affine, Affine]:
        """Momentum of the body frame in the coordinates, and in the axes of the first node."""
        if self._is_plain:
            return p, p
        in_chart, carried = chain.apply(self._covectors, [xi, p])
        return in_chart, carried

    def times(self, chain: Chain, h: Length, vector: Affine) -> Affine:
        """Multiple of a vector."""
        return chain.apply(self._scaled, [h, vector])[0] if isinstance(h, Affine) else h * vector

    def pushes(self, chain: Chain, q: Affine, impulse: Affine, found: Sequence[Affine]) -> list[Affine]:
        """What impulses of the constraints push."""
        return chain.apply(self._push, [q, impulse, *found], self.given)

    def places(self, chain: Chain, q: Affine, h: Length, found: Sequence[Affine]) -> Affine:
        """Phi / h."""
        if isinstance(h, Affine):
            return chain.apply(self._places, [q, *found, h], self.given)[0]
        return chain.apply(self._places, [q, *found], [h, *self.given])[0]


def _add(one: Affine, other: Affine | None) -> Affine:
    return one if other is None else one + other
