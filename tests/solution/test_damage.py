"""Result files that are damaged: one line says so, no number changes, no process dies."""

from __future__ import annotations

import gzip
import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mbocp.exceptions import MbocpError, ResultFileError
from mbocp.solution import Solution
from mbocp.solution.problem_facts import Facts
from mbocp.solution.solution import ProblemNotShownWarning
from mbocp.storage import guarded, seal

from .damage import edit, edited_image, make_old
from .fabricated import limited, pendulum


@pytest.fixture
def result(tmp_path: Path) -> Path:
    return limited().save(tmp_path / "result.h5")


def flips(size: int) -> Iterator[tuple[int, int]]:
    """Every bit of the seal's lines, and some of all the others."""
    yield from ((byte, bit) for byte in range(140) for bit in range(8))
    draw = random.Random(1)
    yield from ((draw.randrange(size), draw.randrange(8)) for _ in range(300))


def test_every_flipped_bit_is_refused_before_hdf5_sees_the_file(
    result: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*_: Any) -> None:
        raise AssertionError("HDF5 got a damaged file")

    monkeypatch.setattr("mbocp.storage.hdf5.content_of", opened)
    monkeypatch.setattr(seal, "renew", opened)
    content = bytearray(pendulum(num_steps=2).save(result).read_bytes())
    for byte, bit in flips(len(content)):
        content[byte] ^= 1 << bit
        result.write_bytes(content)
        with pytest.raises(ResultFileError, match=r"is damaged|no result file|not a result file"):
            seal.read_image(result)
        content[byte] ^= 1 << bit


def test_the_digest_is_that_of_any_other_tool(result: Path) -> None:
    import hashlib

    content = result.read_bytes()
    written = content.splitlines()[1].removeprefix(b"sha256 ")
    rest = content.replace(written, b"", 1)
    assert hashlib.sha256(rest).hexdigest().encode() == written


@pytest.mark.parametrize("more", [b"\0", b"tail"])
def test_bytes_behind_the_end_are_refused(result: Path, more: bytes) -> None:
    result.write_bytes(result.read_bytes() + more)
    with pytest.raises(ResultFileError, match="does not match its digest"):
        Solution.load(result)


def test_a_file_that_another_program_changed_is_refused(result: Path) -> None:
    with h5py.File(result, "r+") as file:
        file["summary"].attrs["cost"] = 1.0
    with pytest.raises(ResultFileError, match="was changed after mbocp wrote it"):
        Solution.load(result)


def test_without_the_first_bytes_it_is_refused(result: Path) -> None:
    result.write_bytes(result.read_bytes()[seal.SEAL_SIZE :])
    with pytest.raises(ResultFileError, match="has lost its first 512 bytes"):
        Solution.load(result)


def test_foreign_hdf5_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "foreign.h5", "w", userblock_size=512) as file:
        file["x"] = np.zeros(3)
    with pytest.raises(ResultFileError, match="no result file of mbocp"):
        Solution.load(tmp_path / "foreign.h5")


def test_what_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    for path in (tmp_path / "pipe.h5", Path("/dev/zero")):
        with pytest.raises(ResultFileError, match=r"is a (pipe|device), expected a result file"):
            Solution.load(path)
    for name in ("x" * 300 + ".h5", "a\0b.h5"):
        with pytest.raises(ResultFileError, match="cannot be read"):
            Solution.load(tmp_path / name)


def test_a_file_that_is_too_large_is_not_read(result: Path) -> None:
    with result.open("r+b") as file:
        file.truncate(seal.LARGEST + 1)  # a hole, which takes no space
    with pytest.raises(ResultFileError, match=r"has 2048\.0 MB, expected a result file of at most 2048 MB"):
        Solution.load(result)


def test_a_result_that_would_be_too_large_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbocp.solution.files.LARGEST", 10_000)
    with pytest.raises(ResultFileError, match="a result file has 10000 at most"):
        pendulum().save(tmp_path / "result.h5")
    assert list(tmp_path.iterdir()) == []


# Files of formats 1 and 2.


