"""Arrows of forces in a real browser: seen through bodies, hidden by their box. Slow: it needs Chromium."""

from __future__ import annotations

import numpy as np
import pytest

from mbocp import load_robot
from mbocp.view import movie
from mbocp.view.marks import ForceMark, Marks
from mbocp.view.replay import write_replay
from tests.view.test_replay_browser import browse, picture

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(movie.find_browser() is None, reason="no Chromium"),
]

CLICKED = """<script>const waiting = setInterval(() => {
  if (document.body.dataset.state !== "ready") { return; }
  clearInterval(waiting);
  const label = document.getElementById("forces"), box = label.querySelector("input");
  const arrow = () => {
    let found = null;
    viewer.scene.traverse((node) => { if (node.renderOrder === 10) { found = node; } });
    for (let node = found; node; node = node.parent) { if (!node.visible) { return "hidden"; } }
    return found ? "seen" : "none";
  };
  const states = [label.hidden ? "no box" : "box", arrow()];
  for (let k = 0; k < CLICKS; ++k) { box.click(); states.push(arrow()); }
  document.body.dataset.arrows = states.join(" ");
}, 50);</script>"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A force of 10 N on the tool of a UR5, which is in the middle of a solid box."""
    load = {"name": "load", "frame": "tool0", "mass": 1.0, "com": [0.0, 0.0, 0.0], "box": [0.9, 0.9, 0.9]}
    robot, t = load_robot("ur5", payload=[load]), np.linspace(0.0, 1.0, 11)
    force = np.tile([0.0, 0.0, 10.0], (10, 1))
    marks = Marks(forces=(ForceMark("it", robot.frame_id("tool0"), 0, False, t, force),))
    path = tmp_path_factory.mktemp("arrows") / "page.html"
    return write_replay(robot, t, np.tile(robot.q0, (11, 1)), path, marks=marks)


def clicked(page, clicks: int):
    """The page with its box clicked some times when it is ready."""
    copy, script = page.with_name(f"clicked_{clicks}.html"), CLICKED.replace("CLICKS", str(clicks))
    text = page.read_text(encoding="utf-8").replace("</body>", script + "</body>")
    copy.write_text(text, encoding="utf-8")
    return copy


def test_the_box_hides_and_shows_arrows(page) -> None:
    document = browse(clicked(page, 2), "--dump-dom")
    assert 'data-arrows="box seen hidden seen"' in document
    assert "Forces of constraints: 1 cm = " in document


def test_arrows_are_seen_through_bodies(page) -> None:
    """Their colour is in the picture, though a box is around them, and is gone when the box is clicked."""
    counts = []
    for clicks in (0, 1):
        shot = picture(clicked(page, clicks), float(clicks) / 2)[100:530]  # below title and box
        red, green, blue = np.moveaxis(shot, 2, 0)
        counts.append(int(((red > 1.5 * green + 40) & (blue > 1.5 * green) & (red > 1.2 * blue)).sum()))
    assert counts[0] > 150
    assert counts[1] == 0
