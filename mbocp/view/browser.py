"""Chromium without a window: pictures of pages, and what their scripts make of them."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from mbocp.exceptions import ReplayError

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
