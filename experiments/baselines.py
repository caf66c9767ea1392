"""REINFORCE: what is a baseline for? Returns with each, and the noise that each leaves.

The noise is the variance of the gradient, for the agent of a short run. Some ten minutes.
"""

import compare
import numpy as np
import pages
import pandas as pd
import seaborn as sns
import study
import torch
from study import Job
from variants import REINFORCE

BASELINES, STEPS, EARLY = ("none", "mean", "value"), range(0, 100_001, 5000), 30_000
BATCHES = 300  # of whose gradients the variance is taken
NOISE = "--total-steps 10000"  # the run for whose policy noise is measured
JOBS = [Job(REINFORCE, options, seed=seed) for seed in range(71, 81)
        for options in (NOISE, *(f"--baseline {name}" for name in BASELINES))]


def measure(job):
    rows, weights = study.train(job)
    if not job.options.startswith(NOISE):
        return rows
    module, args = study.load(job)
    env = module.make_env(args.env_id)
    env.reset(seed=job.seed)
    agent = module.Agent(env.observation_space, env.action_space, args.hidden_size)
    agent.load_state_dict(weights)
    batches = [play(module, args, env, agent) for _ in range(BATCHES)]
    rows = rows.tail(1)
    for name in BASELINES:
        gradients = [gradient(module, agent, name, *batch) for batch in batches]
        rows[f"variance_{name}"] = torch.stack(gradients).double().var(0).sum().item()
    return rows


def play(module, args, env, agent):
    """A batch: observations, actions, rewards to go."""
    episodes = [module.play(env, agent) for _ in range(args.batch_episodes)]
    obs, actions, rewards, last_values = zip(*episodes)
    rewards_to_go = [module.compute_rewards_to_go(r, last_value, args.gamma)
                     for r, last_value in zip(rewards, last_values)]
    return torch.cat(obs), torch.cat(actions), torch.cat(rewards_to_go)


def gradient(module, agent, baseline, obs, actions, rewards_to_go):
    advantages = module.compute_advantages(rewards_to_go, agent.value(obs).detach(), baseline)
    loss = module.policy_loss(agent.policy(obs).log_prob(actions).sum(-1), advantages, 1)
    return torch.cat([x.flatten() for x in torch.autograd.grad(loss, agent.actor.parameters())])


def draw(rows):
    noise = rows[rows["options"] == NOISE]
    variance, curves, early, whole, lines, tests = {}, {}, {}, {}, [], []
    for name in BASELINES:
        runs = rows[rows["options"] == f"--baseline {name}"].groupby("seed")
        variance[name] = noise[f"variance_{name}"] / noise["variance_none"]
        curves[name] = pd.DataFrame(  # batches of different seeds end at different steps
            {seed: np.interp(STEPS, run["steps"], run["return"]) for seed, run in runs}, STEPS)
        early[name], whole[name] = curves[name].loc[EARLY], runs["return"].mean()
        tests += [compare.welch(returns[name], returns["none"]).p for returns in (early, whole)]
        lines.append([f"`{name}`", compare.spread(variance[name], 2),
                      compare.spread(early[name]), compare.spread(whole[name])])
    for i, p in enumerate(compare.marked(tests[2:])):  # those of "none" compare it with itself
        lines[1 + i // 2][2 + i % 2] += f", p {p}"
    picture, (left, middle, right) = pages.figure(13, 6, 1, 3)
    found = dict(zip(BASELINES[1:], compare.holm(tests[2:]).reshape(-1, 2).any(1)))
    faster = " and ".join(name for name in found if found[name])
    titles = ("variance of the gradient after\n10,000 steps (none: 1)",
              f"return, averaged over the run\n(significantly above none: {faster or 'no other'})")
    for axis, dots, title in zip((left, right), (variance, whole), titles):
        sns.swarmplot(dots, color="black", size=6, ax=axis)
        for i, name in enumerate(BASELINES):
            axis.plot([i - 0.3, i + 0.3], 2 * [dots[name].mean()], f"C{i}", lw=4)
        axis.set(xlabel="--baseline", ylabel="", title=title, ylim=(0, None))
    middle.remove()
    stack = middle.get_subplotspec().subgridspec(3, 1).subplots(sharex=True, sharey=True)
    for i, (axis, name) in enumerate(zip(stack, BASELINES)):
        for other in BASELINES:
            axis.plot(curves[other].mean(axis="columns"), color="silver", lw=2)
        axis.plot(curves[name], color=f"C{i}", lw=0.7)
        axis.plot(curves[name].mean(axis="columns"), color=f"C{i}", lw=4)
        axis.axhline(950, color="black", lw=1)
        axis.text(99_000, 60, name, ha="right")
    stack[0].set_title("return: ten seeds, their mean,\nothers' means (grey), solved (black)")
    stack[-1].set(xlabel="steps", xticks=[0, 50_000, 100_000], yticks=[0, 500, 1000])
    stack[-1].xaxis.set_major_formatter("{x:,.0f}")
    verdict = f"with {faster} it learns faster" if faster else "faster learning may be chance"
    picture.suptitle("A baseline makes REINFORCE's gradient less noisy (InvertedPendulum);\n"
                     + verdict)
    pages.save(picture, "baselines")
    return {"baselines": pages.table(
        ["`--baseline`", "variance of the gradient, none = 1", f"return after {EARLY:,} steps",
         "mean return over a run"], lines)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
