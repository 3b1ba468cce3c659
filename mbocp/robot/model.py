"""The data of a robot: its parts, sizes, names and labels."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray, dataclass, freeze, frozen_array
from mbocp.exceptions import InvalidValue, UnknownJoint
from mbocp.robot import joints, kinematics
from mbocp.robot.collision.geometry import CollisionSphere, ShapeSource
from mbocp.robot.joints import JointPlace
from mbocp.robot.loops.kinds.constraint import Constraint
from mbocp.robot.parts import (
    Actuation,
    Connector,
    Drive,
    Label,
    Limits,
    Motor,
    QuarticSpring,
    Rotations,
    SpringDamper,
)
from mbocp.robot.payload import LinkInertia, Payload
from mbocp.robot.placed import PlacedRobot
from mbocp.robot.resistance import ElasticJoint, JointResistance
from mbocp.robot.robot_files import RobotFiles
from mbocp.robot.wheels import find_wheels
from mbocp.symbolic.algorithms import text_without
from mbocp.symbolic.model_numbers import (
    ModelNumber,
    inertia_numbers,
    numbers_of_model,
    placement_numbers,
    placements_of_followers,
    translation_numbers,
    values_of,
)

_VELOCITY_UNITS = {"m": "m/s", "rad": "rad/s"}
_MOMENTUM_UNITS = {"m": "N s", "rad": "N m s"}


@dataclass(frozen=True, eq=False, repr=False)
class RobotModel:
    """Data of a multibody system: joints and inertias, actuation, constraints, force elements.

    Parameters
    ----------
    name : str
        Name for messages and files.
    model : pin.Model
        Tree of joints and inertias, after locking, with gravity set. Not to be changed.
    visual_model : pin.GeometryModel
        Shapes and paths of the meshes that were found. The `geometry` of a mesh is an empty placeholder.
    actuation : Actuation
        B(q).
    constraints : tuple of Constraint
        Phi(q) = 0, see `mbocp.robot.loops.constraints`.
    forces : tuple of QuarticSpring or SpringDamper
        f(q, v).
    q0 : ndarray, shape (nq,)
        Initial pose [m, rad, unit quaternion xyzw].
    limits : Limits
        Bounds on u, v and q.
    source : Path or None
        File that its model was read from.
    trace_frames : tuple of str
        Frames that a replay traces by default.
    connectors : tuple of Connector
        What a replay draws between frames: rods and springs.
    spec : dict
        What `robot_from_spec` needs to load this robot again; JSON-able.
    description : str
        One line for a person.
    rotations : {"quaternion", "dcm"}
        How explicit schemes represent the rotations of free-flyers and ball joints in their state: four
        numbers or the nine of a direction cosine matrix. q has the quaternion in either case.
    redundant_rows : tuple of int
        Rows that the equations leave out because the others imply them; counted over all constraints.
    resistances : tuple of JointResistance
        Damping and friction of joints: the part of f(q, v) that acts on one velocity each.
    elastic : tuple of ElasticJoint
        Springs between joints and their motors.
    motors : tuple of Motor
        Motors with gears; `model`, `actuation` and `limits` have these already.
    payloads : tuple of Payload
        Bodies that it carries; `model` and `visual_model` have them already.
    parts : tuple of PlacedRobot
        Robots that it is made of; empty for a single one.
    shapes : tuple of ShapeSource
        What its files say of the shapes of links.
    given_spheres : tuple of CollisionSphere
        What stands for the shapes of some frames, see `Robot.collision_spheres`.
    decided_by_locks : tuple of ModelNumber
        Numbers of `model` that the values of locked joints decide, where options lock them.
    link_inertias : tuple of LinkInertia
        Masses and inertias of links that its file does not give; `model` has them already.
    opened : tuple of ModelNumber
        Numbers that functions take as parameters in any case, see `mbocp.robot.named_numbers`.
    stored : RobotFiles, optional
        The files it was loaded from, if they came with a result; they keep their temporary folder.
    """

    name: str
    model: pin.Model
    visual_model: pin.GeometryModel
    actuation: Actuation
    constraints: tuple[Constraint, ...]
    forces: tuple[QuarticSpring | SpringDamper, ...]
    q0: Array
    limits: Limits
    source: Path | None = None
    trace_frames: tuple[str, ...] = ()
    connectors: tuple[Connector, ...] = ()
    spec: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""
    rotations: str = "quaternion"
    redundant_rows: tuple[int, ...] = ()
    resistances: tuple[JointResistance, ...] = ()
    elastic: tuple[ElasticJoint, ...] = ()
    motors: tuple[Motor, ...] = ()
    payloads: tuple[Payload, ...] = ()
    parts: tuple[PlacedRobot, ...] = ()
    shapes: tuple[ShapeSource, ...] = ()
    given_spheres: tuple[CollisionSphere, ...] = ()
    decided_by_locks: tuple[ModelNumber, ...] = ()
    link_inertias: tuple[LinkInertia, ...] = ()
    opened: tuple[ModelNumber, ...] = ()
    stored: RobotFiles | None = None

    def __post_init__(self) -> None:
        if self.rotations not in (known := get_args(Rotations)):
            raise InvalidValue.of_choice(f"robot {self.name!r}: rotations", self.rotations, known)
        freeze(self, "q0", (self.nq,), f"{self.name}: q0")
        frozen_array(
            self.actuation.selection, shape=(self.nv, None), name=f"{self.name}: actuation.selection"
        )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, nq={self.nq}, nv={self.nv}, nu={self.nu}, nc={self.nc})"

    # Dimensions and names

    @property
    def nq(self) -> int:
        """Length of q."""
        return int(self.model.nq)

    @property
    def nv(self) -> int:
        """Length of v and p."""
        return int(self.model.nv)

    @property
    def nu(self) -> int:
        """Number of controls."""
        return self.actuation.nu

    @property
    def nc(self) -> int:
        """Number of rows of the holonomic constraints that the equations keep."""
        return len(self.kept_rows)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, without the universe."""
        return joints.joint_names(self.model)

    @cached_property
    def joint_places(self) -> tuple[JointPlace, ...]:
        """Where the joints with numbers of their own are in q and v."""
        return joints.joint_places(self.model)

    @cached_property
    def unit_groups(self) -> tuple[tuple[str, slice], ...]:
        """Joint name and range in q of each unit vector (quaternion or cos/sin pair)."""
        return joints.unit_groups(self.model)

    @cached_property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames; "world" also means the first, the universe."""
        return tuple(frame.name for frame in self.model.frames)

    @cached_property
    def single(self) -> tuple[IntArray, IntArray]:
        """Where joints of one coordinate and one velocity have them: in q, and in v."""
        found = [(joint.idx_q, joint.idx_v) for joint in self.model.joints[1:] if joint.nq == joint.nv == 1]
        at_q, at_v = np.array(found, dtype=np.intp).reshape(-1, 2).T
        return at_q, at_v

    @cached_property
    def q_labels(self) -> tuple[Label, ...]:
        """Name and unit of each number of q."""
        return joints.position_labels(self.model)

    @cached_property
    def move_labels(self) -> tuple[Label, ...]:
        """Name and unit of each direction in which q moves, shape (nv,)."""
        return joints.move_labels(self.model)

    @cached_property
    def v_labels(self) -> tuple[Label, ...]:
        """Name and unit of each number of v."""
        return joints.velocity_labels(self.model, _VELOCITY_UNITS)

    @cached_property
    def p_labels(self) -> tuple[Label, ...]:
        """Name and unit of each number of p."""
        return joints.velocity_labels(self.model, _MOMENTUM_UNITS)

    @property
    def u_labels(self) -> tuple[Label, ...]:
        """Name and unit of each control."""
        return self.actuation.labels

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Controls that prescribe a motion."""
        return self.actuation.drives

    @cached_property
    def driven(self) -> tuple[int, ...]:
        """Velocity components that drives move, in ascending order."""
        return tuple(sorted(dof for drive in self.drives for dof in drive.dofs))

    @cached_property
    def undriven(self) -> tuple[int, ...]:
        """Velocity components that no drive moves, in ascending order."""
        return tuple(dof for dof in range(self.nv) if dof not in self.driven)

    @property
    def num_speeds(self) -> int:
        """Number of speeds s: components that no drive moves, and drives whose control is an acceleration."""
        return self.nv - len(self.driven) + sum(drive.has_state for drive in self.drives)

    @cached_property
    def speed_labels(self) -> tuple[Label, ...]:
        """Name and unit of each speed; those of v if there are no drives."""
        stated = (Label(drive.name, drive.speed_unit) for drive in self.drives if drive.has_state)
        return (*(self.v_labels[dof] for dof in self.undriven), *stated)

    @cached_property
    def closure_labels(self) -> tuple[Label, ...]:
        """Name and unit of each row of the constraints, the redundant ones included."""
        return tuple(label for constraint in self.constraints for label in constraint.rows)

    @cached_property
    def constraint_rows(self) -> tuple[range, ...]:
        """Rows of each constraint among those of all, the redundant ones included."""
        ends = accumulate((len(constraint.rows) for constraint in self.constraints), initial=0)
        return tuple(range(*pair) for pair in pairwise(ends))

    @cached_property
    def kept_rows(self) -> tuple[int, ...]:
        """Rows of the constraints that the equations keep, counted over all constraints in order."""
        return tuple(i for i in range(len(self.closure_labels)) if i not in self.redundant_rows)

    @cached_property
    def constraint_labels(self) -> tuple[Label, ...]:
        """Name and unit of each row that the equations keep."""
        return tuple(self.closure_labels[i] for i in self.kept_rows)

    @cached_property
    def is_vector_space(self) -> bool:
        """Whether every joint's configuration is a plain vector (nq == nv, no circles, no quaternions)."""
        return all(joints.joint_kind(self.model, j).is_vector for j in range(1, self.model.njoints))

    @cached_property
    def turns(self) -> Array:
        """Angle [rad] by unit of each component of v, shape (nv,); 0: it turns nothing, or a wheel."""
        return frozen_array(np.where(self.wheels, 0.0, kinematics.turns(self.model)))

    @cached_property
    def wheels(self) -> BoolArray:
        """Which components of v turn what nothing depends on the angle of, shape (nv,)."""
        if self.forces or self.elastic or self.constraints:
            return np.zeros(self.model.nv, dtype=np.bool_)
        return find_wheels(self.model, self.limits.position_lower, self.limits.position_upper)

    @cached_property
    def angular(self) -> tuple[int, ...]:
        """Components of v that turn what a step has to resolve: no wheels, but on a circle, of one turn."""
        turning = (i for i, label in enumerate(self.v_labels) if label.unit == "rad/s")
        lines = set(self.single[1].tolist())
        return tuple(i for i in turning if not self.wheels[i] or i not in lines)

    @property
    def sources(self) -> tuple[Path, ...]:
        """The files that its model was read from."""
        found = [self.source, *(part.source for part in self.parts)]
        return tuple(dict.fromkeys(path for path in found if path is not None))

    @property
    def has_forces(self) -> bool:
        """Whether springs, dampers or losses of joints act."""
        return bool(self.forces or self.resistances or self.elastic)

    @property
    def has_limits(self) -> bool:
        """Whether any effort, velocity or position is limited."""
        return self.limits.any_finite

    @cached_property
    def varying(self) -> tuple[ModelNumber, ...]:
        """Numbers of the model that functions may take as parameters, in rising order.

        Inertias of bodies that carry a payload and of parts that are simple bodies, where the frames of
        payloads are, what the values of joints decide that options lock, and `opened`.
        """
        frames = [kinematics.frame_id(self.model, payload.name, self.name) for payload in self.payloads]
        turns = [place for place, payload in zip(frames, self.payloads, strict=True) if payload.orientation]
        carrying = {int(self.model.frames[frame].parentJoint) for frame in frames}
        return tuple(
            sorted(
                {
                    *(n for body in carrying | self._object_bodies() for n in inertia_numbers(body)),
                    *(n for frame in frames for n in translation_numbers(frame)),
                    *(n for frame in turns for n in placement_numbers(frame)),
                    *self.decided_by_locks,
                    *self.opened,
                    *placements_of_followers(self.model, sorted(frames), self.decided_by_locks),
                }
            )
        )

    def _object_bodies(self) -> set[int]:
        """Joints that move the parts that are simple bodies."""
        prefixes = tuple(part.prefix for part in self.parts if part.is_object)
        return {
            int(frame.parentJoint)
            for frame in (self.model.frames if prefixes else ())
            if frame.name.startswith(prefixes) and frame.type == pin.FrameType.BODY
        } - {0}

    @cached_property
    def varying_values(self) -> Array:
        """What these numbers are, shape (len(varying),) [kg, m, kg m^2]."""
        return frozen_array(self.values_of(self.varying))

    def values_of(self, numbers: Sequence[ModelNumber]) -> Array:
        """What some of its numbers are, shape (len(numbers),)."""
        of_model = numbers_of_model(numbers)
        known = dict(zip(of_model, values_of(self.model, of_model), strict=True))
        for number in numbers:
            if number.of in ("force", "motor", "resistance"):
                of_all = {"force": self.forces, "motor": self.motors, "resistance": self.resistances}
                element: Any = of_all[number.of][number.owner]
                known[number] = getattr(element, list(element.units)[number.entry])
            elif number.of == "payload":
                payload = self.payloads[number.owner]
                known[number] = (payload.mass, *payload.com, *payload.inertia)[number.entry]
        return np.array([known[number] for number in numbers], dtype=np.float64)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 over all that shapes the equations: model, actuation, constraints, forces, losses."""
        return self._digest(
            self.model.saveToString(), self.forces, self.actuation.selection, self.resistances
        )

    @cached_property
    def shape_fingerprint(self) -> str:
        """The same without the values of the numbers that vary; robots with none have one fingerprint."""
        if not self.varying:
            return self.fingerprint
        selection = np.array(self.actuation.selection)
        for motor in self.opened_motors:
            selection[motor.dof, motor.column] = np.nan
        text = text_without(self.model_without_rotors, numbers_of_model(self.varying))
        if self.opened_motors:
            text += repr(self._mask_parameters("motor", self.motors))
        return self._digest(
            text,
            self._mask_parameters("force", self.forces),
            selection,
            self._mask_parameters("resistance", self.resistances),
        )

    @property
    def opened_motors(self) -> tuple[Motor, ...]:
        """Motors of which functions take a number as a parameter."""
        return tuple(self.motors[k] for k in sorted({n.owner for n in self.opened if n.of == "motor"}))

    @property
    def found_gears(self) -> tuple[Motor, ...]:
        """Motors whose gear ratio is such a parameter."""
        return tuple(self.motors[n.owner] for n in self.opened if n.of == "motor" and n.entry == 0)

    @cached_property
    def model_without_rotors(self) -> pin.Model:
        """Model without the rotors of such motors."""
        if not self.opened_motors:
            return self.model
        model, armature = pin.Model(self.model), np.array(self.model.armature)
        armature[[motor.dof for motor in self.opened_motors]] = 0.0
        model.armature = armature
        return model

    def _mask_parameters(self, of: str, elements: Sequence[Any]) -> object:
        """Springs or motors without the numbers that functions take."""
        opened = {(number.owner, number.entry) for number in self.opened if number.of == of}
        if not opened:
            return elements
        return [
            [element.kind, *element.place]
            + [None if (k, i) in opened else getattr(element, key) for i, key in enumerate(element.units)]
            for k, element in enumerate(elements)
        ]

    def _digest(self, model: str, forces: object, selection: Array, resistances: object) -> str:
        digest = hashlib.sha256(model.encode())
        digest.update(selection.tobytes())
        for actuator in self.actuation.frame_actuators:
            digest.update(repr(actuator.frame_id).encode() + actuator.direction.tobytes())
        digest.update(repr((self.actuation.labels, self.constraints, forces)).encode())
        if self.redundant_rows:
            digest.update(repr(self.redundant_rows).encode())
        if self.resistances:
            digest.update(repr(resistances).encode())
        if self.elastic:
            digest.update(repr(self.elastic).encode())
        for drive in self.drives:
            digest.update(
                repr((drive.control, drive.dofs, drive.frame_id)).encode() + drive.direction.tobytes()
            )
        return digest.hexdigest()

    def frame_id(self, name: str) -> int:
        """Index of a frame by name; "world" is the universe. Bodies come before joints of the same name.

        Raises
        ------
        UnknownFrame
            If there is no such frame.
        """
        return kinematics.frame_id(self.model, name, self.name)

    def unknown_joint(self, name: str, valid: Iterable[str]) -> UnknownJoint:
        """Error for a name that is none of the valid ones, and what it is instead."""
        return UnknownJoint(name, self.name, valid, joints.why_without_numbers(self.model, name))

    def configuration_indices(self, joint: str) -> slice:
        """Range of a joint in q (empty for a mimic joint). Raises `UnknownJoint`."""
        return joints.configuration_slice(self.model, joints.joint_id(self.model, joint, self.name))

    def velocity_indices(self, joint: str) -> slice:
        """Range of a joint in v and p (empty for a mimic joint). Raises `UnknownJoint`."""
        return joints.velocity_slice(self.model, joints.joint_id(self.model, joint, self.name))

    def joints_with(self, chosen: BoolArray) -> list[str]:
        """Names of the joints that have a velocity among the chosen ones, shape (nv,)."""
        return [name for name in self.joint_names if chosen[self.velocity_indices(name)].any()]
