"""Spheres that stand for a robot's links: given ones, those of its file, or fitted to its shapes and kept."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, freeze
from mbocp.robot import kinematics
from mbocp.robot.collision.covering_spheres import Cover, cover, protrusions
from mbocp.robot.collision.fit_cache import load_or_fit
from mbocp.robot.collision.geometry import CollisionSphere
from mbocp.robot.collision.solid import Solid, box_around, surface_points

_TOLERANCE = 0.03  # of the robot's size: how far fitted spheres may stick out
_MOST = 8  # spheres of a link
_CHECKED = 8000  # points of a link that are looked at once more
_OTHER = 1_000_003  # where the sequence of these points starts
_TOLD_GAP = 1e-3  # [m]
_SLACK = 1.005  # of radii, for what lies between the points


@dataclass(frozen=True, eq=False)
class LinkSpheres:
    """Spheres of one link.

    Attributes
    ----------
    link : str
        Name of its frame.
    frame : int
        Index of the frame, in which the centres are.
    joint : int
        Index of the joint that moves it; 0: it stands still.
    centers : ndarray, shape (k, 3)
        [m].
    radii : ndarray, shape (k,)
        [m].
    origin : str
        "given" (robot.toml), "urdf" (its shapes are spheres) or "fitted".
    sticks_out : float
        How far the spheres reach beyond the link's shapes at most [m]; NaN where it has none.
    uncovered : float
        Part of the shapes' surface and inside that no sphere covers, of points that were looked at; NaN where
        there are no shapes.
    gap : float
        How far such a point is from the nearest sphere at most [m]; 0 where all are covered.
    """

    link: str
    frame: int
    joint: int
    centers: Array
    radii: Array
    origin: str
    sticks_out: float
    uncovered: float
    gap: float

    def __post_init__(self) -> None:
        freeze(self, "centers", (None, 3), "centers")
        freeze(self, "radii", (len(self.centers),), "radii")

    @property
    def words(self) -> str:
        """What given spheres leave of a link, in a sentence; empty where that is next to nothing."""
        if self.origin != "given" or not self.gap > _TOLD_GAP:
            return ""
        return f"the given spheres leave {100.0 * self.gap:.2g} cm of {self.link} uncovered"


def link_spheres(
    model: pin.Model, geometry: pin.GeometryModel, given: Sequence[CollisionSphere], q: Array, robot: str
) -> tuple[LinkSpheres, ...]:
    """Spheres of all links that have shapes or given spheres, in the order of the frames.

    Parameters
    ----------
    model : pin.Model
    geometry : pin.GeometryModel
        From `read_geometry`.
    given : sequence of CollisionSphere
        They take the place of the shapes of their link.
    q : ndarray, shape (nq,)
        Pose in which the robot's size is measured.
    robot : str
        Name for messages.

    Returns
    -------
    tuple of LinkSpheres
        The same for the same robot.
    """
    shapes: dict[int, list[pin.GeometryObject]] = {}
    for shape in geometry.geometryObjects:
        shapes.setdefault(int(shape.parentFrame), []).append(shape)
    own: dict[int, list[CollisionSphere]] = {}
    for sphere in given:
        own.setdefault(kinematics.frame_id(model, sphere.frame, robot), []).append(sphere)
    tolerance = _TOLERANCE * _size(model, geometry, q) if shapes else 0.0
    return tuple(
        _of_link(model, frame, shapes.get(frame, []), own.get(frame, []), tolerance)
        for frame in sorted({*shapes, *own})
    )


def _of_link(
    model: pin.Model,
    frame: int,
    shapes: Sequence[pin.GeometryObject],
    given: Sequence[CollisionSphere],
    tolerance: float,
) -> LinkSpheres:
    placement = model.frames[frame].placement
    own = np.array([[*sphere.center, sphere.radius] for sphere in given])
    numbers = [own, np.asarray(placement.homogeneous), np.array(tolerance)]
    found = load_or_fit(shapes, numbers, partial(_fit, placement, shapes, given, tolerance))
    sticks_out, uncovered, gap = map(float, found["measures"])
    return LinkSpheres(
        link=model.frames[frame].name,
        frame=frame,
        joint=int(model.frames[frame].parentJoint),
        centers=(found["centers"] - placement.translation) @ placement.rotation,
        radii=found["radii"],
        origin=str(found["origin"]),
        sticks_out=sticks_out,
        uncovered=uncovered,
        gap=gap if gap > _ROUND_OFF or np.isnan(gap) else 0.0,
    )


def _fit(
    placement: pin.SE3,
    shapes: Sequence[pin.GeometryObject],
    given: Sequence[CollisionSphere],
    tolerance: float,
) -> dict[str, Array]:
    """Spheres of a link in the axes of its joint, where they come from, and how well they cover."""
    solid = Solid.of(shapes) if shapes else None
    origin, made = _cover_link(placement, shapes, given, solid, tolerance)
    sticks_out = uncovered = gap = np.nan
    if solid is not None:
        sticks_out = float(protrusions(made, solid).max()) if origin != "urdf" else 0.0
        gaps = made.gaps(_sample_points(shapes, solid, 2 * _OTHER))
        uncovered, gap = float((gaps > _ROUND_OFF).mean()), float(gaps.max())
    measures = np.array([sticks_out, uncovered, gap])
    return {"centers": made.centers, "radii": made.radii, "origin": np.array(origin), "measures": measures}


def _cover_link(
    placement: pin.SE3,
    shapes: Sequence[pin.GeometryObject],
    given: Sequence[CollisionSphere],
    solid: Solid | None,
    tolerance: float,
) -> tuple[str, Cover]:
    """Where the spheres of a link come from, and the spheres in the axes of its joint."""
    if given or solid is None:
        centers = np.array([placement.act(np.array(sphere.center)) for sphere in given])
        return "given", Cover(centers, np.array([sphere.radius for sphere in given]))
    if all(isinstance(shape.geometry, coal.Sphere) for shape in shapes):
        centers = np.array([shape.placement.translation for shape in shapes])
        return "urdf", Cover(centers, np.array([shape.geometry.radius for shape in shapes]))
    made = cover(solid, tolerance, _MOST).enlarge(_sample_points(shapes, solid, _OTHER))
    return "fitted", Cover(made.centers, made.radii * _SLACK)


_ROUND_OFF = 1e-9  # [m]


def _sample_points(shapes: Sequence[pin.GeometryObject], solid: Solid, start: int) -> Array:
    """Points on the surface and inside."""
    share = max(_CHECKED // len(shapes), 500)
    return np.vstack([*(surface_points(shape, share, start) for shape in shapes), solid.inner])


def _size(model: pin.Model, geometry: pin.GeometryModel, q: Array) -> float:
    """Diagonal of the box around all shapes [m]."""
    data, drawn = model.createData(), pin.GeometryData(geometry)
    pin.updateGeometryPlacements(model, data, geometry, drawn, np.array(q))
    corners = []
    for shape, place in zip(geometry.geometryObjects, drawn.oMg, strict=True):
        corners += [place.act(corner) for corner in box_around(shape.geometry)]
    return float(np.linalg.norm(np.ptp(np.array(corners), axis=0)))
