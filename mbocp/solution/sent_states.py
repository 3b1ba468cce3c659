r"""States and controls of a robot that follows a motion as it is sent.

Motors do so exactly. Links that hang on springs follow as their dynamics let them, from where the solution
has them at the start: with E the links of elastic joints, which no motor acts on, and S all that is sent,

.. math:: M_{EE}(q)\, \dot v_E = -h_E(q, v) - M_{ES}(q)\, \dot v_S
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.exceptions import MbocpError
from mbocp.robot.large import make_working_data
from mbocp.solution.curves import Curves
from mbocp.solution.sent import Sent

if TYPE_CHECKING:
    from mbocp.robot import Robot

_MOST_CONDITION = 1e8  # of the matrix from controls to forces of joints
_TURN = 0.3  # [rad] of the fastest oscillation of links, in a step of the Runge-Kutta scheme: 1e-5 wrong
_MOST_STEPS = 200_000  # of it, which take half a minute


@dataclass(frozen=True, eq=False)
class Follower:
    """A robot that follows a motion.

    Attributes
    ----------
    sent : Sent
    robot : Robot
    has_controls : bool
        Whether what is sent says all controls: for robots without loops and drives, whose joints have one
        velocity and a motor each; not across impacts.
    links : callable, optional
        Positions and velocities of the links of elastic joints at times [s], shape (n, 2 links).
    """

    sent: Sent
    robot: Robot
    has_controls: bool
    links: Callable[[Array], Array] | None = None

    @classmethod
    def of(cls, sent: Sent, robot: Robot) -> Follower:
        """Integrate the motion of links on springs.

        Raises
        ------
        MbocpError
            If they cannot be followed.
        """
        prescribed = cls(sent, robot, _has_controls(sent, robot))
        if not (robot.elastic and prescribed.has_controls):
            return prescribed
        return cls(sent, robot, has_controls=True, links=_integrate_links(prescribed))

    @property
    def known(self) -> tuple[BoolArray, BoolArray]:
        """Which coordinates of q and v follow from what is sent, shapes (nq,) and (nv,).

        Those of floating bases and of balls do not.
        """
        labels, names = self.sent.solution.labels, set(self.sent.joints)
        of_q = [bool({column.name, column.name.rpartition(".")[0]} & names) for column in labels.q]
        masks = np.array(of_q), np.array([column.name in names for column in labels.v])
        if self.links is not None:
            masks[0][self._link_q], masks[1][self._link_v] = True, True
        return masks

    def states(
        self, times: Array, positions: Array, rates: Array, others: Array | None = None
    ) -> tuple[Array, Array]:
        """Configurations, shape (n, nq), and velocities, (n, nv), at times [s] of joints that are sent.

        Other coordinates are those of `others`, shape (n, nq), or of the solution's start, at rest.
        """
        qs, vs = self._place(positions, rates, others)
        if self.links is not None:
            qs[:, self._link_q], vs[:, self._link_v] = np.hsplit(self.links(times), 2)
        return qs, vs

    def controls(self, qs: Array, vs: Array, accelerations: Array) -> Array:
        """Controls by inverse dynamics, shape (n, nu) [N, N m], of accelerations of joints that are sent."""
        robot, rates = self.robot, self.rates(accelerations)
        driven = np.setdiff1d(np.arange(robot.nv), self._link_v)
        of_elements = robot.force_elements_along(qs, vs)
        forces = np.array([self._forces(*at)[driven] for at in zip(qs, vs, rates, of_elements, strict=True)])
        return np.asarray(np.linalg.solve(robot.actuation_matrix(robot.q0)[driven], forces.T).T)

    def rates(self, accelerations: Array) -> Array:
        """Accelerations of joints that are sent in their places, shape (n, nv), zero in others."""
        return self._place(accelerations, accelerations, None)[1]

    @property
    def _link_q(self) -> list[int]:
        return [joint.at_q[0] for joint in self.robot.elastic]

    @property
    def _link_v(self) -> list[int]:
        return [joint.at_v[0] for joint in self.robot.elastic]

    def _place(self, positions: Array, rates: Array, others: Array | None) -> tuple[Array, Array]:
        """Values of joints that are sent, in their places."""
        solution, places = self.sent.solution, {name: k for k, name in enumerate(self.sent.joints)}
        qs = np.repeat(solution.qs[:1], len(positions), axis=0) if others is None else others.copy()
        for k, column in enumerate(solution.labels.q):
            joint, _, function = column.name.rpartition(".")
            if column.name in places:
                qs[:, k] = positions[:, places[column.name]]
            elif joint in places:  # cosine or sine of one that turns without end
                qs[:, k] = getattr(np, function)(positions[:, places[joint]])
        vs = np.zeros((len(positions), len(solution.labels.v)))
        for k, column in enumerate(solution.labels.v):
            if column.name in places:
                vs[:, k] = rates[:, places[column.name]]
        return qs, vs

    def _forces(self, q: Array, v: Array, rates: Array, of_elements: Array) -> Array:
        """Forces that a motion takes beside those of the robot's elements, shape (nv,)."""
        rates = rates.copy()
        rates[self._link_v] += self.link_accelerations(q, v, rates)
        return pin.rnea(self.robot.model, self._data, q, v, rates) - of_elements

    def link_accelerations(self, q: Array, v: Array, rates: Array) -> Array:
        """Accelerations of links on springs, shape (links,), beside those of all else, shape (nv,)."""
        at = self._link_v
        if not at:
            return np.zeros(0)
        force = pin.rnea(self.robot.model, self._data, q, v, rates) - self.robot.force_elements(q, v)
        return np.asarray(np.linalg.solve(self.link_masses(q), -force[at]))

    def link_masses(self, q: Array) -> Array:
        """Mass matrix of links on springs, shape (links, links)."""
        at = self._link_v
        upper = np.triu(pin.crba(self.robot.model, self._data, q)[np.ix_(at, at)])
        return np.asarray(upper + np.triu(upper, 1).T)

    @cached_property
    def _data(self) -> pin.Data:
        return make_working_data(self.robot.model)


