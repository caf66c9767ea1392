"""What did it change that PPO's σ falls to 0.2, no longer to 0.1? Rows of the older default.

Those with 0.2 are of `returns`. Five hours on two cores.
"""

import compare
import pages
import study
from returns import PENDULUM, TASKS
from study import Job
from variants import PPO

ALL_STAND = 9300  # the least mean of ten double pendulums of which none falls
BEFORE = {task: f"{TASKS[task]} --last-std 0.1" for task in (
    "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Ant-v5", "Humanoid-v5", PENDULUM)}
JOBS = [Job(PPO, options, seed=seed) for seed in range(71, 81) for options in BEFORE.values()]


def measure(job):
    """All evaluations of the double pendulum, else the last."""
    return study.train(job)[0] if PENDULUM in job.options else study.last_evaluation(job)


def before_and_after(rows, rows_today):
    """Of a table: the last returns with 0.1, with 0.2, and their difference."""
    before, after = (study.final_rows(x).set_index("options")["return"] for x in (rows, rows_today))
    pairs = {task: (after[TASKS[task]], before[BEFORE[task]]) for task in BEFORE}
    gains = [compare.welch(*pair) for pair in pairs.values()]
    p_values = compare.marked([gain.p for gain in gains])
    for (task, (today, then)), gain, p in zip(pairs.items(), gains, p_values):
        yield [task, compare.spread(then), compare.spread(today), str(gain), p]


def falls(rows, rows_today):
    """By part of a run: evaluations in which a double pendulum fell, and of how many seeds."""
    pendulums = [rows[rows["options"] == BEFORE[PENDULUM]],
                 rows_today[rows_today["options"] == TASKS[PENDULUM]]]
    for first, last in (0.1, 0.4), (0.4, 0.7), (0.7, 1.0):
        line = [f"{first} to {last}"]
        for runs in pendulums:
            millions = runs["steps"].div(1e6).round(2)
            part = runs[millions.between(first, last, inclusive="right")]
            fell = part[part["return"] < ALL_STAND]
            line.append(f"{len(fell)} of {len(part)}, {fell['seed'].nunique()} seeds")
        yield line


def draw(rows):
    both = rows, study.read("returns")
    return {"before and after": pages.table(
                ["task", "`--last-std 0.1`", "0.2", "difference, 95%", "p"],
                before_and_after(*both)),
            "falls": pages.table(
                ["million steps", "a fall, with `--last-std 0.1`", "with 0.2"], falls(*both))}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
