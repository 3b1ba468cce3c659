"""`mbocp spheres`."""

from __future__ import annotations

import json

from tests.robot.urdfs import joint, link, robot, write
from tests.view.pages import read_page


def ball(tmp_path):
    shape = '<collision><geometry><sphere radius="0.07"/></geometry></collision>'
    urdf = robot(link("base"), link("l1", extra=shape), joint("j1", "revolute", "base", "l1"))
    return str(write(tmp_path, urdf))


def test_a_table_and_a_page(run, tmp_path):
    page = tmp_path / "page.html"
    done = run("spheres", ball(tmp_path), "--replay", str(page))
    assert done.exit_code == 0
    assert "l1    1        urdf  70 mm" in done.stdout
    assert "/replay/world/robot/j1/spheres/l1_0" in read_page(page).objects()


def test_json(run, tmp_path):
    (found,) = json.loads(run("spheres", ball(tmp_path), "--json").stdout)
    assert (found["link"], found["radii"], found["origin"]) == ("l1", [0.07], "urdf")


def test_a_robot_without_shapes_is_refused(run):
    done = run("spheres", "stewart")
    assert done.exit_code == 2
    assert "has no collision geometry" in done.stderr
