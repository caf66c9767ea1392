"""a2c_vector.py: its maths by hand, its worlds in processes, its random physics, what it learns."""

import contextlib
import functools
import json
import math
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import gymnasium as gym
import harness  # registers the worlds
import numpy as np
import pandas as pd
import pytest
import torch
from harness import ROOT, read_json, run, run_folder, start, table

import a2c_vector as a2c
import ppo_continuous as ppo

SIZES = "--num-envs 4 --rollout-steps 25 --total-steps 100"
SHORT = "--num-envs 3 --rollout-steps 64 --total-steps 576 --eval-episodes 1 --eval-every 0"
ASYNC = "--vectorization async"

# Python 3.12 and later warn of a fork while threads run, such as that of tqdm
may_fork = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


def parse(env, options=""):
    env_id = env if "-" in env else f"harness:{env}-v0"
    return a2c.parse_args(f"--env-id {env_id} {SIZES} {options}".split())


def make(env="DiscreteThreeSteps", options=""):
    """Arguments, vector environment, its first observations, and an agent for it."""
    args = parse(env, options)
    envs = a2c.make_envs(args)
    obs, _ = envs.reset(seed=a2c.make_seeds(1, stream=2, count=args.num_envs))
    agent = a2c.make_agent(args, gym.make(args.env_id))
    make_opinionated(agent)
    return args, envs, obs, agent


def make_opinionated(agent):
    """A new policy finds all actions alike, which would hide mistakes."""
    agent["policy"].net[-1].weight.data *= 300
    agent["policy"].norm.update(torch.randn(50, *agent["policy"].norm.mean.shape))


def play(env="DiscreteThreeSteps", options=""):
    """One rollout: arguments, agent, transitions, episodes."""
    args, envs, obs, agent = make(env, options)
    transitions, _, episodes = a2c.rollout(envs, agent["policy"], obs, args.rollout_steps, 0)
    return args, agent, transitions, episodes


def train(path, env, options="", seed=1):
    """Train into `path`: the parameters and statistics at the end."""
    path.mkdir(exist_ok=True)
    a2c.train(parse(env, options), seed, path / "seed", path / "stop")
    return torch.load(path / "seed/checkpoint.pt", weights_only=True)["agent"]


def check_same(some, others):
    assert some.keys() == others.keys()
    assert all(torch.equal(x, others[name]) for name, x in some.items())


# --- Advantages -----------------------------------------------------------------------------------


def test_the_last_row_of_a_rollout_and_a_rollout_of_one_step_learn():
    for T in 1, 6:
        args, agent, transitions, _ = play(options=f"--rollout-steps {T} --num-envs 16")
        states, _, rewards, next_states, terminated, done = transitions.values()
        with torch.no_grad():
            values, next_values = agent["critic"](states), agent["critic"](next_states)
        batch = rewards, values, next_values, terminated, done
        advantages = a2c.compute_gae(*batch, args.gamma, args.gae_lambda)
        delta = rewards + args.gamma * next_values * ~terminated - values
        assert terminated[-1].all() == (T == 6)
        torch.testing.assert_close(advantages[-1], delta[-1])


@pytest.mark.parametrize("world", ["DiscreteThreeSteps", "DiscreteForever"])
def test_nothing_of_the_next_episode_reaches_an_episode(world):
    """Though it ended by its time limit, and though the next one began within the same step."""
    args, agent, transitions, _ = play(world)
    _, _, rewards, _, terminated, done = transitions.values()
    end = done[:, 0].nonzero()[0].item()
    assert done[end].all()
    values, next_values = torch.randn(2, *rewards.shape)
    before = a2c.compute_gae(rewards, values, next_values, terminated, done, 0.9, 0.8)
    assert before.isfinite().all()
    for x in rewards, values, next_values:
        x[end + 1 :] = math.nan  # NaN, since 0 · NaN would still be NaN
    if world == "DiscreteThreeSteps":
        next_values[end] = math.nan
    after = a2c.compute_gae(rewards, values, next_values, terminated, done, 0.9, 0.8)
    assert torch.equal(before[: end + 1], after[: end + 1])


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits(tmp_path):
    options = "--gamma 0.9 --total-steps 12800 --num-envs 8 --rollout-steps 8 --eval-every 0"
    options += " --critic-learning-rate 1e-2 --reward-scale 0.5"
    args, _, _, agent = make("Timeless", options)
    agent.load_state_dict(train(tmp_path, "Timeless", options))
    obs = torch.tensor([[episode, 0.0] for episode in (-0.8, 0.0, 0.8)])
    raw_values = agent["critic"](obs) / args.reward_scale
    assert (raw_values - 10).abs().max() < 1, raw_values  # blind to the limit: at most 5.7


