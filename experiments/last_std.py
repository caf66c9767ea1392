"""What did it change that PPO's σ falls to 0.2, no longer to 0.1? Rows of the older default.

Those with 0.2 are of `returns`. Five hours on two cores.
"""

import compare
import pages
import pandas as pd
import study
from returns import PENDULUM, TASKS
from study import PPO, Job

ALL_STAND = 9300  # the least mean of ten double pendulums of which none falls
BEFORE = {task: f"{TASKS[task]} --last-std 0.1" for task in (
    "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Ant-v5", "Humanoid-v5", PENDULUM)}
JOBS = [Job(PPO, options, seed=seed) for seed in range(71, 81) for options in BEFORE.values()]


def measure(job):
    """All evaluations of the double pendulum, else the last."""
    return study.train(job)[0] if PENDULUM in job.options else study.last_evaluation(job)


def before_and_after(rows):
    """Of a table: the last returns with 0.1, with 0.2, and their difference."""
    finals = study.final_rows(rows).set_index("options")["return"]
    pairs = [(finals[TASKS[task]], finals[BEFORE[task]]) for task in BEFORE]
    gains = [compare.welch(*pair) for pair in pairs]
    p_values = compare.marked([gain.p for gain in gains])
    for task, (after, before), gain, p in zip(BEFORE, pairs, gains, p_values):
        yield [task, compare.spread(before), compare.spread(after), str(gain), p]


def falls(rows):
    """By part of a run: evaluations in which a double pendulum fell, and of how many seeds."""
    for first, last in (0.1, 0.4), (0.4, 0.7), (0.7, 1.0):
        part = rows[rows["steps"].div(1e6).round(2).between(first, last, inclusive="right")]
        line = [f"{first} to {last}"]
        for options in BEFORE[PENDULUM], TASKS[PENDULUM]:
            runs = part[part["options"] == options]
            fell = runs[runs["return"] < ALL_STAND]
            line.append(f"{len(fell)} of {len(runs)}, {fell['seed'].nunique()} seeds")
        yield line


def draw(rows):
    rows = pd.concat([rows, study.read("returns")])
    return {"before and after": pages.table(
                ["task", "`--last-std 0.1`", "0.2", "difference, 95%", "p"],
                before_and_after(rows)),
            "falls": pages.table(
                ["million steps", "a fall, with `--last-std 0.1`", "with 0.2"], falls(rows))}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
