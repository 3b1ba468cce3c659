"""A replay as single pictures or as a film: drawn from the page by Chromium without a window."""

from __future__ import annotations

import base64
import io
import math
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from mbocp._arrays import dataclass
from mbocp.exceptions import ReplayError
from mbocp.solution.atomic import replace_file

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",  # 3-D graphics without a graphics card
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
)
_OWN_TIME = "--virtual-time-budget=10000"  # [ms] that pass for a page, as fast as its scripts run


def find_browser() -> str | None:
    """Path of Chromium or Chrome; None where there is none."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def browser_command(profile: Path, *flags: str, size: tuple[int, int]) -> list[str]:
    """Command that opens a page without a window; its address comes last.

    Parameters
    ----------
    profile : Path
        Folder for the browser's own files.
    *flags : str
        More flags of the browser.
    size : (int, int)
        Width and height of the window [pixel].

    Raises
    ------
    ReplayError
        If there is no browser.
    """
    browser = find_browser()
    if browser is None:
        raise ReplayError(
            f"no browser on the PATH ({', '.join(BROWSERS)}), which draws pictures of a replay: install one "
            "(Debian: apt install chromium)"
        )
    return [browser, *_FLAGS, f"--window-size={size[0]},{size[1]}", f"--user-data-dir={profile}", *flags]


def browse(
    address: str, profile: Path, *flags: str, size: tuple[int, int], timeout: float = 120.0
) -> subprocess.CompletedProcess[str]:
    """Open a page, run its scripts, and leave again.

    Parameters
    ----------
    address : str
    profile : Path
        Folder for the browser's own files.
    *flags : str
        What to do with the page: ``--screenshot=FILE``, ``--dump-dom``.
    size : (int, int)
        Width and height of the window [pixel].
    timeout : float
        [s].

    Returns
    -------
    done : CompletedProcess
        With what the browser wrote.

    Raises
    ------
    ReplayError
        If there is no browser, or it fails.
    """
    command = [*browser_command(profile, _OWN_TIME, *flags, size=size), address]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ReplayError(f"{command[0]}: {error}") from error
    if done.returncode:
        raise ReplayError(f"{command[0]} failed with status {done.returncode}: {done.stderr.strip()[-300:]}")
    return done


MOVIES = (".gif", ".mp4")
_MAX_FRAMES = 3000
_MAX_SIDE = 4096  # [pixel]
_SECONDS_A_FRAME = 2.0  # [s] on a slow machine, before it is given up
_RECORDER = """<script>
"use strict";
(async () => {
  const times = @TIMES@;
  const state = () => document.body.dataset.state;
  while (!state()) { await new Promise((later) => setTimeout(later, 20)); }
  if (state() === "failed") { return; }
  const pictures = [];
  for (const time of times) {
    if (viewer.animator.mixer) { viewer.animator.pause(); viewer.animator.seek(time); }
    pictures.push(viewer.capture_image().split(",")[1]);
  }
  const held = document.createElement("script");
  held.type = "text/plain";
  held.id = "pictures";
  held.textContent = pictures.join(" ");
  document.body.replaceChildren(held);
})();
</script>"""
_BARE = """<style>
header, #bar, #busy, main { display: none !important; }
#stage { width: @WIDTH@px !important; height: @HEIGHT@px !important; }
</style>"""


@dataclass(frozen=True)
class Film:
    """How a replay is filmed.

    Attributes
    ----------
    frames_per_second : float
        [1/s].
    speed : float
        Seconds of motion per second of watching.
    size : (int, int)
        Width and height [pixel], even numbers.
    """

    frames_per_second: float = 25.0
    speed: float = 1.0
    size: tuple[int, int] = (960, 640)

    def __post_init__(self) -> None:
        for name in ("frames_per_second", "speed"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ReplayError(f"film: {name}: got {value}, expected a positive number")
        if any(side % 2 or not 64 <= side <= _MAX_SIDE for side in self.size):
            raise ReplayError(
                f"film: size: got {self.size[0]}x{self.size[1]}, expected even numbers from 64 to {_MAX_SIDE}"
            )


def frame_times(duration: float, film: Film) -> list[float]:
    """Times of the pictures [s] since the motion's begin; the last one is its end.

    Raises
    ------
    ReplayError
        If there would be too many.
    """
    steps = math.ceil(duration / film.speed * film.frames_per_second - 1e-9)
    if steps >= _MAX_FRAMES:
        words = f"{steps + 1} pictures, expected at most {_MAX_FRAMES}"
        raise ReplayError(f"film: {words}; take a greater speed or fewer a second")
    return [min(k * film.speed / film.frames_per_second, duration) for k in range(steps + 1)]


def pictures_of(page: str, times: Sequence[float], size: tuple[int, int]) -> list[bytes]:
    """PNG pictures of a replay page at some times [s].

    Parameters
    ----------
    page : str
        What `mbocp.view.replay.replay_page` returns.
    times : sequence of float
    size : (int, int)
        [pixel].

    Raises
    ------
    ReplayError
        If there is no browser, or it does not show the page.
    """
    recorder = _RECORDER.replace("@TIMES@", str([float(time) for time in times]))
    bare = _BARE.replace("@WIDTH@", str(size[0])).replace("@HEIGHT@", str(size[1]))
    film = page.replace("</head>", f"{bare}</head>", 1)
    cut = film.rindex("</body>")
    with tempfile.TemporaryDirectory(prefix="mbocp-film-") as name:
        folder = Path(name)
        file = folder / "film.html"
        file.write_text(film[:cut] + recorder + film[cut:], encoding="utf-8", errors="replace")
        patience = 60.0 + _SECONDS_A_FRAME * len(times)
        done = browse(file.as_uri(), folder / "profile", "--dump-dom", size=size, timeout=patience)
    found = re.search(r'<script type="text/plain" id="pictures">([^<]*)</script>', done.stdout)
    pictures = [base64.b64decode(words) for words in found.group(1).split()] if found else []
    if len(pictures) != len(times):
        raise ReplayError(
            "film: the browser did not draw the replay; does it show the page of `mbocp replay`?"
        )
    return pictures


def write_frames(pictures: Sequence[bytes], folder: str | Path) -> Path:
    """Write pictures as 00000.png, 00001.png, ... into a folder, which is made.

    Raises
    ------
    ReplayError
        If the folder cannot be made, or has such pictures of another film.
    ResultFileError
        If a picture cannot be written.
    """
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
        if any(re.fullmatch(r"\d{5}\.png", path.name) for path in place.iterdir()):
            raise ReplayError(f"{place}: has pictures of a film; give another folder, or remove them")
        for k, picture in enumerate(pictures):
            replace_file(place / f"{k:05d}.png", picture)
    except OSError as error:
        raise ReplayError(f"{place}: {error}") from error
    return place


def write_movie(pictures: Sequence[bytes], path: str | Path, frames_per_second: float) -> Path:
    """Write pictures as a GIF, or by ffmpeg as MP4, by the suffix of `path`.

    Raises
    ------
    ReplayError
        If the suffix is neither, or there is no ffmpeg.
    ResultFileError
        If the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in MOVIES:
        raise ReplayError(f"{path}: a film ends in {' or '.join(MOVIES)}, got {suffix or 'no suffix'}")
    content = _gif(pictures, frames_per_second) if suffix == ".gif" else _mp4(pictures, frames_per_second)
    return replace_file(path, content)