# --- Losses and their gradients -------------------------------------------------------------------


def test_losses_by_hand():
    log_probs, advantages = torch.tensor([-1.0, -0.5, -2.0]), torch.tensor([2.0, -4.0, 1.0])
    assert a2c.policy_loss(log_probs, advantages).item() == pytest.approx(-(-2 + 2 - 2) / 3)
    values, targets = torch.tensor([1.0, 2.0, 0.0]), torch.tensor([3.0, 1.0, 0.0])
    assert a2c.value_loss(values, targets).item() == pytest.approx((4 + 1 + 0) / 3 / 2)


def gradients_by_hand(args, agent, transitions):
    """Of the loss that the docstring of a2c_vector.py states, from the definitions."""
    states, actions, rewards, next_states, terminated, done = transitions.values()
    policy, critic = agent["policy"], agent["critic"]
    values, next_values = critic(states).tolist(), critic(next_states).tolist()  # numbers: constant
    T, N = rewards.shape
    advantages = torch.zeros(T, N)
    for n in range(N):
        for t in range(T):
            for k in range(t, T):
                goes_on = not terminated[k, n]
                reward = args.reward_scale * rewards[k, n]
                delta = reward + args.gamma * goes_on * next_values[k][n] - values[k][n]
                advantages[t, n] += (args.gamma * args.gae_lambda) ** (k - t) * delta
                if done[k, n]:
                    break
    targets = advantages + torch.tensor(values)
    advantages = (advantages - advantages.mean()) / advantages.std()
    probs = policy.net(policy.norm(states)).softmax(-1)
    log_pi = probs.gather(-1, actions.unsqueeze(-1)).squeeze(-1).log()
    entropy = -(probs * probs.log()).sum(-1).mean()
    loss_pi = -(advantages * log_pi).mean() - args.entropy_coef * entropy
    loss_v = (critic(states) - targets).square().mean() / 2
    parameters = list(policy.parameters()), list(critic.parameters())
    return [*torch.autograd.grad(loss_pi, parameters[0]),
            *torch.autograd.grad(loss_v, parameters[1])]


@pytest.mark.parametrize("rollout_steps", [1, 25])
@pytest.mark.parametrize("world", ["DiscreteThreeSteps", "DiscreteForever"])
def test_an_update_follows_the_gradient_written_out(world, rollout_steps):
    """In particular, none goes through a bootstrap value, a target or an advantage."""
    options = f"--rollout-steps {rollout_steps} --max-grad-norm 1e9"
    options += " --gamma 0.9 --gae-lambda 0.7 --entropy-coef 0.3 --reward-scale 0.4"
    args, agent, transitions, _ = play(world, options)
    transitions["rewards"] = torch.randn_like(transitions["rewards"])
    expected = gradients_by_hand(args, agent, transitions)
    a2c.optimise(agent, torch.optim.SGD(agent.parameters(), lr=0.0), transitions, args)
    parameters = [*agent["policy"].parameters(), *agent["critic"].parameters()]
    for parameter, gradient in zip(parameters, expected):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-6)


