"""What each scheme takes, and what it can integrate: one table, which callers ask instead of names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

from mbocp._arrays import dataclass
from mbocp.integrators.pairs import PAIRS
from mbocp.integrators.tableaux import TABLEAUX

# Appendix B: where in its step a scheme looks at state and forces.
PROJECTED = "projected_midpoint"
TAU: Mapping[str, float] = MappingProxyType(
    {"se1": 1.0, "se2": 0.0, "midpoint": 0.5, "semi_implicit_euler": 0.0, PROJECTED: 0.5}
)
# Where in its step the velocity is that the configuration moves with.
VELOCITY_TAU: Mapping[str, float] = MappingProxyType({**TAU, "semi_implicit_euler": 1.0})
EULER_SCHEMES = tuple(name for name in TAU if name != PROJECTED)


@dataclass(frozen=True)
class SchemeData:
    """What a scheme takes, and what it can integrate.

    Attributes
    ----------
    order : int
        Of convergence with smooth controls.
    options : frozenset of str
        Keys of a problem file that say more of it; it would pass over others in silence.
    solves_constraints : bool
        Whether constraints are solved with each step; others project accelerations, and positions drift.
    takes_drives : bool
        Whether controls may prescribe velocities.
    takes_matrices : bool
        Whether attitudes may be rotation matrices.
    alternates : bool
        Whether its steps move by the mean of the velocities at both ends, or nearly so. Equations on
        positions at all nodes then leave velocities across them that change their sign from node to node.
    settles : bool
        Whether what is damped much faster than a step is at rest after it; else it rings from node to node.
    takes_holds : bool
        Whether constraints may begin and end along the way: their positions are solved at the end of a step.
    takes_loops : bool
        Whether robots may have holonomic constraints at all.
    takes_natural : bool
        Whether it integrates natural coordinates, too.
    projects : bool
        Whether velocities at the end of each step are projected onto the constraints.
    has_forces : bool
        Whether a step has one force for each constraint, which path constraints can bound.
    has_row_adjoints : bool
        Whether a solution's adjoints are the multipliers of its steps' rows, not duals of momenta at nodes.
    controls : tuple of str
        How controls may vary within a step, see `mbocp.integrators.controls`.
    """

    order: int
    options: frozenset[str]
    solves_constraints: bool
    takes_drives: bool
    takes_matrices: bool
    alternates: bool = False
    settles: bool = False
    takes_holds: bool = False
    takes_loops: bool = True
    takes_natural: bool = False
    projects: bool = False
    has_forces: bool = False
    has_row_adjoints: bool = False
    controls: tuple[str, ...] = ("constant",)

    def takes(self, key: str) -> bool:
        """Whether a key of a problem file, with its table, is one of the options."""
        return key in self.options


_TAU_FAMILY = SchemeData(
    1,
    frozenset(),
    solves_constraints=True,
    takes_drives=False,
    takes_matrices=False,
    has_forces=True,
)
_PARTITIONED = SchemeData(
    2,
    frozenset(),
    solves_constraints=True,
    takes_drives=False,
    takes_matrices=False,
    alternates=True,
    controls=("constant", "linear", "stages"),
)
_RUNGE_KUTTA = SchemeData(
    1,
    frozenset(
        (
            "integrator.lie",
            "integrator.substeps",
            "integrator.gamma_quaternion",
            "integrator.gamma_dcm",
            "integrator.gamma_constraint",
            "goal.guard",
            "goal.redundant",
        )
    ),
    solves_constraints=False,
    takes_drives=True,
    takes_matrices=True,
    has_row_adjoints=True,
)

SCHEMES: Mapping[str, SchemeData] = MappingProxyType(
    {
        name: replace(
            _TAU_FAMILY,
            order=1 + (tau == 0.5),
            alternates=tau == 0.5,
            settles=name == "se1",
            takes_holds=tau > 0.0,
            takes_natural=name != PROJECTED,
            projects=name == PROJECTED,
            has_row_adjoints=name == "se1",
            controls=("constant", "stages") if tau == 0.5 else ("constant",),  # it has one stage
        )
        for name, tau in VELOCITY_TAU.items()
    }
    | {
        name: replace(
            _PARTITIONED,
            order=pair.order,
            alternates=pair.is_symplectic,
            settles=not pair.is_symplectic,
            takes_loops=pair.holds_constraints,
            # One stage sees the mean of linear controls alone, whose ends could then alternate.
            controls=_PARTITIONED.controls if pair.num_stages > 1 else ("constant", "stages"),
        )
        for name, pair in PAIRS.items()
    }
    | {
        name: replace(_RUNGE_KUTTA, order=tableau.order, alternates=tableau.num_stages > 1)
        for name, tableau in TABLEAUX.items()
    }
)


def what_errs_less(scheme: str) -> str:
    """What to take where the steps of a scheme are too long for a motion."""
    data = SCHEMES.get(scheme)
    if data is not None and data.projects:
        return "more steps"
    one = f', as "{PROJECTED}"' if data is not None and data.takes_holds and data.order == 1 else ""
    return f"more steps, or a scheme of higher order{one}"


def schemes_that(does: Callable[[SchemeData], bool]) -> str:
    """Return the quoted names of the schemes of which something is true."""
    return ", ".join(f'"{name}"' for name, data in SCHEMES.items() if does(data))
