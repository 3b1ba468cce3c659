"""Numbers of a body that carries payloads, as expressions in their masses, centres of mass and moments."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import pinocchio as pin

from mbocp.robot import Payload

_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))  # of the moments, in the order of `ModelNumber`


def payload_moments(placement: pin.SE3, payload: Payload, moves: Mapping[str, ca.SX]) -> ca.SX:
    """What a payload adds to its body: mass, first and second moments about the body's origin, shape (13,).

    Parameters
    ----------
    placement : pinocchio.SE3
        Of the payload's frame in the body.
    payload : Payload
    moves : mapping of str to casadi.SX
        Added to its `mass`, `com` and `inertia`, where they are given.
    """
    R, mass = ca.DM(placement.rotation), payload.mass + moves.get("mass", ca.SX(0))
    centre = ca.DM(placement.translation) + R @ (ca.SX(payload.com) + moves.get("com", ca.SX.zeros(3)))
    xx, yy, zz, xy, xz, yz = ca.vertsplit(ca.SX(payload.inertia) + moves.get("inertia", ca.SX.zeros(6)))
    own = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = R @ own @ R.T + mass * _second_moment(centre)
    return ca.vertcat(mass, mass * centre, ca.vec(second))


def body_numbers(body: pin.Inertia, change: ca.SX) -> ca.SX:
    """Mass, centre of mass and moments of a body to which `payload_moments` are added, shape (10,).

    In the order of `ModelNumber`.
    """
    mass, lever = body.mass + change[0], ca.SX(ca.DM(body.lever))
    centre = (body.mass * lever + change[1:4]) / mass
    about_origin = ca.DM(body.inertia) + body.mass * _second_moment(lever) + ca.reshape(change[4:], 3, 3)
    moments = about_origin - mass * _second_moment(centre)
    found: ca.SX = ca.vertcat(mass, centre, *[moments[i, j] for i, j in _ENTRIES])
    return found


def _second_moment(c: ca.SX) -> ca.SX:
    return ca.dot(c, c) * ca.SX.eye(3) - ca.mtimes(c, c.T)
