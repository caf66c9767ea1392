"""A2C in other gravity and wind than it was trained in, with and without --randomize."""

import itertools

import pandas as pd
import seaborn as sns
import torch
from benchmark import common
from benchmark.common import A2C, number, spread

FIGURES = ("robustness",)
GRAVITY, WIND = (-2.0, -4.0, -6.0, -8.0, -10.0, -11.9), (0.0, 5.0, 10.0, 15.0, 20.0)
EPISODES = 20
FIRST_SEED = 10**9  # the same episodes for all agents; none was trained with them
USUAL, RANDOM = "default", "--randomize"


def jobs(quick):
    return [job for name, flags in ((USUAL, ""), (RANDOM, "--randomize"))
            for job in common.training_jobs(A2C, quick, flags, part=name)]


def measure(job):
    common.run_folder(job)
    return common.fresh(play, job)


def play(job):
    """Deterministic episodes in each world of the grid: a row for each world."""
    script, folder = common.load(A2C), common.run_folder(job)
    torch.set_num_threads(1)
    args = script.parse_args(["--watch", str(folder / "checkpoint.pt")])
    quick = args.total_steps < 10_000
    rows = []
    for i, (gravity, wind) in enumerate(itertools.product(GRAVITY, WIND)):
        if quick and (gravity, wind) not in ((-2.0, 0.0), (-10.0, 0.0)):
            continue
        envs = script.make_envs(args.env_id, 2 if quick else EPISODES, "NextStep", gravity=gravity,
                                enable_wind=wind > 0, wind_power=wind)
        agent = script.Agent(envs.single_observation_space, envs.single_action_space, args)
        agent.load_state_dict(torch.load(args.watch, weights_only=True)["agent"])
        rows.append({"env_id": args.env_id, "gravity": gravity, "wind_power": wind,
                     **script.evaluate(agent, envs, FIRST_SEED + i)})
    return pd.DataFrame(rows)


def report(data, draw):
    outer = [data[x].isin((data[x].min(), data[x].max())) for x in ("gravity", "wind_power")]
    usual = data["gravity"].eq(-10) & data["wind_power"].eq(0)
    regions = {"all worlds": usual | True, "outermost worlds": outer[0] | outer[1],
               "usual world": usual}
    rows = {name: [f"trained: {name}"] for name in (USUAL, RANDOM)}
    rows["gap"] = ["difference, 95%"]
    for inside in regions.values():
        agents = data[inside].groupby(["part", "seed"])["return_mean"].mean()
        for name in USUAL, RANDOM:
            rows[name].append(spread(agents[name])[0])
        gap, margin = common.difference(agents[RANDOM], agents[USUAL])
        rows["gap"].append(f"{number(gap)} ± {number(margin)}")
    draw(maps(data), "robustness")
    gaps = {}
    for gravity in sorted(data["gravity"].unique(), reverse=True):
        agents = data[data["gravity"] == gravity].groupby(["part", "seed"])["return_mean"].mean()
        gap, margin = common.difference(agents[RANDOM], agents[USUAL])
        gaps[number(gravity)] = f"{number(gap, 0)} ± {number(margin, 0)}"
    return {"regions": common.table(["", *regions], rows.values()),
            "gravity": common.table(["gravity", *gaps], [["difference", *gaps.values()]])}


def maps(data):
    """A map of mean returns for each kind of training, and one of their difference."""
    cells = {name: x.pivot_table(index="gravity", columns="wind_power", values="return_mean")
             for name, x in data.groupby("part", sort=False)}
    figure = common.figure(13, 4)
    axes = figure.subplots(1, 3)
    scale = {"vmin": min(x.min().min() for x in cells.values()),
             "vmax": max(x.max().max() for x in cells.values())}
    for axis, name in zip(axes, (USUAL, RANDOM)):
        sns.heatmap(cells[name], annot=True, fmt=".0f", cmap="viridis", ax=axis, **scale)
        axis.set_title(f"trained: {name}")
    sns.heatmap(cells[RANDOM] - cells[USUAL], annot=True, fmt="+.0f", cmap="vlag", center=0,
                ax=axes[2])
    axes[2].set_title("--randomize minus default")
    for axis in axes:
        axis.set(xlabel="wind power (0: no wind)", ylabel="gravity")
    figure.suptitle(f"Mean return of {data['seed'].nunique()} agents, {EPISODES} episodes of each "
                    "in each world")
    return figure
