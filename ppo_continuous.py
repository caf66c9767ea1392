# /// script
# requires-python = ">=3.10,<3.14"
# dependencies = ["torch>=2.6,<2.14", "gymnasium[mujoco]>=1.4,<1.5", "numpy>=1.26", "tqdm>=4.66",
#     "mujoco>=3.1,<3.16", "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.28"]
# ///
"""PPO: proximal policy optimisation for continuous actions, in one file.

    python ppo_continuous.py --seed 1 2 3

trains three agents side by side to balance a double pendulum on a cart. In a good run the return
climbs within a minute from 50, which random actions earn, to 9,300; the most is 9,360.

At every step the agent observes a state s, draws an action a from its policy π(a|s), and gets a
reward r and the next state, until the episode ends. We want a high *return*, the sum of all rewards
of an episode. Two neural networks learn:

    the actor   π(a|s) = Normal(μ(s), σ²)   which actions to take
    the critic  V(s)                        what to expect from s on if we follow π: the mean of
                                            r_t + γ·r_{t+1} + γ²·r_{t+2} + …, with γ < 1

The critic judges actions. The advantage A of an action is what followed minus V(s): how much better
it turned out than what π does on average. Actions with A > 0 become more likely, those with A < 0
less. A2C (advantage actor-critic) takes one gradient step on a rollout and throws it away. PPO [1]
takes many, so it learns more from it. But the rollout shows only what π_old did, the policy that
collected it, so π must stay near π_old. One update:

  1. Anneal: the learning rate falls linearly to 0, and σ, the exploration, from 0.6 to 0.1.
  2. Collect a rollout: T steps in each of N environments.
  3. Scale the rewards, so that what V has to predict has a similar spread in every task.
  4. Estimate the advantages A (GAE [2]). A + V(s) are the targets that V is trained on.
  5. Go through the rollout several times, in minibatches. On each, take a gradient step on
         −mean(min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)) + ½·mean((V(s) − target)²),  ρ = π(a|s)/π_old(a|s)
     or, once KL(π_old ‖ π), estimated on the minibatch, is above max_kl, go on to 6.
  6. Update the statistics that normalise observations. Start again at 1.

Points 2, 4 and 5 are PPO. The rest are details that help, most of them common [4]: 1, 3, 6, max_kl,
standardised A, the initial weights, and tanh, which keeps actions in their bounds. Left out: a σ
that is learned, an entropy bonus, clipped gradients and a clipped value loss.

In the code: s obs, a actions, V values, A advantages, ρ ratio, ε clip_eps, λ gae_lambda, σ sigma.
In shapes: T rollout_steps, N num_envs, B a minibatch, D numbers in an observation, K in an action.
[1] Schulman et al. 2017, Proximal Policy Optimization Algorithms, arXiv 1707.06347.
[2] Schulman et al. 2016, Generalized Advantage Estimation, arXiv 1506.02438.
[3] Pardo et al. 2018, Time Limits in Reinforcement Learning, arXiv 1712.00378.
[4] Huang et al. 2022, The 37 Implementation Details of Proximal Policy Optimization.
"""

import argparse
import os
import random
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

    def __init__(self, envs, hidden_size):
        super().__init__()
        inputs, outputs = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
        self.obs_stats = RunningStatistics(inputs)
        self.actor = mlp(inputs, hidden_size, outputs, last_gain=0.01)
        self.critic = mlp(inputs, hidden_size, 1, last_gain=1.0)
        self.register_buffer("sigma", torch.ones(outputs))  # set by `train`

    def policy(self, obs):
        """Observations (…, D) -> π(·|s), whose log_prob sums over the K numbers of an action."""
        mean = self.actor(self.obs_stats.normalise(obs))
        gaussians = torch.distributions.Normal(mean, self.sigma, validate_args=False)  # faster
        return torch.distributions.Independent(gaussians, 1)

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

    def normalise(self, x):
        """To mean 0 and standard deviation 1, clipped so that no outlier dominates the networks."""
        # A spread below 1e-8 of the mean is rounding; the floor avoids dividing by 0.
        std = (self.var + 1e-16 * self.mean**2).clamp(min=1e-30).sqrt()
        return ((x - self.mean) / std).clamp(-10, 10).float()

    def update(self, rows):
        """Merge in new `rows`, whose weight w is their share of all rows so far.

            mean ← (1−w)·mean + w·mean_new
            var  ← (1−w)·var + w·var_new + w·(1−w)·(mean_new − mean)²
        """
        self.count += len(rows)
        rows, w = rows.double(), len(rows) / self.count.item()
        self.var.lerp_(rows.var(0, correction=0) + (1 - w) * (rows.mean(0) - self.mean) ** 2, w)
        self.mean.lerp_(rows.mean(0), w)


