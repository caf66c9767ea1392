"""Walker2d again: more seeds, and what stable-baselines3 does otherwise there.

Run after the ten seeds of `returns` had been seen to be below stable-baselines3 with our sizes: the
seeds 81 to 85 and the changes first, then, when the first two of these were known, 111 to 120.
An hour on two cores.
"""

import compare
import pages
import pandas as pd
import study
from race import BEST, finals_of
from returns import TASKS
from study import Job
from variants import PPO

TASK = "Walker2d-v5"
CHANGES = {"none": ("", ""),
           "σ learned": ("", "sigma-learned"),
           "no tanh, actions clipped": ("", "no-tanh"),
           "gradients clipped at 0.5": ("", "gradients-clipped"),
           "no KL limit": (" --max-kl 1e9", ""),
           "all four": (" --max-kl 1e9", "like-sb3")}
JOBS = [*(Job(PPO, TASKS[TASK], seed=seed) for seed in (*range(81, 86), *range(111, 121))),
        *(Job(PPO, TASKS[TASK] + options, change, seed)
          for options, change in list(CHANGES.values())[1:] for seed in (81, 82))]


def draw(rows):
    found = rows.set_index(["options", "change", "seed"])["return"]
    more = found[TASKS[TASK], ""].sort_index()
    planned = study.final_rows(study.read("returns")).set_index("options").loc[TASKS[TASK]]
    sb3 = finals_of(TASK, study.read("race"))[f"sb3, {BEST[TASK]}"]
    ours = {"101 to 110, as planned": planned["return"], "81 to 85": more.loc[:85],
            "111 to 120": more.loc[111:], "all 25": pd.concat([planned["return"], more])}
    gains = [compare.welch(returns, sb3) for returns in ours.values()]
    lines = [[name, compare.spread(returns), str(gain), compare.p_text(gain.p)]
             for (name, returns), gain in zip(ours.items(), gains)]
    changes = [[name, *(compare.number(found[TASKS[TASK] + options, change, seed])
                        for seed in (81, 82))] for name, (options, change) in CHANGES.items()]
    return {"walker": pages.table(
                ["our seeds", "return", f"minus sb3, {BEST[TASK]} ({len(sb3)})", "p"], lines),
            "walker changes": pages.table(["change", "seed 81", "seed 82"], changes)}


if __name__ == "__main__":
    study.main(JOBS, draw)
