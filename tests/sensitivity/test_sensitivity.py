"""Derivatives of optima against differences of optima that are solved again."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError, SingularSystem, SolverError
from mbocp.formulation.formulate import formulate_with_independent_ends
from mbocp.formulation.layout import places
from mbocp.robot.named_numbers import open_numbers
from mbocp.sensitivity import DegenerateLimitWarning, of_robot
from mbocp.sensitivity.change import change_along, has_plain_numbers
from mbocp.sensitivity.kkt import Parts
from mbocp.sensitivity.of_ends import check_rates_at_end
from mbocp.sensitivity.parameters import parameters_of
from mbocp.terms import path_constraint, running_cost
from tests.sensitivity.moved import moved

EXAMPLES = Path(__file__).parents[2] / "examples"
TOLERANCE = 1e-6  # relative to the largest entry
QUANTITIES = ("cost", "qs", "vs", "us", "t", "lams", "mus", "lam_us", "lam_vs")
# With four points, errors of differences are of the fourth order of the step.
POINTS = ((1.0, 8.0 / 12.0), (-1.0, -8.0 / 12.0), (2.0, -1.0 / 12.0), (-2.0, 1.0 / 12.0))


def example(path, /, **changes):
    return mbocp.load_problem(EXAMPLES / path).with_(solver={"tolerance": 1e-12}, **changes)


def arm_within_limits():
    return example("arms/ur5_limits.toml", steps=16)


def arm_with_payload():
    return example("arms/payload.toml", steps=12)


def arm_in_least_time():
    return example("arms/ur5_fastest.toml").with_(solver={"tolerance": 1e-13})


def loop():
    """Over a third of a turn, which few steps resolve."""
    return example("loops/four_bar.toml", steps=24, duration=0.8, goal={"q": {"crank": 3.0}, "v": 0})


def loop_of_bodies():
    return loop().with_(coordinates="natural")


def quaternion():
    return example("free_flyer/drone_flip.toml", steps=14)


def explicit_steps():
    return example("so3/unicycle_pendulum.toml", steps=40)


def quartic_spring():
    return example("paper/cart_pendulum_elastic.toml", steps=20)


def continuous_joints():
    reach = example("arms/kinova_reach.toml", steps=40, cost={"velocity": 10.0})
    assert reach.robot.nq > reach.robot.nv
    return reach


def phases_with_holds():
    changes = {"phase.swing.steps": 10, "phase.flight.steps": 8, "solver": {"tolerance": 1e-12}}
    return mbocp.load_problem(EXAMPLES / "arms/throw_into_bucket.toml", changes)


def bodies_within_a_speed():
    """Bodies that the kernel eliminates one by one where nothing limits them."""
    return example(
        "loops/four_bar.toml",
        steps=40,
        coordinates="natural",
        integrator={"scheme": "se1"},
        goal={"q": {"crank": 2.2}, "v": 0},
        path=[{"kind": "speed", "frame": "coupler_point", "max": 0.3}],
    )


def feet_in_contact():
    """Conditions of its contacts follow from others."""
    return example("legged/solo12_jump.toml")


def linkage_that_polishes():
    """Midpoint leaves velocities across its loop, and which of these are zero is said where it ends."""
    changes = {f"phase.{k}.steps": 10 for k in range(3)}
    return mbocp.load_problem(EXAMPLES / "loops/polish.toml", changes | {"solver.tolerance": 1e-12})


def trot():
    """Its goal says how high it stands, and so do its legs."""
    changes = {"gait.cycles": 1, "gait.steps": 6, "goal.frame.x": 0.05, "solver.tolerance": 1e-12}
    return mbocp.load_problem(EXAMPLES / "legged/solo12_trot.toml", changes)


def arm_with_slow_torques():
    limits = {"effort_rate": 120.0}
    return example("arms/payload.toml", steps=12, limits=limits, integrator={"scheme": "midpoint"})


def arm_with_smooth_end():
    return example("arms/payload.toml", steps=12, limits={"jerk": 400.0}, integrator={"scheme": "midpoint"})


def upright_cup():
    """Rows of its conditions have terms so large that round-off of these is more than others are."""
    return example("arms/cup.toml", steps=20)


def arm_that_follows_the_time():
    def away(at):
        return (at.q[0] - 0.3 * ca.sin(3.0 * at.t)) ** 2

    return example("arms/ur5_reach.toml", steps=10).with_(terms=[running_cost(away, weight=50.0)])


def arm_along_a_path():
    """It stays where it is while links grow."""
    path = {"kind": "follow", "frame": "tool0", "relative": True, "points": [[0, 0, 0], [0.05, 0.05, 0]]}
    changes = {"horizon.duration": 2.0, "horizon.steps": 12, "cost": {"effort": 1.0, "velocity": 1.0}}
    changes |= {"limits": {}, "path": [path], "solver": {"tolerance": 1e-12}}
    return mbocp.load_problem(EXAMPLES / "arms/follow_path.toml", changes)


def arm_with_a_cool_wrist():
    """Its limit is small, and numbers go with its square."""
    return example("arms/ur5_reach.toml", steps=10, limits={"effort_rms": {"wrist_3_joint": 0.03}})


def walker_from_a_free_start():
    """On legs of other lengths it starts elsewhere."""
    return example("walking/compass_gait.toml")


CASES = [
    pytest.param(
        walker_from_a_free_start, "robot.frame.standing_foot.length", 0, 2e-3, marks=pytest.mark.slow
    ),
    (arm_that_follows_the_time, "horizon.duration", 0, 1e-3),
    (arm_along_a_path, "robot.joint.elbow_joint.length", 0, 1e-5),
    (upright_cup, "start.q", 1, 1e-3),
    (arm_with_a_cool_wrist, "limits.effort_rms.upper", 5, 1e-4),
    (arm_with_smooth_end, "horizon.duration", 0, 2e-5),
    (arm_with_slow_torques, "start.q", 1, 2e-4),
    (arm_with_slow_torques, "goal.q", 2, 2e-4),
    (arm_with_slow_torques, "horizon.duration", 0, 2e-5),
    (arm_with_slow_torques, "robot.payload.crate.mass", 0, 1e-3),
    (arm_with_slow_torques, "limits.effort_rate.upper", 1, 1e-3),
    (arm_within_limits, "start.q", 1, 2e-4),
    (arm_within_limits, "start.v", 0, 2e-4),
    (arm_within_limits, "goal.q", 2, 2e-4),
    (arm_within_limits, "goal.v", 0, 2e-4),
    (arm_within_limits, "cost.effort", 2, 1e-3),
    (arm_within_limits, "limits.velocity.upper", 0, 2e-4),
    (arm_within_limits, "horizon.duration", 0, 2e-5),
    (arm_with_payload, "robot.payload.crate.mass", 0, 1e-2),
    (arm_with_payload, "robot.payload.crate.com", 1, 1e-3),
    (arm_with_payload, "robot.payload.crate.inertia", 0, 1e-3),
    (arm_in_least_time, "goal.frame.tool0.position", 0, 2e-4),
    (arm_in_least_time, "goal.frame.tool0.orientation", 1, 2e-4),
    (arm_in_least_time, "limits.velocity.upper", 0, 2e-4),
    (loop, "start.q", 0, 1e-3),
    (loop, "goal.q", 1, 1e-3),
    (loop, "goal.v", 0, 1e-3),
    (loop, "horizon.duration", 0, 1e-3),
    (loop, "robot.frame.coupler_pin.length", 0, 1e-4),
    (loop, "robot.joint.rocker.mass", 0, 1e-3),
    (quartic_spring, "robot.spring.spring.length", 0, 1e-4),
    (arm_with_slow_torques, "robot.joint.elbow_joint.length", 0, 1e-4),
    (loop_of_bodies, "start.q", 0, 1e-3),
    (loop_of_bodies, "start.v", 0, 1e-3),
    (loop_of_bodies, "goal.q", 1, 1e-3),
    (quaternion, "start.q", 3, 1e-3),
    (quaternion, "goal.q", 4, 1e-3),
    (quaternion, "horizon.duration", 0, 1e-3),
    (continuous_joints, "start.q", 0, 1e-3),
    (continuous_joints, "goal.q", 0, 1e-3),
    (explicit_steps, "start.q", 3, 1e-4),
    (explicit_steps, "cost.potential", 0, 1e-4),
    (phases_with_holds, "start.q", 1, 1e-4),
    (linkage_that_polishes, "goal.frame.linkage/left_tip.position", 0, 1e-3),
    pytest.param(
        linkage_that_polishes,
        "robot.joint.linkage/right_elbow.z",
        0,
        1e-3,
        marks=pytest.mark.slow,
    ),
    pytest.param(trot, "cost.effort", 2, 1e-3, marks=pytest.mark.slow),
    pytest.param(
        bodies_within_a_speed, "start.q", 0, 1e-4, marks=pytest.mark.slow, id="bodies_within_a_speed"
    ),
    pytest.param(feet_in_contact, "start.q", 0, 1e-4, marks=pytest.mark.slow, id="feet_in_contact-start.q"),
]


@pytest.mark.filterwarnings("ignore:2 limits are active with next to no multiplier")  # of feet in contact
@pytest.mark.parametrize(("make", "word", "k", "step"), CASES)
def test_agrees_with_differences_of_optima(make, word, k, step):
    problem, solution = optimum(make)
    derivatives = mbocp.sensitivities(solution, [word])
    quantities = set(QUANTITIES) & set(derivatives.quantities)
    if word.startswith("robot."):
        quantities -= {"mus"}
    if make is arm_in_least_time:  # of the rest a barrier leaves too much for differences to be so good
        quantities = {"cost", "t"}
    if make in (feet_in_contact, linkage_that_polishes, trot):  # multipliers are some of many
        quantities &= {"cost", "t", "qs", "vs", "us"}
    again = [solved(moved(problem, word, k, at * step)) for at, _ in POINTS]

    def difference(read):
        return sum(weight * read(s) for s, (_, weight) in zip(again, POINTS, strict=True)) / step

    for name in sorted(quantities):
        expected = difference(lambda s, name=name: reading(s, solution, name))
        agree(derivatives.of(name, word)[..., k], expected, name)


def solved(problem):
    """Solution from the problem's own guess: the barrier ends at the same parameter in all of them."""
    solution = mbocp.solve(problem)
    assert solution.converged, solution.advice
    return solution


