"""Path constraints at the end of a step, in coordinates, with exact first and second derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np

from mbocp.formulation.features.accelerations import accelerate_driven
from mbocp.formulation.features.clock import CLOCK, STEP_SHARE
from mbocp.formulation.layout import Block
from mbocp.formulation.parameter_layout import NUMBERS, parameter_layout, path_parameters, pieces
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.steps import StepSymbols, unit_of
from mbocp.terms.clearance_term import ClearanceTerm
from mbocp.terms.point import Point, Sizes


def build_path(at: StepSymbols, signature: FunctionSignature) -> ca.Function:
    """(x1, m, u, theta) -> h, dh_dx1, upper Hessian of m'h in x1; only flat programmes have it."""
    clearances, others = _kinds(signature)
    if not clearances:
        return _write_out(at, signature, others)
    nx, ends = at.x1.numel(), np.cumsum([0, *(term.rows for term in signature.path)]).tolist()
    x, theta = ca.MX.sym("x1", nx), ca.MX.sym("theta", at.theta.numel())
    m, u = ca.MX.sym("m", ends[-1]), ca.MX.sym("u", at.inputs.numel())
    of_term = ca.vertsplit(m, ends)
    rows = {k: (ca.MX(0, 1), ca.MX(0, nx)) for k in range(len(of_term))}
    hessian = ca.MX(nx, nx)
    if others:
        found = _write_out(at, signature, others)(x, ca.vertcat(*(of_term[k] for k in others)), u, theta)
        parts = np.cumsum([0, *(signature.path[k].rows for k in others)]).tolist()
        split = zip(ca.vertsplit(found[0], parts), ca.vertsplit(found[1], parts), strict=True)
        rows |= dict(zip(others, split, strict=True))
        hessian += found[2]
    given = pieces(theta, parameter_layout(signature, Sizes.of(at.mechanics)).theta)
    for k, term in clearances.items():
        numbers, unit = _numbers(given, k, term), _unit_of_time(given, term)
        h, dh, upper = _of_clearance(at, term).call([x, of_term[k], unit, *numbers])
        rows[k] = (h, dh)
        hessian += upper
    outputs = [ca.vertcat(*(h for h, _ in rows.values())), ca.vertcat(*(dh for _, dh in rows.values()))]
    return ca.Function("path", [x, m, u, theta], [*outputs, ca.triu(hessian)])


def build_path_values(at: StepSymbols, signature: FunctionSignature) -> ca.Function:
    """(x1, u, theta) -> h, the values of `build_path` alone, for trial steps."""
    clearances, others = _kinds(signature)
    inputs, values = [at.x1, at.inputs, at.theta], ca.cse([_expressions(at, signature, others)])
    written = ca.Function("path_values", inputs, values)
    if not clearances:
        return written
    x, u = ca.MX.sym("x1", at.x1.numel()), ca.MX.sym("u", at.inputs.numel())
    theta = ca.MX.sym("theta", at.theta.numel())
    rows = {k: ca.MX(0, 1) for k in range(len(signature.path))}
    if others:
        ends = np.cumsum([0, *(signature.path[k].rows for k in others)]).tolist()
        rows |= dict(zip(others, ca.vertsplit(written(x, u, theta), ends), strict=True))
    given = pieces(theta, parameter_layout(signature, Sizes.of(at.mechanics)).theta)
    for k, term in clearances.items():
        numbers, where = _numbers(given, k, term), _places_of(at, term)
        place = _in_seconds(x[where], _unit_of_time(given, term), term)
        (rows[k],) = term.values(_place_of(at)).call([place, *numbers])
    return ca.Function("path_values", [x, u, theta], [ca.vertcat(*rows.values())])


def _kinds(signature: FunctionSignature) -> tuple[dict[int, ClearanceTerm], list[int]]:
    """Clearances by their numbers, and the numbers of the other constraints."""
    clearances = {k: term for k, term in enumerate(signature.path) if isinstance(term, ClearanceTerm)}
    return clearances, [k for k in range(len(signature.path)) if k not in clearances]


def _numbers(given: Mapping[str, ca.MX], k: int, term: ClearanceTerm) -> list[ca.MX]:
    """Parameters of a clearance, and what functions take of the robot."""
    own = [given[path_parameters(k, name)] for name in term.sizes]
    return [*own, given[NUMBERS]] if NUMBERS in given else own


