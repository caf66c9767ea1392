"""PPO with one detail changed at a time: what it loses, or gains."""

import numpy as np
import pandas as pd
from benchmark import common
from benchmark.common import PPO, number, spread

FIGURES = ("ablation",)
TASKS = {"HalfCheetah-v5": 300_000, "InvertedDoublePendulum-v5": 150_000, "Hopper-v5": 1_000_000}
SEEDS = range(1, 9)
CHANGES = {  # its name: flags, or the patch of a variant
    "defaults": "",
    "advantages recomputed in each epoch": "advantages-anew.patch",
    "no KL limit": "--max-kl 1e9",
    "learning rate not lowered": "networks-not-slowed-down.patch",
    "ratio not clipped": "--clip-eps 1e9",
    "neither KL limit nor clip": "--max-kl 1e9 --clip-eps 1e9",
    "advantages not standardised": "advantages-not-standardised.patch",
    "observations not normalised": "observations-not-normalised.patch",
    "rewards not scaled": "rewards-not-scaled.patch",
    "learning rate constant": "learning-rate-constant.patch",
    "last layer not small": "last-layer-not-small.patch",
    "weights not orthogonal": "weights-not-orthogonal.patch",
    "σ learned": "noise-learned.patch",
    "σ constant": "--last-std 0.6",
    "actions clipped, no tanh": "no-tanh.patch",
    "time limits treated as deaths": "time-limits-as-deaths.patch",
    "value loss clipped, too": "value-loss-clipped.patch",
}


def changed(change):
    """Flags and variant of a change."""
    if change.endswith(".patch"):
        return "", change.removesuffix(".patch")
    return change, ""


def jobs(quick):
    found = []
    for env_id, steps in list(TASKS.items())[:1] if quick else TASKS.items():
        for name in list(CHANGES)[:2] if quick else CHANGES:
            flags, variant = changed(CHANGES[name])
            size = "" if quick else f" --total-steps {steps} --num-evals 4 --eval-episodes 20"
            found += common.training_jobs(PPO, quick, f"--env-id {env_id}{size} {flags}",
                                          SEEDS, variant=variant, part=f"{env_id}: {name}")
    return found


measure = common.train


def effects(last):
    """For each task and change: what each seed gains, in percent of the defaults' mean.

    A row has the returns, the mean gain, half its 95% interval, p of the paired t-test, and whether
    p passes Holm's correction for the number of rows.
    """
    from scipy.stats import ttest_rel

    found = []
    for env_id, runs in last.sort_values("seed").groupby("env_id", sort=False):
        returns = {name: runs["return_mean"][runs["part"] == f"{env_id}: {name}"].to_numpy()
                   for name in CHANGES}
        usual = returns.pop("defaults")
        percent = 100 / abs(usual.mean())
        for name, x in returns.items():
            if len(x):
                mean, margin = common.gain(x, usual)
                found.append({"env_id": env_id, "name": name, "returns": x, "mean": mean * percent,
                              "margin": margin * percent, "p": ttest_rel(x, usual).pvalue})
    found = pd.DataFrame(found)
    return found.assign(passes=passes_holm(found["p"]))


def passes_holm(p_values, level=0.05):
    """Which p-values stay below the level if corrected for their number (Holm 1979)."""
    p_values = np.asarray(p_values)
    limits = level / np.arange(len(p_values), 0, -1)  # for the smallest, the next, ...
    order = np.argsort(p_values)
    passes = np.empty(len(p_values), dtype=bool)
    passes[order] = np.logical_and.accumulate(p_values[order] <= limits)
    return passes


def report(data, draw):
    last = common.last_rows(data)
    jobs_done = last.groupby("env_id")["seed"].count()
    last = last[last["env_id"].map(jobs_done) == jobs_done.max()]  # the rest is on its way
    tables = {table_name(env_id): "Not measured yet with the current files." for env_id in TASKS}
    found = effects(last)
    for env_id, changes in found.groupby("env_id"):
        usual = last["return_mean"][last["part"] == f"{env_id}: defaults"]
        rows = [["defaults", *spread(usual, 0), ""]]
        for x in changes.sort_values("mean").itertuples():
            gain = f"{number(x.mean, 0)} ± {number(x.margin, 0)} %"
            rows.append([x.name, *spread(x.returns, 0), f"**{gain}**" if x.passes else gain])
        title = f"{env_id}, {TASKS[env_id]:,} steps"
        header = [title, "mean ± std", "every seed", "gain of each seed, mean and 95%"]
        tables[table_name(env_id)] = common.table(header, rows)
    draw(picture(found), "ablation")
    return tables


def table_name(env_id):
    return env_id.split("-")[0].lower()


def picture(found):
    """A dot and a 95% interval for each change, sorted by the mean over tasks."""
    names = found.groupby("name")["mean"].mean().sort_values().index
    tasks = found["env_id"].unique()
    figure = common.figure(3 + 3 * len(tasks), 0.32 * len(names) + 1.6)
    panels = figure.subplots(1, len(tasks), sharex=True, sharey=True, squeeze=False)[0]
    for axis, env_id in zip(panels, tasks):
        for x in found[found["env_id"] == env_id].itertuples():
            fill = "C0" if x.passes else "#a6cee3" if abs(x.mean) > x.margin else "white"
            axis.errorbar(x.mean, -names.get_loc(x.name), xerr=x.margin, fmt="o", capsize=3,
                          color="C0", markerfacecolor=fill)
        axis.axvline(0, color="grey", linewidth=0.8)
        axis.set(title=env_id, xlabel="change of the return, %",
                 yticks=[-i for i in range(len(names))], yticklabels=names)
    figure.suptitle("PPO with a detail changed: mean of the seeds, 95% interval. White: includes 0,"
                    "\nlight: excludes 0, dark: excludes 0 also after Holm's correction")
    return figure
