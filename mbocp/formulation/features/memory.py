r"""Controls, accelerations and their rates that a state remembers of the step that led to it.

A function of two steps, such as a rate, is a function of one state that remembers. With s the speeds, u the
controls and dt the length of the step from one state to the next, the blocks and their next values are

.. math::
    \text{control} \quad & u, &
    \text{control\_rate} \quad & (u - u^-) / \delta t, \\
    \text{acceleration} \quad & a = (s_1 - s_0) / \Delta t, &
    \text{jerk} \quad & (a - a^-) / \delta t

where a minus means what was remembered before, and delta t is the time from the middle of the step before to
that of this one: dt where steps are as long as each other, and dt/2 for the jerk of the first step, and the
rate of its control. All begin with zero, but for the acceleration and the control before the start where a
problem has some; without these the control of the first step has no rate. Rates count in units of
the size of their limits, so that the numbers that solvers see are of ordinary size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Passage
from mbocp.problem import Problem
from mbocp.robot import Label

_RISE = 8.0  # part of the duration over which the greatest jerk makes a typical acceleration


@dataclass(frozen=True)
class Rule:
    """How a block follows from a step.

    Attributes
    ----------
    of : {"u", "s"}
        Whether it has an entry for each control or for each speed.
    words : str
        What its rows are called, before the name of a control or speed.
    next_value : callable
        `Passage` -> the value after the step.
    has_unit : bool
        Whether it counts in a unit of its own; else in those of the controls.
    needs : tuple of str
        Blocks that it looks at.
    asks_for_first : bool
        Whether it looks at `Passage.has_before`.
    """

    of: Literal["u", "s"]
    words: str
    next_value: Callable[[Passage], Any]
    has_unit: bool = True
    needs: tuple[str, ...] = ()
    asks_for_first: bool = False


def _control_rate(at: Passage) -> Any:
    if at.begin is not None:
        return at.units_of_u * (at.u - at.begin) / (at.dt * at.units["control_rate"])
    change = at.units_of_u * (at.u - at.before["control"])
    return at.has_before * change / (at.spacing * at.units["control_rate"])


def _control_rate_from_start(at: Passage) -> Any:
    change = at.units_of_u * (at.u - at.before["control"])
    return change / (_measure_spacing_from_start(at) * at.units["control_rate"])


def _jerk(at: Passage) -> Any:
    change = at.acceleration - at.units["acceleration"] * at.before["acceleration"]
    return change / (_measure_spacing_from_start(at) * at.units["jerk"])


def _measure_spacing_from_start(at: Passage) -> Any:
    return at.spacing * (1.0 + at.has_before) / 2.0  # from the start in half of the first step


RULES: Mapping[str, Rule] = MappingProxyType(
    {
        "control": Rule("u", "previous control", lambda at: at.u, has_unit=False),
        "control_rate": Rule("u", "rate of control", _control_rate, needs=("control",), asks_for_first=True),
        "acceleration": Rule("s", "acceleration of", lambda at: at.acceleration / at.units["acceleration"]),
        "jerk": Rule("s", "jerk of", _jerk, needs=("acceleration",), asks_for_first=True),
    }
)


def order_blocks(names: set[str]) -> tuple[str, ...]:
    """Return names of blocks and of those that they need, in the order in which states have them."""
    wanted = names | {need for name in names & RULES.keys() for need in RULES[name].needs}
    return tuple(name for name in RULES if name in wanted)


@dataclass(frozen=True)
class Memory(Feature):
    """Names of what is remembered; functions of two steps, such as rates, are functions of one state then.

    Attributes
    ----------
    names : tuple of str
    has_control_before : bool
        Whether the rate of the first control is that from a control before the start.
    """

    names: tuple[str, ...]
    has_control_before: bool = False

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Memory | None:
        """Return what the cost, the path constraints, the end, and linear controls look at."""
        of_cost = {"control"} if asked.couples_steps or problem.controls == "linear" else set()
        names = order_blocks(of_cost | asked.remembers)
        return cls(names, _control_before(problem, names) is not None) if names else None

    @property
    def stage_key(self) -> Mapping[str, Any]:
        """From where the first control has a rate."""
        return {"control_before": True} if self.has_control_before else {}

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One for each name."""
        sizes, rules = {"u": nu, "s": ns}, {name: RULES[name] for name in self.names}
        return tuple(
            Block(name, sizes[rule.of], has_unit=rule.has_unit, counts_as_control=not rule.has_unit)
            for name, rule in rules.items()
        )

    @property
    def asks_for_first(self) -> bool:
        """Whether a rule does."""
        return any(RULES[name].asks_for_first for name in self.names)

    def next_value(self, name: str, step: Passage) -> Any:
        """By the rule of the block."""
        if name == "control_rate" and self.has_control_before:
            return _control_rate_from_start(step)
        return RULES[name].next_value(step)

    def units(self, problem: Problem) -> Mapping[str, float]:
        """Those of the limits."""
        return memory_units(problem)

    def first(self, problem: Problem) -> Mapping[str, Array]:
        """The acceleration at the start, and the control before it."""
        found = {}
        if "acceleration" in self.names and problem.a_start.any():
            found["acceleration"] = problem.a_start / memory_units(problem)["acceleration"]
        if (u := _control_before(problem, self.names)) is not None:
            found["control"] = u
        return found

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Which control or speed they are of."""
        labels = {"u": problem.robot.u_labels, "s": speeds}
        rules = [RULES[name] for name in self.names]
        return [f"{rule.words} {label.name}" for rule in rules for label in labels[rule.of]]


def _control_before(problem: Problem, names: tuple[str, ...]) -> Array | None:
    """That from which the first control has a rate; linear controls begin with it, see `ControlValues`."""
    has_rate = "control_rate" in names and problem.controls != "linear"
    return problem.u_before if has_rate else None


def memory_units(problem: Problem) -> dict[str, float]:
    """Return units of the blocks that have one [m/s^2, rad/s^2 and the like], by name.

    Those of the limits. Where the jerk alone is limited, accelerations are of the size that it makes.
    """
    units = {name: 1.0 for name, rule in RULES.items() if rule.has_unit}
    limits = problem.rate_limits
    units |= {name: c.scale for c in limits for name in c.term.remembers[-1:] if name in units}
    keys = {limit.key for limit in limits}
    if "jerk" in keys and "acceleration" not in keys:
        units["acceleration"] = units["jerk"] * problem.duration / _RISE
    return units


def rate_shares_at_start(problem: Problem) -> dict[str, float]:
    """Return the part of their multipliers that rates keep where their step becomes the first one, by name.

    Over half the time a rate is twice as steep; that of a control without one before is none.
    """
    of_controls = 1.0 if problem.controls == "linear" else 0.0 if problem.u_before is None else 0.5
    return {"control_rate": of_controls, "jerk": 0.5}
