# /// script
# requires-python = ">=3.11"
# dependencies = ["torch>=2.6", "gymnasium[mujoco]>=1.3", "mujoco>=3.1,<3.16", "numpy>=1.26",
#     "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.31", "tqdm>=4.66"]
# ///
"""PPO: proximal policy optimisation for continuous actions, in one file.

    python ppo_continuous.py --seed 1 2 3               # or: uv run ppo_continuous.py --seed 1
    python ppo_continuous.py --watch runs/…/seed-1.pt   # replays an agent and films it

The first command trains three agents side by side to balance a double pendulum on a cart, and
leaves logs, agents and a figure in a new folder in runs/. In a good run the return in evaluation,
without noise, climbs within a minute to 9,300; the most is 9,360, and random actions earn 50.

At every step the agent observes the state s (here of cart and poles), draws an action a from its
policy π(a|s), and gets a reward r, until the episode ends. We want a high *return*, the sum of all
rewards of an episode. Two neural networks learn:

    the actor   π(a|s) = Normal(μ(s), σ²)   which actions to take; it learns μ, and we set σ
    the critic  V(s)                        the mean *reward to go* if π acts from s on:
                                            G_t = r_t + γ·r_{t+1} + γ²·r_{t+2} + …

γ makes distant rewards count less: with 0.99, one 100 steps away counts 0.37. The *advantage* A of
an action is the mean of G if we take it now and then follow π, minus V(s). A *rollout* of recorded
steps gives noisy estimates of it. Actions that did better than the others become more likely, the
rest less. In REINFORCE and A2C the actor takes one gradient step on a rollout; in PPO [1] many, to
get more out of it. But a rollout only shows what its own policy, π_old, did, so π must stay near
π_old. One update:

  1. Anneal: the learning rate falls to 0, and σ from 0.6 to 0.2: explore widely first, then settle.
  2. Collect a rollout: T steps in each of N environments.
  3. Scale the rewards, so that V's targets, here up to 936, are of the order of 1: to predict more,
     V's weights must grow, but Adam moves each by about the learning rate, however large the error.
  4. Estimate the advantages A (GAE [2]). A + V(s) then estimates the mean of G: the target for V.
  5. Go through the rollout several times, in minibatches, and on each take a gradient step on
         −mean(min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)) + ½·mean((V(s) − target)²)
     with A standardised. ρ = π(a|s)/π_old(a|s) says how many times as likely an action has become;
     the clip takes the gradient away once ρ has gone far enough in A's direction (`policy_loss`).
     Before each step measure how far π has moved: if KL(π_old ‖ π) exceeds max_kl, go on to 6.
  6. Update the statistics that normalise observations: last, so that ρ and KL compare π with the
     policy that drew the actions. Start again at 1.

PPO itself is 2, 4, and 5 without standardising A or max_kl. The rest is mostly as in [4], but there
σ is learned, actions are clipped, time limits count as deaths, and Adam's ε is 1e-5. Left out:
clipping of rewards, gradients and value loss; an entropy bonus, which rewards a wide π (as we set
σ, its gradient would be 0). `--env-id` takes other tasks; `mlp` makes the networks.

In the code: s obs, a actions, V values, A advantages, ρ ratio, ε clip_eps, λ gae_lambda, σ sigma.
In shapes: T rollout_steps, N num_envs, B a minibatch, D numbers in an observation, K in an action.
[1] Schulman et al. 2017, Proximal Policy Optimization Algorithms, arXiv 1707.06347.
[2] Schulman et al. 2016, Generalized Advantage Estimation, arXiv 1506.02438.
[3] Pardo et al. 2018, Time Limits in Reinforcement Learning, arXiv 1712.00378.
[4] Huang et al. 2022, The 37 Implementation Details of Proximal Policy Optimization.
"""

import argparse
import os
import sys
import time
from pathlib import Path
from typing import NamedTuple

import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
import pandas as pd
import seaborn as sns
import torch
from matplotlib.figure import Figure
from torch import Tensor, nn
from tqdm import tqdm

# --- Agent ----------------------------------------------------------------------------------------


