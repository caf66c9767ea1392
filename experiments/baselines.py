"""REINFORCE: what is a baseline for? Returns with each, and the noise that each leaves."""

import numpy as np
import study
import torch
from study import Job, number
from variants import REINFORCE

BASELINES, BATCHES = ("none", "mean", "value"), 300
NOISE = "--total-steps 10000"  # a short run, for whose policy the noise is measured
JOBS = [Job(REINFORCE, options, seed=seed) for seed in range(101, 111)
        for options in (NOISE, *(f"--baseline {name}" for name in BASELINES))]


def measure(job):
    row, weights = study.train(job)
    return row | variances(job, weights) if job.options == NOISE else row


def variances(job, weights):
    """Of the gradient of a batch, with each baseline, summed over the actor's weights."""
    module, args = study.load(job)
    env = module.make_env(args.env_id)
    env.reset(seed=job.seed)
    agent = module.Agent(env.observation_space, env.action_space, args.hidden_size)
    agent.load_state_dict(weights)
    gradients = {name: [] for name in BASELINES}
    for _ in range(BATCHES):
        obs, actions, rewards, last_values = zip(
            *[module.play(env, agent) for _ in range(args.batch_episodes)])
        obs, actions = torch.cat(obs), torch.cat(actions)
        G = torch.cat([module.compute_rewards_to_go(r, last_value, args.gamma)
                       for r, last_value in zip(rewards, last_values)])
        for name in BASELINES:
            A = module.compute_advantages(G, agent.value(obs).detach(), name)
            log_probs = agent.policy(obs).log_prob(actions).sum(-1)
            loss = module.policy_loss(log_probs, A, args.batch_episodes)
            gradient = torch.autograd.grad(loss, agent.actor.parameters())
            gradients[name].append(torch.cat([x.flatten() for x in gradient]))
    return {f"variance {name}": torch.stack(x).double().var(0).sum().item()
            for name, x in gradients.items()}


def draw(rows):
    noise = rows[rows["options"] == NOISE]
    titles = {}
    for name in BASELINES:
        left = (noise[f"variance {name}"] / noise["variance none"]).mean()
        titles[f"--baseline {name}"] = f"{name}: variance {number(left, 2)}"
    rows = rows.assign(title=rows["options"].map(titles)).dropna(subset="title")
    lines = study.curves(rows, np.arange(0, 100_001, 5000))
    return {}, {"baselines": study.seeds_and_mean(lines, "title", col_order=titles.values())}


if __name__ == "__main__":
    study.main("baselines", JOBS, measure)
