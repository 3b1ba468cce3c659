"""Which tasks a study has: grids, axes, samples, lists, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbocp.exceptions import MemoryLimitExceeded, ProblemFileError, StudyFileError
from mbocp.study import Study
from mbocp.study.task_kinds import first_of_each_kind

from .conftest import EXAMPLES, PENDULUM, MakeStudy

AXIS = {
    "name": "how",
    "values": [
        {"label": "plain", "solver.globalisation": "none"},
        {"label": "safe", "solver.globalisation": "default", "integrator.scheme": "midpoint"},
    ],
}


def overrides(study: Study) -> list[dict[str, Any]]:
    return [dict(task.overrides) for task in study.tasks()]


def test_a_grid_is_a_product_whose_last_key_is_fastest(make: MakeStudy) -> None:
    study = make(grid={"horizon.steps": [5, 10], "cost.effort": {"linspace": [1, 2, 3]}})
    assert len(study) == 6
    assert overrides(study) == [
        {"horizon.steps": steps, "cost.effort": effort} for steps in (5, 10) for effort in (1.0, 1.5, 2.0)
    ]
    assert [task.index for task in study.tasks()] == list(range(6))
    assert study.names == ("horizon.steps", "cost.effort")


def test_geomspace(make: MakeStudy) -> None:
    study = make(grid={"cost.effort": {"geomspace": [1e-4, 1, 5]}})
    np.testing.assert_allclose([t.values["cost.effort"] for t in study.tasks()], 10.0 ** np.arange(-4, 1))


def test_ranges_have_units(make: MakeStudy) -> None:
    key = "goal.q.bob"
    study = make(fixed={"goal.q": {}}, grid={key: {"linspace": [0, "180 deg", 3]}})
    np.testing.assert_allclose([task.values[key] for task in study.tasks()], [0, np.pi / 2, np.pi])
    drawn = make(sample={"count": 9, "cost.effort": {"uniform": ["90 deg", "180 deg"]}})
    assert all(np.pi / 2 <= task.values["cost.effort"] <= np.pi for task in drawn.tasks())
    with pytest.raises(StudyFileError, match=r"linspace: got .*, expected units of one sort"):
        make(grid={key: {"linspace": ["1 m", "180 deg", 3]}})


def test_units_of_ranges_fit_their_key(make: MakeStudy) -> None:
    study = make(grid={"horizon.duration": {"linspace": ["1 s", "2000 ms", 2]}}, time_limit="2 min")
    assert [task.values["horizon.duration"] for task in study.tasks()] == [1.0, 2.0]
    assert study.job.time_limit == 120.0
    with pytest.raises(StudyFileError, match=r"duration: got '1, as 1 m', a length, expected .* s"):
        make(grid={"horizon.duration": {"linspace": ["1 m", "2 m", 2]}})


def test_axes_have_named_values(make: MakeStudy) -> None:
    study = make(axis=[AXIS], grid={"horizon.steps": [5, 10]})
    tasks = list(study.tasks())
    assert [dict(task.values) for task in tasks] == [
        {"horizon.steps": steps, "how": label} for steps in (5, 10) for label in ("plain", "safe")
    ]
    assert tasks[1].overrides == {
        "horizon.steps": 5,
        "solver.globalisation": "default",
        "integrator.scheme": "midpoint",
    }


def test_grid_axes_and_list_multiply(make: MakeStudy) -> None:
    entries = [{"label": "near", "goal.q": [0, 0, -5]}, {"goal.q": [3, 0, -4], "goal.p": [0, 1, 0]}]
    study = make(grid={"horizon.steps": [5, 10]}, axis=[AXIS], list=entries)
    assert len(study) == 2 * 2 * 2
    first, second = study.task(0), study.task(1)
    assert first.values == {"horizon.steps": 5, "how": "plain", "label": "near", "goal.q": [0, 0, -5]}
    assert "label" not in first.overrides
    assert second.overrides["goal.p"] == [0, 1, 0]
    assert study.names == ("horizon.steps", "how", "label", "goal.q", "goal.p")
    with pytest.raises(IndexError):
        study.task(8)


def sampled(make: MakeStudy, key: str, draw: Any, count: int = 500, seed: int = 1, **more: Any) -> Any:
    study = make(seed=seed, sample={"count": count, key: draw, **more})
    return np.array([task.values[key] for task in study.tasks()])


def test_samples_have_their_distribution(make: MakeStudy) -> None:
    uniform = sampled(make, "cost.effort", {"uniform": [2, 4]})
    assert 2 <= uniform.min() < 2.05 < 3.95 < uniform.max() < 4
    normal = sampled(make, "start.p", {"normal": [[1, -1, 0], [0.1, 0.2, -0.0]]})
    assert normal.shape == (500, 3)
    np.testing.assert_allclose(normal.mean(axis=0), [1, -1, 0], atol=0.05)
    np.testing.assert_allclose(normal.std(axis=0), [0.1, 0.2, 0], rtol=0.1)
    words = sampled(make, "integrator.scheme", {"choice": ["se1", "se2"]})
    assert set(words) == {"se1", "se2"}


def test_samples_are_those_of_the_seed_and_the_key(make: MakeStudy) -> None:
    draw = {"uniform": [2, 4]}
    some = sampled(make, "cost.effort", draw)
    np.testing.assert_array_equal(some, sampled(make, "cost.effort", draw))
    assert not np.any(some == sampled(make, "cost.effort", draw, seed=2))
    np.testing.assert_array_equal(some, sampled(make, "cost.effort", draw, count=600)[:500])
    another = {"horizon.duration": {"uniform": [2, 4]}}
    np.testing.assert_array_equal(some, sampled(make, "cost.effort", draw, **another))
    assert not np.any(some == sampled(make, "horizon.duration", draw))


def test_what_is_fixed_comes_first(make: MakeStudy) -> None:
    fixed = {"goal.q": {"base_x": 0.0}, "robot.gravity": [0, 0, -1]}
    cart = {"robot": "cart_pendulum_rigid", "horizon": {"duration": 1.0, "steps": 5}}
    study = Study.from_tables({"problem": cart, "fixed": fixed, "grid": {"goal.q.base_x": [0.5, 1.0]}})
    assert study.job.document["goal"] == {"q": {"base_x": 0.0}}
    assert study.job.document["robot"] == {"name": "cart_pendulum_rigid", "gravity": [0, 0, -1]}


def test_the_digest_is_that_of_the_tasks(make: MakeStudy) -> None:
    study = make(grid={"horizon.steps": [5, 10]})
    assert study.digest == make(grid={"horizon.steps": [5, 10]}).digest
    assert study.digest == make(grid={"horizon.steps": [5, 10]}, summary={"by": ["horizon.steps"]}).digest
    for other in (
        make(grid={"horizon.steps": [5, 11]}),
        make(grid={"horizon.steps": [5, 10]}, time_limit=3),
        make(grid={"horizon.steps": [5, 10]}, fixed={"cost.effort": 2}),
        make(grid={"horizon.steps": [5, 10]}, record=["q_final"]),
    ):
        assert other.digest != study.digest


def test_groups_are_words_and_settings_but_no_goals(make: MakeStudy) -> None:
    study = make(
        grid={"goal.q": [[0, 0, -5], [3, 0, -4]], "horizon.steps": [5, 10], "solver.loop": ["open", "auto"]},
        axis=[AXIS],
        sample={
            "count": 3,
            "cost.effort": {"uniform": [1, 2]},
            "solver.hessian": {"choice": ["structured", "dense"]},
        },
    )
    assert study.groups == ("how", "horizon.steps", "solver.loop", "solver.hessian")
    assert make(grid={"horizon.steps": [5]}, summary={"by": []}).groups == ()


def test_kinds_differ_in_more_than_numbers(make: MakeStudy) -> None:
    study = make(
        grid={"goal.q": [[0, 0, -5], [3, 0, -4]], "cost.velocity": [0, 1, 2]},
        axis=[AXIS],
        sample={"count": 50, "start.p": {"uniform": [[0, 0, 0], [0, 1, 0]]}},
    )
    kinds = first_of_each_kind(study)
    assert [(t.values["cost.velocity"], t.values["how"]) for t in kinds] == [
        (0, "plain"),
        (0, "safe"),
        (1, "plain"),
        (1, "safe"),
    ]
    assert all(t.overrides == study.task(t.index).overrides for t in kinds)
    assert len(first_of_each_kind(make(grid={"robot.gravity": [[0, 0, -g] for g in range(100)]}))) == 64
    parameters = {"robot.payload.0.mass": [0.1, 0.2], "robot.lock.j1": [0.0, 0.1, 0.2]}
    robot = {**PENDULUM["robot"], "payload": [{"frame": "bob", "mass": 0.1}], "lock": {"j1": 0.0}}
    problem = {**PENDULUM, "robot": robot}
    assert len(first_of_each_kind(make(problem=problem, grid=parameters))) == 1
    others = {"robot.payload": [[], [{"frame": "bob", "mass": 0.1}], [{"frame": "bob", "mass": 0.2}]]}
    assert len(first_of_each_kind(make(problem=problem, grid=others))) == 2


def test_study_files(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text((EXAMPLES / "paper/rigid_pendulum.toml").read_text())
    folder = tmp_path / "studies"
    folder.mkdir()
    file = folder / "some.toml"
    file.write_text('problem = "../base.toml"\n[grid]\n"horizon.steps" = [5, 10]\n')
    study = Study.load(file)
    assert study.name == "some"
    assert study.job.source == folder / "../base.toml"
    assert len(study) == 2


def test_inline_problems_are_relative_to_the_study(tmp_path: Path) -> None:
    file = tmp_path / "some.toml"
    file.write_text(
        'name = "word"\n[problem]\nrobot = "ur5"\nhorizon = { duration = 1.0, steps = 5 }\n'
        '[grid]\n"horizon.steps" = [5, 10]\n'
    )
    study = Study.load(file)
    assert (study.name, study.job.source) == ("word", file)


@pytest.mark.parametrize(
    ("tables", "reason"),
    [
        ({}, "<study>: nothing is varied; add"),
        ({"grdi": {}}, r"<study>: grdi: unknown key, did you mean 'grid'\?"),
        ({"seed": -1}, "<study>: seed: got -1, expected a whole number, 0 or above"),
        ({"time_limit": 0}, "<study>: time_limit: got 0, expected a number above 0"),
        ({"grid": {"horizon.steps": []}}, "grid.horizon.steps: the list is empty"),
        ({"grid": {"horizon.steps": 5}}, "grid.horizon.steps: got 5, expected a list of values"),
        (
            {"grid": {"horizon.duration": {"linspace": [0, 1, 10**12]}}},
            "linspace: got count 1000000000000, expected a whole number from 1 to 1000000",
        ),
        ({"grid": {"horizon.steps": {"linspace": [0, 1]}}}, r"grid.horizon.steps.linspace: got \[0, 1\]"),
        (
            {"grid": {"cost.effort": {"linspace": [0, 1, 2.5]}}},
            "linspace: got count 2.5, expected a whole number",
        ),
        ({"grid": {"cost.effort": {"geomspace": [0, 1, 3]}}}, "geomspace: got 0 to 1, expected two numbers"),
        ({"grid": {"cost.effort": {"uniform": [0, 1]}}}, "grid.cost.effort: got {'uniform'.*linspace"),
        (
            {"grid": {"goal": {"q": {"a": [1]}}}},
            r'grid.goal: got a table; write dotted keys in quotes: "goal.q"',
        ),
        ({"fixed": {"solver": {"method": "auto"}}}, 'fixed.solver: got a table; .* "solver.method" = '),
        ({"fixed": {"goal..q": 1}}, "fixed.goal..q: 'goal..q' is not a key"),
        ({"axis": [{"name": "a", "values": []}]}, "axis.0.values: axis 'a' has no values"),
        (
            {"axis": [{"name": "a", "values": [{"cost.effort": 1}]}]},
            "axis.0.values.0: .* needs a name: label",
        ),
        (
            {"axis": [{"name": "a", "values": [{"label": "x"}, {"label": "x"}]}]},
            "axis.0.values.1: label 'x' stands twice",
        ),
        ({"axis": [{"name": "a"}]}, "axis.0.values: this key is missing"),
        ({"sample": {"count": 0, "cost.effort": {"uniform": [0, 1]}}}, "sample.count: got 0"),
        ({"sample": {"cost.effort": {"uniform": [0, 1]}}}, "sample.count: got None"),
        ({"sample": {"count": 3}}, "sample: has a count but no key"),
        (
            {"sample": {"count": 3, "cost.effort": [0, 1]}},
            r"sample.cost.effort: got \[0, 1\], expected { unif",
        ),
        ({"sample": {"count": 3, "cost.effort": {"uniform": [1, 0]}}}, "uniform: got .* low is above high"),
        (
            {"sample": {"count": 3, "cost.effort": {"uniform": [0]}}},
            r"uniform: got \[0\], expected \[low, high\]",
        ),
        (
            {"sample": {"count": 3, "goal.q": {"uniform": [[0, 1], [1]]}}},
            "uniform: got .* each a number or a list of one length",
        ),
        ({"sample": {"count": 3, "cost.effort": {"normal": [1, -1]}}}, "the deviation is below 0"),
        ({"sample": {"count": 3, "cost.effort": {"choice": []}}}, "choice: got .* at least one value"),
        (
            {"sample": {"count": 3, "cost.effort": {"uniform": [0, 1]}}, "list": [{"cost.tracking": 1}]},
            r"sample: give \[sample\] or \[\[list\]\], not both",
        ),
        (
            {"grid": {"cost.effort": [1]}, "list": [{"cost.effort": 1}]},
            "list: 'cost.effort' is varied by grid, too",
        ),
        ({"grid": {"cost.effort": [1]}, "fixed": {"cost.effort": 2}}, "fixed.cost.effort: is varied by grid"),
        (
            {"grid": {"cost.effort": [1]}, "record": ["q_fina"]},
            "record: a solution has no 'q_fina': .*'q_final'",
        ),
        (
            {"grid": {"cost.effort": [1]}, "summary": {"by": ["horizon.steps"]}},
            "summary.by: 'horizon.steps' is not varied",
        ),
        ({"grid": {"cost.effrot": [1]}}, r"<study>: cost.effrot: unknown key, did you mean 'effort'\?"),
        ({"grid": {"horizon.steps": [2.5]}}, "<study>: horizon.steps: got 2.5, expected a whole number"),
        ({"grid": {"goal.q.bob": [1]}}, r"<study>: goal.q is \[0, 0, -5\], which has no keys below it"),
        (
            {"grid": {"cost.effort": [1]}, "list": [{"cost.tracking": 0}, {"cost.betta": 1}]},
            "cost.betta: unknown",
        ),
    ],
)
def test_what_is_wrong_is_said(make: MakeStudy, tables: dict[str, Any], reason: str) -> None:
    with pytest.raises(StudyFileError, match=reason):
        make(**tables)


def test_more_samples_than_memory_holds_are_refused(make: MakeStudy) -> None:
    with pytest.raises(MemoryLimitExceeded, match=r"sample.count = .* GB of memory.*Take fewer"):
        make(sample={"count": 2**62, "cost.effort": {"uniform": [0, 1]}})


def test_mistakes_of_the_problem_are_told_from_those_of_the_study() -> None:
    wrong = {**PENDULUM, "horizon": {"duration": 1.0, "stepz": 5}}
    with pytest.raises(ProblemFileError, match=r"horizon.stepz: unknown key"):
        Study.from_tables({"problem": wrong, "grid": {"cost.effort": [1, 2]}})
    with pytest.raises(ProblemFileError, match=r"nowhere.toml: no such file"):
        Study.from_tables({"problem": "nowhere.toml", "grid": {"cost.effort": [1, 2]}})
    with pytest.raises(StudyFileError, match="problem: got 3, expected the path of a problem file"):
        Study.from_tables({"problem": 3, "grid": {"cost.effort": [1, 2]}})


def test_files_that_are_no_study(tmp_path: Path) -> None:
    with pytest.raises(StudyFileError, match=r"some.toml: no such file"):
        Study.load(tmp_path / "some.toml")
    with pytest.raises(StudyFileError, match=r"is a folder, expected a study file"):
        Study.load(tmp_path)
    (tmp_path / "some.toml").write_text("problem = \n")
    with pytest.raises(StudyFileError, match=r"malformed TOML"):
        Study.load(tmp_path / "some.toml")
