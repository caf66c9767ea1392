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
"""REINFORCE: the policy gradient with the returns of whole episodes, in one file.

It learns to balance a pole on a cart in half a minute: 100,000 steps, return 1000, which is one for
each step that the pole stands. An episode has 1000 steps at most.
`--help` lists all options; each run leaves a folder in `runs`.

    python reinforce_mujoco.py --seed 1 2 3 5 8

In a state s (`obs` in the code) the policy π(u|s), a probability density, draws u. The environment
gets u, clipped to the range of its actions. It answers with a reward r and the next state, and so
on until the episode ends after T steps.
  1. Set the learning rate, which falls evenly to 0.
     Play a batch of a few episodes with π:  u_t ~ Normal(μ(s_t), σ(s_t)).
  2. G_t = r_t + γ·G_{t+1}   the reward-to-go: the discounted rewards that u_t can affect.
     G_T = 0 if the task ended there (the pole fell). If only time ran out, rewards could have
     followed: then G_T = V(s_T) with --baseline value ([3]); without it 0, which is too low if
     rewards are positive, as here.
  3. A_t = G_t − b_t   the advantage over a baseline b, which --baseline chooses:
       none   b_t = 0
       mean   b_t = the mean of G over the batch; A is also divided by the batch's std of G,
              so that it has the same size in every batch
       value  b_t = V(s_t), a second network (the critic) that learns to predict G_t
  4. A step of Adam on  −mean(A·log π(u|s)) + ½·mean((V(s) − G)²), the means over the batch.
     A and G are constants there: no gradient goes through them. (Without a critic V = 0.)
  5. Throw the batch away, for the new π would play other episodes. Go to 1, until enough steps
     were played.
Symbols: γ discount: G looks about 1/(1 − γ) = 50 steps ahead, and so varies less than a plain sum;
    μ, σ mean and standard deviation of u. In the code, u is `samples`, clipped `actions`; G is
    `returns`, V(s) `values`.
Shapes: T steps of an episode; B steps of a batch; N states at a time; D numbers in s; K in u.
Units: a `return` in tables and figures is the plain sum of an episode's raw rewards. `seconds` are
    those of training, without evaluations.

Why it works. The aim is a large expected return E[G]. Let ∇ be the gradient with respect to the
weights of π. Take one step alone: s is given, G(u) is the expected return after u, E a mean over u.
    ∇E[G] = ∇∫π(u|s)·G(u) du = ∫∇π·G du = ∫π·(∇π/π)·G du = E[G·∇log π],  since ∇log π = ∇π/π.
So push up the probability of each action in proportion to the G_t that followed it, which is G(u)
on average ([1]): with G_t held constant, −mean(G_t·log π) has this gradient on average, times −1.
(G was held fixed here. But it is r plus γ times the E[G] of the next state, which depends on the
weights, too. By the product rule that adds γ times the ∇E[G] of the next state, and so on. All in
all ∇E[G_0] is the mean of Σ_t γ^t·G_t·∇log π(u_t|s_t) over episodes ([2] section 13.3). The factor
γ^t is left out here, as usual, so that late steps count like early ones.)
If no G is negative, as here, every action that was tried is pushed up, a bad one only less than
others, and the estimate varies a lot from batch to batch. With a typical G subtracted, actions that
were worse than usual are pushed down, and there is less noise. On average this changes nothing: if
b does not depend on u, E[b·∇log π] = b·∫∇π du = b·∇∫π du = 0, because ∫π du is always 1.
Some bias remains: γ^t is left out; with `mean`, G_t is compared with a mean and std of which the G
of its own episode are a part; the loss divides by the number of steps, which depends on the
actions, too; and where time ran out, G_T is a guess.

Left out: to cut episodes off in the middle, with V(s) in place of the later rewards, and to play in
several environments at a time (a2c_vector.py adds both); several gradient steps on the same batch
(ppo_continuous.py adds them).

References: [1] Williams 1992, Simple Statistical Gradient-Following Algorithms for Connectionist
    Reinforcement Learning. [2] Sutton and Barto 2018, Reinforcement Learning, 2nd edition.
    [3] Pardo et al. 2018, Time Limits in Reinforcement Learning.
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
    add("--total-steps", type=number(int, 1), default=100_000, help="environment steps, at least")
    add("--device", choices=devices, default="cpu", help="what computes the networks")
    add("--out-dir", default="runs", help="where the folder of this run is made")
    add("--watch", metavar="CHECKPOINT", help="evaluate this checkpoint and make a GIF of it")
    add = parser.add_argument_group("environment").add_argument
    add("--env-id", default="InvertedPendulum-v5",
        help="a Gymnasium id, also my_module:MyEnv-v0; episodes end after 10,000 steps at most")
    add = parser.add_argument_group("algorithm").add_argument
    add("--batch-episodes", type=number(int, 1), default=4, help="episodes of an update")
    add("--baseline", choices=("none", "mean", "value"), default="value", help="b, in A = G − b")
    add("--learning-rate", type=number(float, 0), default=1e-2, help="of Adam; it falls to 0")
    add("--gamma", type=number(float, 0, 1), default=0.98, help="discount of later rewards, γ")
    add = parser.add_argument_group("evaluation").add_argument
    add("--num-evals", type=number(int, 1, 1e6), default=20, help="evaluations, one more at start")
    add("--eval-episodes", type=number(int, 1), default=20, help="episodes of an evaluation")
    return check(parser, argv)


# --- Agent ----------------------------------------------------------------------------------------


class Agent(nn.Module):
    """The policy π(u|s) = Normal(μ(s), σ(s)), u (…, K), and, with --baseline value, V(s)."""

    def __init__(self, observation_space, action_space, args):
        super().__init__()
        inputs, outputs = observation_space.shape[0], action_space.shape[0]
        self.trunk = nn.Sequential(nn.Linear(inputs, 16), nn.Tanh(), nn.Linear(16, 32), nn.Tanh())
        self.mean = nn.Linear(32, outputs)
        self.raw_std = nn.Linear(32, outputs)
        for head in (self.mean, self.raw_std):
            nn.init.normal_(head.weight, std=0.01)  # at first μ and σ hardly depend on s
        self.register_buffer("low", torch.as_tensor(action_space.low, dtype=torch.float32))
        self.register_buffer("high", torch.as_tensor(action_space.high, dtype=torch.float32))
        self.critic = None
        if args.baseline == "value":
            self.critic = nn.Sequential(
                nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1))

    def policy(self, obs):
        """Observations (…, D) -> the distribution of u (…, K), whose dimensions are independent."""
        features = self.trunk(obs)
        # The floor under σ keeps π exploring and ∇_μ log π = (u − μ)/σ² small: its std is 1/σ ≤ 10.
        std = nn.functional.softplus(self.raw_std(features)) + 0.1
        return torch.distributions.Normal(self.mean(features), std, validate_args=False)  # faster

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,), or 0 if there is no critic."""
        if self.critic is None:
            return torch.zeros_like(obs[..., 0])
        return self.critic(obs).squeeze(-1)

    @torch.inference_mode()
    def act(self, obs, deterministic=False):
        """NumPy (N, D) -> NumPy: samples u of π (N, K), or the mean μ, and actions (N, K).

        Learning sees only u, of which π is the density, not what clipping makes of it.
        """
        policy = self.policy(torch.as_tensor(obs, dtype=torch.float32, device=self.low.device))
        samples = policy.mode if deterministic else policy.sample()
        actions = samples.clamp(self.low, self.high)
        return samples.cpu().numpy(), actions.cpu().numpy()


