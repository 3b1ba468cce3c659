"""The end of the `mbocp` script: nothing is lost, and the exit status is the command's."""

from __future__ import annotations

import subprocess
import sys

import pytest

PLANTED = """
import atexit, sys, threading, time
import mbocp.cli

def planted():
    atexit.register(print, "registered", flush=False)
    def write():
        time.sleep(0.2)
        print("thread")
    threading.Thread(target=write).start()
    print("command")
    {end}

mbocp.cli.main = planted
mbocp.cli.script()
"""


def _run(end: str) -> subprocess.CompletedProcess[str]:
    code = PLANTED.format(end=end)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("end", "status"),
    [("pass", 0), ("sys.exit()", 0), ("sys.exit(0)", 0), ("sys.exit(2)", 2), ("sys.exit(141)", 141)],
)
def test_threads_and_handlers_end_before_the_process(end: str, status: int) -> None:
    done = _run(end)
    assert (done.returncode, done.stdout, done.stderr) == (status, "command\nthread\nregistered\n", "")


def test_the_interpreter_tells_messages_and_exceptions() -> None:
    done = _run("sys.exit('words')")
    assert (done.returncode, done.stderr) == (1, "words\n")
    done = _run("raise RuntimeError('no')")
    assert done.returncode == 1
    assert "RuntimeError: no" in done.stderr
    assert done.stdout == "command\nthread\nregistered\n"


def test_memory_is_not_freed_piece_by_piece() -> None:
    code = (
        "import sys, mbocp.cli\n"
        "class Witness:\n"
        "    def __del__(self): print('freed', flush=True)\n"
        "sys.witness = Witness()\n"
        "mbocp.cli.main = lambda: None\n"
        "mbocp.cli.script()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
