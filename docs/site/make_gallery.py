"""Solve the examples and photograph their replays: `python docs/site/make_gallery.py [NAME ...]`.

Everything goes to `build/gallery`: for each example a replay (.html), a picture (.png), a summary (.json) and
the result (.h5). An example is solved again when its file has changed, or when it is named. Pictures need
Chromium; without it the plots of `mbocp plot` take their place.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from PIL import Image

from mbocp.view.movie import browse, find_browser

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build" / "gallery"
ROOMS = {  # of examples, and their titles
    "arms": "Arms",
    "worlds": "Several robots",
    "free_flyer": "Drones",
    "legged": "Legs",
    "walking": "Walking",
    "loops": "Closed loops",
    "design": "Designs",
    "receding": "In the loop",
    "paper": "Pendulums of the first paper",
    "so3": "The second paper",
    "optima": "Known optima",
    "identification": "Motions that tell masses",
}
NO_SINGLE_MOTION = {"lattice"}  # thousands of tasks, for `mbocp study`
SIZE = (840, 560)  # [pixels], of the window
MOMENT = 0.4  # part of the motion that has passed in the picture


def examples() -> Iterator[Path]:
    """Problem files of the gallery, in its order."""
    for room in ROOMS:
        for path in sorted((ROOT / "examples" / room).glob("*.toml")):
            if path.stem not in NO_SINGLE_MOTION:
                yield path


def name_of(example: Path) -> str:
    """What an example's files are called."""
    return f"{example.parent.name}-{example.stem}"


def is_current(example: Path) -> bool:
    """Whether its files are there and were made from its present text."""
    name = FOLDER / name_of(example)
    files = [name.with_suffix(end) for end in (".json", ".html", ".png", ".digest")]
    return all(file.exists() for file in files) and files[-1].read_text() == digest_of(example)


def digest_of(example: Path) -> str:
    """Digest of the problem file."""
    return hashlib.sha256(example.read_bytes()).hexdigest()


def make(example: Path) -> None:
    """Solve one example and keep what the gallery shows of it."""
    name = FOLDER / name_of(example)
    result, page = name.with_suffix(".h5"), name.with_suffix(".html")
    said = mbocp("solve", example, "-o", result, "--no-meshes", "--json", "--quiet", "--replay", page)
    summary = json.loads(said)
    name.with_suffix(".json").write_text(json.dumps(summary, indent=1))
    picture = name.with_suffix(".png")
    if not photograph(page, picture, MOMENT * float(summary["duration"])):
        mbocp("plot", result, "-o", picture, "--quiet")
    shrink(picture)
    name.with_suffix(".digest").write_text(digest_of(example))


def mbocp(*words: str | Path) -> str:
    """What a command prints; its exit status may say that it did not converge."""
    command = [sys.executable, "-m", "mbocp", *map(str, words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
    return done.stdout


def photograph(page: Path, picture: Path, time: float, size: tuple[int, int] = SIZE) -> bool:
    """A picture of a replay at a time [s]; False without a browser."""
    if find_browser() is None:
        return False
    browse(
        f"{page.as_uri()}#t={time:g}", FOLDER / "profile", f"--screenshot={picture}", size=size, timeout=180.0
    )
    return True


def shrink(picture: Path) -> None:
    """Store a picture with a palette of its own: a third of the size."""
    with Image.open(picture) as image:
        small = image.convert("RGB")
    small.thumbnail(SIZE)
    small.quantize(192, dither=Image.Dither.NONE).save(picture, optimize=True)


def main(names: list[str]) -> None:
    """Make what is missing, or the examples that are named."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    known = {name_of(example): example for example in examples()}
    if unknown := set(names) - set(known):
        raise SystemExit(f"no example {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    for name, example in known.items():
        if name in names or (not names and not is_current(example)):
            print(f"gallery: {name}", flush=True)
            make(example)


if __name__ == "__main__":
    main(sys.argv[1:])
