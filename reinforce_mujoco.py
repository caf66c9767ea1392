# /// script
# requires-python = ">=3.10,<3.14"
# dependencies = ["torch>=2.6,<2.14", "gymnasium[mujoco]>=1.4,<1.5", "numpy>=1.26", "tqdm>=4.66",
#     "mujoco>=3.1,<3.16", "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.31"]
# ///
"""REINFORCE: policy gradients from whole episodes, in one file.

    python reinforce_mujoco.py --seed 1 2 3               # or: uv run reinforce_mujoco.py --seed 1
    python reinforce_mujoco.py --watch runs/…/seed-1.pt   # replays an agent and films it

The first command trains three agents side by side to balance a pole on a cart, and leaves logs,
agents and a figure in a new folder in runs/. In a good run the return climbs within a minute to
1000, the most that an episode can earn; uniformly random actions earn about 5.

At every step the agent observes a state s (here four numbers: where the cart is, how the pole
leans, how fast both move) and draws an action a (a force on the cart) from its policy π(a|s). The
environment answers with a reward r (1 while the pole is up) and the next state, until the episode
ends. We want a high *return*, the sum of all rewards of an episode.

The policy is a Gaussian whose mean and standard deviation come from a neural network, the actor;
evaluations play the mean. It learns by trial and error: actions followed by high rewards become
more likely.

  1. Play a batch of episodes with π.
  2. For each step t, compute the *reward to go*: the rewards from t on, later ones counting less,
         G_t = r_t + γ·r_{t+1} + γ²·r_{t+2} + …
     With γ = 0.98 a reward 50 steps later counts only γ^50 ≈ 0.36. What happens much later usually
     owes little to this action, so counting it in full would mostly add noise.
  3. Subtract a baseline b_t:  A_t = G_t − b_t.  With a good b, A_t > 0 means better than expected.
         --baseline none    b_t = 0
         --baseline mean    b_t = the mean of G over the batch
         --baseline value   b_t = V(s_t), the prediction of G_t by a second network, the critic
  4. Take a gradient step on  −mean(A·log π(a|s)),  which makes actions with A > 0 more likely and
     those with A < 0 less likely (`policy_loss` says why). The critic takes ten steps on
     ½·mean((V(s) − G)²), which is smallest when V(s) is the average of G after s.
  5. Throw the batch away, because it shows what the old π did. Start again at 1.

That is REINFORCE [1, 2]. The rest are details that help: Adam with a learning rate that falls to 0,
orthogonal initial weights, a standard deviation of at least 0.1 (at first 0.8, which suits actions
of the order of 1). If a time limit cuts an episode off after T steps, G_T = V(s_T) stands for the
rewards that would have followed [3]; so the critic is trained whatever the baseline. Nothing is
rescaled: observations, actions and rewards should be of the order of 1.

In the code: s obs, a actions, r rewards, G rewards_to_go, V values, A advantages, γ gamma.
In shapes: T steps of an episode, B of a batch; D numbers in an observation, K in an action.
[1] Williams 1992, Simple Statistical Gradient-Following Algorithms for Connectionist RL.
[2] Sutton and Barto 2018, Reinforcement Learning: An Introduction, chapter 13.
[3] Pardo et al. 2018, Time Limits in Reinforcement Learning, arXiv 1712.00378.
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

import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
import pandas as pd
import seaborn as sns
import torch
from matplotlib.figure import Figure
from torch import nn
from tqdm import tqdm

# --- Agent ----------------------------------------------------------------------------------------


class Agent(nn.Module):
    """The actor π(a|s) and the critic V(s)."""

    def __init__(self, obs_space, action_space, hidden_size):
        super().__init__()
        inputs, outputs = obs_space.shape[0], action_space.shape[0]
        self.actor = mlp(inputs, hidden_size, 2 * outputs, last_gain=0.01)
        self.critic = mlp(inputs, hidden_size, 1, last_gain=1.0)

    def policy(self, obs):
        """Observations (…, D) -> π(·|s): a Gaussian for each of the K numbers of an action."""
        mean, raw_std = self.actor(obs.float()).chunk(2, dim=-1)
        std = nn.functional.softplus(raw_std) + 0.1  # at least 0.1, so that it keeps exploring
        return torch.distributions.Normal(mean, std)

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,)."""
        return self.critic(obs.float()).squeeze(-1)

    @torch.no_grad()
    def act(self, obs, deterministic=False):
        """NumPy observations (…, D) -> NumPy actions (…, K): drawn from π, or its mean."""
        policy = self.policy(torch.tensor(np.array(obs, float)))
        return (policy.mean if deterministic else policy.sample()).numpy()


