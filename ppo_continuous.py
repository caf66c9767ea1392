# /// script
# requires-python = ">=3.10"
# dependencies = [
#     "torch>=2.6,<2.14",
#     "gymnasium[mujoco,box2d]>=1.4,<1.5",
#     "mujoco>=3.1,<3.16",
#     "numpy>=1.26",
#     "pandas>=2.2",
#     "seaborn>=0.13.2",
#     "matplotlib>=3.8",
#     "tqdm>=4.66",
# ]
# ///
"""PPO for continuous control: proximal policy optimisation, in one file.

Learns:   InvertedDoublePendulum-v5 in 151,552 steps: 9322 to 9326 of about 9350 points with the
          seeds 1 to 5 (deterministic, 10 episodes each), 20 seconds a seed, two at a time on a
          2-core AMD EPYC; Python 3.11, torch 2.13, Gymnasium 1.4, MuJoCo 3.15.
Command:  python ppo_continuous.py --seed 1 2 3 4 5

The algorithm. For a state s the policy π draws a Gaussian sample u, the environment gets the action
a = g(u), within its bounds, and returns a reward r; the critic V(s) predicts the discounted sum of
rewards to come. What turns out better than V foresaw is made more likely (reinforce_mujoco.py says
why that makes returns grow):
  1. Play T steps in N environments with π, from now on π_old:  u_t ~ N(μ(s_t), σ²),  a_t = g(u_t)
  2. Divide r by the running std of G_t = r_t + γ·G_{t−1}, where each episode begins with G = 0.
  Several times:
  3.   δ_t = r_t + γ·(1 − terminated_t)·V(s_{t+1}) − V(s_t)   what a step gave beyond what V foresaw
  4.   A_t = δ_t + γλ·(1 − done_t)·A_{t+1},  R_t = A_t + V(s_t)   advantage, critic's target
       For each minibatch, A standardised, with the ratio ρ = π(u|s) / π_old(u|s):
  5.     end the update if π is too far from π_old:  KL ≈ E[ρ − 1 − log ρ] > 1.5·target_kl
  6.     Adam on  −E[min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)] + c_V·E[(V(s) − R)²] − c_H·H(π)
  7. Update the mean and variance that normalise s, lower the learning rate, go to 1.
terminated: an end for good; done: any end. At a mere time limit more reward could have followed.
With λ = 0, A = δ: little noise, but wrong where V is. With λ = 1, A is the discounted sum of the
rewards that followed, minus V: noisy, but V can be wrong only where it stands for rewards that were
cut off.
At π = π_old the gradient of E[ρ·A] is E[A·∇log π], that of A2C. Further away the samples of π_old
tell less and less about π: hence 5, and the clipping in 6.

= A2C (a2c_vector.py) plus: several epochs of minibatches per rollout, the KL limit (5), the clipped
objective (6). Unlike [1], each epoch repeats 3 and 4 with the critic as it is by then ([6]). What
else is new: actions are continuous (1), the scale of the rewards is found while learning (2).
Left out on purpose: recurrent or shared networks, images, discrete actions, logging services.

Symbols:     γ discount, λ trust in rewards (1) against V (0), ε clip range, H entropy.
Shapes:      T steps, N environments, B = T·N rows, M rows in a minibatch, D dimensions of a state,
             K dimensions of an action.
Units:       raw rewards in all returns (not in value_loss: step 2); environment steps; seconds.
References:  [1] Schulman et al. 2017, Proximal Policy Optimization Algorithms.
             [2] Schulman et al. 2016, High-Dimensional Continuous Control Using Generalized
             Advantage Estimation. [3] Pardo et al. 2018, Time Limits in Reinforcement Learning.
             [4] Schulman 2020, Approximating KL Divergence. [5] Chan et al. 1979, Updating Formulae
             and a Pairwise Algorithm for Computing Sample Variances. [6] Andrychowicz et al. 2021,
             What Matters for On-Policy Deep Actor-Critic Methods?
"""

import argparse
import contextlib
import csv
import importlib.metadata
import json
import math
import multiprocessing
import os
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from datetime import datetime
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import seaborn as sns
import torch
from matplotlib.figure import Figure
from PIL import Image
from torch import nn
from tqdm import tqdm

SCRIPT = Path(__file__).stem


# --- Environment ----------------------------------------------------------------------------------


