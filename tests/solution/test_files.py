"""Result files: what goes in comes out, and nothing half-written or foreign gets through."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mbocp.exceptions import ResultFileError
from mbocp.solution import IterationRecord, Solution, Status
from mbocp.solution.atomic import atomic_path
from mbocp.solution.problem_facts import BrakingPlace, Facts
from mbocp.storage import seal

from .damage import edit, make_old
from .fabricated import arm, humanoid, limited, pendulum


@pytest.mark.parametrize("make", [pendulum, arm, humanoid, limited])
def test_round_trip(make: Any, tmp_path: Path) -> None:
    saved = make()
    assert saved.save(tmp_path / "result.h5") == tmp_path / "result.h5"
    assert Solution.load(tmp_path / "result.h5") == saved


def test_round_trip_of_odd_numbers(tmp_path: Path) -> None:
    nothing = IterationRecord(iteration=3, residual=float("inf"), cost=float("-inf"))
    saved = pendulum(
        cost=float("nan"),
        residual=float("inf"),
        history=(nothing,),
        qs=np.full((101, 3), np.nan),
        status="diverged",
        advice="ζ\n%s",
        facts_kept=Facts(braking=(BrakingPlace("slide", np.float64(-np.inf), np.float64(1.0), 2.0, 0.0),)),
    )
    saved.save(tmp_path / "result.h5")
    assert Solution.load(tmp_path / "result.h5") == saved


def test_files_without_meanings_of_the_control_momenta_load(tmp_path: Path) -> None:
    pendulum().save(tmp_path / "result.h5")

    def as_0_1_0_wrote_it(file: h5py.File) -> None:
        del file["trajectories/control_momenta"].attrs["meanings"]

    make_old(tmp_path / "result.h5", as_0_1_0_wrote_it)
    old = Solution.load(tmp_path / "result.h5")
    assert old == pendulum(control_momentum_meanings=())
    assert [quantity.name for quantity in old.conserved] == ["rotation about z"]


def test_files_of_format_1_load_with_defaults(tmp_path: Path) -> None:
    solution = pendulum()
    solution.save(tmp_path / "result.h5")
    new = ("scheme", "lie", "rotations", "substeps", "limit_violation", "manifold_drift")

    def as_format_1(file: h5py.File) -> None:
        file.attrs["format_version"] = 1
        for name in (*new, "manifold_drift_resimulated"):
            del file["summary"].attrs[name]

    make_old(tmp_path / "result.h5", as_format_1)
    old = Solution.load(tmp_path / "result.h5")
    assert old == solution
    assert (old.scheme, old.lie, old.substeps, old.rotations) == ("", "", 0, "")
    assert np.isinf(old.limits_v).all()
    assert not old.lam_us.any()


def test_what_says_nothing_is_not_in_the_file(tmp_path: Path) -> None:
    pendulum().save(tmp_path / "free.h5")
    limited().save(tmp_path / "limited.h5")
    with h5py.File(tmp_path / "free.h5") as free, h5py.File(tmp_path / "limited.h5") as bounded:
        added = set(bounded["trajectories"]) - set(free["trajectories"])
    assert added == {"lam_us", "lam_vs", "lam_path", "limits_u", "limits_v", "manifold_drifts"}


def test_every_dataset_describes_itself(tmp_path: Path) -> None:
    limited().save(tmp_path / "result.h5")
    with h5py.File(tmp_path / "result.h5") as file:
        assert file["trajectories/lams"].attrs["symbol"] == "lambda"
        assert "multiplier" in file["trajectories/lams"].attrs["description"]
        assert file.attrs["format"] == "mbocp solution"
        assert file.attrs["format_version"] == 3
        assert file["summary"].attrs["status"] == "converged"
        for name, data in file["trajectories"].items():
            assert {"description", "symbol", "rows", "columns", "units"} <= set(data.attrs), name
        assert list(file["trajectories/us"].attrs["columns"]) == ["force_x", "force_y", "force_z"]
        assert list(file["trajectories/vs"].attrs["units"]) == ["m/s"] * 3
        assert all("description" in data.attrs for data in file["text"].values())


def test_an_interrupted_save_leaves_the_old_file_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "result.h5"
    old = pendulum()
    old.save(path)

    def interrupted(handle: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)  # after the new file is written
    with pytest.raises(KeyboardInterrupt):
        arm().save(path)
    assert list(tmp_path.iterdir()) == [path]
    assert Solution.load(path) == old


def test_a_full_disk_is_an_error_and_leaves_the_old_file_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "result.h5"
    old = pendulum()
    old.save(path)

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ResultFileError, match=r"No space left on device; what was there before is unchanged"):
        arm().save(path)
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == [path]
    assert Solution.load(path) == old


def test_saving_into_nowhere(tmp_path: Path) -> None:
    with pytest.raises(ResultFileError, match=r"folder .*missing does not exist: create it first"):
        pendulum().save(tmp_path / "missing" / "result.h5")
    with pytest.raises(ResultFileError, match="is a folder"):
        pendulum().save(tmp_path)


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link.h5").symlink_to(tmp_path / "real.h5")
    with atomic_path(tmp_path / "link.h5") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link.h5").is_symlink()
    assert (tmp_path / "real.h5").read_text() == "new"


def test_the_file_has_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    pendulum().save(tmp_path / "result.h5")
    assert (tmp_path / "result.h5").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_missing_file_a_folder_and_a_foreign_file(tmp_path: Path) -> None:
    with pytest.raises(ResultFileError, match="no such file"):
        Solution.load(tmp_path / "none.h5")
    with pytest.raises(ResultFileError, match="is a folder, expected a result file"):
        Solution.load(tmp_path)
    (tmp_path / "text.h5").write_text("robot = 'panda'\n")
    with pytest.raises(ResultFileError, match="not even HDF5"):
        Solution.load(tmp_path / "text.h5")
    (tmp_path / "empty.h5").write_text("")
    with pytest.raises(ResultFileError, match="not even HDF5"):
        Solution.load(tmp_path / "empty.h5")
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["x"] = np.zeros(3)
    with pytest.raises(ResultFileError, match="is HDF5, but not a result file of mbocp"):
        Solution.load(tmp_path / "foreign.h5")


def test_a_truncated_file_is_refused_at_any_length(tmp_path: Path) -> None:
    pendulum().save(tmp_path / "result.h5")
    whole = (tmp_path / "result.h5").read_bytes()
    for fraction in (0.001, 0.01, 0.1, 0.5, 0.9, 0.999):
        (tmp_path / "cut.h5").write_bytes(whole[: int(len(whole) * fraction)])
        with pytest.raises(ResultFileError, match="is damaged or incomplete"):
            Solution.load(tmp_path / "cut.h5")


def test_parts_that_are_missing_or_do_not_fit(tmp_path: Path) -> None:
    def without_adjoints(file: h5py.File) -> None:
        del file["trajectories/mus"]

    pendulum().save(tmp_path / "a.h5")
    edit(tmp_path / "a.h5", without_adjoints)
    with pytest.raises(ResultFileError, match=r"damaged or incomplete .*mus"):
        Solution.load(tmp_path / "a.h5")

    def with_fewer_nodes(file: h5py.File) -> None:
        columns = dict(file["trajectories/t"].attrs)
        del file["trajectories/t"]
        file["trajectories/t"] = np.arange(7.0)
        file["trajectories/t"].attrs.update(columns)

    pendulum().save(tmp_path / "b.h5")
    edit(tmp_path / "b.h5", with_fewer_nodes)
    with pytest.raises(ResultFileError, match=r"do not fit together .*vs: got shape"):
        Solution.load(tmp_path / "b.h5")


def test_a_newer_format_asks_for_an_upgrade(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seal, "FORMAT_VERSION", 4)
    pendulum().save(tmp_path / "result.h5")
    monkeypatch.undo()
    with pytest.raises(ResultFileError, match=r"has format 4, written by a newer mbocp; .* up to 3: upgrade"):
        Solution.load(tmp_path / "result.h5")


def test_names_of_very_many_columns_fit(tmp_path: Path) -> None:
    """More than 4096 names are more than HDF5's oldest format allows."""
    names = tuple(f"constraint {i}" for i in range(5000))
    saved = pendulum(num_steps=2, path_names=names, lam_path=np.zeros((2, 5000)))
    saved.save(tmp_path / "result.h5")
    assert Solution.load(tmp_path / "result.h5") == saved


def test_an_impact_moves_nothing_where_a_solve_converged_and_may_where_it_did_not(tmp_path: Path) -> None:
    t = np.array(pendulum().t)
    t[40] = t[39]
    begun = pendulum(t=t, status=Status.MAX_ITERATIONS)
    assert Solution.load(begun.save(tmp_path / "begun.h5")) == begun
    done = pendulum(t=t).save(tmp_path / "done.h5")
    with pytest.raises(ResultFileError, match="but for impacts"):
        Solution.load(done)
