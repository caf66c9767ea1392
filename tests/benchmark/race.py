"""Return against minutes: ours, and stable-baselines3 with its defaults and its zoo's settings."""

import math
import time

import pandas as pd
import seaborn as sns
from benchmark import common, peers
from benchmark.common import A2C, PPO, Job, number

FIGURES = "ppo_race", "a2c_race"
STEPS = 1_000_000
TASKS = {PPO: ["HalfCheetah-v5", "Hopper-v5", "Walker2d-v5"], A2C: ["LunarLander-v3"]}
OURS = "ours"
LEARNERS = OURS, "stable-baselines3, defaults", "stable-baselines3, its zoo's settings"
STYLES = "-", "-", ":"  # in grey two of the colours are alike


def jobs(quick):
    size = "--total-steps 2048 --num-evals 1" if quick else f"--total-steps {STEPS} --num-evals 50"
    return [Job(script, seed, f"--env-id {env_id} {size}", part=learner)
            for script, env_ids in TASKS.items() for env_id in env_ids[:1 if quick else None]
            for seed in ([1] if quick else [1, 2, 3, 4, 5]) for learner in LEARNERS]


class Track:
    """Evaluations of one training at even steps, against its seconds; their own do not count."""

    def __init__(self, script, args, seed):
        self.script, self.seed, self.pause = script, seed, args.total_steps / args.num_evals
        self.envs = script.make_envs(args.env_id, 5, "NextStep")
        self.seconds, self.start, self.rows = 0.0, time.perf_counter(), []

    def visit(self, env_step, agent, last=False):
        if env_step >= len(self.rows) * self.pause or last:
            self.seconds += time.perf_counter() - self.start
            result = self.script.evaluate(agent, self.envs, self.seed)
            self.rows.append({"env_step": env_step, "seconds": self.seconds,
                              "return_mean": result["return_mean"]})
            self.start = time.perf_counter()


def measure(job):
    return common.fresh(race, job)


def race(job):
    script = common.load(job.script)
    args = script.parse_args(job.flags.split())
    if job.part == OURS:
        _, agent, updates = common.begin(job.script, args, job.seed)
        track = Track(script, args, job.seed)
        for env_step, *_ in updates:
            track.visit(env_step, agent)
    else:  # A2C's environments take the peer's actions as they are
        track = Track(common.load(A2C), args, job.seed)
        peers.learn(job.script, args, job.seed, "zoo" in job.part, track.visit)
    return pd.DataFrame(track.rows).assign(env_id=args.env_id)


def report(data, draw):
    tables = dict.fromkeys(("ppo", "a2c"), "Not measured yet with the current files.")
    runs = data.groupby("env_id")[["seed", "part"]].value_counts().groupby("env_id").size()
    data = data[data["env_id"].map(runs) == runs.max()]  # the rest is on its way
    for script, name in (PPO, "ppo"), (A2C, "a2c"):
        x = data[data["script"] == script].assign(minutes=lambda x: x["seconds"] / 60)
        if len(x):
            tables[name] = common.table(
                ["task", "learner", "final return, each seed", "minutes, median",
                 "minutes to the goal: its mean", "our mean", "each seed of ours",
                 "ratio of the means"], rows(x))
            draw(picture(x, script), f"{name}_race")
    return tables


def rows(data):
    """For each learner: final returns, minutes, and how soon it and ours reach their mean.

    That mean is the goal. Both have reached it when the mean of their seeds first has.
    """
    found = []
    for env_id, runs in data.groupby("env_id", sort=False):
        ours = runs[runs["part"] == OURS]
        for learner in LEARNERS:
            x = runs[runs["part"] == learner]
            last = x.groupby("seed")[["minutes", "return_mean"]].last()
            goal = mean_course(x)["return_mean"].iloc[-1]
            times = [first_time(mean_course(x), goal), first_time(mean_course(ours), goal)]
            seeds = [first_time(y, goal) for _, y in ours.groupby("seed")]
            ratio = times[0] / times[1]
            rest = ["", "", "", ""]
            if learner != OURS:
                rest = [*(clock(y) for y in times), ", ".join(clock(y) for y in seeds),
                        f"{ratio:.1f}" if ratio > 0 else "–"]
            found.append([env_id, learner, ", ".join(number(y, 0) for y in last["return_mean"]),
                          number(last["minutes"].median()), *rest])
    return found


def mean_course(runs):
    """Of all seeds; something else may have run beside one of them, hence the median minutes."""
    return runs.groupby("env_step").agg({"minutes": "median", "return_mean": "mean"})


def first_time(course, goal):
    """Minutes until the return is at least the goal, or infinity."""
    return min(course["minutes"][course["return_mean"] >= goal], default=math.inf)


def clock(minutes):
    return f"{minutes:.2f}" if minutes < math.inf else "never"


def picture(data, script):
    """Every seed, the mean in bold, and dashed the goals; minutes on a logarithmic axis."""
    data = data[data["minutes"] > 0.02]
    env_ids = data["env_id"].unique()
    grid = sns.relplot(data, x="minutes", y="return_mean", hue="part", hue_order=LEARNERS,
                       col="env_id", units="seed", estimator=None, kind="line", linewidth=0.7,
                       alpha=0.35, height=3.6, aspect=1 if len(env_ids) > 1 else 2,
                       facet_kws={"sharey": False, "legend_out": False})
    grid.set(xscale="log").set_titles("{col_name}")
    grid.set_axis_labels("minutes of training (logarithmic)", "return in evaluation")
    for env_id, axis in grid.axes_dict.items():
        for i, learner in enumerate(LEARNERS):
            runs = data[data["env_id"].eq(env_id) & data["part"].eq(learner)]
            mean = mean_course(runs).set_index("minutes")["return_mean"]
            axis.plot(mean, STYLES[i], color=f"C{i}", linewidth=2.2)
            if learner != OURS:
                axis.axhline(mean.iloc[-1], color=f"C{i}", linestyle="--", linewidth=1.2)
        axis.xaxis.set_major_formatter("{x:g}")
    sns.move_legend(grid, "upper center", bbox_to_anchor=(0.5, 0), ncols=3, title="",
                    frameon=False)
    for line, style in zip(grid.legend.get_lines(), STYLES):
        line.set(alpha=1, linewidth=2.2, linestyle=style)
    if script == A2C:
        grid.set(ylim=(-600, 300), xlim=(0.08, None)).set_titles("{col_name} (cut at −600)")
    return grid