def mlp(inputs, hidden, outputs, last_gain):
    """Two hidden layers, orthogonal weights; a small `last_gain` starts π alike in all states."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain)):  # √2 is usual
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


def squash(actions, space):
    """Map actions (N, K) of any size into the bounds of the action space.

    PPO takes this as a part of the environment: a is the action as drawn, and π(a|s) its density.
    (That of the squashed action has one more factor, in π as in π_old: it cancels in ρ.)
    """
    share = (np.tanh(actions) + 1) / 2
    inside = (1 - share) * space.low + share * space.high
    return inside.clip(space.low, space.high).astype(space.dtype)  # rounding may go beyond


# --- An update, point by point --------------------------------------------------------------------


class Transitions(NamedTuple):
    """What happened in T steps of N environments."""

    obs: Tensor  # (T, N, D)
    actions: Tensor  # (T, N, K), as drawn; `envs.step` squashes them
    rewards: Tensor  # (T, N)
    next_obs: Tensor  # (T, N, D): what followed the action, even if the episode ended there
    terminated: Tensor  # (T, N), bool: the episode ended for good, so no reward can follow
    done: Tensor  # (T, N), bool: terminated, or cut off by a time limit


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
            returns += infos["return"][done].tolist()
            obs, _ = envs.reset(options={"reset_mask": done})
    columns = (torch.tensor(np.stack(column)) for column in zip(*steps))
    return Transitions(*columns), obs, returns


def scale_rewards(rewards, done, past_rewards, stats, gamma):
    """3. Divide rewards (T, N) by the standard deviation, so far, of the sums

        F_t = r_t + γ·F_{t−1},  from 0 in each new episode.

    V predicts a sum of later rewards, not known yet. F is a sum of past ones, which usually has a
    similar spread; while it has none, rewards stay as they are. `past_rewards` is F before the
    first row, (N,) or 0. Returns the scaled rewards, and F after the last row.
    """
    sums = torch.empty_like(rewards)
    for t in range(len(rewards)):
        sums[t] = rewards[t] + gamma * past_rewards
        past_rewards = sums[t] * ~done[t]
    stats.update(sums.flatten())
    varies = stats.var > 1e-16 * stats.mean**2  # by more than rounding
    return (rewards / stats.var.sqrt() if varies else rewards).float(), past_rewards


def compute_gae(rewards, values, next_values, terminated, done, gamma, gae_lambda):
    """4. Generalised advantage estimation; all (T, N) ([2] eq. 11 and 16).

        δ_t = r_t + γ·V(s_{t+1}) − V(s_t)               how much better one step was than expected
        A_t = δ_t + γλ·δ_{t+1} + (γλ)²·δ_{t+2} + …
            = δ_t + γλ·A_{t+1}                          so one pass backwards computes them all

    The sum ends with the last δ of an episode or of the rollout. In this last δ_t:
        terminated      no reward can follow, so V(s_{t+1}) counts as 0
        truncated       V(s_{t+1}) stands for what would have followed without a time limit [3]
        end of rollout  V(s_{t+1}) stands for the rest of the episode

    If V were exact, every λ would be right on average. With λ = 0, A_t = δ_t: little noise, but all
    of V's error. With λ = 1 the values in between cancel and, if the sum has n terms,
    A_t = r_t + γ·r_{t+1} + … + γ^n·V(s_{t+n}) − V(s_t): less bias, but more noise.
    """
    advantages = rewards + gamma * next_values * ~terminated - values  # at first only δ
    for t in reversed(range(len(advantages) - 1)):
        advantages[t] += gamma * gae_lambda * advantages[t + 1] * ~done[t]
    return advantages


def policy_loss(ratio, advantages, clip_eps):
    """−mean(min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)); ρ and A are (B,) ([1] eq. 7).

    How much better is π than π_old? As A is measured against the average of π_old, π gains

        ∫ π·A da = ∫ π_old·(π/π_old)·A da = E[ρ·A]     a drawn from π_old, as in the rollout

    in one state. Summed with weights γ^t over the states that π_old meets, it is nearly the gain in
    discounted return while π is near π_old (Kakade and Langford 2002). PPO drops γ^t: raise E[ρ·A].
    At ρ = 1, where an update starts, its gradient is E[A·∇log π], as in A2C. Farther away the
    estimate gets worse, so a sample drops out once ρ has gone far enough in the direction of A:

                    ρ < 1−ε                1−ε ≤ ρ ≤ 1+ε      ρ > 1+ε
        A > 0       ρ·A: raise ρ           ρ·A: raise ρ       (1+ε)·A: no gradient
        A < 0       (1−ε)·A: no gradient   ρ·A: lower ρ       ρ·A: lower ρ

    Where ρ has gone the wrong way, the gradient stays, to lead it back. The clip alone does not
    keep π near: all samples share the weights, so others can still push ρ out. Hence max_kl.
    """
    clipped_ratio = ratio.clamp(1 - clip_eps, 1 + clip_eps)
    return -torch.min(ratio * advantages, clipped_ratio * advantages).mean()


def approximate_kl(log_ratio):
    """KL(π_old ‖ π) = E[−log ρ], estimated by mean(ρ − 1 − log ρ); log ρ is (B,).

    E[ρ] = ∫ π_old·(π/π_old) da = 1, so adding ρ − 1 changes nothing on average. But now no term is
    below 0, as log ρ ≤ ρ − 1, and near ρ = 1 they vary much less: they are about ½·(log ρ)².
    For two Gaussians of the same σ it is ½·Σ((μ − μ_old)/σ)²: the smaller σ, the less μ may move.
    """
    return (log_ratio.expm1() - log_ratio).mean()  # expm1(x) is exp(x) − 1, but accurate near 0


def optimise(agent, optimizer, samples, epochs, minibatch_size, clip_eps, max_kl):
    """5. On all T·N samples: obs, actions, log π_old(a|s), A, targets. Returns the last metrics."""
    shuffled = torch.cat([torch.randperm(len(samples[0])) for _ in range(epochs)])
    for rows in shuffled.split(minibatch_size):  # each sample once an epoch
        obs, actions, old_log_probs, A, targets = (x[rows] for x in samples)
        log_ratio = agent.policy(obs).log_prob(actions) - old_log_probs
        ratio, kl = log_ratio.exp(), approximate_kl(log_ratio)
        A = (A - A.mean()) / (A.std(correction=0) + 1e-8)  # now A > 0: above the minibatch's mean
        loss_v = ((agent.value(obs) - targets) ** 2).mean() / 2
        if kl > max_kl:  # not sooner, as loss_v is logged
            break
        optimizer.zero_grad()
        (policy_loss(ratio, A, clip_eps) + loss_v).backward()  # no shared weights: no interference
        optimizer.step()
    return {"value_loss": loss_v.item(), "kl": kl.item(),
            "clip_fraction": ((ratio - 1).abs() > clip_eps).float().mean().item()}


# --- Training -------------------------------------------------------------------------------------


def train(index, args, folder):
    """Train the agent of `args.seed[index]`; leave its log and its weights in `folder`."""
    torch.set_num_threads(1)  # networks this small gain nothing from more threads
    seed = args.seed[index]
    for set_seed in torch.manual_seed, np.random.seed, random.seed:  # agent and environments
        set_seed(make_seeds(seed, stream=0, count=1)[0])
    envs = make_envs(args.env_id, args.num_envs, "Disabled")  # `rollout` resets them
    eval_envs = make_envs(args.env_id, args.eval_episodes, "NextStep")
    obs, _ = envs.reset(seed=make_seeds(seed, stream=2, count=args.num_envs))
    agent = Agent(envs, args.hidden_size)
    optimizer = torch.optim.Adam(agent.parameters(), fused=True)  # fused is faster
    reward_stats, past_rewards = RunningStatistics(), 0.0
    log, env_step, evals_done, start = [], 0, 0, time.perf_counter()
    bar = tqdm(total=args.total_steps, disable=index > 0 or sys.stderr is None)
    while env_step < args.total_steps:
        # 1. Anneal.
        remaining = 1 - env_step / args.total_steps
        optimizer.param_groups[0]["lr"] = remaining * args.learning_rate
        agent.sigma.fill_(remaining * args.first_std + (1 - remaining) * args.last_std)
        # 2. Collect a rollout.
        batch, obs, returns = rollout(envs, agent, obs, args.rollout_steps)
        # 3. Scale the rewards.
        rewards, past_rewards = scale_rewards(
            batch.rewards, batch.done, past_rewards, reward_stats, args.gamma)
        # 4. Estimate advantages and targets, which are constants in 5, like π_old.
        with torch.no_grad():
            old_log_probs = agent.policy(batch.obs).log_prob(batch.actions)
            values, next_values = agent.value(batch.obs), agent.value(batch.next_obs)
        advantages = compute_gae(
            rewards, values, next_values, batch.terminated, batch.done, args.gamma, args.gae_lambda)
        targets = advantages + values
        # 5. Update actor and critic, on samples in no order: (T, N, …) -> (T·N, …).
        samples = batch.obs, batch.actions, old_log_probs, advantages, targets
        metrics = optimise(agent, optimizer, [x.flatten(0, 1) for x in samples],
                           args.epochs, args.minibatch_size, args.clip_eps, args.max_kl)
        # 6. Update the statistics, last, so that 2 to 5 all normalise in the same way.
        agent.obs_stats.update(batch.obs.flatten(0, 1))

        if not nn.utils.parameters_to_vector(agent.parameters()).isfinite().all():
            raise ValueError("a weight is not finite: are rewards NaN, infinite or huge?")
        # How well V predicted its targets, up to a constant: 1 is perfect, 0 or less useless.
        metrics["explained_variance"] = 1 - (advantages.var() / targets.var()).item()
        env_step += rewards.numel()
        bar.update(min(env_step, args.total_steps) - bar.n)
        log.append({"env_step": env_step, "seconds": time.perf_counter() - start,
                    "return": np.mean(returns) if returns else np.nan, **metrics})
        if env_step >= evals_done / args.num_evals * args.total_steps:
            evals_done += 1
            log[-1]["eval_return"] = evaluate(agent, eval_envs, seed)
            bar.set_postfix(eval_return=round(log[-1]["eval_return"], 1))
            save(folder / f"seed-{seed}", log, agent, args)


# --- Options --------------------------------------------------------------------------------------


def parse_args(argv=None):
    parser = argparse.ArgumentParser(
        usage=argparse.SUPPRESS, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    add = parser.add_argument
    add("--seed", type=in_range(int, 0), nargs="+", default=[1], help="random seeds, an agent each")
    add("--total-steps", type=in_range(int, 1), default=150_000, help="environment steps in all")
    add("--env-id", default="InvertedDoublePendulum-v5", help="Gymnasium id or my_module:MyEnv-v0")
    add("--watch", type=Path, metavar="AGENT.pt", help="do not train, but film this agent")
    add("--out-dir", default="runs", help="where the folder of this run is created")
    add("--num-evals", type=in_range(int, 1), default=20, help="evaluations, plus a first one")
    add("--eval-episodes", type=in_range(int, 1), default=10, help="episodes of an evaluation")
    add("--num-envs", type=in_range(int, 1), default=16, help="environments stepped together")
    add("--rollout-steps", type=in_range(int, 1), default=128, help="steps of each in a rollout")
    add("--epochs", type=in_range(int, 1), default=10, help="passes over a rollout, at most")
    add("--minibatch-size", type=in_range(int, 2), default=512, help="samples in a minibatch")
    add("--learning-rate", type=in_range(float, 0), default=1e-3, help="falls linearly to 0")
    add("--gamma", type=in_range(float, 0, 1), default=0.99, help="discount factor")
    add("--gae-lambda", type=in_range(float, 0, 1), default=0.95, help="0 trusts V, 1 the rewards")
    add("--clip-eps", type=in_range(float, 0), default=0.2, help="clips the ratio at 1 +- this")
    add("--max-kl", type=in_range(float, 0), default=0.03, help="KL that ends the gradient steps")
    add("--first-std", type=in_range(float, 1e-4), default=0.6, help="sigma at first, before tanh")
    add("--last-std", type=in_range(float, 1e-4), default=0.1, help="sigma at last, before tanh")
    add("--hidden-size", type=in_range(int, 1), default=64, help="units of each hidden layer")
    return parser.parse_args(argv)


def in_range(kind, low, high=1e12):
    """An argparse type: a number from `low` to `high`; 1e6 counts as an int."""

    def number(text):
        value = float(text)
        if not low <= value <= high or value != kind(value):
            raise argparse.ArgumentTypeError(f"{text}: not {kind.__name__} in [{low}, {high:g}]")
        return kind(value)

    return number


# ==================================================================================================
# Below: plumbing, not the algorithm
# ==================================================================================================


def make_seeds(seed, stream, count):
    """Seeds below 2³¹, different for each stream: 0 global generators, 1 evaluation, 2 training."""
    return (np.random.SeedSequence(seed, spawn_key=(stream,)).generate_state(count) >> 1).tolist()


def make_envs(env_id, count, autoreset_mode, **kwargs):
    """`count` environments; those of autoreset mode "NextStep" reset themselves when done."""
    try:
        envs = gym.make_vec(env_id, count, "sync", {"autoreset_mode": autoreset_mode}, [
            lambda x: gym.wrappers.TimeLimit(x, x.spec.max_episode_steps or 10_000),
            Tidy], **kwargs)
    except (gym.error.Error, ImportError) as error:
        sys.exit(f"--env-id {env_id}: {error}")
    obs_space, space = envs.single_observation_space, envs.single_action_space
    if not (isinstance(obs_space, gym.spaces.Box) and isinstance(space, gym.spaces.Box)
            and len(obs_space.shape) == len(space.shape) == 1 and space.dtype.kind == "f"
            and np.abs([space.low, space.high], dtype=float).max() < 1e30):
        envs.close()
        message = f"{env_id}: needs flat Boxes, actions with bounds; has {obs_space}, {space}"
        sys.exit(" ".join(message.split()))  # in one line
    envs = gym.wrappers.vector.TransformObservation(envs, np.asarray_chkfinite)  # NaN: ValueError
    return gym.wrappers.vector.TransformAction(envs, lambda actions: squash(actions, space))


class Tidy(gym.Wrapper):
    """The only `info` is the return, when an episode has ended; it must be finite."""

    def reset(self, *, seed=None, options=None):
        self.total = 0.0
        if seed is not None:  # some environments draw from their spaces
            self.observation_space.seed(seed)
            self.action_space.seed(seed)
        return self.env.reset(seed=seed, options=options or None)[0], {}  # a vector may pass {}

    def step(self, action):
        obs, reward, terminated, truncated, _ = self.env.step(action)
        self.total += float(reward)
        done = terminated or truncated
        info = {"return": np.asarray_chkfinite(self.total).item()} if done else {}
        return obs, reward, terminated, truncated, info


def evaluate(agent, envs, seed):
    """The mean return of one episode in each environment, with deterministic actions."""
    obs, _ = envs.reset(seed=make_seeds(seed, stream=1, count=envs.num_envs))
    returns, playing = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    while playing.any():  # environments that are done go on, but no longer count
        obs, rewards, terminated, truncated, _ = envs.step(agent.act(obs, deterministic=True))
        returns += playing * rewards
        playing &= ~(terminated | truncated)
    return returns.mean().item()


def save(path, log, agent, args):
    """Write new files, then put them in place of the old ones, so that none is ever cut short."""
    pd.DataFrame(log).to_csv(f"{path}.csv.new", index=False)
    torch.save({**vars(args), "agent": agent.state_dict()}, f"{path}.pt.new")
    for suffix in "csv", "pt":
        Path(f"{path}.{suffix}.new").replace(f"{path}.{suffix}")


def watch(args):
    """Print a saved agent's mean return; film an episode, every fifth frame, in a GIF beside it."""
    try:
        saved = torch.load(args.watch, weights_only=True)
        envs = make_envs(saved["env_id"], args.eval_episodes, "NextStep")
        agent = Agent(envs, saved["hidden_size"])
        agent.load_state_dict(saved["agent"])
        for set_seed in np.random.seed, random.seed:  # environments may use these
            set_seed(make_seeds(args.seed[0], stream=0, count=1)[0])
        print("return:", evaluate(agent, envs, args.seed[0]))
        os.environ.setdefault("MUJOCO_GL", "egl" if sys.platform == "linux" else "glfw")
        film = make_envs(saved["env_id"], 1, "NextStep", render_mode="rgb_array_list")
        evaluate(agent, film, args.seed[0])
        imageio.imwrite(args.watch.with_suffix(".gif"), film.render()[0][::5], duration=50, loop=0)
    except Exception as error:  # no agent of this script, an environment that cannot be drawn, …
        sys.exit(f"--watch {args.watch}: {error!r}")


