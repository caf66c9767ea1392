"""Ours against stable-baselines3 and CleanRL: returns against steps and against minutes.

Ours are the runs of `returns`. CleanRL logs returns in training; it is compared by these, and
without noise. It is measured if CLEANRL is the path of its file. Nine hours on two cores.
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
WORDS = {"return": "without noise", "sampled": "in training"}
RACES = {  # tasks; what is compared; learners: the change of their rows, colour, dashes
    "race": (TASKS[:3], ["return"], {
        "ours": ("ours", "C0", "-"), "sb3, defaults": ("defaults", "C1", "--"),
        "sb3, zoo": ("zoo", "C2", ":"), "sb3, our sizes": ("our sizes", "C4", "-.")}),
    "cleanrl": (TASKS, ["return", "sampled"], {
        "ours": ("ours", "C0", "-"), "CleanRL": ("CleanRL", "C3", "--")})}
LEFT_OUT = returns.TASKS["Hopper-v5"], "zoo"  # all stop near 1,000: not what the zoo publishes
BEST = {"HalfCheetah-v5": "zoo", "Hopper-v5": "defaults", "Walker2d-v5": "our sizes"}  # ten seeds
JOBS = [*(Job(peers.FILE, returns.TASKS[task], setting, seed) for task in BEST
          for setting in ("defaults", "zoo", "our sizes")
          for seed in range(1, 11 if setting == BEST[task] else 6)),
        *(Job(peers.FILE, returns.TASKS[task], "CleanRL", seed)
          for seed in range(101, 111) for task in TASKS)]


def curves_of(learners, task, column, rows):
    """Of each learner and seed: the mean of its evaluations, of 50,000 steps at a time."""
    runs = rows[(rows["options"] == returns.TASKS[task]) & (rows["steps"] > 25_000)]
    runs = runs.assign(steps=(runs["steps"] / 50_000).round() / 20).dropna(subset=column)
    curves = {}
    for learner, (change, *_) in learners.items():
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


def draw_steps(axis, curves, learners, **labels):
    """Means against steps; at the end a dot for each seed."""
    for i, (learner, curve) in enumerate(curves.items(), start=1):
        _, color, dashes = learners[learner]
        mean = curve.groupby("steps")["return"].mean()
        finals = curve.loc[curve["steps"] == 1, "return"]
        axis.plot(mean, color=color, ls=dashes, lw=3, label=f"{learner} ({len(finals)})")
        axis.plot(np.full(len(finals), 1 + 0.04 * i), finals, "o", color=color, ms=5, alpha=0.6)
    axis.set(xlabel="million steps", xticks=[0, 0.5, 1], **labels)
    pages.name_ends(axis, x=1.06 + 0.04 * i)


def draw_minutes(axis, curves, learners, task):
    """Means against minutes."""
    speeds = speeds_of(task)
    for learner, curve in curves.items():
        change, color, dashes = learners[learner]
        mean = curve.groupby("steps")["return"].mean()
        axis.plot(1e6 * mean.index / speeds[change] / 60, mean, color=color, ls=dashes, lw=3)
    axis.set(xscale="log", xlabel="minutes (log scale)")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.minorticks_off()


def lines_of(task, word, curves):
    """Of the table, one for each peer, from the last points of the curves; at its end the gain."""
    finals = {learner: curve.loc[curve["steps"] == 1, "return"]
              for learner, curve in curves.items()}
    ours = finals.pop("ours")
    for peer, theirs in finals.items():
        yield [task[:-3], f"{peer}{word} ({len(theirs)})",
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


def draw_race(name, rows):
    """Returns its table."""
    (tasks, columns, learners), lines = RACES[name], []
    height = len(columns) + 1
    picture, panels = pages.figure(4.5 * len(tasks), 4.2 * height, height, len(tasks), sharey="col")
    panels = panels.reshape(height, -1)
    for i, task in enumerate(tasks):
        for axis, column in zip(panels[:, i], columns):
            curves = curves_of(learners, task, column, rows)
            draw_steps(axis, curves, learners, title=task)
            word = f" {WORDS[column]}" if len(columns) > 1 else ""
            lines += lines_of(task, word, curves)
        draw_minutes(panels[-1, i], curves_of(learners, task, columns[0], rows), learners, task)
    for axis, column in zip(panels[:, 0], [*columns, columns[0]]):
        axis.set_ylabel(f"return {WORDS[column]}")
    verdicts = list(compare.verdicts([gain for *_, gain in lines]))
    title = title_of(lines, verdicts) or "No difference"
    picture.suptitle(f"{title}\n(significant; the rest may be chance; dots: seeds)", wrap=True)
    pages.save(picture, f"ppo_{name}")
    return pages.table(
        ["task", "peer (seeds)", "peer's return (median)", "ours (seeds)", "ours − peer's, 95%",
         "verdict"],
        [[*line, end] for line, end in zip(lines, verdicts)])


def draw(rows):
    rows = rows[rows[["options", "change"]].apply(tuple, axis=1) != LEFT_OUT]
    rows = pd.concat([study.read("returns").replace({"change": {"": "ours"}}), rows])
    return {name: draw_race(name, rows) for name in RACES}


if __name__ == "__main__":
    study.main([job for job in JOBS if peers.CLEANRL or job.change != "CleanRL"], draw, peers.learn)
