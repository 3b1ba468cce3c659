"""Nodes of one step's expression graph, Table 3 of [Manara2017]_.

Counted are the nodes of CasADi's graph (`Function.n_nodes`: operations, constants and inputs) of one step of
the classical Runge-Kutta method, from coordinates, speeds and controls to coordinates and speeds; the
exponential map at its end is counted apart, as in the paper. Both as the graph is written, and after common
subexpressions have been merged, which is what mbocp compiles.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from mbocp.integrators.chain import Chain
from mbocp.integrators.runge_kutta import CoordinateState, ExplicitStep, Gains
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.robot import Robot, load_robot
from mbocp_papers.layout import Column, PaperTable, Section
from mbocp_papers.so3.data import FORMULATIONS, Formulation

TITLE = "nodes of the graph of one step, classical Runge-Kutta"

_COLUMNS = (
    Column("formulation", "", "label"),
    Column("paper", "step", "paper"),
    Column("paper", "+ exp", "paper"),
    Column("mbocp", "step"),
    Column("mbocp", "+ exp"),
    Column("mbocp, merged", "step"),
    Column("mbocp, merged", "+ exp"),
    Column("ratio", "mbocp/paper", "ratio"),
    Column("ratio", "merged/paper", "ratio"),
)


@dataclass(frozen=True)
class StepNodes:
    """Nodes of a step.

    Attributes
    ----------
    step, merged_step : int
        Without the exponential at the end; as written, and with common subexpressions merged.
    exponential, merged_exponential : int
        Of the exponential map; 0 where there is none.
    """

    step: int
    exponential: int
    merged_step: int
    merged_exponential: int


def step_function(robot: Robot, formulation: Formulation, scheme: str = "rk4") -> ca.Function:
    """Step (z, s, u, h, gains) -> (z, s) of a robot as a CasADi function, as it is written."""
    mechanics = ForwardMechanics(robot, formulation.rotations)
    nz, ns, nu = mechanics.nq, mechanics.ns, mechanics.nu
    x, h, gains = ca.SX.sym("x", nz + ns + nu), ca.SX.sym("h"), ca.SX.sym("gains", 3)
    chain = Chain(x)
    root = chain.root()
    z, s, u = root.split(nz, ns, nu)
    before = CoordinateState(z, s)
    step = ExplicitStep(mechanics, scheme, formulation.lie, 1)
    after = step(chain, before, u, h, Gains(gains[0], gains[1], gains[2]))
    return ca.Function("step", [x, h, gains], [after.z.value, after.s.value])


def step_nodes(robot: Robot, formulation: Formulation) -> StepNodes:
    """Count the nodes of a step of a robot."""
    whole = step_function(robot, formulation)
    last = merged_last = 0
    if formulation.lie == "munthe_kaas":
        mechanics = ForwardMechanics(robot, formulation.rotations)
        z, w = ca.SX.sym("z", mechanics.nq), ca.SX.sym("w", mechanics.nv)
        exponential = ca.Function("exponential", [z, w], [ca.densify(mechanics.integrate(z, w))])
        last, merged_last = exponential.n_nodes(), _count_merged(exponential)
    return StepNodes(whole.n_nodes() - last, last, _count_merged(whole) - merged_last, merged_last)


def nodes_table() -> PaperTable:
    """Table 3."""
    robot = load_robot("unicycle_pendulum")
    found = {one.label: step_nodes(robot, one) for one in FORMULATIONS}
    rows = tuple((_row(one, found[one.label]),) for one in FORMULATIONS)
    return PaperTable(
        number=3,
        title=TITLE,
        columns=_COLUMNS,
        sections=(Section("", rows),),
        notes=(
            "Counted: all nodes of CasADi's graph from coordinates, speeds and controls to coordinates and "
            "speeds; of Munthe-Kaas's method the exponential at the end apart. Merged: common "
            "subexpressions once, as compiled.",
            "The equations of motion come from the robot's URDF by Pinocchio's algorithms; the paper's are "
            "written by hand for this system.",
        ),
        data={one.label: {"paper": list(one.nodes), **vars(found[one.label])} for one in FORMULATIONS},
    )


def _count_merged(function: ca.Function) -> int:
    inputs = function.sx_in()
    merged = ca.Function(function.name(), inputs, ca.cse(list(function.call(inputs))))
    return int(merged.n_nodes())


def _row(one: Formulation, found: StepNodes) -> tuple[str, ...]:
    paper = sum(one.nodes)
    return (
        one.label,
        str(one.nodes[0]),
        _apart(one.nodes[1] if len(one.nodes) > 1 else 0),
        str(found.step),
        _apart(found.exponential),
        str(found.merged_step),
        _apart(found.merged_exponential),
        f"{(found.step + found.exponential) / paper:.2f}",
        f"{(found.merged_step + found.merged_exponential) / paper:.2f}",
    )


def _apart(count: int) -> str:
    return str(count) if count else ""