def test_each_loss_reaches_its_own_network_only():
    _, agent, transitions, _ = play()
    states, actions, rewards, *_ = transitions.values()
    losses = {
        "policy": a2c.policy_loss(agent["policy"](states).log_prob(actions), rewards),
        "critic": a2c.value_loss(agent["critic"](states), rewards),
    }
    for name, loss in losses.items():
        agent.zero_grad(set_to_none=True)
        loss.backward()
        reached = {key.split(".")[0] for key, p in agent.named_parameters() if p.grad is not None}
        assert reached == {name}


def test_the_loss_of_ppo_starts_with_the_gradient_of_a2c():
    """What links the files: as long as its ratio is 1, PPO's step is A2C's."""
    _, agent, transitions, _ = play()
    states, actions, *_ = transitions.values()
    log_probs = agent["policy"](states).log_prob(actions).flatten()
    advantages, parameters = torch.randn(len(log_probs)), list(agent["policy"].parameters())
    ratio = (log_probs - log_probs.detach()).exp()
    losses = a2c.policy_loss(log_probs, advantages), ppo.policy_loss(ratio, advantages, 0.2)
    ours, theirs = (torch.autograd.grad(x, parameters, retain_graph=True) for x in losses)
    assert all(x.abs().max() > 1e-4 for x in ours)
    for x, y in zip(ours, theirs):
        torch.testing.assert_close(x, y)


def test_longer_gradients_are_shortened_network_by_network_and_logged_as_they_were():
    logged, kept = [], []
    for limit in 1e9, 1e-3:
        torch.manual_seed(0)
        args, agent, transitions, _ = play(options=f"--max-grad-norm {limit}")
        sgd = torch.optim.SGD(agent.parameters(), lr=0.0)
        metrics = a2c.optimise(agent, sgd, transitions, args)
        logged.append([metrics["grad_norm"], metrics["critic_grad_norm"]])
        for network in agent["policy"], agent["critic"]:
            kept.append(torch.cat([p.grad.flatten() for p in network.parameters()]).norm().item())
    assert logged[0] == logged[1] == pytest.approx(kept[:2])
    assert min(kept[:2]) > 2e-3
    assert kept[2:] == pytest.approx([1e-3, 1e-3], rel=1e-2)


def test_the_logged_numbers_are_those_of_the_rollout():
    args, agent, transitions, _ = play(options="--gae-lambda 1 --gamma 0.9 --reward-scale 2")
    states = transitions["states"]
    with torch.no_grad():
        values, entropy = agent["critic"](states), agent["policy"](states).entropy().mean()
    metrics = a2c.optimise(agent, torch.optim.SGD(agent.parameters(), lr=0.0), transitions, args)
    # λ = 1: R of the steps of whole episodes is the discounted sum of their rewards, 2 · 1 each
    R = 2 * torch.tensor([1 + 0.9 + 0.81, 1 + 0.9, 1] * 8 + [0]).unsqueeze(-1).repeat(1, 4)
    with torch.no_grad():
        R[-1] = 2 + 0.9 * agent["critic"](transitions["next_states"][-1])
    assert metrics["value_loss"] == pytest.approx((values - R).square().mean().item() / 2, rel=1e-4)
    explained = 1 - (R - values).var() / R.var()
    assert metrics["explained_variance"] == pytest.approx(explained.item(), rel=1e-3)
    assert metrics["entropy"] == pytest.approx(entropy.item(), rel=1e-5)


# --- Policy ---------------------------------------------------------------------------------------


def test_log_probabilities_and_entropy_by_hand():
    _, _, obs, agent = make()
    policy, obs = agent["policy"], torch.as_tensor(obs)
    p = policy.net(policy.norm(obs)).exp()
    p = p / p.sum(-1, keepdim=True)
    for action in range(3):
        log_probs = policy(obs).log_prob(torch.full((4,), action))
        torch.testing.assert_close(log_probs, p[:, action].log())
    torch.testing.assert_close(policy(obs).entropy(), -(p * p.log()).sum(-1))
    uniform = torch.zeros_like(p)
    for parameter in policy.net[-1].parameters():
        parameter.data.zero_()
    torch.testing.assert_close(policy(obs).entropy(), uniform[:, 0] + math.log(3))


