"""Ours against stable-baselines3 and CleanRL: returns against steps and against minutes.

Ours are the runs of `returns`. CleanRL logs its returns in training, so these are compared; it is
measured if CLEANRL is the path of its file. Five hours on two cores.
"""

import compare
import numpy as np
import pages
import pandas as pd
import peers
import returns
import study
from study import Job

TASKS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", returns.PENDULUM
RACES = {  # learner: the change of its rows, a column, colour, dashes
    "race": {"ours": ("ours", "return", "C0", "-"),
             "sb3, defaults": ("defaults", "return", "C1", "--"),
             "sb3, zoo": ("zoo", "return", "C2", ":"),
             "sb3, our sizes": ("our sizes", "return", "C4", "-.")},
    "cleanrl": {"ours": ("ours", "sampled", "C0", "-"),
                "CleanRL": ("CleanRL", "sampled", "C3", "--")}}
LEFT_OUT = returns.TASKS["Hopper-v5"], "zoo"  # all stop near 1,000: not what the zoo publishes
SHOWN = {"race": TASKS[:3], "cleanrl": TASKS}
BEST = {"HalfCheetah-v5": "zoo", "Hopper-v5": "defaults", "Walker2d-v5": "our sizes"}  # ten seeds
JOBS = [*(Job(peers.FILE, returns.TASKS[task], setting, seed) for task in BEST
          for setting in ("defaults", "zoo", "our sizes")
          for seed in range(1, 11 if setting == BEST[task] else 6)),
        *(Job(peers.FILE, returns.TASKS[task], "CleanRL", seed)
          for seed in range(101, 111) for task in TASKS)]


def curves_of(learners, task, rows):
    """Of each learner and seed: the mean of its evaluations, of 50,000 steps at a time."""
    runs = rows[(rows["options"] == returns.TASKS[task]) & (rows["steps"] > 25_000)]
    runs = runs.assign(steps=(runs["steps"] / 50_000).round() / 20)
    curves = {}
    for learner, (change, column, *_) in learners.items():
        seeds = runs[runs["change"] == change].groupby(["seed", "steps"])
        curves[learner] = seeds[column].mean().rename("return").reset_index()
    return {learner: curve for learner, curve in curves.items() if len(curve)}


def speeds_of(task):
    """Steps a second of each learner; CleanRL's by its ratio to ours, as it ran on another day."""
    speeds = study.read("speed")
    speeds = speeds[speeds["options"] == f"--env-id {task} --total-steps 32768"]
    beside, usual = (speeds[speeds["change"] == change].groupby("learner")["speed"].median()
                     for change in ("CleanRL", ""))
    ours = usual.get("ours", beside.get("ours"))
    ratio = beside.get("CleanRL", np.nan) / beside.get("ours", np.nan)
    return {**usual, "ours": ours, "CleanRL": ours * ratio}


def draw_task(by_steps, by_minutes, learners, task, curves):
    """Against steps with every seed, against minutes the means alone."""
    speeds = speeds_of(task)
    for learner, curve in curves.items():
        change, column, color, dashes = learners[learner]
        style = {"color": color, "ls": dashes, "lw": 3}
        pages.curves(curve, "steps", by_steps, color=color, title=task, label=learner,
                     xlabel="million steps", xticks=[0, 0.5, 1])
        by_steps.lines[-1].set(**style)
        mean = curve.groupby("steps")["return"].mean()
        by_minutes.plot(1e6 * mean.index / speeds[change] / 60, mean, **style)
    pages.name_ends(by_steps)
    ylabel = {"return": "return", "sampled": "return in training"}[column]
    by_steps.set_ylabel(ylabel)
    by_minutes.set(xscale="log", xlabel="minutes (log scale)", ylabel=ylabel)
    by_minutes.xaxis.set_major_formatter("{x:g}")
    by_minutes.minorticks_off()


def lines_of(task, curves):
    """Of the table, one for each peer, from the last points of the curves; at its end the gain."""
    finals = {learner: curve.loc[curve["steps"] == curve["steps"].max(), "return"]
              for learner, curve in curves.items()}
    ours = finals.pop("ours")
    for peer, theirs in finals.items():
        yield [task[:-3], f"{peer} ({len(theirs)})",
               f"{compare.spread(theirs)} ({compare.number(theirs.median())})",
               f"{compare.spread(ours)} ({len(ours)})", compare.welch(ours, theirs)]


def title_of(lines, verdicts):
    """On which task ours are significantly above whom, or below."""
    leads = {}
    for (task, peer, *_), verdict in zip(lines, verdicts):
        if "ours" in verdict:
            side = "above" if "above" in verdict else "below"
            leads.setdefault(f"{task}: ours {side}", []).append(peer.rsplit(" (")[0])
    return "; ".join(f"{side} {' and '.join(peers)}" for side, peers in leads.items())


def draw_race(name, learners, rows):
    """Returns its table."""
    tasks, lines = SHOWN[name], []
    picture, panels = pages.figure(4.3 * len(tasks), 9, 2, len(tasks), sharey="col")
    for i, task in enumerate(tasks):
        curves = curves_of(learners, task, rows)
        draw_task(*panels[i :: len(tasks)], learners, task, curves)
        lines += lines_of(task, curves)
    verdicts = list(compare.verdicts([gain for *_, gain in lines]))
    title = title_of(lines, verdicts) or "No difference"
    picture.suptitle(f"{title} (significant; the rest may be chance)", wrap=True)
    pages.save(picture, f"ppo_{name}")
    return pages.table(
        ["task", "theirs (seeds)", "their return (median)", "ours (seeds)", "ours − theirs, 95%",
         "verdict"], [[*line, end] for line, end in zip(lines, verdicts)])


def draw(rows):
    rows = rows[rows[["options", "change"]].apply(tuple, axis=1) != LEFT_OUT]
    rows = pd.concat([study.read("returns").replace({"change": {"": "ours"}}), rows])
    return {name: draw_race(name, learners, rows) for name, learners in RACES.items()}


if __name__ == "__main__":
    study.main([job for job in JOBS if peers.CLEANRL or job.change != "CleanRL"], draw, peers.learn)