def test_a_sound_old_file_loads(tmp_path: Path) -> None:
    make_old(limited().save(tmp_path / "old.h5"))
    assert Solution.load(tmp_path / "old.h5") == limited()


def test_a_file_of_format_2_as_it_was_written_loads(tmp_path: Path) -> None:
    packed = Path(__file__).parents[1] / "data" / "result_of_format_2.h5.gz"
    (tmp_path / "old.h5").write_bytes(gzip.decompress(packed.read_bytes()))
    old = Solution.load(tmp_path / "old.h5")
    assert (old.converged, old.num_steps, old.robot_name) == (True, 8, "rigid_pendulum")
    assert old.cost == 381.6617184675394
    assert old.residual < 1e-9
    old.save(tmp_path / "new.h5")
    assert Solution.load(tmp_path / "new.h5") == old


def test_old_files_are_refused_for_the_same_reasons(tmp_path: Path) -> None:
    path = tmp_path / "old.h5"
    make_old(pendulum().save(path), lambda file: file.attrs.__setitem__("format", "another"))
    with pytest.raises(ResultFileError, match="is HDF5, but not a result file of mbocp"):
        Solution.load(path)
    make_old(pendulum().save(path), lambda file: file["trajectories"].__delitem__("vs"))
    with pytest.raises(ResultFileError, match=r"damaged or incomplete \(vs is missing"):
        Solution.load(path)


def never_written(name: str, shape: tuple[int, ...], **options: Any) -> Callable[[h5py.File], None]:
    """Declare an array or text of another size, in chunks of which none, or only the first, is written."""

    def change(file: h5py.File) -> None:
        attributes, kind = dict(file[name].attrs), file[name].dtype
        del file[name]
        made = file.create_dataset(name, shape, kind, chunks=(10**5, *shape[1:]), **options)
        made.attrs.update(attributes)

    return change


