r"""Momenta of a tree of joints, and what changes them, over boxes of configurations.

.. math:: p = M(q)\,v, \qquad \dot p = \tau - w, \qquad
    w_i = g_i(q) - \tfrac{1}{2} v^T \frac{\partial M}{\partial q_i} v

Centrifugal and Coriolis forces are quadratic forms of the velocities. With the momentum h of the links that a
joint carries, and its axis S, they are :math:`-(v \times S)\cdot h`, v the twist of its own link.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.bounds.intervals import Box, cosine, sine
from mbocp.bounds.slope_bounds import slopes_of
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind

TURNING, SLIDING = ("revolute", "continuous"), ("prismatic",)


@dataclass(frozen=True, eq=False)
class Momenta:
    """What momenta depend on in each of K boxes.

    Attributes
    ----------
    M : Box, shape (K, n, n)
        Mass matrix.
    typical : ndarray, shape (K, n, n)
        That in the middle of the box.
    gravity : Box, shape (K, n)
        g, by what gravity opposes the controls.
    forms : Box, shape (K, n, n, n)
        Symmetric matrices of the quadratic forms :math:`w_i - g_i`.
    """

    M: Box
    typical: Array
    gravity: Box
    forms: Box

    def enclose_opposing(self, v: Box) -> Box:
        """Enclose w for velocities within boxes, shape (K, n)."""
        most = v.size
        n = most.shape[1]
        with np.errstate(invalid="ignore", over="ignore"):
            pairs = most[:, None, :, None] * most[:, None, None, :]
            # Of squares only one sign is there, of products both.
            own, size = np.eye(n, dtype=np.bool_), self.forms.size
            low = np.where(own, np.minimum(self.forms.lower, 0.0), -size)
            high = np.where(own, np.maximum(self.forms.upper, 0.0), size)
            sides = [np.where(size == 0.0, 0.0, side * pairs).sum(axis=(2, 3)) for side in (low, high)]
            low, high = self.gravity.lower + _out(sides[0], -1.0), self.gravity.upper + _out(sides[1], 1.0)
        return Box.of(low, high)


def why_no_momenta(robot: Robot) -> str:
    """What of a robot its momenta are not enclosed for; "" where they are."""
    model = robot.model
    for joint in range(1, model.njoints):
        if joint_kind(model, joint).word not in (*TURNING, *SLIDING):
            return f"joint {model.names[joint]!r} is {joint_kind(model, joint).word}"
    return ""


def momenta_over(robot: Robot, q: Box) -> Momenta:
    """Enclose what momenta depend on over boxes of configurations.

    Parameters
    ----------
    robot : Robot
        A tree of revolute, continuous and prismatic joints.
    q : Box, shape (K, n)
        Displacements by velocity component: angles of continuous joints, too [m, rad].
    """
    model = robot.model
    found = _by_links(model, q)
    middle = _by_links(model, Box(q.centre, np.zeros_like(q.radius)))
    slopes = slopes_of(model, q.size.max(axis=0))
    with np.errstate(invalid="ignore"):
        moved = np.einsum("ijl,kl->kij", slopes.of_inertia, q.radius)
        turned = np.einsum("il,kl->ki", slopes.of_gravity, q.radius)
    M = found.M.within(middle.M, moved).within(middle.M * 0.0, slopes.M + np.diag(model.armature))
    M = M.within(M.T, np.zeros_like(moved))
    gravity = found.gravity.within(middle.gravity, turned).within(middle.gravity * 0.0, slopes.gravity)
    return Momenta(
        M,
        middle.typical,
        gravity,
        found.forms.within(found.forms * 0.0, 0.5 * slopes.of_inertia.transpose(2, 0, 1)),
    )


def gravity_by_lines(robot: Robot, q: Box, gravity: Box) -> tuple[Array, Box]:
    """Write gravity as G q + rest, G of shape (K, n, n), with rows of zeros where lines help nothing."""
    model, data = robot.model, robot.model.createData()
    slopes = slopes_of(model, q.size.max(axis=0))
    middle = _by_links(model, Box(q.centre, np.zeros_like(q.radius))).gravity
    G = np.array(
        [pin.computeGeneralizedGravityDerivatives(model, data, _numbers(model, x)) for x in q.centre]
    )
    with np.errstate(invalid="ignore"):
        left = 0.5 * np.einsum("ilm,kl,km->ki", slopes.of_slopes, q.radius, q.radius)
        left += 1e-9 * np.einsum("kil,kl->ki", np.abs(G), q.radius)  # G is not exact
    is_line = left < gravity.radius
    G[~is_line] = 0.0
    near = Box(
        np.where(is_line, middle.centre, gravity.centre),
        np.where(is_line, middle.radius + left, gravity.radius),
    )
    return G, near - (Box(G, np.zeros_like(G)) @ q.centre[:, :, None])[:, :, 0]


def _numbers(model: pin.Model, displacements: Array) -> Array:
    """Configuration of joints of one velocity, shape (nq,)."""
    q = np.zeros(model.nq)
    for joint in model.joints[1:]:
        x = displacements[joint.idx_v]
        q[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
    return q


def _by_links(model: pin.Model, q: Box) -> Momenta:
    """Enclose them link by link, with boxes of rotation matrices."""
    K, n = q.centre.shape
    words = [joint_kind(model, joint).word for joint in range(1, model.njoints)]
    if not any(word in TURNING for word in words):  # nothing depends on where it is
        q = Box(np.zeros((K, n)), np.zeros((K, n)))
    links = _links_over(model, q)
    zero = np.zeros((K, 3, n))
    turn, slide, field = {0: Box(zero, zero)}, {0: Box(zero, zero)}, {}
    field[0] = Box(np.tile(-model.gravity.linear[:, None], (K, 1, 1)), np.zeros((K, 3, 1)))
    for i, link in links.items():
        at = int(model.joints[i].idx_v)
        axis = np.zeros((3, n))
        axis[:, at] = link.axis
        up, R = int(model.parents[i]), link.R.T
        turn[i] = R @ turn[up]
        slide[i] = R @ (slide[up] - _cross(link.p) @ turn[up])
        if link.turns:
            turn[i] = turn[i] + np.tile(axis, (K, 1, 1))
        else:
            slide[i] = slide[i] + np.tile(axis, (K, 1, 1))
        field[i] = R @ field[up]
    linear, angular, pull, twist = {}, {}, {}, {}
    for i in links:
        body = model.inertias[i]
        lever = pin.skew(body.lever)
        linear[i] = body.mass * np.eye(3) @ (slide[i] - lever @ turn[i])
        angular[i] = lever @ linear[i] + body.inertia @ turn[i]
        pull[i] = body.mass * np.eye(3) @ field[i]
        twist[i] = lever @ pull[i]
    M = _empty(K, n, n)
    gravity, forms = _empty(K, n), _empty(K, n, n, n)
    for i, link in reversed(links.items()):
        at, up = int(model.joints[i].idx_v), int(model.parents[i])
        row = link.axis[None, :]
        _put(M, at, row @ (angular[i] if link.turns else linear[i]))
        _put(gravity, at, row @ (twist[i] if link.turns else pull[i]))
        across = pin.skew(link.axis)
        # (v x S) . h is (slide x a) . linear + (turn x a) . angular; of a sliding joint (turn x a) . linear.
        if link.turns:
            form = (slide[i].T @ across) @ linear[i] + (turn[i].T @ across) @ angular[i]
        else:
            form = (turn[i].T @ across) @ linear[i]
        if up > 0:  # else its angle turns all of it, and no inertia changes
            _put(forms, at, (form + form.T) * np.full((K, n, n), -0.5))
            carried = link.R @ linear[i]
            linear[up] = linear[up] + carried
            angular[up] = angular[up] + link.R @ angular[i] + _cross(link.p) @ carried
            weight = link.R @ pull[i]
            pull[up] = pull[up] + weight
            twist[up] = twist[up] + link.R @ twist[i] + _cross(link.p) @ weight
    M = M + np.tile(np.diag(model.armature), (K, 1, 1))
    return Momenta(M, M.centre, gravity, forms)


@dataclass(frozen=True, eq=False)
class _Link:
    """Placement of a joint in the link before, its axis in its own frame, and whether it turns."""

    R: Box
    p: Box
    axis: Array
    turns: bool


def _links_over(model: pin.Model, q: Box) -> dict[int, _Link]:
    K = len(q.centre)
    found = {}
    for i in range(1, model.njoints):
        joint, placement = model.joints[i], model.jointPlacements[i]
        turns = joint_kind(model, i).word in TURNING
        S = np.array(joint.createData().S).reshape(6)
        axis = S[3:] if turns else S[:3]
        at = q[:, joint.idx_v]
        R0, p0 = np.array(placement.rotation), np.tile(placement.translation[:, None], (K, 1, 1))
        if turns:
            skew, along = pin.skew(axis), np.outer(axis, axis)
            turned = [_times(np.eye(3) - along, cosine(at)), _times(skew, sine(at))]
            R = R0 @ (turned[0] + turned[1] + np.tile(along, (K, 1, 1)))
            p = Box(p0, np.zeros_like(p0))
        else:
            R = Box(np.tile(R0, (K, 1, 1)), np.zeros((K, 3, 3)))
            p = _times((R0 @ axis)[:, None], at) + p0
        found[i] = _Link(R, p, axis, turns)
    return found


def _times(matrix: Array, factor: Box) -> Box:
    return Box(
        np.tile(matrix, (len(factor.centre), 1, 1)), np.zeros((len(factor.centre), *matrix.shape))
    ) * Box(factor.centre[:, None, None], factor.radius[:, None, None])


def _cross(p: Box) -> Box:
    """Matrices that take the cross product with vectors, shape (K, 3, 3)."""
    entries = np.zeros((9, 3))
    for k in range(3):
        entries[:, k] = pin.skew(np.eye(3)[k]).ravel()
    flat = entries @ p
    return Box(flat.centre.reshape(-1, 3, 3), flat.radius.reshape(-1, 3, 3))


def _out(sums: Array, sign: float) -> Array:
    return sums + sign * 1e-12 * np.abs(sums)


def _empty(*shape: int) -> Box:
    return Box(np.zeros(shape), np.zeros(shape))


def _put(into: Box, at: int, rows: Box) -> None:
    into.centre[:, at] = rows.centre.reshape(into.centre[:, at].shape)
    into.radius[:, at] = rows.radius.reshape(into.radius[:, at].shape)
