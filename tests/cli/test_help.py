"""What `--help` says, and completion in a shell."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys

import pytest

from mbocp.cli.app import COMMANDS, load_command
from mbocp.cli.command_examples import EXAMPLES

from .conftest import Run


def test_every_command_has_examples() -> None:
    assert set(EXAMPLES) == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_list_says_what_the_commands_say_first(name: str) -> None:
    assert load_command(name).help.partition("\n\n")[0] == COMMANDS[name][1]


@pytest.mark.parametrize("line", [line for lines in EXAMPLES.values() for line in lines])
def test_examples_are_commands_with_their_options(line: str) -> None:
    program, name, *words = shlex.split(line)
    assert program == "mbocp"
    assert line in EXAMPLES[name]
    with load_command(name).make_context(name, words, resilient_parsing=False) as context:
        assert context.params


@pytest.mark.parametrize("name", EXAMPLES)
def test_help_shows_the_examples_as_they_are(run: Run, name: str) -> None:
    shown = run(name, "--help").stdout
    for line in EXAMPLES[name]:
        assert re.search(rf"^ +{re.escape(line)}$", shown, re.MULTILINE)


def test_no_command_is_described_by_half_a_sentence(run: Run) -> None:
    listed = run("--help").stdout.partition("Commands:\n")[2]
    assert len(listed.splitlines()) >= len(EXAMPLES)
    assert all(line.endswith(".") and not line.endswith("...") for line in listed.splitlines() if line)


def test_a_shell_completes_commands() -> None:
    asked = {"_MBOCP_COMPLETE": "complete_bash", "COMP_WORDS": "mbocp re", "COMP_CWORD": "1"}
    script = "import sys; sys.argv[0] = 'mbocp'; from mbocp.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["replay", "report"]
