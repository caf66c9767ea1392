# /// script
# requires-python = ">=3.10,<3.14"
# dependencies = ["torch>=2.6,<2.14", "gymnasium[box2d]>=1.4,<1.5", "numpy>=1.26",
#     "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.31", "tqdm>=4.66"]
# ///
"""A2C: advantage actor-critic, with many environments and random physics, in one file.

    python a2c_vector.py --seed 1 2 3               # or: uv run a2c_vector.py --seed 1
    python a2c_vector.py --watch runs/…/seed-1.pt   # replays an agent and films it

The first command trains three agents side by side to land on the moon, and leaves logs, agents and
a figure in a new folder in runs/. In a good run the return climbs within three minutes from −180,
which random actions earn, to about 250; 200 counts as solved.

At every step the agent observes a state s, draws an action a from its policy π(a|s), and gets a
reward r and the next state, until the episode ends. We want a high *return*, the sum of all rewards
of an episode. Two neural networks learn:

    the actor   π(a|s)   which of a few actions to take, as probabilities
    the critic  V(s)     what to expect from s on if we follow π: the mean *reward to go*
                         r_t + γ·r_{t+1} + γ²·r_{t+2} + …, where γ < 1, as later rewards owe
                         less to what happens at t, and mostly add noise

Without V an episode must end before we know what followed each action. In A2C [1] V stands in for
the rewards still to come, so the networks can learn every T steps, in mid-episode. An update:

  1. Anneal linearly to 0: the learning rate and the weight c of the entropy bonus (in 5).
  2. Collect a rollout: T steps in each of N environments.
  3. Scale the rewards by a constant, so that what V has to predict is neither tiny nor huge.
  4. Estimate the advantages A (GAE [2]): how much better each action turned out than what π does on
     average. A + V(s) then estimates the reward to go: the target for V.
  5. Take one gradient step, on the whole rollout, to lower
         −mean(A·log π(a|s)) + ½·mean((V(s) − target)²) − c·entropy(π)      with A standardised
     The step makes actions with A > 0 more likely, the others less. The entropy is high while π is
     undecided; the bonus keeps π from settling on one action before it has tried the others. Then
     throw the rollout away, because it shows what the old π did.
  6. Update the statistics that normalise observations. Start again at 1.

Why N environments? T steps in a row are much alike; N environments tell N different stories, so the
gradient is less noisy, and one call of the networks serves N states. But an update uses T·N steps,
so with the same total, a larger N means fewer updates. (When processes pay off: see `make_envs`.)

Steps 1, 3 and 6, standardised A, the initial weights and clipped gradients are standard tricks.
`--randomize` gives each episode physics of its own (`RandomPhysics`).

In the code: s obs, a actions, V values, A advantages, λ gae_lambda, c entropy_coef.
In shapes: T rollout_steps, N num_envs, D numbers in an observation.
[1] Mnih et al. 2016, Asynchronous Methods for Deep RL, arXiv 1602.01783: A3C; A2C is synchronous.
[2] Schulman et al. 2016, Generalized Advantage Estimation, arXiv 1506.02438.
[3] Pardo et al. 2018, Time Limits in Reinforcement Learning, arXiv 1712.00378.
[4] Peng et al. 2018, Sim-to-Real Transfer ... with Dynamics Randomization, arXiv 1710.06537.
"""

