"""What README and results.md say in words, computed from the data; a test looks for each."""

import ablation
import compare
import last_std
import numpy as np
import pandas as pd
import race
import returns
import study
import variants
from compare import number


def of_runs():
    """Of our runs on ten tasks."""
    finals = study.final_rows(study.read("returns")).set_index("options")
    humanoids = finals.loc[returns.TASKS["Humanoid-v5"], "return"]
    yield (f"above 2,000 in {sum(humanoids > 2000)} of 10 runs; the median of all is "
           f"{compare.median(humanoids).replace('(', '(95%: ')}")
    stand = sum(humanoids > returns.STANDING["Humanoid-v5"])
    yield f"5,000, which {stand} of 10 exceed"
    yield f"{10 - stand} of 10 humanoids earn less than staying upright would"
    for task in "HalfCheetah", "Hopper", "Walker2d", "Humanoid":
        yield f"{task} {compare.spread(finals.loc[returns.TASKS[f'{task}-v5'], 'return'])}"
    first = study.read("other_machine").set_index(["options", "seed"])["return"]
    for options, elsewhere in first.groupby("options"):
        here = finals.loc[options].set_index("seed")["return"]
        gain = compare.paired(here[elsewhere[options].index] - elsewhere[options])
        digits = int(abs(here.mean()) < 100)
        yield (f"{number(gain.gain, digits)} ± {number(gain.margin, digits)} "
               f"({options.split()[1].removesuffix('-v5')})")
    of_tasks = study.read("returns").query("options in @returns.TASKS.values()")
    first = of_tasks.groupby(["options", "seed"])["return"].first().groupby("options").max()
    last = finals.loc[list(returns.TASKS.values()), "return"].groupby("options").min()
    yield (f"on {sum(last > first)} of {len(last)} tasks every run ends above the best first "
           "evaluation")
    yield from of_walkers(finals.loc[returns.TASKS["Walker2d-v5"]].set_index("seed")["return"])
    for options, runs in study.read("settings").groupby("options"):
        if "Swimmer" in options or "Humanoid" in options:
            yield f"{number(runs['return'].min())} to {number(runs['return'].max())}"
    *_, (_, _, falls) = last_std.falls(study.read("last_std"), study.read("returns"))
    yield f"{falls.split()[3]} of 10 runs have a fall near the end"


def of_walkers(walkers):
    yield f"from {number(walkers.min())} to {number(walkers.max())}"
    sb3 = race.finals_of("Walker2d-v5", study.read("race"))["sb3, our sizes"]
    gain = compare.welch(walkers, sb3)
    yield (f"{number(-gain.gain)} ± {number(gain.margin)} below *our sizes* (p {gain.p:.2g}, "
           "uncorrected)")
    elsewhere = study.read("other_machine").set_index(["options", "seed"])["return"]
    first = elsewhere[returns.TASKS["Walker2d-v5"]].combine_first(walkers)
    yield (f"first had {compare.spread(first)}, and were significantly below "
           f"(p {compare.welch(first, sb3).p:.2g})")
    more = study.read("walker").set_index(["options", "change"])["return"]
    more = more[returns.TASKS["Walker2d-v5"], ""]
    p = compare.welch([*walkers, *more], sb3).p
    yield (f"have {compare.spread(more)}, all twenty-five {compare.spread([*walkers, *more])} "
           f"(p {p:.2g})")


def of_the_ablation():
    rows = study.read("ablation")
    effects = ablation.effects(rows, ablation.TABLES).set_index(["table", "change"])["gain"]
    yield f"loses {-effects['double pendulum', '--clip-eps 1e9']:.0f}% of its return"
    pendulums = rows.set_index(study.KEYS[:3]).loc[ablation.TABLES["double pendulum"][0][:3]]
    yield f"of {len(pendulums)} other seeds {sum(pendulums['return'] < 9300)} drops one of ten"


def of_peers():
    ratios = study.read("speed").query("change == 'CleanRL'").pivot(
        index=["options", "seed"], columns="learner", values="speed").eval("ours / CleanRL")
    ratios = ratios.groupby("options").median()
    yield f"{ratios.min():.0f} to {ratios.max():.0f} times as fast"
    rows = study.read("race")
    hoppers = study.final_rows(rows[rows[["options", "change"]].apply(tuple, axis=1)
                                    == race.LEFT_OUT])
    yield f"end at {number(hoppers['return'].min())} to {number(hoppers['return'].max())}"
    tried = [trials[trials["env_id"].isin(race.TASKS)]["env_id"] == returns.PENDULUM
             for trials in (earlier_trials(), later_trials())]
    on_pendulum = sum(map(sum, tried))
    yield (f"{sum(map(len, tried)) - on_pendulum} trainings on the first three tasks, "
           f"{on_pendulum} on the double pendulum")


def of_cleanrl():
    """Means against those of CleanRL, in training, after equal steps and after equal minutes."""
    rows = pd.concat([study.read("returns").replace({"change": {"": "ours"}}), study.read("race")])
    leads = []
    for task in race.TASKS:
        curves = race.curves_of(task, rows, "sampled")
        ours, theirs = (curves[learner].groupby("steps")["return"].mean()
                        for learner in ("ours", "CleanRL"))
        if task == "HalfCheetah-v5":
            yield f"{ours[1] / theirs[1]:.1f} times what CleanRL's does"
        speeds = race.speeds_of(task)
        done = speeds["CleanRL"] / speeds["ours"]  # of its steps, when ours has done all
        leads.append((ours[1] - np.interp(done, theirs.index, theirs), done))
    gains, done = zip(*leads)
    yield f"by {number(min(gains))} to {number(max(gains))}"
    yield f"{100 * min(done):.0f} to {100 * max(done):.0f}% of our steps"


def of_others_settings():
    """Of our script on HalfCheetah, with the settings of others."""
    finals = study.final_rows(study.read("race")).set_index(["options", "change"])["return"]
    for like in race.LIKE:
        yield f"{compare.spread(finals[like])} (median {number(finals[like].median())})"
    _, their_sigma, our_sigma = (finals[like] for like in race.LIKE)
    yield f"much of our lead (p {compare.welch(our_sigma, their_sigma).p:.2g})"


def of_baselines():
    """Of REINFORCE with the critic as baseline: the study's runs, and those with defaults."""
    runs = study.final_rows(study.read("baselines").query("options == '--baseline value'"))
    hundred = study.read("returns").query(
        "script == 'reinforce_mujoco.py' and options == @returns.HUNDRED")
    solved = [*(runs["return"] >= 950), *(hundred["return"] >= 950)]
    yield f"With it {sum(solved)} of {len(solved)} runs are solved"


def earlier_trials():
    rows = pd.read_csv(study.DATA / "earlier_trials.csv", comment="#")
    return rows[rows["stage"] < 6]  # 6: other settings


def later_trials():
    rows = study.read("trials")
    rows = rows[rows["script"] == variants.PPO]
    return rows["options"].str.extract(r"--env-id (?P<env_id>\S+)")


def claims():
    yield from of_runs()
    yield from of_the_ablation()
    yield from of_peers()
    yield from of_cleanrl()
    yield from of_others_settings()
    yield from of_baselines()