def _gif(pictures: Sequence[bytes], frames_per_second: float) -> bytes:
    from PIL import Image  # wanted only here

    images = [Image.open(io.BytesIO(picture)).convert("RGB") for picture in pictures]
    shown = [images[0], images[len(images) // 2], images[-1]]
    width, height = images[0].size
    together = Image.new("RGB", (width, 3 * height))
    for k, image in enumerate(shown):
        together.paste(image, (0, k * height))
    palette = together.quantize(255)  # one for all: the background does not flicker
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    ends = [round(100 * (k + 1) / frames_per_second) for k in range(len(frames))]
    # GIF counts hundredths of a second, and viewers take less than two of them for ten.
    lasts = [10 * max(end - begin, 2) for begin, end in zip([0, *ends], ends, strict=False)]
    content = io.BytesIO()
    frames[0].save(
        content, "GIF", save_all=True, append_images=frames[1:], duration=lasts, loop=0, optimize=False
    )
    return content.getvalue()


def _mp4(pictures: Sequence[bytes], frames_per_second: float) -> bytes:
    program = shutil.which("ffmpeg")
    if program is None:
        raise ReplayError(
            "no ffmpeg on the PATH, which writes MP4: install it (Debian: apt install ffmpeg), or write .gif"
        )
    with tempfile.TemporaryDirectory(prefix="mbocp-film-") as name:
        folder = Path(name)
        for k, picture in enumerate(pictures):
            (folder / f"{k:05d}.png").write_bytes(picture)
        target = folder / "film.mp4"
        taken = ["-framerate", f"{frames_per_second:g}", "-i", str(folder / "%05d.png")]
        written = ["-pix_fmt", "yuv420p", "-movflags", "+faststart", str(target)]
        command = [program, "-loglevel", "error", *taken, *written]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ReplayError(f"{program} failed with status {done.returncode}: {done.stderr.strip()[-300:]}")
        return target.read_bytes()
