"""Ours against stable-baselines3 and CleanRL: returns against steps and against minutes.

Ours are the runs of `returns`. CleanRL logs returns in training; it is compared by these, and
without noise. It is measured if CLEANRL is the path of its file. Nine hours on two cores.
"""

import compare
import pages
import pandas as pd
import peers
import returns
import study
import variants
from matplotlib.lines import Line2D
from study import Job

TASKS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", returns.PENDULUM
LEARNERS = {  # the change of their rows, colour, dashes
    "ours": ("ours", "C0", "-"), "CleanRL": ("CleanRL", "black", (0, (5, 1))),
    "sb3, defaults": ("defaults", "C1", "--"), "sb3, zoo": ("zoo", "C2", ":"),
    "sb3, our sizes": ("our sizes", "C4", "-.")}
MARKERS = dict(zip(LEARNERS, "oDsv^"))
LEFT_OUT = returns.TASKS["Hopper-v5"], "zoo"  # all stop near 1,000: not what the zoo publishes
BEST = {"HalfCheetah-v5": "zoo", "Hopper-v5": "defaults", "Walker2d-v5": "our sizes"}  # ten seeds
CHEETAH = returns.TASKS["HalfCheetah-v5"]
LIKE = {  # ours with others' settings, in which σ begins at 1
    "CleanRL's": (f"{CHEETAH} --num-envs 1 --rollout-steps 2048 --minibatch-size 64 "
                  "--learning-rate 3e-4 --max-kl 1e9", "like-cleanrl"),
    "sb3's, our sizes": (f"{CHEETAH} --max-kl 1e9", "like-cleanrl"),
    "sb3's, our sizes, σ from 0.6": (f"{CHEETAH} --max-kl 1e9", "like-sb3")}
JOBS = [*(Job(peers.FILE, returns.TASKS[task], setting, seed) for task in BEST
          for setting in ("defaults", "zoo", "our sizes")
          for seed in range(1, 11 if setting == BEST[task] else 6)),
        *(Job(peers.FILE, returns.TASKS[task], "CleanRL", seed)
          for seed in range(101, 111) for task in TASKS),
        *(Job(variants.PPO, *like, seed) for like in LIKE.values() for seed in range(101, 106))]


def measure(job):
    return peers.learn(job) if job.script == peers.FILE else study.train(job)[0]


def curves_of(task, rows, column="return"):
    """Of each learner and seed: the mean of its evaluations, of 50,000 steps at a time."""
    runs = rows[(rows["options"] == returns.TASKS[task]) & (rows["steps"] > 25_000)]
    runs = runs.assign(steps=(runs["steps"] / 50_000).round() / 20).dropna(subset=column)
    curves = {}
    for learner, (change, *_) in LEARNERS.items():
        seeds = runs[runs["change"] == change].groupby(["seed", "steps"])
        curves[learner] = seeds[column].mean().rename("return").reset_index()
    return {learner: curve for learner, curve in curves.items() if len(curve)}


def finals_of(task, rows, column="return"):
    """Of each learner: the last points of its curves, one for each seed."""
    curves = curves_of(task, rows, column)
    return {learner: curve.loc[curve["steps"] == 1, "return"] for learner, curve in curves.items()}


def slowness_of(task):
    """How many times as long as ours each learner takes: of five repetitions min, median, max."""
    speeds = study.read("speed")
    speeds = speeds[speeds["options"] == f"--env-id {task} --total-steps 32768"]
    speeds = speeds.pivot(index=["change", "seed"], columns="learner", values="speed")
    return speeds.rdiv(speeds["ours"], axis="index").agg(["min", "median", "max"])