class CheckedEnv(gym.Wrapper):
    """Says which environment failed, and when; sums up each episode in its last info."""

    def __init__(self, env, index):
        super().__init__(env)
        self.index, self.steps = index, 0

    def check(self, obs, reward=0.0):
        if not math.isfinite(np.dot(obs, obs) + reward):  # finite only if every part is
            raise FloatingPointError("it returned NaN or infinity")

    def fail(self, error):
        at = f"environment {self.index}, at its step {self.steps}"
        raise gym.error.Error(f"{at}: {error!r}") from error

    def reset(self, **options):
        self.episode_return, self.episode_start = 0.0, self.steps
        try:
            obs, _ = self.env.reset(**options)
            self.check(obs)
        except Exception as error:
            self.fail(error)
        return obs, {}

    def step(self, action):
        self.steps += 1
        try:
            obs, reward, terminated, truncated, _ = self.env.step(action)
            self.check(obs, reward)
        except Exception as error:
            self.fail(error)
        self.episode_return += float(reward)
        ended = terminated or truncated
        row = self.episode_return, self.steps - self.episode_start
        return obs, reward, terminated, truncated, {"episode": row} if ended else {}


def make_envs(env_id, num_envs):
    """N environments, stepped together; whichever ends restarts within the same step."""
    makers = [lambda i=i: CheckedEnv(gym.make(env_id), i) for i in range(num_envs)]
    return gym.vector.SyncVectorEnv(makers, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)


def make_seeds(seed, stream, count):
    """`count` integers for one purpose of a run; runs and purposes (streams) share none.

    Stream 0: networks and noise, 1: evaluation, 2 + k: environments (re)started at update k.
    """
    return np.random.SeedSequence(seed, spawn_key=(stream,)).generate_state(count).tolist()


# --- Networks -------------------------------------------------------------------------------------


class RunningNorm(nn.Module):
    """(x − mean) / √var, clipped, with the mean and variance of all rows that `update` was given.

    They are buffers: a checkpoint carries them, and nothing but `update` changes them.
    """

    def __init__(self, shape, clip=10.0):
        super().__init__()
        self.clip = clip
        self.register_buffer("mean", torch.zeros(shape))
        self.register_buffer("var", torch.ones(shape))
        self.register_buffer("count", torch.zeros((), dtype=torch.int64))

    def forward(self, x):
        return ((x - self.mean) / self.var.sqrt()).clamp(-self.clip, self.clip)

    def update(self, rows):
        """Pool `rows` (B, …) with all earlier ones ([5])."""
        rows = rows.float()  # observations may be integers
        weight = len(rows) / (self.count + len(rows))
        delta = rows.mean(0) - self.mean
        var = self.var + weight * (rows.var(0, correction=0) - self.var + (1 - weight) * delta**2)
        self.var.copy_(var.clamp(min=1e-8))  # a dimension that never moved must not divide by zero
        self.mean += weight * delta
        self.count += len(rows)


