"""What of the second paper is asked for, and the rows of the lattice that go with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from mbocp.exceptions import ResultFileError
from mbocp.study import StudyResult, run_study
from mbocp_papers.so3.experiment import SOLVERS, VARIANTS, Lattice, check_choice, lattice_study
from mbocp_papers.so3.outcomes import Outcomes, outcomes_of

Say = Callable[[str], object]

QUICK_LATTICE = Lattice(2, 2)
DEFAULT_SOLVERS = {"corrected": "monolithic", "as_printed": "ipopt"}  # a repeated condition stalls the others

_REPORTS = 100  # lines about the progress of a lattice


@dataclass(frozen=True)
class Request:
    """How tables and figures are made.

    Attributes
    ----------
    folder : Path
        Where figures and rows go.
    lattice : Lattice
    variant : {"corrected", "as_printed"}
    solver : {"monolithic", "fatrop", "ipopt"}
        Of the lattice.
    workers : int, optional
        Processes for the lattice.
    quick : bool
        Fewer steps and repetitions.
    results : Path, optional
        Rows of the lattice. Default: a file in the folder, named after lattice, variant and solver.
    resume : bool
        Go on with rows that are there, instead of taking them as they are.
    suffixes : tuple of str
        Of pictures.
    dpi : int
    """

    folder: Path = Path("paper")
    lattice: Lattice = field(default_factory=Lattice)
    variant: str = "corrected"
    solver: str = "monolithic"
    workers: int | None = None
    quick: bool = False
    results: Path | None = None
    resume: bool = False
    suffixes: tuple[str, ...] = (".png",)
    dpi: int = 160

    def __post_init__(self) -> None:
        check_choice("--variant", self.variant, VARIANTS)
        check_choice("--solver", self.solver, SOLVERS)

    @property
    def rows(self) -> Path:
        """Where the rows of the lattice are, or will be."""
        return self.results or self.folder / f"so3_{self.lattice}_{self.variant}_{self.solver}.jsonl"


def lattice_outcomes(request: Request, say: Say = str) -> Outcomes:
    """Outcomes of the lattice: from the file of rows, if there is one, else from a run that writes it.

    Raises
    ------
    ResultFileError, StudyError
        If the file is no study's, of another study, or cannot be written.
    """
    path = request.rows
    if path.exists() and not request.resume:
        return outcomes_of(_load(path, path.stat().st_mtime_ns))
    study = lattice_study(request.lattice, request.variant, request.solver)
    if not path.parent.is_dir():
        if request.results is not None:
            raise ResultFileError(path, f"there is no folder {str(path.parent)!r}; make it first")
        path.parent.mkdir(parents=True)

    def told(done: int, total: int) -> None:
        if done % max(1, total // _REPORTS) == 0 or done == total:
            say(f"lattice {request.lattice}: {done} of {total} tasks")

    say(f"lattice {request.lattice}: compiling")
    return outcomes_of(run_study(study, path, workers=request.workers, resume=True, progress=told))


@lru_cache(maxsize=2)
def _load(path: Path, _changed: int) -> StudyResult:
    """Rows of a file, read once for all figures as long as it does not change."""
    return StudyResult.load(path)
