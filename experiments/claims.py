"""What README and results.md say in words, computed from the data; a test looks for each."""

import ablation
import compare
import last_std
import more_seeds
import pandas as pd
import race
import returns
import study
import variants
from compare import number
from scipy import stats


def of_runs():
    """Of the three scripts, and of PPO on ten tasks."""
    hundred = study.read("returns").query("options == @returns.HUNDRED").groupby("script")
    for script, bar in (variants.REINFORCE, 950), (variants.A2C, 200), (variants.PPO, 9100):
        yield compare.proportion(hundred.get_group(script)["return"] >= bar)
    finals = study.final_rows(study.read("returns")).set_index("options")
    humanoids = finals.loc[returns.TASKS["Humanoid-v5"], "return"]
    yield (f"above 2,000 in {sum(humanoids > 2000)} of 10 runs; the median of all is "
           f"{compare.median(humanoids).replace('(', '(95%, bootstrap: ')}")
    stand = sum(humanoids > returns.STANDING["Humanoid-v5"])
    yield f"5,000, which {stand} of 10 exceed"
    yield f"{10 - stand} of 10 humanoids earn less than staying upright would"
    noise = finals["return"] - finals["sampled"]
    reacher, pusher = (noise[returns.TASKS[f"{task}-v5"]].mean() for task in ("Reacher", "Pusher"))
    yield f"Noise costs ours {reacher:.0f} points on Reacher, {pusher:.0f} on Pusher"
    first = study.read("other_machine").query("options != ''")
    first = first.set_index(["options", "seed"])["return"]
    unlike = []
    for options, elsewhere in first.groupby("options"):
        here = finals.loc[options].set_index("seed")["return"]
        gain = compare.paired(here[elsewhere[options].index] - elsewhere[options])
        if abs(gain.gain) > gain.margin:
            unlike.append(options)
    without_0 = f"leaves out 0 on {len(unlike)} tasks" if unlike else "contains 0 on every task"
    yield f"The 95% interval of the change {without_0}"
    of_tasks = study.read("returns").query("options in @returns.TASKS.values()")
    first = of_tasks.groupby(["options", "seed"])["return"].first().groupby("options").max()
    last = finals.loc[list(returns.TASKS.values()), "return"].groupby("options").min()
    assert all(last > first)  # as the heading of the ten tasks says
    swimmers = finals.loc[returns.TASKS["Swimmer-v5"], "return"]
    yield f"Swimmers hardly learn: {compare.spread(swimmers)}, where Gymnasium asks for 360"
    yield from of_other_defaults()
    yield from of_walkers(finals.loc[returns.TASKS["Walker2d-v5"]].set_index("seed")["return"])
    for options, runs in study.read("settings").groupby("options"):
        if "Swimmer" in options or "Humanoid" in options:
            yield f"{number(runs['return'].min())} to {number(runs['return'].max())}"
    *_, (_, _, falls) = last_std.falls(study.read("last_std"), study.read("returns"))
    yield f"in the last 300,000 steps {falls.split()[3]} of 10 double pendulums fall"


def of_other_defaults():
    """Runs of the plain commands in other studies that end below the threshold."""
    others = pd.concat([study.read("ablation"), study.read("exercises").rename(
        columns={"last eval_return": "return"})]).query("options == '' and change == ''")
    lows = []
    for script, bar, name in ((variants.PPO, 9100, "double pendulums ends"),
                              (variants.A2C, 200, "landers")):
        ends = others.loc[others["script"] == script, "return"]
        (low,) = ends[ends < bar]
        lows.append(f"one of {len(ends)} {name} at {number(low)}")
    yield ", ".join(lows)


