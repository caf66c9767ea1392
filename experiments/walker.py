"""What helps stable-baselines3 on Walker2d? Its differences from ours, one by one and together.

Forty minutes on two cores.
"""

import compare
import pages
import study
from returns import TASKS
from study import PPO, Job

TASK = "Walker2d-v5"
CHANGES = {"none": ("", ""),
           "σ learned": ("", "sigma-learned"),
           "no tanh, actions clipped": ("", "no-tanh"),
           "gradients clipped at 0.5": ("", "gradients-clipped"),
           "no KL limit": (" --max-kl 1e9", ""),
           "all four": (" --max-kl 1e9", "like-sb3")}
JOBS = [Job(PPO, TASKS[TASK] + options, change, seed)
        for seed in range(81, 86) for options, change in CHANGES.values()]


def draw(rows):
    returns = rows.set_index(["options", "change", "seed"])["return"]
    found = {name: returns.loc[TASKS[TASK] + options, change]
             for name, (options, change) in CHANGES.items()}
    usual = found.pop("none")
    gains = {name: compare.paired(changed - usual) for name, changed in found.items()}
    p_values = compare.marked([gain.p for gain in gains.values()])
    return {"walker": pages.table(
        ["change", "return (± std)", "gain, 95%", "p"],
        [["none", compare.spread(usual), "", ""],
         *([name, compare.spread(found[name]), str(gain), p]
           for (name, gain), p in zip(gains.items(), p_values))])}


if __name__ == "__main__":
    study.main(JOBS, draw)
