"""What is each detail worth? Changes one at a time; some of them are exercises.

Eight seeds a setting, in one go, without tuning again after a change. Three hours on two cores.
"""

import numpy as np
import pandas as pd
import study
from study import A2C, PPO, Job, number

NAMES = {"--clip-eps 1e9": "no clip", "--max-kl 1e9": "no KL limit", "--last-std 0.6": "σ constant",
         "--clip-eps 1e9 --max-kl 1e9": "neither clip nor KL limit", "sigma-learned": "σ learned"}
DETAILS = [*NAMES, "learning-rate-constant", "advantages-not-standardised", "no-tanh",
           "observations-not-normalised", "rewards-not-scaled", "last-layer-not-small",
           "time-limits-as-deaths"]  # of PPO: options, and some of `variants`
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
    limits = level / np.arange(len(p_values), 0, -1)
    passes = np.logical_and.accumulate(np.sort(p_values) <= limits)
    return passes[np.argsort(np.argsort(p_values))]


def effects(rows):
    """A row for each change: what the seeds gain, in percent of the mean without it."""
    from scipy import stats
    found, returns = [], rows.groupby(study.KEYS)["return"].last().unstack()
    for table, (*_, changes) in TABLES.items():
        usual = returns.loc[job(table)[:3]]
        for change in changes:
            x = returns.loc[job(table, change)[:3]]
            test = stats.ttest_1samp(100 * (x - usual) / usual.mean(), 0)
            gain, margin = study.interval(test)
            idle = f" ({sum(x == usual)} unchanged)" if any(x == usual) else ""
            found.append([
                table, change, gain, margin, test.pvalue, study.p_value(test), study.spread(usual),
                study.spread(x), f"{number(gain)} ± {number(margin)}{idle}"])
    found = pd.DataFrame(found, columns=[
        "table", "change", "gain", "margin", "p-value", "p", "without", "with it", "text"])
    return found.assign(holds=holm(found["p-value"]))


def draw(rows):
    found = effects(rows)
    found["text"] = found["text"].mask(found["holds"], "**" + found["text"] + "**")
    details = found[found["change"].isin(DETAILS)].replace({"change": NAMES})
    details["change"] = details["change"].str.replace("-", " ")
    order = details.groupby("change")["gain"].mean().sort_values().index
    texts = details.pivot(index="change", columns="table", values="text").loc[order]
    picture, panels = study.figure(11, 5, 1, 3, sharex=True, sharey=True)
    for axis, table in zip(panels, texts):
        x = details[details["table"] == table].set_index("change").loc[order[::-1]]
        axis.errorbar(x["gain"], x.index, xerr=x["margin"], fmt="o", mfc="white", capsize=3)
        axis.plot(x["gain"].where(x["holds"]), x.index, "o", color="C0", zorder=3)
        axis.axvline(0, color="grey")
        axis.set(title=table, xlabel="gain, % (95%, not corrected)")
    share = f"{details['holds'].sum()} of {len(details)} effects"
    picture.suptitle(f"{share} are significant after Holm's correction (filled)")
    study.save(picture, "ablation")
    answers = found[~found["change"].isin(DETAILS)]
    usual = details.groupby("table")["without"].first()
    lines = [["return as it is (± std)", *usual], *texts.reset_index().to_numpy()]
    return {"ablation": study.table(["gain, % (95%)", *texts], lines), "answers": study.table(
        ["", "change", "without", "with", "gain, %", "p"],
        answers[["table", "change", "without", "with it", "text", "p"]].to_numpy())}


if __name__ == "__main__":
    study.main(JOBS, draw)
