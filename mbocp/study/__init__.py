"""Many problems at once: a grid, a random sample or a list of changes to one problem, on an executor.

from mbocp.study import Study, run_study

result = run_study(Study.load("reach.toml"), "reach.jsonl")
result.column("cost")
"""

from mbocp.study.result import StudyResult
from mbocp.study.run import StudyWarning, run_study
from mbocp.study.study import Study, Task
from mbocp.study.summary import Spread, Summary, TaskGroup

__all__ = ["Spread", "Study", "StudyResult", "StudyWarning", "Summary", "Task", "TaskGroup", "run_study"]
