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
"""A2C: synchronous advantage actor-critic on vectorised environments, in one file.

Learns:   LunarLander-v3 in 1,000,448 steps: 194 to 230 points, 210 on average (200 is solved) with
          the seeds 1 to 5 (deterministic, 20 episodes each), 70 seconds a seed, two at a time on a
          2-core AMD EPYC; Python 3.11, torch 2.13, Gymnasium 1.4, Box2D 2.3.10.
Command:  python a2c_vector.py --seed 1 2 3 4 5

The algorithm. In a state s the actor π draws one of K actions a, and the environment returns a
reward r; the critic V(s) predicts the discounted sum of rewards to come.
  1. Play T steps in N environments with π:  a_t ~ π(·|s_t)
  2. Multiply r by a constant, so that V has to predict numbers of a moderate size.
  3. δ_t = r_t + γ·(1 − terminated_t)·V(s_{t+1}) − V(s_t)   what a step gave beyond what V foresaw
  4. A_t = δ_t + γλ·(1 − done_t)·A_{t+1},  R_t = A_t + V(s_t)   advantage, critic's target
  5. One step of Adam: π on −E[A·log π(a|s)] − c_H·H(π), A standardised; V on ½·E[(V(s) − R)²]
  6. Update the mean and variance that normalise s, lower the learning rates, go to 1.
terminated: an end for good; done: any end. At a mere time limit more reward could have followed.
A rollout may end amid an episode: there A_T = 0, and V(s_T) in the last δ stands for what follows.
E and H are means over all B rows. H, the entropy, keeps π from settling on one action too early.
With λ = 0, A = δ: little noise, but wrong where V is. With λ = 1, A is the discounted sum of the
rewards that followed, minus V, as in REINFORCE: noisy, but V can be wrong only where it stands for
rewards that were cut off.

= REINFORCE (reinforce_mujoco.py) plus: a critic, which is not only what a return is compared with,
but foresees the return, so that δ can judge an action without waiting for the end of the episode
(3, 4); N environments at a time, before long each in another part of its episode, so that a short
rollout holds enough variety (1). What keeps this stable: states are normalised, rewards scaled,
advantages standardised, gradients clipped, and H is kept up.
Left out on purpose: the asynchronous workers of [1], each of which updates the weights on its own;
layers that actor and critic share; images; continuous actions.

Vectorised environments: one call of the network serves all N of them. With --vectorization async
each also steps in a process of its own, which can only pay if a step takes longer than sending its
result. `tests/benchmark.py scaling` measures both on your machine.

Domain randomization: with --randomize every episode has its own gravity, and about half of them
wind and turbulence of their own, so that no single world can be learned by heart. Evaluating and
watching keep to the usual world; `tests/benchmark.py robustness` compares agents in many.

Symbols:     γ discount; λ trust in rewards (1) against V (0); H entropy, c_H its weight.
Shapes:      T steps, N environments, B = T·N rows, D dimensions of a state, K actions.
Units:       raw rewards in all returns (not in value_loss: step 2); environment steps; seconds.
References:  [1] Mnih et al. 2016, Asynchronous Methods for Deep Reinforcement Learning. [2]
             Schulman et al. 2016, High-Dimensional Continuous Control Using Generalized Advantage
             Estimation. [3] Pardo et al. 2018, Time Limits in Reinforcement Learning. [4] Tobin et
             al. 2017, Domain Randomization for Transferring Deep Neural Networks from Simulation to
             the Real World. [5] Chan et al. 1979, Updating Formulae and a Pairwise Algorithm for
             Computing Sample Variances.
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


class RandomPhysics(gym.Wrapper):
    """Draws LunarLander's physics for each episode anew ([4]), and adds them to its last info.

    Half of the episodes have wind; only in these do wind power and turbulence matter. `widths`: how
    far gravity, wind power and turbulence may be from LunarLander's defaults. Values out of its
    range are not drawn. The generator is the wrapper's own, seeded by `reset`.
    """

    RANGES = {"gravity": (-10.0, -11.99, -0.01), "wind_power": (15.0, 0.0, 20.0),
              "turbulence_power": (1.5, 0.0, 2.0)}  # default, lowest, highest

    def __init__(self, env, widths):
        super().__init__(env)
        self.widths, self.random = widths, np.random.default_rng()

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.random = np.random.default_rng([seed, 1])  # [seed] is the environment's own
        self.physics = {"enable_wind": bool(self.random.integers(2))}
        for width, (name, (default, lowest, highest)) in zip(self.widths, self.RANGES.items()):
            low, high = max(default - width, lowest), min(default + width, highest)
            self.physics[name] = self.random.uniform(low, high)
        vars(self.unwrapped).update(self.physics)
        return self.env.reset(seed=seed, options=options)

    def step(self, action):
        *transition, info = self.env.step(action)
        if info:
            info["episode"] += tuple(self.physics.values())
        return *transition, info


def make_env(args, index, **options):
    """One environment, with new physics in each episode if asked for."""
    if multiprocessing.parent_process():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the business of the main process
    env = CheckedEnv(gym.make(args.env_id, **options), index)
    widths = args.gravity_width, args.wind_width, args.turbulence_width
    return RandomPhysics(env, widths) if args.randomize else env


def make_envs(args):
    """N environments, stepped together; whichever ends restarts within the same step."""
    makers = [lambda i=i: make_env(args, i) for i in range(args.num_envs)]
    kinds = {"sync": gym.vector.SyncVectorEnv, "async": gym.vector.AsyncVectorEnv}
    return kinds[args.vectorization](makers, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)


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
    """π(a|s), a probability for each of K actions."""

    def __init__(self, norm, action_space, hidden):
        super().__init__()
        self.norm, self.first_action = norm, int(action_space.start)
        self.net = mlp(len(norm.mean), hidden, int(action_space.n), 0.01, nn.ReLU)

    def forward(self, obs):
        """Observations (…, D) -> the distribution of an action (…), counted from 0."""
        return torch.distributions.Categorical(
            logits=self.net(self.norm(obs)), validate_args=False)

    @torch.inference_mode()
    def act(self, obs, deterministic=False):
        """NumPy (N, D) -> NumPy actions (N,), counted from 0 and as the environment counts them."""
        obs = torch.as_tensor(obs, dtype=torch.float32, device=self.norm.mean.device)
        distribution = self(obs)
        actions = distribution.logits.argmax(-1) if deterministic else distribution.sample()
        actions = actions.cpu().numpy()
        return actions, actions + self.first_action


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
    agent = {"policy": Policy(norm, env.action_space, args.hidden_size),
             "critic": Critic(norm, args.hidden_size, nn.ReLU)}
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


def policy_loss(log_probs, advantages):
    """−E[A·log π(a|s)]: actions better than expected become more likely; (B,) each."""
    return -(advantages * log_probs).mean()


def value_loss(values, targets):
    """½·E[(V − R)²]; (B,) each. The targets R are data: no gradient goes through them."""
    return ((values - targets) ** 2).mean() / 2


# --- Training -------------------------------------------------------------------------------------


def optimise(agent, optimizer, transitions, args):
    """Steps 2 to 5. Returns the diagnostics."""
    states, actions, rewards, next_states, terminated, done = transitions.values()
    values = agent["critic"](states)
    with torch.no_grad():  # advantages and targets are data: no gradient goes through them
        next_values = agent["critic"](next_states)
        rewards = args.reward_scale * rewards  # step 2
        advantages = compute_gae(rewards, values, next_values, terminated, done,
                                 args.gamma, args.gae_lambda)
        targets = advantages + values
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    distribution = agent["policy"](states)
    entropy = distribution.entropy().mean()
    loss_pi = policy_loss(distribution.log_prob(actions), advantages)
    loss_v = value_loss(values, targets)
    optimizer.zero_grad()
    (loss_pi - args.entropy_coef * entropy + loss_v).backward()  # they share no parameters
    grad_norm = nn.utils.clip_grad_norm_(agent["policy"].parameters(), args.max_grad_norm)
    critic_norm = nn.utils.clip_grad_norm_(agent["critic"].parameters(), args.max_grad_norm)
    if not (grad_norm + critic_norm).isfinite():
        sys.exit("error: the gradient is not finite; a lower --learning-rate may help")
    optimizer.step()  # step 5
    diagnostics = {"policy_loss": loss_pi, "value_loss": loss_v, "entropy": entropy,
                   "explained_variance": 1 - (targets - values).var() / targets.var(),
                   "grad_norm": grad_norm, "critic_grad_norm": critic_norm}
    return {name: x.item() for name, x in diagnostics.items()}


def train(args, seed, folder, stop, bar_position=0):
    """Train one seed into `folder`, until done or the file `stop` exists."""
    if stop.exists():
        return  # Ctrl-C came before it was this seed's turn
    torch.set_num_threads(1)  # in networks this small a second thread waits more than it works
    torch.manual_seed(*make_seeds(seed, stream=0, count=1))
    folder.mkdir(exist_ok=True)
    T, N = args.rollout_steps, args.num_envs
    num_updates = math.ceil(args.total_steps / (T * N))
    envs, eval_env = make_envs(args), CheckedEnv(gym.make(args.env_id), "of evaluation")
    agent = make_agent(args, eval_env)
    optimizer = torch.optim.Adam([
        {"params": agent["policy"].parameters(), "lr": args.learning_rate},
        {"params": agent["critic"].parameters(), "lr": args.critic_learning_rate}],
        eps=1e-5, fused=True)
    anneal = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda update: 1 - update / num_updates)
    obs, _ = envs.reset(seed=make_seeds(seed, stream=2, count=N))
    columns = ["env_step", "return", "length"]
    if args.randomize:
        columns += ["enable_wind", *RandomPhysics.RANGES]
    env_step, seconds, evaluation, recent = 0, 0.0, {}, []
    clock = time.perf_counter()
    bar = tqdm(range(num_updates), f"seed {seed}", unit="step", unit_scale=T * N,
               position=bar_position)
    for update in bar:
        try:
            batch, obs, episodes = rollout(envs, agent["policy"], obs, T, env_step)  # step 1
        except (EOFError, ConnectionError) as error:  # only async has processes that can die
            for process in envs.processes:
                process.kill()  # or each would complain that it has lost the others
            envs.closed = True
            raise gym.error.Error(f"the process of an environment died: {error!r}") from error
        diagnostics = optimise(agent, optimizer, batch, args)  # steps 2 to 5
        agent["policy"].norm.update(batch["states"].flatten(0, 1))  # step 6
        env_step += T * N
        duration = time.perf_counter() - clock
        seconds += duration
        metrics = {"env_step": env_step, **diagnostics, "learning_rate": anneal.get_last_lr()[0],
                   "steps_per_second": T * N / duration}
        anneal.step()  # the end of step 6

        stopped = stop.exists()
        last = stopped or update + 1 == num_updates
        if last or args.eval_every and (update + 1) % args.eval_every == 0:
            seeds = make_seeds(seed, stream=1, count=args.eval_episodes)
            evaluation = evaluate(agent["policy"], eval_env, seeds)
            append_rows(folder / "evals.csv", ["env_step", *evaluation],
                        [[env_step, *evaluation.values()]])
            save_checkpoint(folder, args, seed, agent=agent.state_dict())
        clock = time.perf_counter()  # evaluating and saving are not training, all else is
        append_rows(folder / "metrics.csv", metrics, [metrics.values()])
        append_rows(folder / "episodes.csv", columns, episodes)
        recent = (recent + [row[1] for row in episodes])[-20:]
        evaluated = evaluation.get("return_mean", math.nan)
        bar.set_postfix_str(f"return {np.mean(recent or math.nan):.0f}, evaluation {evaluated:.0f}")
        if stopped:
            break
    envs.close()
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


def fly(args):
    """Play it yourself: key 0 is action 0, and so on; Esc ends. Prints each episode's return."""
    if not has_display():
        sys.exit("error: argument --play: got no display, takes one, and a keyboard")

    def report(*step):
        if step[-1]:  # the last info of an episode
            print("return {:.1f} in {} steps".format(*step[-1]["episode"]))

    import gymnasium.utils.play  # here, since it switches matplotlib over to a window

    env = make_env(args, "of yours", render_mode="rgb_array")
    first = env.action_space.start
    keys = {str(i): first + i for i in range(env.action_space.n)}
    gymnasium.utils.play.play(env, keys_to_action=keys, callback=report, noop=first)


