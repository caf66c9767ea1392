"""Which defaults should PPO have? Candidates against today's, on seeds used for nothing else.

The rule, fixed before the first run: a candidate is taken if the geometric mean over the five tasks
of its mean return, divided by the default's on the same seeds, is at least 1.05 and none of the
five ratios is below 0.92; or if it at least halves the lost pendulums and that mean is at least
0.98. A pendulum is lost if its episode ends before the time limit.

With --only Pendulum or another task only a part is measured; the table is of what is there.
"""

import gymnasium as gym
import numpy as np
import study
from study import PPO, Job, number

PENDULUM = "--env-id InvertedDoublePendulum-v5 --num-evals 1 --eval-episodes 150"
TASKS = {f"--env-id {task}-v5 --total-steps 1e6 --num-evals 1 --eval-episodes 50": task
         for task in ("HalfCheetah", "Hopper", "Walker2d", "Ant", "Humanoid")}
CANDIDATES = [("", ""), ("--last-std 0.15", ""), ("--last-std 0.2", ""), ("--last-std 0.3", ""),
              ("", "critic-goes-on"), ("--learning-rate 7e-4", ""), ("--learning-rate 5e-4", ""),
              ("--gae-lambda 0.92", "")]  # options, change
JOBS = [Job(PPO, f"{options} {typed}".strip(), change, seed)
        for seed in range(701, 717) for options in (PENDULUM, *(TASKS if seed <= 706 else ()))
        for typed, change in CANDIDATES]


class CountLost(gym.vector.VectorWrapper):
    """Counts first episodes that ended before the time limit."""

    def __init__(self, envs):
        super().__init__(envs)
        self.playing, self.lost = np.ones(envs.num_envs, dtype=bool), 0

    def step(self, actions):
        obs, rewards, terminated, truncated, infos = super().step(actions)
        self.lost += (self.playing & terminated & ~truncated).sum()
        self.playing &= ~(terminated | truncated)
        return obs, rewards, terminated, truncated, infos


def measure(job):
    """The last evaluation."""
    module, args = study.load(job)
    evaluate, counted = module.evaluate, []

    def evaluate_and_count(agent, envs, seed):
        counted.append(CountLost(envs))
        return evaluate(agent, counted[-1], seed)

    module.evaluate = evaluate_and_count
    log, _ = study.run(module, args)
    final = log.iloc[-1]
    return [{"steps": final["env_step"], "seconds": final["seconds"],
             "return": final["eval_return"], "lost": counted[-1].lost}]


def pairs(rows, options, candidate):
    """A row for each seed that has run with the candidate and as usual; of both all columns."""
    typed, change = candidate
    usual = rows[(rows["options"] == options) & (rows["change"] == "")]
    tried = rows[(rows["options"] == f"{options} {typed}".strip()) & (rows["change"] == change)]
    return usual.merge(tried, on="seed", suffixes=("_usual", ""))


def draw(rows):
    lines = []
    for candidate in CANDIDATES if len(rows) else ():
        found = {task: pairs(rows, options, candidate) for options, task in TASKS.items()}
        means = {task: x[["return", "return_usual"]].mean() for task, x in found.items() if len(x)}
        ratios = {task: mean["return"] / mean["return_usual"] for task, mean in means.items()}
        mean = np.exp(np.mean(np.log([*ratios.values()]))) if ratios else np.nan
        lowest = min(ratios.values(), default=np.nan)
        pendulum = pairs(rows, PENDULUM, candidate)
        lost, usual = pendulum["lost"].sum(), pendulum["lost_usual"].sum()
        better = mean >= 1.05 and lowest >= 0.92 or 2 * lost <= usual > 0 and mean >= 0.98
        lines.append([f"`{' '.join(candidate).strip() or 'default'}`",
                      *(f"{ratios[x]:.2f} ({len(found[x])})" if x in ratios else ""
                        for x in TASKS.values()), number(mean, 2), number(lowest, 2),
                      f"{lost} of {150 * len(pendulum)}", usual, "yes" if better else "no"])
    return {"trials": study.table(
        ["candidate", *(f"{x} ÷ default (seeds)" for x in TASKS.values()), "geometric mean",
         "lowest", "lost", "default: lost", "taken"], lines)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
