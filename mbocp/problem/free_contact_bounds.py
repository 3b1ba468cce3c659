"""Feet that may leave the ground at any time, among the path constraints of a problem; experimental."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import ProblemError
from mbocp.problem.contact_bounds import ContactBounds
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.integration import FREE_SCHEME
from mbocp.problem.timeline.hold import FreeContact, Hold
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Label, Robot
from mbocp.robot.kinematics import frame_jacobian
from mbocp.terms.bounded import BoundedTerm, MotionAtNodes, SidesInSteps
from mbocp.terms.free_contact import FACETS, SLIP, FreeContactTerm
from mbocp.terms.span import Span

_ROOM_AT_END = 1e-3  # [m] below the ground: a goal that puts a foot on it leaves solvers no inside there
_GRAVITY = 9.81  # [m/s^2] of the size of speeds


@dataclass(frozen=True, eq=False)
class FreeContactBounds(BoundedTerm):
    """A foot that may leave the ground, see `mbocp.terms.free_contact`.

    Attributes
    ----------
    contact : FreeContact
        What is said of it.
    force : ContactBounds
        Its force, and the pyramid in which that stays.
    place : int
        Among those of all feet.
    length : float
        What heights are compared with [m].
    """

    contact: FreeContact
    force: ContactBounds
    place: int
    length: float

    is_known_before = False  # as forces are not
    span = Span()

    @property
    def name(self) -> str:
        """What it is called."""
        return f"contact of {self.force.contact.constraint}"

    @cached_property
    def term(self) -> FreeContactTerm:
        """Its structure."""
        source = self.force.source
        return FreeContactTerm(source.constraint.frame_ids[0], source.places, self.place)

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name of each row; all have no unit."""
        words = ("height", *(f"slip_{k}" for k in range(1, 5)), "force_by_height", "force_by_slip")
        return tuple(Label(f"{self.name}.{word}", "") for word in words)

    @cached_property
    def lower(self) -> Array:
        """Lower bounds: zero, of products none."""
        return np.array([0.0] * 5 + [-np.inf] * 2)

    @cached_property
    def upper(self) -> Array:
        """Upper bounds: of products alone."""
        return np.array([np.inf] * 5 + [self.contact.smoothing] * 2)

    @cached_property
    def numbers(self) -> dict[str, Array]:
        """Parameters by name."""
        facet = float(self.force.contact.friction or 0.0) * math.cos(math.pi / FACETS)
        speed = math.sqrt(_GRAVITY * self.length)
        found = {"friction": facet, "height": self.contact.height, "length": self.length, "speed": speed}
        of_force = self.force.map.ravel(order="F") / self.force.scale
        return {"map": of_force, **{name: np.array([value]) for name, value in found.items()}}

    def sides_in_steps(
        self, num_steps: int, dt: float, limits: Mapping[str, tuple[Array, Array]] | None, *, is_inner: bool
    ) -> SidesInSteps | None:
        """The last two, which have room below the ground: a goal at rest puts feet there in both."""
        lower = self.lower.copy()
        lower[0] = -_ROOM_AT_END / self.length
        return np.arange(max(num_steps - 2, 0), num_steps), lower, self.upper

    def values_in_motion(self, robot: Robot, nodes: MotionAtNodes) -> Array:
        """Values of the forces, with the least bounds of the speeds."""
        qs, vs = nodes.states[:2]
        slips = np.zeros((len(qs), self.place + 1))
        slips[:, self.place] = self.slips(robot, qs, vs)
        lam, slip = ca.SX.sym("lam", nodes.lams.shape[1]), ca.SX.sym("slip", self.place + 1)
        function = self.function(robot, {"reaction": lam, SLIP: slip}, lam, slip).map(len(qs))
        return np.asarray(function(qs.T, vs.T, nodes.lams.T, slips.T)).T

    def slips(self, robot: Robot, qs: Array, vs: Array) -> Array:
        """Return the least bounds of speeds along the ground at n states, shape (n,)."""
        axes, frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED, self.term.frame
        jacobians = np.array([frame_jacobian(robot.model, q, frame, axes)[:2] for q in qs])
        found: Array = np.abs(np.einsum("nij,nj->ni", jacobians, vs)).sum(axis=1) / self.numbers["speed"]
        return found

    def heights(self, robot: Robot, qs: Array) -> Array:
        """Return how far the foot is above the ground at n configurations, shape (n,) [m]."""
        name = robot.frame_names[self.term.frame]
        return np.array([robot.frame_placement(name, q).translation[2] for q in qs]) - self.contact.height


def check_free_contacts(
    free_feet: tuple[Hold, ...],
    robot: Robot,
    scheme: str,
    coordinates: str,
    accuracy: float | None,
    robust: object,
) -> None:
    """Refuse what feet that may leave the ground do not go with.

    Raises
    ------
    ProblemError
    """
    others = {
        f'integrator.scheme = "{scheme}"; take "{FREE_SCHEME}"': scheme != FREE_SCHEME,
        f'coordinates = "{coordinates}"; take "joint"': not COORDINATES[coordinates].has_joint_states,
        "closed loops of the robot": bool(robot.nc),
        "horizon.accuracy": accuracy is not None,
        "[robust]": robust is not None,
    }
    if free_feet:
        refuse_beside_free(others)


def refuse_beside_free(others: Mapping[str, bool]) -> None:
    """Refuse what feet that may leave the ground do not go with, in words, where it is said.

    Raises
    ------
    ProblemError
    """
    for words, is_said in others.items():
        if is_said:
            raise ProblemError(f'ground.contact: "free" does not go with {words}')


def free_contacts(
    robot: Robot, q_start: Array, table: SwitchTable | None, forces: tuple[BoundedTerm, ...]
) -> tuple[FreeContactBounds, ...]:
    """Return the contacts of a problem whose feet may leave the ground.

    Raises
    ------
    ProblemError
        If the robot does not stand above its ground.
    """
    asked = () if table is None else table.free_feet
    by_name = {force.contact.constraint: force for force in forces if isinstance(force, ContactBounds)}
    data, found = robot.model.createData(), []
    centre = float(pin.centerOfMass(robot.model, data, q_start)[2])
    for place, hold in enumerate(asked):
        assert hold.free is not None
        length = centre - hold.free.height
        if length <= 0.0:
            raise ProblemError(
                f"ground: the centre of mass is at z = {centre:.4g} m at the start, and the ground at "
                f"{hold.free.height:.4g} m; start above it"
            )
        found.append(FreeContactBounds(hold.free, by_name[hold.name], place, length))
    return tuple(found)
