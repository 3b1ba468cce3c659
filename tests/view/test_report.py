"""Reports: one file with all in it, whose plots and replay move each other."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mbocp.robot import load_robot
from mbocp.solution import Labels, Solution
from mbocp.solution.later import retold
from mbocp.solution.solution import ProblemNotShownWarning
from mbocp.view import movie
from mbocp.view.report import compare_results, differences_of, write_report
from mbocp.view.reports.page_plots import energy_panels, frame_panels
from tests.view.test_replay_browser import SIZE, browse

T, STEPS = 2.0, 20


def a_solution(name: str) -> Solution:
    """A motion of every joint at constant speed, with a control that is as large as its step's number."""
    robot = load_robot(name)
    speed = 0.4 * np.resize([1.0, -1.2, 0.8, 0.9, -0.5], robot.nv)
    t = np.linspace(1.0, 1.0 + T, STEPS + 1)  # which does not begin at zero
    qs = np.array([robot.integrate(robot.q0, (x - t[0]) * speed) for x in t])
    return Solution(
        status="converged", solver="none", iterations=0, cost=1.0, residual=0.0, unknowns=1, t=t, qs=qs,
        vs=np.tile(speed, (STEPS + 1, 1)), ps=np.tile(speed, (STEPS + 1, 1)),
        us=np.tile(np.arange(STEPS)[:, None], (1, robot.nu)), mus=np.zeros((STEPS + 1, 2 * robot.nv)),
        lams=np.zeros((STEPS, robot.nc)), zetas=np.zeros((STEPS, robot.nc)),
        robot_name=robot.name, robot_spec=dict(robot.spec), labels=Labels.of_robot(robot),
        problem_name="a <motion>", problem_text="# <script>alert(1)</script>", versions={"mbocp": "x"},
    )  # fmt: skip


