"""An accuracy in place of a number of steps: reached, told, and with fewer steps than equal ones."""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.accuracy.mesh import first_mesh
from mbocp.accuracy.refining import _Search
from mbocp.cli.app import app
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.formulation import formulate
from mbocp.job import Job
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.tables import problem_to_toml
from mbocp.solution import Phase
from mbocp.solution.later import retold
from mbocp.strategies import OneSolve
from tests.phases.test_holds import hits
from tests.phases.test_partings import thrown

EXAMPLES = Path(__file__).parents[2] / "examples"
COSTS = json.loads((Path(__file__).parents[1] / "data/reference_costs.json").read_text())
SYSTEMS = {"cart_pendulum_rigid": "lobatto3", "cart_pendulum_elastic": "gauss2"}


def problem(name: str, **changes: Any) -> mbocp.Problem:
    return mbocp.load_problem(EXAMPLES / f"paper/{name}.toml").with_(**changes)


def true_error(solution: mbocp.Solution, name: str) -> float:
    return float(abs(solution.cost / COSTS[name]["cost"] - 1.0))


@pytest.mark.parametrize("asked", [1e-4, 1e-6])
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_error_of_the_cost_is_below_what_was_asked_for(name: str, asked: float) -> None:
    """Against the limit that two other schemes agree on; equal steps need more for the same."""
    case = problem(name, scheme=SYSTEMS[name])
    s = mbocp.solve(case.with_(accuracy=asked))
    assert s.converged, s.advice
    assert s.accuracy.asked == asked
    assert s.accuracy.local_error <= asked
    assert s.accuracy.rounds >= 1
    assert true_error(s, name) <= asked
    assert s.accuracy.cost_error >= 0.98 * true_error(s, name)
    if name == "cart_pendulum_rigid":  # the errors of the elastic one happen to cancel
        assert s.accuracy.cost_error == pytest.approx(true_error(s, name), rel=0.05)
    equal = mbocp.solve(case.with_(num_steps=s.num_steps), warm_start=s)
    assert equal.converged
    assert true_error(equal, name) > 1.5 * true_error(s, name)
    lengths = np.diff(s.t)
    assert lengths.max() > 2.0 * lengths.min()
    assert lengths.sum() == pytest.approx(case.duration, rel=1e-12)


def test_what_is_asked_of_a_solution_is_asked_of_the_steps_that_were_found(tmp_path: Path) -> None:
    """Sensitivities, of a file, too; and limits that leave room for what is uncertain."""
    case = mbocp.Problem.create(
        "double_pendulum",
        1.0,
        accuracy=0.01,
        start={"q": [0.1, 0.2]},
        goal={"q": [1.0, -0.5], "v": 0},
        cost={"velocity": 0.1},
        limits={"velocity": 3.0},
        scheme="midpoint",
    )
    s = mbocp.solve(case)
    given = s.problem.with_steps_at(s.t)
    assert s.num_steps == given.num_steps != s.problem.num_steps
    slope = mbocp.sensitivities(mbocp.solve(given, warm_start=s), ["goal.q"]).cost["goal.q"]
    of_file = mbocp.sensitivities(mbocp.Solution.load(s.save(tmp_path / "s.h5")), ["goal.q"])
    np.testing.assert_allclose(of_file.cost["goal.q"], slope, rtol=1e-6)
    robust = mbocp.solve(case.with_(robust={"start": {"q": 0.002}}))
    assert robust.converged, robust.advice
    assert robust.sigma_qs[-1].max() < 0.002
    assert robust.accuracy.asked == 0.01


def test_steps_of_any_number_and_length_share_functions() -> None:
    case = problem("elastic_pendulum", scheme="gauss2")
    libraries = {
        formulate(case.with_(num_steps=len(lengths), lengths=lengths)).programme.functions.library
        for lengths in (np.full(20, 0.25), np.full(40, 0.125), np.linspace(0.04, 0.16, 50))
    }
    assert len(libraries) == 1


def test_lengths_that_are_equal_change_nothing() -> None:
    case = problem("elastic_pendulum", num_steps=25)
    plain, given = mbocp.solve(case), mbocp.solve(case.with_(lengths=np.full(25, 0.2)))
    assert case.duration == 5.0
    np.testing.assert_allclose(given.us, plain.us, atol=1e-9)
    assert given.cost == pytest.approx(plain.cost, rel=1e-12)


