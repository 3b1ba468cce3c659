"""Obstacles and self-collision of a problem as one path constraint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, IntArray, dataclass
from mbocp.problem.obstacles.pair_clearances import PairClearances, PlacedShape, WaySize
from mbocp.robot import Label, LinkSpheres, Robot
from mbocp.robot.collision.obstacle import SMOOTHING, Obstacle
from mbocp.robot.collision.obstacle_motion import ObstacleMotion
from mbocp.robot.collision.planes import Planes, planes_around
from mbocp.robot.collision.self_pairs import SelfPairs
from mbocp.terms.bounded import BoundedTerm, MotionAtNodes, SidesInSteps
from mbocp.terms.clearance_term import ClearanceRow, ClearanceTerm, HullSlots, clearance_slots
from mbocp.terms.distances import MOST_PLANES, Core, HullCore, core_of
from mbocp.terms.span import Span

LinkPair = tuple[int, int, bool]  # a link, and an obstacle or another link; whether it is an obstacle

_OF_ALL_PAIRS = (
    *("pieces", "owners", "movers", "scene", "_frames", "planes", "_hulls", "margins", "_by_links"),
    "overlaps",
    *("_pair_clearances", "_kinds", "_still", "_still_clearances", "_sphere_names"),
)
_IDLE = Label("nothing", "m")  # a row that is not needed
_AWAY = 10.0  # [m]: its value
_NOWHERE = -1e3  # [m] along z: where what moves is at no time
_STILL_SLOTS, _MOVING_SLOTS = 64, 16  # of chosen pairs
_HULL_SLOTS = 16  # the same, of hulls
_FEW_HULLS = 16  # that all have planes in each row's table
_BEFORE_GOAL = 0.1  # of the steps, in which room falls to that of the goal
_ROUNDING = 0.05  # of the largest distance that a row keeps: error of planes for a hull that is small enough


@dataclass(frozen=True)
class SelfCollision:
    """That links keep away from each other.

    Attributes
    ----------
    margin : float
        Least distance of their spheres [m].
    of_parts : float, optional
        The same of links of different parts of the robot [m]; by default `margin`.
    disabled : tuple of (str, str)
        Pairs of links that need not.
    srdf : Path, optional
        Whose <disable_collisions> need not, either; by default those that the robot's files name.
    """

    margin: float = 0.0
    of_parts: float | None = None
    disabled: tuple[tuple[str, str], ...] = ()
    srdf: Path | None = None


@dataclass(frozen=True, eq=False)
class Clearance(BoundedTerm):
    """Distances of spheres from obstacles and from each other, see `mbocp.problem.PathConstraint`.

    A pair is a sphere and a piece of an obstacle, or two spheres; rows are what solvers see of them.

    Attributes
    ----------
    robot : Robot
    obstacles : tuple of Obstacle
    spheres : tuple of (int, int)
        Link, by its place in `robot.collision_spheres`, and sphere of it, of all that take part.
    pairs : tuple of (int, int)
        Sphere, by its place in `spheres`, and piece, by its place in `pieces`.
    sphere_pairs : tuple of (int, int)
    own : SelfCollision
        What spheres keep from each other.
    left_out : mapping of str to mapping of str to int
        How many spheres of an obstacle, by its name, are left out for which reason.
    self_pairs : SelfPairs, optional
    chosen : tuple of int, optional
        Pairs that have rows; all where it is None.
    reserve : ndarray, shape (num_pairs,), optional
        What rows keep beyond the margins, for what happens between nodes [m]; nothing where it is None.
    goal_room : ndarray, shape (num_pairs,), optional
        What the goal lets them keep of that [m]; all where it is None.
    """

    robot: Robot
    obstacles: tuple[Obstacle, ...]
    spheres: tuple[tuple[int, int], ...]
    pairs: tuple[tuple[int, int], ...]
    sphere_pairs: tuple[tuple[int, int], ...] = ()
    own: SelfCollision = SelfCollision()
    left_out: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    self_pairs: SelfPairs | None = None
    chosen: tuple[int, ...] | None = None
    reserve: Array | None = None
    goal_room: Array | None = None

    name = "clearance"
    span = Span()

    @property
    def _links(self) -> tuple[LinkSpheres, ...]:
        return self.robot.collision_spheres

    @cached_property
    def pieces(self) -> tuple[Obstacle, ...]:
        """Convex pieces of all obstacles."""
        return tuple(piece for obstacle in self.obstacles for piece in obstacle.pieces)

    @cached_property
    def owners(self) -> tuple[int, ...]:
        """Obstacle of each piece."""
        return tuple(k for k, obstacle in enumerate(self.obstacles) for _ in obstacle.pieces)

    @property
    def num_pairs(self) -> int:
        """Of spheres and obstacles, then of spheres."""
        return len(self.pairs) + len(self.sphere_pairs)

    @cached_property
    def _by_links(self) -> tuple[tuple[LinkPair, ...], IntArray]:
        numbers: dict[LinkPair, int] = {}
        every = chain(
            ((self.spheres[a][0], self.owners[k], True) for a, k in self.pairs),
            ((self.spheres[a][0], self.spheres[b][0], False) for a, b in self.sphere_pairs),
        )
        groups = [numbers.setdefault(key, len(numbers)) for key in every]
        return tuple(numbers), np.array(groups, dtype=np.intp)

    @property
    def link_pairs(self) -> tuple[LinkPair, ...]:
        """Links, each with an obstacle or another link, that have pairs: the groups of these."""
        return self._by_links[0]

    @property
    def groups(self) -> IntArray:
        """Which of the `link_pairs` each pair is of, shape (num_pairs,)."""
        return self._by_links[1]

    def names_of(self, pair: LinkPair) -> tuple[str, str]:
        """Of a link, and of an obstacle or another link."""
        link, number, is_obstacle = pair
        other = self.obstacles[number].name if is_obstacle else self._links[number].link
        return self._links[link].link, other

    @property
    def reserves(self) -> Array:
        """What rows keep beyond the margins, shape (num_pairs,) [m]."""
        return np.zeros(self.num_pairs) if self.reserve is None else self.reserve

    def of_pairs(
        self, chosen: Sequence[int] | None, reserve: Array | None = None, goal_room: Array | None = None
    ) -> Clearance:
        """The same with rows for some of the pairs alone, or for all, that keep a reserve."""
        chosen = None if chosen is None else tuple(sorted(chosen))
        found = replace(self, chosen=chosen, reserve=reserve, goal_room=goal_room)
        for name in _OF_ALL_PAIRS:
            found.__dict__[name] = getattr(self, name)
        return found

    @cached_property
    def _frames(self) -> tuple[int, ...]:
        """Frames that carry spheres, whether these take part or not, or obstacles; those that move last."""
        carriers = {self.frame_of(o) for o in self.obstacles if self._is_carried(o)}
        return tuple(sorted({link.frame for link in self._links} | carriers))

    @cached_property
    def movers(self) -> tuple[ObstacleMotion, ...]:
        """Motions of obstacles by the time, each once."""
        return tuple({o.motion.key: o.motion for o in self.obstacles if o.motion is not None}.values())

    @cached_property
    def scene(self) -> pin.Model:
        """The robot's model, with a free joint for each of these motions."""
        if not self.movers:
            return self.robot.model
        model = pin.Model(self.robot.model)
        for number in range(len(self.movers)):
            name, at = f"motion {number} of obstacles", pin.SE3.Identity()
            joint = model.addJoint(0, pin.JointModelFreeFlyer(), at, name)
            model.addFrame(pin.Frame(name, joint, 0, at, pin.FrameType.OP_FRAME))
        return model

    def scene_configurations(self, qs: Array, ts: Array | None = None) -> Array:
        """Configurations of the scene at some times; at no time what moves is far away."""
        qs = np.asarray(qs, dtype=np.float64)
        if not self.movers:
            return qs
        nowhere = np.tile([0.0, 0.0, _NOWHERE, 0.0, 0.0, 0.0, 1.0], (len(qs), 1))
        return np.hstack([qs, *(nowhere if ts is None else motion.poses(ts) for motion in self.movers)])

    def frame_of(self, obstacle: Obstacle) -> int:
        """Frame of the scene that carries an obstacle."""
        if obstacle.motion is None:
            return self.robot.frame_id(obstacle.frame)
        number = [motion.key for motion in self.movers].index(obstacle.motion.key)
        return int(self.scene.nframes) - len(self.movers) + number

    def placement_of(self, obstacle: Obstacle) -> pin.SE3:
        """Of its shape on the joint of that frame."""
        return self.scene.frames[self.frame_of(obstacle)].placement * obstacle.offset

    def _is_carried(self, obstacle: Obstacle) -> bool:
        return int(self.scene.frames[self.frame_of(obstacle)].parentJoint) > 0

    @cached_property
    def _pair_clearances(self) -> PairClearances:
        place = {frame: k for k, frame in enumerate(self._frames, start=1)}
        kept = [(self._links[link], number) for link, number in self.spheres]
        spheres = [(place[link.frame], link.centers[number]) for link, number in kept]
        radii, shapes = np.array([link.radii[number] for link, number in kept]), list[PlacedShape]()
        for number, obstacle in enumerate(self.pieces):
            core, middle = self._core(number)
            at, other = self.placement_of(obstacle), 0
            if self._is_carried(obstacle):
                at, other = obstacle.offset, place[self.frame_of(obstacle)]
            shapes.append(PlacedShape(other, at.act(middle), at.rotation, core))
        radii_of_shapes = np.array([*(shape.core.radius for shape in shapes), *radii])
        point, axes, first = core_of("sphere", (0.0,), SMOOTHING), np.eye(3), len(shapes)
        shapes += [PlacedShape(*sphere, axes, point) for sphere in spheres]
        pairs = [*self.pairs, *((a, first + b) for a, b in self.sphere_pairs)]
        sphere, shape = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
        kept_radii = radii[sphere] + radii_of_shapes[shape] - self.overlaps
        table = np.column_stack([sphere, shape, kept_radii, self.margins, self.groups])
        return PairClearances(self.scene, self._frames, tuple(spheres), tuple(shapes), table)

    @cached_property
    def planes(self) -> dict[int, Planes]:
        """Planes for the hulls among the pieces, by their numbers."""
        found = {}
        for number, obstacle in enumerate(self.pieces):
            if obstacle.hull is None:
                continue
            spheres = [self.spheres[a] for a, k in self.pairs if k == number]
            largest = max((float(self._links[link].radii[sphere]) for link, sphere in spheres), default=0.0)
            reach = largest + max(obstacle.margin, 0.0)
            tolerance = max(obstacle.smoothing, _ROUNDING * reach)
            found[number] = planes_around(obstacle.hull, reach, tolerance, MOST_PLANES)
        return found

    @cached_property
    def _hulls(self) -> dict[int, HullCore]:
        """What rows see of these."""
        return {
            k: HullCore.of(planes.normals, planes.offsets, planes.slope, self.pieces[k].smoothing)
            for k, planes in self.planes.items()
        }

    def _core(self, number: int) -> tuple[Core | HullCore, Array]:
        """Core of a piece, and its middle in the axes of the shape."""
        obstacle = self.pieces[number]
        if obstacle.hull is not None:
            return self._hulls[number], obstacle.hull.middle
        core = core_of(obstacle.shape, obstacle.sizes, obstacle.smoothing)
        return core, np.array([0.0, 0.0, core.middle])

    @cached_property
    def margins(self) -> Array:
        """Least clearance of each pair, shape (num_pairs,) [m]."""
        of_obstacles = [self.pieces[k].margin for _, k in self.pairs]
        return np.array([*of_obstacles, *map(self._own_margin, self.sphere_pairs)], dtype=np.float64)

    @cached_property
    def overlaps(self) -> Array:
        """How deep spheres of each pair may be in each other, as shapes are not, shape (num_pairs,) [m]."""
        own = () if self.self_pairs is None else self.self_pairs.overlaps
        return np.array([*[0.0] * len(self.pairs), *own])

    def _own_margin(self, pair: tuple[int, int]) -> float:
        """What two spheres keep from each other [m]."""
        names = [self._links[self.spheres[k][0]].link for k in pair]
        parts = [next((p.name for p in self.robot.parts if n.startswith(p.prefix)), "") for n in names]
        if self.own.of_parts is None or parts[0] == parts[1]:
            return self.own.margin
        return self.own.of_parts

    def pair_values(
        self, qs: Array, near: float = np.inf, ts: Array | None = None, pairs: IntArray | None = None
    ) -> Array:
        """Clearance of pairs, by default of all, at each configuration and its time, shape (n, pairs) [m].

        What is larger than `near`, which takes most of the time, may be any number between `near` and it.
        """
        return self._pair_clearances.values(self.scene_configurations(qs, ts), near, pairs)

    def group_values(self, qs: Array, near: float = np.inf, ts: Array | None = None) -> Array:
        """Least clearance beyond margins of each of `link_pairs`, with sharp edges, shape (n, any) [m]."""
        return self._pair_clearances.of_groups(self.scene_configurations(qs, ts), near)

    def nearest_of_pairs(self, qs: Array, near: float, ts: Array | None = None) -> Array:
        """Least clearance of each pair beyond its margin, at most `near`, shape (num_pairs,) [m].

        Of all configurations with their times.
        """
        return self._pair_clearances.nearest(self.scene_configurations(qs, ts), near)

    def joint_placements(self, places: Array) -> Array:
        """Rotation and origin of each joint of the scene, shape (n, njoints, 3, 4) [m]."""
        return self._pair_clearances.joint_placements(places)

    def least(self, qs: Array, most: float = np.inf, ts: Array | None = None) -> Array:
        """Least clearance of all pairs beyond its margin, `most` where it is larger, shape (n,) [m]."""
        return self._pair_clearances.least(self.scene_configurations(qs, ts), most)

    def way(self, ends: Array, ranges: Array, reserve: float, seed: int, size: WaySize) -> Array | None:
        """Corners of a way between two configurations that keeps a reserve beyond all margins, or None.

        What moves by the time does not count. See `PairClearances.way`.
        """
        return self._still_clearances.way(ends, ranges, reserve, seed, size)

    @cached_property
    def _still(self) -> IntArray:
        """Pairs about things that do not move by the time."""
        moves = [self.pieces[k].motion is not None for _, k in self.pairs]
        return np.flatnonzero(~np.array([*moves, *[False] * len(self.sphere_pairs)], dtype=np.bool_))

    @cached_property
    def _still_clearances(self) -> PairClearances:
        if not self.movers:
            return self._pair_clearances
        frames = self._frames[: len(self._frames) - len(self.movers)]
        return self._pair_clearances.of_pairs(self._still, self.robot.model, frames)

    @cached_property
    def _groups(self) -> tuple[tuple[int, ...], ...]:
        """Pair of each row in each group of rows: about shapes that stand still, about others, about hulls.

        -1: of none. There is room for as many rows of chosen pairs as all have who have few.
        """
        kinds = self._by_kind(range(self.num_pairs) if self.chosen is None else self.chosen)
        slots = self._slots(kinds) if self.chosen is not None else [clearance_slots(len(k), 0) for k in kinds]
        return tuple((*kind, *[-1] * (n - len(kind))) for kind, n in zip(kinds, slots, strict=True))

    def _by_kind(self, pairs: Sequence[int]) -> tuple[list[int], ...]:
        every = np.array(pairs, dtype=np.intp)
        return tuple(every[self._kinds[every] == kind].tolist() for kind in range(3))

    @cached_property
    def _kinds(self) -> IntArray:
        """Of each pair: about a shape that stands still, about another, about a hull."""
        found = self._pair_clearances
        kinds = [2 if isinstance(s.core, HullCore) else int(s.place > 0) for s in found.shapes]
        return np.array(kinds, dtype=np.intp)[found.pairs[:, 1].astype(np.intp)]

    def _slots(self, kinds: Sequence[Sequence[int]]) -> list[int]:
        """How many rows there are of each kind for chosen pairs."""
        least = (_STILL_SLOTS, _MOVING_SLOTS, _HULL_SLOTS if self._hulls else 0)
        return [clearance_slots(len(kind), room) for kind, room in zip(kinds, least, strict=True)]

    def fill(self, chosen: Sequence[int], further: Sequence[int]) -> tuple[int, ...]:
        """Chosen pairs, and the first of further ones; a quarter of the rows that there are stays free."""
        kinds = self._by_kind(chosen)
        rooms = [max(3 * n // 4 - len(kind), 0) for kind, n in zip(kinds, self._slots(kinds), strict=True)]
        others = zip(self._by_kind(further), rooms, strict=True)
        return tuple(sorted([*chosen, *chain(*(more[:room] for more, room in others))]))

    @cached_property
    def _order(self) -> tuple[int, ...]:
        """Pair of each row."""
        return tuple(chain(*self._groups))

    @cached_property
    def term(self) -> ClearanceTerm:
        """Its structure, with its function."""
        still, moving, of_hulls = map(len, self._groups)
        slots = HullSlots.of(self._cores if of_hulls else [], of_hulls)
        count = len(self.movers)
        frames = self._frames[: len(self._frames) - count]
        return ClearanceTerm(frames, still, moving, slots, count, self._pieces)

    @property
    def _cores(self) -> list[HullCore]:
        """Of all hulls, or of those that have rows where there are many."""
        if len(self._hulls) <= _FEW_HULLS:
            return list(self._hulls.values())
        cores = [self._pair_clearances.row(k).core for k in self._order if k >= 0]
        return list({id(core): core for core in cores if isinstance(core, HullCore)}.values())

    @property
    def _pieces(self) -> int:
        """Room for the pieces of each motion: 1, 2, 4, 8, ... of them."""
        most = max((len(motion.times) for motion in self.movers), default=0)
        return 1 << (most - 1).bit_length() if most else 0

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return tuple(_IDLE if k < 0 else Label(f"distance of {self._words(k)}", "m") for k in self._order)

    @cached_property
    def _sphere_names(self) -> tuple[str, ...]:
        return tuple(f"{self._links[link].link}[{number}]" for link, number in self.spheres)

    def _words(self, pair: int) -> str:
        names = self._sphere_names
        if pair < len(self.pairs):
            a, k = self.pairs[pair]
            return f"{names[a]} from {self.pieces[k].name}"
        a, b = self.sphere_pairs[pair - len(self.pairs)]
        return f"{names[a]} from {names[b]}"

    @cached_property
    def lower(self) -> Array:
        """Least clearances, shape (rows,) [m]."""
        return self._of_rows(self.margins + self.reserves, -np.inf)

    def _of_rows(self, values: Array, idle: float) -> Array:
        """Values of pairs by rows, shape (..., rows)."""
        order = np.array(self._order, dtype=np.intp)
        return np.where(order < 0, idle, values[..., order])

    def sides_in_steps(
        self, num_steps: int, dt: float, limits: Mapping[str, tuple[Array, Array]] | None, *, is_inner: bool
    ) -> SidesInSteps | None:
        """Before the goal rows keep less, down to the room that it has itself."""
        if self.goal_room is None or not (self.reserves > self.goal_room).any():
            return None
        count = max(round(_BEFORE_GOAL * num_steps), 1)
        shares, least = np.arange(count)[::-1, None] / count, np.minimum(self.goal_room, self.reserves)
        lower = self._of_rows(self.margins + least + shares * (self.reserves - least), -np.inf)
        beyond = self._inner_radii if is_inner else 0.0
        return np.arange(num_steps - count, num_steps), lower + beyond, np.full(lower.shape, np.inf)

    @cached_property
    def upper(self) -> Array:
        """None, shape (rows,)."""
        return np.full(self.rows, np.inf)

    @property
    def _inner_radii(self) -> Array:
        """What distances of centres from cores have beyond clearances, shape (rows,) [m]."""
        return self._of_rows(self._pair_clearances.pairs[:, 2], 0.0)

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression: of distances of centres from cores."""
        return self.lower + self._inner_radii, self.upper

    @cached_property
    def numbers(self) -> dict[str, Array]:
        """Parameters by name."""
        idle, (kept, _) = ClearanceRow.idle(), self.inner_bounds
        rows = [
            idle if k < 0 else self._pair_clearances.row(k, x) for k, x in zip(self._order, kept, strict=True)
        ]
        if not self.movers:
            return self.term.numbers(rows)
        motions = np.hstack([motion.numbers(self._pieces) for motion in self.movers])
        return self.term.numbers(rows) | {"motions": motions.ravel(order="F")}

    def values(self, robot: Robot, q: Array, v: Array, at: float | None = None) -> Array:
        """Clearances at one state, shape (rows,) [m]."""
        return self.values_along(robot, q[None], v[None], v[None], None if at is None else np.array([at]))[0]

    def values_along(self, robot: Robot, qs: Array, vs: Array, us: Array, ts: Array | None = None) -> Array:
        """Clearances at each of n states, shape (n, rows) [m], by the expression that solvers see.

        Without times what moves by them is far away.
        """
        order = np.array(self._order, dtype=np.int64)
        found = np.full((len(qs), self.rows), _AWAY)
        pairs, places = np.unique(order[order >= 0], return_inverse=True)
        found[:, order >= 0] = self.pair_values(qs, ts=ts, pairs=pairs)[:, places]
        return found

    def values_in_motion(self, robot: Robot, nodes: MotionAtNodes) -> Array:
        """Clearances at the nodes, at their times."""
        return self.values_along(robot, *nodes.states, nodes.ts)

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values."""
        return np.ones_like(values)

    def refusal(self, values: Array, where: str) -> str:
        """Why a state of these clearances is refused, of what is worst; `where`: "start" or "goal"."""
        row = int((values - self.lower).argmin())
        pair = self._order[row]
        if pair < len(self.pairs):
            sphere, k = self.pairs[pair]
            subject, other = f"obstacle {self.obstacles[self.owners[k]].name!r}", "it"
        else:
            sphere, second = self.sphere_pairs[pair - len(self.pairs)]
            subject, other = "self_collision", self._links[self.spheres[second][0]].link
        link, number = self.spheres[sphere]
        name, size = self._links[link].link, f"{1e3 * abs(values[row]):.4g} mm"
        how = f"{size} inside {other}" if values[row] < 0.0 else f"{size} from {other}"
        margin = f", and the margin is {1e3 * self.lower[row]:.4g} mm" if self.lower[row] > 0.0 else ""
        return (
            f"{subject}: at the {where} {name} is {how} by its sphere {number}{margin}; move the {where} or "
            f"the obstacle, or give links closer spheres (mbocp spheres {self.robot.name})"
        )
