# /// script
# requires-python = ">=3.10,<3.14"
# dependencies = [
#     "torch>=2.6,<2.14",
#     "gymnasium[mujoco]>=1.4,<1.5",
#     "mujoco>=3.1,<3.16",
#     "numpy>=1.26",
#     "pandas>=2.2",
#     "seaborn>=0.13.2",
#     "matplotlib>=3.8",
#     "pillow>=10",
#     "tqdm>=4.66",
# ]
# ///
"""PPO: proximal policy optimisation for continuous actions, in one file.

It learns to balance a double pendulum in a minute: 150,000 steps, return 9,325 of 9,360 at most.
`--help` lists all options; each run leaves a folder in `runs`.

    python ppo_continuous.py --seed 1 2 3 4 5

In a state s (`obs` in the code) the actor, a network, has a Gaussian density π(u|s) and draws u.
The environment gets the action a = g(u), where g squeezes any number into the range that actions
have. It answers with a reward r and the next state, and so on until the episode ends.
The critic V(s), another network, predicts the mean of G_t = r_t + γ·r_{t+1} + γ²·r_{t+2} + …, the
discounted sum of the rewards that follow s_t. Both see s normalised, by a running mean and std.
  1. Set both learning rates: they fall evenly to 0.
     Play a rollout: T steps in each of N environments with π, called π_old from now on.
  2. Divide r by the running std of F_t = r_t + γ·(1 − done_{t−1})·F_{t−1}; so V has moderate size.
  3. δ_t = r_t + γ·(1 − terminated_t)·V(s_{t+1}) − V(s_t)     how much better than V predicted
  4. A_t = δ_t + γλ·(1 − done_t)·A_{t+1}, from the last step back (A is 0 after it)
     This is the advantage of u_t: how much better than V predicted all that followed it turned out.
     R_t = A_t + V(s_t)   target of the critic: what V(s_t) should have been, according to A
     (terminated_t is 1 if the episode ended for good at t, done_t if it ended at all; if not, 0)
  5. In several epochs, for each minibatch of M shuffled steps, with ρ = π(u|s) / π_old(u|s):
     If π is too far from π_old, that is if KL ≈ mean(ρ − 1 − log ρ) > max_kl, go to 6.
     Standardise A in the minibatch: mean 0, std 1. For all weights together compute the gradient of
         −mean(min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)) + ½·mean((V(s) − R)²) − c_H·H.
     If it is longer than max_grad_norm, shorten it to that. Take a step of Adam.
  6. Update the mean and std that normalise s. Go to 1, until enough steps were played.
Symbols: γ discount; ε clip range; H = −E[log π] entropy of u (large if σ is), c_H its weight; μ(s),
    σ mean and std of π; KL mean of log π_old(u|s) − log π(u|s) over u of π_old (0 if alike).
Shapes: T steps of N environments; B rows of a batch, M of a minibatch; D numbers in s; K in u.
Units: a `return` in tables and figures is the plain sum of an episode's raw rewards. `seconds` are
    those of training, without evaluations.

terminated: the episode ended for good (a fall, a landing), so no reward can follow. truncated: only
time ran out. Rewards could have followed; V(s_{t+1}) stands for them. done: either of the two.
Written out, A_t = δ_t + γλ·δ_{t+1} + (γλ)²·δ_{t+2} + … A larger λ trusts V less. With λ = 0 it is
δ_t: one reward, the rest is V. It varies little, but errors of V make it wrong (bias). With λ = 1
the V in between cancel out: A_t is the discounted sum of the rewards that came (and V where rollout
or time limit cut them off) minus V(s_t). It has less bias, but varies a lot (variance).

Why it works. The aim is a large expected return E[G]. Let ∇ be the gradient with respect to the
weights of π. Take one step alone: s is given, G(u) is the expected return after u, E a mean over u.
    ∇E[G] = ∇∫π(u|s)·G du = ∫∇π·G du = ∫π·(∇π/π)·G du = E[G·∇log π],  since ∇log π = ∇π/π.
So push up the probability of each action in proportion to what followed it. (G was held fixed here.
But it is r plus γ times the E[G] of the next state, which depends on the weights, too. By the
product rule that adds γ times the ∇E[G] of the next state, and so on. All in all ∇E[G_0] is the
mean of Σ_t γ^t·G_t·∇log π(u_t|s_t) over episodes. The factor γ^t is left out here, as usual, so
that late steps count like early ones.)
A number b may be subtracted from G if it does not depend on the action, for
E[b·∇log π] = b·∫∇π du = b·∇∫π du = b·∇1 = 0. With b = V(s), an action counts by how much better
than expected it turned out: on average the gradient stays the same, but it has less noise.
A estimates G − V(s). With A held constant, −mean(A·log π) has this gradient, times −1. To
standardise A hardly turns it: the mean acts like b, the std scales it, both depend little on u.
PPO takes many steps of Adam on the same rollout, which π_old played. So each u is weighted by ρ:
the mean over u of π_old, E_old[ρ·A] = ∫π_old·(π/π_old)·A du = ∫π·A du, has the gradient ∫∇π·A du,
as above with A for G. The farther π is from π_old, the more ρ varies, and the more noise this has;
and the states are still those of π_old. So KL limit and clip have to keep π close to π_old.

= A2C (a2c_vector.py) plus: continuous actions, a running reward scale (step 2), several epochs of
minibatches, the KL limit, ρ and its clip (step 5). Left out: recurrent networks, images.

References: [1] Schulman et al. 2017, Proximal Policy Optimization Algorithms. [2] Schulman et al.
    2016, High-Dimensional Continuous Control Using Generalized Advantage Estimation. [3] Pardo et
    al. 2018, Time Limits in Reinforcement Learning. [4] Schulman 2020, Approximating KL Divergence.
    [5] Chan et al. 1979, Updating Formulae and a Pairwise Algorithm for Computing Sample Variances.
"""

