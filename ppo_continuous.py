# /// script
# requires-python = ">=3.10,<3.14"
# dependencies = ["torch>=2.6,<2.14", "gymnasium[mujoco]>=1.4,<1.5", "numpy>=1.26", "tqdm>=4.66",
#     "mujoco>=3.1,<3.16", "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.31"]
# ///
"""PPO: proximal policy optimisation for continuous actions, in one file.

    python ppo_continuous.py --seed 1 2 3               # or: uv run ppo_continuous.py --seed 1
    python ppo_continuous.py --watch runs/…/seed-1.pt   # replays an agent and films it

The first command trains three agents side by side to balance a double pendulum on a cart, and
leaves logs, agents and a figure in a new folder in runs/. In a good run the return climbs within a
minute from 50, which random actions earn, to 9,300; the most is 9,360.

At every step the agent observes the state s of its environment (here: cart and poles), draws an
action a from its policy π(a|s), and gets a reward r, until the episode ends. We want a high
*return*, the sum of all rewards of an episode. Two neural networks learn:

    the actor   π(a|s) = Normal(μ(s), σ²)   which actions to take; it learns μ, and we set σ
    the critic  V(s)                        the mean *reward to go* from s on, if π acts:
                                            G_t = r_t + γ·r_{t+1} + γ²·r_{t+2} + …

With γ a little below 1, rewards more than some 3/(1−γ) steps away hardly count: they usually owe
little to the action at t. The *advantage* A of an action is how far the mean of G exceeds V(s) if
we take it in s, then follow π. A *rollout* of recorded steps gives noisy estimates, like G − V(s).
Actions with A > 0 become more likely, those with A < 0 less. Simpler algorithms, like A2C, take one
gradient step on a rollout; PPO [1] takes many, to get more out of it. But a rollout only shows what
its own policy, π_old, did, so π must stay near π_old. One update:

  1. Anneal, linearly: the learning rate to 0; σ, the exploration noise, from 0.6 to 0.2.
  2. Collect a rollout: T steps in each of N environments.
  3. Scale the rewards, so that what V has to predict has a similar spread in every task.
  4. Estimate the advantages A (GAE [2]). A + V(s) then estimates the mean of G: the target for V.
  5. Go through the rollout several times, in minibatches. On each, measure how far π has moved: if
     KL(π_old ‖ π) exceeds max_kl, go on to 6. Otherwise take a gradient step on
         −mean(min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)) + ½·mean((V(s) − target)²)
     with A standardised. ρ = π(a|s)/π_old(a|s) says how many times as likely an action has become;
     the clip takes the gradient away once ρ has gone far enough in A's direction (`policy_loss`).
  6. Update the statistics that normalise observations. Start again at 1.

PPO itself is 2, 4, and the minibatches and loss of 5. The rest is usual [4], except σ's schedule,
tanh on actions, and a KL check before each step. Left out: an entropy bonus; clipping of rewards,
gradients and value loss.

In the code: s obs, a actions, V values, A advantages, ρ ratio, ε clip_eps, λ gae_lambda, σ sigma.
In shapes: T rollout_steps, N num_envs, B a minibatch, D numbers in an observation, K in an action.
[1] Schulman et al. 2017, Proximal Policy Optimization Algorithms, arXiv 1707.06347.
[2] Schulman et al. 2016, Generalized Advantage Estimation, arXiv 1506.02438.
[3] Pardo et al. 2018, Time Limits in Reinforcement Learning, arXiv 1712.00378.
[4] Huang et al. 2022, The 37 Implementation Details of Proximal Policy Optimization.
[5] Kakade and Langford 2002, Approximately Optimal Approximate Reinforcement Learning.
"""