class Agent(nn.Module):
    """The actor π(a|s) and the critic V(s). Both see normalised observations."""

    def __init__(self, obs_space, action_space, hidden_size):
        super().__init__()
        inputs, outputs = obs_space.shape[0], action_space.shape[0]
        self.obs_stats = RunningStatistics(inputs)
        self.actor = mlp(inputs, hidden_size, outputs, last_gain=0.01)
        self.critic = mlp(inputs, hidden_size, 1, last_gain=1.0)
        self.register_buffer("sigma", torch.ones(outputs))  # set by `train`

    def policy(self, obs):
        """Observations (…, D) -> π(·|s): a Gaussian for each of the K numbers of an action."""
        mean = self.actor(self.obs_stats.normalise(obs))
        return torch.distributions.Normal(mean, self.sigma)

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,), in units of scaled rewards."""
        return self.critic(self.obs_stats.normalise(obs)).squeeze(-1)

    @torch.no_grad()
    def act(self, obs, deterministic=False):
        """NumPy observations (N, D) -> NumPy actions (N, K): drawn from π, or its mean μ."""
        policy = self.policy(torch.tensor(obs))
        return (policy.mean if deterministic else policy.sample()).numpy()


class RunningStatistics(nn.Module):
    """Mean and variance of all rows so far, for each dimension; before the first, 0 and 1."""

    def __init__(self, *shape):
        super().__init__()
        self.register_buffer("mean", torch.zeros(shape, dtype=torch.float64))
        self.register_buffer("var", torch.ones(shape, dtype=torch.float64))
        self.register_buffer("std", torch.ones(shape, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.int64))

    def normalise(self, x):
        """To mean 0 and standard deviation 1, clipped so that no outlier dominates the networks."""
        return ((x - self.mean) / self.std).clamp(-10, 10).float()

    def update(self, rows):
        """Merge in new `rows` (…, *shape), whose weight w is their share of all rows so far.

            mean ← (1−w)·mean + w·mean_new
            var  ← (1−w)·var + w·var_new + w·(1−w)·(mean_new − mean)²
        """
        rows = rows.reshape(-1, *self.mean.shape).double()
        self.count += len(rows)
        w = len(rows) / self.count.item()
        self.var.lerp_(rows.var(0, correction=0) + (1 - w) * (rows.mean(0) - self.mean) ** 2, w)
        self.mean.lerp_(rows.mean(0), w)
        # A dimension that has never changed has variance 0, but for rounding. It gets std 1.
        self.std.copy_(torch.where(self.var > 1e-16 * self.mean**2, self.var.sqrt(), 1.0))


def mlp(inputs, hidden, outputs, last_gain):
    """Two hidden layers, orthogonal weights; a small `last_gain` starts π alike in all states."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain)):  # √2 is customary
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


def squash(actions, space):
    """Map unbounded actions (N, K) into the bounds of the action space: a part of the environment.

    PPO sees a as drawn. (The density of the squashed one has one more factor, which cancels in ρ.)
    """
    inside = space.low + (np.tanh(actions) + 1) / 2 * (space.high - space.low)
    return inside.clip(space.low, space.high).astype(space.dtype)  # rounding may go beyond


# --- The steps of an update -----------------------------------------------------------------------


class Transitions(NamedTuple):
    """What happened in T steps of N environments."""

    obs: Tensor  # (T, N, D)
    actions: Tensor  # (T, N, K), as drawn; `envs.step` squashes them
    rewards: Tensor  # (T, N)
    next_obs: Tensor  # (T, N, D): what followed the action, even if the episode ended there
    terminated: Tensor  # (T, N), bool: the episode ended for good, so no reward can follow
    done: Tensor  # (T, N), bool: terminated, or truncated, say by a time limit


def rollout(envs, agent, obs, earned, num_steps):
    """2. T steps of each environment, from `obs` (N, D) on; its episode has `earned` (N,) so far.

    `envs.step` takes N actions and returns arrays with a row for each environment. Episodes end at
    different steps; `envs.reset` restarts those in its mask, but only after the transition is
    stored, so `next_obs` is what really followed the action, never the start of another episode.
    Returns Transitions; `obs` and `earned` to go on from; and the returns of episodes that ended.
    """
    rows, returns = [], []
    for _ in range(num_steps):
        actions = agent.act(obs)
        next_obs, rewards, terminated, truncated, _ = envs.step(actions)
        done = terminated | truncated
        rows.append((obs, actions, rewards, next_obs, terminated, done))
        obs, earned = next_obs, earned + rewards
        if done.any():
            returns += earned[done].tolist()
            earned[done] = 0
            obs, _ = envs.reset(options={"reset_mask": done})
    columns = (torch.tensor(np.stack(column)) for column in zip(*rows))
    return Transitions(*columns), obs, earned, returns