def test_the_policy_that_acts_is_the_one_that_learns():
    """Actions are as frequent as the log-probabilities say, and each environment draws its own."""
    _, _, _, agent = make()
    state = np.float32([[1, 2]])
    samples, _ = agent["policy"].act(np.repeat(state, 20_000, axis=0))
    frequencies = np.bincount(samples, minlength=3) / 20_000
    probs = agent["policy"](torch.as_tensor(state[0])).probs.detach().numpy()
    assert probs.max() - probs.min() > 0.05
    np.testing.assert_allclose(frequencies, probs, atol=0.015)  # 4 standard errors


def test_the_deterministic_action_is_the_most_likely_one():
    _, _, _, agent = make()
    obs = np.float32(np.random.default_rng(0).normal(size=(200, 2), scale=3))
    samples, actions = agent["policy"].act(obs, deterministic=True)
    assert len(np.unique(samples)) > 1
    np.testing.assert_array_equal(samples, agent["policy"](torch.as_tensor(obs)).probs.argmax(-1))
    np.testing.assert_array_equal(actions, samples + 1)  # this world counts from 1


def test_a_saved_agent_acts_the_same_when_loaded(tmp_path):
    args, _, _, agent = make()
    a2c.save_checkpoint(tmp_path, args, 1, agent=agent.state_dict())
    torch.manual_seed(1)
    other = a2c.make_agent(args, gym.make(args.env_id))
    obs = np.float32(np.random.default_rng(0).normal(size=(100, 2), scale=3))
    old, new = (x["policy"].act(obs, deterministic=True)[1] for x in (agent, other))
    assert (old != new).any()
    other.load_state_dict(torch.load(tmp_path / "checkpoint.pt", weights_only=True)["agent"])
    np.testing.assert_array_equal(old, other["policy"].act(obs, deterministic=True)[1])


# --- Rollout --------------------------------------------------------------------------------------


@pytest.mark.parametrize("world", ["DiscreteThreeSteps", "DiscreteForever"])
def test_every_row_is_a_real_transition(world):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    args, envs, obs, agent = make(world)
    transitions, last_obs, _ = a2c.rollout(envs, agent["policy"], obs, args.rollout_steps, 0)
    states, _, rewards, next_states, terminated, done = transitions.values()
    length = {"DiscreteThreeSteps": 3, "DiscreteForever": 8}[world]
    assert (states[0, :, 1] == 0).all()
    assert torch.equal(next_states[..., 0], states[..., 0])  # the same episode, also at its end
    assert torch.equal(next_states[..., 1], states[..., 1] + 1)
    assert torch.equal(done, next_states[..., 1] == length)
    by_itself = world == "DiscreteThreeSteps"
    assert torch.equal(terminated, done if by_itself else torch.zeros_like(done))
    goes_on = ~done[:-1]
    assert torch.equal(states[1:][goes_on], next_states[:-1][goes_on])
    assert (states[1:][done[:-1]][:, 1] == 0).all()
    assert torch.equal(torch.tensor(last_obs)[~done[-1]], next_states[-1][~done[-1]])
    assert (rewards == 1).all()
    for env in envs.envs:  # as many rows as steps, by its own count
        assert env.steps == env.unwrapped.total == len(states)
    assert all(x.dtype in (torch.float32, torch.bool) for x in (states, rewards, next_states, done))


def test_the_stored_action_is_the_one_that_was_executed():
    """This world shows the action that it got, counts them from 1, and refuses all others."""
    _, _, transitions, _ = play("Echo", "--rollout-steps 60 --total-steps 240")
    samples, executed = transitions["samples"], transitions["next_states"][..., 0]
    assert sorted(set(samples.flatten().tolist())) == [0, 1, 2]
    assert torch.equal(samples + 1, executed.long())


def test_every_finished_episode_is_logged_once_with_its_raw_return_and_length():
    _, envs, obs, agent = make()
    episodes = []
    for begin in range(0, 60, 20):  # 5 steps in 4 environments at a time: some span two rollouts
        _, obs, ended = a2c.rollout(envs, agent["policy"], obs, 5, begin)
        episodes += ended
    assert episodes == [(4 * step, 3.0, 3) for step in (3, 6, 9, 12, 15) for _ in range(4)]