import argparse
import copy
import os
import random
import signal
import sys
import time
from contextlib import closing
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
        return torch.distributions.Normal(mean, self.sigma, validate_args=False)  # for speed

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,), in units of scaled rewards."""
        return self.critic(self.obs_stats.normalise(obs)).squeeze(-1)

    @torch.no_grad()
    def act(self, obs, deterministic=False):
        """NumPy observations (N, D) -> NumPy actions (N, K): drawn from π, or its mean μ."""
        policy = self.policy(torch.tensor(obs))
        return (policy.mean if deterministic else policy.sample()).numpy()


class RunningStatistics(nn.Module):
    """Mean and variance of all rows seen so far, for each dimension; at first 0 and 1."""

    def __init__(self, *shape):
        super().__init__()
        self.register_buffer("mean", torch.zeros(shape, dtype=torch.float64))
        self.register_buffer("var", torch.ones(shape, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.int64))

    def std(self):
        """The standard deviation, or 1 for a constant, whose variance is only rounding."""
        return torch.where(self.var > 1e-16 * self.mean**2, self.var.sqrt(), 1.0)

    def normalise(self, x):
        """To mean 0 and standard deviation 1, clipped so that no outlier dominates the networks."""
        return ((x - self.mean) / self.std()).clamp(-10, 10).float()

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


def mlp(inputs, hidden, outputs, last_gain):
    """Two hidden layers, orthogonal weights; a small `last_gain` starts π alike in all states."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain)):  # √2 is customary
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


def squash(actions, space):
    """Map unbounded actions (N, K) into the bounds of the action space.

    This counts as part of the environment: PPO sees the action a as drawn, and its density π(a|s).
    (The squashed action's density has one more factor, the same in π and π_old, so ρ is the same.)
    """
    share = (np.tanh(actions) + 1) / 2
    inside = (1 - share) * space.low + share * space.high
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


def rollout(envs, agent, obs, num_steps):
    """2. T steps of each environment, from observations `obs` (N, D) on.

    `envs.step` takes N actions and returns arrays with a row for each environment. Episodes end at
    different steps; `envs.reset` restarts those in its mask, but only after the transition is
    stored, so `next_obs` is what really followed the action, never the start of another episode.
    Returns Transitions, the observations to go on from, and the returns of episodes that ended.
    """
    steps, returns = [], []
    for _ in range(num_steps):
        actions = agent.act(obs)
        next_obs, rewards, terminated, truncated, infos = envs.step(actions)
        done = terminated | truncated
        steps.append((obs, actions, rewards, next_obs, terminated, done))
        obs = next_obs
        if done.any():
            returns += infos["episode"]["r"][done].tolist()  # set by RecordEpisodeStatistics
            obs, _ = envs.reset(options={"reset_mask": done})
    columns = (torch.tensor(np.stack(column)) for column in zip(*steps))  # transposed
    return Transitions(*columns), obs, returns


def scale_rewards(rewards, done, past_rewards, stats, gamma):
    """3. Divide rewards (T, N) by the standard deviation of all F so far:

        F_t = r_t + γ·F_{t−1},  from 0 in each new episode.

    V predicts the discounted sum of later rewards. F is that of past ones: already known, and
    usually spread about as much. While F does not vary, rewards stay as they are. `past_rewards`
    is the F to start from, (N,) or 0. Returns the scaled rewards, and the F to go on from.
    """
    sums = torch.empty_like(rewards)
    for t in range(len(rewards)):
        sums[t] = rewards[t] + gamma * past_rewards
        past_rewards = sums[t] * ~done[t]
    stats.update(sums)
    return (rewards / stats.std()).float(), past_rewards


def compute_gae(rewards, values, next_values, terminated, done, gamma, gae_lambda):
    """4. Generalised advantage estimation; all (T, N) ([2] eq. 11 and 16).

        δ_t = r_t + γ·V(s_{t+1}) − V(s_t)               how much better one step was than expected
        A_t = δ_t + γλ·δ_{t+1} + (γλ)²·δ_{t+2} + …
            = δ_t + γλ·A_{t+1}                          so one pass backwards computes them all

    The sum ends with the last δ of an episode or of the rollout. In this last δ_t:
        terminated      no reward can follow, so V(s_{t+1}) counts as 0
        truncated       V(s_{t+1}) stands for what would have followed without a time limit [3]
        end of rollout  V(s_{t+1}) stands for the rest of the episode

    Why may V stand for what follows? An exact V is its mean. Then δ_t alone is right on average,
    and later δ, with mean 0, only add noise: any λ is right, 0 the best. But a learned V errs, and
    a larger λ lets in less of its error, but more noise:
        λ = 0      A_t = δ_t: little noise, but all of V's error
        λ = 1      all V in between cancel. With n terms, A_t = r_t + … + γ^n·V(s_{t+n}) − V(s_t),
                   with less of V's error, but more noise. If the episode terminates there, its
                   last V is 0, and this is REINFORCE with the baseline V
        otherwise  in between: δ_{t+k} counts λ^k times as much as for λ = 1
    """
    advantages = rewards + gamma * next_values * ~terminated - values  # at first only δ
    for t in reversed(range(len(advantages) - 1)):
        advantages[t] += gamma * gae_lambda * advantages[t + 1] * ~done[t]
    return advantages