@cache
def optimum(make):
    """Problem and solution that tests share."""
    problem = make()
    return problem, solved(problem)


def reading(solution, before, name):
    if name != "qs":
        return getattr(solution, name)
    robot = solution.problem.robot
    return np.array([robot.difference(q, moved) for q, moved in zip(before.qs, solution.qs, strict=True)])


def agree(found, expected, name):
    size = max(np.abs(expected).max(initial=0.0), 1e-3)
    assert np.shape(found) == np.shape(expected), name
    assert np.abs(found - expected).max(initial=0.0) <= TOLERANCE * size, name


@pytest.mark.parametrize("make", [arm_within_limits, arm_in_least_time, loop, loop_of_bodies, quaternion])
def test_the_cheap_gradient_of_the_cost_solves_nothing(make):
    _, solution = optimum(make)
    derivatives = mbocp.sensitivities(solution, ["start.q"])
    cheap = derivatives.cost["start.q"]
    assert "_optimum" not in vars(derivatives)
    exact = derivatives.of("cost", "start.q")
    assert np.abs(cheap - exact).max() <= TOLERANCE * np.abs(exact).max()


@pytest.mark.parametrize("make", [arm_within_limits, loop, quaternion, explicit_steps])
def test_adjoints_are_what_derivatives_add_up_to(make):
    (_, solution), words = optimum(make), ["start.q", "goal.v", "horizon.duration"]
    derivatives = mbocp.sensitivities(solution, words)
    rng = np.random.default_rng(0)
    shapes = {"qs": solution.vs.shape, "vs": solution.vs.shape, "us": solution.us.shape}
    bars = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    bars["dts"] = rng.normal(size=solution.num_steps)
    found = derivatives.gradient(**bars)
    for word in words:
        columns = [(bar[..., None] * derivatives.of(name, word)) for name, bar in bars.items()]
        expected = sum(column.reshape(-1, column.shape[-1]).sum(axis=0) for column in columns)
        assert found[word] == pytest.approx(expected, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize(
    ("path", "changes"),
    [
        # Conditions of the end are chosen where the motion ends. How the last step before a parting shares
        # its force with that is known to the tolerance alone.
        (
            "loops/polish.toml",
            {f"phase.{k}.steps": 10 for k in range(3)} | {"solver.tolerance": 1e-10},
        ),
        ("design/five_bar_lengths.toml", {"integrator.scheme": "midpoint"}),  # and with the first lengths
    ],
)
def test_the_optimum_is_that_of_the_solve(path, changes, tmp_path):
    problem = mbocp.load_problem(EXAMPLES / path, changes)
    solution = solved(problem)
    solution.save(tmp_path / "result.npz")
    for one in (solution, mbocp.Solution.load(tmp_path / "result.npz")):
        derivatives = mbocp.sensitivities(one, ["cost.effort"])
        iterate = derivatives._optimum.kkt.optimum.iterate
        us = derivatives.formulation.motion_of(iterate).us
        assert np.abs(us - one.us).max() <= 1e-8 * np.abs(one.us).max()
    share, cost = 1e-4, problem.cost
    dearer = replace(problem, cost=cost.with_weights({"effort": (1.0 + share) * cost.effort}))
    slope = (mbocp.solve(dearer, warm_start=solution).cost - solution.cost) / share
    assert slope == pytest.approx(derivatives.cost["cost.effort"] @ cost.effort, rel=1e-5)


def test_multipliers_that_are_some_of_many_leave_derivatives_of_the_motion():
    """Legs on the ground say how high a trot ends, and so does its goal."""
    _, solution = optimum(trot)
    weights = mbocp.sensitivities(solution, ["cost.velocity"])
    expected = np.einsum("nu,nuk->k", solution.us, weights.of("us", "cost.velocity"))
    found = weights.gradient(us=solution.us)["cost.velocity"]
    assert np.abs(found - expected).max() <= TOLERANCE * np.abs(expected).max()
    legs = mbocp.sensitivities(solution, ["goal.q"])
    for read in (
        lambda: weights.of("eta", "cost.velocity"),
        lambda: legs.of("us", "goal.q"),
        lambda: legs.of("cost", "goal.q"),
        lambda: legs.gradient(us=solution.us),
    ):
        with pytest.raises(SingularSystem, match="some of its conditions follow from others"):
            read()


def test_numbers_are_those_of_a_problem_formulated_anew():
    """What is known of parameters directly is what formulating moved problems says."""
    derivatives = mbocp.sensitivities(optimum(arm_within_limits)[1], ["start.q"])
    formulation, base = derivatives.formulation, derivatives.formulation.problem
    words = ["start.q", "start.v", "goal.q", "goal.v", "cost.effort", "cost.velocity"]
    words += [
        f"limits.{key}.{side}" for key in ("effort", "velocity", "position") for side in ("lower", "upper")
    ]
    for parameter in parameters_of(formulation, words):
        change = parameter.change()
        again = change_along(formulation, lambda size, word=parameter.word: moved(base, word, 1, size))
        for name in ("start", "theta", "rho", "rho_terminal", "lower", "upper"):
            assert np.allclose(getattr(change, name)[1], getattr(again, name)[0], atol=1e-9), (
                parameter.word,
                name,
            )


@pytest.mark.parametrize("changes", [{}, {"integrator.scheme": "gauss2"}, {"limits.effort_rate": 300.0}])
def test_lengths_of_steps_and_limits_stand_alone_where_numbers_are_plain(changes):
    problem = mbocp.load_problem(EXAMPLES / "arms/ur5_limits.toml", {"horizon.steps": 5, **changes})
    formulation = formulate_with_independent_ends(problem, math.inf)[0]
    assert has_plain_numbers(formulation) == ("limits.effort_rate" not in changes)
    for parameter in parameters_of(formulation, ["horizon.duration", "limits.velocity.upper"]):
        found, by = parameter.change(), np.ones(len(parameter.names))
        move = partial(lambda one, size: one.put(problem, one.value + size), parameter)
        expected = change_along(formulation, move)
        for name in ("start", "theta", "rho", "rho_terminal", "lower", "upper"):
            whole = by @ getattr(found, name).reshape(len(by), -1)
            assert np.allclose(whole, getattr(expected, name).ravel(), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("path", "steps"), [("four_bar", 100), ("stewart", 20)])
def test_end_conditions_turn_with_the_goal_as_those_formulated_anew(path, steps):
    solution = solved(mbocp.load_problem(EXAMPLES / f"loops/{path}.toml", {"horizon.steps": steps}))
    (goal,) = mbocp.sensitivities(solution, ["goal.q"]).parameters
    assert goal._turns_of_rows()
    found, expected = goal.change(), goal._formulate_anew(goal.value)
    assert np.abs(expected.rho_terminal).max() > 0.1
    assert np.allclose(found.rho_terminal, expected.rho_terminal, atol=1e-10)


def test_closed_loops_go_along_with_a_pose():
    """Midpoint's velocities lie across loops, too, and which of these are zero goes with the end."""
    word = "goal.frame.left_tip.position"

    def problem_to(x):
        goal = {"goal.q": {}, "goal.v": 0, "goal.frame": {"name": "left_tip", "x": x, "z": 0.6}}
        changes = {"integrator.scheme": "midpoint", "solver.tolerance": 1e-12, "cost.velocity": 3.0, **goal}
        return mbocp.load_problem(EXAMPLES / "loops/five_bar.toml", changes)

    def controls(size):
        return solved(problem_to(0.2 + 1e-4 * size)).us

    exact = mbocp.sensitivities(solved(problem_to(0.2)), [word]).of("us", word)[..., 0]
    expected = sum(weight * controls(at) for at, weight in POINTS) / 1e-4
    assert np.abs(expected - exact).max() <= TOLERANCE * np.abs(expected).max()


def test_velocities_at_a_goal_are_those_that_contacts_allow_where_the_motion_ends():
    """Problems themselves have a guess of that end alone."""
    problem = trot().with_(integrator={"scheme": "midpoint"})
    (goal,) = mbocp.sensitivities(solved(problem), ["goal.v"]).parameters
    end, switches = goal.problem.goal, problem.timeline.switches
    assert end.q_is_reached
    guess = problem.robot.integrate(end.q, 0.1 * np.ones(problem.robot.nv))
    guessed = replace(problem, goal=replace(problem.goal, q=guess))
    given = goal.put(guessed, np.random.default_rng(0).normal(size=problem.robot.nv)).goal.value
    assert np.abs(switches.at_end(end.q, of_rates=True) @ given).max() < 1e-12
    assert np.abs(switches.at_end(guess, of_rates=True) @ given).max() > 1e-3
    with pytest.raises(SolverError, match="contacts allow other velocities"):
        check_rates_at_end(guessed, end.q)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:2 limits are active with next to no multiplier")
def test_velocities_at_the_goal_are_those_that_contacts_allow():
    problem, solution = optimum(feet_in_contact)
    derivatives = mbocp.sensitivities(solution, ["goal.v"])
    (goal,) = derivatives.parameters
    end = goal.problem
    tied = end.timeline.switches.at_end(end.goal.q, of_rates=True)
    wanted = np.random.default_rng(0).normal(size=problem.robot.nv)
    given = goal.put(end, wanted).goal.value
    assert np.abs(tied @ wanted).max() > 0.1
    assert np.abs(tied @ given).max() < 1e-12
    assert np.allclose(derivatives.of("vs", "goal.v")[-1] @ wanted, given, atol=1e-8)


def test_end_conditions_that_are_left_out_shift_no_other_number():
    path = EXAMPLES / "so3/unicycle_pendulum.toml"
    problem = mbocp.load_problem(path, {"limits.velocity": {"pendulum": 9.0}})
    formulation, left_out = formulate_with_independent_ends(problem, math.inf)
    assert "rate of pendulum.wz" in left_out
    (limit,) = parameters_of(formulation, ["limits.velocity.upper"])
    spins = [label.name for label in problem.robot.speed_labels].index("pendulum.wz")
    moved = limit.change().upper[limit.names.index("pendulum.wz")]
    expected = np.zeros_like(moved)
    expected[:, formulation.layout.nz + spins] = 1.0
    assert np.allclose(moved, expected)


@pytest.mark.parametrize("make", [arm_within_limits, arm_in_least_time, loop, loop_of_bodies, quaternion])
def test_the_inverse_of_the_conditions_derivative_is_symmetric(make):
    derivatives = mbocp.sensitivities(optimum(make)[1], ["start.q"])
    kkt = derivatives._optimum.kkt
    rng = np.random.default_rng(0)
    right = Parts(*(rng.normal(size=part.shape) for part in Parts.zeros(kkt.optimum.programme, 2)))
    right = right._replace(ws=np.where(kkt.optimum.held, right.ws, 0.0))
    found, of_start, _ = kkt.solve(right)
    products = sum(np.inner(a.reshape(2, -1), b.reshape(2, -1)) for a, b in zip(right, found, strict=True))
    assert np.abs(products - products.T).max() <= 1e-8 * np.abs(products).max()
    first = (part[:, 0] for part in (found.xs, found.ys, found.us, found.ms))
    expected = sum(own @ part.T for own, part in zip(first, kkt.of_start, strict=True))
    assert np.abs(of_start - expected).max() <= 1e-10 * np.abs(expected).max()


@pytest.mark.parametrize("share", [0.0, 1e-12])
def test_a_system_that_is_all_but_singular_has_no_derivative(share):
    """A joint at rest, of which next to nothing is weighed: by round-off it goes anywhere."""
    floating = mbocp.load_robot("ur5", gravity=[0, 0, 0])
    problem = example("arms/ur5_reach.toml", steps=12, cost={"effort": 1.0, "velocity": 0.0})
    still = problem.with_(robot=floating, goal={"q": problem.q_start.tolist(), "v": 0})
    derivatives = mbocp.sensitivities(solved(still), ["start.q"])
    formulation = derivatives.formulation
    theta = np.array(formulation.programme.theta)
    theta[places(formulation.pieces.parameters.theta)["effort"].start] = share
    unweighed = replace(formulation, programme=replace(formulation.programme, theta=theta))
    with pytest.raises(SingularSystem, match="no unique derivative"):
        replace(derivatives, formulation=unweighed).of("us", "start.q")
    assert np.isfinite(derivatives.of("us", "start.q")).all()


def test_a_limit_that_is_just_touched_is_told():
    free = arm_within_limits().with_(limits={"effort": False, "velocity": False, "position": False})
    fastest = np.abs(solved(free).vs).max(axis=0)
    joint = int(fastest.argmax())
    limits = replace(free.limits, v_upper=np.where(np.arange(6) == joint, fastest, np.inf))
    limits = replace(limits, v_lower=np.where(np.arange(6) == joint, -fastest, -np.inf))
    derivatives = mbocp.sensitivities(solved(free.with_(limits=limits)), ["start.q"])
    with pytest.warns(DegenerateLimitWarning, match="velocity limit of"):
        derivatives.of("us", "start.q")
    assert "velocity limit of" in derivatives.degenerate[0]


def test_what_has_no_derivatives_is_refused():
    problem, solution = optimum(arm_with_payload)
    with pytest.raises(ProblemError, match=r"'goal\.x'.*it has start\.q, .*robot\.payload\.crate\.mass"):
        mbocp.sensitivities(solution, ["goal.x"])
    with pytest.raises(ProblemError, match=r"'' is no parameter.*it has start\.q"):
        mbocp.sensitivities(solution, [])
    with pytest.raises(SolverError, match="only an optimum has derivatives"):
        mbocp.sensitivities(mbocp.solve(problem.with_(solver={"max_iterations": 1})), ["start.q"])
    with pytest.raises(InvalidValue, match=r"solution\.iterate"):
        mbocp.sensitivities(replace(solution, iterate=None), ["start.q"])
    carried = solution.iterate
    aside = replace(carried.iterate, us=carried.iterate.us + 50.0)
    far = mbocp.sensitivities(replace(solution, iterate=replace(carried, iterate=aside)), ["start.q"])
    with pytest.raises(SolverError, match=r"\(a Newton step is \d\.\de[-+]\d\d of the motion\)"):
        far.of("us", "start.q")
    derivatives = mbocp.sensitivities(solution, ["start.q", "robot.payload.crate.mass"])
    with pytest.raises(InvalidValue, match="one of cost, dts, t, qs"):
        derivatives.of("velocity", "start.q")
    with pytest.raises(InvalidValue, match="by the motion alone"):
        derivatives.of("ps", "robot.payload.crate.mass")
    with pytest.raises(DimensionMismatch, match="us"):
        derivatives.gradient(us=np.zeros(3))


def test_numbers_that_no_body_has_are_refused():
    _, solution = optimum(arm_with_payload)
    (numbers,) = mbocp.sensitivities(solution, ["robot.numbers"]).parameters
    with pytest.raises(InvalidValue, match=r"inertia of wrist_3_joint: .* positive about all axes"):
        numbers.put(numbers.problem, numbers.value - 10.0)


def test_a_point_mass_has_derivatives_in_its_inertia():
    """No body has it after a small move, nor need it have."""
    limits = {"effort_rate": 400.0}
    problem = example("arms/cup.toml", steps=20, limits=limits, integrator={"scheme": "midpoint"})
    words = ["robot.payload.cup.inertia", "robot.numbers"]
    derivatives = mbocp.sensitivities(solved(problem), words)
    inertia, of_numbers = derivatives.parameters[0], derivatives.cost["robot.numbers"]
    assert derivatives.cost[words[0]] == pytest.approx(inertia.in_numbers @ of_numbers, rel=1e-9)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (arm_with_slow_torques, ["start.v", "goal.v"]),  # what holds it at rest holds it with no velocity
        (lambda: example("design/five_bar_lengths.toml"), ["goal.v"]),  # of which loop?
        (lambda: arm_between_times(0.4), ["horizon.duration"]),  # the nodes between would be others
    ],
)
def test_numbers_that_motions_leap_with_are_no_parameters(make, words):
    solution = optimum(make)[1]
    for word in words:
        with pytest.raises(ProblemError, match=f"'{word}' is no parameter"):
            mbocp.sensitivities(solution, [word])


