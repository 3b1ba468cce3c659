"""Pictures: everything that should be in them is, with names and units, and no data breaks them."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.image as mpimg
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from mbocp.exceptions import InvalidValue, ResultFileError, UnknownFrame
from mbocp.robot import load_robot
from mbocp.solution import Column, IterationRecord, Status
from mbocp.view.figures import style
from mbocp.view.figures.frame_paths import frame_paths
from mbocp.view.figures.lines import without_zigzag
from mbocp.view.figures.style import PALETTE, line_style, shorten
from mbocp.view.plots import (
    overview,
    plot_controls,
    plot_convergence,
    plot_invariants,
    plot_multipliers,
    plot_path,
    plot_rates,
    plot_solution,
    plot_states,
    save_figure,
)
from tests.mechanics.models import cart_pendulum, spherical_pendulum
from tests.solution.fabricated import arm, fabricate, humanoid, limited, pendulum
from tests.view.motions import hanging, motion


def titles(figure: Figure) -> list[str]:
    return [axes.get_title(loc="left") for axes in figure.axes]


def panel(figure: Figure, title: str) -> Axes:
    return next(axes for axes in figure.axes if axes.get_title(loc="left").startswith(title))


def levels(axes: Axes) -> set[float]:
    """Heights of the horizontal lines."""
    return {line.get_ydata()[0] for line in axes.lines if len(line.get_ydata()) == 2}


def legend(axes: Axes | Figure) -> list[str]:
    found = axes.get_legend() if isinstance(axes, Axes) else axes.legends[0]
    assert found is not None
    return [text.get_text() for text in found.get_texts()]


@pytest.mark.parametrize("make", [pendulum, arm, humanoid, limited])
@pytest.mark.parametrize(
    "plot",
    [plot_states, plot_controls, plot_multipliers, plot_rates, plot_convergence, plot_invariants],
)
def test_every_picture_of_every_size_renders(make: Any, plot: Any) -> None:
    figure = plot(make(num_steps=20))
    figure.canvas.draw()
    assert all(axes.get_xlabel() and axes.get_ylabel() for axes in figure.axes)


def test_states_have_names_and_units() -> None:
    figure = plot_states(pendulum())
    assert titles(figure) == ["Configuration", "Velocity"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["$q$ [m]", "$v$ [m/s]"]
    assert legend(figure.axes[0]) == ["x", "y", "z"]
    assert plot_states(pendulum(), rate="p").axes[1].get_ylabel() == "$p$ [kg m/s]"


def test_columns_of_different_units_are_apart() -> None:
    figure = plot_states(humanoid(num_steps=20))
    assert titles(figure)[:3] == ["Configuration, root_joint", "Configuration, root_joint", "Configuration"]
    assert [axes.get_ylabel() for axes in figure.axes[:3]] == ["$q$ [m]", "$q$", "$q$ [rad]"]


def test_many_joints_share_one_legend_and_keep_their_style() -> None:
    figure = plot_states(humanoid(num_steps=20))
    names = legend(figure)
    assert len(names) == 20
    q, v = (axes for axes in figure.axes if len(axes.lines) == 20)
    for a, b in zip(q.lines, v.lines, strict=True):
        assert (a.get_color(), a.get_linestyle()) == (b.get_color(), b.get_linestyle())
    assert len({str(line_style(i)) for i in range(28)}) == 28


def test_a_continuous_joint_is_drawn_as_an_angle() -> None:
    angle = np.linspace(3.0, 5.0, 101)  # crosses pi
    columns = [Column("base.cos", ""), Column("base.sin", ""), Column("elbow", "rad")]
    qs = np.column_stack([np.cos(angle), np.sin(angle), angle])
    rates = [Column("base", "rad/s"), Column("elbow", "rad/s")]
    figure = plot_states(fabricate(columns, rates, [Column("base", "N m")], qs=qs))
    axes = panel(figure, "Configuration")
    assert legend(axes) == ["base", "elbow"]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), angle)


def test_controls_are_steps_where_one_can_see_them() -> None:
    coarse, fine = plot_controls(pendulum(num_steps=20)), plot_controls(pendulum(num_steps=200))
    assert coarse.axes[0].lines[0].get_drawstyle() == "steps-post"
    assert len(np.asarray(coarse.axes[0].lines[0].get_ydata())) == 21
    assert fine.axes[0].lines[0].get_drawstyle() == "default"
    assert np.asarray(fine.axes[0].lines[0].get_xdata())[0] == pytest.approx(1.5 / 400)


def test_limits_are_dashed_where_the_motion_comes_near() -> None:
    robot = load_robot("ur5")  # 150 N m and 28 N m
    us = np.tile([30.0, 30.0, 30.0, 20.0, 20.0, 40.0], (20, 1))
    limits = np.array([-robot.limits.effort, robot.limits.effort])
    solution = dataclasses.replace(motion(robot, robot.q0 + 0.5, us=us), limits_u=limits)
    axes = plot_controls(solution).axes[0]
    assert levels(axes) == {-28.0, 28.0}
    assert axes.get_title(loc="right") == "limits dashed; 1 beyond their limit; limits from ±150 not shown"
    weak = dataclasses.replace(solution, us=0.01 * solution.us)
    assert plot_controls(weak).axes[0].get_title(loc="right") == "limits from ±28 not shown"


@pytest.fixture(scope="module")
def of_arm() -> Figure:
    """An overview with a robot whose URDF has an effort for each joint, and efforts above some."""
    robot = load_robot("ur5")
    return overview(motion(robot, robot.q0 + 0.5, us=np.full((20, 6), 100.0)), robot)


def test_limits_that_nobody_enforces_are_not_drawn(of_arm: Figure) -> None:
    controls = panel(of_arm, "Control")
    assert controls.get_title(loc="right") == ""
    assert levels(controls) == set()


def test_limits_of_the_problem_are_dashed() -> None:
    solution = limited()
    states, controls = plot_states(solution), plot_controls(solution)
    assert levels(panel(states, "Configuration")) == set()
    assert levels(panel(states, "Velocity")) == {-2.0, 2.0}
    assert panel(states, "Velocity").get_title(loc="right") == "limits dashed"
    assert levels(panel(controls, "Control")) == {-20.0, 25.0}  # and not those of some robot
    beyond = dataclasses.replace(solution, us=1.01 * solution.us, lam_us=0 * solution.us)
    title = plot_controls(beyond).axes[0].get_title(loc="right")
    assert title == "limits dashed; 3 beyond their limit"
    far = dataclasses.replace(solution, limits_u=1000 * solution.limits_u)
    assert plot_controls(far).axes[0].get_title(loc="right") == "limits from 2e+04 not shown"
    slow = solution.vs * [1.0, 1.0, 1e-3]
    same = dataclasses.replace(solution, vs=slow, limits_v=np.outer([-2.0, 2.0], np.ones(3)))
    velocity = panel(plot_states(same), "Velocity")
    assert velocity.get_title(loc="right") == "limits dashed"  # also that of the slow one, on the same level


def test_limits_of_a_configuration_with_an_angle() -> None:
    columns = [Column("base.cos", ""), Column("base.sin", ""), Column("elbow", "rad")]
    rates = [Column("base", "rad/s"), Column("elbow", "rad/s")]
    limits = np.array([[-np.inf, -np.inf, -1.0], [np.inf, np.inf, 0.9]])
    figure = plot_states(fabricate(columns, rates, [Column("base", "N m")], limits_q=limits))
    assert levels(panel(figure, "Configuration")) == {-1.0, 0.9}


def test_invariants_with_the_drift_of_rotations() -> None:
    axes = panel(plot_invariants(limited()), "Drift of invariants")
    assert "rotations" in legend(axes)
    assert "rotations" not in legend(panel(plot_invariants(pendulum()), "Drift of invariants"))


def test_multipliers_of_active_limits() -> None:
    figure = plot_multipliers(limited())
    assert [title for title in titles(figure) if "limits" in title or "path" in title] == [
        "Multiplier of the limits of u, force",
        "Multiplier of the limits of v",
        "Multiplier of the path",
    ]
    assert panel(figure, "Multiplier of the limits of u").get_ylabel() == r"$\lambda^u$ [cost/N]"
    overview(limited()).canvas.draw()
    barrier = limited(lam_qs=np.full((21, 3), 1e-11), lam_path=np.full((20, 2), 1e-11))
    assert not [t for t in titles(plot_multipliers(barrier)) if "limits of q" in t or "path" in t]


def test_of_many_rows_of_the_path_those_that_pull_are_shown() -> None:
    """As of obstacles: a hundred rows, of which a few push."""
    sizes = np.array([0.0, 3.0, 1e-9, 0.5, *np.zeros(96)])
    names = tuple(f"{k}th distance" for k in range(100))
    lam_path = np.outer(np.linspace(-1.0, 1.0, 20), sizes)
    few = panel(plot_multipliers(limited(lam_path=lam_path, path_names=names)), "Multiplier of the path")
    assert legend(few) == [names[1], names[3]]
    many = limited(lam_path=lam_path + np.linspace(0.1, 0.2, 100), path_names=names)
    rows = panel(plot_multipliers(many), "Multiplier of the path, 8 of 100")
    assert len(rows.lines) == 8
    assert max(np.abs(line.get_ydata()).max() for line in rows.lines) == np.abs(many.lam_path).max()


def test_long_names_leave_the_columns_of_a_page_as_wide_as_each_other() -> None:
    names = ("velocity of base_link.y", "velocity of right_wheel.x", "frame_acceleration of base_link.x")
    lam_path = np.outer(np.linspace(-1.0, 1.0, 20), [1.0, 2.0, 3.0])
    figure = overview(limited(lam_path=lam_path, path_names=names))
    figure.draw_without_rendering()
    (axes,) = (one for one in figure.axes if one.get_title(loc="left").startswith("Multiplier of the path"))
    assert axes.get_legend().get_window_extent().x1 <= axes.get_window_extent().x1
    widths = [one.get_position().width for one in figure.axes]
    assert max(widths) == pytest.approx(min(widths), rel=0.01)


def test_exponents_stand_beside_legends() -> None:
    figure = plot_multipliers(pendulum(zetas=np.outer(np.linspace(-1e5, 1e5, 100), [1.0])))
    FigureCanvasAgg(figure).draw()
    seen = 0
    for axes in figure.axes:
        exponent, names = axes.yaxis.get_offset_text(), axes.get_legend()
        if exponent.get_text() and names is not None:
            seen += 1
            assert exponent.get_window_extent().x1 <= names.get_window_extent().x0 + 0.1  # [pixel]
    assert seen


def test_adjoints_that_zigzag_are_drawn_as_their_mean() -> None:
    smooth = pendulum(num_steps=60)
    sign = np.where(np.arange(61) % 2, -1.0, 1.0)[:, None]
    rough = dataclasses.replace(smooth, mus=smooth.mus + 5.0 * sign)
    axes = panel(plot_multipliers(rough), "Adjoint of the configuration")
    mean, as_computed = (np.asarray(axes.lines[i].get_ydata()) for i in (0, len(axes.lines) // 2))
    np.testing.assert_allclose(mean, smooth.mus[:, 0], atol=0.02 * np.ptp(smooth.mus[:, 0]))
    np.testing.assert_array_equal(as_computed, rough.mus[:, 0])
    assert axes.get_ylim()[1] < 4.0 < as_computed.max()
    assert [text.get_text() for text in axes.texts] == ["mean of neighbours; faint: as computed"]
    calm = panel(plot_multipliers(smooth), "Adjoint of the configuration")
    np.testing.assert_array_equal(calm.lines[0].get_ydata(), smooth.mus[:, 0])
    assert not calm.texts


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-50.0, 50.0), st.floats(-0.5, 0.5))
def test_a_line_comes_out_of_its_zigzag(at: float, slope: float, jump: float, growth: float) -> None:
    k = np.arange(40.0)
    line, sign = at + slope * k / 40, (-1.0) ** k
    rough = line + jump * (1 + growth * k / 40) * sign
    means = without_zigzag(rough[:, None])[:, 0]
    assert np.abs(means - line).max() <= max(1e-9, 0.05 * np.ptp(line))


@pytest.mark.parametrize("seed", range(5))
def test_what_does_not_alternate_stays_as_it_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    smooth = np.sin(np.linspace(0, 9, 50))[:, None]
    for values in (smooth, rng.normal(size=(50, 1)), smooth + np.nan, smooth[:5], np.zeros((50, 1))):
        np.testing.assert_array_equal(without_zigzag(values), values)


def test_multipliers_of_a_constrained_system() -> None:
    figure = plot_multipliers(pendulum())
    symbols = [axes.get_ylabel().split(" ")[0] for axes in figure.axes]
    assert symbols == [r"$\mu^q$", r"$\mu^p$", r"$\lambda$", r"$\zeta$"]
    assert len(plot_multipliers(arm()).axes) == 2


def test_convergence_is_logarithmic_with_the_tolerance() -> None:
    figure = plot_convergence(arm())
    axes = figure.axes[0]
    assert axes.get_yscale() == "log"
    assert legend(axes) == ["residual", "increment", "tolerance"]
    assert titles(figure) == ["Convergence", "Cost"]


def test_invariants_with_the_violation_of_constraints() -> None:
    robot = spherical_pendulum()
    angle = np.linspace(0, 1, 21)
    qs = 5.0 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    solution = motion(robot, [0, 5.0, 0], qs=qs)
    figure = plot_invariants(solution, robot)
    assert titles(figure) == [
        "Control Hamiltonian",
        "Control momentum",
        "Drift of invariants, violation of constraints",
    ]
    assert legend(figure.axes[2]) == [r"$\xi$ rotation about z", r"$\Phi$ rod"]
    assert figure.axes[2].get_yscale() == "log"


def test_invariants_where_bodies_have_constraints_and_the_robot_has_none() -> None:
    """As in natural coordinates."""
    figure = plot_invariants(pendulum(), load_robot("ur5"))
    assert not any("Phi" in name for name in legend(figure.axes[-1]))


def test_what_is_constant_looks_constant() -> None:
    momentum = panel(plot_invariants(arm()), "Control momentum")
    low, high = momentum.get_ylim()
    assert high - low > 0.1


def test_a_motion_in_space_and_one_in_a_plane() -> None:
    robot = load_robot("ur5")
    solution = motion(robot, robot.q0 + 0.5)
    (axes,) = plot_path(solution, robot).axes
    assert axes.name == "3d"
    assert legend(axes) == ["tool0", "start", "end"]
    cart = hanging(cart_pendulum(), "bob_body", "cart_body")
    (axes,) = plot_path(motion(cart, [1.0, 1.5, 1.0]), cart).axes
    assert axes.name == "rectilinear"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("$x$ [m]", "$z$ [m]")


def test_rates_have_names_and_units_and_all_kinds() -> None:
    robot = load_robot("ur5")
    solution = motion(robot, [0.8, -0.6, 0.5, 0.4, -0.3, 0.2])
    kinds = ["Acceleration", "Jerk", "Rate of the control", "Power"]
    figure = plot_rates(solution, robot)
    assert titles(figure) == kinds
    units = [axes.get_ylabel().rpartition("[")[2] for axes in figure.axes]
    assert units == ["rad/s²]", "rad/s³]", "N m/s]", "W]"]
    assert titles(plot_rates(solution)) == kinds[:3]  # powers need a robot
    drawn = figure.axes[0].lines[0].get_ydata()
    accelerations = np.diff(solution.vs[:, 0]) / np.diff(solution.t)
    assert np.isin(accelerations, drawn).all()


@pytest.mark.parametrize("columns", [1, 4])
def test_labels_of_axes_in_space_are_on_the_page(columns: int) -> None:
    """Alone on a page, and in the narrow cell of an overview with many panels."""
    robot = hanging(load_robot("ur5"), "tool0")
    paths = frame_paths(robot, motion(robot, [0.5, -1.0, 1.0, 0.0, 0.5, 0.0]).qs)
    figure = style.new_figure(4.1 * columns, 8.5)
    axes = figure.add_subplot(GridSpec(3, columns, figure=figure)[:2, -1], projection=paths.projection)
    paths.draw(axes)
    paths.fit(axes)
    figure.draw_without_rendering()
    page = figure.bbox
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        box = axis.label.get_window_extent()
        assert page.x0 <= box.x0, axis.label.get_text()
        assert box.x1 <= page.x1, axis.label.get_text()


def test_the_path_of_a_frame_that_is_not_there() -> None:
    robot = load_robot("ur5")
    with pytest.raises(UnknownFrame, match="tool9"):
        plot_path(motion(robot, robot.q0 + 0.5), robot, ["tool9"])


def test_the_path_ends_where_the_robot_does() -> None:
    robot = load_robot("ur5")
    solution = motion(robot, robot.q0 + 0.5)
    (axes,) = plot_path(solution, robot, ["tool0"]).axes
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, solution.qs[-1])
    expected = data.oMf[robot.frame_id("tool0")].translation
    ends = [np.array(line.get_data_3d())[:, -1] for line in axes.lines if len(line.get_data_3d()[0]) == 21]
    np.testing.assert_allclose(ends[0], expected, atol=1e-12)


def test_the_overview_says_what_it_is() -> None:
    figure = overview(arm())
    assert figure.get_suptitle().startswith(
        "panda_reach, robot panda: converged after 9 iterations of monolithic"
    )
    assert "$J$ = 12.34568" in figure.get_suptitle()
    failed = overview(arm(status=Status.MAX_ITERATIONS, advice="give it more iterations"))
    assert "not converged (max_iterations)" in failed.get_suptitle()
    assert failed.get_suptitle().endswith("give it more iterations")


def test_the_overview_with_a_robot_has_its_path(of_arm: Figure) -> None:
    assert "Path in space" in titles(of_arm)
    of_arm.canvas.draw()


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_the_file_is_what_its_suffix_says(suffix: str, tmp_path: Path) -> None:
    path = save_figure(plot_controls(pendulum(num_steps=20)), tmp_path / f"picture{suffix}")
    start = path.read_bytes()[:60]
    assert {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}[suffix] in start
    assert list(tmp_path.iterdir()) == [path]


def test_a_style_takes_the_place_of_the_own_one(tmp_path: Path) -> None:
    own = tmp_path / "own.mplstyle"
    own.write_text("axes.labelsize: 14\nfigure.facecolor: '#102030'\n")
    figure = overview(pendulum(num_steps=20), style=own)
    assert {axes.xaxis.label.get_size() for axes in figure.axes} == {14.0}
    dark = plot_solution(pendulum(num_steps=20), tmp_path / "dark.png", style="dark_background")
    assert not mpimg.imread(dark)[0, 0, :3].any()
    plain = overview(pendulum(num_steps=20))
    assert plain.get_facecolor() == (1.0, 1.0, 1.0, 1.0)
    assert {axes.xaxis.label.get_size() for axes in plain.axes} == {8.5}


def test_a_style_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidValue, match=r"style: got nonsense, .*mplstyle.*dark_background"):
        plot_solution(pendulum(num_steps=20), tmp_path / "a.png", style="nonsense")
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(("name", "got"), [("picture.bmp", "suffix '.bmp'"), ("picture", "needs a suffix")])
def test_other_suffixes_are_refused(name: str, got: str, tmp_path: Path) -> None:
    with pytest.raises(ResultFileError, match=rf"{got}: use \.png, \.pdf, \.svg"):
        plot_solution(pendulum(num_steps=20), tmp_path / name)


def test_an_interrupted_picture_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "picture.png"
    path.write_bytes(b"old")

    def interrupted(self: FigureCanvasAgg, target: Any) -> None:
        target.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(FigureCanvasAgg, "print_png", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_figure(style.new_figure(3, 2), path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_numbers_that_are_none_do_not_break_a_picture(tmp_path: Path) -> None:
    robot = hanging(spherical_pendulum(), "body")
    broken = {name: getattr(pendulum(), name).copy() for name in ("qs", "vs", "us", "mus", "lams", "zetas")}
    for values in broken.values():
        values[50:] = np.nan
        values[49] = np.inf
    record = IterationRecord(iteration=0, residual=float("nan"))
    empty = {"control_hamiltonians": np.zeros(0), "control_momenta": np.full((101, 1), np.nan)}
    solution = pendulum(
        **{**broken, **empty, "history": (record,), "cost": float("nan"), "status": "diverged", "advice": "x"}
    )
    assert plot_solution(solution, tmp_path / "picture.png").stat().st_size > 10_000
    plot_convergence(dataclasses.replace(solution, history=())).canvas.draw()
    plot_path(solution, robot).canvas.draw()


def test_names_that_mean_something_to_matplotlib() -> None:
    names = ["_hidden", "cost$", "a_b"]
    q, v, u = ([Column(n, unit) for n in names] for unit in ("rad", "rad/s", "N m"))
    figure = plot_states(fabricate(q, v, u, num_steps=20))
    figure.canvas.draw()
    assert [text.strip() for text in legend(figure.axes[0])] == ["_hidden", r"cost\$", "a_b"]


def test_pictures_leave_no_trace_in_matplotlib() -> None:
    before = dict(matplotlib.rcParams)
    overview(pendulum(num_steps=20))
    assert dict(matplotlib.rcParams) == before


def test_the_palette_is_told_apart_without_red_or_green() -> None:
    """Luminance and blue-yellow alone separate neighbours of the palette."""
    rgb = np.array([[int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)] for c in PALETTE])
    opponent = np.column_stack([rgb @ [0.30, 0.59, 0.11], rgb[:, 2] - rgb[:, :2].mean(axis=1)])
    for a, b in itertools.pairwise(opponent):
        assert np.linalg.norm(a - b) > 0.1


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["root_joint.x", "root_joint.y"], ("root_joint", ["x", "y"])),
        (["x", "y", "z"], ("", ["x", "y", "z"])),
        (["joint_1", "joint_2"], ("", ["joint_1", "joint_2"])),
        (["alone.x"], ("", ["alone.x"])),
        (["same", "same"], ("", ["same", "same"])),
        (["distance of a", "distance of b"], ("distance of ...", ["a", "b"])),
        ([], ("", [])),
    ],
)
def test_what_names_share_is_said_once(names: list[str], expected: tuple[str, list[str]]) -> None:
    assert shorten(names) == expected
