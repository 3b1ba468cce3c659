"""`mbocp schema`: what editors know of problem files."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from mbocp.cli.solve import check_output

SCHEMA_FILE = "mbocp.schema.json"  # the name by which problem files beside it know it


def write_schema(output: Path | None) -> None:
    """Write the JSON schema of problem files, to the screen where no file is given.

    Raises
    ------
    MbocpError
        If the file is none that can be written.
    """
    from mbocp.problem.file.schema import problem_schema

    text = json.dumps(problem_schema(), indent=1)
    if output is None:
        typer.echo(text)
    else:
        check_output(output, "-o", (".json",))
        output.write_text(f"{text}\n", encoding="utf-8")
