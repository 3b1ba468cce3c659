r"""Momenta that nothing changes, and goals that ask for them.

A symmetry X(q) of a robot, see `mbocp.mechanics.symmetries`, along which neither controls nor gravity nor
losses of joints act has a constant momentum :math:`P = X(q)^T M(q)\,v`: that of a passive base that slides
and turns on a plane, for one. So a goal at rest contradicts a momentum at the start; or it asks for what
holds by itself, and its rows depend on those of the steps, which leaves the equations singular. A centre of
mass whose momentum stays goes where that takes it. Floating bodies keep their spins about their own centres
of mass, too, where nothing turns them, see `mbocp.mechanics.symmetries.spins`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.mechanics.symmetries import find_symmetries
from mbocp.mechanics.symmetries.fields import Symmetry
from mbocp.mechanics.symmetries.spins import Spin, spins_of
from mbocp.problem.problem import Problem
from mbocp.problem.reasons.cause import Cause
from mbocp.robot import Robot
from mbocp.robot.large import make_working_data

_ZERO = 1e-8  # relative: round-off of forces and momenta along a symmetry
_POSES = 3  # at which forces along it are looked at, beside start and goal
_SLACK, _SHARE = 1e-3, 0.01  # [m], and of the way: what steps of first order miss


@dataclass(frozen=True, eq=False)
class _Kept:
    """A symmetry or a spin whose momentum stays what it is at the start."""

    symmetry: Symmetry | Spin
    momentum: float

    @property
    def is_translation(self) -> bool:
        return not self.symmetry.twist[3:].any()

    @property
    def words(self) -> str:
        """Along or about which axis."""
        if isinstance(self.symmetry, Spin):
            return f"about {self.symmetry.axis}"
        name: str = self.symmetry.name
        return name.removeprefix("translation ").removeprefix("rotation ")

    def nothing_moves(self, robot: Robot) -> str:
        """The beginning of a sentence, before the axis."""
        if isinstance(self.symmetry, Spin):
            return f"nothing turns {self.symmetry.owner}"
        return f"nothing pushes {robot.name}"

    @property
    def unit(self) -> str:
        return "kg m/s" if self.is_translation else "kg m^2/s"


def momentum_causes(problem: Problem) -> Iterator[Cause]:
    """Momenta that nothing changes, and that the goal asks for all the same."""
    robot = problem.robot
    if not _are_given_and_stay(problem):
        return
    kept = list(_symmetries(problem))
    asked = [one for one in kept if _asks_for_rest(problem, one)]
    scale = _scale(problem)
    for one in asked:
        if abs(one.momentum) > _ZERO * scale:
            line = (
                f"{one.nothing_moves(robot)} {one.words}: its momentum of {one.momentum:.3g} {one.unit} "
                "stays, and the goal has it at rest"
            )
            yield Cause("momentum", one.symmetry.name, line, True, 1.0 + abs(one.momentum) / scale)
    yield from _centres_elsewhere(problem, kept)
    still = [one for one in asked if abs(one.momentum) <= _ZERO * scale]
    for beginning in dict.fromkeys(one.nothing_moves(robot) for one in still):
        yield _find_double_rest(problem, [one for one in still if one.nothing_moves(robot) == beginning])


def _are_given_and_stay(problem: Problem) -> bool:
    """Whether momenta may stay along the motion, whose start and goal are given."""
    robot, goal = problem.robot, problem.goal
    changes = problem.timeline.switches is not None or problem.phase or robot.drives
    is_given = problem.start_free is None and goal.is_exact and goal.periodic is None
    return is_given and not changes and robot.nu < robot.nv


def _find_double_rest(problem: Problem, still: Sequence[_Kept]) -> Cause:
    """Rest at the end where momenta are zero by themselves."""
    robot, rate = problem.robot, problem.goal.rate
    moved = np.max([np.abs(one.symmetry.generator(_poses(problem))).max(axis=0) for one in still], axis=0)
    driven = np.abs(robot.actuation_matrix(problem.q_start)).max(axis=1) > 0.0
    passive = (moved > _ZERO * moved.max()) & ~driven
    axes, moved_names = _join([one.words for one in still]), _join(_names(robot, passive))
    line = (
        f"{still[0].nothing_moves(robot)} {axes}: its momentum stays zero there, so that rest at the end "
        f"holds by itself, and a goal.{rate} that asks for it makes the equations singular; leave "
        f"{moved_names} out of goal.{rate}"
    )
    return Cause("momentum", moved_names, line, False, 1.0)


def _names(robot: Robot, moved: BoolArray) -> list[str]:
    """Joints, and of those that are moved in part their velocities."""
    names: list[str] = []
    for joint in list(robot.model.joints)[1:]:
        own = slice(joint.idx_v, joint.idx_v + joint.nv)
        if moved[own].all():
            names.append(robot.model.names[joint.id])
        else:
            names += [robot.v_labels[i].name for i in range(own.start, own.stop) if moved[i]]
    return names


def _centres_elsewhere(problem: Problem, kept: Sequence[_Kept]) -> Iterator[Cause]:
    """Centres of mass that are elsewhere at the goal than their momentum takes them.

    Those of robots whose base flies are told of otherwise, see `mbocp.problem.reasons.causes`.
    """
    robot, goal, T = problem.robot, problem.goal, problem.duration
    flies = any(joint.shortname() == "JointModelFreeFlyer" for joint in robot.model.joints)
    if flies or not goal.q_active.all() or problem.duration_range is not None:
        return
    for one in kept:
        if not one.is_translation or len(one.symmetry.joints) < robot.model.njoints - 1:
            continue
        data, axis = robot.model.createData(), one.symmetry.twist[:3]
        c0, c1 = (axis @ pin.centerOfMass(robot.model, data, np.array(q)) for q in (problem.q_start, goal.q))
        goes = one.momentum / data.mass[0] * T
        missed = abs(float(c1 - c0 - goes))
        if missed > _SLACK + _SHARE * max(abs(c1 - c0), abs(goes)):
            way = f"goes {goes:.3g} m there in {T:.4g} s by itself" if goes else "stays where it is"
            line = (
                f"nothing pushes {robot.name} {one.words}: its centre of mass {way}, and the goal has it "
                f"{missed:.3g} m elsewhere"
            )
            yield Cause("momentum", one.symmetry.name, line, True, 1.0 + missed)


def _symmetries(problem: Problem) -> Iterator[_Kept]:
    """Symmetries along which nothing acts."""
    robot, qs = problem.robot, _poses(problem)
    losses = np.zeros(robot.nv, dtype=np.bool_)
    for resistance in robot.resistances:
        losses[resistance.dof] |= resistance.damping > 0.0 or resistance.friction > 0.0
    known, found = set(), list[Symmetry | Spin]([*find_symmetries(robot), *spins_of(robot)])
    for symmetry in found:
        turns = tuple(symmetry.twist[3:]), symmetry.joints
        fields = symmetry.generator(qs)
        if (isinstance(symmetry, Spin) and turns in known) or (fields[:, losses] != 0.0).any():
            continue
        if any(_acts(robot, q, field) for q, field in zip(qs, fields, strict=True)):
            continue
        known.add(turns)
        first = fields[0] @ robot.mass_matrix(problem.q_start) @ problem.v_start
        yield _Kept(symmetry, float(first))


def _acts(robot: Robot, q: Array, field: Array) -> bool:
    """Whether controls, gravity or constraints act along a field of velocities."""
    forces = (
        robot.actuation_matrix(q).T,
        pin.computeGeneralizedGravity(robot.model, make_working_data(robot.model), q),
        robot.closure_jacobian(q),
    )
    return any(np.abs(f @ field).max(initial=0.0) > _ZERO * np.abs(f).max(initial=1.0) for f in forces)


def _asks_for_rest(problem: Problem, one: _Kept) -> bool:
    """Whether the goal's rates, which are zero, say that the momentum is."""
    goal, robot = problem.goal, problem.robot
    if not goal.rate_active.any() or goal.value[goal.rate_active].any():
        return False
    field = one.symmetry.generator(np.array(goal.q)[None])[0]
    weights = field if goal.rate == "p" else robot.mass_matrix(goal.q) @ field
    return not (np.abs(weights[~goal.rate_active]) > _ZERO * np.abs(weights).max()).any()


def _scale(problem: Problem) -> float:
    """Size of momenta: that of the start, or of moving the robot by its size within the time."""
    masses = problem.robot.mass_matrix(problem.q_start)
    return float(np.abs(masses).max() * max(np.abs(problem.v_start).max(), 1.0 / problem.duration))


def _poses(problem: Problem) -> Array:
    """Start, goal and some others."""
    robot, rng = problem.robot, np.random.default_rng(7)
    others = [robot.integrate(problem.q_start, rng.uniform(-1.0, 1.0, robot.nv)) for _ in range(_POSES)]
    return np.array([problem.q_start, problem.goal.q, *others])


def _join(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