def _has_controls(sent: Sent, robot: Robot) -> bool:
    if robot.nc or robot.drives or not len(sent.joints) == robot.nv - len(robot.elastic) == robot.nu:
        return False
    has_forces = all(column.unit in ("N", "N m") for column in sent.solution.labels.u)
    if not has_forces or sent.curves.has_impacts or not robot.actuation.is_constant:
        return False
    driven = np.setdiff1d(np.arange(robot.nv), [joint.at_v[0] for joint in robot.elastic])
    return bool(np.linalg.cond(robot.actuation_matrix(robot.q0)[driven]) < _MOST_CONDITION)


def _integrate_links(follower: Follower) -> Callable[[Array], Array]:
    """Motion of links on springs, from the solution's start, by the classical Runge-Kutta scheme."""
    curves, solution = follower.sent.curves, follower.sent.solution
    at_q, at_v = follower._link_q, follower._link_v
    parts = _parts(follower)
    times, (positions, velocities, accelerations, _) = curves.places(2 * parts)
    qs, vs = follower._place(positions, velocities, None)
    _, rates = follower._place(positions, accelerations, None)

    def slope(k: int, y: Array) -> Array:
        qs[k, at_q], vs[k, at_v] = np.split(y, 2)
        return np.concatenate([vs[k, at_v], follower.link_accelerations(qs[k], vs[k], rates[k])])

    y = np.concatenate([solution.qs[0, at_q], solution.vs[0, at_v]])
    nodes, found = [0.0], [y]
    for first in range(0, len(times), 2 * parts + 1):  # a step of the curves has both of its ends
        for k in range(first, first + 2 * parts, 2):
            h = times[k + 2] - times[k]
            a = slope(k, y)
            b = slope(k + 1, y + h / 2.0 * a)
            c = slope(k + 1, y + h / 2.0 * b)
            d = slope(k + 2, y + h * c)
            y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            nodes.append(times[k + 2])
            found.append(y)
    links = Curves(np.array(nodes), *np.hsplit(np.array(found), 2))
    return lambda at: np.hstack(links.at(at)[:2])


def _parts(follower: Follower) -> int:
    """Of a step of the curves, in which links turn little by their oscillations.

    Raises
    ------
    MbocpError
        If they oscillate too often.
    """
    springs, curves = follower.robot.elastic, follower.sent.curves
    masses = follower.link_masses(follower.sent.solution.qs[0])
    stiffness, damping = (
        np.linalg.eigvals(np.linalg.solve(masses, np.diag([getattr(joint, key) for joint in springs])))
        for key in ("stiffness", "damping")
    )
    fastest = float(np.sqrt(np.abs(stiffness).max()) + np.abs(damping).max())  # [1/s]
    parts = int(np.ceil(float(np.diff(curves.nodes).max()) * fastest / _TURN))
    if parts * len(curves.nodes) > _MOST_STEPS:
        raise MbocpError(f"links of elastic joints oscillate {fastest / 2.0 / np.pi:.3g} times a second")
    return parts
