"""What is each detail of PPO worth? Twelve changes, one at a time, on three tasks.

Eight seeds a setting, all measured in one go. Some three hours on two cores.
"""

import numpy as np
import pandas as pd
import study
from study import PPO, Job, number

TASKS = {"HalfCheetah-v5": 300_000, "InvertedDoublePendulum-v5": 150_000, "Hopper-v5": 1_000_000}
CHANGES = {  # options, or one of `variants`
    "as it is": "",
    "ratio not clipped": "--clip-eps 1e9",
    "no KL limit": "--max-kl 1e9",
    "neither clip nor KL limit": "--clip-eps 1e9 --max-kl 1e9",
    "σ stays at 0.6": "--last-std 0.6",
    "σ learned": "sigma-learned",
    "learning rate constant": "learning-rate-constant",
    "advantages not standardised": "advantages-not-standardised",
    "observations not normalised": "observations-not-normalised",
    "rewards not scaled": "rewards-not-scaled",
    "actions clipped, no tanh": "no-tanh",
    "last layer not small": "last-layer-not-small",
    "time limits as deaths": "time-limits-as-deaths",
}


def job(task, change, seed):
    options, variant = (change, "") if change.startswith("-") else ("", change)
    size = f"--total-steps {TASKS[task]} --num-evals 4 --eval-episodes 20"
    return Job(PPO, f"--env-id {task} {size} {options}".strip(), variant, seed)


JOBS = [job(task, change, seed) for seed in range(81, 89) for task in TASKS
        for change in CHANGES.values()]


def holm(p_values, level=0.05):
    """Which p-values stay below the level when corrected for their number (Holm 1979)."""
    limits = level / np.arange(len(p_values), 0, -1)
    passes = np.logical_and.accumulate(np.sort(p_values) <= limits)
    return passes[np.argsort(np.argsort(p_values))]


def effects(rows):
    """For each task and change: returns, what the seeds gain in percent of the mean, p."""
    from scipy import stats

    found = []
    rows = study.last(rows).set_index(["options", "change", "seed"])["return"]
    for task in TASKS:
        usual = rows[job(task, "", 0)[1:3]]
        for name, change in list(CHANGES.items())[1:]:
            changed = rows[job(task, change, 0)[1:3]]
            mean, margin = study.interval(100 * (changed - usual) / usual.mean())
            found.append({"task": task, "name": name, "returns": changed, "mean": mean,
                          "margin": margin, "p": stats.ttest_rel(changed, usual).pvalue,
                          "idle": (changed == usual).sum(), "usual": usual})
    found = pd.DataFrame(found)
    return found.assign(passes=holm(found["p"].fillna(1)))


def draw(rows):
    found, tables = effects(rows), {}
    order = found.groupby("name")["mean"].mean().sort_values(ascending=False).index.to_list()
    picture, panels = study.figure(13, 6, 1, len(TASKS), sharey=True)
    for axis, (task, x) in zip(panels, found.groupby("task", sort=False)):
        for effect in x.itertuples():
            axis.errorbar(effect.mean, order.index(effect.name), xerr=effect.margin, fmt="o",
                          capsize=3, color="C0", markerfacecolor="C0" if effect.passes else "white")
        axis.axvline(0, color="grey", linewidth=0.8)
        axis.set(title=f"{task}, {TASKS[task]:,} steps", xlabel="change of the return, %",
                 yticks=range(len(order)), yticklabels=order)
        usual = x["usual"].iloc[0]
        lines = [["as it is", study.spread(usual), study.every(usual), "", ""]]
        for effect in x.sort_values("mean").itertuples():
            gain = f"{number(effect.mean)} ± {number(effect.margin)} %"
            lines.append([effect.name, study.spread(effect.returns), study.every(effect.returns),
                          f"**{gain}**" if effect.passes else gain, effect.idle or ""])
        tables[f"ablation {task}"] = study.table(
            [f"{task}, {TASKS[task]:,} steps", "mean ± std", "seeds 81 to 88",
             "gain of each seed, mean and 95%", "seeds in which it did nothing"], lines)
    picture.suptitle(f"PPO with a detail changed: mean of eight seeds, 95% interval; filled: "
                     f"excludes 0 also after Holm's correction for {len(found)} comparisons")
    study.save(picture, "ablation")
    return tables


if __name__ == "__main__":
    study.main(JOBS, draw)