def policy_loss(ratio, advantages, clip_eps):
    """−mean(min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)); ρ and A are (B,) ([1] eq. 7).

    How much better is π than π_old? Take one action from π, then go on with π_old. As A says what
    an action adds to V, the mean of G rises by

        ∫ π·A da = ∫ π_old·(π/π_old)·A da = E[ρ·A]     a drawn from π_old, as in the rollout

    Summed with weights γ^t over the states that π meets, this is the exact gain in discounted
    return [5]. PPO maximises E[ρ·A] over the states that π_old has met, which is nearly the same
    while π is near π_old, and drops γ^t, with which late steps would hardly count. At ρ = 1, where
    an update starts, its gradient is E[A·∇log π], as in A2C, because ∇ρ = ρ·∇log π. Farther away
    the estimate gets worse, so a sample drops out once ρ has gone far enough in the direction of A:

                    ρ < 1−ε                1−ε ≤ ρ ≤ 1+ε      ρ > 1+ε
        A > 0       ρ·A: raise ρ           ρ·A: raise ρ       (1+ε)·A: no gradient
        A < 0       (1−ε)·A: no gradient   ρ·A: lower ρ       ρ·A: lower ρ

    Where ρ has gone the wrong way, the gradient stays, to lead it back. The clip alone does not
    keep π near: all samples share the weights, so others can still push ρ out. Hence max_kl.
    """
    clipped_ratio = ratio.clamp(1 - clip_eps, 1 + clip_eps)
    return -torch.min(ratio * advantages, clipped_ratio * advantages).mean()


