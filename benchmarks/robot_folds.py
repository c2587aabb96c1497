"""Plans all folds of all shipped garments for one robot: which of them its arms can make.

    python -m benchmarks.robot_folds ROBOT [--poses 8]

The folds have the optimiser's plain arcs and the garments lie at poses drawn from their ranges, as in the
benchmark `motion`. No world is simulated. The exit code is 0 if every fold has a plan, else 2.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from benchmarks.motion.workload import tasks
from foldcell.cell.commands.shared import table
from foldcell.cell.config.cell_settings import load_settings
from foldcell.robots.registry import find_robot
from foldcell.skills.motion.moves.fold import plan_hands_motion
from foldcell.skills.motion.validation.collision import CollisionChecker


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robot_folds", description=__doc__)
    parser.add_argument("robot", metavar="ROBOT", help="a robot of `foldcell robot list`")
    parser.add_argument("--poses", type=int, default=8, metavar="N", help="poses of each garment (8)")
    options = parser.parse_args()
    settings, model = load_settings(), find_robot(options.robot).load_model()
    checker = CollisionChecker(model, settings.table)
    limits = model.limits(settings.motion.accelerations, settings.motion.velocity_scale)
    folds: Counter[str] = Counter()
    planned: Counter[str] = Counter()
    failures: Counter[tuple[str, str]] = Counter()
    for task in tasks(options.poses, settings.surface):
        outcome = plan_hands_motion(
            model, checker, settings.table, task.paths, model.q_park, limits=limits,
            tool_speed=min(task.garment.max_tool_speed, settings.motion.tool_speed),
            approach_height=settings.motion.approach_height, rng=np.random.default_rng(1),
        )  # fmt: skip
        folds[task.garment.name] += 1
        planned[task.garment.name] += outcome.ok
        if outcome.failure is not None:
            failures[task.garment.name, outcome.failure.what] += 1
    print(
        *table(("garment", "folds", "planned"), [(name, n, planned[name]) for name, n in folds.items()]), sep="\n"
    )
    for (name, what), count in failures.most_common():
        print(f"{count} of {name}: {what}")
    print(f"{planned.total()} of {folds.total()} folds have a plan")
    return 0 if planned == folds else 2


if __name__ == "__main__":
    raise SystemExit(main())
