# /// script
# requires-python = ">=3.10,<3.14"
# dependencies = ["torch>=2.6,<2.14", "gymnasium[mujoco]>=1.4,<1.5", "numpy>=1.26", "tqdm>=4.66",
#     "mujoco>=3.1,<3.16", "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.28"]
# ///
"""REINFORCE: policy gradients from the returns of whole episodes, in one file.

    python reinforce_mujoco.py --seed 1 2 3

trains three agents in parallel to balance a pole on a cart. Each step with the pole upright earns
1, for at most 1000 steps. After 100,000 steps, within a minute, they all earn 1000 in
the last evaluation, where they take the mean of π, not a random action; so do seeds 4 and 5.

At every step the agent observes a state s and draws an action a from its policy π(a|s), a Gaussian
whose mean and standard deviation are computed by a neural network, the actor. The environment
answers with a reward r and the next state, until the episode ends. The goal is a high sum of
rewards. So the higher the return G after an action, the more likely the action is made:

  1. Anneal the learning rate: it falls linearly to 0 over the run.
  2. Play a batch of a few whole episodes with π.
  3. Compute the discounted return from each step t on:  G_t = r_t + γ·G_{t+1}. With γ = 0.98 a
     reward 50 steps later counts only γ^50 ≈ 0.36: G is less noisy than a plain sum, but
     short-sighted. After the last step, G_T = 0 if the episode ended for good. If a time limit cut
     it off, G_T = V(s_T), the rewards still to come, predicted by a second network, the critic [3].
  4. Compute the advantage  A_t = G_t − b_t,  how much better the return was than a baseline b:
         --baseline none    b_t = 0
         --baseline mean    b_t = mean of G over the batch
         --baseline value   b_t = V(s_t), the critic's prediction of G_t
  5. Take an Adam step, with A and G held fixed, on  −mean(A·log π(a|s)) + ½·mean((V(s) − G)²).
     Discard the batch: the next update needs actions of the new π. Repeat from 1.

This is REINFORCE [1] with a baseline; an action is credited only with what followed it [2]. All
else is implementation detail: V(s_T) at a time limit, annealing, Adam, a mean over the steps of a
batch, a lower bound on σ, orthogonal initial weights, small in the last layer of π, a factor γ^t
left out (`policy_loss`). The environment clips actions; log π is that of the unclipped action.
The critic is trained with every baseline, as step 3 needs it.

Symbols: s obs, a actions, r rewards, G returns, V values, A advantages, γ gamma, μ and σ mean and
    standard deviation of π.
Shapes: T steps of an episode, B steps of a batch, D numbers in an observation, K in an action.
An episode is `terminated` if it ended for good (the pole fell), `truncated` if only time ran out. A
`return` in tables and figures is the plain, undiscounted sum of rewards.
[1] Williams 1992, Simple Statistical Gradient-Following Algorithms for Connectionist Reinforcement
Learning. [2] Sutton and Barto 2018, Reinforcement Learning: An Introduction, chapter 13. [3] Pardo
et al. 2018, Time Limits in Reinforcement Learning.
"""

import argparse
import json
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

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
    """The actor π(a|s) = Normal(μ(s), σ(s)) and the critic V(s)."""

    def __init__(self, observation_space, action_space, args):
        super().__init__()
        inputs, outputs = observation_space.shape[0], action_space.shape[0]
        # The small output gain makes π nearly the same in every state at first.
        self.actor = mlp(inputs, args.hidden_size, 2 * outputs, output_gain=0.01)
        self.critic = mlp(inputs, args.hidden_size, 1, output_gain=1.0)

    def policy(self, obs):
        """Observations (…, D) -> π(·|s), a distribution over actions."""
        mean, raw_std = self.actor(obs).chunk(2, dim=-1)
        # The lower bound on σ keeps π exploring and gradients moderate: ∂log π/∂μ = (a − μ)/σ² has
        # standard deviation 1/σ ≤ 10.
        std = nn.functional.softplus(raw_std) + 0.1
        gaussians = torch.distributions.Normal(mean, std, validate_args=False)
        return torch.distributions.Independent(gaussians, 1)  # log π sums over K dimensions

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,)."""
        return self.critic(obs).squeeze(-1)

    @torch.no_grad()
    def act(self, obs, deterministic=False):
        """NumPy observations (N, D) -> N actions, a NumPy array: drawn from π, or its mode."""
        policy = self.policy(torch.as_tensor(obs).to(next(self.parameters())))  # dtype and device
        actions = policy.mode if deterministic else policy.sample()
        return actions.cpu().numpy()


def mlp(inputs, hidden, outputs, output_gain):
    """Two hidden layers, a linear output layer; orthogonal weights, zero biases."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, output_gain)):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


