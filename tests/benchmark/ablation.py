"""What is each detail worth? Changes one at a time; some of them are exercises.

Eight seeds a setting, in one go, without tuning again after a change. Four hours on two cores.
"""

import numpy as np
import pandas as pd
import study
from study import A2C, PPO, Job, number

DETAILS = [  # of PPO: options, or one of `variants`
    "--clip-eps 1e9", "--max-kl 1e9", "--clip-eps 1e9 --max-kl 1e9", "--last-std 0.6",
    "sigma-learned", "learning-rate-constant", "advantages-not-standardised",
    "observations-not-normalised", "rewards-not-scaled", "no-tanh", "last-layer-not-small",
    "time-limits-as-deaths",
]
TABLES = {  # a script on a task: options, changes
    "HalfCheetah": (PPO, "--env-id HalfCheetah-v5 --total-steps 3e5",
                    [*DETAILS, "--epochs 1", "--epochs 1 --minibatch-size 52",
                     "--first-std 0.03 --last-std 0.03"]),
    "double pendulum": (PPO, "", DETAILS),
    "Hopper": (PPO, "--env-id Hopper-v5 --total-steps 1e6", DETAILS),
    "A2C": (A2C, "", ["--gae-lambda 0", "--gae-lambda 1"]),
}


def job(table, change="", seed=0):
    script, options, _ = TABLES[table]
    if change.startswith("-"):
        return Job(script, f"{options} {change}".strip(), "", seed)
    return Job(script, options, change, seed)


JOBS = [job(table, change, seed) for seed in range(81, 89) for table in TABLES
        for change in ("", *TABLES[table][2])]


def holm(p_values, level=0.05):
    """Which p-values stay below the level when corrected for their number (Holm 1979)."""
    limits = level / np.arange(len(p_values), 0, -1)
    passes = np.logical_and.accumulate(np.sort(p_values) <= limits)
    return passes[np.argsort(np.argsort(p_values))]


def effects(rows):
    """For each change: returns, and what the seeds gain in percent of the mean without it."""
    from scipy import stats

    found, rows = [], rows.groupby(study.KEYS)
    returns, fit = rows["return"].last().unstack(), rows["explained_variance"].mean().unstack()
    for table in TABLES:
        usual = returns.loc[job(table)[:3]]
        for change in TABLES[table][2]:
            key = job(table, change)[:3]
            x = returns.loc[key]
            test = stats.ttest_1samp(100 * (x - usual) / usual.mean(), 0)
            gain, margin = study.interval(test)
            found.append({"table": table, "change": change, "gain": gain, "margin": margin,
                          "p": test.pvalue, "returns": x, "usual": usual, "idle": sum(x == usual),
                          "fit": fit.loc[key].mean(), "usual_fit": fit.loc[job(table)[:3]].mean()})
    found = pd.DataFrame(found)
    return found.assign(holds=holm(found["p"]))


def as_text(effect):
    text = f"{number(effect.gain)} ± {number(effect.margin)}"
    text = f"**{text}**" if effect.holds else text
    return f"{text} ({effect.idle} seeds unchanged)" if effect.idle else text


def draw(rows):
    found = effects(rows)
    details = found[found["change"].isin(DETAILS)]
    order = details.groupby("change")["gain"].mean().sort_values(ascending=False).index.to_list()
    picture, panels = study.figure(14, 6, 1, 3, sharey=True)
    lines = {change: [f"`{change}`"] for change in ["as it is", *reversed(order)]}
    for axis, (table, here) in zip(panels, details.groupby("table", sort=False)):
        lines["as it is"].append(study.spread(here["usual"].iloc[0]))
        for x in here.itertuples():
            axis.errorbar(x.gain, order.index(x.change), xerr=x.margin, fmt="o", capsize=3,
                          color="C0", markerfacecolor="C0" if x.holds else "white")
            lines[x.change].append(as_text(x))
        axis.axvline(0, color="grey")
        axis.set(title=table, xlabel="gain, %", yticks=range(len(order)), yticklabels=order)
    study.save(picture, "ablation")
    answers = [[x.table, f"`{x.change}`", study.spread(x.usual), study.spread(x.returns),
                f"{as_text(x)} %", f"{x.usual_fit:.2g}, {x.fit:.2g}"]
               for x in found[~found["change"].isin(DETAILS)].itertuples()]
    return {"ablation": study.table(["gain, %", *details["table"].unique()], lines.values()),
            "answers": study.table(["", "change", "without", "with", "gain, 95%",
                                    "explained variance without, with"], answers)}


if __name__ == "__main__":
    study.main(JOBS, draw)
