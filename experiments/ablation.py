"""What is each detail worth? One change at a time, eight seeds each. Five hours on two cores."""

import compare
import pages
import pandas as pd
import study
from study import Job
from variants import A2C, PPO

NAMES = {"--clip-eps 1e9": "no clip", "--max-kl 1e9": "no KL limit", "--last-std 0.6": "σ constant",
         "--clip-eps 1e9 --max-kl 1e9": "neither clip nor KL limit", "sigma-learned": "σ learned"}
DETAILS = [*NAMES, "learning-rate-constant", "advantages-not-standardised", "no-tanh",  # of PPO
           "observations-not-normalised", "rewards-not-scaled", "last-layer-not-small",
           "time-limits-as-deaths"]
TABLES = {  # a script on a task: a job, and changes
    "HalfCheetah": (Job(PPO, "--env-id HalfCheetah-v5 --total-steps 3e5"),
                    [*DETAILS, "--epochs 1", "--epochs 1 --minibatch-size 52",
                     "--first-std 0.03 --last-std 0.03",
                     "--first-std 0.2 --last-std 0.2 --max-kl 0.000675"]),
    "double pendulum": (Job(PPO), DETAILS),
    "Hopper": (Job(PPO, "--env-id Hopper-v5 --total-steps 1e6"), DETAILS),
    "A2C": (Job(A2C), ["--gae-lambda 0", "--gae-lambda 1"]),
}


def with_change(job, change, seed=1):
    """A change is an option, to be typed, or one of `variants`."""
    if change.startswith("--"):
        return job._replace(options=f"{job.options} {change}".strip(), seed=seed)
    return job._replace(change=change, seed=seed)


JOBS = [with_change(usual, change, seed) for seed in range(81, 89)
        for usual, changes in TABLES.values() for change in ("", *changes)]


def effects(rows, tables):
    """A row for each change that two seeds have: what they gain, in percent of their mean."""
    found, returns = [], rows.set_index(study.KEYS)["return"].unstack()
    for name, (usual, changes) in tables.items():
        for change in changes:
            jobs = [job[:3] for job in (usual, with_change(usual, change))]
            both = returns.reindex(jobs).T.dropna().to_numpy().T
            if both.shape[1] > 1:
                without, changed = both
                gains = 100 * (changed - without) / abs(without.mean())
                effect = compare.paired(gains)
                alike = sum(changed == without)
                found.append([name, change, len(gains), *effect, compare.spread(without),
                              compare.spread(changed),
                              f"{effect}{f' ({alike} identical)' if alike else ''}"])
    found = pd.DataFrame(found, columns=["table", "change", "seeds", *compare.Difference._fields,
                                         "without", "with", "gain, %"])
    found["holds"] = compare.holm(found["p"])
    found["gain, %"] = found["gain, %"].mask(found["holds"], "**" + found["gain, %"] + "**")
    return found


def draw_gains(details, order, tasks):
    picture, panels = pages.figure(13, 7, 1, 3, sharex=True, sharey=True)
    for axis, (task, title) in zip(panels, tasks.items()):
        effect = details[details["table"] == task].set_index("change").loc[order[::-1]]
        axis.errorbar(effect["gain"], effect.index, xerr=effect["margin"], fmt="o", mfc="white",
                      capsize=3)
        for change, found in effect[effect["holds"]].iterrows():
            axis.plot(found["gain"], change, "o", color="C0", zorder=3)
            axis.text(found["gain"] + found["margin"] + 3, change, compare.number(found["gain"]),
                      va="center", bbox={"color": "white", "pad": 0})
        axis.axvline(0, color="grey")
        axis.set(title=title, xlabel="change in return, %", xlim=(-100, 65))
    found = details[details["holds"]]
    assert (found["gain"] < 0).all()  # as the title says
    names = ", ".join(change for change in order if change in set(found["change"]))
    low, high = (compare.number(-x) for x in (found["gain"].max(), found["gain"].min()))
    picture.suptitle(f"Changes that cost PPO {low} to {high}% on a task "
                     f"(none helps significantly):\n{names}")
    picture.supxlabel("filled: significant after correction; hollow: undecided,\n"
                      "even where the 95% interval of the eight pairs leaves out 0", fontsize=14)
    pages.save(picture, "ablation")


def draw(rows):
    found = effects(rows, TABLES)
    details = found[found["change"].isin(DETAILS)].replace({"change": NAMES})
    details["change"] = details["change"].str.replace("-", " ")
    order = details.groupby("change")["gain"].mean().sort_values().index
    texts = details.pivot(index="change", columns="table", values="gain, %").loc[order]
    usual = {task: study.load(TABLES[task][0])[1] for task in texts}
    titles = {task: f"{task},\n{args.total_steps:,} steps" for task, args in usual.items()}
    draw_gains(details, order, titles)
    lines = [["return as it is (± std)", *details.groupby("table")["without"].first()],
             *texts.reset_index().to_numpy()]
    asked = ~found["change"].isin(DETAILS) | (
        (found["table"] == "double pendulum") & found["change"].str.startswith("--clip-eps"))
    answers = found[asked].assign(p=found["p"].map(compare.p_text))
    answers = answers[["table", "change", "without", "with", "gain, %", "p"]]
    return {"ablation": pages.table(
                ["gain, % (95%)", *(x.replace("\n", " ") for x in titles.values())], lines),
            "answers": pages.table(["", *answers.columns[1:]], answers.to_numpy())}


if __name__ == "__main__":
    study.main(JOBS, draw)