# --- The steps ------------------------------------------------------------------------------------


def rollout(envs, agent, args, env_step):
    """Steps 2 and 3: whole episodes, one after the other.

    `envs` is a vector of one environment that does not reset itself, so `obs` ends at s_T. Returns
    the batch: tensors obs (B, D), actions (B, K), returns (B,); and the last step, plain return and
    length of each episode. `env_step`: steps taken before.
    """
    steps, returns, episodes = [], [], []
    for _ in range(args.batch_episodes):
        obs, _ = envs.reset()
        rewards, done = [], False
        while not done:
            actions = agent.act(obs)
            steps.append({"obs": obs[0], "actions": actions[0]})
            obs, reward, terminated, truncated, _ = envs.step(actions)
            rewards.append(reward.item())
            done = terminated.item() or truncated.item()
        last_value = 0.0 if terminated else agent.value(torch.as_tensor(obs).to(args.device)).item()
        returns += discounted_returns(rewards, last_value, args.gamma)
        env_step += len(rewards)
        episodes.append({"env_step": env_step, "return": sum(rewards), "length": len(rewards)})
    batch = torch.utils.data.default_collate(steps)  # stacks the arrays of each name
    batch["returns"] = torch.tensor(returns)
    batch = SimpleNamespace(**{name: x.to(args.device) for name, x in batch.items()})
    return batch, episodes


def discounted_returns(rewards, last_value, gamma):
    """Step 3: G_t = r_t + γ·G_{t+1}, with G_T = `last_value`; lists of T numbers."""
    returns, G = [], last_value
    for reward in reversed(rewards):
        G = reward + gamma * G
        returns.append(G)
    return returns[::-1]


def compute_advantages(returns, values, baseline):
    """Step 4: A = G − b; A, G: (B,). `detach` keeps the policy loss from training the critic."""
    baselines = {"none": 0.0, "mean": returns.mean(), "value": values.detach()}
    return returns - baselines[baseline]


def policy_loss(log_probs, advantages):
    """−mean(A·log π); log π and A are (B,). Its gradient approximates −∇J (below), up to scale.

    Here V(s) is not the critic but the true expected discounted return from s on, and Q(s,a) the
    same if a is taken first; ∇ is the gradient with respect to the weights of the actor; E is the
    mean over all that is not given: the first state s_0, actions, rewards r, next states s'. We
    maximise J = E[V(s_0)]. Given s and a, r and s' do not depend on the weights, so
    ∇Q = E[γ·∇V(s')]. Then (the policy gradient theorem, [2] sections 13.2 and 13.3)

        ∇V(s) = ∇∫ π(a|s)·Q(s,a) da
              = ∫ [∇π(a|s)·Q(s,a) + π(a|s)·∇Q(s,a)] da    product rule
              = E[Q(s,a)·∇log π(a|s) + γ·∇V(s')]          ∇π = π·∇log π;  Q = E[r + γ·V(s')]
        ∇J = E[∇V(s_0)]
           = E[Σ_t γ^t·Q(s_t,a_t)·∇log π(a_t|s_t)]        insert ∇V(s') again and again
           = E[Σ_t γ^t·G_t·∇log π(a_t|s_t)]               on average G_t is Q(s_t,a_t)

    As usual, γ^t is left out, so that late steps count as much as early ones; strictly, what
    remains is not ∇J. We estimate it by a mean over steps, not a sum, so its scale is independent
    of their number.

    A baseline b(s) may be subtracted from G, because E[b·∇log π] = b·∫∇π da = b·∇∫π da = b·∇1 = 0:
    the mean of the estimate does not change. A good baseline removes much of its noise. If all
    returns are positive, then without a baseline every action that was tried is pushed up, bad ones
    just by less. With b ≈ V, those that turned out worse than expected are pushed down.

    Small biases remain. The baseline `mean`, which includes G_t, and the divisor B both depend on
    the actions; larger batches reduce these biases. At a time limit, G_T is only the critic's
    estimate.
    """
    return -(advantages * log_probs).mean()


