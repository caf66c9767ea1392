"""How high do the returns get, and how often does a run fail?

The three scripts with their defaults, PPO with the same options on ten tasks, the guide's settings.
"""

import gymnasium as gym
import numpy as np
import study
from study import Job, number, spread
from variants import A2C, PPO, REINFORCE

FIRST_SEED = 101
HUNDRED = "--eval-episodes 100 --num-evals 1"  # defaults train the same, but end with 100 episodes
DEFAULTS = {REINFORCE: 20, A2C: 30, PPO: 20}  # seeds
TASKS = {"HalfCheetah-v5": 20, "Hopper-v5": 20, "Walker2d-v5": 20, "InvertedDoublePendulum-v5": 20,
         "Ant-v5": 10, "Humanoid-v5": 10, "InvertedPendulum-v5": 10, "Pusher-v5": 10,
         "Reacher-v5": 10, "Swimmer-v5": 10}
STEPS = np.linspace(0, 1e6, 21)  # of the figures
PANELS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Ant-v5", "Humanoid-v5", "Swimmer-v5"
SETTINGS = (  # of the guide
    (PPO, "--env-id Swimmer-v5 --total-steps 1e6 --gamma 0.999 --gae-lambda 0.98 "
          "--rollout-steps 512 --first-std 1"),
    (PPO, "--env-id Swimmer-v5 --total-steps 1e6 --gamma 0.9999"),
    (PPO, "--env-id MountainCarContinuous-v0 --total-steps 1e5 --first-std 2"),
    (A2C, "--env-id CartPole-v1 --total-steps 3e5 --gamma 0.99"))


def of(task):
    return f"--env-id {task} --total-steps 1e6"


COUNTS = {(script, HUNDRED): count for script, count in DEFAULTS.items()}
COUNTS |= {(PPO, of(task)): count for task, count in TASKS.items()}
COUNTS |= dict.fromkeys(SETTINGS, 5)
JOBS = [Job(*plan, seed=FIRST_SEED + i) for plan, count in COUNTS.items() for i in range(count)]


def measure(job):
    return study.train(job)[0]


def summary(task, runs):
    """The cells of a line; how many reach Gymnasium's threshold."""
    returns, goal = runs["return"], gym.spec(task).reward_threshold
    digits = int(abs(returns.mean()) < 100)
    solved = "–"
    if goal is not None:
        solved = f"{sum(returns >= goal)} of {len(runs)} ≥ {goal:,g}".replace("-", "−")
    return [len(runs), spread(returns, digits), number(returns.min(), digits), solved]


def minutes(runs):
    return number(runs["seconds"].median() / 60, 1)


def draw_tasks(runs):
    lines = study.curves(runs, STEPS)
    grid = study.seeds_and_mean(lines, "task", col_order=PANELS, col_wrap=3, sharey=False)
    for task, axis in grid.axes_dict.items():
        goal = gym.spec(task).reward_threshold
        if goal and goal < 1.25 * axis.get_ylim()[1]:
            axis.axhline(goal, color="black", ls=":", lw=2)
    return grid


def draw(rows):
    runs = dict(list(rows.groupby(["script", "options"])))
    columns = ["seeds", "mean ± std", "lowest", "reach Gymnasium's threshold"]
    defaults, tasks, settings = [], [], []
    for script in DEFAULTS:
        args = study.load(Job(script))[1]
        defaults.append([f"`{script}`", args.env_id, f"{args.total_steps:,}",
                         *summary(args.env_id, runs[script, HUNDRED])])
    for task in TASKS:
        run = runs[PPO, of(task)]
        tasks.append([task, *summary(task, run), minutes(run)])
    for script, options in SETTINGS:
        run, task = runs[script, options], options.split()[1]
        settings.append([f"`python {script} {options}`", *summary(task, run), minutes(run)])
    tables = {"defaults": study.table(["file", "task", "steps", *columns], defaults),
              "tasks": study.table(["task", *columns, "minutes"], tasks),
              "settings": study.table(["command", *columns, "minutes"], settings)}
    rows = rows.assign(task=rows["options"].map({of(task): task for task in TASKS}))
    return tables, {"ppo_returns": draw_tasks(rows.dropna(subset="task"))}


if __name__ == "__main__":
    study.main("returns", JOBS, measure)
