"""Numbers that no study measures anew: published returns of PPO against ours, and trials.

published.csv holds the highest final mean of several seeds within a million steps that we know of;
ours are those of `returns`. earlier_trials.csv and trials.csv are what the defaults were chosen by.
"""

import itertools

import compare
import pages
import pandas as pd
import returns
import study
import variants
from compare import number
from scipy import stats

EARLIER = ((4, "minibatches of 64, learning rate 3e-4"),  # stages, changes
           (5, "one environment, rollouts of 2048 steps"),
           (5, "KL once an epoch, over the whole rollout"))
TRIAL_TASKS = "HalfCheetah", "Hopper", "Walker2d", "Ant", "Humanoid"


def beside_ours(other, finals):
    """Cells of a table, and p; ours are measured as theirs were."""
    runs = finals[finals["options"] == returns.TASKS[other["task"]]]
    ours, digits = runs["sampled" if other["sampled"] else "return"], int(abs(other["mean"]) < 100)
    theirs = f"{number(other['mean'], digits)} ± {number(other['std'], digits)}"
    p = stats.ttest_ind_from_stats(ours.mean(), ours.std(), len(ours), other["mean"], other["std"],
                                   other["seeds"], equal_var=False).pvalue
    of_seeds = f" ({other['seeds']:.0f})" if other["seeds"] == other["seeds"] else ""
    return [other["task"], f"{theirs.removesuffix(' ± nan')}{of_seeds} {other['source']}",
            other["handicap"],
            compare.spread(ours, digits), "drawn" if other["sampled"] else "mean"], p


def earlier_lines():
    """Of a table: a change, a task, pairs of a seed, what they gain."""
    rows = pd.read_csv(study.DATA / "earlier_trials.csv", comment="#").fillna({"change": ""})
    for stage, change in EARLIER:
        of_stage = rows[(rows["stage"] == stage) & rows["change"].isin(["", change])]
        keys = ["env_id", "total_steps", "seed", "change"]
        pairs = of_stage.set_index(keys)["return_at_100"].unstack().dropna()
        for task, gains in (pairs[change] - pairs[""]).groupby("env_id"):
            several = len(gains) > 2
            yield [change, task, len(gains), str(compare.paired(gains))
                   if several else ", ".join(map(compare.number, gains))]


def trial_lines():
    """Of a table: a candidate, its mean return ÷ another's on seeds that both have, by task."""
    rows = study.read("trials")
    rows = rows[rows["script"] == variants.PPO]
    typed = rows["options"].str.extract(r"--env-id (?P<task>\w+)-.*episodes \d+ ?(?P<option>.*)")
    rows = rows.join(typed).assign(candidate=typed["option"] + rows["change"])
    found = rows.pivot(index=["task", "seed"], columns="candidate", values=["return", "lost"])
    candidates = found["return"].columns
    for other, candidate in itertools.product(["", "--last-std 0.2"], candidates):
        if candidate == other or not candidate.startswith(other):
            continue
        both = found["return"][[other, candidate]].dropna().groupby("task").mean()
        ratios = (both[candidate] / both[other]).reindex(TRIAL_TASKS)
        ratios["mean"] = stats.gmean(ratios)
        lost = found["lost"].loc["InvertedDoublePendulum", [candidate, other]].dropna()
        falls = [number(x) if len(lost) else "" for x in lost.sum()]
        yield [f"`{candidate}`", f"`{other}`" if other else "as it was",
               *("" if x != x else number(x, 2) for x in ratios), *falls]


def draw(published):
    finals = study.final_rows(study.read("returns"))
    tables = {"earlier": pages.table(["change", "task", "pairs", "gain"], earlier_lines()),
              "trials": pages.table(["candidate", "÷", *TRIAL_TASKS, "geometric mean", "lost",
                                     "÷: lost"], trial_lines())}
    for same_version, others in published.groupby("same_version"):
        lines, p_values = zip(*(beside_ours(other, finals) for _, other in others.iterrows()))
        tables["published" if same_version else "older versions"] = pages.table(
            ["task", "published (seeds)", "what to know", "ours", "actions", "p"],
            [[*line, p] for line, p in zip(lines, compare.marked(p_values))])
    return tables


if __name__ == "__main__":
    pages.write_tables(draw(study.read("published")))
