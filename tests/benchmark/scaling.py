"""Steps per second against the number of environments, in one process and in a process each."""

import pandas as pd
import seaborn as sns
from benchmark import common
from benchmark.common import A2C, Job
from benchmark.speed import our_speed, random_speed

FIGURES = ("scaling",)
ALONE = True  # nothing else may run beside a measurement of speed
COUNTS = 1, 2, 4, 8, 16, 32
KINDS = {"sync": "one process", "async": "a process each"}


def jobs(quick):
    steps, repeats = (128, 1) if quick else (20_480, 3)
    return [
        Job(A2C, seed, f"--num-envs {count} --vectorization {kind} --rollout-steps "
                       f"{max(1, (64 if quick else 512) // count)} --total-steps {steps}")
        for seed in range(1, repeats + 1)  # in turns: a busy machine slows all alike
        for count in (COUNTS[:2] if quick else COUNTS) for kind in KINDS]


def measure(job):
    return common.fresh(speeds, job)


def speeds(job):
    args = common.load(A2C).parse_args(job.flags.split())
    rows = {"stepping": random_speed(job), "training": our_speed(job)}
    return pd.DataFrame({"env_id": args.env_id, "environments": args.num_envs,
                         "vectorization": args.vectorization, "measure": rows.keys(),
                         "speed": rows.values()})


def report(data, draw):
    median = data.groupby(["measure", "vectorization", "environments"])["speed"].median()
    counts = sorted(data["environments"].unique())
    table = common.table(
        ["steps per second", "environments in", *counts],
        [[name, KINDS[kind], *(f"{x:,.0f}" for x in median[name, kind])]
         for name in ("stepping", "training") for kind in KINDS])
    shown = median.reset_index().replace({"vectorization": KINDS})
    grid = sns.relplot(shown, x="environments", y="speed", hue="vectorization", kind="line",
                       style="vectorization", markers=True, col="measure", height=3.2, aspect=1.3)
    grid.set_titles("{col_name}").set_axis_labels("environments", "steps per second")
    grid.legend.set_title("")
    for axis in grid.axes.flat:
        axis.set_xscale("log", base=2)
        axis.set_xticks(counts, counts)
        axis.set_ylim(0)
    draw(grid, "scaling")
    return {"speeds": table}