def test_what_is_not_reached_is_told() -> None:
    s = mbocp.solve(problem("elastic_pendulum", accuracy=1e-6, scheme="se1"))
    assert s.status == "under_resolved"
    assert not s.converged
    assert s.is_stationary
    assert s.advice.startswith("horizon.accuracy = 1e-06 is not reached: with ")
    assert s.accuracy.cost_error > 1e-6


def test_no_round_begins_after_the_time_limit() -> None:
    case = problem("elastic_pendulum", accuracy=1e-6, scheme="se1", solver={"time_limit": 1.0})
    formulate(case.with_(accuracy=None, lengths=np.full(case.num_steps, case.dt)))

    def wait(record: object) -> None:
        time.sleep(0.4)

    s = mbocp.solve(case, callback=wait)
    assert not s.converged


def test_no_round_begins_that_would_not_end_in_time() -> None:
    """Twenty steps took a second beside compiling: twice two hundred take some thirty."""
    case = problem("elastic_pendulum", accuracy=1e-6)
    last = mbocp.solve(case.with_(accuracy=None, num_steps=20))
    last = retold(last, phases=(Phase("compile", 0, 50.0), Phase("monolithic", 5, 1.0)))
    mesh = first_mesh(last.problem).even(10)
    assert mesh.num_steps == 200
    for limit, is_late in ((10.0, True), (60.0, False)):
        search = _Search(Job.of(case, time_limit=limit), OneSolve())
        assert search._is_too_late_for(mesh, last) is is_late


def test_a_motion_that_was_found_is_kept_where_the_finer_one_is_stopped() -> None:
    case = problem("elastic_pendulum", accuracy=1e-6, scheme="se1")
    first = list[int]()

    def stop_second_solve(record: mbocp.IterationRecord) -> None:
        if first and record.iteration == 0:
            raise KeyboardInterrupt
        first.append(record.iteration)

    s = mbocp.solve(case, callback=stop_second_solve)
    assert s.status == "interrupted"
    assert s.advice.startswith(f"optimal with {s.num_steps} steps; ")
    assert s.residual < 1e-6
    assert s.iterations > 0


def test_ctrl_c_after_a_round_leaves_that_round() -> None:
    rounds = list[str]()

    def stop(record: mbocp.IterationRecord) -> None:
        if record.phase.startswith("round "):
            rounds.append(record.phase)
        if len(rounds) == 2:
            raise KeyboardInterrupt

    s = mbocp.solve(problem("elastic_pendulum", accuracy=1e-6, scheme="se1"), callback=stop)
    assert s.status == "interrupted"
    assert s.accuracy.rounds == 2
    assert s.residual < 1e-6
    told = f"{s.num_steps} steps, one is wrong by {s.accuracy.local_error:.2g} at most, "
    assert rounds[1] == f"round 2: {told}the cost by {s.accuracy.cost_error:.2g} of it"


