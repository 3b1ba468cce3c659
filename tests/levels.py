"""Levels of tests, by where they stand: what `make quick`, `make check` and `make test` run.

`slow` is a mark of single tests of any level, which `make test-all` alone runs.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[1]

# Folders and files, without `tests/`, `test_` and `.py`; the longest place that holds a file decides.
_PLACES = {
    # Functions by themselves, readers, checks: next to nothing is compiled or solved.
    "unit": """
        architecture bounds/enclosures clocks dataclass docs files levels lie linear meshes problem repository
        robot stubs switches text warn cli/help cli/keys cli/progress guesses/along guesses/given_way
        mechanics/duals programme/algebra identification/base identification/consistent identification/log
        solution/export solution/formats solution/recordings solution/solution
        solvers/filter solvers/registry study/expansion study/table symbolic/functions symbolic/versions
        terms/spline view/forces
    """,
    # Problems formulated and solved, each feature on a small robot; results, commands, files.
    "solve": """
        bounds damping explaining guesses holds mimic pairs phases robust solution stop strangers study
        cli/check cli/end cli/end_to_end cli/machine cli/solve cli/spheres formulation/features
        formulation/fewer_ends formulation/free_contacts formulation/memory formulation/moved_start
        formulation/operations formulation/sources formulation/found_numbers formulation/step_lengths
        formulation/steps formulation/turning problem/between_nodes problem/causes problem/clear_goal
        problem/default_cost problem/effort_rms problem/frame_goals problem/goal_sets
        problem/impulse_bounds problem/mesh_obstacles problem/moving_obstacles problem/compound_obstacles
        problem/scenes problem/pair_clearances problem/place_causes problem/file/gait problem/file/ground
        problem/via programme/c_files programme/keys programme/later receding/estimator receding/horizon
        receding/moving robot/large_robots robot/loops/undriven ros sensitivity menus cli/menu cli/excite
        solvers/equations solvers/homotopy solvers/limits solvers/time_limit solvers/units
        terms/acceleration terms/braking terms/constraint_force terms/contact terms/distances
        terms/effort_about_gravity terms/end_acceleration terms/energy identification terms/hulls terms/kept
        terms/acceleration_over_speed terms/frame_velocity terms/motor terms/whole_path view/replay
    """,
    # Motions and schemes beside mechanics and each other: all files that are not named elsewhere.
    "physics": """
        guesses/around phases/solved problem/approach problem/problem robot/loading/examples robot/elastic
        robot/loading/joined robot/loading/lock_numbers robot/loading/parts solution/later solution/travel
    """,
    # Damaged files, killed processes, full disks, spoilt functions.
    "hostile": """
        attack cli/signals programme/background programme/cache_faults solution/atomic solution/damage
        solvers/failures solvers/interruption solvers/tough study/dask study/kill view/replay_hostile
    """,
}

# Files that take longest; processes begin with them, so that none is left for the end.
_LONGEST = """
    programme/algebra frozen/frozen campaign/campaign identification/identify sensitivity/sensitivity
    identification/exciting attack/attack checker/checker integrators/partitioned
    integrators/orders_of_systems solvers/apart loops formulation/found_numbers control_values
    solvers/staggered terms/follow robust problem/between_nodes view/plots accuracy/refining
    formulation/phases view/layout formulation/payload_numbers notebooks
"""
LONGEST = _LONGEST.split()

LEVELS = {level: places.split() for level, places in _PLACES.items()}


@cache  # asked for each test of a file
def level_of(file: Path) -> str:
    """Return the level of a file of tests."""
    path = PurePosixPath(name_of(file))
    levels = {place: level for level, places in LEVELS.items() for place in places}
    return next((levels[str(place)] for place in (path, *path.parents) if str(place) in levels), "physics")


def name_of(file: Path) -> str:
    """Return how a file is called here."""
    return file.relative_to(ROOT).with_suffix("").as_posix().replace("tests/", "").replace("test_", "")
