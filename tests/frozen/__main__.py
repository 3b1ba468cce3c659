"""Record what problems come to now: `python -m tests.frozen [NAME ...]`, all of them without a name.

What comes to what was recorded but for round-off stays as it was.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from tests.frozen.fingerprints import RECORD, equals, fingerprint, make_problem, problem_names


def main() -> None:
    """Record anew, and say what has changed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of problem files, as arms/ur5_reach.toml")
    asked = parser.parse_args().names or problem_names()
    then: dict[str, Any] = json.loads(RECORD.read_text(encoding="utf-8"))
    now = {name: json.loads(json.dumps(fingerprint(make_problem(name)), default=list)) for name in asked}
    changed = [name for name, found in now.items() if not _is_as_before(found, then.get(name))]
    found = {**then, **{name: now[name] for name in changed}}
    RECORD.write_text(json.dumps({name: found[name] for name in problem_names()}, indent=1) + "\n", "utf-8")
    print(
        f"{len(changed)} of {len(asked)} problems recorded in {RECORD.name}: {', '.join(changed) or 'none'}"
    )


def _is_as_before(now: dict[str, Any], then: dict[str, Any] | None) -> bool:
    return (
        then is not None
        and now.keys() == then.keys()
        and all(equals(now[part], then[part], rtol=1e-9) for part in now)
    )


if __name__ == "__main__":
    main()