@pytest.mark.parametrize("asked", [None, 1e-2])
def test_ctrl_c_while_the_accuracy_is_worked_out_leaves_the_motion(
    asked: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mbocp.accuracy.solution_accuracy.accuracy_of", stop)
    s = mbocp.solve(problem("elastic_pendulum", accuracy=asked), accuracy=True)
    assert s.status == "interrupted"
    assert s.advice.startswith("interrupted before its accuracy was known; a strict local minimum")
    assert s.residual < 1e-6


def test_ctrl_c_before_the_first_round_is_told_leaves_its_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mbocp.accuracy.rounds.step_errors_of", stop)
    s = mbocp.solve(problem("elastic_pendulum", accuracy=1e-6, scheme="se1"))
    assert s.status == "interrupted"
    assert s.advice.startswith("interrupted in another attempt; ")
    assert s.residual < 1e-6


def test_result_file_json_and_summary_say_it(tmp_path: Path) -> None:
    run = CliRunner(env={"COLUMNS": "200", "TERM": "dumb"})
    path = str(EXAMPLES / "paper/cart_pendulum_rigid.toml")
    document = Path(path).read_text()
    assert "steps = " in document
    file = tmp_path / "swing.toml"
    lines = [line for line in document.splitlines() if not line.startswith("steps")]
    at = lines.index("[horizon]") + 1
    file.write_text("\n".join([*lines[:at], "accuracy = 1e-3", *lines[at:]]))
    saved = tmp_path / "swing.h5"
    done = run.invoke(app, ["solve", str(file), "--set", "integrator.scheme=lobatto3", "-o", str(saved)])
    assert done.exit_code == 0, done.output
    assert "0.001 was asked for: " in done.stdout
    loaded = mbocp.Solution.load(saved)
    assert loaded.accuracy.asked == 1e-3
    assert loaded.accuracy.cost_error < 1e-3
    assert "accuracy = 0.001" in loaded.problem_text
    again = run.invoke(app, ["solve", str(file), "--set", "integrator.scheme=lobatto3", "--json"])
    told = json.loads(again.stdout)["accuracy"]
    assert told["asked"] == 1e-3
    assert told["cost_error"] == pytest.approx(loaded.accuracy.cost_error)
    assert told["rounds"] == loaded.accuracy.rounds


def test_problem_files_keep_accuracy_and_lengths() -> None:
    case = problem("elastic_pendulum")
    assert parse_problem(problem_to_toml(case.with_(accuracy=1e-5))).accuracy == 1e-5
    lengths = np.linspace(0.01, 0.03, 125)
    lengths *= case.duration / lengths.sum()
    given = case.with_(num_steps=125, lengths=lengths)
    again = parse_problem(problem_to_toml(given))
    np.testing.assert_array_equal(again.lengths, given.lengths)
    np.testing.assert_allclose(given.with_(cost={"effort": 2.0}).lengths, lengths)
    np.testing.assert_allclose(given.with_(duration=10.0).lengths, 2.0 * lengths)
    assert given.with_(num_steps=30).lengths is None
    assert given.with_(accuracy=1e-3).lengths is None


@pytest.mark.parametrize(
    ("name", "scheme", "controls"),
    [
        ("elastic_pendulum", "gauss2", "linear"),
        ("elastic_pendulum", "gauss3", "stages"),
        ("rigid_pendulum", "lobatto3", "stages"),
        ("cart_pendulum_rigid", "lobatto3", "linear"),
        ("cart_pendulum_elastic", "gauss2", "stages"),
    ],
)
def test_controls_that_vary_within_steps(name: str, scheme: str, controls: str) -> None:
    """Far fewer steps than with constant controls, and the cost is as exact as was asked for."""
    s = mbocp.solve(problem(name, scheme=scheme, controls=controls, accuracy=1e-6))
    assert s.converged, s.advice
    assert true_error(s, name) <= 1e-6
    assert s.num_steps < 300  # with constant controls 1.0e-6 takes 180 to 2012


PHASES = [{"name": "first", "steps": 7, "duration": 2.0}, {"name": "second", "steps": 11, "duration": 3.0}]


@pytest.mark.parametrize(("controls", "asked"), [("constant", 1e-5), ("stages", 1e-7)])
def test_phases_get_numbers_of_steps_of_their_own(controls: str, asked: float) -> None:
    """A motion that is cut into phases has the cost of the whole."""
    case = problem("elastic_pendulum", scheme="gauss2", controls=controls).with_(phase=PHASES)
    asking = parse_problem(problem_to_toml(case.with_(accuracy=asked)))
    assert [phase.steps for phase in asking.phase] == [7, 11]
    s = mbocp.solve(asking)
    assert s.converged, s.advice
    assert true_error(s, "elastic_pendulum") <= asked
    assert s.accuracy.local_error <= asked
    dts = np.diff(s.t)
    first = s.t[1:] <= 2.0 + 1e-9
    assert dts[first].sum() == pytest.approx(2.0, rel=1e-12)
    for phase in (first, ~first):
        assert np.ptp(dts[phase]) < 1e-12
    assert dts[first].mean() != pytest.approx(dts[~first].mean(), rel=0.05)


@pytest.fixture(scope="module")
def best() -> mbocp.Solution:
    """The optimum of the elastic pendulum, to 1e-9."""
    return mbocp.solve(problem("elastic_pendulum", scheme="gauss3", controls="stages", num_steps=100))


@pytest.mark.parametrize("share", [0.4, 0.35])
def test_a_via_point_stays_at_its_node(share: float, best: mbocp.Solution) -> None:
    """One on the optimal motion costs nothing, if it is at the right time."""
    via = [{"name": "on the way", "share": share, "q": best.qs[round(100 * share)]}]
    case = problem("elastic_pendulum", scheme="gauss2", accuracy=1e-4, via=via)
    s = mbocp.solve(case)
    assert s.converged, s.advice
    assert share * s.num_steps == pytest.approx(round(share * s.num_steps), abs=1e-9)
    assert true_error(s, "elastic_pendulum") <= 1e-4
    node = round(share * s.num_steps)
    assert s.t[node] == pytest.approx(5.0 * share, rel=1e-12)
    np.testing.assert_allclose(s.qs[node], via[0]["q"], atol=1e-8)
    assert np.ptp(np.diff(s.t)) < 1e-12


def test_a_part_of_a_path_constraint_stays_where_it_is() -> None:
    kept = [{"kind": "speed", "frame": "bob", "max": 99.0, "from": 0.5, "until": {"share": 0.35}}]
    s = mbocp.solve(problem("elastic_pendulum", scheme="gauss2", accuracy=1e-4, path=kept))
    assert s.converged, s.advice
    assert s.num_steps % 20 == 0
    assert true_error(s, "elastic_pendulum") <= 1e-4


@pytest.mark.parametrize(("controls", "asked"), [("constant", 1e-4), ("stages", 1e-6)])
def test_a_free_duration(controls: str, asked: float) -> None:
    """Against many steps of a scheme of order six."""
    free = {"duration": {"min": 1.0, "max": 20.0, "guess": 5.0}, "cost": {"time": 1.0}}
    known = problem("elastic_pendulum", scheme="gauss3", controls="stages", num_steps=80, **free)
    true = mbocp.solve(known, check=True)
    s = mbocp.solve(problem("elastic_pendulum", scheme="gauss2", controls=controls, accuracy=asked, **free))
    assert s.converged, s.advice
    assert abs(s.cost / true.cost - 1.0) <= asked
    assert s.duration == pytest.approx(true.duration, rel=100 * asked)


def test_the_least_time_within_limits() -> None:
    """2 sqrt(100) s, and 150 degrees about an axis: 28.6304 s."""
    case = mbocp.load_problem(EXAMPLES / "optima/two_carts.toml")
    s = mbocp.solve(case.with_(accuracy=1e-4))
    assert s.converged, s.advice
    assert s.cost == pytest.approx(20.0, rel=1e-4)


def finer(case: mbocp.Problem, s: mbocp.Solution, factor: int) -> mbocp.Solution:
    """A motion with so many times the steps of a found one."""
    if not case.phase:
        return mbocp.solve(case.with_(num_steps=factor * s.num_steps), warm_start=s, check=True)
    found = parse_problem(s.problem_text).phase
    phases = tuple(dataclasses.replace(phase, steps=factor * phase.steps) for phase in found)
    return mbocp.solve(case.with_(phase=phases), warm_start=s, check=True)


def limit(case: mbocp.Problem, s: mbocp.Solution) -> float:
    """Cost of steps of no length, from two times and four times as many, of order two."""
    double, four = (finer(case, s, factor).cost for factor in (2, 4))
    assert abs(double - four) < 0.5 * abs(s.cost - double)
    return four + (four - double) / 3.0


@pytest.mark.parametrize("asked", [1e-3, 1e-5])
def test_phases_that_hold_and_let_go(asked: float) -> None:
    """The tip of a pendulum lands on a wire, slides and leaves it: the estimate is the error."""
    case = hits(scheme="midpoint")
    s = mbocp.solve(case.with_(accuracy=asked))
    assert s.converged, s.advice
    assert s.accuracy.local_error <= asked
    true = abs(s.cost / limit(case, s) - 1.0)
    assert true <= asked
    assert s.accuracy.cost_error == pytest.approx(true, rel=0.2)
    assert list(s.phase_times) == ["fall", "slide", "leave"]
    assert s.phase_times["slide"] == pytest.approx((0.2, 0.35))


@pytest.mark.parametrize("coordinates", ["joint", pytest.param("natural", marks=pytest.mark.slow)])
def test_a_throw(coordinates: str) -> None:
    """A ball that is held and let go, with a free body in the flight."""
    case = thrown(coordinates=coordinates)
    s = mbocp.solve(case.with_(accuracy=1e-3))
    assert s.converged, s.advice
    assert s.accuracy.local_error <= 1e-3
    assert abs(s.cost / limit(case, s) - 1.0) <= s.accuracy.cost_error <= 1e-3


@pytest.mark.parametrize(
    ("duration", "asked"), [pytest.param(5.0, 1e-3, marks=pytest.mark.slow), (1.5, 1e-2)]
)
def test_natural_coordinates(duration: float, asked: float) -> None:
    """Against gauss2 with controls at its stages; errors of two kinds cancel at 20 to 200 steps of 5 s."""
    words: dict[str, Any] = {"goal": {"q": [1.0, 0.5], "v": 0}}
    case = mbocp.Problem.create("double_pendulum", duration, 200, scheme="midpoint", **words)
    true = mbocp.solve(case.with_(scheme="gauss2", controls="stages"), check=True).cost
    s = mbocp.solve(case.with_(coordinates="natural", accuracy=asked))
    assert s.converged, s.advice
    assert s.coordinates == "natural"
    assert s.accuracy.local_error <= asked
    assert abs(s.cost / true - 1.0) <= 1.1 * s.accuracy.cost_error <= 1.1 * asked


@pytest.mark.parametrize(("start", "goal"), [([0.46, -0.21], [1.47, 0.53]), ([-0.71, -0.24], [-1.58, 0.53])])
def test_natural_coordinates_where_errors_of_costs_change_their_sign(
    start: list[float], goal: list[float]
) -> None:
    """Costs with 8 steps are too large, with 16 to 500 too small: their differences tell a third of it."""
    words: dict[str, Any] = {"start": {"q": start}, "goal": {"q": goal, "v": 0}, "cost": {"velocity": 0.1}}
    case = mbocp.Problem.create("double_pendulum", 2.0, 100, scheme="gauss2", **words)
    costs = [mbocp.solve(case.with_(num_steps=steps), check=True).cost for steps in (100, 200)]
    true = costs[1] + (costs[1] - costs[0]) / 3.0
    s = mbocp.solve(case.with_(coordinates="natural", scheme="midpoint", accuracy=0.03))
    assert s.converged, s.advice
    assert abs(s.cost / true - 1.0) <= 1.02 * s.accuracy.cost_error <= 1.02 * 0.03


@pytest.mark.slow
def test_around_obstacles() -> None:
    case = mbocp.load_problem(EXAMPLES / "arms/slalom.toml").with_(scheme="gauss2")
    s = mbocp.solve(case.with_(accuracy=1e-3))
    assert s.converged, s.advice
    finer = mbocp.solve(case.with_(num_steps=4 * s.num_steps), warm_start=s, check=True)
    assert s.cost == pytest.approx(finer.cost, rel=1e-3)
    assert s.clearance > -1e-8


@pytest.mark.filterwarnings("ignore:via 'odd'. between two nodes")  # of the example's 500
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"impacts": (5,)}, "given by numbers of steps; say them in phases"),
        (
            {"via": [{"name": "odd", "time": 0.7123456, "q": [0.0, 0.0, -5.0]}]},
            "via 'odd': no 200 steps or fewer have nodes",
        ),
        (
            {
                "phase": PHASES,
                "path": [{"kind": "speed", "frame": "bob", "max": 99.0, "until": {"share": 0.5}}],
            },
            "until: a share of equal steps, and lengths of steps are free or differ",
        ),
    ],
)
def test_what_accuracy_does_not_go_with_is_refused_by_name(changes: dict[str, Any], words: str) -> None:
    changes = {"scheme": "midpoint", **changes}
    with pytest.raises(ProblemError, match=words):
        problem("elastic_pendulum", **changes).with_(accuracy=1e-4)


def test_numbers_that_make_no_sense_are_refused() -> None:
    case = problem("elastic_pendulum")
    for accuracy in (0.0, -1.0, 1e-14, 0.5):
        with pytest.raises(InvalidValue, match=r"horizon\.accuracy"):
            case.with_(accuracy=accuracy)
    with pytest.raises(ProblemError, match=r"horizon\.accuracy: got nan, expected a finite number"):
        case.with_(accuracy=float("nan"))
    with pytest.raises(InvalidValue, match=r"horizon\.lengths\[3\]"):
        case.with_(num_steps=4, lengths=[0.5, 1.0, 1.0, 0.0])
    with pytest.raises(ProblemError, match=r"horizon\.lengths: they take 2 s"):
        case.with_(num_steps=4, lengths=[0.5, 0.5, 0.5, 0.5])
    both = ["horizon.accuracy=1e-4", "horizon.steps=10"]
    with pytest.raises(ProblemError, match="steps and accuracy both say which steps there are"):
        mbocp.load_problem(EXAMPLES / "paper/elastic_pendulum.toml", both)