def scale_rewards(rewards, done, F, stats, gamma):
    """3. Divide rewards (T, N) by the standard deviation of all F so far:

        F_t = r_t + γ·F_{t−1},  from 0 in each new episode.

    We would divide by the spread of V's targets, but these contain V, which is already scaled. F,
    the same sum over the past, needs rewards only. (If all F are equal, rewards are not scaled.) No
    mean is subtracted: that would change what a long episode is worth. `F` is where to start from,
    (N,) or 0. Returns the scaled rewards, and the F to go on from.
    """
    sums = torch.empty_like(rewards)
    for t in range(len(rewards)):
        sums[t] = rewards[t] + gamma * F
        F = sums[t] * ~done[t]
    stats.update(sums)
    return (rewards / stats.std).float(), F


def compute_gae(rewards, values, next_values, terminated, done, gamma, gae_lambda):
    """4. Generalised advantage estimation: returns A; all are (T, N) ([2] eq. 11 and 16).

        δ_t = r_t + γ·V(s_{t+1}) − V(s_t)               how much better one step was than expected
        A_t = δ_t + γλ·δ_{t+1} + (γλ)²·δ_{t+2} + …
            = δ_t + γλ·A_{t+1}                          so one pass backwards computes them all

    The sum ends with the last δ of an episode or of the rollout. In this last δ_t:
        terminated      no reward can follow, so V(s_{t+1}) counts as 0
        truncated       V(s_{t+1}) stands for what would have followed without a time limit [3]
        end of rollout  V(s_{t+1}) stands for the rest of the episode

    For example three steps that each earn 1, with V = 4 everywhere, γ = 0.9 and λ = 0.5:
        terminated     δ = 0.6, 0.6, −3     A = 0.26, −0.75, −3
        truncated      δ = 0.6, 0.6, 0.6    A = 0.99, 0.87, 0.6

    Why sum several δ? If V were exact, the mean of δ_t would be the advantage of a_t: r_t +
    γ·V(s_{t+1}) is what we got and may still expect, V(s_t) what we expected before. Later δ would
    have mean 0, and only add noise. But a learned V is wrong. λ = 0 keeps all its error: A_t = δ_t.
    With λ = 1 all V but the first and the last cancel: A_t = r_t + γ·r_{t+1} + … − V(s_t), plus
    γⁿ·V(s_{t+n}) if a time limit or the rollout's end cuts the sum. Those rewards were really
    earned, with all their noise. Other λ are a compromise: δ_{t+k} counts λ^k times as much.
    """
    next_values = next_values.masked_fill(terminated, 0)
    advantages = rewards + gamma * next_values - values  # at first only δ
    for t in reversed(range(len(advantages) - 1)):
        advantages[t] += gamma * gae_lambda * advantages[t + 1] * ~done[t]
    return advantages


def policy_loss(ratio, advantages, clip_eps):
    """−mean(min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)); ρ and A are (B,) ([1] eq. 7).

    Take one action from π, then go on with π_old: how much more do we earn than with π_old alone? A
    says how much better an action is than what π_old does on average, so the answer is the mean of
    A over π's actions. We only have π_old's actions, so each is weighted by ρ:

        ∫ π·A da = ∫ π_old·(π/π_old)·A da = E[ρ·A]     a drawn from π_old, as in the rollout

    The states are π_old's, too: nearly right while π is near π_old. As ∇ρ = ρ·∇log π, the gradient
    at ρ = 1, where an update starts, is E[A·∇log π], as in REINFORCE and A2C. Farther away the
    estimate gets worse, so a sample drops out once ρ has gone far enough in A's direction:

                    ρ < 1−ε                1−ε ≤ ρ ≤ 1+ε      ρ > 1+ε
        A > 0       ρ·A: raise ρ           ρ·A: raise ρ       (1+ε)·A: no gradient
        A < 0       (1−ε)·A: no gradient   ρ·A: lower ρ       ρ·A: lower ρ

    Where ρ has gone the wrong way, the gradient stays, to lead it back. The clip only removes
    gradients. It does not hold π: one step may jump past 1 ± ε, Adam's momentum carries on, and
    other samples move the same weights. Hence max_kl, as a second brake.
    """
    clipped_ratio = ratio.clamp(1 - clip_eps, 1 + clip_eps)
    return -torch.min(ratio * advantages, clipped_ratio * advantages).mean()