def plot(folder):
    """Draw learning_curve.png; print the end of each seed's log."""
    files = sorted(folder.glob("*.csv"), key=lambda file: int(file.stem.removeprefix("seed-")))
    log = pd.concat([pd.read_csv(file).assign(seed=file.stem) for file in files], ignore_index=True)
    figure = Figure(figsize=(12, 8), layout="constrained")
    diagnostics = ["value_loss", "explained_variance", "kl", "clip_fraction"]
    axes = figure.subplot_mosaic([["return"] * len(diagnostics), diagnostics], height_ratios=(3, 1))
    for name, ax in axes.items():
        sns.lineplot(log, x="env_step", y=name, hue="seed", estimator=None, legend=False, ax=ax,
                     alpha=0.4 if name == "return" else 1.0)
    sns.lineplot(log, x="env_step", y="eval_return", hue="seed", estimator=None, ax=axes["return"])
    axes["return"].set(title=folder.name, ylabel="return (pale: in training)")
    axes["explained_variance"].set_ylim(-1, 1)
    figure.savefig(folder / "learning_curve.png")
    print(folder, log.groupby("seed", sort=False)[["env_step", "eval_return"]].last(), sep="\n")


def main():
    sys.path.append(str(Path.cwd()))  # `my_module` of --env-id may lie here
    args = parse_args()
    if args.watch:
        return watch(args)
    if len(set(args.seed)) < len(args.seed):
        sys.exit(f"--seed {args.seed}: each only once")
    make_envs(args.env_id, 1, "Disabled").close()  # if --env-id is wrong, the program ends here
    name = f"{args.env_id}__{Path(__file__).stem}__{pd.Timestamp.now():%Y%m%d_%H%M%S%f}"
    folder = Path(args.out_dir).expanduser() / name.replace(":", "-").replace("/", "-")
    folder.mkdir(parents=True)
    try:
        if len(args.seed) == 1:
            train(0, args, folder)
        else:  # train(0, args, folder), train(1, …), …, each in a process
            torch.multiprocessing.spawn(train, (args, folder), len(args.seed), daemon=True)
    finally:  # after Ctrl-C, too
        if any(folder.glob("*.csv")):
            plot(folder)


if __name__ == "__main__":
    main()
