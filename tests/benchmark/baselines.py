"""REINFORCE: the returns with each baseline, and the noise of the gradient that each leaves."""

import numpy as np
import pandas as pd
import seaborn as sns
import torch
from benchmark import common
from benchmark.common import REINFORCE, Job, number

FIGURES = ("baselines",)
BASELINES = "none", "mean", "value"
HALFWAY = 100  # return in training of the policy for which the noise is measured
BATCHES = 500


def jobs(quick):
    found = [job for name in BASELINES
             for job in common.training_jobs(REINFORCE, quick, f"--baseline {name}")]
    noise = "noise 2 3" if quick else f"noise {HALFWAY} {BATCHES}"
    return [*found, Job(REINFORCE, part=noise)]


def measure(job):
    if not job.part:
        return common.train(job)
    _, threshold, count = job.part.split()
    return common.fresh(measure_noise, job.seed, float(threshold), int(count))


def halfway_agent(seed, threshold):
    """Environment and agent of a training whose last 20 returns average `threshold`."""
    args, returns = common.load(REINFORCE).parse_args(["--baseline", "mean"]), []
    envs, agent, updates = common.begin(REINFORCE, args, seed)
    for _, episodes, _ in updates:
        returns += [row["return"] for row in episodes]
        if len(returns) >= 20 and np.mean(returns[-20:]) >= threshold:
            return args, envs, agent
    raise ValueError(f"no 20 episodes average {threshold:g}")


def fit_critic(agent, batches, steps=300):
    """Fit V to the returns of `batches`."""
    obs = torch.cat([batch.obs for batch in batches])
    returns = torch.cat([batch.returns for batch in batches])
    optimizer = torch.optim.Adam(agent.critic.parameters(), 1e-2)
    for _ in range(steps):
        optimizer.zero_grad()
        (((agent.value(obs) - returns) ** 2).mean() / 2).backward()
        optimizer.step()


def policy_gradients(agent, batch):
    """The estimates of one batch, (3, number of parameters)."""
    script = common.load(REINFORCE)
    values, log_probs = agent.value(batch.obs), agent.policy(batch.obs).log_prob(batch.actions)
    rows = []
    for baseline in BASELINES:
        advantages = script.compute_advantages(batch.returns, values, baseline)
        loss = script.policy_loss(log_probs, advantages)
        gradient = torch.autograd.grad(loss, list(agent.actor.parameters()), retain_graph=True)
        rows.append(torch.nn.utils.parameters_to_vector(gradient))
    return torch.stack(rows)


def measure_noise(seed, threshold, count):
    """Many batches of one policy: the total variance of its gradient, for each baseline."""
    script = common.load(REINFORCE)
    args, envs, agent = halfway_agent(seed, threshold)
    envs.reset(seed=script.make_seeds(seed, stream=1000, count=1))  # not an episode of training
    torch.manual_seed(seed)
    batches = [script.rollout(envs, agent, args, 0)[0] for _ in range(count + 50)]
    fit_critic(agent, batches[count:])  # on batches of its own
    gradients = torch.stack([policy_gradients(agent, x) for x in batches[:count]], 1).double()
    variance = gradients.var(1).sum(-1)  # the trace of the covariance
    length = sum(len(x.obs) for x in batches[:count]) / count / args.batch_episodes
    return pd.DataFrame({"env_id": args.env_id, "baseline": BASELINES, "variance": variance,
                         "length_mean": length})


def report(data, draw):
    noise = data[data["part"].ne("")].set_index("baseline")["variance"]
    runs = data[data["part"].eq("")].copy()
    runs["baseline"] = runs["flags"].str.extract(r"--baseline (\w+)", expand=False)
    last = common.last_rows(runs)
    rows = []
    for name in BASELINES:
        x = last[last["baseline"] == name]
        rows.append([f"`{name}`", f"{noise[name] / noise['none']:.2f}",
                     *(", ".join(number(y, 0) for y in x[column])
                       for column in ("return_mean", "train_return"))])
    figure = common.figure(11, 3.4)
    panels = figure.subplots(1, 4, sharey=False)
    for axis, name in zip(panels, BASELINES):
        sns.lineplot(common.in_bins(runs[runs["baseline"] == name], "train_return", "env_id"),
                     x="env_step", y="train_return", units="seed", estimator=None, ax=axis)
        axis.set(ylim=(0, 1050), ylabel="mean return, last 100 episodes",
                 title=f"--baseline {name}")
        common.steps_axis(axis)
    relative = noise / noise["none"]
    panels[3].bar(relative.index, relative)
    panels[3].set(title="noise of the gradient", ylabel="total variance, relative to none")
    draw(figure, "baselines")
    header = ["`--baseline`", "variance", "return in evaluation, each seed",
              "in training, last 100 episodes"]
    return {"returns": common.table(header, rows)}
