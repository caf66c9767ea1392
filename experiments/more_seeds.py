"""More seeds of PPO on four tasks, and what stable-baselines3 does otherwise on Walker2d.

Run after the ten seeds of `returns`: on HalfCheetah, our best task, on Hopper, where these seemed
lucky, and on the double pendulum, where two of them fell late, 111 to 120; on Walker2d, where they
were below stable-baselines3, the seeds 81 to 85 and the changes first, then, when the first two of
these were known, 111 to 120. Four hours on two cores.
"""

import compare
import pages
import pandas as pd
import study
from race import BEST, finals_of
from returns import PENDULUM, TASKS
from study import Job
from variants import PPO

WALKER = "Walker2d-v5"
PEERS = {**{task: f"sb3, {setting}" for task, setting in BEST.items()}, PENDULUM: "CleanRL"}
CHANGES = {"none": ("", ""),
           "σ learned": ("", "sigma-learned"),
           "no tanh, actions clipped": ("", "no-tanh"),
           "gradients clipped at 0.5": ("", "gradients-clipped"),
           "no KL limit": (" --max-kl 1e9", ""),
           "all four": (" --max-kl 1e9", "like-sb3")}
JOBS = [*(Job(PPO, TASKS[task], seed=seed) for task in PEERS for seed in range(111, 121)),
        *(Job(PPO, TASKS[WALKER], seed=seed) for seed in range(81, 86)),
        *(Job(PPO, TASKS[WALKER] + options, change, seed)
          for options, change in list(CHANGES.values())[1:] for seed in (81, 82))]


def samples(rows):
    """{task: {which seeds: their returns}}; Hopper's 81 to 88 are those of the ablation."""
    planned, ablation = study.final_rows(study.read("returns")), study.read("ablation")
    found = {}
    for task in PEERS:
        first, earlier, more = (
            x[(x["options"] == TASKS[task]) & (x["change"] == "")].set_index("seed")["return"]
            for x in (planned, ablation, rows))
        earlier = pd.concat([earlier, more]).sort_index().loc[:100]
        of_task = {"101 to 110, as planned": first}
        if len(earlier):
            of_task[f"{earlier.index[0]} to {earlier.index[-1]}"] = earlier
        of_task["111 to 120"] = more.loc[111:]
        found[task] = {**of_task, f"all {sum(map(len, of_task.values()))}": pd.concat(of_task)}
    return found


def line(task, seeds, returns, peer):
    gain = compare.welch(returns, peer)
    return [task[:-3], seeds, compare.spread(returns), compare.number(returns.median()),
            compare.number(returns.min()), str(gain), compare.p_text(gain.p)]


def draw(rows):
    lines = []
    for task, of_task in samples(rows).items():
        peer = finals_of(task, study.read("race"))[PEERS[task]]
        lines += [line(task, seeds, returns, peer) for seeds, returns in of_task.items()]
    found = rows.set_index(["options", "change", "seed"])["return"]
    changes = [[name, *(compare.number(found[TASKS[WALKER] + options, change, seed])
                        for seed in (81, 82))] for name, (options, change) in CHANGES.items()]
    return {"more seeds": pages.table(
                ["task", "our seeds", "return", "median", "lowest", "minus the best peer", "p"],
                lines),
            "walker changes": pages.table(["change", "seed 81", "seed 82"], changes)}


if __name__ == "__main__":
    study.main(JOBS, draw)
