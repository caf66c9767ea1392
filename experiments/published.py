"""PPO's returns against published ones: it trains nothing, as ours are those of `returns`.

published.csv holds the highest final mean of several seeds within a million steps that we know of.
"""

import returns
import study
from scipy import stats
from study import number

JOBS = []


def compare(other, finals):
    """Cells of a table, and p; ours are measured as theirs were."""
    runs = finals[finals["options"] == returns.TASKS[other["task"]]]
    ours, digits = runs["sampled" if other["sampled"] else "return"], int(abs(other["mean"]) < 100)
    theirs = f"{number(other['mean'], digits)} ± {number(other['std'], digits)}"
    p = stats.ttest_ind_from_stats(ours.mean(), ours.std(), len(ours), other["mean"], other["std"],
                                   other["seeds"], equal_var=False).pvalue
    return [other["task"], f"{theirs.removesuffix(' ± nan')} {other['source']}", other["handicap"],
            study.spread(ours, digits), "training" if other["sampled"] else "evaluation"], p


def draw(published):
    finals, tables = study.final_rows(study.read("returns")), {}
    for same_version, others in published.groupby("same_version"):
        lines, p_values = zip(*(compare(other, finals) for _, other in others.iterrows()))
        tables["published" if same_version else "older versions"] = study.table(
            ["task", "published", "what to know", "ours", "in", "p"],
            [[*line, p] for line, p in zip(lines, study.marked(p_values))])
    return tables


if __name__ == "__main__":
    study.main(JOBS, draw)
