"""What helps stable-baselines3 on Walker2d? Its differences from ours, one by one and together.

Forty minutes on two cores.
"""

import compare
import pages
import study
from race import BEST, RACES, curves_of
from returns import TASKS
from study import PPO, Job

TASK = "Walker2d-v5"
CHANGES = {"none": ("", ""), "σ learned": ("", "sigma-learned"), "no tanh, actions clipped": ("", "no-tanh"),
           "gradients clipped at 0.5": ("", "gradients-clipped"),
           "no KL limit": (" --max-kl 1e9", ""),
           "all four": (" --max-kl 1e9", "like-sb3")}
JOBS = [Job(PPO, TASKS[TASK] + options, change, seed)
        for seed in range(81, 86) for options, change in CHANGES.values()]


def draw(rows):
    usual = study.final_rows(study.read("returns")).set_index("options").loc[TASKS[TASK], "return"]
    *_, learners = RACES["race"]
    sb3 = curves_of(learners, TASK, "return", study.read("race"))[f"sb3, {BEST[TASK]}"]
    found = {name: rows[(rows["options"] == TASKS[TASK] + options) & (rows["change"] == change)]
             for name, (options, change) in CHANGES.items()}
    found = {**found, f"sb3, {BEST[TASK]}": sb3[sb3["steps"] == 1]}
    gains = [compare.welch(runs["return"], usual) for runs in found.values()]
    lines = [[f"{name} ({len(runs)})", compare.spread(runs["return"]), str(gain)]
             for (name, runs), gain in zip(found.items(), gains)]
    p_values = compare.marked([gain.p for gain in gains])
    return {"walker": pages.table(
        ["change (seeds)", "return", "minus ours as it is, 95%", "p"],
        [[f"none ({len(usual)})", compare.spread(usual), "", ""],
         *([*line, p] for line, p in zip(lines, p_values))])}


if __name__ == "__main__":
    study.main(JOBS, draw)