# --- Rollout --------------------------------------------------------------------------------------


def rollout(env, agent, num_episodes, gamma, env_step):
    """Steps 1 and 2: whole episodes of π, one after the other.

    Returns tensors of all their steps, obs (B, D), samples (B, K), returns G (B,), and a row for
    each episode. `env_step`: the environment steps that were taken before this call.
    """
    batch = {"obs": [], "samples": [], "returns": []}
    episodes = []
    for _ in range(num_episodes):
        obs, _ = env.reset()
        rewards = []
        terminated = truncated = False
        while not (terminated or truncated):
            samples, actions = agent.act(obs[None])
            batch["obs"].append(np.array(obs))  # a copy: some environments use one array again
            batch["samples"].append(samples[0])
            obs, reward, terminated, truncated, _ = env.step(actions[0])
            env_step += 1
            check_finite(0, env_step, np.array([reward]), obs[None])
            rewards.append(float(reward))
        last_obs = torch.as_tensor(obs, dtype=torch.float32, device=agent.low.device)
        last_return = 0.0 if terminated else agent.value(last_obs).item()
        batch["returns"].extend(discounted_returns(rewards, last_return, gamma))
        episodes.append({"env_step": env_step, "return": sum(rewards), "length": len(rewards)})
    for name, rows in batch.items():
        batch[name] = torch.as_tensor(np.array(rows), dtype=torch.float32, device=agent.low.device)
    return batch, episodes


# --- Returns and advantages -----------------------------------------------------------------------


def discounted_returns(rewards, last_return, gamma):
    """Step 2: G_t = r_t + γ·G_{t+1} with G_T = `last_return`; rewards (T,) -> returns (T,)."""
    returns = np.empty(len(rewards))
    G = last_return
    for t in reversed(range(len(rewards))):
        G = rewards[t] + gamma * G
        returns[t] = G
    return returns


def compute_advantages(returns, values, baseline):
    """Step 3: A = G − b, (B,) each. No gradient goes through A."""
    if baseline == "mean":
        return (returns - returns.mean()) / (returns.std(correction=0) + 1e-8)
    return returns - values.detach()  # b = V(s); with --baseline none there is no critic: V = 0


