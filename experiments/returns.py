"""How high do the returns get, and how often does a run fail? Four hours on two cores."""

import gymnasium as gym
import study
from study import A2C, PPO, REINFORCE, Job, number

PENDULUM = "InvertedDoublePendulum-v5"
TASKS = {f"{task}-v5": f"--env-id {task}-v5 --total-steps 1e6" for task in (
    "Ant", "HalfCheetah", "Hopper", "Humanoid", "InvertedDoublePendulum", "InvertedPendulum",
    "Pusher", "Reacher", "Swimmer", "Walker2d")}
PANELS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Ant-v5", "Humanoid-v5", PENDULUM
LEVELS = {"Ant-v5": ("Ant: standing still", 1000), PENDULUM: ("double pendulum: the most", 9360)}
HUNDRED = "--num-evals 1 --eval-episodes 100"
SEEDS = {REINFORCE: range(71, 81), A2C: range(71, 101), PPO: range(71, 81)}
CURVES = [Job(PPO, options, seed=seed) for seed in SEEDS[PPO] for options in TASKS.values()]
JOBS = [*(Job(script, seed=seed) for seed in range(1, 6) for script in SEEDS),
        *(Job(script, HUNDRED, seed=seed) for script in SEEDS for seed in SEEDS[script]), *CURVES]


def measure(job):
    """All evaluations of what the figures show, else the last."""
    rows, _ = study.train(job)
    return rows if job in CURVES else rows.tail(1)


def draw_tasks(rows, title):
    picture, panels = study.figure(11, 8, 2, 3)
    for axis, task in zip(panels, PANELS):
        runs = rows[rows["options"] == TASKS[task]].assign(millions=rows["steps"] / 1e6)
        study.curves(runs, "millions", axis, label="evaluation: each seed, their mean", xlabel="",
                     ylabel="", title=task.removesuffix("-v5").replace("Double", "\nDouble"))
        axis.plot(runs.groupby("millions")["sampled"].mean(), "C1-.", lw=3, label="training: mean")
        if task in LEVELS:
            words, level = LEVELS[task]
            axis.axhline(level, color="black", ls="--", lw=1.5, label=f"{words}, {level:,}")
        axis.get_legend().remove()
    legend = dict(pair[::-1] for axis in panels for pair in zip(*axis.get_legend_handles_labels()))
    picture.legend(legend.values(), legend, loc="outside lower center", ncols=2)
    picture.suptitle(f"{title}\n(return against million steps, ten seeds)")
    study.save(picture, "ppo_returns")


def task_line(task, runs):
    digits = 0 if runs["return"].abs().mean() > 100 else 1
    return [task, study.spread(runs["return"], digits), study.median(runs["return"], digits),
            number(runs["return"].min(), digits), study.spread(runs["sampled"], digits),
            number(runs["seconds"].median() / 60, 1)]


def script_line(script, runs):
    _, args = study.load(Job(script))
    threshold = gym.spec(args.env_id).reward_threshold
    return [f"`{script}`", args.env_id, study.spread(runs["return"]), number(runs["return"].min()),
            f"≥ {threshold:,g}: {study.proportion(runs['return'] >= threshold)}",
            f"{args.total_steps:,}, {number(runs['seconds'].median())} s"]


def falls(runs):
    """By part of a run: evaluations in which a double pendulum fell, and seeds."""
    for first, last in (0.1, 0.4), (0.4, 0.7), (0.7, 1.0):
        part = runs[runs["steps"].div(1e6).round(2).between(first, last, inclusive="right")]
        fell = part[part["return"] < gym.spec(PENDULUM).reward_threshold]
        yield [f"{first} to {last}", f"{len(fell)} of {len(part)}",
               f"{fell['seed'].nunique()} of {part['seed'].nunique()}"]


def draw(rows):
    finals = study.final_rows(rows)
    of_task = {task: finals[finals["options"] == options] for task, options in TASKS.items()}
    hundred = finals[finals["options"] == HUNDRED].groupby("script", sort=False)
    counts = [f"{sum(of_task[task]['return'] > goal)} of {len(of_task[task])} {what}"
              for task, goal, what in (("HalfCheetah-v5", 4800, "cheetahs run"),
                                       ("Humanoid-v5", 2000, "humanoids walk"))]
    draw_tasks(rows, f"One set of options: {', '.join(counts)}")
    return {
        "three scripts": study.table(
            ["file", "task", "mean ± std", "lowest", "solved (95% interval)", "steps, time"],
            [script_line(script, hundred.get_group(script)) for script in SEEDS]),
        "ten tasks": study.table(
            ["task", "mean ± std", "median (95%)", "lowest", "in training", "minutes"],
            [task_line(task, runs) for task, runs in of_task.items()]),
        "falls": study.table(["million steps", "evaluations with a fall", "seeds"],
                             falls(rows[rows["options"] == TASKS[PENDULUM]]))}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
