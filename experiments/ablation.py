"""What is each detail worth? One change at a time, eight seeds each. Three hours on two cores."""

import numpy as np
import pandas as pd
import study
from scipy import stats
from study import A2C, PPO, Job

NAMES = {"--clip-eps 1e9": "no clip", "--max-kl 1e9": "no KL limit", "--last-std 0.6": "σ constant",
         "--clip-eps 1e9 --max-kl 1e9": "neither clip nor KL limit", "sigma-learned": "σ learned"}
DETAILS = [*NAMES, "learning-rate-constant", "advantages-not-standardised", "no-tanh",  # of PPO
           "observations-not-normalised", "rewards-not-scaled", "last-layer-not-small",
           "time-limits-as-deaths"]
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
    typed, changed = (change, "") if change.startswith("-") else ("", change)
    return Job(script, f"{options} {typed}".strip(), changed, seed)


JOBS = [job(table, change, seed) for seed in range(81, 89) for table in TABLES
        for change in ("", *TABLES[table][2])]


def holm(p_values, level=0.05):
    """Which p-values stay below the level when corrected for their number (Holm 1979)."""
    passes = np.sort(p_values) <= level / np.arange(len(p_values), 0, -1)
    return np.logical_and.accumulate(passes)[np.argsort(np.argsort(p_values))]


def effects(rows):
    """A row for each change: what the seeds gain, in percent of the mean without it."""
    found, returns = [], rows.set_index(study.KEYS)["return"].unstack()
    for table, (*_, changes) in TABLES.items():
        usual = returns.loc[job(table)[:3]]
        for change in changes:
            changed = returns.loc[job(table, change)[:3]]
            gains = 100 * (changed - usual) / usual.mean()
            effect = study.difference(stats.ttest_1samp(gains, 0))
            unchanged = f" ({sum(changed == usual)} unchanged)" if any(changed == usual) else ""
            found.append([table, change, *effect, study.spread(usual), study.spread(changed),
                          f"{effect}{unchanged}", study.p_text(effect.p)])
    found = pd.DataFrame(found, columns=[
        "table", "change", "gain", "margin", "p-value", "without", "with", "gain, %", "p"])
    found["holds"] = holm(found["p-value"])
    found["gain, %"] = found["gain, %"].mask(found["holds"], "**" + found["gain, %"] + "**")
    return found


def draw_gains(details, order, tasks):
    picture, panels = study.figure(11, 5, 1, 3, sharex=True, sharey=True)
    for axis, task in zip(panels, tasks):
        effect = details[details["table"] == task].set_index("change").loc[order[::-1]]
        axis.errorbar(effect["gain"], effect.index, xerr=effect["margin"], fmt="o", mfc="white",
                      capsize=3)
        axis.plot(effect["gain"].where(effect["holds"]), effect.index, "o", color="C0", zorder=3)
        axis.axvline(0, color="grey")
        axis.set(title=task, xlabel="gain, % (95%, not corrected)")
    picture.suptitle(f"{details['holds'].sum()} of {len(details)} effects are significant "
                     "after Holm's correction (filled)")
    study.save(picture, "ablation")


def draw(rows):
    found = effects(rows)
    details = found[found["change"].isin(DETAILS)].replace({"change": NAMES})
    details["change"] = details["change"].str.replace("-", " ")
    order = details.groupby("change")["gain"].mean().sort_values().index
    texts = details.pivot(index="change", columns="table", values="gain, %").loc[order]
    draw_gains(details, order, texts.columns)
    lines = [["return as it is (± std)", *details.groupby("table")["without"].first()],
             *texts.reset_index().to_numpy()]
    answers = found.loc[~found["change"].isin(DETAILS),
                        ["table", "change", "without", "with", "gain, %", "p"]]
    return {"ablation": study.table(["gain, % (95%)", *texts], lines),
            "answers": study.table(["", *answers.columns[1:]], answers.to_numpy())}


if __name__ == "__main__":
    study.main(JOBS, draw, study.last_evaluation)