def optimise(agent, optimizer, batch, args):
    """Steps 4 and 5: one step of Adam. Returns its metrics."""
    values = agent.value(batch.obs)
    advantages = compute_advantages(batch.returns, values, args.baseline)
    policy = agent.policy(batch.obs)
    loss_pi = policy_loss(policy.log_prob(batch.actions), advantages)
    loss_v = ((values - batch.returns) ** 2).mean() / 2
    optimizer.zero_grad()
    (loss_pi + loss_v).backward()  # the networks share no weights: each has its own loss
    optimizer.step()
    metrics = {"policy_loss": loss_pi, "value_loss": loss_v, "policy_std": policy.stddev.mean()}
    return {name: x.item() for name, x in metrics.items()}


def train(args, seed, envs, agent, optimizer, env_step=0):
    """Yields `env_step`, new episodes and metrics: once before training, then after each update."""
    envs.reset(seed=make_seeds(seed, stream=2, count=1))  # only seeds; `rollout` resets again
    yield env_step, [], []
    while env_step < args.total_steps:
        # Step 1: anneal the learning rate.
        optimizer.param_groups[0]["lr"] = (1 - env_step / args.total_steps) * args.learning_rate
        # Steps 2 and 3: play a batch of episodes, compute returns.
        batch, episodes = rollout(envs, agent, args, env_step)
        # Steps 4 and 5: compute advantages, update the networks.
        metrics = optimise(agent, optimizer, batch, args)
        env_step += len(batch.obs)
        yield env_step, episodes, [{"env_step": env_step, **metrics}]


# --- Options --------------------------------------------------------------------------------------


