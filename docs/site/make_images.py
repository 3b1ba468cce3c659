"""Make the pictures that pages hold: `python docs/site/make_images.py [NAME ...]`, after `make docs`.

Names are those of `MAKERS`. Pictures come from results of the gallery, and from the commands on the pages,
through Chromium. Figures of the papers are from `mbocp paper`, diagrams of work and precision from `python -m
benchmarks.work_precision`, and `live.png` is a photograph of `mbocp live examples/arms/slalom.toml`.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import make_sheet
import transcripts
from make_gallery import FOLDER, MOMENT, ROOT, mbocp, photograph, shrink
from PIL import Image

DOCS = ROOT / "docs"
IMAGES = DOCS / "images"
LOOPS = ("delta", "five_bar", "four_bar", "parallelogram_arm", "slider_crank", "stewart")
ROBOTS = {"panda": "panda", "iris": "iris", "so101": "so101", "so101_bare": "so101_bare"}  # pages by picture
MOMENTS = (0.0, 0.4, 0.8)  # parts of the motion that have passed, side by side
PANEL = (348, 232)  # [pixel] of one of them
BARE = "<style>header, #bar { visibility: hidden }</style></head>"  # a page with nothing written on it
GAP = 3  # [pixel]


def loops() -> None:
    """Each closed loop of the gallery at three times."""
    for name in LOOPS:
        replay, page = FOLDER / f"loops-{name}.html", FOLDER / "bare.html"
        page.write_text(replay.read_text("utf-8").replace("</head>", BARE, 1), "utf-8")
        duration = float(json.loads(replay.with_suffix(".json").read_text())["duration"])
        sheet = Image.new("RGB", (3 * PANEL[0] + 2 * GAP, PANEL[1]), "white")
        for column, moment in enumerate(MOMENTS):
            picture = FOLDER / "moment.png"
            photograph(page, picture, moment * duration)
            with Image.open(picture) as taken:
                panel = taken.convert("RGB").resize(PANEL, Image.Resampling.LANCZOS)
            sheet.paste(panel, (column * (PANEL[0] + GAP), 0))
        sheet.quantize(192, dither=Image.Dither.NONE).save(IMAGES / "loops" / f"{name}.png", optimize=True)


def urdf() -> None:
    """The robots of docs/three_robots.md, by its own commands, and the goal of docs/your_urdf.md."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        transcripts.lay_out_robots(folder)
        for step in transcripts.steps_of((DOCS / "three_robots.md").read_text("utf-8")):
            _run(step.command, folder)
        for name, page in ROBOTS.items():
            _keep(folder / f"{page}.html", IMAGES / "urdf" / f"{name}.png", MOMENT)
        (problem,) = re.findall(
            r"^```toml\n(.*?)^```", (DOCS / "your_urdf.md").read_text("utf-8"), re.M | re.S
        )
        (folder / "arm.urdf").write_bytes((folder / "so101.urdf").read_bytes())
        (folder / "reach.toml").write_text(problem.replace("~/ros/src", "share"))
        _run("mbocp solve reach.toml -q --replay reach.html", folder)
        _keep(folder / "reach.html", IMAGES / "urdf" / "reach.png", 100.0)


def _run(command: str, folder: Path) -> None:
    words = [sys.executable, "-m", "mbocp", *shlex.split(command)[1:]]
    subprocess.run(words, cwd=folder, env={**os.environ, "COLUMNS": "100"}, check=True)


def _keep(page: Path, picture: Path, time: float) -> None:
    photograph(page, picture, time)
    shrink(picture)


def pick_and_place() -> None:
    """The moving picture of the first page."""
    result = FOLDER / "arms-pick_and_place.h5"
    film = IMAGES / "pick_and_place.gif"
    mbocp("replay", result, "--movie", film, "--size", "600x328", "--fps", "12.5")


MAKERS: dict[str, Callable[[], None]] = {
    "loops": loops,
    "urdf": urdf,
    "pick_and_place": pick_and_place,
    "wishes": make_sheet.main,
}


def made() -> set[str]:
    """Pictures that this script makes, within `docs/images`."""
    loops_and_robots = [f"loops/{name}.png" for name in LOOPS] + [
        f"urdf/{name}.png" for name in (*ROBOTS, "reach")
    ]
    return {"pick_and_place.gif", "wishes.png", *loops_and_robots}


def main(names: list[str]) -> None:
    """Make all of them, or those that are named."""
    if unknown := set(names) - set(MAKERS):
        raise SystemExit(f"no picture {', '.join(sorted(unknown))}; there are {', '.join(MAKERS)}")
    for name in names or MAKERS:
        print(f"images: {name}", flush=True)
        MAKERS[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
