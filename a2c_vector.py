# /// script
# requires-python = ">=3.10,<3.14"
# dependencies = ["torch>=2.6,<2.14", "gymnasium[box2d]>=1.4,<1.5", "numpy>=1.26",
#     "pandas>=2.2", "seaborn>=0.13.2", "matplotlib>=3.8", "imageio>=2.28", "tqdm>=4.66"]
# ///
"""A2C: synchronous advantage actor-critic for discrete actions, in one file.

    python a2c_vector.py --seed 1 2 3

trains three agents in parallel to land on the moon. After 1,000,000 steps, about three minutes,
seeds 1 to 10 average 209 to 267 in evaluation (another CPU: 179 to 274); 200 counts as solved.

At every step the agent observes a state s and draws an action a from its policy π(a|s), computed by
a neural network, the actor. The environment answers with a reward r and the next state, until the
episode ends. The goal is a high expected return r_t + γ·r_{t+1} + γ²·r_{t+2} + …, where γ < 1
makes later rewards count less. A second network, the critic, learns the state value V(s), the
expected return from s on; the action value Q(s,a) is the expected return if a is taken first and π
followed afterwards. Their difference is the advantage A(s,a) = Q(s,a) − V(s): how much better the
action is than what π does on average. If A > 0, a is made more likely; if A < 0, less. Each update:

  1. Anneal linearly to 0: the learning rates and the weight c of the entropy bonus.
  2. Collect a rollout: T steps in each of N environments.
  3. Scale the rewards by a constant, so that the critic's targets are neither tiny nor huge.
  4. Estimate advantages A (GAE) and the critic's targets R = A + V(s), both held fixed in step 5.
     R is a noisy estimate of Q(s,a); least squares fits V(s) to Q's mean over a, the true V(s).
  5. Standardise A over the rollout, and take an Adam step on
         −mean(A·log π(a|s)) + ½·mean((V(s) − R)²) − c·entropy(π)
  6. Update the running mean and standard deviation that normalise observations.

REINFORCE, the plainest policy gradient, needs whole episodes. A2C learns before an episode ends: V
stands in for rewards still to come (bootstrapping). In A3C [1] each worker updates shared weights
on its own; A2C makes one update when all environments have made T steps. `compute_gae` is from [2].
All else is implementation detail: learning-rate annealing, observation normalisation and
clipping, reward scaling, standardised advantages, orthogonal initialisation with small weights in
the last layer of π, gradient clipping, Adam's eps, and A3C's entropy bonus, so that π explores.

Symbols: s obs, a actions, r rewards, V values, A advantages, R targets, γ gamma, λ gae_lambda,
    c entropy_coef. Shapes: T rollout_steps, N num_envs, D numbers in an observation.
An episode is `terminated` if it ended for good (say, by a crash), `truncated` if time ran out,
`done` if either. A `return` in tables and figures is the plain, undiscounted sum of raw rewards.
[1] Mnih et al. 2016, Asynchronous Methods for Deep Reinforcement Learning.
[2] Schulman et al. 2016, arXiv 1506.02438: generalized advantage estimation.
[3] Pardo et al. 2018, Time Limits in Reinforcement Learning.
[4] Peng et al. 2018, Sim-to-Real Transfer of Robotic Control with Dynamics Randomization.
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
    """The actor π(a|s), the critic V(s), and running statistics."""

    def __init__(self, observation_space, action_space, args):
        super().__init__()
        inputs, outputs = observation_space.shape[0], int(action_space.n)
        self.obs_stats = RunningStatistics(inputs)
        # The small output gain makes π nearly the same in every state at first.
        self.actor = mlp(inputs, args.hidden_size, outputs, output_gain=0.01)
        self.critic = mlp(inputs, args.hidden_size, 1, output_gain=1.0)

    def policy(self, obs):
        """Observations (…, D) -> π(·|s), a distribution over actions."""
        logits = self.actor(self.obs_stats.normalise(obs))
        return torch.distributions.Categorical(logits=logits, validate_args=False)

    def value(self, obs):
        """Observations (…, D) -> V(s) (…,), the expected return in scaled rewards (step 3)."""
        return self.critic(self.obs_stats.normalise(obs)).squeeze(-1)

    @torch.no_grad()
    def act(self, obs, deterministic=False):
        """NumPy observations (N, D) -> N actions, a NumPy array: drawn from π, or its mode."""
        policy = self.policy(torch.as_tensor(obs).to(next(self.parameters())))  # dtype and device
        actions = policy.mode if deterministic else policy.sample()
        return actions.cpu().numpy()


class RunningStatistics(nn.Module):
    """Mean and variance of all rows seen so far, for each dimension; at first 0 and 1."""

    def __init__(self, shape):
        super().__init__()
        self.register_buffer("mean", torch.zeros(shape))
        self.register_buffer("var", torch.ones(shape))
        self.register_buffer("count", torch.zeros((), dtype=torch.int64))

    def normalise(self, x):
        """To mean 0 and standard deviation 1, clipped so that no outlier dominates the networks."""
        return ((x - self.mean) / self.var.sqrt()).clamp(-10, 10)

    def update(self, rows):
        """Merge in new `rows` (B, …), whose weight w is their share of all rows so far."""
        self.count += len(rows)
        weight = len(rows) / self.count
        # var ← (1−w)·var + w·(var_new + (1−w)·(mean_new − mean)²);  mean ← (1−w)·mean + w·mean_new
        between = (1 - weight) * (rows.mean(0) - self.mean) ** 2
        # A dimension that has never changed has variance 0; the floor avoids dividing by 0.
        self.var.lerp_(rows.var(0, correction=0) + between, weight).clamp_(min=1e-8)
        self.mean.lerp_(rows.mean(0), weight)


def mlp(inputs, hidden, outputs, output_gain):
    """Two hidden layers, a linear output layer; orthogonal weights, zero biases."""
    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, output_gain)):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])


# --- The steps ------------------------------------------------------------------------------------


def rollout(envs, agent, obs, args, env_step):
    """Step 2: T steps in each environment, starting from observations `obs` (N, D).

    Returns transitions, float tensors (T, N, …); the obs to go on from; step, return and length of
    each episode that ended. Environments do not reset themselves, so `next_obs` is always what
    followed the action; finished ones are reset afterwards. `env_step`: steps taken before.
    """
    steps, episodes = [], []
    for _ in range(args.rollout_steps):
        actions = agent.act(obs)
        next_obs, rewards, terminated, truncated, infos = envs.step(actions)
        done = terminated | truncated
        steps.append({"obs": obs, "actions": actions, "rewards": rewards, "next_obs": next_obs,
                      "terminated": terminated, "done": done})
        env_step += len(obs)
        for i in np.flatnonzero(done):
            episodes.append({"env_step": env_step, "return": float(infos["episode"]["r"][i]),
                             "length": int(infos["episode"]["l"][i])})
        obs = envs.reset(options={"reset_mask": done})[0] if done.any() else next_obs
    batch = torch.utils.data.default_collate(steps)  # stacks the arrays of each name
    batch = SimpleNamespace(**{name: x.float().to(args.device) for name, x in batch.items()})
    return batch, obs, episodes


def compute_gae(rewards, values, next_values, terminated, done, gamma, gae_lambda):
    """Step 4: generalised advantage estimation; all (T, N) ([2] eq. 11 and 16).

        δ_t = r_t + γ·V(s_{t+1}) − V(s_t)               how much better one step was than expected
        A_t = δ_t + γλ·δ_{t+1} + (γλ)²·δ_{t+2} + …
            = δ_t + γλ·A_{t+1}                          so one pass backwards computes them all

    The sum ends with the last δ of an episode or of the rollout. In this last δ_t:
        terminated      no reward can follow, so V(s_{t+1}) counts as 0
        truncated       V(s_{t+1}) stands for what would have followed without a time limit [3]
        end of rollout  V(s_{t+1}) stands for the rest of the episode

    If V is the true value of π, δ_t has mean A(s_t,a_t) and every later δ mean 0, so A_t is right
    on average for every λ. As V is an estimate, λ balances bias against variance. With λ = 0,
    A_t = δ_t relies on one reward and on V: little noise, but all of V's error (bias). With λ = 1,
    the values in between cancel, so A_t = r_t + γ·r_{t+1} + … + γ^n·V(s_{t+n}) − V(s_t) with n
    steps left: less bias, but the luck of all later steps (variance).
    """
    advantages = rewards + gamma * (1 - terminated) * next_values - values  # at first only δ
    for t in reversed(range(len(advantages) - 1)):
        advantages[t] += gamma * gae_lambda * (1 - done[t]) * advantages[t + 1]
    return advantages


def policy_loss(log_probs, advantages):
    """−mean(A·log π); log π and A are (T·N,). Its gradient approximates −∇J (below), up to scale.

    The actions must be drawn from the current π, so a rollout is used only once.

    Below, V, Q and A are those of π itself, not estimates; ∇ is the gradient in π's parameters; E
    averages over all that is not given: the first state s_0, actions, rewards r, next states s'. We
    maximise J = E[V(s_0)]. Given s and a, r and s' do not depend on π, so ∇Q = E[γ·∇V(s')].

        ∇V(s) = Σ_a [∇π(a|s)·Q(s,a) + π(a|s)·∇Q(s,a)]   product rule for V(s) = Σ_a π·Q
              = E[Q(s,a)·∇log π(a|s) + γ·∇V(s')]        ∇π = π·∇log π;  Q = E[r + γ·V(s')]
              = E[A(s,a)·∇log π(a|s) + γ·∇V(s')]        A = Q − V;  E[V·∇log π] = V·∇Σ_a π = 0
        ∇J = E[Σ_t γ^t·A(s_t,a_t)·∇log π(a_t|s_t)]      insert ∇V(s') again and again

    Subtracting V(s), a baseline, leaves this mean as it is, but usually makes estimates of it much
    less noisy. As usual, γ^t is left out, so late steps count fully; the result is not quite ∇J.
    """
    return -(advantages * log_probs).mean()


def optimise(agent, optimizer, batch, args, entropy_coef):
    """Step 5: one step of Adam. Returns its metrics."""
    # The mean is one more baseline (almost: it depends on a); the std fixes A's scale.
    A = (batch.advantages - batch.advantages.mean()) / (batch.advantages.std(correction=0) + 1e-8)
    policy = agent.policy(batch.obs)
    loss_pi = policy_loss(policy.log_prob(batch.actions), A)
    loss_v = ((agent.value(batch.obs) - batch.targets) ** 2).mean() / 2
    entropy = policy.entropy().mean()
    optimizer.zero_grad()
    (loss_pi + loss_v - entropy_coef * entropy).backward()
    for network in agent.actor, agent.critic:  # clipping one must not shrink the other
        nn.utils.clip_grad_norm_(network.parameters(), args.max_grad_norm)
    optimizer.step()
    metrics = {"policy_loss": loss_pi, "value_loss": loss_v, "entropy": entropy,
               # `advantages` are R − V. 1 is perfect, up to an offset; 0 is as good as a constant.
               "explained_variance": 1 - batch.advantages.var() / batch.targets.var()}
    return {name: x.item() for name, x in metrics.items()}


def make_optimizer(agent):
    """Adam for actor and critic; `train` sets the learning rates."""
    groups = [{"params": agent.actor.parameters()}, {"params": agent.critic.parameters()}]
    return torch.optim.Adam(groups, eps=1e-5, fused=True)  # eps damps steps if gradients < 1e-5


def train(args, seed, envs, agent, optimizer, env_step):
    """Yields `env_step`, new episodes and metrics: once before training, then after each update."""
    obs, _ = envs.reset(seed=make_seeds(seed, 2 + env_step, args.num_envs))
    yield env_step, [], []
    while env_step < args.total_steps:
        # Step 1: anneal.
        remaining = 1 - env_step / args.total_steps
        optimizer.param_groups[0]["lr"] = remaining * args.learning_rate
        optimizer.param_groups[1]["lr"] = remaining * args.critic_learning_rate
        entropy_coef = remaining * args.entropy_coef
        # Steps 2 and 3: collect a rollout, scale the rewards.
        batch, obs, episodes = rollout(envs, agent, obs, args, env_step)
        batch.rewards *= args.reward_scale
        # Step 4: estimate advantages and targets, which are constants in the losses.
        with torch.no_grad():
            values, next_values = agent.value(batch.obs), agent.value(batch.next_obs)
        batch.advantages = compute_gae(batch.rewards, values, next_values, batch.terminated,
                                       batch.done, args.gamma, args.gae_lambda)
        batch.targets = batch.advantages + values
        # Step 5: update actor and critic.
        batch = SimpleNamespace(**{name: x.flatten(0, 1) for name, x in vars(batch).items()})
        metrics = optimise(agent, optimizer, batch, args, entropy_coef)
        # Step 6: update `obs_stats` last, so that steps 2 to 5 normalise in the same way.
        agent.obs_stats.update(batch.obs)
        env_step += len(batch.obs)  # T·N
        yield env_step, episodes, [{"env_step": env_step, **metrics}]


class RandomPhysics(gym.Wrapper):
    """`--randomize`: each episode of training has its own gravity and wind, unseen by π [4]."""

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.random = np.random.default_rng([seed, 1])  # the environment itself uses `seed`
        self.unwrapped.enable_wind = bool(self.random.integers(2))
        self.unwrapped.gravity = self.random.uniform(-11.99, -7.0)
        self.unwrapped.wind_power = self.random.uniform(0.0, 20.0)
        self.unwrapped.turbulence_power = self.random.uniform(0.0, 2.0)
        return self.env.reset(seed=seed, options=options)


# --- Options --------------------------------------------------------------------------------------


def parse_args(argv=None):
    """The options; most invalid ones end the program with a one-line error."""
    parser = argparse.ArgumentParser(
        usage=argparse.SUPPRESS, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    add = parser.add_argument
    add("--seed", type=number(int, 0), nargs="+", default=[1], help="random seeds, one agent each")
    add("--total-steps", type=number(int, 1), default=1_000_000, help="minimum environment steps")
    add("--out-dir", default="runs", help="where the run's folder is created")
    add("--device", default="cpu", help="device for the neural networks: cpu, cuda or mps")
    add("--resume", type=os.path.abspath, metavar="CHECKPOINT", help="resume in a new folder")
    add("--watch", type=os.path.abspath, metavar="CHECKPOINT", help="evaluate and make a GIF")
    add("--num-evals", type=number(int, 1), default=20, help="evaluations (plus step 0)")
    add("--eval-episodes", type=number(int, 1), default=20, help="episodes per evaluation")
    add("--env-id", default="LunarLander-v3", help="Gymnasium id or my_module:MyEnv-v0")
    add("--num-envs", type=number(int, 1), default=8, help="environments stepped together")
    add("--vectorization", choices=("sync", "async"), default="sync", help="async: in processes")
    add("--randomize", action="store_true", help="LunarLander: train in changing physics")
    add("--rollout-steps", type=number(int, 1), default=64, help="rollout steps per environment")
    add("--reward-scale", type=number(float, 0), default=0.1, help="multiplies rewards in training")
    add("--learning-rate", type=number(float, 0), default=2e-3, help="initial, actor")
    add("--critic-learning-rate", type=number(float, 0), default=3e-3, help="initial, critic")
    add("--gamma", type=number(float, 0, 1), default=0.999, help="discount factor")
    add("--gae-lambda", type=number(float, 0, 1), default=0.98, help="0 relies on V, 1 on rewards")
    add("--entropy-coef", type=number(float, 0), default=0.01, help="initial weight of the entropy")
    add("--max-grad-norm", type=number(float, 0), default=0.5, help="largest, per network")
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


def make_envs(env_id, count, autoreset_mode, vectorization="sync", randomize=False, **kwargs):
    """`count` environments; one without a time limit gets 10,000 steps. NaN or inf: ValueError."""
    envs = gym.make_vec(env_id, count, vectorization, {"autoreset_mode": autoreset_mode}, [
        lambda env: env if env.spec.max_episode_steps else gym.wrappers.TimeLimit(env, 10_000),
        gym.wrappers.RecordEpisodeStatistics, *([RandomPhysics] if randomize else [])], **kwargs)
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
    # "Disabled" leaves resets to `rollout`.
    envs = make_envs(args.env_id, args.num_envs, "Disabled", args.vectorization, args.randomize)
    eval_envs = make_envs(args.env_id, args.eval_episodes, "NextStep")  # reset themselves
    agent = Agent(envs.single_observation_space, envs.single_action_space, args).to(args.device)
    optimizer = make_optimizer(agent)
    tables = {"evals": [], "episodes": [], "metrics": []}
    first_step, seconds = 0, 0.0
    if args.resume:
        checkpoint = torch.load(args.resume, "cpu", weights_only=True)
        agent.load_state_dict(checkpoint["agent"])
        optimizer.load_state_dict(checkpoint["optimizer"])
        tables = checkpoint["tables"]
        last = tables["evals"].pop()  # the loop begins by repeating it
        first_step, seconds = last["env_step"], last["seconds"]
        torch.manual_seed(make_seeds(seed, 2 + first_step, count=1)[0])
    evals_due = np.linspace(first_step, args.total_steps, args.num_evals + 1, dtype=int)
    with tqdm(total=args.total_steps, initial=first_step, disable=index > 0) as bar:
        start = time.perf_counter()
        for env_step, episodes, metrics in train(args, seed, envs, agent, optimizer, first_step):
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
                              "agent": agent.state_dict(), "optimizer": optimizer.state_dict()})
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
    data = data.groupby(["seed", "env_step"], as_index=False).mean()
    figure = Figure(figsize=(12, 9), layout="constrained")
    panels = figure.subplot_mosaic([
        ["return"] * 4, ["policy_loss", "value_loss", "explained_variance", "entropy"]],
        height_ratios=(3, 1))
    if threshold := gym.make(env_id).spec.reward_threshold:
        panels["return"].axhline(threshold, color="grey", label=f"threshold: {threshold:g}")
    labels = {"return": "training", "return_mean": "evaluation: deterministic actions"}
    for name in data.columns.intersection([*panels, *labels]):
        sns.lineplot(data, x="env_step", y=name, errorbar=("pi", 100), label=labels.get(name),
                     ax=panels[name.removesuffix("_mean")]).locator_params(axis="x", nbins=4)
    figure.savefig(folder / "learning_curve.png")


def parse_and_check(parser, argv):
    """Check the options. A checkpoint's options (not its device) become the defaults."""
    args = parser.parse_args(argv)
    if path := args.resume or args.watch:
        try:
            saved = torch.load(path, "cpu", weights_only=True)["args"] | {"device": "cpu"}
            args = parser.parse_args(argv, argparse.Namespace(**saved))
        except Exception as error:
            parser.error(f"argument CHECKPOINT {path}: {error!r}")
    try:
        env = gym.make(args.env_id)
    except (gym.error.Error, ImportError, ValueError) as error:
        parser.error(f"argument --env-id: {error!r}")
    observations, actions = env.observation_space, env.action_space
    fits = isinstance(observations, gym.spaces.Box) and len(observations.shape) == 1
    if not fits or not isinstance(actions, gym.spaces.Discrete) or actions.start != 0:
        parser.error("argument --env-id: takes flat Box observations, Discrete actions from 0")
    if args.vectorization == "async" and len(args.seed) > 1:
        parser.error("argument --vectorization: async takes one seed")
    if args.randomize and not hasattr(env.unwrapped, "turbulence_power"):
        parser.error("argument --randomize: takes LunarLander")
    return args


def main():
    args = parse_args()
    if args.watch:
        return watch(args)
    name = f"{args.env_id}__{Path(__file__).stem}__{pd.Timestamp.now():%Y%m%d_%H%M%S%f}"
    folder = Path(args.out_dir, name.replace(":", "-").replace("/", "-"))
    folder.mkdir(parents=True)
    record = {**vars(args), "command": sys.argv,
              "versions": {x: version(x) for x in ("torch", "gymnasium", "Box2D", "numpy")}}
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