def arm_between_times(until):
    held = path_constraint(lambda at: at.q[0], upper=0.5, since=0.2, until=until)
    return example("arms/ur5_reach.toml", steps=20).with_(terms=[held])


@pytest.mark.parametrize(
    ("path", "steps", "word"),
    [
        ("design/five_bar_lengths.toml", 30, "robot.numbers"),
        ("design/gear_ratio.toml", 40, "robot.numbers"),
        ("design/five_bar_lengths.toml", 30, "robot.joint.left_elbow.mass"),  # beside those that are found
        ("arms/past_a_belt.toml", 15, "robot.joint.elbow_joint.length"),  # which obstacles do not follow
    ],
)
def test_numbers_that_equations_do_not_take_are_no_parameters(path, steps, word):
    solution = solved(mbocp.load_problem(EXAMPLES / path, {"horizon.steps": steps}))
    with pytest.raises(ProblemError, match=f"'{word}' is no parameter"):
        mbocp.sensitivities(solution, [word])


def test_a_target_that_is_the_goal_has_no_parameter():
    """It would move along with the goal, or not: nobody can tell."""
    tracked = loop().with_(cost={"tracking": 1.0})
    with pytest.raises(ProblemError, match=r"'goal\.q'"):
        mbocp.sensitivities(solved(tracked), ["goal.q"])


def test_only_some_functions_of_robots_numbers_are_kept(monkeypatch):
    monkeypatch.setattr(of_robot, "_growth", {})
    monkeypatch.setattr(of_robot, "_KEPT", 2)
    words = [f"joint.{name}.length" for name in ("shoulder_lift_joint", "elbow_joint", "wrist_1_joint")]
    robot = open_numbers(mbocp.load_robot("ur5"), words)
    first = [of_robot._numbers_with(robot, (word,), np.array([0.1])) for word in words]
    assert [key[-1] for key in of_robot._growth] == [(word,) for word in words[1:]]
    for word, (values, slopes) in zip(words, first, strict=True):
        again = of_robot._numbers_with(robot, (word,), np.array([0.1]))
        np.testing.assert_array_equal(again[0], values)
        np.testing.assert_array_equal(again[1], slopes)