def of_walkers(walkers):
    yield f"from {number(walkers.min())} to {number(walkers.max())}"
    sb3 = race.finals_of("Walker2d-v5", study.read("race"))["sb3, our sizes"]
    gain = compare.welch(walkers, sb3)
    gain = gain._replace(gain=-gain.gain)
    elsewhere = study.read("other_machine").set_index(["options", "seed"])["return"]
    first = elsewhere[returns.TASKS["Walker2d-v5"]].combine_first(walkers)
    yield (f"earns {gain.gain:,.0f} more ({gain.interval()}; p {gain.p:.2g}, but "
           f"{compare.welch(first, sb3).p:.2g}, significant, before five of our runs")
    of_task = more_seeds.samples(study.read("more_seeds"))
    cheetahs, hoppers, walkers, pendulums = (list(x.values())[-1] for x in of_task.values())
    yield (f"all {len(cheetahs)} cheetahs have {compare.spread(cheetahs)}, all {len(hoppers)} "
           f"hoppers {compare.spread(hoppers)}, from {number(hoppers.min())}, all {len(walkers)} "
           f"walkers {compare.spread(walkers)}, and all {len(pendulums)} double pendulums "
           f"{compare.spread(pendulums)}")
    yield f"{sum(hoppers < 1300)} of {len(hoppers)} hoppers end below 1,300"
    rows = study.read("race")
    leads = (compare.welch(cheetahs, race.finals_of("HalfCheetah-v5", rows)["sb3, zoo"]),
             compare.welch(hoppers, race.finals_of("Hopper-v5", rows)["sb3, defaults"]))
    yield (f"all {len(cheetahs)} cheetahs lead sb3's zoo by {leads[0]}, all {len(hoppers)} hoppers "
           f"sb3's defaults by {leads[1]}")
    yield f"With all {len(walkers)} walkers p is {compare.welch(walkers, sb3).p:.2g}"


def of_the_ablation():
    rows = study.read("ablation")
    effects = ablation.effects(rows, ablation.TABLES)
    returned = rows.set_index(["options", "change"])["return"]
    hoppers = returned[ablation.TABLES["Hopper"][0].options, ""]
    low, high = number(hoppers.min()), number(hoppers.max())
    yield f"the eight unchanged runs alone range from {low} to {high}"
    pendulum = effects.set_index(["table", "change"]).loc["double pendulum"]
    clip, both = pendulum.loc["--clip-eps 1e9"], pendulum.loc["--clip-eps 1e9 --max-kl 1e9"]
    low, high = (number(both["gain"] + sign * both["margin"]) for sign in (-1, 1))
    yield f"Without the clip the double pendulum loses {-clip['gain']:.0f}%"
    yield f"without both it loses {-both['gain']:.0f}% ({low} to {high})"
    found = effects.query("change in @ablation.DETAILS and holds")
    numbers = ["none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine",
               "ten", "eleven", "twelve"]
    worse, better = (numbers[found.query(f"gain {sign} 0")["change"].nunique()] for sign in "<>")
    yield (f"{worse.capitalize()} of {numbers[len(ablation.DETAILS)]} changes of PPO make it "
           f"significantly worse on a task, {better} better")


def of_baselines():
    ends = study.final_rows(study.read("baselines").query("options.str.startswith('--baseline')"))
    unsolved = ends[ends["return"] < 950]
    assert set(unsolved["options"]) == {"--baseline none"}
    yield f"all runs are solved but {len(unsolved)} of 10 with `none`"


def of_peers():
    speeds = study.read("speed").query("script == @variants.PPO").pivot(
        index=["options", "change", "seed"], columns="learner", values="speed")
    ratios = speeds.rdiv(speeds["ours"], axis="index").groupby("options").median()
    low, high = ratios.min(), ratios.max()
    peers = ["CleanRL", "defaults"]
    span = f"{low[peers].min():.1f} to {high[peers].max():.1f}"
    yield f"PPO is {span} times as fast as peers with their defaults"
    more = (f"{100 * x['our sizes'] - 100:.0f}" for x in (low, high))
    yield f"{' to '.join(more)}% faster than sb3's"
    rows = study.read("race")
    compared, lines, _, p_values = race.comparisons(rows)
    undecided = [(task, gain.gain) for (task, *_, gain), different in zip(
        lines, compare.holm(p_values)) if not different]
    lower = [task for task, gain in undecided if gain < 0]
    assert set(lower) == {"Walker2d", "InvertedDoublePendulum"}
    yield (f"The other {len(undecided)} of {len(lines)} comparisons are undecided; {len(lower)} of "
           "them lean to peers")
    hoppers = race.finals_of("Hopper-v5", rows[race.left_out(rows)])["sb3, zoo"]
    yield f"end at {number(hoppers.min())} to {number(hoppers.max())}"
    tried = [trials[trials["env_id"].isin(race.TASKS)]["env_id"] == returns.PENDULUM
             for trials in (earlier_trials(), later_trials())]
    on_pendulum = sum(map(sum, tried))
    finals = race.finals_of(returns.PENDULUM, compared)
    theirs, ours = finals["CleanRL"], finals["ours"]
    yield by_ranks("all five of CleanRL's runs", theirs, "all ten of ours", ours)
    yield (f"{sum(map(len, tried)) - on_pendulum} trainings on the first three tasks, "
           f"{on_pendulum} on the double pendulum")


