"""What was tried before the defaults were fixed: each run of docs/data/trials.csv."""

from benchmark import common
from benchmark.common import A2C, PPO

FIGURES = ()


def report(data, draw):
    data = data.astype({"stage": "Int64"}).fillna({"change": "–"})  # A2C had no stages
    ppo, a2c = data[data["script"] == PPO], data[data["script"] == A2C]
    return {"ppo": table(ppo.sort_values("stage", kind="stable"), ["stage", "change"]),
            "a2c": table(a2c, ["change"])}


def table(data, names):
    rows = [[*key, "; ".join(tasks(x))] for key, x in data.groupby(names, sort=False)]
    return common.table([*names, "returns (seeds)"], rows)


def tasks(runs):
    """For each task and length, the last return of each seed; those cut off have none."""
    for (env_id, steps), x in runs.groupby(["env_id", "total_steps"], sort=False):
        returns = x["return_at_100"].map("{:.0f}".format).replace("nan", "cut off")
        both = ", ".join(returns + " (" + x["seed"].astype(str) + ")")
        yield f"{env_id.split('-')[0]}, {steps / 1e6:g}M steps: {both}"