def optimise(agent, optimizer, samples, *, epochs, minibatch_size, clip_eps, max_kl):
    """5. Gradient steps on all T·N samples: obs, actions, μ_old, log π_old(a|s), A, targets.

    Returns metrics of the last minibatch. Its `kl` may be above max_kl, as the step before is not
    undone; `clip_fraction` counts every ρ outside 1 ± ε, also those that keep their gradient. As π
    and π_old are Gaussians with the same σ,

        KL(π_old ‖ π) = ½·Σ((μ − μ_old)/σ)²       summed over the K numbers of an action

    and averaged over states. With K = 1 the default limit, 0.03, is a move of μ by about σ/4.
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
            # Standardised: one scale in all tasks; the mean is one more baseline.
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
    # If one seed fails, the others get SIGTERM: handle it like Ctrl-C, and close environments.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    seed = args.seed[index]
    with (closing(make_envs(args, seed, args.eval_episodes)) as eval_envs,
          closing(make_envs(args, seed, args.num_envs, "Disabled")) as envs,
          tqdm(total=args.total_steps, disable=index > 0) as bar):
        make_repeatable(seed)  # the initial weights, and all that follows
        agent = Agent(envs.single_observation_space, envs.single_action_space, args.hidden_size)
        optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate, fused=True)  # faster
        reward_stats, past_rewards = RunningStatistics(), 0.0
        log, env_step, evals_done, start = [], 0, 0, time.perf_counter()
        obs, _ = envs.reset(seed=make_seeds(seed, stream=2, count=args.num_envs))
        while env_step < args.total_steps:
            # 1. Anneal: ever less exploration, ever smaller steps.
            remaining = 1 - env_step / args.total_steps
            optimizer.param_groups[0]["lr"] = remaining * args.learning_rate
            agent.sigma.fill_(remaining * args.first_std + (1 - remaining) * args.last_std)
            # 2. Collect a rollout.
            batch, obs, returns = rollout(envs, agent, obs, args.rollout_steps)
            check_finite(f"a reward of {args.env_id}", batch.rewards.float())
            # 3. Scale the rewards.
            rewards, past_rewards = scale_rewards(
                batch.rewards, batch.done, past_rewards, reward_stats, args.gamma)
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
            # 6. Update the statistics, last, so that 2 to 5 all normalise in the same way.
            agent.obs_stats.update(batch.obs)

            # How well V predicted its targets (target − V = A), up to a constant: 1 perfectly, 0
            # like a constant, below 0 worse. If targets hardly vary, it says nothing.
            metrics["explained_variance"] = 1 - (advantages.var() / targets.var()).item()
            weights = nn.utils.parameters_to_vector(agent.parameters())
            check_finite("a weight (is --learning-rate too large?)", weights.detach())
            env_step += rewards.numel()
            bar.update(min(env_step, args.total_steps) - bar.n)
            log.append({"env_step": env_step, "seconds": time.perf_counter() - start,
                        "return": np.mean(returns) if returns else np.nan, **metrics})
            # After the first update, then each time another 1/num_evals of the steps is done.
            if env_step * args.num_evals >= evals_done * args.total_steps:
                evals_done += 1
                log[-1]["eval_return"] = evaluate(agent, eval_envs, seed)
                bar.set_postfix(eval_return=round(log[-1]["eval_return"], 1))
                save(folder / f"seed-{seed}", log, agent, {**vars(args), "seed": [seed]})


# --- Options --------------------------------------------------------------------------------------


def parse_args(argv=None, known=None):
    """The options in `argv` (None: the command line); values in `known` replace the defaults."""
    parser = argparse.ArgumentParser(formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.error = lambda message: sys.exit(f"{message} (see --help)")
    add = parser.add_argument
    add("--seed", type=in_range(int, 0), nargs="+", default=[1], help="seeds, one agent each")
    add("--total-steps", type=in_range(int, 1), default=150_000, help="steps per agent, at least")
    add("--env-id", default="InvertedDoublePendulum-v5", help="Gymnasium id or my_module:MyEnv-v0")
    add("--watch", type=Path, metavar="AGENT.pt", help="do not train, but film this agent")
    add("--out-dir", default="runs", help="where the folder of this run is created")
    add("--num-evals", type=in_range(int, 1), default=20, help="evaluations after a first one")
    add("--eval-episodes", type=in_range(int, 1), default=10, help="episodes of an evaluation")
    add("--num-envs", type=in_range(int, 1), default=16, help="environments stepped together")
    add("--rollout-steps", type=in_range(int, 1), default=128, help="steps per environment")
    add("--epochs", type=in_range(int, 1), default=10, help="passes over a rollout, at most")
    add("--minibatch-size", type=in_range(int, 2), default=512, help="samples in a minibatch")
    add("--learning-rate", type=in_range(float, 0), default=1e-3, help="falls linearly to 0")
    add("--gamma", type=in_range(float, 0, 1), default=0.99, help="discount factor")
    add("--gae-lambda", type=in_range(float, 0, 1), default=0.95, help="0 trusts V, 1 the rewards")
    add("--clip-eps", type=in_range(float, 0), default=0.2, help="clips the ratio at 1 +- this")
    add("--max-kl", type=in_range(float, 0), default=0.03, help="KL that ends the gradient steps")
    add("--first-std", type=in_range(float, 1e-4), default=0.6, help="initial sigma, before tanh")
    add("--last-std", type=in_range(float, 1e-4), default=0.2, help="final sigma, before tanh")
    add("--hidden-size", type=in_range(int, 1), default=64, help="units of each hidden layer")
    return parser.parse_args(argv, known)


def in_range(kind, low, high=1e12):
    """An argparse type: a number from `low` to `high`; 1e6 counts as an int."""

    def number(text):
        value = float(text)
        if not low <= value <= high or value != kind(value):
            raise argparse.ArgumentTypeError(f"{text}: not {kind.__name__} from {low} to {high:g}")
        return kind(value)

    return number


# ==================================================================================================
# Below: plumbing, not the algorithm
# ==================================================================================================


def make_seeds(seed, stream, count):
    """Seeds below 2³¹, different in each stream: 0 global generators, 1 evaluation, 2 training."""
    return (np.random.SeedSequence([seed, stream]).generate_state(count) // 2).tolist()


def make_repeatable(seed):
    """Seed all global generators, and compute in one thread."""
    torch.set_num_threads(1)  # more would round differently, and not be faster here
    for set_seed in torch.manual_seed, np.random.seed, random.seed:
        set_seed(make_seeds(seed, stream=0, count=1)[0])


def make_envs(args, seed, count, autoreset_mode="NextStep", **kwargs):
    """A vector of `count` environments. "NextStep": they reset themselves; else `rollout` does."""
    make_repeatable(seed)  # so that what environments draw when made is repeatable
    envs = gym.make_vec(
        args.env_id, count, "sync", wrappers=[Tidy, gym.wrappers.RecordEpisodeStatistics],
        vector_kwargs={"autoreset_mode": autoreset_mode}, **kwargs)
    obs_space, space = envs.single_observation_space, envs.single_action_space
    if not (all(isinstance(x, gym.spaces.Box) and len(x.shape) == 1 for x in (obs_space, space))
            and space.dtype.kind == "f" and np.abs([space.low, space.high]).max().item() < 1e30):
        envs.close()
        raise gym.error.Error("needs flat Boxes of observations and of actions, floats with bounds "
                              f"(see docs/guide.md); has {obs_space} and {space}")
    envs = gym.wrappers.vector.TransformObservation(
        envs, lambda obs: check_finite(f"an observation of {args.env_id}", obs.astype(float)))
    return gym.wrappers.vector.TransformAction(envs, lambda actions: squash(actions, space))


class Tidy(gym.Wrapper):
    """An environment with an empty `info`, rewards that are numbers, and spaces of its own.

    Some environments draw from their spaces, and some classes share them among all environments.
    Seeding a shared one in an evaluation would disturb training, so here each gets a copy.
    """

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            for i, name in enumerate(("observation_space", "action_space"), start=1):
                vars(self.unwrapped)[name] = copy.deepcopy(getattr(self.unwrapped, name))
                # Fetch it again: if it is a property, our copy does not count.
                getattr(self.unwrapped, name).seed(seed + i)
        # Where the vector has taken out its mask, {} is left, which some environments refuse.
        return self.env.reset(seed=seed, options=options or None)[0], {}

    def step(self, action):
        obs, reward, terminated, truncated, _ = self.env.step(action)
        return obs, np.asarray(reward).item(), terminated, truncated, {}


def check_finite(name, x):
    """Return x. ValueError if a number in it is NaN or infinite."""
    if not np.isfinite(np.asarray(x)).all():
        raise ValueError(f"{name} is NaN or infinite")
    return x


def evaluate(agent, envs, seed, before_step=lambda step: None):
    """The mean return of one episode in each environment, without noise in the actions.

    Always from the same starts; it leaves the global generators as they were. Without a time limit
    it ends after 1,000 steps. `before_step(step)` is called before each step.
    """
    states = np.random.get_state(), random.getstate(), torch.get_rng_state()
    make_repeatable(seed)
    obs, _ = envs.reset(seed=make_seeds(seed, stream=1, count=envs.num_envs))
    returns, playing = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    for step in range(envs.spec.max_episode_steps or 1000):
        before_step(step)
        obs, rewards, terminated, truncated, _ = envs.step(agent.act(obs, deterministic=True))
        returns += np.where(playing, rewards, 0)  # finished ones play on, but no longer count
        playing &= ~(terminated | truncated)
        if not playing.any():
            break
    for restore, state in zip((np.random.set_state, random.setstate, torch.set_rng_state), states):
        restore(state)
    return check_finite(f"a return of {envs.spec.id}", returns).mean().item()


def save(path, log, agent, options):
    """Write new files, then put them in place of the old ones, so that none is ever cut short."""
    pd.DataFrame(log).to_csv(f"{path}.csv.new", index=False)
    torch.save({"agent": agent.state_dict(), "options": options, "script": Path(__file__).name},
               f"{path}.pt.new")
    for suffix in "csv", "pt":
        Path(f"{path}.{suffix}.new").replace(f"{path}.{suffix}")


def watch(path):
    """Print a saved agent's mean return; film up to 200 frames of an episode in a GIF beside it.

    Options are those of its training, except for those typed now.
    """
    os.environ.setdefault("MUJOCO_GL", "egl" if sys.platform == "linux" else "glfw")  # off screen
    try:
        saved = torch.load(path, weights_only=True)
        if saved["options"].keys() != vars(parse_args([])).keys():
            sys.exit(f"--watch {path}: watch it with the {saved['script']} that made it")
        args = parse_args(known=argparse.Namespace(**saved["options"]))
        seed = args.seed[0]
        with closing(make_envs(args, seed, args.eval_episodes)) as envs:
            agent = Agent(envs.single_observation_space, envs.single_action_space, args.hidden_size)
            agent.load_state_dict(saved["agent"])
            print("return:", evaluate(agent, envs, seed))
        with (closing(make_envs(args, seed, 1, render_mode="rgb_array")) as envs,
              imageio.imopen(path.with_suffix(".gif"), "w", plugin="pillow") as film):
            fps = envs.metadata.get("render_fps") or 20
            every = max(1, fps // 25)  # steps per frame
            duration = round(1000 * every / fps, -1)  # in milliseconds; GIFs store tens

            def film_step(step):
                if step % every == 0 and step < 200 * every:
                    film.write(envs.render()[0], bits=8, duration=duration, loop=0)

            evaluate(agent, envs, seed, film_step)
    except Exception as error:
        sys.exit(f"--watch {path}: {error!r}")


def plot(folder):
    """Draw learning_curve.png; print the last evaluation of each seed.

    Pale: the mean return of the training episodes that ended in an update's batch. Below: metrics.
    """
    files = sorted(folder.glob("*.csv"), key=lambda file: int(file.stem.removeprefix("seed-")))
    log = pd.concat([pd.read_csv(file).assign(seed=file.stem) for file in files], ignore_index=True)
    metrics = list(log.columns.drop(["env_step", "seconds", "return", "eval_return", "seed"]))
    figure = Figure(figsize=(12, 8), layout="constrained")
    axes = figure.subplot_mosaic([["return"] * len(metrics), metrics], height_ratios=(3, 1))
    for name in "return", "eval_return", *metrics:
        sns.lineplot(log, x="env_step", y=name, hue="seed", estimator=None,
                     ax=axes.get(name, axes["return"]), legend=name == "eval_return",
                     alpha=0.4 if name == "return" else 1.0)
    axes["return"].set(title=folder.name, ylabel="return (pale: in training)")
    axes["explained_variance"].set_ylim(-1, 1)
    figure.savefig(folder / "learning_curve.png")
    print(folder, log.groupby("seed", sort=False)[["env_step", "eval_return"]].last(), sep="\n")


def main():
    sys.path.append(str(Path.cwd()))  # `my_module` of --env-id may lie here
    args = parse_args()
    if args.watch:
        return watch(args.watch)
    if len(set(args.seed)) < len(args.seed):
        sys.exit("--seed: each only once")
    name = f"{args.env_id}__{Path(__file__).stem}__{pd.Timestamp.now():%Y%m%d_%H%M%S%f}"
    folder = Path(args.out_dir).expanduser() / name.replace(":", "-").replace("/", "-")
    try:
        # A trial: errors here get a one-line message.
        with closing(make_envs(args, args.seed[0], 1)) as envs:
            folder.mkdir(parents=True)
    except (gym.error.Error, ImportError, TypeError, ValueError, OSError) as error:
        sys.exit(f"--env-id {args.env_id} --out-dir {args.out_dir}: {error!r}")
    if not envs.spec.max_episode_steps:
        print(f"{args.env_id} has no time limit: whole episodes, as in evaluations, end after "
              "1,000 steps. To set another limit: gym.register(..., max_episode_steps=...)")
    try:
        if len(args.seed) == 1:
            train(0, args, folder)
        else:  # train(0, args, folder), train(1, …), …, each in a process
            torch.multiprocessing.spawn(train, (args, folder), len(args.seed))
    except KeyboardInterrupt:
        sys.exit("interrupted")  # printed last, after the figure is drawn
    finally:
        for process in torch.multiprocessing.active_children():
            process.join(1)  # after Ctrl-C it may be ending by itself
            process.terminate()
        if any(folder.glob("*.csv")):
            plot(folder)
        elif not any(folder.iterdir()):
            folder.rmdir()


if __name__ == "__main__":
    main()
