"""How high do the returns get, and how often does a run fail? Four hours on two cores."""

import compare
import gymnasium as gym
import numpy as np
import pages
import study
from compare import number
from study import Job
from variants import A2C, PPO, REINFORCE

PENDULUM = "InvertedDoublePendulum-v5"
TASKS = {f"{task}-v5": f"--env-id {task}-v5 --total-steps 1e6" for task in (
    "Ant", "HalfCheetah", "Hopper", "Humanoid", "InvertedDoublePendulum", "InvertedPendulum",
    "Pusher", "Reacher", "Swimmer", "Walker2d")}
PANELS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Ant-v5", "Humanoid-v5", "Swimmer-v5"
STANDING = {"Ant-v5": 1000, "Hopper-v5": 1000, "Walker2d-v5": 1000, "Humanoid-v5": 5000}
HUNDRED = "--num-evals 1 --eval-episodes 100"
SEEDS = {REINFORCE: range(101, 121), A2C: range(101, 131), PPO: range(101, 111)}
CURVES = [Job(PPO, options, seed=seed) for seed in SEEDS[PPO] for options in TASKS.values()]
JOBS = [*(Job(script, seed=seed) for seed in range(1, 6) for script in SEEDS),
        *(Job(script, HUNDRED, seed=seed) for script in SEEDS for seed in SEEDS[script]), *CURVES]


def measure(job):
    """All evaluations of what the figures show, else the last."""
    return study.train(job)[0] if job in CURVES else study.last_evaluation(job)


def at_threshold(task, rows):
    """How many of how many reach Gymnasium's threshold, if the task has one."""
    goal = gym.spec(task).reward_threshold
    if goal is None:
        return "no threshold"
    returned = study.final_rows(rows)["return"]
    return f"{sum(returned >= goal)} of {len(returned)} ≥ {goal:,g}".replace("-", "−")


def draw_tasks(of_task):
    picture, panels = pages.figure(11, 9, 2, 3)
    for axis, task, first in zip(panels, PANELS, 2 * (True, False, False)):
        runs = of_task[task].assign(millions=of_task[task]["steps"] / 1e6)
        pages.curves(runs, "millions", axis, label="evaluation: mean (thin: each seed)",
                     xlabel="million steps" * (axis is panels[4]), ylabel="return" * first)
        goal, title = gym.spec(task).reward_threshold, at_threshold(task, runs)
        if goal is not None and goal < 1.25 * runs["return"].max():
            axis.axhline(goal, color="black", ls=":", lw=1.5, label="Gymnasium's threshold")
        elif goal is not None:
            title += ", off scale"
        final = compare.spread(study.final_rows(runs)["return"])
        axis.set_title(f"{task[:-3]}: {final}\n{title}")
        sampled = runs.groupby("millions")["sampled"].mean()
        axis.plot(sampled, "C1-.", lw=3, label="in training: mean")
        if task in STANDING:
            axis.axhline(STANDING[task], color="black", lw=1,
                         label="staying upright to the end")
        axis.get_legend().remove()
    picture.legend(*panels[1].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    finals = {task: study.final_rows(of_task[task])["return"] for task in PANELS}
    cheetahs, *others = (sum(finals[task] >= (gym.spec(task).reward_threshold or np.inf))
                         for task in PANELS)
    standing = sum(finals["Humanoid-v5"] > STANDING["Humanoid-v5"])
    picture.suptitle(f"One set of options: {cheetahs} of 10 cheetahs pass Gymnasium's "
                     f"threshold,\n{sum(others) or 'no'} hoppers, ants or swimmers do; "
                     f"{standing} of 10 humanoids beat staying upright")
    pages.save(picture, "ppo_returns")


def task_line(task, rows):
    finals = study.final_rows(rows)
    returned, digits = finals["return"], int(abs(finals["return"].mean()) < 100)
    return [task, compare.spread(returned, digits), number(returned.min(), digits),
            at_threshold(task, rows), number(finals["seconds"].median() / 60, 1)]


def script_line(script, runs, typed, slower):
    """`typed` and `slower`: runs of the plain command, on an EPYC and on a slower Xeon."""
    _, args = study.load(Job(script))
    threshold = gym.spec(args.env_id).reward_threshold
    returned = runs["return"]
    here, elsewhere = (f"{x['seconds'].median():.0f} s" for x in (typed, slower))
    if typed["processor"].iloc[0] == slower["processor"].iloc[0]:
        here = "–"  # this script has not been measured on the faster one
    return [f"`{script}`", args.env_id, compare.spread(returned), number(returned.min()),
            f"{sum(returned >= threshold)} of {len(returned)} ≥ {threshold:,g}",
            f"{args.total_steps:,}: {here} ({elsewhere})"]


def draw(rows):
    elsewhere = study.read("other_machine")
    hundred, typed, slower = (x[x["options"] == options].groupby("script") for x, options in (
        (rows, HUNDRED), (rows, ""), (elsewhere, "")))
    of_task = {task: rows[rows["options"] == options] for task, options in TASKS.items()}
    draw_tasks(of_task)
    return {"three scripts": pages.table(
        ["file", "task", "mean ± std", "lowest", "solved", "steps: median time (Xeon)"],
        [script_line(x, *(runs.get_group(x) for runs in (hundred, typed, slower)))
         for x in SEEDS]),
        "ten tasks": pages.table(
            ["task", "mean ± std", "lowest", "at threshold", "median minutes"],
            [task_line(task, runs) for task, runs in of_task.items()])}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