def optimise(agent, optimizer, samples, *, epochs, minibatch_size, clip_eps, max_kl):
    """5. Gradient steps on all T·N samples: obs, actions, μ_old, log π_old(a|s), A, targets.

    A KL above max_kl ends them, the critic's too. Returns metrics of the last minibatch: `kl` may
    exceed max_kl, as the step before, which went too far, is not undone; `clip_fraction` counts all
    ρ outside 1 ± ε, also those that keep their gradient. As π and π_old are Gaussians with one σ,

        KL(π_old ‖ π) = ½·Σ((μ − μ_old)/σ)²       summed over the K numbers of an action

    averaged over a minibatch. With K = 1 the default limit, 0.03, is a move of μ by about σ/4; more
    numbers share it.
    """
    for _ in range(epochs):
        for rows in torch.randperm(len(samples[0])).split(minibatch_size):
            obs, actions, old_means, old_log_probs, A, targets = (x[rows] for x in samples)
            policy = agent.policy(obs)
            ratio = (policy.log_prob(actions).sum(-1) - old_log_probs).exp()
            kl = (((policy.mean - old_means) / agent.sigma) ** 2).sum(-1).mean() / 2
            loss_v = ((agent.value(obs) - targets) ** 2).mean() / 2
            metrics = {"value_loss": loss_v.item(), "kl": kl.item(),
                       "clip_fraction": ((ratio - 1).abs() > clip_eps).float().mean().item()}
            if kl > max_kl:
                return metrics
            # Standardised, as is customary. The mean acts as a baseline (but contains A itself).
            A = (A - A.mean()) / (A.std(correction=0) + 1e-8)
            optimizer.zero_grad()
            (policy_loss(ratio, A, clip_eps) + loss_v).backward()  # each trains its own network
            optimizer.step()
    return metrics


# --- Training -------------------------------------------------------------------------------------


def train(index, args, folder):
    """Train the agent of `args.seed[index]`; leave its log and its weights in `folder`.

    The log has a row for each update: `env_step` and `seconds` so far; `return`, the mean of the
    training episodes that ended in it, if any did; the metrics of `optimise`; and after some
    updates `eval_return`, without noise, so usually higher.
    """
    seed, folder, log = args.seed[index], Path(folder), []
    torch.set_num_threads(1)  # more would round differently, and not be faster here
    torch.manual_seed(seed)
    envs = make_envs(args, args.num_envs, "Disabled")
    eval_envs = make_envs(args, args.eval_episodes)
    obs, _ = envs.reset(seed=1000 * seed)
    agent = Agent(envs.single_observation_space, envs.single_action_space, args.hidden_size)
    optimizer = torch.optim.Adam(agent.parameters(), fused=True)  # fused: faster
    reward_stats, F, earned = RunningStatistics(), 0.0, 0.0

    steps = args.rollout_steps * args.num_envs  # of an update
    num_updates = int(np.ceil(args.total_steps / steps))
    evaluations = np.linspace(1, num_updates, 1 + args.num_evals).round()
    bar = tqdm(range(1, 1 + num_updates), unit=" steps", unit_scale=steps, disable=index > 0)
    start = time.perf_counter()
    for update in bar:
        # 1. Anneal: ever less exploration, ever smaller steps.
        remaining = 1 - (update - 1) / num_updates
        optimizer.param_groups[0]["lr"] = remaining * args.learning_rate
        agent.sigma.fill_(remaining * args.first_std + (1 - remaining) * args.last_std)
        # 2. Collect a rollout.
        batch, obs, earned, returns = rollout(envs, agent, obs, earned, args.rollout_steps)
        # 3. Scale the rewards.
        rewards, F = scale_rewards(batch.rewards, batch.done, F, reward_stats, args.gamma)
        # 4. Estimate advantages and targets, which are constants in 5, like π_old.
        with torch.no_grad():
            old_pi = agent.policy(batch.obs)
            old_log_probs = old_pi.log_prob(batch.actions).sum(-1)
            # V(next_obs) is not values[1:]: the next row may be another episode's.
            values, next_values = agent.value(batch.obs), agent.value(batch.next_obs)
        advantages = compute_gae(rewards, values, next_values, batch.terminated, batch.done,
                                 gamma=args.gamma, gae_lambda=args.gae_lambda)
        targets = advantages + values
        # 5. Update actor and critic, on one list of samples: (T, N, …) -> (T·N, …).
        samples = (batch.obs, batch.actions, old_pi.mean, old_log_probs, advantages, targets)
        metrics = optimise(agent, optimizer, [x.flatten(0, 1) for x in samples],
                           epochs=args.epochs, minibatch_size=args.minibatch_size,
                           clip_eps=args.clip_eps, max_kl=args.max_kl)
        # 6. Update the statistics, last.
        agent.obs_stats.update(batch.obs)

        # How well V predicts its targets (which contain V): 1 perfectly, 0 like a constant. Its
        # errors are the advantages. Blank if targets vary by less than a tenth of their mean.
        unexplained = advantages.square().mean() / targets.var(correction=0)
        alike = targets.std(correction=0) < targets.mean().abs() / 10
        metrics["explained_variance"] = np.nan if alike else 1 - unexplained.item()
        log.append({"env_step": update * steps, "seconds": time.perf_counter() - start,
                    "return": np.mean(returns) if returns else np.nan, **metrics})
        if update in evaluations:
            log[-1]["eval_return"] = evaluate(agent, eval_envs, seed)
            bar.set_postfix(eval_return=f"{log[-1]['eval_return']:.1f}")
            folder.mkdir(parents=True, exist_ok=True)
            pd.DataFrame(log).to_csv(folder / f"seed-{seed}.csv", index=False)
            torch.save({"agent": agent.state_dict(), "options": {**vars(args), "seed": [seed]}},
                       folder / f"seed-{seed}.pt")
    envs.close()
    eval_envs.close()