def mlp(inputs, hidden, outputs, output_gain, activation):
    """Two hidden layers and a linear one, orthogonal weights, zero biases."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (math.sqrt(2), math.sqrt(2), output_gain)):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], activation(), layers[1], activation(), layers[2])


class Policy(nn.Module):
    """π(u|s) = N(μ(s), σ²) over the latent action u (…, K); the environment gets a = g(u).

    To PPO, g is a part of the environment: it needs π of u only. (The density of a = tanh(u) has
    one more factor, the same for π and π_old, which cancels in ρ. An entropy bonus does differ: H
    is that of u.)

    log σ = std_speed·parameter, the same in every state: Adam moves each parameter by about the
    learning rate, so with std_speed < 1 exploration outlives the first success.
    """

    def __init__(self, norm, action_space, hidden, log_std, std_speed, squash):
        super().__init__()
        self.norm, self.std_speed, self.squash = norm, std_speed, squash
        self.mean_net = mlp(len(norm.mean), hidden, action_space.shape[0], 0.01, nn.Tanh)
        self.slow_log_std = nn.Parameter(torch.full(action_space.shape, log_std / std_speed))
        self.register_buffer("low", torch.as_tensor(action_space.low, dtype=torch.float32))
        self.register_buffer("high", torch.as_tensor(action_space.high, dtype=torch.float32))

    def forward(self, obs):
        """Observations (…, D) -> μ(s) (…, K) and log σ (K,)."""
        return self.mean_net(self.norm(obs)), (self.std_speed * self.slow_log_std).clamp(-10, 2)

    def bound(self, latents):
        """a = g(u): to [−1, 1] by tanh or by clipping, then stretched over [low, high]."""
        unit = torch.tanh(latents) if self.squash == "tanh" else latents.clamp(-1, 1)
        return torch.lerp(self.low, self.high, (unit + 1) / 2)

    @torch.inference_mode()
    def act(self, obs, deterministic=False):
        """NumPy (N, D) -> NumPy latents u = μ + σ·ε (N, K), ε ~ N(0, 1), and actions a (N, K).

        deterministic: u = μ(s).
        """
        mean, log_std = self(torch.as_tensor(obs, dtype=torch.float32, device=self.low.device))
        latents = mean if deterministic else mean + log_std.exp() * torch.randn_like(mean)
        return latents.cpu().numpy(), self.bound(latents).cpu().numpy()


def gaussian_log_prob(latents, mean, log_std):
    """log N(u; μ, σ²) = −Σ_k [((u_k − μ_k)/σ_k)²/2 + log σ_k + log(2π)/2]; u (…, K) -> (…,)."""
    squares = ((latents - mean) / log_std.exp()) ** 2
    return -squares.sum(-1) / 2 - (log_std + math.log(2 * math.pi) / 2).sum()


def gaussian_entropy(log_std):
    """H = −E[log N(u; μ, σ²)] = Σ_k [log σ_k + log(2πe)/2], wherever μ is."""
    return (log_std + math.log(2 * math.pi * math.e) / 2).sum()


class Critic(nn.Module):
    """V(s), the expected discounted sum of scaled rewards: (…, D) -> (…,)."""

    def __init__(self, norm, hidden, activation):
        super().__init__()
        self.norm = norm
        self.value = mlp(len(norm.mean), hidden, 1, 1.0, activation)

    def forward(self, obs):
        return self.value(self.norm(obs)).squeeze(-1)


def make_agent(args, env):
    """Policy, critic, all statistics as one module: its state_dict is all that acting needs."""
    norm = RunningNorm(env.observation_space.shape)
    policy = Policy(norm, env.action_space, args.hidden_size, args.log_std,
                    args.std_speed, args.squash)
    critic = Critic(norm, args.hidden_size, nn.Tanh)
    agent = {"policy": policy, "critic": critic, "reward_norm": RunningNorm(())}
    return nn.ModuleDict(agent).to(args.device)


# --- Rollout --------------------------------------------------------------------------------------


def rollout(envs, policy, obs, num_steps, env_step):
    """Play `num_steps` steps in each environment, from observations `obs` (N, D) and `env_step` on.

    Returns the real transitions, a dict of tensors (T, N, …), with the policy's samples rather than
    what the environments made of them; the observations to go on from; and a row (env_step, return,
    length, …) for each episode that ended.
    """
    transitions, episodes = [], []
    for _ in range(num_steps):
        samples, actions = policy.act(obs)
        new_obs, rewards, terminated, truncated, infos = envs.step(actions)
        env_step, done, next_obs = env_step + len(obs), terminated | truncated, new_obs.copy()
        for i in np.flatnonzero(done):  # there new_obs[i] begins the next episode
            next_obs[i] = infos["final_obs"][i]
            episodes.append((env_step, *infos["final_info"]["episode"][i]))
        transitions.append((obs, samples, rewards, next_obs, terminated, done))
        obs = new_obs
    device = policy.norm.mean.device
    columns = [torch.as_tensor(np.stack(x)) for x in zip(*transitions)]
    columns = [(x.float() if x.is_floating_point() else x).to(device) for x in columns]
    names = "states", "samples", "rewards", "next_states", "terminated", "done"
    return dict(zip(names, columns)), obs, episodes


# --- Returns and advantages -----------------------------------------------------------------------


def scale_rewards(rewards, done, carry, reward_norm, gamma):
    """Rewards (T, N) over the running std of G_t = r_t + γ·G_{t−1}, with G = 0 before an episode.

    G looks back, unlike what V predicts, so it is known at once, and over many steps it spreads
    about as widely as what V has to predict. Rewards are only divided: to subtract their mean would
    make long episodes better or worse than they are.
    `carry` (N,), γ·G from the rollout before (0 before the first), is returned for the next one.
    """
    # In NumPy, which is faster than tensors for small rows.
    past_returns, done = rewards.cpu().numpy().copy(), done.cpu().numpy()
    for t in range(len(done)):
        past_returns[t] += carry
        carry = gamma * np.where(done[t], 0, past_returns[t])
    reward_norm.update(torch.as_tensor(past_returns.flatten(), device=rewards.device))
    return rewards / reward_norm.var.sqrt(), carry


def compute_gae(rewards, values, next_values, terminated, done, gamma, gae_lambda):
    """Generalised advantage estimates A ([2] eq. 11, 16); all (T, N).

    A terminal state is worth nothing, whatever the critic says; at a time limit V(s_{t+1}) stands
    for the rewards that were cut off ([3] eq. 6). In both cases A_{t+1} is of another episode.
    """
    deltas = rewards + gamma * next_values.masked_fill(terminated, 0.0) - values  # step 3
    deltas, done = deltas.cpu().numpy(), done.cpu().numpy()  # faster than tensors for small rows
    advantages, advantage = np.empty_like(deltas), np.zeros_like(deltas[0])
    for t in reversed(range(len(deltas))):
        advantage = deltas[t] + gamma * gae_lambda * np.where(done[t], 0, advantage)  # step 4
        advantages[t] = advantage
    return torch.as_tensor(advantages, device=rewards.device)


# --- Loss -----------------------------------------------------------------------------------------


def policy_loss(ratio, advantages, clip_eps):
    """−E[min(ρ·A, clip(ρ, 1−ε, 1+ε)·A)]; (M,) each ([1] eq. 7).

    Where A > 0 the gradient is 0 once ρ > 1 + ε, where A < 0 once ρ < 1 − ε: nothing is gained by
    going further. Where ρ went the wrong way, min takes the term that leads back.
    """
    clipped_ratio = ratio.clamp(1 - clip_eps, 1 + clip_eps)
    return -torch.min(ratio * advantages, clipped_ratio * advantages).mean()


def value_loss(values, old_values, targets, clip_eps):
    """E[(V − R)²]; with ε > 0 the larger of it and that of V within ±ε of V_old.

    (M,) each; V_old is V as it was when the epoch began.
    """
    errors = (values - targets) ** 2
    if clip_eps > 0:
        clipped_values = old_values + (values - old_values).clamp(-clip_eps, clip_eps)
        errors = torch.max(errors, (clipped_values - targets) ** 2)
    return errors.mean()


def approximate_kl(log_ratio):
    """KL(π_old ‖ π) ≈ E[ρ − 1 − log ρ] on samples of π_old: never negative, little noise ([4])."""
    return (log_ratio.expm1() - log_ratio).mean()  # expm1(x) = exp(x) − 1, exact near 0


# --- Training -------------------------------------------------------------------------------------


@torch.no_grad()  # advantages and targets are data: no gradient goes through them
def minibatches(transitions, policy, critic, args):
    """Yields minibatches of at least `minibatch_size` rows, each row once an epoch; tensors (M, …).

    A generator: what stands in the loop runs after the caller has learned from the epoch before
    (with gradients: no_grad pauses at each yield), so each epoch takes its advantages from the
    critic as it is by then.
    """
    states, latents, rewards, next_states, terminated, done = transitions.values()
    old_log_probs = gaussian_log_prob(latents, *policy(states))
    for _ in range(args.epochs):
        values = critic(torch.cat((states, next_states[-1:])))
        values, next_values = values[:-1], values[1:].clone()  # s_{t+1} is s_t of the next row,
        next_values[done] = critic(next_states[done])  # except where an episode ended
        advantages = compute_gae(rewards, values, next_values, terminated, done,
                                 args.gamma, args.gae_lambda)
        batch = states, latents, old_log_probs, values, advantages, advantages + values
        order = torch.randperm(rewards.numel())
        parts = len(order) // args.minibatch_size
        yield from zip(*(x.flatten(0, 1)[order].tensor_split(parts) for x in batch))


def optimise(agent, optimizer, transitions, args):
    """Steps 3 to 6. Returns each diagnostic's mean over the minibatches that were learned from."""
    policy, critic, logs = agent["policy"], agent["critic"], []
    parameters = list(agent.parameters())
    for rows in minibatches(transitions, policy, critic, args):
        states, latents, old_log_probs, old_values, advantages, targets = rows
        mean, log_std = policy(states)
        log_probs = gaussian_log_prob(latents, mean, log_std)
        log_ratio = log_probs - old_log_probs  # 0 until the first step
        ratio, kl = log_ratio.exp(), approximate_kl(log_ratio)
        if logs and 0 < args.target_kl < kl / 1.5:  # step 5
            break
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        loss_pi = policy_loss(ratio, advantages, args.clip_eps)
        loss_v = value_loss(critic(states), old_values, targets, args.value_clip_eps)
        entropy = gaussian_entropy(log_std)  # σ is the same in every state: no mean to take
        optimizer.zero_grad()
        (loss_pi + args.value_coef * loss_v - args.entropy_coef * entropy).backward()  # step 6
        grad_norm = nn.utils.clip_grad_norm_(parameters, args.max_grad_norm)
        if not grad_norm.isfinite():
            sys.exit("error: the gradient is not finite; a lower --learning-rate may help")
        optimizer.step()
        logs.append({
            "policy_loss": loss_pi, "value_loss": loss_v, "entropy": entropy, "approx_kl": kl,
            "clip_fraction": ((ratio - 1).abs() > args.clip_eps).float().mean(),
            "explained_variance": 1 - (targets - old_values).var() / targets.var(),
            "grad_norm": grad_norm, "policy_std": log_std.exp().mean()})
    return {name: torch.stack([log[name] for log in logs]).mean().item() for name in logs[0]}


