"""REINFORCE: what is a baseline for? Returns with each, and the noise that each leaves.

The noise is the variance of the gradient, for the agent of a short run. Some ten minutes.
"""

import numpy as np
import seaborn as sns
import study
import torch
from study import REINFORCE, Job, number

BASELINES, EARLY = ("none", "mean", "value"), 30_000
NOISE = "--total-steps 10000"  # the run for whose policy noise is measured
JOBS = [Job(REINFORCE, options, seed=seed) for seed in range(71, 81)
        for options in (NOISE, *(f"--baseline {name}" for name in BASELINES))]


def measure(job):
    rows, weights = study.train(job)
    if not job.options.startswith(NOISE):
        return rows
    module, args = study.load(job)
    (env,) = module.make_envs(args, 1).envs
    env.reset(seed=job.seed)
    agent = module.Agent(env.observation_space, env.action_space, args.hidden_size)
    agent.load_state_dict(weights)
    batches = [play(module, args, env, agent) for _ in range(300)]
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
    loss = module.policy_loss(agent.policy(obs).log_prob(actions).sum(-1), advantages)
    return torch.cat([x.flatten() for x in torch.autograd.grad(loss, agent.actor.parameters())])


def draw(rows):
    noise = rows[rows["options"] == NOISE]
    variance, early, whole, lines = {}, {}, {}, []
    for name in BASELINES:
        runs = rows[rows["options"] == f"--baseline {name}"].groupby("seed")
        variance[name] = noise[f"variance_{name}"] / noise["variance_none"]
        early[name] = [np.interp(EARLY, run["steps"], run["return"]) for _, run in runs]
        whole[name] = runs["return"].mean()
        tests = [study.welch(returns[name], returns["none"]) for returns in (early, whole)]
        p_early, p_whole = (study.p_text(test.p) if name != "none" else "" for test in tests)
        lines.append([f"`{name}`", study.spread(variance[name], 2),
                      study.spread(early[name]), p_early, study.spread(whole[name]), p_whole,
                      study.proportion(runs["return"].last() >= 950),
                      number(runs["sampled"].last().mean())])
    picture, panels = study.figure(11, 4, 1, 3)
    titles = ("variance of the gradient, none = 1", f"return after {EARLY:,} steps",
              "mean return over a run")
    for axis, title, dots in zip(panels, titles, (variance, early, whole)):
        sns.pointplot(dots, errorbar=None, linestyle="none", marker="_", markersize=50, ax=axis)
        sns.swarmplot(dots, color="black", ax=axis)
        axis.set(xlabel="--baseline", ylabel="", title=title, ylim=(0, None))
    picture.suptitle("REINFORCE on InvertedPendulum: ten seeds (dots), their mean (line)")
    study.save(picture, "baselines")
    header = ["`--baseline`", *titles[:2], "p", titles[2], "p", "solved (95%)", "in training"]
    return {"baselines": study.table(header, lines)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
