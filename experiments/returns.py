"""How high do the returns get, and how often does a run fail?

The three scripts with their defaults, and PPO with the same options on ten tasks.
"""

import gymnasium as gym
import study
from study import Job, number, spread
from variants import A2C, PPO, REINFORCE

FIRST_SEED = 101
DEFAULTS = {REINFORCE: 20, A2C: 30, PPO: 20}  # seeds
TASKS = {"HalfCheetah-v5": 20, "Hopper-v5": 20, "Walker2d-v5": 20, "InvertedDoublePendulum-v5": 20,
         "Ant-v5": 10, "Humanoid-v5": 10, "InvertedPendulum-v5": 10, "Pusher-v5": 10,
         "Reacher-v5": 10, "Swimmer-v5": 10}
PANELS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Ant-v5", "Humanoid-v5", "Swimmer-v5"
STANDING = {"Ant-v5": 1000, "Hopper-v5": 1000, "Walker2d-v5": 1000, "Humanoid-v5": 5000}
SETTINGS = {  # of the guide
    "--env-id Swimmer-v5 --total-steps 1e6 --gamma 0.999 --gae-lambda 0.98 --rollout-steps 512 "
    "--first-std 1": 5,
    "--env-id Swimmer-v5 --total-steps 1e6 --gamma 0.9999": 5,
    "--env-id MountainCarContinuous-v0 --total-steps 1e5 --first-std 2": 5}


def of(task):
    return f"--env-id {task} --total-steps 1e6"


COUNTS = {**{(script, ""): count for script, count in DEFAULTS.items()},
          **{(PPO, of(task)): count for task, count in TASKS.items()},
          **{(PPO, options): count for options, count in SETTINGS.items()}}
JOBS = [Job(*plan, seed=FIRST_SEED + i) for plan, count in COUNTS.items() for i in range(count)]


def measure(job):
    """The default runs' agents play a hundred episodes, the others' ten, as in training."""
    row, weights = study.train(job)
    if not job.options:
        row["return"] = hundred_episodes(job, weights)
    return row


def hundred_episodes(job, weights, options=""):
    """The mean return of an agent, from starts that no training saw."""
    module, args = study.load(job._replace(options=options))
    envs = (module.make_env(args.env_id) if job.script == REINFORCE
            else module.make_envs(args, 100))
    space = [getattr(envs, f"single_{x}", getattr(envs, x)) for x in ("observation_space",
                                                                       "action_space")]
    agent = module.Agent(*space, args.hidden_size)
    agent.load_state_dict(weights)
    count = [100] if job.script == REINFORCE else []
    return module.evaluate(agent, envs, job.seed, *count)


def solved(task, returns):
    """How many reach Gymnasium's threshold, if the task has one."""
    goal = gym.spec(task).reward_threshold
    if goal is None:
        return "–"
    return f"{sum(returns >= goal)} of {len(returns)} ≥ {goal:,g}".replace("-", "−")


def default_line(script, runs):
    _, args = study.load(Job(script))
    return [f"`{script}`", args.env_id, f"{args.total_steps:,}", len(runs), spread(runs["return"]),
            number(runs["return"].min()), solved(args.env_id, runs["return"]),
            number(runs["seconds"].median())]


def task_line(task, runs):
    returns = runs["return"]
    digits = int(abs(returns.mean()) < 100)
    return [task, len(runs), spread(returns, digits),
            " to ".join(number(x, digits) for x in (returns.min(), returns.max())),
            solved(task, returns), number(runs["seconds"].median() / 60, 1)]


def setting_line(options, runs):
    script = runs["script"].iloc[0]
    return [f"`python {script} {options}`", spread(runs["return"]), number(runs["return"].min()),
            number(runs["seconds"].median() / 60, 1)]


def draw_tasks(of_task):
    picture, panels = study.figure(11, 8, 2, 3)
    for i, (axis, task) in enumerate(zip(panels, PANELS)):
        lines = study.curves(of_task[task])
        for _, seed in lines.groupby("seed"):
            axis.plot(seed["steps"] / 1e6, seed["return"], color="C0", lw=0.8, alpha=0.5)
        axis.plot(lines.groupby("steps")["return"].mean().rename(lambda x: x / 1e6), color="C0",
                  lw=4)
        goal = gym.spec(task).reward_threshold
        if goal and goal < 1.25 * lines["return"].max():
            axis.axhline(goal, color="black", ls=":", lw=2, label="Gymnasium's threshold")
        if task in STANDING:
            axis.axhline(STANDING[task], color="black", lw=1, label="staying upright to the end")
        axis.set(title=task.removesuffix("-v5"), xlabel="million steps" * (i > 2),
                 ylabel="return" * (i % 3 == 0))
    lines = {label: line for axis in panels for line, label in zip(
        *axis.get_legend_handles_labels())}
    picture.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=2)
    picture.suptitle("PPO on six tasks: every seed, and their mean")
    return picture


def draw(rows):
    runs = dict(list(rows.groupby(["script", "options"])))
    of_task = {task: runs[PPO, of(task)] for task in TASKS}
    tables = {
        "defaults": study.table(
            ["file", "task", "steps", "seeds", "mean ± std", "lowest", "solved", "seconds"],
            [default_line(script, runs[script, ""]) for script in DEFAULTS]),
        "tasks": study.table(
            ["task", "seeds", "mean ± std", "range", "at Gymnasium's threshold", "minutes"],
            [task_line(*x) for x in of_task.items()]),
        "settings": study.table(["command", "mean ± std", "lowest", "minutes"],
                                [setting_line(x, runs[PPO, x]) for x in SETTINGS
                                 if (PPO, x) in runs])}
    return tables, {"ppo_returns": draw_tasks(of_task)}


if __name__ == "__main__":
    study.main("returns", JOBS, measure)
