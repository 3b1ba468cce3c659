r"""What schemes keep over many steps without controls: `python -m benchmarks.invariants`.

Robots without losses move without controls for 100,000 steps, simulated by the kernel in parts of 10,000,
each from where the one before ended. Errors of the energy are told in the first tenth and in the last, by
their largest value and by their mean, as parts of the largest kinetic energy: a scheme that drifts has a
larger last tenth, or a mean that moves. Momenta that a symmetry keeps are those of the first 10,000 steps, as
parts of the largest component of momentum that there is, kept or not. They are told for steps as they are,
whose states are rounded, and whose errors add up like a random walk; and for compensated steps, of which
each takes what rounding left of the one before (section VIII.5 of [Hairer2006]_). Energies are those of the
latter.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, present, show
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.guesses.make import guess_by_simulation
from mbocp.integrators import PAIRS
from mbocp.problem import Problem
from mbocp.robot import Robot

__all__ = ["SCHEMES", "SYSTEMS", "Drift", "Free", "drift_of", "drift_table", "moved"]

_PAGE = Path(__file__).parent / "measured" / "invariants.md"
_BEGIN = "<!-- tables: python -m benchmarks.invariants --docs -->"
_TO_ROUND_OFF = 1e-15  # residual of a step in its unit of force; a guess is simulated to 1e-12
_PART = 10_000  # steps of one simulation: all of them would take gigabytes
SCHEMES = ("midpoint", "gauss1", "lobatto2", "gauss2", "lobatto3", "gauss3")


@dataclass(frozen=True)
class Free:
    """A robot that moves by itself.

    Attributes
    ----------
    name : str
    make : callable
        The robot, without losses.
    dt : float
        Length of a step [s].
    v : tuple of float
        Velocity that the motion begins with [rad/s, m/s]; on loops the nearest that they allow.
    q : tuple of float
        How far the start is from `Robot.q0`, in its tangent.
    momenta : callable
        Momenta of a robot at a state.
    kept : tuple of int
        Which of them stay.
    """

    name: str
    make: Callable[[], Robot]
    dt: float
    v: tuple[float, ...]
    q: tuple[float, ...] = ()
    momenta: Callable[[Robot, Array, Array], Array] | None = None
    kept: tuple[int, ...] = ()

    def start(self, robot: Robot) -> tuple[Array, Array]:
        """Configuration and velocity."""
        q = robot.integrate(robot.q0, np.array(self.q)) if self.q else np.asarray(robot.q0)
        v = np.array(self.v)
        if self.momenta is _of_body:  # its centre of mass at rest: round-off of forces turns by no long lever
            v[:3] = -np.cross(v[3:], robot.model.inertias[1].lever)
        return q, _allowed(robot, q, v)


@dataclass(frozen=True)
class Drift:
    """Errors of the energy, as parts of the largest kinetic energy, and of momenta, as parts of the largest.

    Attributes
    ----------
    first, last : float
        Largest error of the energy in the first tenth of the steps and in the last.
    moved : float
        What the mean error of the last tenth differs from that of the first by.
    momentum : float
        Largest change of a momentum that stays, over the first part; NaN where there is none.
    rounded : float
        The same by steps that are not compensated.
    """

    first: float
    last: float
    moved: float
    momentum: float
    rounded: float


def _body(gravity: float) -> Robot:
    """A free body with three different moments of inertia, its centre of mass off its origin."""
    load = {"name": "load", "frame": "base_link", "mass": 10.0, "com": [0.1, 0.2, -0.3], "box": [1, 2, 3]}
    body = mbocp.load_robot(
        "hector", gravity=[0.0, 0.0, -gravity], actuated=["root_joint"], payload=[load], damping=False
    )
    return replace(body, resistances=())


def _allowed(robot: Robot, q: Array, v: Array) -> Array:
    """The nearest velocity that the constraints allow: by the midpoint rule those of nodes are off."""
    if not robot.nc:
        return v
    jacobian = robot.constraint_jacobian(q)
    found: Array = v - np.linalg.pinv(jacobian) @ jacobian @ v
    return found


def _lossless(name: str) -> Robot:
    return replace(mbocp.load_robot(name), resistances=())


def _of_body(robot: Robot, q: Array, v: Array) -> Array:
    """Linear and angular momentum in the world."""
    found: Array = pin.XYZQUATToSE3(q[:7]).act(pin.Force(robot.momentum(q, v))).vector
    return found


def _of_base(robot: Robot, q: Array, v: Array) -> Array:
    """Of the first joint, whose axis is vertical."""
    return robot.momentum(q, v)[:1]


_ALL = tuple(range(6))
_TURNING = (0.0, 0.0, 0.0, 0.5, 1.2, -0.7)
SYSTEMS = (
    Free("rigid body, no gravity", lambda: _body(0.0), 0.02, _TURNING, momenta=_of_body, kept=_ALL),
    # A thousandth of a m/s^2: in 2000 s a body falls by 20,000 km otherwise, out of all digits.
    Free("rigid body, falling", lambda: _body(1e-3), 0.02, _TURNING, momenta=_of_body, kept=(0, 1, 5)),
    Free("four_bar", lambda: _lossless("four_bar"), 0.01, (1.0, 1.0, 1.0)),
    Free(
        "ur5",
        lambda: _lossless("ur5"),
        0.005,
        (0.3, 0.2, -0.2, 0.1, 0.1, 0.1),
        (0.0, 1.4, 0.2, 0.1, 0.1, 0.1),
        momenta=_of_base,
        kept=(0,),
    ),
)


def moved(
    robot: Robot, scheme: str, dt: float, q: Array, v: Array, num_steps: int, *, compensated: bool = True
) -> tuple[Array, Array]:
    """Configurations and velocities of all nodes without controls, compensated sums of rounding or not."""
    problem = Problem.create(
        robot,
        num_steps * dt,
        num_steps,
        start={"q": q, "v": v},
        goal={"v": np.zeros(robot.nv), "enforce": "penalty"},
        cost={"effort": 1.0, "terminal": 1.0},
        scheme=scheme,
    )
    formulation = formulate(problem)
    iterate = guess_by_simulation(
        formulation, np.zeros(robot.nu), tolerance=_TO_ROUND_OFF, compensated=compensated
    )
    found = formulation.motion_of(iterate)
    return found.qs, found.vs


def drift_of(system: Free, scheme: str, *, parts: int = 10, part: int = _PART) -> Drift:
    """Drifts over `parts` times `part` steps."""
    robot = system.make()
    q, v = system.start(robot)
    errors, largest, change = [], 0.0, np.nan
    energy, _ = _energies(robot, q[None], v[None])
    for k in range(parts):
        qs, vs = moved(robot, scheme, system.dt, q, v, part)
        if k == 0:
            change = _change(system, robot, qs, vs)
        total, kinetic = _energies(robot, qs, vs)
        errors.append(total - energy[0])
        largest = max(largest, float(kinetic.max()))
        q, v = qs[-1], _allowed(robot, qs[-1], vs[-1])
    first, last = errors[0] / largest, errors[-1] / largest
    plain = moved(robot, scheme, system.dt, *system.start(robot), part, compensated=False)
    return Drift(
        float(np.abs(first).max()),
        float(np.abs(last).max()),
        float(abs(last.mean() - first.mean())),
        change,
        _change(system, robot, *plain),
    )


def _change(system: Free, robot: Robot, qs: Array, vs: Array) -> float:
    """Largest change of momenta that stay, as a part of the largest that there is; NaN where none stays."""
    if system.momenta is None:
        return np.nan
    momenta = np.array([system.momenta(robot, *state) for state in zip(qs, vs, strict=True)])
    kept = momenta[:, list(system.kept)]
    return float(np.abs(kept - kept[0]).max() / np.abs(momenta).max())


def _energies(robot: Robot, qs: Array, vs: Array) -> tuple[Array, Array]:
    """Mechanical and kinetic energy of each state [J]."""
    model, data = robot.model, robot.model.createData()
    pairs = list(zip(qs, vs, strict=True))
    total = [pin.computeMechanicalEnergy(model, data, q, v) for q, v in pairs]
    return np.array(total), np.array([pin.computeKineticEnergy(model, data, q, v) for q, v in pairs])


def _schemes_of(robot: Robot) -> Iterator[str]:
    for scheme in SCHEMES:
        if not robot.nc or scheme not in PAIRS or PAIRS[scheme].holds_constraints:
            yield scheme


def drift_table(
    systems: Sequence[Free] = SYSTEMS, schemes: Sequence[str] = SCHEMES, *, told: bool = False
) -> Table:
    """One row for each system and scheme."""
    rows = []
    for system in systems:
        for scheme in _schemes_of(system.make()):
            if scheme not in schemes:
                continue
            found = drift_of(system, scheme)
            rows.append(
                (
                    system.name,
                    scheme,
                    f"{system.dt:g}",
                    *(f"{value:.1e}" for value in (found.first, found.last, found.moved)),
                    *(f"{x:.1e}" if np.isfinite(x) else "" for x in (found.momentum, found.rounded)),
                )
            )
            if told:
                print(*rows[-1], flush=True)
    columns = (
        "robot", "scheme", "step [s]", "energy, first tenth", "last tenth", "its mean moves by",
        "momentum, 10,000 steps", "not compensated",
    )  # fmt: skip
    return Table("Energy over 100,000 steps, momenta over 10,000", columns, rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or put it into the measured ones."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.invariants", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--docs", action="store_true", help=f"write the table into measured/{_PAGE.name}")
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--schemes", nargs="*", default=SCHEMES)
    parser.add_argument("names", nargs="*", help="of the robots; all, if there are none")
    options = parser.parse_args(arguments)
    one_core()
    systems = [system for system in SYSTEMS if not options.names or system.name in options.names]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # joints turn as they like, beyond their limits
        table = drift_table(systems, options.schemes, told=True)
    if options.docs:
        present([header(), table], _PAGE, _BEGIN, into_page=True)
    else:
        show(table, markdown=options.markdown)


if __name__ == "__main__":
    main()