def mlp(inputs, hidden, outputs, last_gain):
    """Two hidden layers, orthogonal weights; a small `last_gain` starts π alike in all states."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain)):  # √2 is customary
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


# --- The steps of an update -----------------------------------------------------------------------


def play(env, agent):
    """1. One episode of T steps.

    Returns observations (T, D), actions (T, K) as drawn (`Tidy` clips them), T rewards, and an
    estimate of the rewards still to come: 0 if the episode ended for good (the pole fell), V(s_T)
    if a time limit cut it off.
    """
    all_obs, actions, rewards, terminated, truncated = [], [], [], False, False
    obs, _ = env.reset()
    while not (terminated or truncated):
        all_obs.append(obs)
        actions.append(agent.act(obs))
        obs, reward, terminated, truncated, _ = env.step(actions[-1])
        rewards.append(reward)
    all_obs = torch.tensor(np.array([*all_obs, obs], float))
    last_value = 0.0 if terminated else agent.value(all_obs[-1]).item()
    return all_obs[:-1], torch.tensor(np.array(actions)), rewards, last_value


def compute_rewards_to_go(rewards, last_value, gamma):
    """2. G_t = r_t + γ·G_{t+1}, from G_T = `last_value` backwards. A list of T numbers -> (T,)."""
    rewards_to_go, G = [], last_value
    for reward in reversed(rewards):
        G = reward + gamma * G
        rewards_to_go.append(G)
    return torch.tensor(rewards_to_go[::-1])


def compute_advantages(rewards_to_go, values, baseline):
    """3. A = G − b; A, G and V are (B,)."""
    baselines = {"none": 0.0, "mean": rewards_to_go.mean(), "value": values}
    return rewards_to_go - baselines[baseline]


def policy_loss(log_probs, advantages):
    """4. −mean(A·log π); log π and A are (B,). Why does a step on it raise the return?

    *One decision.* The agent draws a from π and earns r(a), on average E[r] = ∫ π(a)·r(a) da. The
    weights only change how likely each action is, not what it earns. The gradient with respect to
    them says which change raises E[r] fastest:

        ∇E[r] = ∫ ∇π(a)·r(a) da
              = ∫ π(a)·∇log π(a)·r(a) da        because ∇log π = ∇π/π
              = E[r·∇log π(a)]                  an average over π's own actions: play, and average

    *An episode* τ is many decisions. With p for the environment, its probability is

        P(τ) = p(s_0)·π(a_0|s_0)·p(s_1|s_0,a_0)·π(a_1|s_1)·…

    In log P, which is a sum, only the log π depend on the weights: ∇log P(τ) = Σ_t ∇log π(a_t|s_t).
    The same three lines hold for episodes, with τ for a, P(τ) for π(a), the return for r(a):

        ∇E[return] = E[Σ_i r_i · Σ_t ∇log π(a_t|s_t)] = E[Σ_t Σ_i r_i·∇log π(a_t|s_t)]

    *Less noise.* Given all that came before a_t, the mean of ∇log π(a_t|s_t) is 0:

        ∫ π·∇log π da = ∫ ∇π da = ∇∫ π da = ∇1 = 0

    It stays 0 when multiplied by anything that is fixed by then: a reward r_i with i < t, or a
    number b(s_t). Such terms leave the mean as it is and change only the noise. So we drop the
    earlier rewards, which add noise, and subtract b(s_t), which removes some: if b ≈ V, bad actions
    get a negative factor, while without it positive rewards push up every action that was tried.
    (Better ones are pushed more, and win, because densities integrate to 1, but with more noise.)

        ∇E[return] = E[Σ_t (r_t + r_{t+1} + … − b(s_t))·∇log π(a_t|s_t)]

    Like r(a) above, A is a mere factor: V is detached, so no gradient flows through it. Then
    −A·log π has the gradient −A·∇log π: a step down the loss is, on average, nearly a step up the
    mean return. Nearly, as Adam rescales each weight's step, and the loss differs in four ways:
      - a mean over the batch's steps, not a sum over an episode: nearly a rescaling;
      - γ < 1 counts late rewards less: some bias, less noise. [2], which maximises E[G_0], also
        multiplies by γ^t; we leave this out, because late steps would hardly count;
      - b = mean(G) contains G_t, so it is not quite fixed before a_t;
      - V(s_T) adds rewards beyond a time limit, which the return does not count.
    The value of this loss says nothing of progress, and need not fall: only its gradient matters.
    """
    return -(advantages * log_probs).mean()


def optimise(agent, optimizer, obs, actions, rewards_to_go, *, baseline, critic_steps):
    """3 and 4, on the B steps of a batch.

    Returns metrics: `value_loss` is that of the last critic step, the others are from before.
    """
    values = agent.value(obs).detach()  # a constant for the actor, and not yet fitted to this G
    advantages = compute_advantages(rewards_to_go, values, baseline)
    policy = agent.policy(obs)  # as while playing, but now with gradients
    log_probs = policy.log_prob(actions).sum(-1)  # K independent numbers: log densities add
    optimizer.zero_grad()
    policy_loss(log_probs, advantages).backward()
    optimizer.step()
    # The actor's next step needs actions of the new π, but the critic may go on: any V(s_t) is a
    # fair baseline for later batches. With `--critic-steps 1` V ends at half of the mean of G.
    for _ in range(critic_steps):
        optimizer.zero_grad()  # all are None, so Adam skips the actor
        loss_v = ((agent.value(obs) - rewards_to_go) ** 2).mean() / 2
        loss_v.backward()
        optimizer.step()
    # 1: V predicted G perfectly, up to a constant; 0 or less: no better than a constant.
    explained_variance = 1 - (rewards_to_go - values).var() / rewards_to_go.var()
    return {"value_loss": loss_v.item(), "explained_variance": explained_variance.item(),
            "policy_std": policy.stddev.mean().item()}


# --- Training -------------------------------------------------------------------------------------


def train(index, args, folder):
    """Train the agent of `args.seed[index]`; leave its log and its weights in `folder`.

    The log has a row for each update: `env_step` and `seconds` so far; `return`, the mean of the
    batch's episodes; the metrics of `optimise` (`policy_std` is the mean standard deviation of π);
    and after some updates `eval_return`, without noise.
    """
    # If one seed fails, the others get SIGTERM: handle it like Ctrl-C, and close environments.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    seed = args.seed[index]
    with (closing(make_envs(args, seed, args.eval_episodes)) as eval_envs,
          closing(make_envs(args, seed, 1)) as envs,
          tqdm(total=args.total_steps, disable=index > 0) as bar):
        (env,) = envs.envs  # without the vector around it: `play` does the resetting
        make_repeatable(seed)  # the initial weights, and all that follows
        agent = Agent(env.observation_space, env.action_space, args.hidden_size)
        optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate, fused=True)  # faster
        log, env_step, evals_done, start = [], 0, 0, time.perf_counter()
        env.reset(seed=make_seeds(seed, stream=2, count=1)[0])  # `play` goes on without a seed
        while env_step < args.total_steps:
            optimizer.param_groups[0]["lr"] = (1 - env_step / args.total_steps) * args.learning_rate
            # 1. Play.
            episodes = [play(env, agent) for _ in range(args.batch_episodes)]
            obs, actions, rewards, last_values = zip(*episodes)
            # 2. Compute the rewards to go.
            rewards_to_go = [compute_rewards_to_go(r, last_value, args.gamma)
                             for r, last_value in zip(rewards, last_values)]
            # 3 and 4. Subtract the baseline, take gradient steps.
            metrics = optimise(agent, optimizer, torch.cat(obs), torch.cat(actions),
                               torch.cat(rewards_to_go), baseline=args.baseline,
                               critic_steps=args.critic_steps)

            weights = nn.utils.parameters_to_vector(agent.parameters())
            check_finite("a weight (is --learning-rate too large?)", weights.detach())
            env_step += sum(map(len, rewards))
            bar.update(min(env_step, args.total_steps) - bar.n)
            log.append({"env_step": env_step, "seconds": time.perf_counter() - start,
                        "return": np.mean([sum(r) for r in rewards]), **metrics})
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
    add("--total-steps", type=in_range(int, 1), default=100_000, help="steps per agent, at least")
    add("--env-id", default="InvertedPendulum-v5", help="Gymnasium id or my_module:MyEnv-v0")
    add("--watch", type=Path, metavar="AGENT.pt", help="do not train, but film this agent")
    add("--out-dir", default="runs", help="where the folder of this run is created")
    add("--num-evals", type=in_range(int, 1), default=20, help="evaluations after a first one")
    add("--eval-episodes", type=in_range(int, 1), default=20, help="episodes of an evaluation")
    add("--batch-episodes", type=in_range(int, 1), default=4, help="episodes of a batch")
    add("--baseline", choices=("none", "mean", "value"), default="value", help="subtracted from G")
    add("--critic-steps", type=in_range(int, 1), default=10, help="critic's steps on a batch")
    add("--learning-rate", type=in_range(float, 0), default=3e-3, help="falls linearly to 0")
    add("--gamma", type=in_range(float, 0, 1), default=0.98, help="discount factor")
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


def make_envs(args, seed, count, **kwargs):
    """A vector of `count` self-resetting environments with a time limit."""
    make_repeatable(seed)  # so that what environments draw when made is repeatable
    envs = gym.make_vec(args.env_id, count, "sync", **kwargs, wrappers=[
        lambda env: gym.wrappers.TimeLimit(env, env.spec.max_episode_steps or 1000), Tidy])
    obs_space, space = envs.single_observation_space, envs.single_action_space
    if not (all(isinstance(x, gym.spaces.Box) and len(x.shape) == 1 for x in (obs_space, space))
            and space.dtype.kind == "f"):
        envs.close()
        raise gym.error.Error("needs flat Boxes of observations and of actions, floats (see "
                              f"docs/guide.md); has {obs_space} and {space}")
    return envs


class Tidy(gym.Wrapper):
    """An environment that clips actions, insists on finite numbers, drops infos, owns its spaces.

    Some environments draw from their spaces, and some classes share them among all environments.
    Seeding a shared one in an evaluation would disturb training, so here each gets a copy.
    """

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            for i, name in enumerate(("observation_space", "action_space"), start=1):
                vars(self.unwrapped)[name] = copy.deepcopy(getattr(self.unwrapped, name))
                # Fetch it again: if it is a property, our copy does not count.
                getattr(self.unwrapped, name).seed(seed + i)
        return self.look(self.env.reset(seed=seed)[0]), {}

    def step(self, action):
        """Clipping is a part of the environment: π(a|s) is the density of a as it was drawn."""
        space = self.action_space
        action = action.clip(space.low, space.high).astype(space.dtype)
        obs, reward, terminated, truncated, _ = self.env.step(action)
        reward = check_finite(f"a reward of {self.spec.id}", np.asarray(reward, float).item())
        return self.look(obs), reward, terminated, truncated, {}

    def look(self, obs):  # a copy, as some environments reuse one array
        return check_finite(f"an observation of {self.spec.id}", np.array(obs))


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