def test_episodes_csv_holds_every_episode_of_a_run(tmp_path):
    train(tmp_path, "DiscreteForever", "--rollout-steps 5 --total-steps 320 --eval-every 0")
    episodes = pd.read_csv(tmp_path / "seed/episodes.csv")
    assert episodes["env_step"].tolist() == [8 * 4 * (i + 1) for i in range(10) for _ in range(4)]
    assert (episodes["return"] == 8).all()
    assert (episodes["length"] == 8).all()


# --- Training and evaluation ----------------------------------------------------------------------


def test_the_same_seed_gives_the_same_parameters_and_another_seed_others(tmp_path):
    first, again = (train(tmp_path / name, "CartPole-v1", SHORT) for name in ("first", "again"))
    check_same(first, again)
    other = train(tmp_path / "other", "CartPole-v1", SHORT, seed=2)
    weights = [name for name in first if name.endswith("weight")]
    assert not any(torch.equal(first[name], other[name]) for name in weights)


def test_both_learning_rates_fall_in_a_straight_line(tmp_path, monkeypatch):
    seen, optimise = [], a2c.optimise

    def spy(agent, optimizer, *rest):
        for network, group in zip(("policy", "critic"), optimizer.param_groups):
            assert {id(p) for p in group["params"]} == {id(p) for p in agent[network].parameters()}
        seen.append([group["lr"] for group in optimizer.param_groups])
        return optimise(agent, optimizer, *rest)

    monkeypatch.setattr(a2c, "optimise", spy)
    options = "--learning-rate 1e-3 --critic-learning-rate 4e-3 --total-steps 400 --eval-every 0"
    train(tmp_path, "DiscreteThreeSteps", options)
    falling = np.array([1, 0.75, 0.5, 0.25])
    np.testing.assert_allclose(seen, np.stack([1e-3 * falling, 4e-3 * falling], axis=1))


def test_the_policy_that_learns_from_a_rollout_is_the_one_that_played_it(tmp_path, monkeypatch):
    """Also its statistics: they change after the update, or π(a|s) would not be what acted."""
    played, rollout, optimise = [], a2c.rollout, a2c.optimise

    def spy(envs, policy, *rest):
        played.append({name: x.clone() for name, x in policy.state_dict().items()})
        return rollout(envs, policy, *rest)

    def check(agent, *rest):
        check_same(agent["policy"].state_dict(), played[-1])
        return optimise(agent, *rest)

    monkeypatch.setattr(a2c, "rollout", spy)
    monkeypatch.setattr(a2c, "optimise", check)
    train(tmp_path, "DiscreteThreeSteps", "--total-steps 300 --eval-every 0")
    assert [x["norm.count"].item() for x in played] == [0, 100, 200]


@pytest.mark.parametrize("world", ["DiscreteForever", "LunarLander-v3"])
def test_evaluation_keeps_to_the_registered_time_limit_and_physics(world, tmp_path, monkeypatch):
    """Also while training has random physics."""
    seen, evaluate = [], a2c.evaluate

    def spy(policy, env, seeds):
        seen.append((env.spec, env.unwrapped))
        return evaluate(policy, env, seeds)

    monkeypatch.setattr(a2c, "evaluate", spy)
    randomize = "--randomize" if world == "LunarLander-v3" else ""
    train(tmp_path, world, f"--eval-every 1 --eval-episodes 2 {randomize}")
    ((spec, unwrapped),) = seen
    assert spec.max_episode_steps == {"DiscreteForever": 8, "LunarLander-v3": 1000}[world]
    if randomize:
        assert physics_in_force(unwrapped) == usual_physics()
    else:
        evals = pd.read_csv(tmp_path / "seed/evals.csv")
        assert evals[["return_mean", "length_mean", "episodes"]].values.tolist() == [[8, 8, 2]]


