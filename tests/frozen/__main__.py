"""Record what all problems come to now: `python -m tests.frozen`."""

from __future__ import annotations

import json

from tests.frozen.fingerprints import RECORD, fingerprint, make_problem, problem_names

found = {name: fingerprint(make_problem(name)) for name in problem_names()}
RECORD.write_text(json.dumps(found, indent=1, default=list) + "\n", encoding="utf-8")
print(f"{len(found)} problems recorded in {RECORD.name}")