def train(args, seed, folder, stop, bar_position=0):
    """Train one seed into `folder`, new or resumed, until done or the file `stop` exists."""
    if stop.exists():
        return  # Ctrl-C came before it was this seed's turn
    torch.set_num_threads(1)  # in networks this small a second thread waits more than it works
    torch.manual_seed(*make_seeds(seed, stream=0, count=1))
    folder.mkdir(exist_ok=True)
    T, N = args.rollout_steps, args.num_envs
    num_updates = math.ceil(args.total_steps / (T * N))
    envs, eval_env = make_envs(args.env_id, N), CheckedEnv(gym.make(args.env_id), "of evaluation")
    agent = make_agent(args, eval_env)
    optimizer = torch.optim.Adam(agent.parameters(), eps=1e-5, fused=True)
    first, seconds, evaluation = 0, 0.0, {}
    if args.resume:
        first, seconds, evaluation = restore(args, folder, agent, optimizer)
    obs, _ = envs.reset(seed=make_seeds(seed, stream=2 + first, count=N))
    env_step, carry, recent = first * T * N, 0.0, []
    clock = time.perf_counter()
    bar = tqdm(range(first, num_updates), f"seed {seed}", num_updates, initial=first, unit="step",
               unit_scale=T * N, position=bar_position)
    for update in bar:
        learning_rate = args.learning_rate * (1 - update / num_updates)  # the end of step 7
        optimizer.param_groups[0]["lr"] = learning_rate
        batch, obs, episodes = rollout(envs, agent["policy"], obs, T, env_step)  # step 1
        batch["rewards"], carry = scale_rewards(
            batch["rewards"], batch["done"], carry, agent["reward_norm"], args.gamma)  # step 2
        diagnostics = optimise(agent, optimizer, batch, args)  # steps 3 to 6
        # Step 7 comes only now: while ρ is computed, π and π_old must see the same inputs.
        agent["policy"].norm.update(batch["states"].flatten(0, 1))
        env_step += T * N
        duration = time.perf_counter() - clock
        seconds += duration
        metrics = {"env_step": env_step, **diagnostics, "learning_rate": learning_rate,
                   "steps_per_second": T * N / duration}

        stopped = stop.exists()
        last = stopped or update + 1 == num_updates
        due = last or args.eval_every and (update + 1) % args.eval_every == 0
        if due:
            seeds = make_seeds(seed, stream=1, count=args.eval_episodes)
            evaluation = evaluate(agent["policy"], eval_env, seeds)
            append_rows(folder / "evals.csv", ["env_step", *evaluation],
                        [[env_step, *evaluation.values()]])
        clock = time.perf_counter()  # evaluation is not training, all else is
        append_rows(folder / "metrics.csv", metrics, [metrics.values()])
        append_rows(folder / "episodes.csv", ["env_step", "return", "length"], episodes)
        if due:
            save_checkpoint(folder, args, seed, agent=agent.state_dict(),
                            optimizer=optimizer.state_dict(), rng=torch.get_rng_state(),
                            progress=(update + 1, seconds, evaluation),
                            csv_bytes={p.name: p.stat().st_size for p in folder.glob("*.csv")})
        recent = (recent + [row[1] for row in episodes])[-20:]
        evaluated = evaluation.get("return_mean", math.nan)
        bar.set_postfix_str(f"return {np.mean(recent or math.nan):.0f}, evaluation {evaluated:.0f}")
        if stopped:
            break
    result = {"script": SCRIPT, "env_id": args.env_id, "seed": seed, "env_steps": env_step,
              "train_seconds": seconds, "steps_per_second": env_step / seconds,
              **{f"eval_{name}": x for name, x in evaluation.items()}, "versions": versions()}
    (folder / "summary.json").write_text(json.dumps(result, indent=2))