def draw_steps(rows, lines, holds):
    """Above: means against steps, and the runs at the end. Below: ours minus each peer's."""
    picture, panels = pages.figure(15, 9.5, 2, 6, width_ratios=3 * (3, 2), height_ratios=(3, 2))
    peers = list(LEARNERS)[1:]
    gains = {(task, peer): gain for task, peer, *_, gain in lines}
    significant = dict(zip(gains, holds))
    for i, task in enumerate(BEST):
        curve, ends, below, spare = panels[[2 * i, 2 * i + 1, 2 * i + 6, 2 * i + 7]]
        spare.remove()
        below.set_subplotspec(below.get_gridspec()[1, 2 * i : 2 * i + 2])
        finals = finals_of(task, rows)
        for place, (learner, seeds) in enumerate(curves_of(task, rows).items()):
            _, color, dashes = LEARNERS[learner]
            curve.plot(seeds.groupby("steps")["return"].mean(), color=color, ls=dashes, lw=3)
            ends.plot([place] * len(finals[learner]), finals[learner], ".", ms=9, color=color)
            ends.plot(place, finals[learner].mean(), MARKERS[learner], ms=12, mew=2, mfc="none",
                      color=color)
        for place, peer in enumerate(peers):
            if (task[:-3], peer) not in gains:
                below.text(0.05, place, "left out", va="center",
                           transform=below.get_yaxis_transform())
                continue
            gain, color = gains[task[:-3], peer], LEARNERS[peer][1]
            below.errorbar(gain.gain, place, xerr=gain.margin, fmt=MARKERS[peer], ms=12, mew=2,
                           capsize=4, color=color,
                           mfc=color if significant[task[:-3], peer] else "white")
        below.axvline(0, color="grey")
        curve.set(title=task[:-3], xlabel="million steps", xticks=[0, 0.5, 1])
        ends.set(title="at the end", xlabel="seeds", xlim=(-0.6, len(finals) - 0.4))
        limits = [*curve.get_ylim(), *ends.get_ylim()]
        curve.set_ylim(min(limits), max(limits))
        ends.set(ylim=curve.get_ylim(), yticklabels=[])
        ends.set_xticks(range(len(finals)), map(len, finals.values()))
        below.set(xlabel="ours minus peer's", ylim=(3.5, -0.5))
        below.set_yticks(range(len(peers)), peers if i == 0 else [])
    panels[0].set_ylabel("mean return")
    picture.legend(handles=[Line2D([], [], color=color, ls=dashes, lw=3, marker=MARKERS[learner],
                                   ms=11, label=learner)
                            for learner, (_, color, dashes) in LEARNERS.items()],
                   loc="outside lower center", ncols=5)
    return picture


def draw_minutes(rows):
    """Return of a million steps against the minutes: the median of ours, times others' ratio."""
    picture, panels = pages.figure(14, 5.2, 1, 3)
    ratios = {}
    for axis, task in zip(panels, BEST):
        slowness = slowness_of(task)
        ours = rows[(rows["options"] == returns.TASKS[task]) & (rows["change"] == "ours")]
        minutes = study.final_rows(ours)["seconds"].median() / 60 * slowness
        for learner, finals in finals_of(task, rows).items():
            change, color, _ = LEARNERS[learner]
            ratios[task, learner] = slowness.loc["median", change]
            low, middle, high = minutes[change]
            axis.errorbar(middle, finals.mean(), finals.std(), [[middle - low], [high - middle]],
                          fmt=MARKERS[learner], ms=12, color=color, label=learner)
            if learner != "ours":
                left = learner == "CleanRL"
                axis.annotate(f"×{ratios[task, learner]:.1f}", (middle, finals.mean()),
                              (-9, -20) if left else (9, 5), textcoords="offset points",
                              ha="right" if left else "left")
        if returns.TASKS[task] == CHEETAH:
            theirs = study.final_rows(rows).set_index(["options", "change"]).loc[LIKE["CleanRL's"]]
            axis.errorbar(theirs["seconds"].median() / 60, theirs["return"].mean(),
                          theirs["return"].std(), fmt="o", ms=12, mfc="white", color="C0",
                          label="ours with CleanRL's settings")
        axis.set(title=task[:-3], xlabel="minutes (log; peers': estimated)", xscale="log",
                 xticks=[2, 5, 10, 20], xlim=(1.5, 55))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.minorticks_off()
    panels[0].set_ylabel("return after a million steps")
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    spans = [f"{min(x):.1f} to {max(x):.1f}" for x in (
        [ratio for (_, learner), ratio in ratios.items() if learner in learners]
        for learners in (("CleanRL", "sb3, defaults"), ("sb3, our sizes",)))]
    picture.suptitle(
        f"A million steps take peers' defaults {spans[0]} times as long as ours, with our sizes "
        f"{spans[1]}\n(vertical: std of seeds; horizontal: range of peers' estimated minutes)")
    pages.save(picture, "ppo_minutes")


