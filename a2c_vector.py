# /// script
# requires-python = ">=3.11,<3.14"  # Box2D has no wheel for 3.14
# dependencies = ["torch>=2.6", "gymnasium[box2d]>=1.3", "numpy>=1.26",
#     "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.31", "tqdm>=4.66"]
# ///
"""A2C: advantage actor-critic, with many environments and random physics, in one file.

    python a2c_vector.py --seed 1 2 3               # or: uv run a2c_vector.py --seed 1
    python a2c_vector.py --watch runs/…/seed-1.pt   # replays an agent and films it

The first command trains three agents side by side to land on the moon, and leaves logs, agents and
a figure in a new folder in runs/. In a good run the return in evaluation, of the likeliest actions,
climbs within three minutes to about 250; 200 counts as solved, and random actions earn −180.

At every step the agent observes the state s of its environment (here: where the lander is and how
it moves), draws an action a from its policy π(a|s), and gets a reward r, until the episode ends. We
want a high *return*, the sum of all rewards of an episode. Two neural networks learn:

    the actor   π(a|s)   which of a few actions to take, as probabilities
    the critic  V(s)     the mean *reward to go* of π from s: G_t = r_t + γ·r_{t+1} + γ²·r_{t+2} + …

γ makes distant rewards count less: with 0.999, one 1,000 steps away counts 0.37. The *advantage* A
of an action is the mean of G if we take it now and then follow π, minus V(s). Without a critic an
episode must end before we know what followed an action. In A2C [1] V stands in for the rewards
still to come, so the agent can learn every T steps, in mid-episode. One update:

  1. Anneal, linearly to 0: the learning rate, and the weight c of the entropy bonus in 5.
  2. Collect a rollout: T steps in each of N environments (--rollout-steps, --num-envs).
  3. Multiply the rewards by 0.1: to predict hundreds, V's weights must grow, but Adam moves each by
     about the learning rate, however large the error. (The actor's A is standardised anyway.)
  4. Estimate the advantages A (GAE [2]). A + V(s) then estimates the mean of G: the target for V.
  5. Take one gradient step, on the whole rollout, on
         −mean(A·log π(a|s)) + ½·mean((V(s) − target)²) − c·entropy(π)      with A standardised
     Actions that did better than the others become more likely, the rest less. The entropy is high
     while π is undecided: its bonus keeps π from settling on one action before it tried the others.
  6. Update the statistics that normalise observations. Start again at 1, with a new rollout.

N environments (`make_envs`) are in N different situations, so the gradient is less noisy, and one
call of a network serves them all; but the same number of steps allows fewer updates. `--randomize`
draws random moons (`RandomPhysics`). A2C itself is 2, 4 with λ = 1, and 5 without standardising A;
the rest is customary, as is a limit on gradients. `--env-id` takes other tasks.

In the code: s obs (D numbers), a actions, V values, A advantages, λ gae_lambda, c entropy_coef.
[1] Mnih et al. 2016, Asynchronous Methods for Deep RL, arXiv 1602.01783: A3C; A2C is synchronous.
[2] Schulman et al. 2016, Generalized Advantage Estimation, arXiv 1506.02438.
[3] Pardo et al. 2018, Time Limits in Reinforcement Learning, arXiv 1712.00378.
[4] Peng et al. 2018, Sim-to-Real Transfer ... with Dynamics Randomization, arXiv 1710.06537.
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
        inputs, outputs = obs_space.shape[0], int(action_space.n)
        self.obs_stats = RunningStatistics(inputs)
        self.actor = mlp(inputs, hidden_size, outputs, last_gain=0.01)
        self.critic = mlp(inputs, hidden_size, 1, last_gain=1.0)

    def policy(self, obs):
        """Observations (…, D) -> π(·|s): a probability for each action."""
        return torch.distributions.Categorical(logits=self.actor(self.obs_stats.normalise(obs)))

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,), in units of scaled rewards."""
        return self.critic(self.obs_stats.normalise(obs)).squeeze(-1)

    @torch.no_grad()
    def act(self, obs, deterministic=False):
        """NumPy observations (N, D) -> NumPy actions (N,): drawn from π, or the likeliest."""
        policy = self.policy(torch.tensor(obs))
        return (policy.mode if deterministic else policy.sample()).numpy()


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
    """Two hidden layers, orthogonal weights; a small `last_gain` makes π start nearly uniform."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain)):  # √2 makes up for ReLU's zeros
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])


# --- The steps of an update -----------------------------------------------------------------------


class Transitions(NamedTuple):
    """What happened in T steps of N environments."""

    obs: Tensor  # (T, N, D)
    actions: Tensor  # (T, N), int
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


def policy_loss(log_probs, advantages):
    """−mean(A·log π); log π and A are (T, N). Why does a step on it raise the mean return?

        ∇E[return] = Σ_τ return·∇P(τ) = E[return·Σ_t ∇log π(a_t|s_t)]        as ∇P = P·∇log P
                   = E[Σ_t (r_t + r_{t+1} + … − V(s_t))·∇log π(a_t|s_t)]     less noise: see below
                   ≈ E[Σ_t A_t·∇log π(a_t|s_t)]       A_t estimates the bracket, with γ and V

    Of the probability P(τ) of an episode, only the factors π(a_t|s_t) depend on the weights. In s_t
    the mean of ∇log π(a_t|s_t) is Σ_a π·∇log π = ∇Σ_a π = ∇1 = 0. It stays 0 when multiplied by
    what is fixed before a_t is drawn. So we may drop earlier rewards and subtract V(s_t).

    E is over actions of π as it is now. After one step π is another, and the rollout is outdated.
    A term needs only s_t, a_t and A_t, so a rollout may hold pieces of episodes. And here a mean is
    as good as a sum, because the number of steps, T·N, does not depend on the actions.
    """
    return -(advantages * log_probs).mean()


def optimise(agent, optimizer, obs, actions, advantages, targets, *, entropy_coef, max_grad_norm):
    """5. One gradient step on a whole rollout: all (T, N), and `obs` (T, N, D). Returns metrics."""
    # Standardised, so that c suits any rewards. The mean acts as a baseline (but contains A).
    A = (advantages - advantages.mean()) / (advantages.std(correction=0) + 1e-8)
    policy = agent.policy(obs)
    loss_pi = policy_loss(policy.log_prob(actions), A)
    loss_v = ((agent.value(obs) - targets) ** 2).mean() / 2
    entropy = policy.entropy().mean()
    optimizer.zero_grad()
    (loss_pi + loss_v - entropy_coef * entropy).backward()
    # Scale a gradient down if its norm is above the limit.
    for network in agent.actor, agent.critic:  # one by one: V's errors must not scale the actor's
        nn.utils.clip_grad_norm_(network.parameters(), max_grad_norm)
    optimizer.step()
    return {"value_loss": loss_v.item(), "entropy": entropy.item()}


# --- Environments ---------------------------------------------------------------------------------


def make_envs(args, count, vectorization="sync", autoreset_mode="NextStep", **kwargs):
    """A vector of `count` environments: actions (N,) in; observations (N, D), rewards (N,), … out.

    "sync" steps one after the other. "async" gives each a process of its own: steps run at the same
    time, but each costs a message there and back, one after the other. With C ≤ N idle cores

        N·step  becomes  N·step/C + N·message:      async pays if step·(1 − 1/C) > message

    On our machine LunarLander's step takes 0.03 ms, a message 0.04 ms: it does not. Measure yours.

    With "NextStep" an environment resets itself in the step after the end of an episode. That step
    ignores the action: nothing to learn from. So training takes "Disabled": a finished environment
    waits until `rollout` resets it. In evaluation finished ones may restart, as they do not count.
    """
    if args.randomize and "LunarLander" not in args.env_id:
        raise gym.error.Error("--randomize knows the physics of LunarLander only")
    envs = gym.make_vec(args.env_id, count, vectorization, **kwargs,
                        wrappers=[RandomPhysics] if args.randomize else None,
                        vector_kwargs={"autoreset_mode": autoreset_mode})
    obs_space, space = envs.single_observation_space, envs.single_action_space
    flat = isinstance(obs_space, gym.spaces.Box) and len(obs_space.shape) == 1
    if not (flat and isinstance(space, gym.spaces.Discrete) and space.start == 0):
        raise gym.error.Error(f"needs a flat Box and Discrete from 0, not {obs_space}, {space}")
    return envs


class RandomPhysics(gym.Wrapper):
    """`--randomize`: domain randomization [4]. Each episode has a gravity and a wind of its own.

    An agent is often meant for a world that we know only roughly: a robot, say, is trained in a
    simulator. If it has learned to act in many worlds, it may cope with the real one, too. It does
    not see which world was drawn, so one policy has to do for all, which may cost some return in
    each. Evaluations draw worlds, too.

    For another environment change the check in `make_envs` and what `reset` sets, and recompute
    what depends on it. In CartPole, say, draw `length` and `masspole`, and then set
    `polemass_length = masspole * length` and `total_mass = masspole + masscart`.
    """

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.env.reset(seed=seed)  # seeds the environment's own generator, from which we draw
        lander = self.unwrapped  # usual: gravity −10, no wind; allowed: −12 to 0
        lander.gravity = lander.np_random.uniform(-11.99, -7.0)
        lander.enable_wind = bool(lander.np_random.integers(2))
        lander.wind_power = lander.np_random.uniform(0.0, 20.0)
        lander.turbulence_power = lander.np_random.uniform(0.0, 2.0)
        return self.env.reset(options=options)


# --- Training -------------------------------------------------------------------------------------


def train(index, args, folder):
    """Train the agent of `args.seed[index]`; leave its log and its weights in `folder`.

    The log has a row for each update: `env_step` and `seconds` so far; `return`, the mean of the
    training episodes that ended in it, if any did; the metrics of `optimise`; and sometimes
    `eval_return`, of the likeliest actions, which may be far lower early on.
    """
    seed, folder, log = args.seed[index], Path(folder), []
    torch.set_num_threads(1)  # more would round differently, and not be faster here
    torch.manual_seed(seed)
    envs = make_envs(args, args.num_envs, args.vectorization, "Disabled")
    eval_envs = make_envs(args, args.eval_episodes)
    obs, _ = envs.reset(seed=1000 * seed)
    agent = Agent(envs.single_observation_space, envs.single_action_space, args.hidden_size)
    optimizer = torch.optim.Adam(agent.parameters(), fused=True)  # fused: faster
    earned = 0.0

    steps = args.rollout_steps * args.num_envs  # of an update
    num_updates = int(np.ceil(args.total_steps / steps))
    evaluations = np.linspace(1, num_updates, 1 + args.num_evals).round()
    bar = tqdm(range(1, 1 + num_updates), unit=" steps", unit_scale=steps, disable=index > 0)
    start = time.perf_counter()
    for update in bar:
        # 1. Anneal: ever smaller steps, ever less exploration.
        remaining = 1 - (update - 1) / num_updates
        optimizer.param_groups[0]["lr"] = remaining * args.learning_rate
        entropy_coef = remaining * args.entropy_coef
        # 2. Collect a rollout.
        batch, obs, earned, returns = rollout(envs, agent, obs, earned, args.rollout_steps)
        # 3. Scale the rewards.
        rewards = batch.rewards.float() * args.reward_scale
        # 4. Estimate advantages and targets, which are constants in 5.
        with torch.no_grad():
            # V(next_obs) is not values[1:]: the next row may be another episode's.
            values, next_values = agent.value(batch.obs), agent.value(batch.next_obs)
        advantages = compute_gae(rewards, values, next_values, batch.terminated, batch.done,
                                 gamma=args.gamma, gae_lambda=args.gae_lambda)
        targets = advantages + values
        # 5. Update actor and critic.
        metrics = optimise(agent, optimizer, batch.obs, batch.actions, advantages, targets,
                           entropy_coef=entropy_coef, max_grad_norm=args.max_grad_norm)
        # 6. Update the statistics, last, so that 2 to 5 all normalise in the same way.
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
    add("--total-steps", type=bounded(int, 1), default=1_000_000, help="steps per agent, at least")
    add("--env-id", default="LunarLander-v3", help="Gymnasium id or my_module:MyEnv-v0")
    add("--watch", type=Path, metavar="AGENT.pt", help="do not train, but film this agent")
    add("--out-dir", default="runs", help="where the folder of this run is created")
    add("--num-evals", type=bounded(int, 1), default=20, help="evaluations after a first one")
    add("--eval-episodes", type=bounded(int, 1), default=20, help="episodes of an evaluation")
    add("--num-envs", type=bounded(int, 1), default=8, help="environments stepped together")
    add("--vectorization", choices=("sync", "async"), default="sync", help="async: a process each")
    add("--randomize", action=argparse.BooleanOptionalAction, default=False, help="random moons")
    add("--rollout-steps", type=bounded(int, 1), default=64, help="steps per environment")
    add("--reward-scale", type=bounded(float, 0), default=0.1, help="multiplies rewards")
    add("--learning-rate", type=bounded(float, 0), default=2e-3, help="falls linearly to 0")
    add("--gamma", type=bounded(float, 0, 1), default=0.999, help="discount factor")
    add("--gae-lambda", type=bounded(float, 0, 1), default=0.98, help="0 trusts V, 1 the rewards")
    add("--entropy-coef", type=bounded(float, 0), default=0.01, help="falls linearly to 0")
    add("--max-grad-norm", type=bounded(float, 0), default=0.5, help="limit for each network")
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