def test_evaluation_is_deterministic_and_every_seed_another_episode():
    _, _, _, agent = make("CartPole-v1")
    env = gym.make("CartPole-v1")
    a, b = (a2c.evaluate(agent["policy"], env, range(5)) for _ in range(2))
    assert a == b
    assert a["return_std"] > 0
    returns = [a2c.play(agent["policy"], env, seed)[0] for seed in range(5)]
    assert (a["return_mean"], a["episodes"]) == (np.mean(returns), 5)


# --- Random physics -------------------------------------------------------------------------------

NAMES = "gravity", "wind_power", "turbulence_power"
METHODS = multiprocessing.get_all_start_methods()


def lander(options="--randomize"):
    return a2c.make_env(a2c.parse_args(options.split()), 0)


def physics_in_force(env):
    env = env.unwrapped
    return {"enable_wind": env.enable_wind, **{name: getattr(env, name) for name in NAMES}}


def usual_physics():
    return physics_in_force(gym.make("LunarLander-v3"))


def draw(env, episodes, seed=0):
    """Physics of the first episodes, as the environment has them."""
    drawn = []
    for episode in range(episodes):
        env.reset(seed=None if episode else seed)
        drawn.append(physics_in_force(env))
        assert env.unwrapped.world.gravity[1] == pytest.approx(drawn[-1]["gravity"])
    return pd.DataFrame(drawn)


@pytest.mark.parametrize("widths", [(8, 15, 1.5), (1, 2, 0.3), (100, 100, 100)])
def test_physics_fill_their_widths_within_the_ranges_of_the_lander(widths):
    flags = (f"--{x}-width {width}" for x, width in zip(("gravity", "wind", "turbulence"), widths))
    drawn = draw(lander(" ".join(["--randomize", *flags])), 300)
    usual, lowest, highest = (-10, 15, 1.5), (-12, 0, 0), (0, 20, 2)
    for i, name in enumerate(NAMES):
        low, high = max(usual[i] - widths[i], lowest[i]), min(usual[i] + widths[i], highest[i])
        margin = 0.05 * (high - low)
        assert low <= drawn[name].min() < low + margin
        assert high >= drawn[name].max() > high - margin
        assert drawn[name].nunique() == 300
    assert -12 < drawn["gravity"].min() < drawn["gravity"].max() < 0  # the lander refuses the ends
    assert 0.4 < drawn["enable_wind"].mean() < 0.6


def test_a_width_of_0_leaves_the_usual_value():
    drawn = draw(lander("--randomize --gravity-width 0 --wind-width 0 --turbulence-width 0"), 5)
    usual = usual_physics()
    assert all((drawn[name] == usual[name]).all() for name in NAMES)


def test_without_randomize_the_physics_are_the_registered_ones():
    env = lander("")
    drawn = draw(env, 3)
    assert all((drawn[name] == value).all() for name, value in usual_physics().items())
    while not (info := env.step(0)[-1]):
        pass
    assert len(info["episode"]) == 2


def test_physics_do_not_change_what_else_an_environment_draws():
    """The usual world and a random one of width 0 without wind show the same first observation."""
    usual, env = gym.make("LunarLander-v3"), lander("--randomize --gravity-width 0")
    for seed in range(20):
        a, b = usual.reset(seed=seed)[0], env.reset(seed=seed)[0]
        if not env.unwrapped.enable_wind:
            np.testing.assert_array_equal(a, b)


def test_the_row_of_an_episode_holds_the_physics_of_that_episode():
    """Not those of the next one, which have been drawn by the time that the row is written."""
    args, envs, obs, agent = make("LunarLander-v3", "--randomize")
    rows = 0
    for t in range(300):
        before = [physics_in_force(env) for env in envs.envs]
        transitions, obs, episodes = a2c.rollout(envs, agent["policy"], obs, 1, 4 * t)
        ended = transitions["done"][0].nonzero().flatten().tolist()
        assert [row[3:] for row in episodes] == [tuple(before[i].values()) for i in ended]
        rows += len(ended)
    assert rows >= 4