# --- Losses ---------------------------------------------------------------------------------------


def policy_loss(log_probs, advantages):
    """−mean(A·log π); (B,) each. Its gradient estimates that of −E[G]; its value need not fall."""
    return -(advantages * log_probs).mean()


def value_loss(values, targets):
    """½·mean((V − target)²); (…,) each -> ()."""
    return ((values - targets) ** 2).mean() / 2


# --- Update ---------------------------------------------------------------------------------------


def optimise(agent, optimizer, batch, baseline):
    """Steps 3 and 4. Returns the diagnostics."""
    values = agent.value(batch["obs"])
    advantages = compute_advantages(batch["returns"], values, baseline)  # step 3
    policy = agent.policy(batch["obs"])
    loss_pi = policy_loss(policy.log_prob(batch["samples"]).sum(-1), advantages)
    loss_v = value_loss(values, batch["returns"])
    optimizer.zero_grad()  # step 4
    (loss_pi + loss_v).backward()  # π and V share no weights
    weights = nn.ModuleList((agent.trunk, agent.mean, agent.raw_std)).parameters()  # those of π
    gradient_norm = nn.utils.get_total_norm([p.grad for p in weights], error_if_nonfinite=True)
    optimizer.step()
    diagnostics = {"policy_loss": loss_pi, "value_loss": loss_v, "gradient_norm": gradient_norm,
                   "entropy": policy.entropy().sum(-1).mean(), "policy_std": policy.stddev.mean()}
    return {name: x.item() for name, x in diagnostics.items()}


# --- Training -------------------------------------------------------------------------------------


def train(args, seed):
    """Train one seed; yields at the start and after each update what there is to write down."""
    torch.set_num_threads(1)  # networks this small do not gain from more threads
    torch.manual_seed(make_seeds(seed, stream=0, count=1)[0])
    env = record_episodes(gym.make(args.env_id))
    env.reset(seed=make_seeds(seed, stream=2, count=1)[0])  # later resets go on from this seed
    agent = Agent(env.observation_space, env.action_space, args).to(args.device)
    optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate, fused=True)
    env_step = 0
    yield env_step, agent, optimizer, [], {}
    while env_step < args.total_steps:
        share = 1 - env_step / args.total_steps
        optimizer.param_groups[0]["lr"] = args.learning_rate * share  # step 1
        batch, episodes = rollout(env, agent, args.batch_episodes, args.gamma, env_step)  # 1 and 2
        diagnostics = optimise(agent, optimizer, batch, args.baseline)  # steps 3 and 4
        env_step += len(batch["obs"])
        yield env_step, agent, optimizer, episodes, diagnostics


# ==================================================================================================
# From here on: nothing about the algorithm
# ==================================================================================================

# --- Environments ---------------------------------------------------------------------------------


def record_episodes(env):
    """Records return and length of each episode, and ends it after 10,000 steps at the latest."""
    return gym.wrappers.RecordEpisodeStatistics(gym.wrappers.TimeLimit(env, 10_000))


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
    path = args.watch
    expected = (gym.error.Error, ImportError) if path is None else Exception
    try:
        if path is not None:
            checkpoint = torch.load(path, "cpu", weights_only=True)  # runs no code from the file
            # Options given now override those in the checkpoint, which override the defaults.
            args = parser.parse_args(argv, argparse.Namespace(**checkpoint["args"]))
        env = gym.make(args.env_id)
        spaces = env.observation_space, env.action_space
        if not all(isinstance(space, gym.spaces.Box) and len(space.shape) == 1 for space in spaces):
            raise gym.error.Error(
                "takes flat Box observations (gymnasium.wrappers.FlattenObservation) and "
                f"Box actions (a2c_vector.py: Discrete), not {spaces}")
        if path is not None:
            Agent(*spaces, args).load_state_dict(checkpoint["agent"])
    except expected as error:
        name = "--env-id" if path is None else f"--watch: {path}"
        parser.error(f"argument {name}: {error!r}")
    if len(set(args.seed)) < len(args.seed):
        parser.error(f"argument --seed: got {args.seed}, takes each once")
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
    folder = make_folder(args)
    folders = [folder / f"seed-{seed}" for seed in args.seed]
    try:
        train_seeds(args, folders)
    except KeyboardInterrupt:
        for process in multiprocessing.active_children():  # several seeds
            process.terminate()
    finally:
        if any(folder.glob("**/metrics.csv")):
            print(f"drawing {folder / 'learning_curve.png'}", flush=True)
            plot(folder, args.env_id)
        for file in sorted(folder.glob("**/evals.csv")):
            last, path = pd.read_csv(file).iloc[-1], file.with_name("checkpoint.pt")
            print(f"return {last['return_mean']:.1f} after {last['env_step']:,.0f} steps, "
                  f"{last['seconds'] / 60:.1f} minutes: {path}")


if __name__ == "__main__":
    main()
