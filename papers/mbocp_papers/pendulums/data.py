"""What the first paper prints in its tables, [Bijalwan2025]_, number by number."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Strategy:
    """One of the paper's four ways to solve the discrete problem, section 5.

    Attributes
    ----------
    label : str
        As in the tables' heads.
    method : str
        `solver.method` of mbocp.
    adjoint : str
        `solver.adjoint`: "auxiliary" for section 5.2.2.
    """

    label: str
    method: str
    adjoint: str = "direct"

    @property
    def is_hybrid(self) -> bool:
        """Whether gradient iterations come first, section 5.3."""
        return "+" in self.method


STRATEGIES = (
    Strategy("Monolithic", "monolithic"),
    Strategy("FBSM-Newton", "fbsm_newton"),
    Strategy("FBSM-BB + Monolithic", "fbsm_bb+monolithic"),
    Strategy("FBSM-BB + FBSM-Newton", "fbsm_bb+fbsm_newton"),
)
AUXILIARY = Strategy("FBSM-Newton, auxiliary", "fbsm_newton", "auxiliary")


@dataclass(frozen=True)
class Printed:
    """Iterations, of each phase in turn, and CPU time [s]."""

    iterations: tuple[int, ...]
    seconds: float


@dataclass(frozen=True)
class PrintedRow:
    """One step size of Tables 2, 4, 6, 7.

    Attributes
    ----------
    dt : float
        [s].
    steps : int
        N = T / dt.
    dof : int
        The column "DOF".
    printed : tuple of Printed
        In the order of `STRATEGIES`.
    auxiliary : Printed or None
        Of `AUXILIARY`, where the text has it.
    """

    dt: float
    steps: int
    dof: int
    printed: tuple[Printed, ...]
    auxiliary: Printed | None = None

    def measured_strategies(self) -> list[tuple[Strategy, Printed]]:
        """Strategies with what is printed of them."""
        pairs = list(zip(STRATEGIES, self.printed, strict=True))
        return pairs if self.auxiliary is None else [*pairs, (AUXILIARY, self.auxiliary)]


@dataclass(frozen=True)
class Comparison:
    """Tables 2, 4, 6, 7: the four strategies at four step sizes.

    Attributes
    ----------
    number : int
    title : str
    system : str
        Name of the system in `mbocp_papers.pendulums.cases`.
    gradient_iterations : int
        Of FBSM-BB, before the second phase of a hybrid.
    rows : tuple of PrintedRow
    """

    number: int
    title: str
    system: str
    gradient_iterations: int
    rows: tuple[PrintedRow, ...]


@dataclass(frozen=True)
class PrintedStep:
    """Norms after one iteration: of the increment and of the residual; None where nothing is printed."""

    iteration: int
    monolithic: tuple[float, float] | None
    fbsm_newton: tuple[float, float] | None


@dataclass(frozen=True)
class Convergence:
    """Tables 1, 3, 5: norms over the iterations at dt = 0.01 s.

    Attributes
    ----------
    number : int
    title : str
    system : str
    steps : int
        N.
    gradient_iterations : int
        Of FBSM-BB before the iterations that are printed; 0: the strategies alone.
    printed : tuple of PrintedStep
    """

    number: int
    title: str
    system: str
    steps: int
    gradient_iterations: int
    printed: tuple[PrintedStep, ...]


def _row(dt: float, steps: int, dof: int, *columns: object, auxiliary: Printed | None = None) -> PrintedRow:
    """Row as it stands in the paper: iterations and CPU time, in turn."""
    printed = []
    for iterations, seconds in zip(columns[::2], columns[1::2], strict=True):
        phases = tuple(int(k) for k in str(iterations).split("+"))
        printed.append(Printed(phases, float(str(seconds))))
    return PrintedRow(dt, steps, dof, tuple(printed), auxiliary)


COMPARISONS = (
    Comparison(
        2,
        "3D elastic pendulum: comparison of solution strategies",
        "elastic_pendulum",
        25,
        (
            _row(0.5, 10, 165, 7, 2.57, 9, 2.25, "25+6", 2.24, "25+6", 2.07),
            _row(0.1, 50, 765, 9, 56.29, 9, 34.08, "25+6", 35.78, "25+6", 25.68),
            _row(0.05, 100, 1515, 11, 250.67, 9, 111.58, "25+6", 136.95, "25+6", 84.44),
            _row(
                0.01,
                500,
                7515,
                *(15, 8080.22, 15, 4516.84, "25+6", 3251.7, "25+6", 2010.23),
                auxiliary=Printed((15,), 4786.9),  # in the text of section 6.1
            ),
        ),
    ),
    Comparison(
        4,
        "3D rigid pendulum: comparison of solution strategies",
        "rigid_pendulum",
        500,
        (
            _row(0.25, 4, 71, 8, 0.37, 115, 6.03, "500+2", 4.09, "500+2", 3.84),
            _row(0.1, 10, 173, 8, 1.44, 44, 7, "387+1", 4.71, "387+1", 5.41),
            _row(0.05, 20, 343, 8, 4.16, 30, 13.12, "500+2", 11.12, "500+2", 12.00),
            _row(0.01, 100, 1703, 7, 82.94, 30, 261.73, "500+4", 88.98, "500+6", 94.11),
        ),
    ),
    Comparison(
        6,
        "2D rigid pendulum on a cart: comparison of solution strategies",
        "cart_pendulum_rigid",
        25,
        (
            _row(0.1, 20, 301, 13, 8.90, 7, 1.67, "25+7", 5.03, "25+9", 2.61),
            _row(0.05, 40, 601, 13, 33.64, 7, 4.95, "25+8", 19.49, "25+8", 6.41),
            _row(0.01, 200, 3001, 12, 745.7, 7, 102.11, "25+8", 465.29, "25+7", 103.1),
            _row(0.005, 400, 6001, 13, 3394.41, 7, 401.3, "25+8", 1881.25, "25+7", 390.21),
        ),
    ),
    Comparison(
        7,
        "2D elastic pendulum on a cart: comparison of solution strategies",
        "cart_pendulum_elastic",
        25,
        (
            _row(0.1, 20, 261, 14, 9.48, 9, 1.93, "25+6", 4.94, "25+9", 2.57),
            _row(0.05, 40, 521, 14, 36.33, 7, 4.67, "25+6", 16.98, "25+10", 8.13),
            _row(0.01, 200, 2601, 19, 1190.3, 8, 138.9, "25+8", 502.42, "25+9", 135.22),
            _row(0.005, 400, 5201, 18, 4708.65, 8, 450.85, "25+8", 2016.67, "25+8", 482.07),
        ),
    ),
)

CONVERGENCES = (
    Convergence(
        1,
        "3D elastic pendulum: convergence of the individual strategies",
        "elastic_pendulum",
        500,
        0,
        (
            PrintedStep(1, (3.823270e02, 3.586640e02), (1.712774e01, 1.256651e01)),
            PrintedStep(13, (2.189136e-03, 1.435653e-08), (2.312865e-03, 5.544332e-08)),
            PrintedStep(14, (1.034807e-08, 1.967061e-12), (5.518912e-08, 3.213193e-13)),
            PrintedStep(15, (1.890021e-14, 2.004273e-12), (2.891783e-13, 2.465730e-13)),
        ),
    ),
    Convergence(
        3,
        "3D rigid pendulum: convergence of the hybrids' second phase",
        "rigid_pendulum",
        100,
        500,
        (
            PrintedStep(1, (4.310758e01, 1.495236e-01), (2.114917e01, 2.818483e-02)),
            PrintedStep(3, (5.303904e-05, 2.262833e-12), (2.371533e-01, 8.877569e-06)),
            PrintedStep(4, (5.505714e-11, 7.811857e-13), (4.291247e-03, 2.661242e-09)),
            PrintedStep(5, None, (9.920731e-08, 5.282123e-14)),
            PrintedStep(6, None, (1.936632e-11, 3.431016e-14)),
        ),
    ),
    Convergence(
        5,
        "2D rigid pendulum on a cart: convergence of the individual strategies",
        "cart_pendulum_rigid",
        200,
        0,
        (
            PrintedStep(1, (3.086121e02, 1.198159e01), (3.723607e01, 4.154488e-01)),
            PrintedStep(4, (2.784208e02, 1.099290e01), (3.057142e00, 2.173781e-04)),
            PrintedStep(5, (9.570851e01, 9.159894e00), (2.944943e-02, 2.266004e-08)),
            PrintedStep(6, (4.109482e01, 3.957286e00), (2.873218e-06, 4.508789e-14)),
            PrintedStep(7, (1.819356e01, 9.460896e-01), (3.643147e-13, 1.207341e-14)),
            PrintedStep(12, (3.201166e-12, 1.192913e-13), None),
        ),
    ),
)
