"""Ours against stable-baselines3 and CleanRL: returns against steps and against minutes.

Ours are the runs of `returns`. Minutes are steps divided by the steps a second that `speed` has
measured; in training by those of the runs themselves, on CleanRL's processor. Five hours on two
cores. CleanRL, which logs returns in training, is measured if CLEANRL is the path of its file.
"""

import pandas as pd
import peers
import returns
import study
from study import Job, number

TASKS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5"
LEARNERS = {  # the change of its rows, a column, colour, dashes
    "ours": ("ours", "return", "C0", "-"),
    "sb3, defaults": ("defaults", "return", "C1", "--"),
    "sb3, zoo": ("zoo", "return", "C2", ":"),
    "sb3, our sizes": ("our sizes", "return", "C4", "-."),
    "ours, in training": ("ours", "sampled", "C0", ":"),
    "CleanRL, in training": ("CleanRL", "sampled", "C3", "--")}
BROKEN = "Hopper-v5", "sb3, zoo"  # all seeds stop near 1,000: not what the zoo publishes
JOBS = [*(Job(peers.FILE, returns.TASKS[task], setting, seed) for task in TASKS
          for setting in ("defaults", "zoo", "our sizes") for seed in range(1, 6)),
        *(Job(peers.FILE, returns.TASKS[task], "CleanRL", seed)
          for seed in range(101, 106) for task in TASKS)]


def curves_of(task, rows):
    """Of each learner and seed: the mean of its evaluations, of 50,000 steps at a time."""
    runs = rows[(rows["options"] == returns.TASKS[task]) & (rows["steps"] > 25_000)]
    runs = runs.assign(steps=(runs["steps"] / 50_000).round() / 20)
    curves = {}
    for learner, (change, column, *_) in LEARNERS.items():
        seeds = runs[runs["change"] == change].groupby(["seed", "steps"])
        curves[learner] = seeds[column].mean().rename("return").reset_index()
    return curves


def speeds_of(task, rows):
    """Steps a second of each learner."""
    alone = study.read("speed").groupby(["options", "learner"])["speed"].median()
    ends = study.final_rows(rows[rows["options"] == returns.TASKS[task]])
    machine = ends.loc[ends["change"] == "CleanRL", "processor"]
    ends = ends[ends["processor"].isin(machine)]
    own = ends.eval("steps / seconds").groupby(ends["change"]).median()
    return {learner: own[change] if "training" in learner
            else alone[f"--env-id {task} --total-steps 32768", change]
            for learner, (change, *_) in LEARNERS.items()}


def draw_task(by_steps, by_minutes, task, curves, speeds):
    """Against steps with every seed, against minutes the means alone."""
    for learner, curve in curves.items():
        *_, color, dashes = LEARNERS[learner]
        broken = (task, learner) == BROKEN
        style = {"color": "grey" if broken else color, "ls": dashes, "lw": 3}
        study.curves(curve, "steps", by_steps, color=style["color"], title=task,
                     label=learner.removeprefix("sb3, ") + ",\nset aside" * broken,
                     xlabel="million steps", xticks=[0, 0.5, 1])
        by_steps.lines[-1].set(**style)
        mean = curve.groupby("steps")["return"].mean()
        by_minutes.plot(1e6 * mean.index / speeds[learner] / 60, mean, **style)
    study.name_ends(by_steps)
    by_minutes.set(xscale="log", xlabel="minutes (log scale)", ylabel="return")
    by_minutes.xaxis.set_major_formatter("{x:g}")


def lines_of(task, curves):
    """Of the table, from the last points of the curves; at the end of a line: what ours gain."""
    for learner, curve in curves.items():
        last = curve.loc[curve["steps"] == curve["steps"].max(), "return"]
        if learner.startswith("ours"):
            ours = last
        broken = (task, learner) == BROKEN
        yield [task, f"{learner}{', set aside' * broken} ({len(last)})", study.spread(last),
               number(last.median()), "" if ours is last or broken else study.welch(ours, last)]


def draw(rows):
    rows = pd.concat([study.read("returns").replace({"change": {"": "ours"}}), rows])
    picture, panels = study.figure(13, 9, 2, len(TASKS), sharey="col")
    lines = []
    for i, task in enumerate(TASKS):
        curves = curves_of(task, rows)
        lines += lines_of(task, curves)
        draw_task(*panels[i :: len(TASKS)], task, curves, speeds_of(task, rows))
    found = [[*line, end] for line, end in zip(lines, study.verdicts([x[-1] for x in lines]))]
    leads = [f"{line[1][:-4]} ({line[0][:-3]})" for line in found if "above" in line[-1]]
    picture.suptitle(f"Significantly below ours: {'; '.join(leads)}\n(no others; sb3: "
                     "stable-baselines3; thin: seeds, bold: means)", wrap=True)
    study.save(picture, "ppo_race")
    return {"race": study.table(["task", "learner (seeds)", "mean ± std", "median",
                                 "ours − theirs, 95%", "verdict"], found)}


if __name__ == "__main__":
    study.main([job for job in JOBS if peers.CLEANRL or job.change != "CleanRL"], draw, peers.learn)
