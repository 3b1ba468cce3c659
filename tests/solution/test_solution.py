"""A solution holds together: shapes, derived values, equality."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from mbocp import Problem
from mbocp.exceptions import DimensionMismatch, InvalidValue
from mbocp.formulation import Motion
from mbocp.solution import Column, IterationRecord, Labels, Status
from mbocp.solution.goal_error import goal_error
from mbocp.solution.problem_facts import Facts, PathRow

from .fabricated import arm, limited, pendulum


def test_arrays_are_copies_and_read_only() -> None:
    t = np.linspace(0.0, 1.5, 101)
    solution = pendulum(t=t)
    t[0] = 9.0
    assert solution.t[0] == 0.0
    for name in ("t", "qs", "vs", "ps", "us", "lams", "mus", "zetas", "eta", "control_momenta"):
        assert not getattr(solution, name).flags.writeable, name


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("qs", (100, 3)),
        ("vs", (100, 3)),
        ("ps", (101, 2)),
        ("us", (101, 3)),
        ("lams", (101, 1)),
        ("mus", (101, 5)),
        ("zetas", (100, 2)),
        ("eta", (2, 2)),
        ("t", (1,)),
        ("control_hamiltonians", (101,)),
        ("control_momenta", (101, 2)),
        ("manifold_drifts", (100,)),
        ("lam_us", (101, 3)),
        ("lam_vs", (100, 3)),
        ("lam_qs", (101, 2)),
        ("lam_path", (100, 1)),
        ("limits_u", (3, 3)),
        ("limits_v", (2, 2)),
        ("limits_q", (2, 7)),
    ],
)
def test_a_wrong_shape_is_refused_by_name(name: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(DimensionMismatch, match=name):
        pendulum(**{name: np.zeros(shape)})


def test_without_limits_nothing_is_active() -> None:
    solution = arm()
    assert solution.limits_u.shape == solution.limits_q.shape == (2, 7)
    assert (solution.lam_us.shape, solution.lam_qs.shape) == ((100, 7), (101, 7))
    assert np.isinf(solution.limits_v).all()
    assert solution.lam_path.shape == (100, 0)
    assert solution.active_limits == ()
    assert np.isnan([solution.manifold_drift, solution.manifold_drift_resimulated]).all()
    assert solution.limit_violation == 0.0


def test_limits_that_the_motion_touches() -> None:
    solution = limited()
    found = {(a.kind, a.name, a.side): a for a in solution.active_limits}
    assert ("velocity", "z", "upper") not in found  # as fast as it likes
    upper = found["control", "force_x", "upper"]
    assert (upper.bound, upper.unit, upper.total) == (25.0, "N", 20)
    assert upper.count == np.count_nonzero(solution.us[:, 0] == 25.0)
    assert found["path", "ceiling.z", "lower"].count == 3
    assert not any(name == "clearance" for _, name, _ in found)


def test_small_motors_are_not_at_limits_that_they_are_far_from() -> None:
    us = np.tile([1e-12, 0.0, 0.0], (20, 1))
    sides = np.array([[-2e-12, -1.0, -1.0], [1e-12, 1.0, 1.0]])
    (found,) = [a for a in limited(us=us, limits_u=sides).active_limits if a.kind == "control"]
    assert (found.name, found.side, found.count) == ("force_x", "upper", 20)


def test_bounds_of_path_constraints_are_those_of_the_problem() -> None:
    facts = Facts(path=(PathRow("ceiling.z", -5.5, np.inf, "m", 20),))
    (ceiling,) = [a for a in limited(facts_kept=facts).active_limits if a.kind == "path"]
    assert (ceiling.name, ceiling.side, ceiling.bound, ceiling.unit) == ("ceiling.z", "lower", -5.5, "m")
    (unknown,) = [a for a in limited().active_limits if a.kind == "path"]
    assert np.isnan(unknown.bound)


def test_what_a_barrier_leaves_over_is_not_active() -> None:
    assert not [a for a in limited(lam_path=np.full((20, 2), 1e-9)).active_limits if a.kind == "path"]
    broken = limited(mus=np.full((21, 6), np.nan), lam_path=np.full((20, 2), np.nan))
    assert not [a for a in broken.active_limits if a.kind == "path"]


def test_the_start_does_not_count_as_touching() -> None:
    vs = np.zeros((21, 3))
    vs[0] = 2.0
    assert not [a for a in limited(vs=vs).active_limits if a.kind == "velocity"]


def test_the_drift_is_the_largest_of_all() -> None:
    assert limited().manifold_drift == 3e-9
    assert limited(manifold_drift=1.0).manifold_drift == 1.0


def test_labels_must_fit_their_trajectory() -> None:
    with pytest.raises(DimensionMismatch, match=r"labels\.u"):
        pendulum(labels=Labels(u=(Column("only one", "N"),)))


def test_labels_that_are_left_out_are_numbered() -> None:
    solution = pendulum(labels=Labels())
    assert [c.name for c in solution.labels.mu] == ["0", "1", "2", "0", "1", "2"]
    assert solution.labels.q[0].header == "0"


def test_what_is_absent_has_no_columns() -> None:
    solution = arm(lams=np.zeros(0), zetas=np.zeros(0), control_hamiltonians=np.zeros(0))
    assert solution.lams.shape == solution.zetas.shape == (100, 0)
    assert np.isnan(solution.control_hamiltonian["min"])
    quiet = arm(control_momenta=np.zeros(0), control_momentum_names=(), control_momentum_meanings=())
    assert np.isnan(quiet.control_momentum_drift)
    assert quiet.conserved == ()


def test_derived_values() -> None:
    momenta = np.zeros((101, 2))
    momenta[7, 1], momenta[0, 1] = -3.0, 1.0
    solution = pendulum(
        control_momenta=momenta,
        control_momentum_names=("translation along x", "rotation about z"),
        control_momentum_meanings=(),
    )
    assert (solution.num_steps, solution.nq, solution.nv, solution.nu, solution.nc) == (100, 3, 3, 3, 1)
    assert solution.control_momentum_drift == 4.0
    assert solution.control_hamiltonian["max"] == np.max(solution.control_hamiltonians)
    assert solution.control_hamiltonian["mean"] == np.mean(solution.control_hamiltonians)
    assert np.array_equal(solution.q_final, solution.qs[-1])
    assert np.array_equal(solution.p_final, solution.ps[-1])
    assert np.array_equal(solution.u_first, solution.us[0])
    assert np.array_equal(solution.u_last, solution.us[-1])
    assert solution.duration == 1.5


def test_conserved_quantities_sum_up_the_control_momenta() -> None:
    momenta = np.tile([2.0, -4.0, 1e-12], (101, 1))
    momenta[50] += [1e-3, -2e-3, 3e-12]
    names, meanings = ("translation along x", "translation along y", "rotation about z"), ("a", "", "c")
    solution = pendulum(
        control_momenta=momenta, control_momentum_names=names, control_momentum_meanings=meanings
    )
    along_x, along_y, about_z = solution.conserved
    assert (along_x.name, along_x.meaning, along_x.value) == ("translation along x", "a", 2.0)
    assert along_x.drift == pytest.approx(1e-3)
    assert along_x.relative_drift == pytest.approx(5e-4)
    assert along_y.value == -4.0
    assert along_y.relative_drift == pytest.approx(5e-4)
    assert not along_y.vanishes
    # Beside adjoints of about 3 that is round-off, and a drift relative to it says nothing.
    assert about_z.vanishes
    assert np.isnan(about_z.relative_drift)
    assert about_z.drift == pytest.approx(3e-12)


def test_meanings_belong_to_names() -> None:
    with pytest.raises(DimensionMismatch, match="control_momentum_meanings"):
        pendulum(control_momentum_meanings=("one", "two"))
    assert pendulum(control_momentum_meanings=()).control_momentum_meanings == ("",)


def test_only_one_status_is_converged() -> None:
    assert [s for s in Status if pendulum(status=s).converged] == [Status.CONVERGED]
    assert pendulum(status="max_iterations").status is Status.MAX_ITERATIONS
    assert f"{Status.SINGULAR}" == str(Status.SINGULAR) == "singular"


def test_repr_is_short_and_says_what_matters() -> None:
    text = repr(pendulum())
    assert len(text) < 140
    assert "rigid_pendulum: converged after 9 iterations of monolithic, cost 12.3456789" in text


def test_equality_is_by_content_and_nan_equals_nan() -> None:
    assert pendulum() == pendulum()
    assert pendulum(cost=float("nan")) == pendulum(cost=float("nan"))
    assert pendulum().equals("something else") is False
    qs = pendulum().qs.copy()
    qs[50, 1] = np.nextafter(qs[50, 1], 9.0)
    assert pendulum() != pendulum(qs=qs)
    record = IterationRecord(iteration=0, residual=1.0)
    assert pendulum(history=(record,)) != pendulum(history=(dataclasses.replace(record, cost=2.0),))


def test_solutions_travel_between_processes() -> None:
    assert pickle.loads(pickle.dumps(pendulum())) == pendulum()


def test_options_that_no_file_can_hold_are_refused() -> None:
    with pytest.raises(InvalidValue, match=r"options: got function"):
        pendulum(options={"callback": lambda: None})


def test_options_are_copied() -> None:
    options = {"nested": {"tolerance": 1e-9}}
    solution = pendulum(options=options)
    options["nested"]["tolerance"] = 1.0
    assert solution.options["nested"]["tolerance"] == 1e-9


def test_what_is_met_exactly_is_off_by_nothing() -> None:
    """The first joint, which may end anywhere, is far from a number that nobody asked."""
    goal = {"q": {"joint2": 0.4}, "v": {"joint2": 0.0}}
    problem = Problem.create("double_pendulum", 1.0, 2, start={"q": [0.0, 0.0]}, goal=goal)
    vs = np.array([[0.0, 0.0], [1.0, 0.4], [2.0, 0.0]])
    motion = Motion(np.array([[0.0, 0.0], [0.5, 0.2], [1.5, 0.4]]), vs, np.zeros((2, 2)), np.full(2, 0.5))
    expected = "off by 0.00e+00 rad at joint2, velocity by 0.00e+00 rad/s at joint2"
    assert goal_error(problem, motion, vs) == expected