# ==================================================================================================
# Below: plumbing, not the algorithm
# ==================================================================================================


def parse_args(argv=None, known=None):
    parser = argparse.ArgumentParser(formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.error = lambda message: sys.exit(f"{message} (see --help)")
    add = parser.add_argument
    add("--seed", type=bounded(int, 0), nargs="+", default=[1], help="seeds, one agent each")
    add("--total-steps", type=bounded(int, 1), default=150_000, help="steps per agent, at least")
    add("--env-id", default="InvertedDoublePendulum-v5", help="Gymnasium id or my_module:MyEnv-v0")
    add("--watch", type=Path, metavar="AGENT.pt", help="do not train, but film this agent")
    add("--out-dir", default="runs", help="where the folder of this run is created")
    add("--num-evals", type=bounded(int, 1), default=20, help="evaluations after a first one")
    add("--eval-episodes", type=bounded(int, 1), default=10, help="episodes of an evaluation")
    add("--num-envs", type=bounded(int, 1), default=16, help="environments stepped together")
    add("--rollout-steps", type=bounded(int, 1), default=128, help="steps per environment")
    add("--epochs", type=bounded(int, 1), default=10, help="passes over a rollout, at most")
    add("--minibatch-size", type=bounded(int, 2), default=512, help="samples in a minibatch")
    add("--learning-rate", type=bounded(float, 0), default=1e-3, help="falls linearly to 0")
    add("--gamma", type=bounded(float, 0, 1), default=0.99, help="discount factor")
    add("--gae-lambda", type=bounded(float, 0, 1), default=0.95, help="0 trusts V, 1 the rewards")
    add("--clip-eps", type=bounded(float, 0), default=0.2, help="clips the ratio at 1 +- this")
    add("--max-kl", type=bounded(float, 0), default=0.03, help="KL that ends the gradient steps")
    add("--first-std", type=bounded(float, 1e-4), default=0.6, help="initial sigma, before tanh")
    add("--last-std", type=bounded(float, 1e-4), default=0.2, help="final sigma, before tanh")
    add("--hidden-size", type=bounded(int, 1), default=64, help="units of each hidden layer")
    return parser.parse_args(argv, known)  # values in `known` replace the defaults


def bounded(kind, low, high=1e12):
    """An argparse type: an int (also written 1e6) or float from `low` to `high`."""

    def number(text):
        value = float(text)
        if not low <= value <= high or value != kind(value):
            raise argparse.ArgumentTypeError(f"{text}: not {kind.__name__} from {low} to {high:g}")
        return kind(value)

    return number


def make_envs(args, count, autoreset_mode="NextStep", **kwargs):
    """A vector of `count` environments. "NextStep": they reset themselves; else `rollout` does."""
    envs = gym.make_vec(args.env_id, count, "sync", **kwargs,
                        vector_kwargs={"autoreset_mode": autoreset_mode})
    obs_space, space = envs.single_observation_space, envs.single_action_space
    flat = all(isinstance(x, gym.spaces.Box) and len(x.shape) == 1 for x in (obs_space, space))
    if not flat or space.dtype.kind != "f" or np.abs([space.low, space.high]).max().item() > 1e30:
        raise gym.error.Error(f"needs flat Boxes, actions bounded floats; has {obs_space}, {space}")
    return gym.wrappers.vector.TransformAction(envs, lambda actions: squash(actions, space))


def evaluate(agent, envs, seed, before_step=lambda step: None):
    """The mean return of an episode in each environment: deterministic, always the same starts.

    Without a time limit, that of the first 1,000 steps.
    """
    obs, _ = envs.reset(seed=1_000_000 + 1000 * seed)  # other seeds than in training
    returns, playing = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    for step in range(envs.spec.max_episode_steps or 1000):
        before_step(step)
        obs, rewards, terminated, truncated, _ = envs.step(agent.act(obs, deterministic=True))
        returns[playing] += rewards[playing]  # finished ones play on, but no longer count
        playing &= ~(terminated | truncated)
        if not playing.any():
            break
    return returns.mean()


def watch(path, argv=()):
    """Play an episode of a saved agent: print its return; a GIF beside `path` shows its start."""
    os.environ.setdefault("MUJOCO_GL", "egl" if sys.platform == "linux" else "glfw")  # off screen
    saved = torch.load(path, weights_only=True)
    args = parse_args(argv, argparse.Namespace(**saved["options"]))  # typed ones win
    envs = make_envs(args, 1, render_mode="rgb_array")
    agent = Agent(envs.single_observation_space, envs.single_action_space, args.hidden_size)
    agent.load_state_dict(saved["agent"])
    fps, frames = envs.metadata.get("render_fps") or 20, []
    every = max(1, fps // 25)  # steps per frame

    def film(step):
        if step % every == 0 and len(frames) < 200:
            frames.append(envs.render()[0].copy())

    print("return:", evaluate(agent, envs, args.seed[0], film))
    envs.close()
    imageio.imwrite(Path(path).with_suffix(".gif"), frames, duration=1000 * every / fps, loop=0)


def plot(folder):
    """Draw learning_curve.png: on top returns, pale those of training; below, the metrics."""
    files = sorted(Path(folder).glob("seed-*.csv"))
    log = pd.concat([pd.read_csv(file).assign(seed=file.stem) for file in files], ignore_index=True)
    metrics = log.columns.drop(["env_step", "seconds", "return", "eval_return", "seed"])
    figure = Figure(figsize=(12, 8), layout="constrained")
    axes = figure.subplot_mosaic([["return"] * len(metrics), list(metrics)], height_ratios=(3, 1))
    for name in "return", "eval_return", *metrics:
        sns.lineplot(log, x="env_step", y=name, hue="seed", estimator=None, marker=".", mew=0,
                     ax=axes.get(name, axes["return"]), alpha=0.4 if name == "return" else 1.0,
                     legend=name == "eval_return" and len(files) <= 10)
    axes["return"].set(title=Path(folder).name, ylabel="return (pale: in training)")
    axes["explained_variance"].set_ylim(-1, 1.05)
    figure.savefig(Path(folder, "learning_curve.png"))
    print(folder, log.groupby("seed")[["env_step", "eval_return"]].last(), sep="\n")


def main():
    sys.path.append(os.getcwd())  # `my_module` of --env-id may lie here
    args = parse_args()
    if args.watch:
        return watch(args.watch.absolute(), sys.argv[1:])
    name = f"{args.env_id}__{Path(__file__).stem}__{pd.Timestamp.now():%Y%m%d_%H%M%S%f}"
    folder = Path(args.out_dir, name.replace(":", "-").replace("/", "-")).absolute()
    try:
        make_envs(args, 1).close()  # a trial: a wrong name gets a line, not a traceback
    except (gym.error.Error, ImportError) as error:
        sys.exit(f"--env-id {args.env_id}: {error}")
    try:
        if len(args.seed) == 1:
            train(0, args, folder)
        else:  # train(0, args, folder), train(1, …), …, each in a process
            torch.multiprocessing.spawn(train, (args, folder), len(args.seed))
    finally:  # also after Ctrl-C
        for process in torch.multiprocessing.active_children():
            process.terminate()
        if any(folder.glob("seed-*.csv")):
            plot(folder)


if __name__ == "__main__":
    main()
