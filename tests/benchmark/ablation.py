"""PPO with one detail changed at a time: what it loses, or gains."""

import numpy as np
from benchmark import common
from benchmark.common import PPO, number, spread

FIGURES = ("ablation",)
TASKS = {"HalfCheetah-v5": 300_000, "InvertedDoublePendulum-v5": 150_000, "Hopper-v5": 1_000_000}
CHANGES = {  # its name: flags, or the patch of a variant
    "defaults": "",
    "advantages anew in each epoch": "advantages-anew.patch",
    "no KL limit": "--max-kl 1e9",
    "networks not slowed down": "networks-not-slowed-down.patch",
    "ratio not clipped": "--clip-eps 1e9",
    "neither KL limit nor clip": "--max-kl 1e9 --clip-eps 1e9",
    "advantages not standardised": "advantages-not-standardised.patch",
    "observations not normalised": "observations-not-normalised.patch",
    "rewards not scaled": "rewards-not-scaled.patch",
    "learning rate constant": "learning-rate-constant.patch",
    "last layer not small": "last-layer-not-small.patch",
    "weights not orthogonal": "weights-not-orthogonal.patch",
    "σ learned": "noise-learned.patch",
    "σ not annealed": "--last-std 0.6",
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
                                          variant=variant, part=f"{env_id}: {name}")
    return found


measure = common.train


def effects(runs):
    """For each change: returns, and mean and 95% interval of what each seed gains, in percent."""
    runs = runs.assign(name=runs["part"].str.split(": ").str[1]).sort_values("seed")
    usual = runs[runs["name"] == "defaults"]["return_mean"].to_numpy()
    percent = 100 / abs(usual.mean())
    for name in CHANGES:
        x = runs[runs["name"] == name]["return_mean"].to_numpy()
        if len(x) and name != "defaults":
            mean, margin = common.gain(x, usual)
            yield name, x, mean * percent, margin * percent


def report(data, draw):
    last = common.last_rows(data)
    jobs_done = last.groupby("env_id")["seed"].count()
    last = last[last["env_id"].map(jobs_done) == jobs_done.max()]  # the rest is on its way
    tables = {table_name(env_id): "Not measured yet with the current files." for env_id in TASKS}
    found = {}
    for env_id, runs in last.groupby("env_id", sort=False):
        found[env_id] = sorted(effects(runs), key=lambda x: x[2])
        rows = [[name, *spread(x, 0), f"{number(gap, 0)} ± {number(margin, 0)} %"]
                for name, x, gap, margin in found[env_id]]
        usual = runs[runs["part"].str.endswith(": defaults")]["return_mean"]
        rows.insert(0, ["defaults", *spread(usual, 0), ""])
        title = f"{env_id}, {TASKS[env_id]:,} steps"
        header = [title, "mean ± std", "every seed", "gain of each seed, mean and 95%"]
        tables[table_name(env_id)] = common.table(header, rows)
    draw(picture(found), "ablation")
    return tables


def table_name(env_id):
    return env_id.split("-")[0].lower()


def picture(found):
    """A dot and a 95% interval for each change; the dot is filled if the interval is without 0."""
    means = {}
    for effects_of_task in found.values():
        for name, _, gap, _ in effects_of_task:
            means.setdefault(name, []).append(gap)
    names = sorted(means, key=lambda name: np.mean(means[name]))
    figure = common.figure(3 + 3.5 * len(found), 0.32 * len(names) + 1.4)
    panels = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
    for axis, (env_id, effects_of_task) in zip(panels, found.items()):
        for name, _, gap, margin in effects_of_task:
            axis.errorbar(gap, -names.index(name), xerr=margin, fmt="o", capsize=3, color="C0",
                          markerfacecolor="C0" if abs(gap) > margin else "white")
        axis.axvline(0, color="grey", linewidth=0.8)
        axis.set(title=env_id, xlabel="change of the return, % of the defaults'",
                 yticks=[-i for i in range(len(names))], yticklabels=names)
    figure.suptitle("PPO with a detail changed, 95% intervals (filled: they exclude 0)")
    return figure
