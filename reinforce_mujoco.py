# /// script
# requires-python = ">=3.10,<3.14"
# dependencies = ["torch>=2.6,<2.14", "gymnasium[mujoco]>=1.4,<1.5", "numpy>=1.26", "tqdm>=4.66",
#     "mujoco>=3.1,<3.16", "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.28"]
# ///
"""REINFORCE: policy gradients from whole episodes, in one file.

    python reinforce_mujoco.py --seed 1 2 3

trains three agents side by side to balance a pole on a cart. In a good run the return climbs within
a minute from below 10 (random actions earn 5) to 1000, the most that an episode can earn.

At every step the agent observes a state s (here four numbers: where the cart is, how the pole
leans, how fast both move) and draws an action a (a force on the cart) from its policy π(a|s). The
environment answers with a reward r (1 while the pole is up) and the next state, until the episode
ends. We want a high *return*, the sum of all rewards of an episode.

The policy is a Gaussian whose mean and standard deviation come from a neural network, the actor. It
learns by trial and error: actions followed by high rewards become more likely.

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
     those with A < 0 less likely (`policy_loss` says why). The critic takes one on
     ½·mean((V(s) − G)²).
  5. Throw the batch away, because it shows what the old π did. Start again at 1.

That is REINFORCE [1, 2]. The rest are details that help: Adam with a learning rate that falls to 0,
orthogonal weights, a standard deviation of at least 0.1 (at first 0.8, which suits actions of the
order of 1) and, with any baseline, V(s_T) for the rewards that a time limit cuts off [3].

In the code: s obs, a actions, r rewards, G rewards_to_go, V values, A advantages, γ gamma.
In shapes: T steps of an episode, B of a batch; D numbers in an observation, K in an action.
[1] Williams 1992, Simple Statistical Gradient-Following Algorithms for Connectionist RL.
[2] Sutton and Barto 2018, Reinforcement Learning: An Introduction, chapter 13.
[3] Pardo et al. 2018, Time Limits in Reinforcement Learning, arXiv 1712.00378.
"""

import argparse
import os
import random
import sys
import time
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

    def __init__(self, envs, hidden_size):
        super().__init__()
        inputs, outputs = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
        self.actor = mlp(inputs, hidden_size, 2 * outputs, last_gain=0.01)
        self.critic = mlp(inputs, hidden_size, 1, last_gain=1.0)

    def policy(self, obs):
        """Observations (…, D) -> π(·|s), whose log_prob sums over the K numbers of an action."""
        mean, raw_std = self.actor(obs.float()).chunk(2, dim=-1)
        std = nn.functional.softplus(raw_std) + 0.1  # at least 0.1, so that it keeps exploring
        return torch.distributions.Independent(torch.distributions.Normal(mean, std), 1)

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,)."""
        return self.critic(obs.float()).squeeze(-1)

    @torch.no_grad()
    def act(self, obs, deterministic=False):
        """NumPy observations (…, D) -> NumPy actions (…, K): drawn from π, or its mean."""
        policy = self.policy(torch.tensor(obs))
        return (policy.mean if deterministic else policy.sample()).numpy()


def mlp(inputs, hidden, outputs, last_gain):
    """Two hidden layers, orthogonal weights; a small `last_gain` starts π alike in all states."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain)):  # √2 is usual
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


# --- An update, point by point --------------------------------------------------------------------


def play(env, agent):
    """1. One episode of T steps.

    Returns observations (T, D), actions (T, K) as drawn (the environment clips them to its bounds),
    T rewards, and G_T, the value after them: 0 if the episode ended for good (the pole fell),
    V(s_T) if a time limit cut it off.
    """
    all_obs, actions, rewards, done = [], [], [], False
    obs, _ = env.reset()
    while not done:
        all_obs.append(obs.copy())  # some environments return one array again and again
        actions.append(agent.act(obs))
        obs, reward, terminated, truncated, _ = env.step(actions[-1])
        rewards.append(float(reward))
        done = terminated or truncated
    last_value = 0.0 if terminated else agent.value(torch.tensor(obs)).item()
    return torch.tensor(np.stack(all_obs)), torch.tensor(np.stack(actions)), rewards, last_value