def draw_physics(vectorization):
    """What two environments draw for two episodes, for the seeds 1, 2 and 1 again."""
    options = ["--num-envs", "2", "--randomize", "--vectorization", vectorization]
    envs, drawn = a2c.make_envs(a2c.parse_args(options)), []
    for seed in 1, 2, 1:
        for env_seeds in a2c.make_seeds(seed, stream=2, count=2), None:
            envs.reset(seed=env_seeds)
            drawn.append([list(x) for x in zip(*map(envs.get_attr, NAMES))])
    envs.close()
    return drawn


def test_physics_differ_between_environments_episodes_and_seeds_and_repeat_with_the_seed():
    first, second, other_first, other_second, again, again_second = draw_physics("sync")
    assert [first, second] == [again, again_second]
    drawn = [values for episode in (first, second, other_first, other_second) for values in episode]
    assert len(drawn) == 8
    for values in zip(*drawn):  # gravity, wind power, turbulence
        assert len(set(values)) == 8


DRAW_PHYSICS = """
import multiprocessing
import sys

if __name__ == "__main__":
    import json
    import test_a2c

    multiprocessing.set_start_method(sys.argv[1])
    print(json.dumps(test_a2c.draw_physics("async")))
"""


@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_processes_draw_the_same_physics_however_they_were_started(method, tmp_path):
    if method not in METHODS:
        pytest.skip(f"no {method} here")
    (tmp_path / "draw.py").write_text(DRAW_PHYSICS)
    path = os.pathsep.join([str(harness.TESTS), str(ROOT)])
    process = run(tmp_path / "draw.py", method, cwd=tmp_path, PYTHONPATH=path)
    assert json.loads(process.out) == draw_physics("sync")


# --- Processes ------------------------------------------------------------------------------------


@may_fork
@pytest.mark.parametrize("env", ["CartPole-v1", "LunarLander-v3 --randomize"])
def test_environments_in_processes_change_no_number(env, tmp_path):
    env, *options = env.split(" ", 1)
    options = " ".join([SHORT, *options])
    sync = train(tmp_path / "sync", env, options)
    check_same(sync, train(tmp_path / "async", env, f"{options} {ASYNC}"))
    for name in "episodes.csv", "metrics.csv", "evals.csv":
        tables = [table(tmp_path / kind / "seed" / name) for kind in ("sync", "async")]
        assert len(tables[0]) > 0
        pd.testing.assert_frame_equal(*tables, check_exact=True)
    drawn = table(tmp_path / "async/seed/episodes.csv").columns[3:].tolist()
    assert drawn == (["enable_wind", *NAMES] if options.endswith("--randomize") else [])


@pytest.fixture
def own_group(monkeypatch):
    """Processes get a process group of their own, as a shell gives them one."""
    popen = functools.partial(subprocess.Popen, start_new_session=True)
    monkeypatch.setattr(harness.subprocess, "Popen", popen)


def check_nothing_is_left(group):
    """The system may need a moment to clear away who has ended."""
    for _ in range(50):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a process has been left behind")


