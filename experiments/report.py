"""All tables and figures anew, from experiments/data alone. Trains nothing."""

import importlib

import ablation
import compare
import last_std
import pages
import pandas as pd
import race
import returns
import study
from compare import number

STUDIES = ("returns", "last_std", "published", "settings", "race", "speed", "processes",
           "baselines", "robustness", "ablation", "exercises")


def commits():
    """Of a table: by which commits the rows of each study were measured."""
    for name in STUDIES:
        jobs = study.read(name).reindex(columns=[*study.KEYS, "commit"]).drop_duplicates()
        for script, of_script in jobs.groupby("script"):
            counts = of_script["commit"].value_counts()
            yield [f"`{name}.csv`", f"`{script}`",
                   ", ".join(f"{commit} ({count} jobs)" for commit, count in counts.items())]


def tables():
    """{name: table} of all studies; their figures are drawn."""
    found = {"commits": pages.table(["rows", "script", "commits"], commits())}
    for name in STUDIES:
        found |= importlib.import_module(name).draw(study.read(name))
    return found


def claims():
    """What README and results.md say in words; a test looks for each."""
    finals = study.final_rows(study.read("returns")).set_index("options")
    speeds = study.read("speed").query("change == 'CleanRL'")
    speeds = speeds.pivot(index=["options", "seed"], columns="learner", values="speed")
    ratios = speeds.eval("ours / CleanRL").groupby("options").median()
    yield f"{ratios.min():.0f} to {ratios.max():.0f} times as fast"
    effects = ablation.effects(study.read("ablation"), ablation.TABLES)
    effects = effects.set_index(["table", "change"])["gain"]
    yield f"costs {-effects['double pendulum', '--clip-eps 1e9']:.0f}% of the return"
    stand = sum(finals.loc[returns.TASKS["Humanoid-v5"], "return"] > 5000)
    yield f"5,000, and {stand} of 10 earn more"
    yield f"{10 - stand} of 10 humanoids still fall"
    for task in "HalfCheetah", "Hopper", "Walker2d", "Humanoid":
        runs = finals.loc[returns.TASKS[f"{task}-v5"]]
        yield f"{task} {compare.spread(runs['return'])}"
        usual = runs["processor"] == returns.PROCESSOR
        if not usual.all():
            gain = compare.welch(runs.loc[~usual, "return"], runs.loc[usual, "return"])
            yield f"{gain} ({task})"
    for options, runs in study.read("settings").groupby("options"):
        if "Swimmer" in options or "Humanoid" in options:
            yield f"{number(runs['return'].min())} to {number(runs['return'].max())}"
    *_, (_, before, after) = last_std.falls(study.read("last_std"), study.read("returns"))
    yield f"of the last {after.split()[2].rstrip(',')} evaluations {after.split()[0]} have a fall"
    yield f"{before.split()[0]} had"
    trials = pd.read_csv(study.DATA / "earlier_trials.csv", comment="#")
    tried = trials["env_id"].isin(race.TASKS[:3]) & (trials["stage"] < 6)  # 6: other settings
    yield f"in {sum(tried)} trainings"
    tried = study.read("trials")["options"].str.contains("HalfCheetah|Hopper|Walker2d")
    yield f"{sum(tried)} of trials.csv"


if __name__ == "__main__":
    pages.write_tables(tables())