@pytest.fixture(scope="module", params=["four_bar", "solo12"])
def page(request, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp(request.param)
    facts = [("status", "all <well>")]
    with pytest.warns(ProblemNotShownWarning, match="horizon: this key is missing"):
        return write_report(a_solution(request.param), folder / "page.html", facts=facts)


def test_a_report_is_one_file(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    own = text[: text.index("<script>")] + text[text.index('<script type="text/plain"') :]
    assert not re.findall(r'(?:src|href)="(?!data:)', own)
    assert "all &lt;well&gt;" in own
    assert "&lt;script&gt;alert(1)" in own
    assert "<script>alert(1)" not in text
    titles = re.findall("<h2>(.*?)</h2>", own)
    assert titles == [
        "Over time", "What came out", "Loads of the controls",
        "Active limits (0)", "Forces, adjoints and multipliers",
        "Convergence and diagnostics", "Problem file", "Made with",
    ]  # fmt: skip
    assert re.findall("<details><summary><h2>(.*?)</h2>", own) == titles[3:]
    assert '<p class="verdict"><b>converged</b> · cost 1 · 2 s</p>' in own


def test_the_motion_in_space_is_plotted() -> None:
    solution = a_solution("ur5")
    *places, speeds = frame_panels(solution, load_robot("ur5"))
    assert [place.title for place in places] == ["Position of tool0"]
    steps = np.linalg.norm(np.diff(places[0].values, axis=0), axis=1) / np.diff(solution.t)
    means = (speeds.values[1:, 0] + speeds.values[:-1, 0]) / 2.0
    assert steps == pytest.approx(means, rel=2e-2)  # chords of 0.1 s


def test_plots_have_the_numbers_of_the_motion(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    curves = [json.loads(html.unescape(data)) for data in re.findall(r'data-curves="([^"]*)"', text)]
    assert len(curves) >= 4
    for plot in curves:
        assert (plot["start"], plot["duration"]) == (1.0, T)
        assert all(plot["from"] < part["t"][0] < part["t"][-1] < plot["to"] for part in plot["parts"])
        left, right, top, bottom = plot["box"]
        assert 0.0 < left < right <= 1.0
        assert 0.0 < top < bottom < 1.0
        parts = plot["parts"]
        assert all(len(values) == STEPS + (not part["step"]) for part in parts for values in part["values"])
    assert any(
        part["step"] and part["values"][0] == list(range(STEPS)) for plot in curves for part in plot["parts"]
    )


def test_what_is_constant_has_words_in_place_of_a_plot(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "<h3>Velocity" not in text
    words = re.findall(r'<p class="note whole">Constant: (.*?)</p>', text)[0]
    assert re.search(r"Velocity(, root_joint)?: .* [\d.-]+ \[(rad|m)/s\]", words)


def test_energy_is_that_of_momenta_and_heights() -> None:
    robot = load_robot("rigid_pendulum")
    solution = replace(a_solution("rigid_pendulum"), vs=np.ones((STEPS + 1, robot.nv)))
    kinetic, potential, both = energy_panels(solution, robot)[0].values.T
    np.testing.assert_allclose(kinetic, 0.5 * (solution.ps * solution.vs).sum(axis=1))
    heights = [robot.potential_energy(q) - robot.potential_energy(solution.qs[0]) for q in solution.qs]
    np.testing.assert_allclose(potential, heights)
    np.testing.assert_allclose(both, kinetic + potential)


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> str:
    """Two motions of one robot side by side, the second half as long, from an earlier time."""
    first = replace(a_solution("double_pendulum"), problem_text="[horizon]\nsteps = 20\nduration = 2.0")
    second = replace(
        first,
        t=0.5 * first.t,
        cost=0.5,
        qs=1.1 * first.qs,
        problem_text="[horizon]\nsteps = 20\nduration = 1.0",
    )
    path = tmp_path_factory.mktemp("pair") / "page.html"
    with pytest.warns(ProblemNotShownWarning):
        return compare_results({"one": first, "two": second}, path).read_text(encoding="utf-8")


def test_two_results_have_their_numbers_side_by_side(pair: str) -> None:
    assert "<tr><td>cost</td><td>1</td><td>0.5</td></tr>" in pair
    assert "<tr><td>duration [s]</td><td>2</td><td>1</td></tr>" in pair
    assert "<tr><td>horizon.duration</td><td>2</td><td>1</td></tr>" in pair
    assert "horizon.steps</td>" not in pair
    assert "clearance" not in pair.split('id="below"')[1].split("</table>")[0]  # neither has one


def test_two_results_are_drawn_on_the_same_axes(pair: str) -> None:
    plots = [json.loads(html.unescape(data)) for data in re.findall(r'data-curves="([^"]*)"', pair)]
    legends = re.findall("<figcaption>(.*?)</figcaption>", pair)
    assert len(plots) == len(legends) >= 6
    for plot, legend in zip(plots, legends, strict=True):
        assert [len(part["values"]) for part in plot["parts"]] == [1, 1]
        assert [part["t"][0] for part in plot["parts"]] == [1.0, 1.0]  # both begin with the first
        assert plot["to"] > plot["start"] + plot["duration"] == 1.0 + T
        assert re.findall(r"</i>(\w+) ", legend) == ["one", "two"]
        assert len(set(re.findall("border-color:(#[0-9A-F]{6})", legend))) == 2
    assert "<details open><summary><h2>Configuration [rad]</h2>" in pair
    assert "<h2>Velocity" not in pair  # constant, and the same


def test_keys_that_differ_have_as_many_digits_as_tell_them_apart() -> None:
    texts = (
        "[cost]\nw = [0.125, 0.125]\nx = 0.1234567\ny = 1.00000001",
        "[cost]\nw = [0.125, 2.0]\nx = 1.5\ny = 1.0",
    )
    one, two = (retold(a_solution("ur5"), problem_text=text) for text in texts)
    assert differences_of({"a": one, "b": two}) == [
        ["cost.w", "0.125, each of 2", "[0.125, 2]"],
        ["cost.x", "0.123457", "1.5"],
        ["cost.y", "1.00000001", "1.0"],
    ]


def test_results_of_one_problem_differ_in_no_key() -> None:
    assert differences_of({"a": a_solution("ur5"), "b": a_solution("ur5")}) == []


@pytest.mark.slow
def test_the_time_of_the_replay_moves_the_cursors(page: Path) -> None:
    places, shots = [], []
    for time in (0.0, 1.5):
        document = browse(page, "--dump-dom", time=time)
        assert 'data-state="ready"' in document
        assert 'data-problems="0"' in document
        places.append([float(x) for x in re.findall(r'class="cursor" style="left: ([\d.]+)%', document)])
        file = page.with_name(f"{time}.png")
        browse(page, f"--screenshot={file}", time=time)
        shots.append(np.asarray(Image.open(file).convert("RGB"), dtype=float))
    assert len(places[0]) >= 4
    assert np.all(np.array(places[1]) > np.array(places[0]) + 20.0)
    picture = np.abs(shots[0] - shots[1])[60:250].max(axis=2)
    assert (picture > 40.0).sum() > 200  # the robot moved
    assert shots[0][60:250].std() > 5.0  # and is there


@pytest.mark.slow
def test_pages_are_dark_where_the_browser_asks_for_that(page: Path) -> None:
    """Plots, too: their paper has the colour of the page's, and there is light writing on it."""
    light, dark = (_below_the_replay(page, scheme) for scheme in (1, 0))
    assert np.median(light) > 200.0
    assert np.median(dark) < 60.0
    assert (light < 100.0).sum() > 200
    assert (dark > 150.0).sum() > 200


def _below_the_replay(page: Path, scheme: int) -> np.ndarray:
    file = page.with_name(f"scheme{scheme}.png")
    browse(page, f"--screenshot={file}", f"--blink-settings=preferredColorScheme={scheme}")
    shot = np.asarray(Image.open(file).convert("L"), dtype=float)
    return shot[int(0.65 * len(shot)) :]


@pytest.mark.slow
def test_a_pointer_on_a_plot_moves_the_robot(page: Path) -> None:
    """At 80 % of its width; nothing complains on the console."""
    pressed = """<script>addEventListener("load", () => setInterval(() => {
      if (document.body.dataset.state !== "ready" || document.body.dataset.pressed) { return; }
      document.body.dataset.pressed = "1";
      const picture = document.querySelector(".picture.tied"), frame = picture.getBoundingClientRect();
      picture.setPointerCapture = () => {};
      const x = frame.left + 0.8 * frame.width;
      const at = { clientX: x, clientY: frame.top + 9, buttons: 1, bubbles: true };
      picture.dispatchEvent(new PointerEvent("pointerdown", at));
      document.body.dataset.now = viewer.animator.time;
    }, 50));</script>"""
    copy = page.with_name("pressed.html")
    copy.write_text(
        page.read_text(encoding="utf-8").replace("</body>", pressed + "</body>"), encoding="utf-8"
    )
    text = page.read_text(encoding="utf-8")
    plot = json.loads(html.unescape(re.findall(r'data-curves="([^"]*)"', text)[0]))
    left, right = plot["box"][:2]
    expected = plot["from"] + (0.8 - left) / (right - left) * (plot["to"] - plot["from"]) - plot["start"]
    document = browse(copy, "--dump-dom")
    now = float(document.split('data-now="')[1].split('"')[0])
    assert now == pytest.approx(expected, abs=0.01)
    log = movie.browse(
        page.as_uri(), page.parent / "log", "--enable-logging=stderr", "--dump-dom", size=SIZE
    ).stderr
    assert not [line for line in log.splitlines() if "CONSOLE" in line and "Error" in line]