def script_arguments(env, options=""):
    return f"--env-id harness:{env}-v0 --num-envs 4 --rollout-steps 8 {ASYNC} {options}".split()


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
@pytest.mark.parametrize(
    ("world", "mentions"),
    [("Dies", "process of an environment died"), ("DiscreteFailsLate", "at its step 40.*broke")],
)
def test_an_environment_that_fails_in_its_process_ends_in_one_line(
    world, mentions, tmp_path, own_group
):
    arguments = script_arguments(world, "--total-steps 100000 --eval-every 1 --eval-episodes 1")
    process = run("a2c_vector.py", *arguments, cwd=tmp_path, status=1)
    last = process.err.splitlines()[-1]
    assert last.startswith("error: ")
    assert re.search(mentions, last)
    assert list(tmp_path.glob("runs/*/seed-1/checkpoint.pt"))  # of the updates before
    check_nothing_is_left(process.pid)


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
def test_ctrl_c_of_a_terminal_reaches_all_processes_and_ends_in_order(tmp_path, own_group):
    """A terminal sends it to the whole group, of which all but the first leave it alone."""
    options = "--total-steps 10000000 --eval-every 0"
    process = start("a2c_vector.py", *script_arguments("DiscreteThreeSteps", options), cwd=tmp_path)
    deadline = time.monotonic() + 60
    metrics = []
    while not metrics:
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.05)
        with contextlib.suppress(ValueError, OSError):
            metrics = list((run_folder(tmp_path) / "seed-1").glob("metrics.csv"))
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert "KeyboardInterrupt" not in err
    folder = run_folder(tmp_path) / "seed-1"
    steps = pd.read_csv(folder / "metrics.csv")["env_step"]
    assert steps.tolist() == [32 * (i + 1) for i in range(len(steps))]
    assert read_json(folder / "summary.json")["env_steps"] == steps.iloc[-1] < 10_000_000
    assert str((folder / "checkpoint.pt").relative_to(tmp_path)) in out
    assert (folder.parent / "learning_curve.png").exists()
    check_nothing_is_left(process.pid)


# --- Playing --------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window opens")
def test_playing_without_a_display_ends_in_one_clear_line(tmp_path, monkeypatch, capsys):
    for name in "DISPLAY", "WAYLAND_DISPLAY":
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["a2c_vector.py", "--play"])
    with pytest.raises(SystemExit) as end:
        a2c.main()
    assert re.fullmatch("error: .*--play.*display.*", end.value.code)  # printed, with status 1
    assert capsys.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("options", ["--env-id CartPole-v1", "", "--randomize"])
def test_playing_maps_a_key_to_each_action_and_prints_every_return(options, monkeypatch, capsys):
    returns = []

    def fake_play(env, keys_to_action, callback, noop):
        assert keys_to_action == {str(i): i for i in range(env.action_space.n)}
        for _ in range(2):  # episodes
            obs, _ = env.reset(seed=None)  # as the real one does
            assert env.render().shape[-1] == 3
            rewards, ended = [], False
            while not ended:
                step = env.step(keys_to_action["0"])
                callback(obs, step[0], 0, *step[1:])
                obs, ended = step[0], step[2] or step[3]
                rewards.append(step[1])
            returns.append(f"return {sum(rewards):.1f} in {len(rewards)} steps")

    # not the real module, which would need a display
    fake = SimpleNamespace(play=fake_play)
    monkeypatch.setitem(sys.modules, "gymnasium.utils.play", fake)
    monkeypatch.setattr(gym.utils, "play", fake, raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    a2c.fly(a2c.parse_args(["--play", *options.split()]))
    assert capsys.readouterr().out.splitlines() == returns


# --- Learning -------------------------------------------------------------------------------------


def test_it_finds_the_best_action_in_each_state(tmp_path):
    options = "--total-steps 16384 --num-envs 8 --rollout-steps 32 --learning-rate 3e-3"
    parameters = train(tmp_path, "Sign", f"{options} --eval-every 0 --eval-episodes 50")
    assert read_json(tmp_path / "seed/summary.json")["eval_return_mean"] > 0.9
    args, _, _, agent = make("Sign")
    agent.load_state_dict(parameters)
    obs = np.float32([[-0.8, 0], [-0.4, 0], [0.4, 0], [0.8, 0]])
    assert agent["policy"].act(obs, deterministic=True)[1].tolist() == [1, 1, 3, 3]


def test_it_learns_to_balance_a_pole(tmp_path):
    sizes = "--total-steps 40960 --num-envs 16 --rollout-steps 16"
    train(tmp_path, "CartPole-v1", f"{sizes} --eval-every 0")
    assert read_json(tmp_path / "seed/summary.json")["eval_return_mean"] > 120
    episodes = pd.read_csv(tmp_path / "seed/episodes.csv")["return"]
    assert episodes[-20:].mean() > 4 * episodes[:20].mean()