import argparse
import json
import math
import multiprocessing
import os
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor, wait
from importlib.metadata import distributions
from pathlib import Path

import gymnasium as gym
import matplotlib
import numpy as np
import pandas as pd
import seaborn as sns
import torch
from PIL import Image
from torch import nn
from tqdm import tqdm

# --- Arguments ------------------------------------------------------------------------------------


def parse_args(argv=None):
    """All options, with defaults and symbols."""
    parser = argparse.ArgumentParser(
        description=__doc__.partition("\n")[0], usage=argparse.SUPPRESS,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    devices = ("cpu", "cuda", "mps") if torch.accelerator.is_available() else ("cpu",)
    add = parser.add_argument_group("run").add_argument
    add("--seed", type=number(int, 0), nargs="+", default=[1], help="several train side by side")
    add("--total-steps", type=number(int, 1), default=150_000, help="environment steps, at least")
    add("--device", choices=devices, default="cpu", help="what computes the networks")
    add("--out-dir", default="runs", help="where the folder of this run is made")
    add("--resume", metavar="CHECKPOINT", help="go on with the run that saved this checkpoint")
    add("--watch", metavar="CHECKPOINT", help="evaluate this checkpoint and make a GIF of it")
    add = parser.add_argument_group("environment").add_argument
    add("--env-id", default="InvertedDoublePendulum-v5",
        help="a Gymnasium id, also my_module:MyEnv-v0; episodes end after 10,000 steps at most")
    add("--num-envs", type=number(int, 1), default=16, help="environments stepped together, N")
    add("--vectorization", choices=("sync", "async"), default="sync", help="async: in processes")
    add = parser.add_argument_group("algorithm").add_argument
    add("--rollout-steps", type=number(int, 1), default=128, help="steps of each environment, T")
    add("--epochs", type=number(int, 1), default=10, help="passes over a rollout, at most")
    add("--minibatch-size", type=number(int, 2), default=512, help="steps of a minibatch, M")
    add("--learning-rate", type=number(float, 0), default=1e-3, help="of Adam; it falls to 0")
    add("--gamma", type=number(float, 0, 1), default=0.99, help="discount of later rewards, γ")
    add("--gae-lambda", type=number(float, 0, 1), default=0.95, help="λ: 0 trusts V, 1 the rewards")
    add("--clip-eps", type=number(float, 0), default=0.2, help="clips the ratio at 1 ± ε")
    add("--max-kl", type=number(float, 0), default=0.03, help="a larger KL ends an update")
    add("--entropy-coef", type=number(float, 0), default=0.0, help="weight of the entropy, c_H")
    add("--max-grad-norm", type=number(float, 0), default=0.5, help="longer gradients are shrunk")
    add("--hidden-size", type=number(int, 1), default=64, help="units in each of two hidden layers")
    add("--log-std", type=number(float, -10, 2), default=-0.5, help="log σ before training")
    add("--std-learning-rate", type=number(float, 0), default=3e-4, help="that of log σ")
    add = parser.add_argument_group("evaluation").add_argument
    add("--num-evals", type=number(int, 1, 1e6), default=20, help="evaluations, one more at start")
    add("--eval-episodes", type=number(int, 1), default=10, help="episodes of an evaluation")
    return check(parser, argv)


# --- Agent ----------------------------------------------------------------------------------------


class RunningNorm(nn.Module):
    """(x − mean) / √var, within ±10, with mean and variance of all rows that `update` was given.

    They are buffers: they are saved with the weights, and nothing but `update` changes them. At
    first they are 0 and 1: in the first rollout the states are only held within ±10.
    """

    def __init__(self, shape):
        super().__init__()
        self.register_buffer("mean", torch.zeros(shape))
        self.register_buffer("var", torch.ones(shape))
        self.register_buffer("count", torch.zeros((), dtype=torch.int64))

    def forward(self, x):
        return ((x - self.mean) / self.var.sqrt()).clamp(-10, 10)

    def update(self, rows):
        """Pool `rows` (B, …) with all earlier ones ([5]). With the share w of the new ones:

        var ← (1−w)·var + w·var_new + w·(1−w)·(mean_new − mean)²
        mean ← (1−w)·mean + w·mean_new
        """
        self.count += len(rows)
        weight = len(rows) / self.count
        gap = (1 - weight) * (rows.mean(0) - self.mean) ** 2  # `lerp_` multiplies it by w
        # Of a dimension that never moved the variance is 0; nothing may be divided by that.
        self.var.lerp_(rows.var(0, correction=0) + gap, weight).clamp_(min=1e-8)
        self.mean.lerp_(rows.mean(0), weight)


def mlp(inputs, hidden, outputs, activation, output_gain):
    """Two hidden layers and a linear one, with orthogonal weights and biases of 0 at first.

    A gain of √2 is what ReLU needs to keep the size of a signal, and usual for tanh as well. With
    an output gain of 0.01 π starts nearly the same in all states.
    """
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (math.sqrt(2), math.sqrt(2), output_gain)):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], activation(), layers[1], activation(), layers[2])


