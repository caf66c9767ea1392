"""What the exercises 4 to 8 and 10 to 12 give, with the seeds of their sheet. Half an hour."""

import compare
import numpy as np
import pages
import study
import torch
from ablation import with_change
from compare import number
from study import Job
from variants import A2C, PPO

LANDER, PENDULUM = Job(A2C), Job(PPO)
CHEETAH = Job(PPO, "--env-id HalfCheetah-v5 --total-steps 3e5")
POLE = Job(A2C, "--env-id CartPole-v1 --total-steps 3e5 --gamma 0.99")
RUN = {  # number: what the answers call it, without, the change
    4: ("`--gae-lambda 0`", LANDER, "--gae-lambda 0"),
    5: ("`--clip-eps 1e9`", PENDULUM, "--clip-eps 1e9"),
    6: ("`--epochs 1`", CHEETAH, "--epochs 1"),
    7: ("σ = 0.03", CHEETAH, "--first-std 0.03 --last-std 0.03"),
    8: ("time is up: a fall", POLE, "time-limits-as-deaths")}
SHORT = "--total-steps 32768"
FIND = {"right": "", "10": "fault-1", "11": "fault-2", "12": "fault-3",
        "rewards": "rewards-not-scaled"}
SHOWN = {"last eval_return": 0, "first return": 0, "last return": 0,
         "median value_loss": 3, "first explained_variance": 2, "median explained_variance": 2,
         "median kl": 3, "median clip_fraction": 3}  # with so many digits
JOBS = [*(with_change(job, change, seed) for seed in range(1, 6) for _, job, change in
          [*(("", job, "") for job in (LANDER, PENDULUM, CHEETAH, POLE)), *RUN.values()]),
        *(Job(PPO, SHORT, change, seed) for seed in (1, 2, 3) for change in FIND.values())]


def measure(job):
    """The first, the median and the last of each column of the log; of CartPole the mean V, too."""
    module, args = study.load(job)
    log, weights = study.run(module, args)
    words = {"first": log.iloc[0], "median": log.median(), "last": log.iloc[-1]}
    row = {f"{word} {name}": x for word, of_log in words.items() for name, x in of_log.items()}
    if job.options == POLE.options:
        row["mean V"] = mean_value(module, args, weights)
    return [row]


def mean_value(module, args, weights):
    """Of the states in 500 steps of the trained agent."""
    envs, values = module.make_envs(args, 1), []
    agent = module.Agent(envs.single_observation_space, envs.single_action_space, args.hidden_size)
    agent.load_state_dict(weights)
    obs, _ = envs.reset(seed=1)
    for _ in range(500):
        values.append(agent.value(torch.tensor(obs)).item())
        obs, *_ = envs.step(agent.act(obs, deterministic=True))
    envs.close()
    return np.mean(values)


def cell(values, digits):
    return ", ".join(number(x, digits) if round(x, digits) else "0" for x in values)


def apart(some, others):
    """Is each of some farther from each of the others than any two of the same kind are?"""
    return np.abs(np.subtract.outer(some, others)).min() > max(np.ptp(some), np.ptp(others))


def draw(rows):
    rows = rows.set_index(study.KEYS[:3]).sort_index()
    run, find = [], []
    for exercise, (name, job, change) in RUN.items():
        usual, changed = rows.loc[job[:3]], rows.loc[with_change(job, change)[:3]]
        returns = changed["last eval_return"], usual["last eval_return"]
        gain = compare.welch(*returns)
        verdict = "none that five seeds show"
        if gain.p < 0.01:
            verdict = f"an effect, for the {'better' if gain.gain > 0 else 'worse'}"
        medians = []
        for column in ["explained_variance", "kl"] if job.script == PPO else ["explained_variance"]:
            means = (runs[f"median {column}"].mean() for runs in (usual, changed))
            medians.append(" → ".join(number(x, SHOWN[f"median {column}"]) for x in means))
        medians += [""] * (2 - len(medians))
        run.append([exercise, name, compare.spread(returns[1]), compare.spread(returns[0]),
                    str(gain), compare.p_text(gain.p), verdict, *medians])
    for name, digits in SHOWN.items():
        right, *copies = (rows.loc[(PPO, SHORT, change), name].to_numpy()
                          for change in FIND.values())
        find.append([f"{name.replace(' ', ' `')}`", cell(right, digits),
                     *(f"**{cell(copy, digits)}**" if apart(copy, right) else cell(copy, digits)
                       for copy in copies)])
    poles = {name: rows.loc[job[:3]].sort_values("seed")
             for name, job in (("without", POLE), ("with", with_change(POLE, RUN[8][2])))}
    value = [[name, *(f"{number(V, 1)}, {number(last)}" for V, last in zip(
        runs["mean V"], runs["last eval_return"]))] for name, runs in poles.items()]
    return {
        "value": pages.table(["exercise 8: mean V, return", *poles["with"]["seed"]], value),
        "run": pages.table(["", "change", "without (± std)", "with (± std)", "difference, 95%",
                            "p", "verdict", "median `explained_variance`", "median `kl`"], run),
        "find": pages.table(["seeds 1, 2, 3", *FIND], find)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