def sum_rewards(rewards, last_value, gamma):
    """2. G_t = r_t + γ·G_{t+1}, with G_T = `last_value`. A list of T numbers -> (T,)."""
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

    *One decision.* The agent draws a from π and earns G(a), on average E[G] = ∫ π(a)·G(a) da. The
    weights only change how likely each action is, not what it earns. The gradient with respect to
    them says which change raises E[G] fastest:

        ∇E[G] = ∫ ∇π(a)·G(a) da
              = ∫ π(a)·∇log π(a)·G(a) da        because ∇log π = ∇π/π
              = E[G·∇log π(a)]                  an average over π's own actions: play!

    *An episode* τ is many decisions. With p for the environment, its probability is

        P(τ) = p(s_0)·π(a_0|s_0)·p(s_1|s_0,a_0)·π(a_1|s_1)·…

    In log P, which is a sum, only the log π depend on the weights: ∇log P(τ) = Σ_t ∇log π(a_t|s_t).
    So put τ for a, P for π and the return Σ_i r_i for G in the lines above:

        ∇E[return] = E[Σ_i r_i · Σ_t ∇log π(a_t|s_t)] = Σ_t Σ_i E[r_i·∇log π(a_t|s_t)]

    *Less noise.* Whatever happened before a_t, the mean of ∇log π(a_t|s_t) is ∫ π·∇log π da =
    ∇∫ π da = ∇1 = 0. It stays 0 when multiplied by what is known before a_t: an earlier reward r_i,
    i < t, or a baseline b(s_t). So we may drop the earlier rewards and subtract b(s_t):

        ∇E[return] = E[Σ_t (r_t + r_{t+1} + … − b(s_t))·∇log π(a_t|s_t)]

    Without a baseline, positive rewards push up every action that was tried; a bad one loses only
    because others gain more, as probabilities sum to 1. With b ≈ V its A < 0 pushes it down itself.

    The loss, with A constant, has this gradient on average (minus: optimisers descend), except that
      - the mean is over steps, not episodes, which shrinks it where episodes are long;
      - γ < 1, and b = mean(G), which depends on a_t a little, accept some bias for less noise;
      - V(s_T) adds rewards beyond a time limit, which the return does not count.
    """
    return -(advantages * log_probs).mean()


def optimise(agent, optimizer, obs, actions, rewards_to_go, baseline):
    """3 and 4, on the B steps of a batch. Returns metrics."""
    values = agent.value(obs)
    advantages = compute_advantages(rewards_to_go, values.detach(), baseline)  # constants
    policy = agent.policy(obs)
    loss_pi = policy_loss(policy.log_prob(actions), advantages)
    loss_v = ((values - rewards_to_go) ** 2).mean() / 2
    optimizer.zero_grad()
    (loss_pi + loss_v).backward()  # the networks share no weights, so each follows its own loss
    optimizer.step()
    return {"value_loss": loss_v.item(), "policy_std": policy.stddev.mean().item()}


# --- Training -------------------------------------------------------------------------------------


def train(index, args, folder):
    """Train the agent of `args.seed[index]`; leave its log and its weights in `folder`."""
    torch.set_num_threads(1)  # networks this small gain nothing from more threads
    seed = args.seed[index]
    for set_seed in torch.manual_seed, np.random.seed, random.seed:  # agent and environments
        set_seed(make_seeds(seed, stream=0, count=1)[0])
    env = make_env(args.env_id)
    eval_envs = gym.vector.SyncVectorEnv([lambda: make_env(args.env_id)] * args.eval_episodes)
    env.reset(seed=make_seeds(seed, stream=2, count=1)[0])  # `play` resets it again, without a seed
    agent = Agent(eval_envs, args.hidden_size)
    optimizer = torch.optim.Adam(agent.parameters(), fused=True)  # fused is faster
    log, env_step, evals_done, start = [], 0, 0, time.perf_counter()
    bar = tqdm(total=args.total_steps, disable=index > 0 or sys.stderr is None)
    while env_step < args.total_steps:
        optimizer.param_groups[0]["lr"] = (1 - env_step / args.total_steps) * args.learning_rate
        # 1. Play.
        episodes = [play(env, agent) for _ in range(args.batch_episodes)]
        obs, actions, rewards, last_values = zip(*episodes)
        # 2. Compute the rewards to go.
        rewards_to_go = [sum_rewards(r, v, args.gamma) for r, v in zip(rewards, last_values)]
        # 3 and 4. Subtract the baseline, take a gradient step.
        obs, actions, rewards_to_go = torch.cat(obs), torch.cat(actions), torch.cat(rewards_to_go)
        metrics = optimise(agent, optimizer, obs, actions, rewards_to_go, args.baseline)

        if not nn.utils.parameters_to_vector(agent.parameters()).isfinite().all():
            raise ValueError("a weight is not finite: are rewards NaN, infinite or huge?")
        env_step += len(obs)
        bar.update(min(env_step, args.total_steps) - bar.n)
        log.append({"env_step": env_step, "seconds": time.perf_counter() - start,
                    "return": np.mean([sum(x) for x in rewards]), **metrics})
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
    add("--total-steps", type=in_range(int, 1), default=100_000, help="environment steps in all")
    add("--env-id", default="InvertedPendulum-v5", help="Gymnasium id or my_module:MyEnv-v0")
    add("--watch", type=Path, metavar="AGENT.pt", help="do not train, but film this agent")
    add("--out-dir", default="runs", help="where the folder of this run is created")
    add("--num-evals", type=in_range(int, 1), default=20, help="evaluations, plus a first one")
    add("--eval-episodes", type=in_range(int, 1), default=20, help="episodes of an evaluation")
    add("--batch-episodes", type=in_range(int, 1), default=4, help="episodes of a batch")
    add("--baseline", choices=("none", "mean", "value"), default="value", help="subtracted from G")
    add("--learning-rate", type=in_range(float, 0), default=3e-3, help="falls linearly to 0")
    add("--gamma", type=in_range(float, 0, 1), default=0.98, help="discount factor")
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


def make_env(env_id, **kwargs):
    """One environment, which clips actions to its bounds. ValueError if it shows NaN or inf."""
    try:
        env = gym.make(env_id, **kwargs)
    except (gym.error.Error, ImportError) as error:
        sys.exit(f"--env-id {env_id}: {error}")
    obs_space, space = env.observation_space, env.action_space
    if not (isinstance(obs_space, gym.spaces.Box) and isinstance(space, gym.spaces.Box)
            and len(obs_space.shape) == len(space.shape) == 1 and space.dtype.kind == "f"):
        env.close()
        sys.exit(" ".join(f"{env_id}: needs flat float Boxes; has {obs_space}, {space}".split()))
    env = Tidy(gym.wrappers.TimeLimit(env, env.spec.max_episode_steps or 10_000))
    env = gym.wrappers.TransformObservation(env, np.asarray_chkfinite, obs_space)
    return gym.wrappers.TransformAction(
        env, lambda x: x.clip(space.low, space.high).astype(space.dtype), space)


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
        envs = gym.vector.SyncVectorEnv([lambda: make_env(saved["env_id"])] * args.eval_episodes)
        agent = Agent(envs, saved["hidden_size"])
        agent.load_state_dict(saved["agent"])
        for set_seed in np.random.seed, random.seed:  # environments may use these
            set_seed(make_seeds(args.seed[0], stream=0, count=1)[0])
        print("return:", evaluate(agent, envs, args.seed[0]))
        os.environ.setdefault("MUJOCO_GL", "egl" if sys.platform == "linux" else "glfw")
        film = gym.vector.SyncVectorEnv(
            [lambda: make_env(saved["env_id"], render_mode="rgb_array_list")])
        evaluate(agent, film, args.seed[0])
        imageio.imwrite(args.watch.with_suffix(".gif"), film.render()[0][::5], duration=50, loop=0)
    except Exception as error:  # no agent of this script, an environment that cannot be drawn, …
        sys.exit(f"--watch {args.watch}: {error!r}")


def plot(folder):
    """Draw learning_curve.png; print the end of each seed's log."""
    files = sorted(folder.glob("*.csv"), key=lambda file: int(file.stem.removeprefix("seed-")))
    log = pd.concat([pd.read_csv(file).assign(seed=file.stem) for file in files], ignore_index=True)
    figure = Figure(figsize=(12, 8), layout="constrained")
    diagnostics = ["value_loss", "policy_std"]
    axes = figure.subplot_mosaic([["return"] * len(diagnostics), diagnostics], height_ratios=(3, 1))
    for name, ax in axes.items():
        sns.lineplot(log, x="env_step", y=name, hue="seed", estimator=None, legend=False, ax=ax,
                     alpha=0.4 if name == "return" else 1.0)
    sns.lineplot(log, x="env_step", y="eval_return", hue="seed", estimator=None, ax=axes["return"])
    axes["return"].set(title=folder.name, ylabel="return (pale: in training)")
    figure.savefig(folder / "learning_curve.png")
    print(folder, log.groupby("seed", sort=False)[["env_step", "eval_return"]].last(), sep="\n")


def main():
    sys.path.append(str(Path.cwd()))  # `my_module` of --env-id may lie here
    args = parse_args()
    if args.watch:
        return watch(args)
    if len(set(args.seed)) < len(args.seed):
        sys.exit(f"--seed {args.seed}: each only once")
    make_env(args.env_id).close()  # if --env-id is wrong, the program ends here
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