class Agent(nn.Module):
    """The actor π(u|s) = Normal(μ(s), σ), the critic V(s), what normalises states and rewards.

    σ (K,) is the same in every state. Its logarithm is a parameter with a learning rate of its own.
    """

    def __init__(self, observation_space, action_space, args):
        super().__init__()
        inputs, outputs = observation_space.shape[0], action_space.shape[0]
        self.norm = RunningNorm(observation_space.shape)
        self.actor = mlp(inputs, args.hidden_size, outputs, nn.Tanh, output_gain=0.01)
        self.critic = mlp(inputs, args.hidden_size, 1, nn.Tanh, output_gain=1.0)
        self.reward_norm = RunningNorm(())
        self.log_std = nn.Parameter(torch.full((outputs,), args.log_std))
        self.register_buffer("low", torch.as_tensor(action_space.low, dtype=torch.float32))
        self.register_buffer("high", torch.as_tensor(action_space.high, dtype=torch.float32))

    def policy(self, obs):
        """Observations (…, D) -> the distribution of u (…, K), whose dimensions are independent."""
        mean, std = self.actor(self.norm(obs)), self.log_std.exp()
        return torch.distributions.Normal(mean, std, validate_args=False)  # faster

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,), in units of scaled rewards."""
        return self.critic(self.norm(obs)).squeeze(-1)

    @torch.inference_mode()
    def act(self, obs, deterministic=False):
        """NumPy (N, D) -> NumPy: samples u of π, or the mean μ, and actions a = g(u); (N, K).

        g is tanh, stretched to (low, high). The density of a is that of u over |g'(u)|. In ρ, a
        ratio of two densities, |g'(u)| cancels: so all the rest can work with u.
        """
        obs = torch.as_tensor(obs, dtype=torch.float32, device=self.norm.mean.device)
        policy = self.policy(obs)
        samples = policy.mode if deterministic else policy.sample()
        actions = torch.lerp(self.low, self.high, (torch.tanh(samples) + 1) / 2)
        return samples.cpu().numpy(), actions.cpu().numpy()


# --- Rollout --------------------------------------------------------------------------------------


def rollout(envs, agent, obs, num_steps, env_step):
    """Step 1: `num_steps` steps in each environment, from observations `obs` (N, D) on.

    Returns the transitions, a dict of tensors (T, N, …); the observations to go on from; and a row
    for each episode that ended. `env_step`: the steps of all environments before this rollout.

    An environment whose episode ends starts the next one within the same step. Then new_obs[i] is
    the first observation of the next episode, from which π plays on; next_obs[i], for V, is the
    last one of this episode, found in infos.
    """
    steps, episodes = [], []
    for _ in range(num_steps):
        samples, actions = agent.act(obs)
        new_obs, rewards, terminated, truncated, infos = envs.step(actions)
        env_step += len(obs)
        done = terminated | truncated
        next_obs = new_obs.copy()
        for i in np.flatnonzero(done):
            next_obs[i] = infos["final_obs"][i]
            ended = infos["final_info"]["episode"]
            episodes.append({"env_step": env_step, "return": float(ended["r"][i]),
                             "length": int(ended["l"][i])})
        check_finite(0, env_step // len(obs), rewards, next_obs, new_obs)
        steps.append({"obs": obs, "samples": samples, "rewards": rewards, "next_obs": next_obs,
                      "terminated": terminated, "done": done})
        obs = new_obs
    batch = {name: np.array([step[name] for step in steps]) for name in steps[0]}
    for name, column in batch.items():
        batch[name] = torch.as_tensor(column, dtype=torch.float32, device=agent.norm.mean.device)
    return batch, obs, episodes


# --- Returns and advantages -----------------------------------------------------------------------


def scale_rewards(rewards, done, past_return, reward_norm, gamma):
    """Step 2: rewards (T, N) over the running standard deviation of F.

    V predicts a discounted sum of rewards to come. F is such a sum of past rewards: it varies about
    as much and is known at once. The mean of r is not subtracted, else a reward of 1 for each step
    would become 0. `past_return` (N,) is F at the end of the previous rollout, 0 where an episode
    ended (and before the first rollout). Returns the scaled rewards, and F at the end of this one.
    """
    past_returns = torch.empty_like(rewards)
    for t in range(len(rewards)):
        past_returns[t] = rewards[t] + gamma * past_return
        past_return = (1 - done[t]) * past_returns[t]
    reward_norm.update(past_returns.flatten())
    return rewards / reward_norm.var.sqrt(), past_return


def compute_gae(rewards, values, next_values, terminated, done, gamma, gae_lambda):
    """Steps 3 and 4: generalised advantage estimates A ([2] eq. 11, 16); all (T, N).

    A terminal state is worth nothing, whatever the critic says. At a time limit V(s_{t+1}) stands
    for the rewards that were cut off ([3] eq. 6). Either way A_{t+1} is of another episode: it is
    left out. After the last step of the rollout V(s_{t+1}) stands for all that follows.
    """
    deltas = rewards + gamma * (1 - terminated) * next_values - values  # step 3
    advantages = torch.empty_like(deltas)
    advantage = 0.0
    for t in reversed(range(len(deltas))):
        advantage = deltas[t] + gamma * gae_lambda * (1 - done[t]) * advantage  # step 4
        advantages[t] = advantage
    return advantages


# --- Losses ---------------------------------------------------------------------------------------


def policy_loss(ratio, advantages, clip_eps):
    """−mean(min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)); (M,) each ([1] eq. 7).

    If A > 0, the gradient is 0 once ρ > 1 + ε; if A < 0, once ρ < 1 − ε: nothing is gained by going
    further. If ρ went the wrong way, min takes the term that leads back: with ε = 0.2, ρ = 0.5 and
    A = 1 it takes 0.5, which has a gradient, and not the clipped 0.8, which has none.
    """
    clipped_ratio = ratio.clamp(1 - clip_eps, 1 + clip_eps)
    return -torch.min(ratio * advantages, clipped_ratio * advantages).mean()


def value_loss(values, targets):
    """½·mean((V − target)²); (…,) each -> ()."""
    return ((values - targets) ** 2).mean() / 2


def approximate_kl(log_ratio):
    """KL(π_old ‖ π) = E_old[−log ρ] ≈ mean(ρ − 1 − log ρ); (M,) -> ().

    E_old[ρ − 1] = ∫π − ∫π_old = 0, so it changes nothing on average. But now no term is negative,
    and there is much less noise ([4]).
    """
    return (log_ratio.expm1() - log_ratio).mean()  # expm1(x) = exp(x) − 1, exact near 0


# --- Update ---------------------------------------------------------------------------------------


def optimise(agent, optimizer, batch, args):
    """Steps 3 to 5. Returns the diagnostics of each minibatch that was looked at."""
    obs, samples = batch["obs"].flatten(0, 1), batch["samples"].flatten(0, 1)
    with torch.no_grad():  # advantages and targets are data: no gradient goes through them
        values, next_values = agent.value(batch["obs"]), agent.value(batch["next_obs"])
        advantages = compute_gae(batch["rewards"], values, next_values, batch["terminated"],
                                 batch["done"], args.gamma, args.gae_lambda).flatten()
        targets = advantages + values.flatten()
        old_log_probs = agent.policy(obs).log_prob(samples).sum(-1)  # no step yet: π is still π_old
    # The share of the variance of R that V predicts; A = R − V is the rest. A constant has 0.
    explained_variance = 1 - advantages.var(correction=0) / targets.var(correction=0)
    logs = []
    for _ in range(args.epochs):
        for rows in torch.randperm(len(obs)).split(args.minibatch_size):
            policy = agent.policy(obs[rows])
            log_ratio = policy.log_prob(samples[rows]).sum(-1) - old_log_probs[rows]
            ratio = log_ratio.exp()  # ρ
            kl = approximate_kl(log_ratio)
            A = advantages[rows]
            standardised = (A - A.mean()) / (A.std(correction=0) + 1e-8)
            loss_pi = policy_loss(ratio, standardised, args.clip_eps)
            loss_v = value_loss(agent.value(obs[rows]), targets[rows])
            entropy = policy.entropy().sum(-1).mean()
            log = {"policy_loss": loss_pi.item(), "value_loss": loss_v.item(),
                   "entropy": entropy.item(), "policy_std": policy.stddev.mean().item(),
                   "approximate_kl": kl.item(), "explained_variance": explained_variance.item(),
                   "clip_fraction": ((ratio - 1).abs() > args.clip_eps).float().mean().item()}
            logs.append(log)
            if kl > args.max_kl:  # step 5, too far
                return logs
            optimizer.zero_grad()
            (loss_pi + loss_v - args.entropy_coef * entropy).backward()
            log["gradient_norm"] = nn.utils.clip_grad_norm_(
                agent.parameters(), args.max_grad_norm, error_if_nonfinite=True).item()
            optimizer.step()  # step 5
    return logs


# --- Training -------------------------------------------------------------------------------------


def train(args, seed):
    """Train one seed; yields at the start and after each update what there is to write down."""
    torch.set_num_threads(1)  # networks this small do not gain from more threads
    torch.manual_seed(make_seeds(seed, stream=0, count=1)[0])
    envs = make_envs(args)
    agent = Agent(envs.single_observation_space, envs.single_action_space, args).to(args.device)
    # Adam divides a gradient by its usual size + eps. With its default eps of 1e-8 even the tiniest
    # gradients move a weight as far as large ones do; with 1e-5 they do not.
    networks = [*agent.actor.parameters(), *agent.critic.parameters()]
    optimizer = torch.optim.Adam(
        [{"params": networks}, {"params": agent.log_std}], eps=1e-5, fused=True)
    env_step = resume(args.resume, agent, optimizer) if args.resume else 0
    obs, _ = envs.reset(seed=make_seeds(seed, 2 + env_step, args.num_envs))
    past_return = 0.0
    yield env_step, agent, optimizer, [], {}
    while env_step < args.total_steps:
        share = 1 - env_step / args.total_steps
        optimizer.param_groups[0]["lr"] = args.learning_rate * share  # step 1
        optimizer.param_groups[1]["lr"] = args.std_learning_rate * share
        batch, obs, episodes = rollout(envs, agent, obs, args.rollout_steps, env_step)  # step 1
        batch["rewards"], past_return = scale_rewards(
            batch["rewards"], batch["done"], past_return, agent.reward_norm, args.gamma)  # step 2
        logs = optimise(agent, optimizer, batch, args)  # steps 3 to 5
        # Only now: until here s has to be normalised as it was in the rollout.
        agent.norm.update(batch["obs"].flatten(0, 1))  # step 6
        env_step += batch["rewards"].numel()
        yield env_step, agent, optimizer, episodes, pd.DataFrame(logs).mean().to_dict()
    envs.close()


# ==================================================================================================
# From here on: nothing about the algorithm
# ==================================================================================================

# --- Environments ---------------------------------------------------------------------------------


def record_episodes(env):
    """Records return and length of each episode, and ends it after 10,000 steps at the latest."""
    return gym.wrappers.RecordEpisodeStatistics(gym.wrappers.TimeLimit(env, 10_000))


def make_envs(args, *wrappers):
    """N environments, stepped together; whichever ends restarts within the same step."""
    return gym.make_vec(
        args.env_id, args.num_envs, args.vectorization, wrappers=[*wrappers, record_episodes],
        vector_kwargs={"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP})


def make_seeds(seed, stream, count):
    """`count` integers; each seed has its own, and so has each purpose (stream).

    Stream 0: weights and actions, 1: evaluations, 2 + k: environments from step k of training on.
    """
    return np.random.SeedSequence(seed, spawn_key=(stream,)).generate_state(count).tolist()


def check_finite(first, step, *arrays):
    """Ends the run in one line if an environment returned NaN or infinity.

    Row i of the arrays (N, …) comes from environment `first` + i. `step` counts from the start of
    training, in an evaluation from that of the episode.
    """
    for values in arrays:
        if not np.isfinite(values).all():
            culprit = first + np.argwhere(~np.isfinite(values))[0, 0]
            sys.exit(f"error: environment {culprit} returned NaN or infinity at its step {step}")


# --- Evaluate and watch ---------------------------------------------------------------------------


def evaluate(agent, envs, seed):
    """A deterministic episode in each of `envs`, side by side; the same starts at every call."""
    seeds = make_seeds(seed, stream=1, count=len(envs))
    obs = {env: env.reset(seed=seed)[0] for env, seed in zip(envs, seeds)}
    while obs:  # the last observation of each environment whose episode goes on
        _, actions = agent.act(np.stack(list(obs.values())), deterministic=True)  # for all at once
        for env, action in zip(list(obs), actions):
            obs[env], reward, terminated, truncated, _ = env.step(action)
            check_finite(envs.index(env), env.episode_lengths, np.array([reward]), obs[env][None])
            if terminated or truncated:
                del obs[env]
    returns, lengths = np.array([(env.episode_returns, env.episode_lengths) for env in envs]).T
    return {"return_mean": returns.mean().item(), "return_std": returns.std().item(),
            "length_mean": lengths.mean().item(), "episodes": len(envs)}


def watch(args):
    """Evaluate a checkpoint, and make a GIF of the first episode beside it."""
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "egl")  # which needs no display
    gif = Path(args.watch).with_suffix(".gif")
    print(f"drawing {gif}", flush=True)
    camera = gym.wrappers.RenderCollection(gym.make(args.env_id, render_mode="rgb_array"))
    envs = [camera, *(gym.make(args.env_id) for _ in range(args.eval_episodes - 1))]
    agent = Agent(camera.observation_space, camera.action_space, args)
    agent.load_state_dict(torch.load(args.watch, "cpu", weights_only=True)["agent"])
    result = evaluate(agent, [record_episodes(env) for env in envs], args.seed[0])
    print("return {return_mean:.1f} ± {return_std:.1f} in {episodes} episodes".format(**result))
    fps = camera.metadata.get("render_fps", 25)
    every = math.ceil(fps / 25)  # 25 pictures a second are enough
    pictures = [Image.fromarray(picture).reduce(2) for picture in camera.render()[::every]]
    pictures[0].save(gif, save_all=True, append_images=pictures[1:], duration=1000 * every / fps)


# --- Files ----------------------------------------------------------------------------------------


def make_folder(args):
    """A new folder for this call, with args.json."""
    name = f"{args.env_id}__{Path(__file__).stem}__{pd.Timestamp.now():%Y%m%d_%H%M%S%f}"
    folder = Path(args.out_dir, name.replace(":", "-").replace("/", "-"))
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        argparse.ArgumentParser(usage=argparse.SUPPRESS).error(f"argument --out-dir: {error}")
    versions = {package.name: package.version for package in distributions()}
    record = {**vars(args), "command": sys.argv, "versions": versions}
    (folder / "args.json").write_text(json.dumps(record, indent=2))
    return folder


def run(args, seed, folder, position=0):
    """Train one seed; all that it leaves goes into `folder`. `position`: the line of its bar."""
    envs = [record_episodes(gym.make(args.env_id)) for _ in range(args.eval_episodes)]
    tables = {"evals": [], "episodes": [], "metrics": []}
    due = np.arange(args.num_evals + 1.0) * args.total_steps / args.num_evals  # when to evaluate
    seconds = 0.0
    start = time.perf_counter()
    if args.resume:
        tables = torch.load(args.resume, "cpu", weights_only=True)["tables"]
        seconds = tables["evals"].pop()["seconds"]  # this row is made again
    with tqdm(desc=f"seed {seed}", total=args.total_steps, unit="step", unit_scale=True,
              position=position, leave=False, mininterval=1) as bar:
        for env_step, agent, optimizer, episodes, diagnostics in train(args, seed):
            if diagnostics:  # an update was made
                seconds += time.perf_counter() - start
                tables["episodes"] += episodes
                speed = {"steps_per_second": env_step / seconds}
                tables["metrics"].append({"env_step": env_step, **diagnostics, **speed})
            if env_step >= due[0]:
                evaluation = evaluate(agent, envs, seed)
                tables["evals"].append({"env_step": env_step, "seconds": seconds, **evaluation})
                save(args, seed, folder, tables, agent, optimizer)
                due = due[due > env_step]
            returns = [row["return"] for row in tables["episodes"][-20:]]
            training = f"{np.mean(returns):.0f}" if returns else "not known yet"
            bar.set_postfix_str(
                f"evaluation {evaluation['return_mean']:.0f}, training {training}", refresh=False)
            bar.update(min(env_step, args.total_steps) - bar.n)
            start = time.perf_counter()  # evaluating and saving are not training


def save(args, seed, folder, tables, agent, optimizer):
    """Write the tables and the checkpoint; each file is replaced in one go."""
    folder.mkdir(exist_ok=True)
    for name, rows in tables.items():
        if rows:
            pd.DataFrame(rows).to_csv(folder / "table.tmp", index=False)
            os.replace(folder / "table.tmp", folder / f"{name}.csv")
    state = {"args": {**vars(args), "seed": [seed]}, "tables": tables, "rng": torch.get_rng_state(),
             "agent": agent.state_dict(), "optimizer": optimizer.state_dict()}
    torch.save(state, folder / "checkpoint.tmp")
    os.replace(folder / "checkpoint.tmp", folder / "checkpoint.pt")


def resume(path, agent, optimizer):
    """Bring back agent, optimizer and random numbers; returns the environment steps so far.

    Episodes that were going on are lost. On a GPU the random numbers start anew.
    """
    checkpoint = torch.load(path, agent.norm.mean.device, weights_only=True)
    agent.load_state_dict(checkpoint["agent"])
    optimizer.load_state_dict(checkpoint["optimizer"])
    torch.set_rng_state(checkpoint["rng"].cpu())
    return checkpoint["tables"]["evals"][-1]["env_step"]


# --- Plot -----------------------------------------------------------------------------------------


def plot(folder, env_id):
    """learning_curve.png: a panel for each quantity in the tables, over environment steps.

    A line is the mean over the seeds, its band reaches from the lowest to the highest. Before that,
    each seed is averaged over hundredths of the run; gaps are interpolated, and where a seed ended
    early, its last value goes on.
    """
    names = ("evals.csv", "episodes.csv", "metrics.csv")
    files = [file for file in sorted(folder.glob("**/*.csv")) if file.name in names]
    data = pd.concat([pd.read_csv(file).assign(seed=file.parent) for file in files])
    total = data["env_step"].max()
    data["env_step"] = np.ceil(100 * data["env_step"] / total) / 100 * total
    data = data.groupby(["env_step", "seed"]).mean().unstack().interpolate("index")
    data = data.drop(columns=["seconds", "return_std", "episodes"]).stack(future_stack=True)
    data = data.reset_index().melt(["env_step", "seed"])
    evaluated = data["variable"].str.endswith("_mean")
    data["actions"] = np.where(evaluated, "deterministic: evaluation", "sampled: training")
    data["variable"] = data["variable"].str.removesuffix("_mean").str.replace("_", " ")
    grid = sns.relplot(data, x="env_step", y="value", col="variable", hue="actions", col_wrap=4,
                       kind="line", errorbar=("pi", 100), palette="colorblind", height=2.5,
                       facet_kws={"sharey": False})
    grid.set_titles("{col_name}").set_axis_labels("environment steps", "")
    title = f"{env_id}, seeds: {data['seed'].nunique()} (line: mean, band: lowest to highest)"
    grid.figure.suptitle(title, y=1.02)
    grid.savefig(folder / "learning_curve.png")


# --- Command line ---------------------------------------------------------------------------------


def number(kind, low, high=1e12):
    """An argparse type: an int or float from `low` to `high`; 1e6 is an int, NaN is refused."""

    def numeric(text):  # argparse says "invalid numeric value" if float(text) fails
        value = float(text)
        if low <= value <= high and kind(value) == value:
            return kind(value)
        raise argparse.ArgumentTypeError(f"got {text}, takes {kind.__name__} in [{low}, {high:g}]")

    return numeric


def check(parser, argv):
    """The arguments if they can work, else one line that says why not, and exit status 2."""
    args = parser.parse_args(argv)
    path = args.resume if args.watch is None else args.watch
    expected = (gym.error.Error, ImportError) if path is None else Exception
    try:
        if path is not None:
            checkpoint = torch.load(path, "cpu", weights_only=True)  # runs no code from the file
            # Options given now override those in the checkpoint, which override the defaults.
            args = parser.parse_args(argv, argparse.Namespace(**checkpoint["args"]))
        env = gym.make(args.env_id)
        spaces = env.observation_space, env.action_space
        boxes = all(isinstance(space, gym.spaces.Box) and len(space.shape) == 1 for space in spaces)
        if not boxes or not env.action_space.is_bounded():
            raise gym.error.Error(
                "takes flat Box observations (gymnasium.wrappers.FlattenObservation), bounded Box "
                f"actions (a2c_vector.py: Discrete, reinforce_mujoco.py: unbounded), not {spaces}")
        if path is not None:
            Agent(*spaces, args).load_state_dict(checkpoint["agent"])
    except expected as error:
        name = "--env-id" if path is None else f"--watch or --resume: {path}"
        parser.error(f"argument {name}: {error!r}")
    if len(set(args.seed)) < len(args.seed) or args.resume and len(args.seed) > 1:
        parser.error(f"argument --seed: got {args.seed}, takes each once, and one with --resume")
    return args


def train_seeds(args, folders):
    """One seed here, several side by side in processes of their own."""
    if len(folders) == 1:
        return run(args, args.seed[0], folders[0])
    context = multiprocessing.get_context("spawn")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the processes that start now ignore Ctrl-C
    pool = ProcessPoolExecutor(None, context, tqdm.set_lock, (context.RLock(),))
    jobs = [pool.submit(run, args, *job) for job in zip(args.seed, folders, range(len(folders)))]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    wait(jobs)
    for job in jobs:
        job.result()  # raises what went wrong there


def main():
    matplotlib.use("agg")  # draws into files, needs no display
    sys.path.append(os.getcwd())  # for my_module:MyEnv-v0
    if hasattr(sys.stdout, "reconfigure"):  # not in a notebook
        sys.stdout.reconfigure(errors="replace")  # where γ cannot be printed
    args = parse_args()
    if args.watch:
        return watch(args)
    folder = Path(args.resume).parent if args.resume else make_folder(args)
    folders = [folder] if args.resume else [folder / f"seed-{seed}" for seed in args.seed]
    try:
        train_seeds(args, folders)
    except KeyboardInterrupt:
        for process in multiprocessing.active_children():  # several seeds, or environments
            process.terminate()
    finally:
        if any(folder.glob("**/metrics.csv")):
            print(f"drawing {folder / 'learning_curve.png'}", flush=True)
            plot(folder, args.env_id)
        for file in sorted(folder.glob("**/evals.csv")):
            last, path = pd.read_csv(file).iloc[-1], file.with_name("checkpoint.pt")
            print(f"return {last['return_mean']:.1f} after {last['env_step']:,.0f} steps, "
                  f"{last['seconds'] / 60:.1f} minutes: {path}")
            if last["env_step"] < args.total_steps:
                print(f"to go on: python {sys.argv[0]} --resume {path}")


if __name__ == "__main__":
    main()