# --- Plot -----------------------------------------------------------------------------------------


PANELS = [("episodes", "episode", "return"), ("episodes", "env_step", "return"),
          ("episodes", "env_step", "length"), ("evals", "env_step", "return_mean"),
          ("evals", "env_step", "length_mean"),
          *(("metrics", "env_step", name) for name in (
              "policy_loss", "value_loss", "entropy", "explained_variance", "grad_norm",
              "critic_grad_norm", "steps_per_second"))]


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
    add("--env-id", default="LunarLander-v3", help="also my_module:MyEnv-v0")
    add("--total-steps", type=count, default=1_000_000, help="of all environments, rounded up")
    add("--num-envs", type=count, default=16, help="N, environments stepped together")
    add("--vectorization", choices=("sync", "async"), default="sync", help="async: in processes")
    add("--rollout-steps", type=count, default=32, help="T, steps of each in a rollout")
    add("--learning-rate", type=weight, default=2e-3, help="of π at first; it falls to 0")
    add("--critic-learning-rate", type=weight, default=3e-3, help="the same of V")
    add("--gamma", type=share, default=0.999, help="γ, discount of rewards")
    add("--gae-lambda", type=share, default=0.98, help="λ, trust in rewards (1) or V (0)")
    add("--reward-scale", type=weight, default=0.1, help="constant that rewards are multiplied by")
    add("--entropy-coef", type=weight, default=0.003, help="c_H, weight of the entropy")
    add("--max-grad-norm", type=weight, default=0.5, help="longer gradients are shortened")
    add("--hidden-size", type=count, default=64, help="units in each hidden layer")
    add("--randomize", action="store_true", help="new physics for LunarLander in every episode")
    add("--gravity-width", type=weight, default=3.0, help="gravity is -10 ± this, in (-12, 0)")
    add("--wind-width", type=weight, default=15.0, help="wind power is 15 ± this, in [0, 20]")
    add("--turbulence-width", type=weight, default=1.5, help="turbulence is 1.5 ± this, in [0, 2]")
    add("--eval-every", type=number(int, 0), default=100, help="updates; also saves; 0: at the end")
    add("--eval-episodes", type=count, default=20, help="episodes of an evaluation")
    add("--device", choices=devices, default="cpu", help="where the networks are computed")
    add("--out-dir", default="runs", help="where run folders are made")
    add("--play", action="store_true", help="play it yourself: keys 0, 1, … are the actions")
    add("--watch", metavar="CHECKPOINT", help="show an episode in a window or GIF")
    args, env, require = parse_and_check(parser, argv)
    actions, batch_size = env.action_space, args.num_envs * args.rollout_steps
    discrete = isinstance(actions, gym.spaces.Discrete)
    require("env_id", discrete, f"Discrete actions, not {actions} (see ppo_continuous.py)")
    lander = RandomPhysics.RANGES.keys() <= vars(env.unwrapped).keys()
    require("randomize", lander or not args.randomize, "an environment with LunarLander's physics")
    require("rollout_steps", batch_size > 1, "at least 2 rows in a rollout")
    require("total_steps", args.total_steps >= batch_size, f"at least a rollout, {batch_size}")
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
    elif args.play:
        fly(args)
    else:
        train_seeds(args, make_folder(args))


if __name__ == "__main__":
    main()