def parse_args(argv=None):
    """The options; most invalid ones end the program with a one-line error."""
    parser = argparse.ArgumentParser(
        usage=argparse.SUPPRESS, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    add = parser.add_argument
    add("--seed", type=number(int, 0), nargs="+", default=[1], help="random seeds, one agent each")
    add("--total-steps", type=number(int, 1), default=100_000, help="minimum environment steps")
    add("--out-dir", default="runs", help="where the run's folder is created")
    add("--device", default="cpu", help="device for the neural networks: cpu, cuda or mps")
    add("--watch", type=os.path.abspath, metavar="CHECKPOINT", help="evaluate and make a GIF")
    add("--num-evals", type=number(int, 1), default=20, help="evaluations (plus step 0)")
    add("--eval-episodes", type=number(int, 1), default=20, help="episodes per evaluation")
    add("--env-id", default="InvertedPendulum-v5", help="Gymnasium id or my_module:MyEnv-v0")
    add("--batch-episodes", type=number(int, 1), default=4, help="episodes per batch")
    add("--baseline", choices=("none", "mean", "value"), default="value", help="subtracted from G")
    add("--learning-rate", type=number(float, 0), default=3e-3, help="initial, of both networks")
    add("--gamma", type=number(float, 0, 1), default=0.98, help="discount factor")
    add("--hidden-size", type=number(int, 1), default=64, help="units per hidden layer")
    return parse_and_check(parser, argv)


def number(kind, low, high=1e12):
    """An argparse type: an int or float in [low, high]; 1e6 counts as an int."""

    def option(text):
        value = float(text)
        if not low <= value <= high or value != kind(value):
            raise argparse.ArgumentTypeError(f"{text}: no {kind.__name__} in [{low}, {high:g}]")
        return kind(value)

    return option


# ==================================================================================================
# Below: plumbing, not the algorithm
# ==================================================================================================


def make_envs(env_id, count, autoreset_mode, **kwargs):
    """`count` environments; one without a time limit gets 10,000 steps. NaN or inf: ValueError."""
    envs = gym.make_vec(env_id, count, "sync", {"autoreset_mode": autoreset_mode}, [
        lambda env: env if env.spec.max_episode_steps else gym.wrappers.TimeLimit(env, 10_000),
        gym.wrappers.ClipAction], **kwargs)
    # Checked as float32 ("f4"), so that an overflow is caught, too.
    envs = gym.wrappers.vector.TransformReward(envs, lambda x: np.asarray_chkfinite(x, "f4"))
    return gym.wrappers.vector.TransformObservation(envs, lambda x: np.asarray_chkfinite(x, "f4"))


def make_seeds(seed, stream, count):
    """Seeds for each stream: 0 PyTorch in new runs, 1 evaluation, 2 + k training from step k."""
    return np.random.SeedSequence(seed, spawn_key=(stream,)).generate_state(count).tolist()


def evaluate(agent, envs, seed):
    """One episode of deterministic actions in each environment; the same first states each time."""
    obs, _ = envs.reset(seed=make_seeds(seed, stream=1, count=envs.num_envs))
    returns, lengths = np.zeros((2, envs.num_envs))
    playing = np.ones(envs.num_envs, dtype=bool)
    while playing.any():  # finished ones keep running, but no longer count
        obs, rewards, terminated, truncated, _ = envs.step(agent.act(obs, deterministic=True))
        returns += playing * rewards
        lengths += playing
        playing &= ~(terminated | truncated)
    return {"return_mean": returns.mean().item(), "return_std": returns.std().item(),
            "length_mean": lengths.mean().item()}


def watch(args):
    """Evaluate a checkpoint; beside it, save a GIF of the first episode if it can be drawn."""
    os.environ.setdefault("MUJOCO_GL", "egl" if sys.platform == "linux" else "glfw")
    envs = make_envs(args.env_id, args.eval_episodes, "NextStep")
    agent = Agent(envs.single_observation_space, envs.single_action_space, args)
    agent.load_state_dict(torch.load(args.watch, "cpu", weights_only=True)["agent"])
    print(pd.Series(evaluate(agent, envs, args.seed[0])).round(1).to_string())
    if "rgb_array" in envs.metadata["render_modes"]:
        camera = make_envs(args.env_id, 1, "NextStep", render_mode="rgb_array_list")
        evaluate(agent, camera, args.seed[0])
        frames = camera.render()[0][::5]  # for a smaller file
        imageio.imwrite(Path(args.watch).with_suffix(".gif"), frames, duration=50, loop=0)


def run(index, args, folder):
    """Train the agent of one seed; save its tables and a checkpoint at every evaluation."""
    torch.set_num_threads(1)  # networks this small gain nothing from more threads
    seed = args.seed[index]
    folder = folder / f"seed-{seed}"
    folder.mkdir()
    torch.manual_seed(make_seeds(seed, stream=0, count=1)[0])
    envs = make_envs(args.env_id, 1, "Disabled")  # `rollout` resets it
    eval_envs = make_envs(args.env_id, args.eval_episodes, "NextStep")  # reset themselves
    agent = Agent(envs.single_observation_space, envs.single_action_space, args).to(args.device)
    optimizer = torch.optim.Adam(agent.parameters(), fused=True)  # `train` sets its learning rate
    tables = {"evals": [], "episodes": [], "metrics": []}
    seconds = 0.0
    evals_due = np.linspace(0, args.total_steps, args.num_evals + 1, dtype=int)
    with tqdm(total=args.total_steps, disable=index > 0) as bar:
        start = time.perf_counter()
        for env_step, episodes, metrics in train(args, seed, envs, agent, optimizer):
            seconds += time.perf_counter() - start
            tables["episodes"] += episodes
            tables["metrics"] += metrics
            bar.update(min(env_step, args.total_steps) - bar.n)
            if env_step >= evals_due[0]:
                evals_due = evals_due[evals_due > env_step]
                result = evaluate(agent, eval_envs, seed)
                tables["evals"].append({"env_step": env_step, "seconds": seconds, **result})
                bar.set_postfix_str(f"return {result['return_mean']:.1f}")
                save(folder, {"args": {**vars(args), "seed": [seed]}, "tables": tables,
                              "agent": agent.state_dict()})
            if (parent := torch.multiprocessing.parent_process()) and not parent.is_alive():
                return  # the parent process was killed, so stop, too
            start = time.perf_counter()


def save(folder, checkpoint):
    """Write new files, then replace the old ones, so that none is ever half-written."""
    for name, rows in checkpoint["tables"].items():
        if rows:
            pd.DataFrame(rows).to_csv(folder / f"{name}.csv.new", index=False)
    torch.save(checkpoint, folder / "checkpoint.pt.new")
    for file in sorted(folder.glob("*.new")):
        file.replace(file.with_suffix(""))


def report(folder, env_id):
    """Print the result of each seed; draw learning_curve.png: mean and range over seeds."""
    files = sorted(folder.glob("seed-*/*.csv"))
    data = pd.concat([pd.read_csv(file).assign(seed=file.parent.name) for file in files])
    results = data.groupby("seed")[["env_step", "seconds", "return_mean", "return_std"]].last()
    print(folder, results.round(1), sep="\n")
    # In bins, so that each point of the figure is a mean over a fiftieth of the run:
    data["env_step"] -= data["env_step"] % (data["env_step"].max() // 50 + 1)
    data = data.groupby(["env_step", "seed"]).mean().unstack()
    # As seeds end batches at different steps, interpolate, so that each point has all seeds.
    data = data.interpolate("index", limit_area="inside").stack(future_stack=True)
    figure = Figure(figsize=(12, 9), layout="constrained")
    panels = figure.subplot_mosaic([
        ["return"] * 3, ["policy_loss", "value_loss", "policy_std"]], height_ratios=(3, 1))
    if threshold := gym.make(env_id).spec.reward_threshold:
        panels["return"].axhline(threshold, color="grey", label=f"threshold: {threshold:g}")
    labels = {"return": "training", "return_mean": "evaluation: deterministic actions"}
    for name in data.columns.intersection([*panels, *labels]):
        sns.lineplot(data, x="env_step", y=name, errorbar=("pi", 100), label=labels.get(name),
                     ax=panels[name.removesuffix("_mean")]).locator_params(axis="x", nbins=4)
    figure.savefig(folder / "learning_curve.png")


def parse_and_check(parser, argv):
    """Check the options. A checkpoint's options become the defaults."""
    args = parser.parse_args(argv)
    if path := args.watch:
        try:
            saved = torch.load(path, "cpu", weights_only=True)["args"]
            args = parser.parse_args(argv, argparse.Namespace(**saved))
        except Exception as error:
            parser.error(f"argument CHECKPOINT {path}: {error!r}")
    try:
        env = gym.make(args.env_id)
    except (gym.error.Error, ImportError, ValueError) as error:
        parser.error(f"argument --env-id: {error!r}")
    spaces = env.observation_space, env.action_space
    fits = all(isinstance(space, gym.spaces.Box) and len(space.shape) == 1 for space in spaces)
    if not fits or env.action_space.dtype.kind != "f":
        parser.error("argument --env-id: takes flat Box observations and flat Box actions")
    return args


def main():
    args = parse_args()
    if args.watch:
        return watch(args)
    name = f"{args.env_id}__{Path(__file__).stem}__{pd.Timestamp.now():%Y%m%d_%H%M%S%f}"
    folder = Path(args.out_dir, name.replace(":", "-").replace("/", "-"))
    folder.mkdir(parents=True)
    record = {**vars(args), "command": sys.argv,
              "versions": {x: version(x) for x in ("torch", "gymnasium", "mujoco", "numpy")}}
    (folder / "args.json").write_text(json.dumps(record, indent=2))
    try:
        if len(args.seed) == 1:
            run(0, args, folder)
        else:
            torch.multiprocessing.spawn(run, (args, folder), len(args.seed), daemon=True)
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        if any(folder.glob("seed-*/*.csv")):  # none if it ended before the first evaluation
            report(folder, args.env_id)


if __name__ == "__main__":
    main()
