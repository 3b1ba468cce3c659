"""The result of a solve: trajectories, multipliers, history, and what it took."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import mbocp
from mbocp._arrays import dataclass
from mbocp._text import warn_caller
from mbocp.exceptions import DimensionMismatch, InvalidValue, MbocpError, ResultFileError
from mbocp.solution._values import same
from mbocp.solution.active_limits import ActiveLimit, active_limits
from mbocp.solution.problem_facts import Facts
from mbocp.solution.solution_data import SolutionData

if TYPE_CHECKING:
    import xarray

    from mbocp.problem import Problem
    from mbocp.robot import Robot
    from mbocp.solution.its_problem import ProblemPicture
    from mbocp.terms import OwnTerm

T = TypeVar("T")


class ProblemNotShownWarning(UserWarning):
    """The problem of a result cannot be made of its text, and what it asked for is missing in pictures."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Solution(SolutionData):
    r"""Trajectories, multipliers and history of a solved (or not quite solved) optimal control problem.

    The numbers satisfy, for n = 1, ..., N,

    .. math::
        F(x_{n-1}, x_n, \lambda_n, u_{n-1}) = 0, \qquad \Phi(q_n) = 0, \qquad g_T(x_N) = 0,

    with the multipliers :math:`\mu_{n-1}`, :math:`\zeta_{n-1}` and :math:`\eta`, to within `residual`.

    Attributes
    ----------
    status : Status
        How the solve ended; `converged` says whether well, `advice` what to do if not.
    advice, solver, guess_used : str
    goal_error : str
        How far the end is from the goal; "" in results of an older mbocp.
    iterations, unknowns : int
        Iterations of the solver; numbers that it solved for.
    cost : float
        Objective J, eq. (7).
    residual, increment : float
        Norms at the end.
    constraint_violation : float
        Largest holonomic constraint along the trajectory [m^2, m, rad].
    velocity_violation : float
        Largest rate of one, :math:`|\Phi_q v|`: the hidden constraint, which is kept to O(dt).
    violation_within : float
        Largest holonomic constraint in the middles of steps, on geodesics from node to node [m^2, m, rad].
    wall_time_s : float
        Duration of the whole solve [s].
    phases : tuple of Phase
    history : tuple of IterationRecord
    accuracy : Accuracy
        How far the steps are from what the robot would do; of NaN where nobody has looked.
    starts : tuple of StartRecord
        With `solver.starts` above 1 or several goals what each guess led to; empty else.
    t : ndarray, shape (N + 1,)
        Time of the nodes [s].
    qs : ndarray, shape (N + 1, nq)
        Configuration [m, rad, unit quaternion xyzw, cos/sin].
    vs, ps : ndarray, shape (N + 1, nv)
        Velocity [m/s, rad/s] and momentum [kg m/s, N m s].
    us : ndarray, shape (N, nu)
        Control; `us[n]` acts from node n to n + 1. Where controls vary within steps, their means.
    u_values, u_shares : ndarray, shapes (N, k, nu) and (k,)
        With ``horizon.controls`` other than constant the controls at these parts of each step, from 0 to 1;
        between them the polynomial through them. Empty where controls are constant. `controls_at` has those
        of any time.
    lams, zetas : ndarray, shape (N, nc)
        Multipliers of the constraints and their adjoints; `lams[n]` is :math:`\lambda_{n+1}`, `zetas[n]` is
        :math:`\zeta_n`.
    gains : ndarray, shape (N, k nu, 2 nv)
        Feedback K_n: the controls of a step answer a deviation :math:`\Delta x` of (q, v) at its begin, of q
        along the tangent, by :math:`K_n \Delta x`; see `mbocp.formulation.gains`. Where controls have k
        values in a step, those answer, one block of rows after the other, all to the deviation at its begin;
        else k is 1. Linear controls have nu more columns: a deviation is one of the control, too, which the
        step before has answered by. Shape (0, 0, 0) where nobody asked, or where states are not (q, v).
    mus : ndarray, shape (N + 1, 2 nv)
        Adjoint of the state, :math:`\mu_n = (\mu^q_n, \mu^p_n)`; for scheme SE1 the multipliers of the
        step from node n to n + 1.
    eta : ndarray, shape (ng,)
        Multiplier of the exact end condition.
    control_hamiltonians : ndarray, shape (N,)
        Eq. (11); NaN if nobody evaluated it.
    control_momenta : ndarray, shape (N + 1, k)
        Eq. (15), a column for each symmetry in `control_momentum_names`.
    control_momentum_names, control_momentum_meanings : tuple of str
        Symmetry of each control momentum, and what it is in terms of the adjoints; "" if nobody says.
    coordinates : str
        In which the mechanics were written, see `mbocp.problem.Problem`. With "natural" the constraints, of
        `lams` and `zetas`, are those of rigid bodies and joints, too.
    scheme, lie, rotations : str
        Integrator, see `mbocp.problem.Problem` and `mbocp.robot.Robot`; what is left out is what
        `problem_text` says.
    substeps : int
        Steps of an explicit scheme within one of the N.
    manifold_drifts : ndarray, shape (N + 1,)
        How far the rotations of the integrator's state are from their manifold: the largest
        :math:`|\,|q| - 1|` or :math:`\|R^T R - I\|_F`; NaN if nobody evaluated it.
    manifold_drift, manifold_drift_resimulated : float
        The largest of them; and the largest when the start is integrated anew with the controls, which shows
        the integrator without the tolerance of the solver. NaN where not computed.
    limits_u, limits_v, limits_q : ndarray, shape (2, nu), (2, nv), (2, nq)
        Lower and upper limits of the problem, infinite where there are none; what is left out is what
        `problem_text` says.
    limit_violation : float
        By how much the motion leaves limits and path constraints at its nodes at most, in their own units.
    limit_excess, limit_excess_of, limit_excess_time : float, str, float
        By which part of it the motion leaves a limit of speed, position, acceleration, effort or power
        between nodes at most, which one, and when [s]; 0, "" and NaN where it leaves none, NaN, "" and NaN
        where nobody has looked: schemes of first order say nothing of speeds. See
        `mbocp.problem.between_nodes`.
    clearance, clearance_between, clearance_time : float, str, float
        Of a problem with obstacles or self-collision how far those shapes are apart [m] that come nearest to
        their margin, which is not subtracted (negative: how deep they are in each other), of what and when
        [s]: at a thousand poses a second on geodesics from node to node, of the pairs that are checked, which
        leaves out those that can never meet. NaN and "" where there are none.
    positive_work : float
        Mechanical work that the controls do, each by itself, with what they brake left out [J]; NaN in
        results of an older mbocp. Controls that prescribe a motion count as none.
    drawn_energy : float
        Energy that motors draw [J], with the losses, gears and supply of `cost.energy`, which is by up to its
        width less; NaN without such a table, and likewise.
    lam_us, lam_qs, lam_vs : ndarray, shape (N, nu), (N + 1, nq), (N + 1, nv)
        Multipliers of the limits: positive at an active upper one, negative at a lower one, zero where
        nothing is active.
    lam_path : ndarray, shape (N, nh)
        Multipliers of the path constraints at the nodes 1, ..., N, with the same signs; of limits of rates,
        and of speeds within steps, too.
    path_names : tuple of str
        Name of each column of `lam_path`.
    problem_name, robot_name : str
    robot_spec : dict
        Arguments with which `mbocp.load_robot` loads the robot again.
    facts_kept : Facts, optional
        What the problem asked of the motion, in plain values; None of a result of an older mbocp. `facts` has
        them in either case.
    robot_files : RobotFiles, optional
        The robot's files, of a solution that was read from a result which holds them.
    problem_text : str
        The problem file (TOML) as it was solved.
    options, versions : dict
        Options of the solver; versions of what took part.
    labels : Labels
        Name and unit of every column.
    iterate : IterateRecord, optional
        The solver's last iterate with all multipliers, from which a warm start of the same problem goes on.

    Raises
    ------
    DimensionMismatch
        If the shapes do not fit together.
    InvalidValue
        If `options`, `versions` or `robot_spec` hold what JSON cannot.
    """

    @property
    def active_limits(self) -> tuple[ActiveLimit, ...]:
        """Limits and path constraints of the problem that the motion touches."""
        return active_limits(self)

    def __repr__(self) -> str:
        name = self.problem_name or self.robot_name or "unnamed"
        return (
            f"<Solution {name}: {self.status} after {self.iterations} iterations of {self.solver}, "
            f"cost {self.cost:.9g}, residual {self.residual:.1e}, N = {self.num_steps}>"
        )

    def equals(self, other: object) -> bool:
        """Whether `other` is a solution with exactly the same content; NaN equals NaN.

        The files of the robot do not count, but what loads it does.
        """
        if not isinstance(other, Solution):
            return False
        compared = [f.name for f in dataclasses.fields(self) if f.compare]
        return all(same(getattr(self, name), getattr(other, name)) for name in compared)

    def __eq__(self, other: object) -> bool:
        return self.equals(other) if isinstance(other, Solution) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # equal by content, and the content is long

    def to_dict(self) -> dict[str, Any]:
        """Return the summary that `mbocp solve --json` prints, as plain Python values."""
        from mbocp.solution.export import solution_dict

        return solution_dict(self)

    def to_json(self, indent: int | None = None) -> str:
        """Return the summary that `mbocp solve --json` prints; NaN and infinity are null."""
        return json.dumps(self.to_dict(), indent=indent, allow_nan=False)

    def to_csv(self, path: str | Path) -> Path:
        """Write all trajectories into one table, a row for each node, `name [unit]` in the first line."""
        from mbocp.solution.export import write_csv

        return write_csv(self, path)

    def export(
        self,
        path: str | Path,
        *,
        kind: str | None = None,
        rate: float | None = None,
        interpolation: str | None = None,
        fit: bool = True,
        check: bool = True,
        part: str | None = None,
    ) -> Path:
        """Write the motion for controllers and other tools, see `mbocp.solution.export_formats`.

        Raises
        ------
        LimitsExceeded
            If the motion leaves limits as it is sent; `check=False` writes it all the same.
        """
        from mbocp.solution.export_formats import export_motion

        how: dict[str, Any] = {"kind": kind, "rate": rate, "interpolation": interpolation, "fit": fit}
        how |= {"check": check, "part": part}
        return export_motion(self, path, **how, load_robot=self.load_robot)

    def to_xarray(self) -> xarray.Dataset:
        """All trajectories by time and name, see `mbocp.solution.export.dataset_of`."""
        from mbocp.solution.export import dataset_of

        return dataset_of(self)

    def plot(self, path: str | Path, *, robot: Robot | None = None, style: str | Path | None = None) -> Path:
        """Write an overview on one page, as PNG, PDF or SVG by the suffix of `path`.

        Parameters
        ----------
        path : str or Path
        robot : Robot, optional
            Default: the one of the solution, see `load_robot`.
        style : str or Path, optional
            Name of a style of matplotlib, or a file with one (.mplstyle), over mbocp's own; colours and
            dashes of curves stay.

        Raises
        ------
        ResultFileError
            If the suffix is none of the three, or the file cannot be written.
        InvalidValue
            If there is no such style.
        InvalidValue, RobotError
            As `load_robot`.
        """
        shown = self.load_robot() if robot is None else robot
        return mbocp.plot_solution(self, path, robot=shown, style=style)

    def replay(
        self,
        path: str | Path | None = None,
        *,
        robot: Robot | None = None,
        trace: Sequence[str] | None = None,
        ghosts: int | Sequence[float] = 0,
        others: Sequence[Solution] = (),
        direction: tuple[float, float] | None = None,
        speed: float = 1.0,
    ) -> Path | None:
        """Write the motion as a page that works offline, or show it live if no `path` is given.

        Parameters and errors are those of `mbocp.view.of_solution.replay_solution`.
        """
        more: dict[str, Any] = {"ghosts": ghosts, "others": others, "direction": direction}
        return mbocp.replay_solution(self, path, robot=robot, trace=trace, speed=speed, **more)

    def save(self, path: str | Path, *, meshes: bool | None = None) -> Path:
        """Write everything into one self-describing HDF5 file; an interrupted save leaves the old file whole.

        Parameters
        ----------
        path : str or Path
        meshes : bool, optional
            Whether the meshes of the robot go into it, beside its other files. Default: if they have 64 MB
            at most.

        Raises
        ------
        ResultFileError
            If the file cannot be written.

        Warns
        -----
        RobotNotStoredWarning
            If the robot cannot be put into it, or its meshes are left out for their size.
        """
        from mbocp.solution.file_content import content_of
        from mbocp.solution.files import write_content
        from mbocp.solution.its_robot import files_to_store

        return write_content(path, content_of(self, files_to_store(self, meshes)))

    def load_robot(self) -> Robot:
        """Load the robot as it was when the result was written; where it holds none, from where it was.

        Raises
        ------
        InvalidValue
            If the solution does not say which robot it is about.
        RobotError
            If the robot cannot be loaded, or is another one by now.

        Warns
        -----
        RobotChangedWarning
            If files of the robot are others on this machine by now; those that the result holds are used.
        """
        return self._robot

    @cached_property
    def _robot(self) -> Robot:
        from mbocp.solution.its_robot import robot_of

        return robot_of(self)

    @cached_property
    def problem(self) -> Problem:
        """The problem that was solved; of a result from a file, made of its text and robot when asked for.

        Raises
        ------
        InvalidValue, RobotError, ProblemFileError
            As `load_problem`, which takes terms of one's own, too.
        """
        return self.load_problem()

    @cached_property
    def shown(self) -> ProblemPicture | None:
        """What pictures show of the problem; None where it has no text, or cannot be made of it.

        Warns
        -----
        ProblemNotShownWarning
            If it cannot be made.
        """
        if "problem" not in vars(self) and not self.problem_text:
            return None
        from mbocp.solution.its_problem import (  # as slow to import as all else
            ProblemPicture,
            problem_to_show,
        )

        if "problem" in vars(self):
            return ProblemPicture(self.problem, self.problem.obstacle)
        return self._make_or_warn(partial(problem_to_show, self, self.load_robot))

    @cached_property
    def facts(self) -> Facts:
        """What the problem asked of the motion, in plain values: as the result keeps them, or as it follows.

        Warns
        -----
        ProblemNotShownWarning
            If it keeps none, and the problem cannot be made.
        """
        if self.facts_kept is not None or not self.problem_text:
            return super().facts
        from mbocp.solution.its_problem import facts_of_text  # as slow to import as all else

        return self._fit(self._make_or_warn(partial(facts_of_text, self, self.load_robot)) or Facts())

    def _make_or_warn(self, make: Callable[[], T]) -> T | None:
        """What is made of the problem; None, with a warning, where that cannot be."""
        try:
            return make()
        except MbocpError as error:
            warn_caller(f"what the problem asked for is not shown: {error}", ProblemNotShownWarning)
            return None

    def load_problem(
        self, overrides: Mapping[str, Any] | Sequence[str] = (), *, terms: Sequence[OwnTerm] = ()
    ) -> Problem:
        """The problem that was solved, with the robot that the result holds.

        Parameters
        ----------
        overrides, terms
            As of `mbocp.load_problem`.

        Raises
        ------
        InvalidValue, RobotError
            As `load_robot`.
        ProblemFileError
            If the problem's text or an override is wrong, or a term of one's own is missing.
        """
        from mbocp.solution.its_problem import problem_of  # as slow to import as all else

        return problem_of(self, self.load_robot, overrides, terms)

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read what `save` wrote; the result equals what was saved.

        Raises
        ------
        ResultFileError
            If there is no such file, it is not a result of mbocp, it is damaged, or a newer mbocp wrote it.
        """
        from mbocp.solution.file_content import fields_of
        from mbocp.solution.files import read_content

        content = read_content(path)
        try:
            return cls(**fields_of(content))
        except (DimensionMismatch, InvalidValue) as error:
            raise ResultFileError(path, f"is damaged: its parts do not fit together ({error})") from error