# --- Evaluate and watch ---------------------------------------------------------------------------


def play(policy, env, seed=None, frames=None):
    """One episode of the deterministic policy: its return (raw rewards) and its length."""
    obs, _ = env.reset(seed=seed)
    rewards, ended = [], False
    while not ended:
        _, actions = policy.act(obs[None], deterministic=True)
        obs, reward, terminated, truncated, _ = env.step(actions[0])
        rewards.append(float(reward))
        ended = terminated or truncated
        if frames is not None:
            frames.append(Image.fromarray(env.render()).reduce(2))
    return sum(rewards), len(rewards)


def evaluate(policy, env, seeds):
    """One deterministic episode per seed, on an environment that training never sees."""
    returns, lengths = zip(*(play(policy, env, seed) for seed in seeds))
    return {"return_mean": float(np.mean(returns)), "return_std": float(np.std(returns)),
            "length_mean": float(np.mean(lengths)), "episodes": len(seeds)}


def has_display():
    """Whether a window can open: on Linux the environment says so, elsewhere it always can."""
    return sys.platform != "linux" or bool({"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ))


def watch(args):
    """Show an episode in a window or, where there is no display, in a GIF beside the checkpoint."""
    window = has_display()
    os.environ.setdefault("MUJOCO_GL", "glfw" if window else "egl")
    agent = make_agent(args, gym.make(args.env_id))
    agent.load_state_dict(torch.load(args.watch, args.device, weights_only=True)["agent"])
    gif, frames = Path(args.watch).with_suffix(".gif"), None if window else []
    try:
        env = gym.make(args.env_id, render_mode="human" if window else "rgb_array")
        print("return {:.1f} in {} steps".format(*play(agent["policy"], env, frames=frames)))
    except Exception as error:  # every graphics library fails in its own way
        sys.exit(f"error: cannot draw {args.env_id} ({error!r}); Debian's OpenGL is libegl1")
    if frames:
        fps = env.metadata.get("render_fps", 25)
        frames = frames[:: math.ceil(fps / 25)]
        pause = 1000 * math.ceil(fps / 25) / fps  # milliseconds
        frames[0].save(gif, save_all=True, append_images=frames[1:], duration=pause, loop=0)
        print(gif)


# --- Plot -----------------------------------------------------------------------------------------


PANELS = [("episodes", "episode", "return"), ("episodes", "env_step", "return"),
          ("episodes", "env_step", "length"), ("evals", "env_step", "return_mean"),
          ("evals", "env_step", "length_mean"), ("evals", "env_step", "return_std"),
          *(("metrics", "env_step", name) for name in (
              "policy_loss", "value_loss", "entropy", "policy_std", "approx_kl", "clip_fraction",
              "explained_variance", "grad_norm", "learning_rate", "steps_per_second"))]


def plot(folder):
    """learning_curve.png: mean over seeds ± 1.96 standard errors, and a thin line for each seed."""
    units = {"return": " (raw)", "return_mean": " (raw)", "return_std": " (raw)",
             "length": " (steps)", "length_mean": " (steps)", "entropy": " (nats)",
             "approx_kl": " (nats)", "episode": "episodes", "env_step": "environment steps"}
    rows = len(PANELS) // 4
    figure = Figure(figsize=(20, 4 * rows), layout="constrained")  # pyplot might seek a display
    for axis, (table, x, y) in zip(figure.subplots(rows, 4).flat, PANELS):
        files = sorted(folder.glob(f"seed-*/{table}.csv"))
        data = pd.concat(pd.read_csv(file).assign(seed=file.parent.name) for file in files)
        if data.empty:
            continue  # an early Ctrl-C: no episode has ended yet
        data["episode"] = data.groupby("seed").cumcount() + 1
        width = max(1, data[x].max() / 60)  # seeds end their episodes at different steps
        data[x] = np.ceil(data[x] / width) * width
        lines = {"data": data.groupby(["seed", x], as_index=False)[y].mean(), "x": x, "y": y}
        sns.lineplot(**lines, errorbar=("se", 1.96), ax=axis)
        sns.lineplot(**lines, units="seed", estimator=None, linewidth=0.5, ax=axis)
        axis.set(xlabel=units[x], ylabel=f"{table}: {y}{units.get(y, '')}")
        axis.locator_params(axis="x", nbins=5)
    figure.suptitle(folder.name)
    figure.savefig(folder / "learning_curve.png", dpi=100)


# --- Run folder -----------------------------------------------------------------------------------


def versions():
    """What a number depends on besides the seed; what is not installed is left out."""
    found = {}
    for name in ("torch", "gymnasium", "mujoco", "box2d", "numpy"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def append_rows(path, columns, rows):
    """Add rows to a CSV file, below the names of its columns if it is new."""
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if file.tell() == 0:
            writer.writerow(columns)
        writer.writerows(rows)


def save_checkpoint(folder, args, seed, **state):
    """Replace checkpoint.pt in one go: a killed run leaves the old one or the new one, whole."""
    here = ("resume", "watch", "device", "out_dir")  # what belongs to a call, not to the run
    saved = {name: x for name, x in vars(args).items() if name not in here} | {"seed": [seed]}
    torch.save({"script": SCRIPT, "args": saved, **state}, folder / "checkpoint.tmp")
    os.replace(folder / "checkpoint.tmp", folder / "checkpoint.pt")


def restore(args, folder, agent, optimizer):
    """Go back to a checkpoint, CSV files too; returns its updates, seconds, last evaluation.

    The environments start anew: the episodes that were going on then are lost.
    """
    checkpoint = torch.load(args.resume, args.device, weights_only=True)
    agent.load_state_dict(checkpoint["agent"])
    optimizer.load_state_dict(checkpoint["optimizer"])
    torch.set_rng_state(checkpoint["rng"].cpu())
    for path in folder.glob("*.csv"):
        os.truncate(path, checkpoint["csv_bytes"].get(path.name, 0))
    return checkpoint["progress"]


def make_folder(args):
    """A new folder for the files of this call, with args.json."""
    env_id, now = args.env_id.replace(":", "-").replace("/", "-"), datetime.now()
    folder = Path(args.out_dir, f"{env_id}__{SCRIPT}__{now:%Y%m%d_%H%M%S%f}")
    folder.mkdir(parents=True)
    record = {**vars(args), "command": sys.argv, "versions": versions()}
    (folder / "args.json").write_text(json.dumps(record, indent=2))
    return folder


# --- Configuration --------------------------------------------------------------------------------


def number(kind, low, high=1e12):
    """An argparse type: an int or float within [low, high]; NaN is in no interval."""

    def parse(text):
        with contextlib.suppress(ValueError):
            if low <= kind(text) <= high:
                return kind(text)
        raise argparse.ArgumentTypeError(f"got {text}, takes {kind.__name__} in [{low}, {high:g}]")

    return parse


def parse_and_check(parser, argv):
    """The arguments, an environment that they name, and a function that demands more of them.

    What cannot work ends in one line, with status 2. A checkpoint's arguments are kept.
    """
    parser.error = lambda message: parser.exit(2, f"{parser.prog}: error: {message}\n")
    args = parser.parse_args(argv)

    def require(name, condition, takes):
        if not condition:
            flag, got = name.replace("_", "-"), getattr(args, name)
            parser.error(f"argument --{flag}: got {got}, takes {takes}")

    flag = "watch" if args.watch else "resume"
    if getattr(args, flag, None):
        try:
            checkpoint = torch.load(getattr(args, flag), args.device, weights_only=True)
            script, saved = checkpoint["script"], checkpoint["args"]
        except Exception:  # missing, cut short, something else, or with code in it (weights_only)
            script = None
        require(flag, script == SCRIPT, f"a whole checkpoint of {SCRIPT}.py")
        args = parser.parse_args(argv, argparse.Namespace(**saved))  # what it says is the default
        for name in saved:
            require(name, getattr(args, name) == saved[name], f"{saved[name]} as in the checkpoint")
    try:
        env = gym.make(args.env_id)
    except Exception as error:  # its text names the nearest environment
        require("env_id", False, f"a Gymnasium environment: {error}".splitlines()[0])
    obs = env.observation_space
    require("env_id", isinstance(obs, gym.spaces.Box) and len(obs.shape) == 1,
            f"flat observations, not {obs}")
    require("seed", len(set(args.seed)) == len(args.seed), "every seed once")
    folder = next(p for p in Path(args.out_dir, "run").absolute().parents if p.exists())
    writable = folder.is_dir() and os.access(folder, os.W_OK)
    require("out_dir", args.watch or writable, "a folder to write to")
    return args, env, require


def parse_args(argv=None):
    """What --help shows; a wrong argument ends in one line."""
    title, _ = __doc__.split("\n", 1)
    style = argparse.ArgumentDefaultsHelpFormatter
    parser = argparse.ArgumentParser(None, "%(prog)s [options]", title, formatter_class=style)
    devices = ["cpu", *(d for d in ("cuda", "mps") if getattr(torch, d).is_available())]
    count, share, weight = number(int, 1), number(float, 0, 1), number(float, 0)
    add = parser.add_argument
    add("--seed", type=number(int, 0), nargs="+", default=[1], help="several run side by side")
    add("--env-id", default="InvertedDoublePendulum-v5", help="also my_module:MyEnv-v0")
    add("--total-steps", type=count, default=150_000, help="of all environments, rounded up")
    add("--num-envs", type=count, default=16, help="N, environments stepped together")
    add("--rollout-steps", type=count, default=128, help="T, steps of each in a rollout")
    add("--epochs", type=count, default=10, help="passes over a rollout")
    add("--minibatch-size", type=number(int, 2), default=512, help="M, rows of a gradient step")
    add("--learning-rate", type=weight, default=1e-3, help="of Adam at first; it falls to 0")
    add("--gamma", type=share, default=0.99, help="γ, discount of rewards")
    add("--gae-lambda", type=share, default=0.95, help="λ, trust in rewards (1) or V (0)")
    add("--clip-eps", type=weight, default=0.2, help="ε, clip range of the ratio ρ")
    add("--target-kl", type=weight, default=0.02, help="1.5 times it ends an update; 0: no limit")
    add("--value-coef", type=weight, default=0.5, help="c_V, weight of the value loss")
    add("--value-clip-eps", type=weight, default=0.0, help="clip range of V; 0: no clipping")
    add("--entropy-coef", type=weight, default=0.0, help="c_H, weight of the entropy")
    add("--max-grad-norm", type=weight, default=0.5, help="longer gradients are shortened")
    add("--hidden-size", type=count, default=64, help="units in each hidden layer")
    add("--log-std", type=number(float, -10, 2), default=-0.5, help="log σ at first")
    add("--std-speed", type=number(float, 0.01), default=0.3, help="σ's pace of learning; μ's is 1")
    add("--squash", choices=("tanh", "clip"), default="tanh", help="g, keeps actions in bounds")
    add("--eval-every", type=number(int, 0), default=20, help="updates; also saves; 0: at the end")
    add("--eval-episodes", type=count, default=10, help="episodes of an evaluation")
    add("--device", choices=devices, default="cpu", help="where the networks are computed")
    add("--out-dir", default="runs", help="where run folders are made")
    add("--resume", metavar="CHECKPOINT", help="go on with a run, in its folder")
    add("--watch", metavar="CHECKPOINT", help="show an episode in a window or GIF")
    args, env, require = parse_and_check(parser, argv)
    actions, batch_size = env.action_space, args.num_envs * args.rollout_steps
    box = isinstance(actions, gym.spaces.Box) and len(actions.shape) == 1 and actions.is_bounded()
    require("env_id", box, f"a flat, bounded Box of actions, not {actions} (see a2c_vector.py)")
    require("total_steps", args.total_steps >= batch_size, f"at least a rollout, {batch_size}")
    require("minibatch_size", args.minibatch_size <= batch_size, f"at most a rollout, {batch_size}")
    return args


# --- main -----------------------------------------------------------------------------------------


def start_worker(lock):
    """A process of several shares the terminal, and leaves Ctrl-C to its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tqdm.set_lock(lock)


def train_seeds(args, folder):
    """Train the seeds, several side by side in processes, and draw their learning curve."""
    context = multiprocessing.get_context("spawn")
    stop = folder / f"stop-{os.getpid()}"  # a file, since all processes can see it
    signal.signal(signal.SIGINT, lambda *_: stop.touch())  # train ends after its current update
    jobs = [(args, s, folder / f"seed-{s}", stop, i) for i, s in enumerate(args.seed)]
    try:
        if len(jobs) == 1:
            train(*jobs[0])
        else:
            lock = context.RLock()
            with ProcessPoolExecutor(os.cpu_count(), context, start_worker, (lock,)) as pool:
                futures = [pool.submit(train, *job) for job in jobs]
            for future in futures:
                future.result()  # raises what has ended that seed, after all others are done
    except gym.error.Error as error:
        sys.exit(f"error: {error}")
    finally:
        if any(folder.glob("*/evals.csv")):
            plot(folder)
        print("", *sorted(folder.glob("*/checkpoint.pt")), *folder.glob("*.png"), sep="\n")
        stop.unlink(missing_ok=True)


def main():
    args = parse_args()
    if args.watch:
        watch(args)
    elif args.resume:
        train_seeds(args, Path(args.resume).absolute().parent.parent)
    else:
        train_seeds(args, make_folder(args))


if __name__ == "__main__":
    main()
