"""Inputs guided by the lines of mbocp that they reach: `python -m tests.attack.coverage --kind urdf`.

atheris watches mbocp's lines and branches and keeps what reaches a new one; what it mutates is the file, by
the mutations of this package. It is no requirement of mbocp: `make attack` installs it, where there is a
wheel of it for this Python.

What came of every input is written down as it comes, a line each: atheris ends the process itself. The inputs
of findings that are exceptions are kept, and the search goes on; one that takes the process with it ends
the search, and leaves its input beside the log.
"""

from __future__ import annotations

import argparse
import importlib.util
import inspect
import json
import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from random import Random
from types import FunctionType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .corpus import Entry

os.environ.setdefault("OMP_NUM_THREADS", "1")

_WATCHED = ("mbocp", "tomllib", "yaml")
_WATCHED_TAKES = 4  # times as long as code that nobody watches
GUIDED = ("problem", "robot_toml", "robot_yaml", "study", "urdf", "mesh")  # text; HDF5 is read by its library


def main() -> int:
    """Search for `--count` inputs; never returns but when atheris is missing."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack.coverage", description=__doc__)
    parser.add_argument("--kind", choices=GUIDED, required=True)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=int, default=0, help="end after this time; 0: after --count inputs")
    parser.add_argument("--input", type=Path, help="replay a finding")
    parser.add_argument(
        "--log", type=Path, default=Path("attack-coverage"), help="folder for findings and corpus"
    )
    options = parser.parse_args()
    if options.input is not None:
        return _replay(options.kind, options.input.read_bytes())
    if importlib.util.find_spec("atheris") is None:
        print("atheris is not installed: pip install atheris (there are wheels for some versions of Python)")
        return 3
    _search(options)
    return 0


def _replay(kind: str, data: bytes) -> int:
    from .cases import Case
    from .corpus import entries
    from .targets import TARGETS

    entry, body = _parts(data, entries(kind))
    files = {**entry.files, entry.mutated[0]: body}
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        case = Case(kind, 0, entry.name, entry.main, files, entry.files)
        TARGETS[kind](case, case.write(Path(folder)))
    print("accepted")
    return 0


def _parts(data: bytes, known: Sequence[Entry]) -> tuple[Entry, bytes]:
    """Entry that the first byte means, and the file."""
    entry = known[data[0] % len(known)] if data else known[0]
    return entry, data[1:]


def _functions() -> Iterator[FunctionType]:
    """Functions and methods of what is loaded; atheris' own hook misses modules of an editable install."""
    modules = [module for name, module in list(sys.modules.items()) if name.split(".")[0] in _WATCHED]
    holders = [(module.__name__, value) for module in modules for value in list(vars(module).values())]
    holders += [
        (where, value) for where, cls in holders if isinstance(cls, type) for value in vars(cls).values()
    ]
    seen: set[int] = set()
    for where, value in holders:
        inner = (
            getattr(value, "__func__", None) or getattr(value, "fget", None) or getattr(value, "func", None)
        )
        function = inspect.unwrap(inner or value) if callable(inner or value) else None
        if isinstance(function, FunctionType) and function.__module__ == where and id(function) not in seen:
            seen.add(id(function))
            yield function


def _search(options: argparse.Namespace) -> None:
    import atheris

    from .cases import Case, mutate_file
    from .corpus import entries
    from .runner import LIMITS, throw

    for function in _functions():
        atheris.instrument_func(function)

    known = entries(options.kind)
    corpus, outcomes = options.log / options.kind, options.log / f"{options.kind}.jsonl"
    corpus.mkdir(parents=True, exist_ok=True)
    for i, entry in enumerate(known):
        (corpus / f"seed-{i}").write_bytes(bytes([i]) + entry.files[entry.mutated[0]])
    folder = Path(tempfile.mkdtemp(prefix="attack-"))
    seen: set[tuple[str, str]] = set()
    number = 0

    def throw_one(data: bytes) -> None:
        nonlocal number
        number += 1
        entry, body = _parts(data, known)
        files = {**entry.files, entry.mutated[0]: body}
        case = Case(options.kind, number, entry.name, entry.main, files, entry.files)
        inner = folder / "input"
        inner.mkdir()
        os.chdir(inner)
        begun = time.process_time()
        outcome = throw(case, inner, LIMITS)
        taken = time.process_time() - begun
        if taken > _WATCHED_TAKES * LIMITS.cpu and not outcome.is_finding:
            outcome.verdict, outcome.text = "hang", f"{taken:.0f} s of the processor; {outcome.text[:300]}"
        os.chdir(folder)
        shutil.rmtree(inner)
        line = {**asdict(outcome), "input": ""}
        if outcome.is_finding and (outcome.verdict, outcome.where) not in seen:
            seen.add((outcome.verdict, outcome.where))
            kept = options.log / f"{options.kind}-{len(seen)}.input"
            kept.write_bytes(data)
            line["input"] = str(kept)
        with outcomes.open("a") as file:
            file.write(json.dumps(line) + "\n")

    def mutate(data: bytes, max_size: int, seed: int) -> bytes:
        entry, body = _parts(data, known)
        name = entry.mutated[0]
        body = mutate_file(options.kind, name, body or entry.files[name], Random(seed))
        return (data[:1] or b"\x00") + body[: max_size - 1]

    options.log, outcomes = options.log.absolute(), outcomes.absolute()
    outcomes.touch()
    resource.setrlimit(resource.RLIMIT_AS, (LIMITS.address_space, LIMITS.address_space))
    arguments = [
        *(f"-seed={options.seed}", f"-runs={options.count}", "-max_len=200000", "-rss_limit_mb=3000"),
        *(
            f"-timeout={LIMITS.wall:.0f}",  # libFuzzer counts no time of the processor
            f"-artifact_prefix={options.log}/{options.kind}-crash-",
            "-print_final_stats=1",
        ),
        *((f"-max_total_time={options.seconds}",) if options.seconds else ()),
    ]
    atheris.Setup([sys.argv[0], *arguments, str(corpus.absolute())], throw_one, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