def by_ranks(upper, above, lower, below):
    """Two samples of which every value of one exceeds all of the other."""
    assert above.min() > below.max()
    p = stats.mannwhitneyu(above, below, method="exact").pvalue
    return f"{upper} end above {lower} (by ranks p {p:.2g}"


def of_cheetahs():
    """Of HalfCheetah, without noise."""
    rows, *_ = race.comparisons(study.read("race"))
    finals = race.finals_of("HalfCheetah-v5", rows)
    ours, cleanrl, sb3 = (finals[x].mean() for x in ("ours", "CleanRL", "sb3, defaults"))
    theirs = study.final_rows(study.read("race")).set_index(["options", "change"])["return"]
    finals["like CleanRL"] = theirs[race.LIKE["CleanRL's"]]
    finals["more"] = all_cheetahs()
    row = [finals[learner] for learner in (
        "ours", "more", "sb3, zoo", "like CleanRL", "sb3, defaults", "CleanRL")]
    yield f"| {' | '.join(f'{compare.spread(x)} ({len(x)})' for x in row)} |"
    yield f"earns {ours / cleanrl:.1f} times as much as CleanRL's PPO with its defaults"
    yield f"{ours / sb3:.1f} times as much as stable-baselines3's (sb3) with normalisation"


def of_others_settings():
    """Of our script on HalfCheetah, with the settings of others."""
    finals = study.final_rows(study.read("race")).set_index(["options", "change"])["return"]
    theirs = finals[race.LIKE["CleanRL's"]]
    rows, *_ = race.comparisons(study.read("race"))
    as_usual = race.finals_of("HalfCheetah-v5", rows)
    ours, cleanrl = as_usual["ours"], as_usual["CleanRL"]
    median = number(theirs.median())
    less, more = compare.welch(ours, theirs), compare.welch(theirs, cleanrl)
    yield f"with CleanRL's, ours earns {compare.spread(theirs)}"
    yield (f"ours has a median of {median}, and earns {less} less than with its own, but {more} "
           "more than CleanRL's")
    yield by_ranks("all five of ours", theirs, "all five of CleanRL's", cleanrl)
    rows = rows.query("steps > 1e6 and options.str.startswith(@race.CHEETAH)").set_index(
        ["options", "change"])["seconds"]
    slow, fast = (number(rows[key].median() / 60, 1) for key in (
        race.LIKE["CleanRL's"], (race.CHEETAH, "ours")))
    yield f"With CleanRL's settings ours takes {slow} minutes on HalfCheetah, not {fast}"
    like_sb3 = number(rows[race.LIKE["sb3's, our sizes"]].median() / 60, 1)
    yield f"and with sb3's settings ours takes {like_sb3} minutes on HalfCheetah, not {fast}"
    cheetahs = all_cheetahs()
    low, high = map(number, compare.of_one_more(cheetahs))
    yield (f"Other processors and versions round differently: expect {low} to {high} (95%, from "
           f"all {len(cheetahs)} seeds)")


def all_cheetahs():
    return list(more_seeds.samples(study.read("more_seeds"))["HalfCheetah-v5"].values())[-1]


def earlier_trials():
    return pd.read_csv(study.DATA / "earlier_trials.csv", comment="#")


def later_trials():
    rows = study.read("trials")
    rows = rows[rows["script"] == variants.PPO]
    return rows["options"].str.extract(r"--env-id (?P<env_id>\S+)")


def claims():
    yield from of_runs()
    yield from of_the_ablation()
    yield from of_baselines()
    yield from of_peers()
    yield from of_cheetahs()
    yield from of_others_settings()
