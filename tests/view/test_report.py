"""Reports: one file with all in it, whose plots and replay move each other."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mbocp.robot import load_robot
from mbocp.solution import Labels, Solution
from mbocp.solution.solution import ProblemNotShownWarning
from mbocp.view import browser
from mbocp.view.report import write_report
from mbocp.view.reports.plots import frame_panels
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


@pytest.fixture(scope="module", params=["ur5", "four_bar", "solo12"])
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
        "Over time", "What came out", "Active limits", "Loads of the controls",
        "Forces, adjoints and multipliers",
        "Convergence and diagnostics", "Problem file", "Made with",
    ]  # fmt: skip


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
        assert plot["from"] < plot["t"][0] < plot["t"][-1] < plot["to"]
        left, right, top, bottom = plot["box"]
        assert 0.0 < left < right <= 1.0
        assert 0.0 < top < bottom < 1.0
        assert all(len(values) == STEPS + (not plot["step"]) for values in plot["values"])
    assert any(plot["step"] and plot["values"][0] == list(range(STEPS)) for plot in curves)


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
    log = browser.browse(
        page.as_uri(), page.parent / "log", "--enable-logging=stderr", "--dump-dom", size=SIZE
    ).stderr
    assert not [line for line in log.splitlines() if "CONSOLE" in line and "Error" in line]