@pytest.mark.parametrize(
    ("name", "shape"), [("text/problem_text", (10**9,)), ("trajectories/us", (4 * 10**7, 3))]
)
@pytest.mark.parametrize("packing", [None, "gzip"])
def test_what_an_old_file_declares_and_does_not_hold_takes_no_memory(
    name: str, shape: tuple[int, ...], packing: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_old(pendulum().save(tmp_path / "old.h5"), never_written(name, shape, compression=packing))
    monkeypatch.setattr(guarded, "LIMITS", guarded.ReadLimits(memory=700 << 20))
    words = rf"{name.partition('/')[2]} declares \d+ bytes, and 0 were written"
    with pytest.raises(ResultFileError, match=words):
        Solution.load(tmp_path / "old.h5")


def test_an_old_file_may_be_packed(tmp_path: Path) -> None:
    def pack(file: h5py.File) -> None:
        for name in [*(f"trajectories/{n}" for n in file["trajectories"]), "text/history"]:
            attributes, values = dict(file[name].attrs), file[name][()]
            if values.size:
                del file[name]
                file.create_dataset(name, data=values, compression="gzip", shuffle=True)
                file[name].attrs.update(attributes)

    make_old(limited().save(tmp_path / "old.h5"), pack)
    assert Solution.load(tmp_path / "old.h5") == limited()


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "HDF5 crashed on it, signal 11"),
        ("while True: pass", r"reading it did not end in 1 s"),
        ("import time; time.sleep(60)", r"reading it did not end in 0.5 s"),
        ("import os; os._exit(1)", "ended with status 1"),
        ("x = bytearray(1 << 40)", "ended with status 1"),
        ("pass", "not even HDF5"),
    ],
)
def test_a_process_that_crashes_or_never_ends_is_one_line(
    code: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_old(pendulum(num_steps=2).save(tmp_path / "old.h5"))
    limit = "import resource; resource.setrlimit(resource.RLIMIT_CPU, (1, 2))\n"
    monkeypatch.setattr(guarded, "_START", limit + code)
    monkeypatch.setattr(
        guarded, "LIMITS", guarded.ReadLimits(cpu_seconds=1, wall_seconds=0.5 if "sleep" in code else 60.0)
    )
    with pytest.raises(ResultFileError, match=reason):
        Solution.load(tmp_path / "old.h5")


def test_the_process_has_limits_of_time_and_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_old(pendulum(num_steps=2).save(tmp_path / "old.h5"))
    monkeypatch.setattr(guarded, "LIMITS", guarded.ReadLimits(memory=1 << 20))
    with pytest.raises(ResultFileError, match="is damaged"):
        Solution.load(tmp_path / "old.h5")


# Contents that mbocp does not write, behind a right digest.


def put(name: str, value: Any) -> Callable[[h5py.File], None]:
    """Replace an array and keep what is said of it."""

    def change(file: h5py.File) -> None:
        attributes = dict(file[name].attrs)
        del file[name]
        file[name] = value
        file[name].attrs.update(attributes)

    return change


def put_text(name: str, value: str) -> Callable[[h5py.File], None]:
    return put(f"text/{name}", np.frombuffer(value.encode(), dtype=np.uint8))


def put_attribute(group: str, name: str, value: Any) -> Callable[[h5py.File], None]:
    return lambda file: file[group].attrs.__setitem__(name, value)


def nan_in(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[name][(-1,) * file[name].ndim] = np.nan

    return change


def huge(file: h5py.File) -> None:
    del file["trajectories/us"]
    file["trajectories"].create_dataset("us", shape=(10**9, 100), chunks=(1000, 100), dtype=float)


def elsewhere(file: h5py.File) -> None:
    del file["trajectories/us"]
    file["trajectories"]["us"] = h5py.ExternalLink("/etc/passwd", "us")


def outside(file: h5py.File) -> None:
    del file["text/problem_text"]
    external = [("/etc/passwd", 0, 100)]
    file["text"].create_dataset("problem_text", (100,), dtype=np.uint8, external=external)


def in_circles(file: h5py.File) -> None:
    del file["trajectories/us"]
    file["trajectories"]["us"] = file["trajectories"]


T, TEXT = "trajectories", "text"
WRONG: dict[str, tuple[Callable[[h5py.File], object], str]] = {
    "nan_converged": (nan_in(f"{T}/qs"), r"qs: got nan at \[20, 2\], expected finite numbers"),
    "nan_adjoint_converged": (nan_in(f"{T}/eta"), "eta: got nan"),
    "inf_converged": (put(f"{T}/us", np.full((20, 3), np.inf)), "us: got inf at"),
    "nan_cost_converged": (put_attribute("summary", "cost", np.nan), "cost: got nan"),
    "times_that_stand_still": (put(f"{T}/t", np.zeros(21)), "t: got other numbers"),
    "time_nan": (nan_in(f"{T}/t"), "t: got other numbers"),
    "limits_that_cross": (put(f"{T}/limits_u", np.outer([1, -1], np.ones(3))), "limits_u: got other"),
    "scalar_us": (put(f"{T}/us", 1.0), r"us: got shape \(\), expected a table"),
    "scalar_qs": (put(f"{T}/qs", 1.0), r"qs: got shape \(\)"),
    "scalar_t": (put(f"{T}/t", 1.0), "t: got"),
    "scalar_lams": (put(f"{T}/lams", 1.0), "lams: got shape"),
    "flat_vs": (put(f"{T}/vs", np.zeros(21)), "vs: got"),
    "deep_us": (put(f"{T}/us", np.zeros((20, 3, 2))), "us: got"),
    "text_array": (put(f"{T}/us", "words"), "us is not of float64"),
    "complex_array": (put(f"{T}/us", np.zeros((20, 3), dtype=complex)), "us is not of float64"),
    "null_array": (put(f"{T}/us", h5py.Empty("f8")), "us is not of float64"),
    "huge_array": (huge, r"declares \d+ bytes, and \d+ are possible"),
    "array_elsewhere": (elsewhere, "us is a link"),
    "text_elsewhere": (outside, "problem_text is stored in another file"),
    "group_for_array": (in_circles, "us is no dataset"),
    "no_text": (lambda file: file.__delitem__("text"), "text is missing"),
    "no_summary": (lambda file: file.__delitem__("summary"), "summary is missing"),
    "no_history": (lambda file: file["text"].__delitem__("history"), "text: history: got nothing"),
    "no_status": (lambda file: file["summary"].attrs.__delitem__("status"), "status: got nothing"),
    "new_status": (put_attribute("summary", "status", "splendid"), "summary: status: got 'splendid'"),
    "number_for_word": (put_attribute("summary", "solver", 3), "summary: solver: got 3"),
    "word_for_number": (put_attribute("summary", "cost", "low"), "summary: cost: got 'low'"),
    "half_iteration": (put_attribute("summary", "iterations", 1.5), "summary: iterations: got 1.5"),
    "negative_count": (put_attribute("summary", "unknowns", -1), "summary: unknowns: got -1"),
    "negative_norm": (put_attribute("summary", "residual", -1.0), "summary: residual: got -1"),
    "unknown_key": (put_attribute("summary", "luck", 1.0), "summary: luck: got 1.0"),
    "array_in_summary": (put_attribute("summary", "cost", np.zeros(3)), "attribute cost is neither"),
    "no_columns": (lambda file: file[f"{T}/us"].attrs.__delitem__("columns"), "damaged"),
    "fewer_columns": (put_attribute(f"{T}/t", "columns", np.zeros(3)), "attribute columns is neither"),
    "column_too_many": (
        lambda file: [file[f"{T}/eta"].attrs.__setitem__(k, ["a"]) for k in ("columns", "units")],
        "columns of eta: got 1",
    ),
    "facts_of_words": (put_text("facts", '{"via": [["a", "b"]]}'), "facts: via.0.1: got 'b'"),
    "facts_that_are_none": (put_text("facts", "[]"), "text: facts: got"),
    "not_utf8": (put(f"{TEXT}/problem_text", np.full(3, 255, dtype=np.uint8)), "damaged or incomplete"),
    "not_json": (put_text("options", "{"), "damaged or incomplete"),
    "deep_json": (put_text("options", "[" * 100_000), "damaged or incomplete"),
    "long_number": (put_text("options", "1" * 5000), "damaged or incomplete"),
    "list_for_table": (put_text("options", "[]"), "text: options: got"),
    "number_for_history": (put_text("history", "3"), "text: history: got 3"),
    "number_in_history": (put_text("history", "[3]"), "text: history.0: got 3"),
    "foreign_history": (put_text("history", '[{"luck": 3}]'), "IterationRecord 0: iteration: got nothing"),
    "word_in_history": (
        put_text("history", '[{"iteration": 1, "residual": "small"}]'),
        "IterationRecord 0: residual: got 'small'",
    ),
    "half_a_phase": (put_text("phases", '[{"name": "newton"}]'), "Phase 0: iterations: got nothing"),
    "numbers_for_versions": (put_text("versions", '{"mbocp": 1}'), "text: versions.mbocp: got 1"),
    "infinite_word": (put_text("options", '{"__float__": "many"}'), "damaged or incomplete"),
    "text_too_many": (
        lambda file: file["text"].create_dataset("more", data=np.zeros(1, dtype=np.uint8)).attrs.update(
            {"description": "plain text"}
        ),
        "text: more: got",
    ),
    "format_version_text": (lambda file: file.attrs.__setitem__("format_version", "three"), "format_version"),
    "format_version_2": (lambda file: file.attrs.__setitem__("format_version", 2), "format_version is 2"),
    "format_number": (lambda file: file.attrs.__setitem__("format", np.zeros(2)), "format is neither"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_contents_that_mbocp_does_not_write_are_refused(name: str, result: Path) -> None:
    change, reason = WRONG[name]
    edit(result, change)
    with pytest.raises(ResultFileError, match=reason) as caught:
        Solution.load(result)
    assert len(str(caught.value)) < 400 + len(str(result))
    assert len(str(caught.value).splitlines()) == 1


def test_no_numbers_are_needed_where_nothing_converged(tmp_path: Path) -> None:
    saved = pendulum(status="diverged", qs=np.full((101, 3), np.nan), us=np.full((100, 3), np.inf))
    saved.save(tmp_path / "result.h5")
    assert Solution.load(tmp_path / "result.h5") == saved


@pytest.mark.parametrize(
    "text",
    [
        "limits = 3",
        "[" * 50_000,
        "x = " + "1" * 5000,
        "horizon = 1",
        "[horizon]\nsteps = 'x'",
        "[[via]]\nq = 3",
    ],
)
def test_texts_that_are_no_problem_are_told_when_the_problem_is_wanted(text: str, tmp_path: Path) -> None:
    """Older results keep no facts: they have none where the problem cannot be made."""
    made = pendulum(problem_text=text, robot_spec={"name": "rigid_pendulum"}, facts_kept=None)
    loaded = Solution.load(made.save(tmp_path / "old.h5"))
    with pytest.raises(MbocpError):
        loaded.problem  # noqa: B018
    with pytest.warns(ProblemNotShownWarning, match="not shown: .*"):
        assert loaded.facts == Facts()
    assert loaded.active_limits == ()
    with pytest.warns(ProblemNotShownWarning):
        assert loaded.shown is None
    assert loaded.shown is None  # said once


# Any change at all.


def mutants(image: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Images in which one thing is deleted, of another kind, of another shape or of another value."""
    draw = random.Random(seed)
    for _ in range(count):
        yield edited_image(image, lambda file: mutate(file, draw))


def mutate(file: h5py.File, draw: random.Random) -> None:
    objects: list[Any] = [file]
    file.visititems(lambda _, item: objects.append(item))
    item = draw.choice(objects)
    if len(item.attrs) and (item is file or draw.random() < 0.6):
        name = draw.choice(list(item.attrs))
        if draw.random() < 0.2:
            del item.attrs[name]
        else:
            item.attrs[name] = strange(item.attrs[name], draw)
    elif item is not file:
        name, attributes = item.name, dict(item.attrs)
        value = item[()] if isinstance(item, h5py.Dataset) else None
        del file[name]
        if draw.random() < 0.8:
            file[name] = strange(value, draw)
            file[name].attrs.update(attributes)


def strange(value: Any, draw: random.Random) -> Any:
    numbers = [0, -1, 3, 2**62, 1.5, -0.0, 1e308, float("nan"), float("inf"), True]
    words = ["", "x" * 3000, "limits = 3", "[[", "{}", "[]", '{"a": 1}', "converged", "../..", "\x1b[31m"]
    kind = draw.randrange(4)
    if kind == 0:
        return draw.choice(numbers)
    if kind == 1:
        return draw.choice(words)
    if kind == 2:
        return np.zeros(draw.choice([(0,), (3,), (2, 2), (0, 3), (1, 1, 1)]))
    if isinstance(value, np.ndarray) and value.size and value.dtype.kind in "fu":
        changed = value.copy()
        changed.flat[draw.randrange(value.size)] = draw.choice([0, 1, 91, 123, 34])
        return draw.choice([changed, changed[:-1], changed[..., None], changed.astype(complex), changed.T])
    return draw.choice(words)


@pytest.mark.parametrize("make", [limited, pendulum])
@pytest.mark.parametrize(
    ("count", "seed"), [(15, 1), pytest.param(1500, 2, marks=pytest.mark.slow)], ids=["short", "long"]
)
@pytest.mark.filterwarnings("ignore::mbocp.solution.solution.ProblemNotShownWarning")
def test_any_change_gives_a_solution_or_one_error(make: Any, count: int, seed: int, tmp_path: Path) -> None:
    path = make(num_steps=20).save(tmp_path / "result.h5")
    for image in mutants(path.read_bytes()[seal.SEAL_SIZE :], count, seed):
        path.write_bytes(seal.seal(image))
        try:
            solution = Solution.load(path)
        except ResultFileError:
            continue
        solution.save(path)
        assert Solution.load(path) == solution
        solution.to_json()
        solution.to_csv(tmp_path / "table.csv")
        assert repr(solution)
        if solution.converged:
            assert np.isfinite(solution.qs).all()
            assert np.isfinite(solution.mus).all()