def _place_of(at: StepSymbols) -> Point:
    """A configuration of symbols, at rest, at some time; numbers that are found move no frames of it."""
    z, mechanics = at.space.layout.z, at.space.configurations
    q = ca.SX.sym("q", z.stop - z.start)
    return Point(mechanics, q, ca.SX.zeros(mechanics.nv), moment=ca.SX.sym("t"))


def _places_of(at: StepSymbols, term: ClearanceTerm) -> list[int]:
    """Places in a state of what a clearance looks at: the configuration, and the time last."""
    layout = at.space.layout
    found = list(range(layout.z.start, layout.z.stop))
    if term.movers:
        found.append(layout.states[CLOCK if CLOCK in layout.states else "t"].start)
    return found


def _unit_of_time(given: Mapping[str, ca.MX], term: ClearanceTerm) -> ca.MX:
    """What the time of a state is multiplied by [s]: where lengths are free it counts in the guessed one."""
    is_in_shares = term.movers > 0 and STEP_SHARE in given
    return given["dt"] / given[STEP_SHARE] if is_in_shares else ca.MX(1.0)


def _in_seconds(place: ca.MX, unit: ca.MX, term: ClearanceTerm) -> ca.MX:
    """What a clearance looks at, with the time in seconds."""
    return ca.vertcat(place[:-1], unit * place[-1]) if term.movers else place


def _of_clearance(at: StepSymbols, term: ClearanceTerm) -> ca.Function:
    """The function of a clearance, of the whole state."""
    z, nx = at.space.layout.z, at.x1.numel()
    of_q, where = term.function(_place_of(at)), _places_of(at, term)
    x, m, unit = ca.MX.sym("x1", nx), ca.MX.sym("m", term.rows), ca.MX.sym("unit")
    sizes = [*term.sizes.values(), *([count] if (count := at.space.configurations.symbols.numel()) else [])]
    numbers = [ca.MX.sym("numbers", size) for size in sizes]
    h, dh, upper = of_q.call([_in_seconds(x[where], unit, term), m, *numbers])
    slopes, curvature = ca.MX(term.rows, nx), ca.MX(nx, nx)
    nz = z.stop - z.start
    slopes[:, z], curvature[z, z] = dh[:, :nz], upper[:nz, :nz]
    if term.movers:  # the time, which comes after
        t = where[-1]
        slopes[:, t], curvature[t, t] = unit * dh[:, nz], unit**2 * upper[nz, nz]
        curvature[z, t] = unit * upper[:nz, nz]
    return ca.Function("of_state", [x, m, unit, *numbers], [h, slopes, curvature])


def _write_out(at: StepSymbols, signature: FunctionSignature, chosen: Sequence[int]) -> ca.Function:
    """Constraints by their expressions, one after the other, with derivatives."""
    h = _expressions(at, signature, chosen)
    m = ca.SX.sym("m", h.numel())
    hessian, _ = ca.hessian(ca.dot(m, h), at.x1)
    outputs = [h, ca.jacobian(h, at.x1), ca.triu(hessian)]
    return ca.Function("path", [at.x1, m, at.inputs, at.theta], ca.cse(outputs))


def _expressions(at: StepSymbols, signature: FunctionSignature, chosen: Sequence[int]) -> ca.SX:
    """Rows of some constraints, one after the other."""
    layout, rows = at.space.layout, []
    after = {name: at.x1[where] for name, where in layout.states.items()}
    mechanics = at.space.configurations
    for feature in signature.features:
        mechanics = feature.equations(mechanics, after, at.given)
    q, s = at.x1[layout.z], at.x1[layout.s]
    node = Point(mechanics, q, mechanics.velocity(q, s, at.controls))
    remembered = {
        block.name: feature.show(block.name, _unit(at, block) * at.x1[layout.states[block.name]])
        for feature in signature.features
        for block in feature.blocks(layout.ns, mechanics.nu)
    }
    node = replace(node, remembered=remembered)
    if "control" in remembered:
        u = remembered["control"]
        node = replace(node, u=u, acceleration=partial(accelerate_driven, node, u))
    for k in chosen:
        term = signature.path[k]
        assert not isinstance(term, ClearanceTerm)
        rows.append(term.expression(node, {n: at.given[path_parameters(k, n)] for n in term.sizes}))
    return ca.densify(ca.vertcat(ca.SX.zeros(0, 1), *rows))


def _unit(at: StepSymbols, block: Block) -> ca.SX:
    """What a block is multiplied by."""
    if block.has_unit:
        return at.given[unit_of(block.name)]
    return at.units_of_u if block.counts_as_control else ca.SX(1)
