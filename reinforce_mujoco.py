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
"""REINFORCE: the policy gradient with Monte-Carlo returns, in one file.

Learns:   InvertedPendulum-v5 in 191,000 to 194,000 steps: 1000 of 1000 points with the seeds 1, 2,
          3, 5 and 8 (deterministic, 20 episodes each), about 27 seconds a seed, two at a time on a
          2-core AMD EPYC; Python 3.11, torch 2.13, Gymnasium 1.4, MuJoCo 3.15. With sampled
          actions the last 100 episodes of training average 965 to 1000.
Command:  python reinforce_mujoco.py --seed 1 2 3 5 8

The task: push a cart so that the pole on it stays upright; reward r = 1 for each step it does, and
after 1000 steps time is up. The algorithm: in a state s the policy π draws an action u from a
Gaussian, and the environment returns a reward r and the next state, until the episode ends at T.
  1. Play several episodes with π:  u_t ~ N(μ(s_t), σ(s_t)²)
  2. G_t = r_t + γ·G_{t+1},  G_T = 0   the discounted rewards from t on: what u_t can have caused
  3. A_t = G_t − b_t   was it better or worse than the baseline?  --baseline says what b is:
       none   b = 0
       mean   b = the mean of G over all B steps of 1, and A is divided by their standard deviation
       value  b_t = V(s_t), a second network that learns to predict G_t
  4. One step of Adam on −E[A·log π(u|s)] and, if there is a V, on ½·E[(V(s) − G)²]
  5. Lower the learning rate, throw the episodes away (the new π would play others), go to 1.
E[·] is the mean over the B steps; ∇ below is with respect to the weights of π.

Why it learns: E[G·∇log π(u|s)] is the direction in which the expected return grows ([1]; [2]
section 13.3; up to a constant and to weights γ^t that are always left out). It says: push each
action's probability up in proportion to the return that followed. If no return is negative, as
here, every action that was tried is pushed up, and only differences between large numbers teach
anything. A baseline takes away what they have in common. That changes nothing on average ([2]
section 13.4): E[b·∇log π(u|s)] = b·∫π·(∇π/π)du = b·∇∫π du = b·∇1 = 0 if b does not depend on u. But
a good baseline lowers the noise of the estimate, and so the number of episodes that are needed:
`tests/benchmark.py baselines` measures both. (Strictly, the b of `mean` does depend on u a little,
for u_t has a part in some of the returns, and in how many steps B there are to average over.)

What a time limit costs: an episode that is cut off looks as if no reward would have come after it,
so its last 1/(1−γ) steps or so (50 with the default γ) look worse than they are. REINFORCE cannot
know better; with --baseline value it can, and G_T = V(s_T) at a time limit ([3]).

Left out on purpose: several environments at a time, and a critic that foresees rewards, so that no
episode has to be waited for (a2c_vector.py adds both); several gradient steps on the same data
(ppo_continuous.py adds them).

Shapes:      T steps of an episode, B steps of all episodes of an update, D dimensions of a state, K
             of an action.
Units:       returns that are shown or saved are sums of raw rewards, not discounted; environment
             steps; seconds.
References:  [1] Williams 1992, Simple Statistical Gradient-Following Algorithms for Connectionist
             Reinforcement Learning. [2] Sutton and Barto 2018, Reinforcement Learning, 2nd edition.
             [3] Pardo et al. 2018, Time Limits in Reinforcement Learning.
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


def make_seeds(seed, stream, count):
    """`count` integers for one purpose of a run; runs and purposes (streams) share none.

    Stream 0: networks and noise, 1: evaluation, 2 + k: environments (re)started at update k.
    """
    return np.random.SeedSequence(seed, spawn_key=(stream,)).generate_state(count).tolist()


# --- Networks -------------------------------------------------------------------------------------


class Policy(nn.Module):
    """π(u|s) = N(μ(s), σ(s)²) over u (…, K). The environment gets a, which is u within its bounds.

    To the algorithm the clipping is a part of the environment: π is the density of u, not of a.
    """

    def __init__(self, env):
        super().__init__()
        (inputs,), (outputs,) = env.observation_space.shape, env.action_space.shape
        self.trunk = nn.Sequential(nn.Linear(inputs, 16), nn.Tanh(), nn.Linear(16, 32), nn.Tanh())
        self.mean, self.raw_std = nn.Linear(32, outputs), nn.Linear(32, outputs)
        for head in (self.mean, self.raw_std):
            nn.init.normal_(head.weight, std=0.01)  # at first, much the same in every state
        self.register_buffer("low", torch.as_tensor(env.action_space.low, dtype=torch.float32))
        self.register_buffer("high", torch.as_tensor(env.action_space.high, dtype=torch.float32))

    def forward(self, obs):
        """Observations (…, D) -> the distribution of u (…, K), whose dimensions are independent."""
        features = self.trunk(obs)
        # The floor under σ keeps single updates small: ∇log π grows like 1/σ.
        std = nn.functional.softplus(self.raw_std(features)) + 0.1
        return torch.distributions.Normal(self.mean(features), std, validate_args=False)

    @torch.inference_mode()
    def act(self, obs, deterministic=False):
        """NumPy (N, D) -> NumPy samples u (N, K), actions a (N, K); deterministic: u = μ(s)."""
        distribution = self(torch.as_tensor(obs, dtype=torch.float32, device=self.low.device))
        mean, std = distribution.mean, distribution.stddev
        # u = μ + σ·ε with ε ~ N(0, 1): what distribution.sample() does, but faster
        samples = mean if deterministic else mean + std * torch.randn_like(mean)
        return samples.cpu().numpy(), samples.clamp(self.low, self.high).cpu().numpy()


def make_agent(args, env):
    """Policy and, with --baseline value, V: (…, D) -> (…, 1)."""
    agent, (inputs,) = {"policy": Policy(env)}, env.observation_space.shape
    if args.baseline == "value":
        agent["value"] = nn.Sequential(
            nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1))
    return nn.ModuleDict(agent).to(args.device)


# --- Returns and advantages -----------------------------------------------------------------------


def discounted_returns(rewards, last_return, gamma):
    """G_t = r_t + γ·G_{t+1} with G_T = `last_return`; (T,) each (step 2)."""
    G, returns = last_return, []
    for reward in rewards.flip(0).tolist():  # from the last step to the first
        G = reward + gamma * G
        returns.append(G)
    return torch.tensor(returns).flip(0)


def compute_advantages(returns, values, baseline):
    """A = G − b (step 3), a constant for the gradient; (B,) each."""
    if baseline == "none":
        return returns
    if baseline == "mean":
        return (returns - returns.mean()) / (returns.std(correction=0) + 1e-8)
    return returns - values.detach()


# --- Loss -----------------------------------------------------------------------------------------


def policy_loss(log_probs, advantages):
    """−E[A·log π(u|s)]; (B,) each. Its gradient is what counts; that it falls means nothing."""
    return -(advantages * log_probs).mean()


def value_loss(values, targets):
    """½·E[(V − R)²]; (B,) each. The targets R are data: no gradient goes through them."""
    return ((values - targets) ** 2).mean() / 2


# --- Training -------------------------------------------------------------------------------------


def sample_episode(env, policy):
    """One episode of samples of π: states (T, D), samples u (T, K), rewards (T,) as tensors.

    Also the last state (D,), whether it is terminal (not a time limit), and (return, length).
    """
    (obs, _), steps, ended = env.reset(), [], False
    while not ended:
        samples, actions = policy.act(obs[None])
        next_obs, reward, terminated, truncated, info = env.step(actions[0])
        steps.append((obs, samples[0], reward))
        obs, ended = next_obs, terminated or truncated
    columns = [torch.as_tensor(np.stack(x), dtype=torch.float32) for x in zip(*steps)]
    return *columns, torch.as_tensor(obs, dtype=torch.float32), terminated, info["episode"]


def train(args, seed, folder, stop, bar_position=0):
    """Train one seed into `folder`, until done or the file `stop` exists."""
    if stop.exists():
        return  # Ctrl-C came before it was this seed's turn
    torch.set_num_threads(1)  # in networks this small a second thread waits more than it works
    torch.manual_seed(*make_seeds(seed, stream=0, count=1))
    folder.mkdir(exist_ok=True)
    env, eval_env = (CheckedEnv(gym.make(args.env_id), name) for name in (0, "of evaluation"))
    env.reset(seed=make_seeds(seed, stream=2, count=1)[0])  # once: each episode starts differently
    agent = make_agent(args, env)
    optimizer = torch.optim.Adam(agent.parameters(), fused=True)
    env_step, update, seconds, evaluation, recent, ended = 0, 0, 0.0, {}, [], False
    clock = time.perf_counter()
    bar = tqdm(desc=f"seed {seed}", total=args.total_steps, unit="step", position=bar_position)
    while not ended:
        learning_rate = args.learning_rate * (1 - env_step / args.total_steps)  # step 5
        optimizer.param_groups[0]["lr"] = learning_rate
        batch, episodes = [], []
        for _ in range(args.batch_episodes):  # steps 1 and 2
            states, samples, rewards, last, terminated, row = sample_episode(env, agent["policy"])
            bootstrap = args.baseline == "value" and not terminated
            last_return = agent["value"](last.to(args.device)).item() if bootstrap else 0.0
            batch.append((states, samples, discounted_returns(rewards, last_return, args.gamma)))
            env_step += len(rewards)
            episodes.append((env_step, *row))
        states, samples, returns = (torch.cat(x).to(args.device) for x in zip(*batch))
        values = agent["value"](states).squeeze(-1) if args.baseline == "value" else None
        advantages = compute_advantages(returns, values, args.baseline)  # step 3
        distribution = agent["policy"](states)  # π again, now with a graph for the gradient
        losses = {"policy_loss": policy_loss(distribution.log_prob(samples).sum(-1), advantages)}
        if args.baseline == "value":
            losses["value_loss"] = value_loss(values, returns)
        optimizer.zero_grad()
        sum(losses.values()).backward()
        grad_norm = nn.utils.get_total_norm([p.grad for p in agent["policy"].parameters()])
        if not grad_norm.isfinite():
            sys.exit("error: the gradient is not finite; a lower --learning-rate may help")
        optimizer.step()  # step 4
        update += 1
        duration = time.perf_counter() - clock
        seconds += duration
        diagnostics = {**losses, "entropy": distribution.entropy().sum(-1).mean(),
                       "grad_norm": grad_norm, "policy_std": distribution.stddev.mean()}
        metrics = {"env_step": env_step, **{name: x.item() for name, x in diagnostics.items()},
                   "learning_rate": learning_rate, "steps_per_second": len(returns) / duration}

        ended = env_step >= args.total_steps or stop.exists()
        if ended or args.eval_every and update % args.eval_every == 0:
            seeds = make_seeds(seed, stream=1, count=args.eval_episodes)
            evaluation = evaluate(agent["policy"], eval_env, seeds)
            append_rows(folder / "evals.csv", ["env_step", *evaluation],
                        [[env_step, *evaluation.values()]])
            save_checkpoint(folder, args, seed, agent=agent.state_dict())
        clock = time.perf_counter()  # evaluating and saving are not training, all else is
        append_rows(folder / "metrics.csv", metrics, [metrics.values()])
        append_rows(folder / "episodes.csv", ["env_step", "return", "length"], episodes)
        recent = (recent + [row[1] for row in episodes])[-100:]
        bar.update(len(returns))
        evaluated = evaluation.get("return_mean", math.nan)
        bar.set_postfix_str(f"return {np.mean(recent):.0f}, evaluation {evaluated:.0f}")
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
          *(("metrics", "env_step", name) for name in (
              "policy_loss", "policy_std", "grad_norm", "steps_per_second"))]


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
    add("--env-id", default="InvertedPendulum-v5", help="also my_module:MyEnv-v0")
    add("--total-steps", type=count, default=190_000, help="rounded up to a whole update")
    add("--batch-episodes", type=count, default=4, help="episodes of a gradient step")
    add("--baseline", choices=("none", "mean", "value"), default="value",
        help="b, what a return is compared with: 0, the mean of all, V(s)")
    add("--learning-rate", type=weight, default=1e-2, help="of Adam at first; it falls to 0")
    add("--gamma", type=share, default=0.98, help="γ, discount of rewards")
    add("--eval-every", type=number(int, 0), default=150, help="updates; also saves; 0: at the end")
    add("--eval-episodes", type=count, default=20, help="episodes of an evaluation")
    add("--device", choices=devices, default="cpu", help="where the networks are computed")
    add("--out-dir", default="runs", help="where run folders are made")
    add("--watch", metavar="CHECKPOINT", help="show an episode in a window or GIF")
    args, env, require = parse_and_check(parser, argv)
    actions = env.action_space
    box = isinstance(actions, gym.spaces.Box) and len(actions.shape) == 1
    require("env_id", box, f"a flat Box of actions, not {actions} (see a2c_vector.py)")
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
    else:
        train_seeds(args, make_folder(args))


if __name__ == "__main__":
    main()