import argparse
import copy
import os
import random
import signal
import sys
import time
from contextlib import closing
from functools import partial
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
        """Observations (…, D) -> π(·|s)."""
        logits = self.actor(self.obs_stats.normalise(obs))
        return torch.distributions.Categorical(logits=logits, validate_args=False)  # for speed

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,), in units of scaled rewards."""
        return self.critic(self.obs_stats.normalise(obs)).squeeze(-1)

    @torch.no_grad()
    def act(self, obs, deterministic=False):
        """NumPy observations (N, D) -> NumPy actions (N,): drawn from π, or the likeliest."""
        policy = self.policy(torch.tensor(obs))
        return (policy.mode if deterministic else policy.sample()).numpy()


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


def policy_loss(log_probs, advantages):
    """−mean(A·log π); log π and A are (T, N). Why does a step on it raise the return?

    An episode has the probability p = p(s_0)·π(a_0|s_0)·p(s_1|s_0,a_0)·π(a_1|s_1)·…, in which only
    the π depend on the weights, and ∇p = p·∇log p. So

        ∇E[return] = Σ return·∇p = E[return·Σ_t ∇log π(a_t|s_t)]          first Σ: over all episodes

    Given all that came before a_t, the mean of ∇log π(a_t|s_t) is Σ_a π·∇log π = ∇Σ_a π = ∇1 = 0.
    It stays 0 when multiplied by what is fixed by then, like earlier rewards or V(s_t). So we drop
    the earlier rewards and subtract V(s_t): the same mean, with less noise. (If all returns are
    near 200, without V every action is pushed up, with V only the better ones.)

                   = E[Σ_t (r_t + r_{t+1} + … − V(s_t))·∇log π(a_t|s_t)]
                   ≈ E[Σ_t A_t·∇log π(a_t|s_t)]

    as, given s_t and a_t, A_t has nearly the same mean as the bracket and far less noise (nearly,
    since it discounts, and relies on V). The mean in the loss only rescales the gradient. The
    actions must come from π as it is now, so a rollout serves for one gradient step. (Its first
    states came from a slightly older π.)
    """
    return -(advantages * log_probs).mean()


def optimise(agent, optimizer, obs, actions, advantages, targets, *, entropy_coef, max_grad_norm):
    """5. One gradient step on a whole rollout. Returns metrics."""
    # Mean 0 (one more baseline) and standard deviation 1, so that c and the actor's clipping suit
    # rewards of any size.
    standardised = (advantages - advantages.mean()) / (advantages.std(correction=0) + 1e-8)
    policy = agent.policy(obs)
    loss_pi = policy_loss(policy.log_prob(actions), standardised)
    loss_v = ((agent.value(obs) - targets) ** 2).mean() / 2
    entropy = policy.entropy().mean()
    optimizer.zero_grad()
    (loss_pi + loss_v - entropy_coef * entropy).backward()
    for network in agent.actor, agent.critic:  # clipping one must not shrink the other
        nn.utils.clip_grad_norm_(network.parameters(), max_grad_norm)
    optimizer.step()
    return {"value_loss": loss_v.item(), "entropy": entropy.item()}


# --- Environments ---------------------------------------------------------------------------------


def make_envs(args, seed, count, vectorization="sync", autoreset_mode="NextStep", **kwargs):
    """A vector of `count` environments: actions (N,) in; observations (N, D), rewards (N,), … out.

    `--vectorization sync` steps one after the other, in this process. With async each has a process
    of its own, so at every step a message goes to each and back, and all wait for the slowest:

        sync     N·step
        async    N·step/cores + N·message        roughly, if all steps take equally long

    Count only idle cores, at most N. On our machine a message there and back takes 0.04 ms, so
    async pays off if step·(1 − 1/cores) > 0.04 ms: with two cores, from 0.08 ms per step. A step of
    LunarLander takes 0.03 ms, too little. For your own environment run both, with `--num-evals 1`,
    and compare `seconds`.

    Evaluations are always sync: `evaluate` seeds the global generators of this process (np.random,
    …), so an environment that draws from them must live in it. Train such an environment sync, too:
    separate processes may all start with the same generator, and so play the same episodes.

    By default ("NextStep") a vector resets an environment in the step after the end of its episode.
    That step ignores the action and earns nothing: a transition that never happened, from which an
    agent should not learn. So in training ("Disabled") none resets itself, and `rollout` calls
    `envs.reset` with a mask: N rows come back, those outside the mask as they were. Evaluation only
    counts first episodes, so there NextStep does no harm and takes less code.
    """
    make_repeatable(seed)  # so that what environments draw when made is repeatable
    wrappers = [Tidy, gym.wrappers.RecordEpisodeStatistics]
    if args.randomize:
        wrappers.append(RandomPhysics)
    envs = gym.make_vec(args.env_id, count, vectorization, wrappers=wrappers,
                        vector_kwargs={"autoreset_mode": autoreset_mode}, **kwargs)
    obs_space, space = envs.single_observation_space, envs.single_action_space
    if not (isinstance(obs_space, gym.spaces.Box) and len(obs_space.shape) == 1
            and isinstance(space, gym.spaces.Discrete) and space.start == 0):
        envs.close()
        raise gym.error.Error("needs a flat Box of observations and Discrete actions, from 0 on "
                              f"(see docs/guide.md); has {obs_space} and {space}")
    envs.close = partial(envs.close, timeout=1)  # after Ctrl-C a process may not answer
    return gym.wrappers.vector.TransformObservation(
        envs, lambda obs: check_finite(f"an observation of {args.env_id}", obs.astype(float)))


class RandomPhysics(gym.Wrapper):
    """`--randomize`: each episode has its own gravity, and about half of them have wind [4].

    An agent is often meant for a world that we know only roughly, say a robot that is trained in a
    simulator. So we train and evaluate on many physics φ, and maximise E_φ[E[return | π, φ]]. π
    does not observe φ, so one policy has to do for all moons. Mean returns (± std over ten agents),
    by `--watch AGENT.pt --seed 99 --eval-episodes 100`, with `--no-randomize` or `--randomize`:

        trained             usual moon    random moons
        as usual            249 ± 17      199 ± 28
        with --randomize    219 ± 50      190 ± 42

    Here it does not pay off: on random moons nothing is gained, on the usual one perhaps 30 lost.
    It may where the real world is farther from the simulator. `policy_loss` still holds, as φ
    is drawn with s_0; but V does not see φ either, so A is noisier, and, as it relies on V, biased.

    For another environment, put its name in place of LunarLander in `__init__`, and its physics in
    place of the moon's five lines in `reset`. Set it before the environment's own reset, which may
    build the world from it. Draw from ranges as wide as your doubts (LunarLander allows a gravity
    from −12 to 0, and recommends these winds). Often only the environment's `__init__` checks such
    numbers and derives others from them: check your ranges, derive the others again. For CartPole:

        cart = self.unwrapped
        cart.length, cart.masspole = self.rng.uniform(0.3, 0.7), self.rng.uniform(0.05, 0.2)
        cart.total_mass = cart.masspole + cart.masscart
        cart.polemass_length = cart.masspole * cart.length
    """

    def __init__(self, env):
        super().__init__(env)
        if "LunarLander" not in env.unwrapped.spec.id:
            raise gym.error.Error("--randomize knows the physics of LunarLander only")

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.rng = np.random.default_rng([seed, 1])  # independent of the environment's own
        moon = self.unwrapped
        moon.gravity = self.rng.uniform(-11.99, -7.0)  # the usual moon has −10, and no wind
        moon.enable_wind = bool(self.rng.integers(2))
        moon.wind_power = self.rng.uniform(0.0, 20.0)
        moon.turbulence_power = self.rng.uniform(0.0, 2.0)
        return self.env.reset(seed=seed, options=options)


# --- Training -------------------------------------------------------------------------------------


def train(index, args, folder):
    """Train the agent of `args.seed[index]`; leave its log and its weights in `folder`.

    The log has a row for each update: `env_step` and `seconds` so far; `return`, the mean of the
    training episodes that ended in it, if any did; the metrics of `optimise` (`entropy` is at most
    the log of the number of actions); and after some updates `eval_return`. As evaluations play
    the likeliest actions, they may at first score far worse than training.
    """
    # If one seed fails, the others get SIGTERM: handle it like Ctrl-C, and close environments.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    seed = args.seed[index]
    with (closing(make_envs(args, seed, args.eval_episodes)) as eval_envs,
          closing(make_envs(args, seed, args.num_envs, args.vectorization, "Disabled")) as envs,
          tqdm(total=args.total_steps, disable=index > 0) as bar):
        make_repeatable(seed)  # the initial weights, and all that follows
        agent = Agent(envs.single_observation_space, envs.single_action_space, args.hidden_size)
        optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate, eps=1e-5, fused=True)
        log, env_step, evals_done, start = [], 0, 0, time.perf_counter()
        obs, _ = envs.reset(seed=make_seeds(seed, stream=2, count=args.num_envs))
        while env_step < args.total_steps:
            # 1. Anneal.
            remaining = 1 - env_step / args.total_steps
            optimizer.param_groups[0]["lr"] = remaining * args.learning_rate
            entropy_coef = remaining * args.entropy_coef
            # 2. Collect a rollout.
            batch, obs, returns = rollout(envs, agent, obs, args.rollout_steps)
            check_finite(f"a reward of {args.env_id}", batch.rewards.float())
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
    add("--total-steps", type=in_range(int, 1), default=1_000_000, help="steps per agent, at least")
    add("--env-id", default="LunarLander-v3", help="Gymnasium id or my_module:MyEnv-v0")
    add("--watch", type=Path, metavar="AGENT.pt", help="do not train, but film this agent")
    add("--out-dir", default="runs", help="where the folder of this run is created")
    add("--num-evals", type=in_range(int, 1), default=20, help="evaluations after a first one")
    add("--eval-episodes", type=in_range(int, 1), default=20, help="episodes of an evaluation")
    add("--num-envs", type=in_range(int, 1), default=8, help="environments stepped together")
    add("--vectorization", choices=("sync", "async"), default="sync", help="async: a process each")
    add("--randomize", action=argparse.BooleanOptionalAction, default=False, help="random moons")
    add("--rollout-steps", type=in_range(int, 1), default=64, help="steps per environment")
    add("--reward-scale", type=in_range(float, 0), default=0.1, help="multiplies rewards")
    add("--learning-rate", type=in_range(float, 0), default=2e-3, help="falls linearly to 0")
    add("--gamma", type=in_range(float, 0, 1), default=0.999, help="discount factor")
    add("--gae-lambda", type=in_range(float, 0, 1), default=0.98, help="0 trusts V, 1 the rewards")
    add("--entropy-coef", type=in_range(float, 0), default=0.01, help="falls linearly to 0")
    add("--max-grad-norm", type=in_range(float, 0), default=0.5, help="limit for each network")
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