def lines_of(rows, column="return"):
    """Of a table, one for each task and peer: both, their returns, and the difference."""
    for task in TASKS:
        finals = finals_of(task, rows, column)
        ours = finals.pop("ours")
        for peer, theirs in finals.items():
            yield task[:-3], peer, ours, theirs, compare.welch(ours, theirs)


def returns_table(lines, holds, zoo_hopper):
    """A line for each task, a column for each learner; bold: significantly unlike ours."""
    cells = {("Hopper", "sb3, zoo"): zoo_hopper}
    for (task, peer, ours, theirs, _), different in zip(lines, holds):
        text = [f"{compare.spread(x)} ({len(x)})" for x in (ours, theirs)]
        cells[task, "ours"], cells[task, peer] = text[0], f"**{text[1]}**" if different else text[1]
    return pages.table(["task", *LEARNERS], [[task[:-3], *(
        cells.get((task[:-3], learner), "not run") for learner in LEARNERS)] for task in TASKS])


def differences_table(lines, p_values):
    return pages.table(
        ["task", "peer (seeds)", "peer's return (median)", "ours (seeds)", "ours − peer's, 95%",
         "p"],
        [[task, f"{peer} ({len(theirs)})",
          f"{compare.spread(theirs)} ({compare.number(theirs.median())})",
          f"{compare.spread(ours)} ({len(ours)})", gain, p]
         for (task, peer, ours, theirs, gain), p in zip(lines, p_values)])


def like_table(rows):
    """Ours with others' settings, on HalfCheetah."""
    finals = study.final_rows(rows).set_index(["options", "change"])["return"]
    peers = finals_of("HalfCheetah-v5", rows)
    theirs, like_sb3, smaller = (finals[like] for like in LIKE.values())
    pairs = [(theirs, "CleanRL", peers["CleanRL"]),
             (like_sb3, "sb3, our sizes", peers["sb3, our sizes"]),
             (smaller, "the line above", like_sb3)]
    gains = [compare.welch(mine, other) for mine, _, other in pairs]
    return pages.table(
        ["ours with settings", "return (median)", "minus", "difference, 95%", "p"],
        [[name, f"{compare.spread(mine)} ({compare.number(mine.median())})", other, gain,
          compare.p_text(gain.p)]
         for name, (mine, other, _), gain in zip(LIKE, pairs, gains)])


def title_of(lines, holds):
    """On which task ours are significantly above whom, or below."""
    leads = {}
    for (task, peer, *_, gain), different in zip(lines, holds):
        if different:
            side = f"{task}: ours {'above' if gain.gain > 0 else 'below'}"
            leads.setdefault(side, []).append(peer.replace(",", ""))
    return "; ".join(f"{side} {', '.join(peers)}" for side, peers in leads.items())


def left_out(rows):
    return rows[["options", "change"]].apply(tuple, axis=1) == LEFT_OUT


def comparisons(rows):
    """All rows with ours; lines without noise and in training; p-values, to correct for both."""
    ours = study.read("returns").replace({"change": {"": "ours"}})
    rows = pd.concat([ours, rows[~left_out(rows)]])
    lines, in_training = list(lines_of(rows)), list(lines_of(rows, "sampled"))
    return rows, lines, in_training, [gain.p for *_, gain in [*lines, *in_training]]


def draw(rows):
    stood = finals_of("Hopper-v5", rows[left_out(rows)])["sb3, zoo"]
    rows, lines, in_training, p_values = comparisons(rows)
    holds, marked = compare.holm(p_values), compare.marked(p_values)
    draw_minutes(rows)
    picture = draw_steps(rows, lines, holds)
    drawn = [different for line, different in zip(lines, holds) if f"{line[0]}-v5" in BEST]
    picture.suptitle(
        f"{title_of(lines, holds)}; the other {drawn.count(False)} differences are undecided\n"
        "below: 95% intervals, uncorrected (filled: significant after correction)")
    pages.save(picture, "ppo_race")
    return {"race": returns_table(lines, holds, f"left out: {compare.spread(stood)}"),
            "differences": differences_table(lines, marked),
            "in training": differences_table(in_training, marked[len(lines):]),
            "their settings": like_table(rows)}


if __name__ == "__main__":
    study.main([job for job in JOBS if peers.CLEANRL or job.change != "CleanRL"], draw, measure)
