"""a2c_vector.py: its maths by hand, its worlds in processes, its random physics, what it learns."""

import functools
import math
import multiprocessing
import os
import signal
import sys
import time
from pathlib import Path

import gymnasium as gym
import harness  # registers the worlds
import numpy as np
import pandas as pd
import pytest
import torch
from gymnasium.spaces import Discrete
from harness import World, run, run_folder, start, table

import a2c_vector as a2c
import ppo_continuous as ppo

SIZES = "--num-envs 4 --rollout-steps 25 --total-steps 100 --num-evals 1 --eval-episodes 1"
SHORT = "--num-envs 3 --rollout-steps 64 --total-steps 576"
ASYNC = "--vectorization async"

# Python 3.12 and later warn of a fork while threads run, such as that of tqdm
may_fork = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


class BlindStart(World):
    """An episode that starts at or after its step `fault_at` shows a NaN at first."""

    def reset(self, **kwargs):
        obs, info = super().reset(**kwargs)
        blind = self.fault == "start" and self.total >= self.fault_at
        return obs * np.float32("nan" if blind else 1), info


if "DiscreteEndless-v0" not in gym.registry:
    harness.register("DiscreteEndless", length=None, actions=Discrete(3, start=1))
    harness.register("DiscreteBlindStart", BlindStart, actions=Discrete(3, start=1))


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


def parse(env, options=""):
    env_id = env if "-" in env else f"{env}-v0"
    return a2c.parse_args(f"--env-id {env_id} {SIZES} {options}".split())


def make(env="DiscreteThreeSteps", options=""):
    """Arguments, vector environment, its first observations, and an agent for it."""
    args = parse(env, options)
    envs = a2c.make_envs(args)
    obs, _ = envs.reset(seed=a2c.make_seeds(1, stream=2, count=args.num_envs))
    agent = a2c.Agent(envs.single_observation_space, envs.single_action_space, args)
    # a new policy finds all actions alike, which would hide mistakes
    agent.actor[-1].weight.data *= 300
    agent.norm.update(torch.randn(50, *agent.norm.mean.shape))
    return args, envs, obs, agent


def play(env="DiscreteThreeSteps", options=""):
    """One rollout: arguments, agent, transitions."""
    args, envs, obs, agent = make(env, options)
    batch, _, _ = a2c.rollout(envs, agent, obs, args.rollout_steps, 0)
    return args, agent, batch


def gae_inputs(batch):
    return batch["rewards"], batch["terminated"], batch["done"]


def optimise(args, agent, batch):
    """The metrics of an update that leaves the agent as it is, except for its gradients."""
    return a2c.optimise(agent, torch.optim.SGD(agent.parameters(), lr=0.0), batch, args)


def train(path, env, options="", seed=1):
    """Train into `path`: the parameters and statistics at the end."""
    path.mkdir(exist_ok=True)
    a2c.run(parse(env, options), seed, path / "seed")
    return torch.load(path / "seed/checkpoint.pt", weights_only=True)["agent"]


def read(path, name):
    return table(path / f"seed/{name}.csv")


def check_same(some, others):
    assert some.keys() == others.keys()
    assert all(torch.equal(x, others[name]) for name, x in some.items())


# --- Advantages -----------------------------------------------------------------------------------


def test_the_last_row_of_a_rollout_and_a_rollout_of_one_step_learn():
    for T in 1, 6:
        args, agent, batch = play(options=f"--rollout-steps {T} --num-envs 16")
        rewards, terminated, done = gae_inputs(batch)
        with torch.no_grad():
            values, next_values = agent.value(batch["obs"]), agent.value(batch["next_obs"])
        advantages = a2c.compute_gae(
            rewards, values, next_values, terminated, done, args.gamma, args.gae_lambda)
        delta = rewards + args.gamma * next_values * (1 - terminated) - values
        assert terminated[-1].all() == (T == 6)
        torch.testing.assert_close(advantages[-1], delta[-1])


@pytest.mark.parametrize("world", ["DiscreteThreeSteps", "DiscreteForever"])
def test_nothing_of_the_next_episode_reaches_an_episode(world):
    """Though it ended by its time limit, and though the next one began within the same step."""
    _, _, batch = play(world)
    rewards, terminated, done = gae_inputs(batch)
    end = done[:, 0].nonzero()[0].item()
    assert done[end].all()
    values, next_values = torch.randn(2, *rewards.shape)
    before = a2c.compute_gae(rewards, values, next_values, terminated, done, 0.9, 0.8)
    for x in rewards, values, next_values:
        x[end + 1 :] += 100
    if world == "DiscreteThreeSteps":
        next_values[end] += 100
    after = a2c.compute_gae(rewards, values, next_values, terminated, done, 0.9, 0.8)
    assert torch.equal(before[: end + 1], after[: end + 1])


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits(tmp_path):
    options = "--gamma 0.9 --total-steps 12800 --num-envs 8 --rollout-steps 8"
    options += " --critic-learning-rate 1e-2 --reward-scale 0.5"
    args, _, _, agent = make("Timeless", options)
    agent.load_state_dict(train(tmp_path, "Timeless", options))
    obs = torch.tensor([[episode, 0.0] for episode in (-0.8, 0.0, 0.8)])
    raw_values = agent.value(obs) / args.reward_scale
    assert (raw_values - 10).abs().max() < 1, raw_values  # blind to the limit: at most 5.7


# --- Losses and their gradients -------------------------------------------------------------------


def test_losses_by_hand():
    log_probs, advantages = torch.tensor([-1.0, -0.5, -2.0]), torch.tensor([2.0, -4.0, 1.0])
    assert a2c.policy_loss(log_probs, advantages).item() == pytest.approx(-(-2 + 2 - 2) / 3)
    values, targets = torch.tensor([1.0, 2.0, 0.0]), torch.tensor([3.0, 1.0, 0.0])
    assert a2c.value_loss(values, targets).item() == pytest.approx((4 + 1 + 0) / 3 / 2)


def gradients_by_hand(args, agent, batch):
    """Of the loss that the docstring of a2c_vector.py states, from the definitions."""
    rewards, terminated, done = gae_inputs(batch)
    states, next_states = agent.norm(batch["obs"]), agent.norm(batch["next_obs"])
    values = agent.critic(states).squeeze(-1)
    V, next_V = values.tolist(), agent.critic(next_states).squeeze(-1).tolist()  # constants
    T, N = rewards.shape
    advantages = torch.zeros(T, N)
    for n in range(N):
        for t in range(T):
            for k in range(t, T):
                goes_on = not terminated[k, n]
                delta = rewards[k, n] + args.gamma * goes_on * next_V[k][n] - V[k][n]
                advantages[t, n] += (args.gamma * args.gae_lambda) ** (k - t) * delta
                if done[k, n]:
                    break
    targets = advantages + torch.tensor(V)
    advantages = (advantages - advantages.mean()) / advantages.std(correction=0)
    probs = agent.actor(states).softmax(-1)
    log_pi = probs.gather(-1, batch["samples"].long().unsqueeze(-1)).squeeze(-1).log()
    entropy = -(probs * probs.log()).sum(-1).mean()
    loss_pi = -(advantages * log_pi).mean() - args.entropy_coef * entropy
    loss_v = (values - targets).square().mean() / 2
    return [*torch.autograd.grad(loss_pi, list(agent.actor.parameters())),
            *torch.autograd.grad(loss_v, list(agent.critic.parameters()))]


@pytest.mark.parametrize("rollout_steps", [1, 25])
@pytest.mark.parametrize("world", ["DiscreteThreeSteps", "DiscreteForever"])
def test_an_update_follows_the_gradient_written_out(world, rollout_steps):
    """In particular, none goes through a bootstrap value, a target or an advantage."""
    options = f"--rollout-steps {rollout_steps} --max-grad-norm 1e9"
    options += " --gamma 0.9 --gae-lambda 0.7 --entropy-coef 0.3"
    args, agent, batch = play(world, options)
    batch["rewards"] = torch.randn_like(batch["rewards"])
    expected = gradients_by_hand(args, agent, batch)
    parameters = [*agent.actor.parameters(), *agent.critic.parameters()]
    assert len(parameters) == len(expected) == len(list(agent.parameters()))
    for parameter in parameters:
        parameter.grad = torch.ones_like(parameter)  # of an update before, say
    optimise(args, agent, batch)
    for parameter, gradient in zip(parameters, expected):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-6)


def test_each_loss_reaches_its_own_network_only():
    _, agent, batch = play()
    log_probs = agent.policy(batch["obs"]).log_prob(batch["samples"])
    losses = {"actor": a2c.policy_loss(log_probs, batch["rewards"]),
              "critic": a2c.value_loss(agent.value(batch["obs"]), batch["rewards"])}
    for name, loss in losses.items():
        agent.zero_grad(set_to_none=True)
        loss.backward()
        reached = {key.split(".")[0] for key, p in agent.named_parameters() if p.grad is not None}
        assert reached == {name}


def test_the_loss_of_ppo_starts_with_the_gradient_of_a2c():
    """What links the files: as long as its ratio is 1, PPO's step is A2C's."""
    _, agent, batch = play()
    log_probs = agent.policy(batch["obs"]).log_prob(batch["samples"]).flatten()
    advantages, parameters = torch.randn(len(log_probs)), list(agent.actor.parameters())
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
        args, agent, batch = play(options=f"--max-grad-norm {limit}")
        metrics = optimise(args, agent, batch)
        logged.append([metrics["gradient_norm"], metrics["critic_gradient_norm"]])
        for network in agent.actor, agent.critic:
            kept.append(torch.cat([p.grad.flatten() for p in network.parameters()]).norm().item())
    assert logged[0] == logged[1] == pytest.approx(kept[:2])
    assert min(kept[:2]) > 2e-3
    assert kept[2:] == pytest.approx([1e-3, 1e-3], rel=1e-2)


def test_the_logged_numbers_are_those_of_the_rollout():
    args, agent, batch = play(options="--gae-lambda 1 --gamma 0.9")
    with torch.no_grad():
        policy, values = agent.policy(batch["obs"]), agent.value(batch["obs"])
    metrics = optimise(args, agent, batch)
    # λ = 1: R of the steps of whole episodes is the discounted sum of their rewards, 1 each
    R = torch.tensor([1 + 0.9 + 0.81, 1 + 0.9, 1] * 8 + [0]).unsqueeze(-1).repeat(1, 4)
    with torch.no_grad():
        R[-1] = 1 + 0.9 * agent.value(batch["next_obs"][-1])
    assert metrics["value_loss"] == pytest.approx((values - R).square().mean().item() / 2, rel=1e-4)
    explained = 1 - (R - values).var() / R.var()
    assert metrics["explained_variance"] == pytest.approx(explained.item(), rel=1e-3)
    assert metrics["entropy"] == pytest.approx(policy.entropy().mean().item(), rel=1e-5)
    A = (R - values - (R - values).mean()) / (R - values).std(correction=0)
    loss = -(A * policy.log_prob(batch["samples"])).mean()
    assert metrics["policy_loss"] == pytest.approx(loss.item(), rel=1e-3)


# --- Agent ----------------------------------------------------------------------------------------


def test_statistics_are_those_of_all_rows_from_the_first_call_on():
    """Also if the numbers are small, where a prior or a large floor under var would show."""
    rows = 1e-3 * torch.randn(60, 3) * torch.tensor([1.0, 2.0, 3.0]) + 0.01
    norm, end = a2c.RunningNorm((3,)), 0
    for part in rows.split([2, 28, 30]):
        norm.update(part)
        end += len(part)
        torch.testing.assert_close(norm.mean, rows[:end].mean(0), rtol=1e-5, atol=0)
        torch.testing.assert_close(norm.var, rows[:end].var(0, correction=0), rtol=1e-4, atol=0)
        assert norm.count == end
    torch.testing.assert_close(norm(rows).std(0, correction=0), torch.ones(3))
    torch.testing.assert_close(norm(rows).mean(0), torch.zeros(3), rtol=0, atol=1e-4)


def test_the_norm_takes_what_never_moves_and_outliers():
    norm = a2c.RunningNorm((2,))
    assert norm(torch.tensor([3.0, -4.0])).tolist() == [3, -4]
    norm.update(torch.tensor([[7.0, 1.0], [7.0, 3.0]]))
    assert norm(torch.tensor([[7.0, 2.0], [7.0, 1e9]])).tolist() == [[0, 0], [0, 10]]


def test_log_probabilities_and_entropy_by_hand():
    _, _, obs, agent = make()
    obs = torch.as_tensor(obs)
    p = agent.actor(agent.norm(obs)).exp()
    p = p / p.sum(-1, keepdim=True)
    policy = agent.policy(obs)
    for action in range(3):
        torch.testing.assert_close(policy.log_prob(torch.full((4,), action)), p[:, action].log())
    torch.testing.assert_close(policy.entropy(), -(p * p.log()).sum(-1))
    for parameter in agent.actor[-1].parameters():
        parameter.data.zero_()
    torch.testing.assert_close(agent.policy(obs).entropy(), torch.full((4,), math.log(3)))


def test_actor_and_critic_see_normalised_states():
    _, _, _, agent = make()
    obs = torch.randn(3, 5, 2)
    logits, values = agent.policy(obs).logits, agent.value(obs)
    assert (logits.shape, values.shape) == ((3, 5, 3), (3, 5))
    agent.norm.mean += 3
    agent.norm.var *= 4
    torch.testing.assert_close(agent.policy(2 * obs + 3 - agent.norm.mean + 3).logits, logits)


def test_the_policy_that_acts_is_the_one_that_learns():
    """Actions are as frequent as the log-probabilities say, and each environment draws its own."""
    _, _, _, agent = make()
    state = np.float32([[1, 2]])
    samples, _ = agent.act(np.repeat(state, 20_000, axis=0))
    frequencies = np.bincount(samples, minlength=3) / 20_000
    probs = agent.policy(torch.as_tensor(state[0])).probs.detach().numpy()
    assert probs.max() - probs.min() > 0.05
    np.testing.assert_allclose(frequencies, probs, atol=0.015)  # 4 standard errors


def test_the_deterministic_action_is_the_most_likely_one():
    _, _, _, agent = make()
    obs = np.float32(np.random.default_rng(0).normal(size=(200, 2), scale=3))
    samples, actions = agent.act(obs, deterministic=True)
    assert len(np.unique(samples)) > 1
    np.testing.assert_array_equal(samples, agent.policy(torch.as_tensor(obs)).probs.argmax(-1))
    np.testing.assert_array_equal(actions, samples + 1)  # this world counts from 1


def test_a_saved_agent_acts_and_learns_the_same_when_it_is_resumed(tmp_path):
    args, envs, obs, agent = make()
    batch, _, _ = a2c.rollout(envs, agent, obs, args.rollout_steps, 0)
    agents = [agent, a2c.Agent(envs.single_observation_space, envs.single_action_space, args)]
    optimizers = [torch.optim.Adam(x.parameters(), lr) for x, lr in zip(agents, (0.02, 0.01))]
    a2c.optimise(agent, optimizers[0], batch, args)
    a2c.save(args, 1, tmp_path / "seed", {"evals": [{"env_step": 300}]}, agent, optimizers[0])
    obs = np.float32(np.random.default_rng(0).normal(size=(100, 2), scale=3))
    old, new = (x.act(obs, deterministic=True)[1] for x in agents)
    assert (old != new).any()
    sampled, _ = agent.act(obs)
    assert a2c.resume(tmp_path / "seed/checkpoint.pt", agents[1], optimizers[1]) == 300
    np.testing.assert_array_equal(sampled, agents[1].act(obs)[0])  # the same noise, too
    for x, optimizer in zip(agents, optimizers):
        a2c.optimise(x, optimizer, batch, args)
    check_same(*(x.state_dict() for x in agents))


# --- Rollout --------------------------------------------------------------------------------------


@pytest.mark.parametrize("world", ["DiscreteThreeSteps", "DiscreteForever"])
def test_every_row_is_a_real_transition(world):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    args, envs, obs, agent = make(world)
    batch, last_obs, _ = a2c.rollout(envs, agent, obs, args.rollout_steps, 0)
    assert all(x.dtype == torch.float32 for x in batch.values())
    states, next_states = batch["obs"], batch["next_obs"]
    rewards, terminated, done = gae_inputs(batch)
    length = {"DiscreteThreeSteps": 3, "DiscreteForever": 8}[world]
    assert (states[0, :, 1] == 0).all()
    assert torch.equal(next_states[..., 0], states[..., 0])  # the same episode, also at its end
    assert torch.equal(next_states[..., 1], states[..., 1] + 1)
    ends = next_states[..., 1] == length
    assert torch.equal(done, ends.float())
    by_itself = world == "DiscreteThreeSteps"
    assert torch.equal(terminated, done if by_itself else torch.zeros_like(done))
    assert torch.equal(states[1:][~ends[:-1]], next_states[:-1][~ends[:-1]])
    assert (states[1:][ends[:-1]][:, 1] == 0).all()
    assert torch.equal(torch.tensor(last_obs)[~ends[-1]], next_states[-1][~ends[-1]])
    assert (rewards == 1).all()
    for env in envs.envs:  # as many rows as steps, by its own count
        assert env.unwrapped.total == len(states)


def test_a_rollout_goes_on_where_the_last_one_ended():
    _, envs, obs, agent = make()
    first, obs, _ = a2c.rollout(envs, agent, obs, 4, 0)
    second, _, _ = a2c.rollout(envs, agent, obs, 4, 16)
    assert torch.equal(first["next_obs"][-1], second["obs"][0])


def test_the_stored_action_is_the_one_that_was_executed():
    """This world shows the action that it got, counts them from 1, and refuses all others."""
    _, _, batch = play("Echo", "--rollout-steps 60 --total-steps 240")
    samples, executed = batch["samples"], batch["next_obs"][..., 0]
    assert sorted(set(samples.flatten().tolist())) == [0, 1, 2]
    assert torch.equal(samples + 1, executed)


def test_every_finished_episode_is_logged_once_with_its_raw_return_and_length():
    _, envs, obs, agent = make()
    episodes = []
    for begin in range(0, 60, 20):  # 5 steps in 4 environments at a time: some span two rollouts
        _, obs, ended = a2c.rollout(envs, agent, obs, 5, begin)
        episodes += ended
    assert episodes == [{"env_step": 4 * step, "return": 3.0, "length": 3}
                        for step in (3, 6, 9, 12, 15) for _ in range(4)]


def test_episodes_csv_holds_every_episode_of_a_run(tmp_path):
    train(tmp_path, "DiscreteForever", "--rollout-steps 5 --total-steps 320 --reward-scale 0.1")
    episodes = read(tmp_path, "episodes")
    assert episodes["env_step"].tolist() == [8 * 4 * (i + 1) for i in range(10) for _ in range(4)]
    assert (episodes["return"] == 8).all()
    assert (episodes["length"] == 8).all()


@pytest.mark.parametrize(
    ("fault", "step"),
    [("nan", 5), ("inf", 5), ("blind", 5), ("nan", 6), ("blind", 6), ("start", 6)],
)
def test_nan_and_infinity_end_a_rollout_and_name_environment_and_step(fault, step):
    """In a reward or an observation (blind), also around the end of an episode, at step 6."""
    _, envs, obs, agent = make("DiscreteBlindStart")
    _, obs, _ = a2c.rollout(envs, agent, obs, 4, 0)
    envs.envs[2].unwrapped.fault, envs.envs[2].unwrapped.fault_at = fault, step
    with pytest.raises(SystemExit) as end:
        a2c.rollout(envs, agent, obs, 20, 4 * 4)
    message = f"error: environment 2 returned NaN or infinity at its step {step}"
    assert end.value.code == message


# --- Training and evaluation ----------------------------------------------------------------------


def test_the_same_seed_gives_the_same_parameters_and_another_seed_others(tmp_path):
    first, again = (train(tmp_path / name, "CartPole-v1", SHORT) for name in ("first", "again"))
    check_same(first, again)
    other = train(tmp_path / "other", "CartPole-v1", SHORT, seed=2)
    weights = [name for name in first if name.endswith("weight")]
    assert not any(torch.equal(first[name], other[name]) for name in weights)


def test_train_yields_the_start_and_then_every_update_once():
    rows = list(a2c.train(parse("DiscreteThreeSteps", "--total-steps 250"), 1))
    env_steps, agents, optimizers, episodes, diagnostics = zip(*rows)
    assert env_steps == (0, 100, 200, 300)
    assert len(set(agents)) == len(set(optimizers)) == 1
    assert [len(x) for x in episodes] == [0, 32, 32, 36]  # of 3 steps, in 4 environments
    assert diagnostics[0] == {}
    assert all(np.isfinite(list(x.values())).all() for x in diagnostics)
    assert len({x["gradient_norm"] for x in diagnostics[1:]}) == 3


def learning_rates(args):
    """Those of actor and critic in each update, after which so many steps were made."""
    rates = {}
    for env_step, agent, optimizer, _, diagnostics in a2c.train(args, 1):
        for network, group in zip((agent.actor, agent.critic), optimizer.param_groups):
            assert {id(p) for p in group["params"]} == {id(p) for p in network.parameters()}
        if diagnostics:
            rates[env_step] = [group["lr"] for group in optimizer.param_groups]
    return rates


def test_both_learning_rates_fall_in_a_straight_line():
    options = "--learning-rate 2e-3 --critic-learning-rate 4e-3 --total-steps 390"
    rates = learning_rates(parse("DiscreteThreeSteps", options))
    assert list(rates) == [100, 200, 300, 400]  # 4 updates, the last one in full
    falling = 1 - np.array([0, 100, 200, 300]) / 390
    expected = np.stack([2e-3 * falling, 4e-3 * falling], axis=1)
    np.testing.assert_allclose(list(rates.values()), expected)


def test_a_resumed_run_goes_on_at_its_step_with_the_learning_rates_that_belong_there(tmp_path):
    train(tmp_path, "DiscreteThreeSteps", "--total-steps 200")
    options = "--learning-rate 2e-3 --critic-learning-rate 4e-3 --total-steps 400"
    args = parse("DiscreteThreeSteps", options)
    args.resume = tmp_path / "seed/checkpoint.pt"
    rates = learning_rates(args)
    assert list(rates) == [300, 400]
    np.testing.assert_allclose(list(rates.values()), [[1e-3, 2e-3], [5e-4, 1e-3]])


@pytest.mark.parametrize(
    ("option", "learns"), [("--learning-rate", "critic"), ("--critic-learning-rate", "actor")])
def test_with_one_learning_rate_0_only_the_other_network_learns(option, learns):
    updates = a2c.train(parse("DiscreteThreeSteps", f"{option} 0"), 1)
    _, agent, *_ = next(updates)
    before = {name: p.clone() for name, p in agent.named_parameters()}
    next(updates)
    changed = {name for name, p in agent.named_parameters() if not torch.equal(p, before[name])}
    assert {name.split(".")[0] for name in changed} == {learns}


def test_rewards_are_scaled_once_before_an_update_learns_from_them(monkeypatch):
    seen, compute_gae = [], a2c.compute_gae

    def spy(rewards, *rest):
        seen.append(rewards.unique().tolist())
        return compute_gae(rewards, *rest)

    monkeypatch.setattr(a2c, "compute_gae", spy)
    args = parse("DiscreteThreeSteps", "--reward-scale 0.25 --total-steps 200")
    *_, (_, _, _, episodes, _) = a2c.train(args, 1)
    assert seen == [[0.25], [0.25]]
    assert {row["return"] for row in episodes} == {3}  # the raw ones


def test_the_agent_that_learns_from_a_rollout_is_the_one_that_played_it(tmp_path, monkeypatch):
    """Also its statistics: they change after the update, or π(a|s) would not be what acted."""
    played, rows, rollout, optimise = [], [], a2c.rollout, a2c.optimise

    def spy(envs, agent, *rest):
        played.append({name: x.clone() for name, x in agent.state_dict().items()})
        result = rollout(envs, agent, *rest)
        rows.append(result[0]["obs"].flatten(0, 1))
        return result

    def check(agent, *rest):
        check_same(agent.state_dict(), played[-1])
        return optimise(agent, *rest)

    monkeypatch.setattr(a2c, "rollout", spy)
    monkeypatch.setattr(a2c, "optimise", check)
    last = train(tmp_path, "DiscreteThreeSteps", "--total-steps 300")
    assert [x["norm.count"].item() for x in [*played, last]] == [0, 100, 200, 300]
    torch.testing.assert_close(last["norm.mean"], torch.cat(rows).mean(0))
    torch.testing.assert_close(last["norm.var"], torch.cat(rows).var(0, correction=0))


def test_the_first_evaluation_comes_before_training_the_others_evenly(tmp_path):
    train(tmp_path, "DiscreteThreeSteps", "--total-steps 600 --num-evals 3 --eval-episodes 2")
    evals = read(tmp_path, "evals")
    assert evals["env_step"].tolist() == [0, 200, 400, 600]
    assert evals.columns[1:].tolist() == ["return_mean", "return_std", "length_mean", "episodes"]
    assert (evals.iloc[:, 1:] == [3, 0, 3, 2]).all(axis=None)


def test_evaluation_keeps_to_the_registered_time_limit(tmp_path):
    train(tmp_path, "DiscreteForever", "--eval-episodes 2")
    evals = read(tmp_path, "evals")[["return_mean", "length_mean", "episodes"]]
    assert evals.values.tolist() == [[8, 8, 2]] * 2


def test_evaluation_keeps_to_the_usual_physics_while_training_does_not(tmp_path, monkeypatch):
    trained, evaluated, rollout, evaluate = [], [], a2c.rollout, a2c.evaluate

    def spy_rollout(envs, *rest):
        trained.extend(envs.envs)
        return rollout(envs, *rest)

    def spy_evaluate(agent, envs, seed):
        result = evaluate(agent, envs, seed)
        evaluated.extend(map(physics_in_force, envs))
        return result

    monkeypatch.setattr(a2c, "rollout", spy_rollout)
    monkeypatch.setattr(a2c, "evaluate", spy_evaluate)
    train(tmp_path, "LunarLander-v3", "--randomize --eval-episodes 2")
    assert evaluated == [usual_physics()] * 2 * 2
    assert len(trained) == 4
    assert not any(physics_in_force(env) == usual_physics() for env in trained)


def test_an_evaluation_plays_the_likeliest_actions_whatever_the_noise():
    """The same as one episode after the other by hand; each seed is another episode."""
    _, _, _, agent = make("CartPole-v1")
    agent.actor = torch.nn.Linear(4, 2)
    agent.actor.weight.data = torch.tensor([[0.0, 0, 0, 0], [0, 0, 1, 0]])  # follows the pole
    envs = [a2c.record_episodes(gym.make("CartPole-v1")) for _ in range(5)]
    results = []
    for seed in 1, 0, 0:  # so the environments have been used before
        torch.manual_seed(len(results))
        results.append(a2c.evaluate(agent, envs, seed))
    returns = []
    env = gym.make("CartPole-v1")
    for seed in a2c.make_seeds(0, stream=1, count=5):
        obs, _ = env.reset(seed=seed)
        ended, total = False, 0
        while not ended:
            probs = agent.policy(torch.as_tensor(obs)).probs
            obs, reward, terminated, truncated, _ = env.step(probs.argmax().item())
            ended, total = terminated or truncated, total + reward
        returns.append(total)
    assert len(set(returns)) > 1
    expected = {"return_mean": np.mean(returns), "return_std": np.std(returns),
                "length_mean": np.mean(returns), "episodes": 5}
    assert results[1] == results[2] == pytest.approx(expected)
    assert results[0] != results[1]


def test_an_episode_without_a_time_limit_is_cut_off_after_10_000_steps():
    args, envs, obs, agent = make("DiscreteEndless", "--num-envs 1")
    env = a2c.record_episodes(gym.make(args.env_id))
    assert a2c.evaluate(agent, [env], 1)["length_mean"] == 10_000
    batch, _, episodes = a2c.rollout(envs, agent, obs, 10_001, 0)
    assert episodes == [{"env_step": 10_000, "return": 10_000, "length": 10_000}]
    assert batch["done"].flatten().nonzero().tolist() == [[9_999]]
    assert not batch["terminated"].any()


# --- Random physics -------------------------------------------------------------------------------

NAMES = "gravity", "wind_power", "turbulence_power"


def random_lander():
    return a2c.RandomPhysics(gym.make("LunarLander-v3"))


def physics_in_force(env):
    env = env.unwrapped
    assert env.world.gravity[1] == pytest.approx(env.gravity)
    return {name: getattr(env, name) for name in ("enable_wind", *NAMES)}


@functools.cache
def usual_physics():
    env = gym.make("LunarLander-v3")
    env.reset()
    return physics_in_force(env)


def test_physics_fill_their_ranges():
    env, drawn = random_lander(), []
    for episode in range(300):
        env.reset(seed=None if episode else 0)
        drawn.append(physics_in_force(env))
    drawn = pd.DataFrame(drawn)
    for name, low, high in zip(NAMES, (-11.99, 0, 0), (-7, 20, 2)):
        margin = 0.05 * (high - low)
        assert low <= drawn[name].min() < low + margin
        assert high >= drawn[name].max() > high - margin
        assert drawn[name].nunique() == 300
    assert 0.4 < drawn["enable_wind"].mean() < 0.6
    assert drawn.astype(float).corr().abs().sum().max() < 1.5  # drawn one by one


def test_physics_have_nothing_to_do_with_the_ground():
    env, drawn = random_lander(), []
    for seed in range(200):
        env.reset(seed=seed)
        ground = [corners[0][1] for corners in env.unwrapped.sky_polys]
        drawn.append([*physics_in_force(env).values(), ground[0], ground[2]])
    correlations = np.corrcoef(np.transpose(drawn))[:4, 4:]
    assert np.abs(correlations).max() < 0.25


def test_physics_do_not_change_what_else_an_environment_draws():
    """A lander that is given the same physics by hand shows the same, episode after episode."""
    env, other = random_lander(), gym.make("LunarLander-v3")
    winds = set()
    for seed in 3, None, None, 4, None, None:
        obs, _ = env.reset(seed=seed)
        for name, value in physics_in_force(env).items():
            setattr(other.unwrapped, name, value)
        winds.add(env.unwrapped.enable_wind)
        np.testing.assert_array_equal(obs, other.reset(seed=seed)[0])
        for t in range(40):
            one, two = env.step(t % 4), other.step(t % 4)
            np.testing.assert_array_equal(one[0], two[0])
            assert one[1:] == two[1:]
    assert winds == {True, False}


def test_without_randomize_the_physics_are_the_registered_ones():
    _, envs, _, _ = make("LunarLander-v3")
    for _ in range(3):
        assert all(physics_in_force(env) == usual_physics() for env in envs.envs)
        envs.reset()


def test_the_same_seed_gives_a_used_environment_the_same_episodes():
    """The same physics, the same ground, in the first episodes as in those that follow."""
    args, _, _, agent = make("LunarLander-v3", "--randomize")
    envs = a2c.make_envs(args, a2c.RandomPhysics)
    played = []
    for seed in 1, 1, 2:
        torch.manual_seed(0)
        obs, _ = envs.reset(seed=[seed, seed + 10, seed + 20, seed + 30])
        batch, _, episodes = a2c.rollout(envs, agent, obs, 300, 0)
        assert len(episodes) > 4
        played.append(batch)
    check_same(played[0], played[1])
    assert not torch.equal(played[0]["next_obs"], played[2]["next_obs"])


def draw_physics(vectorization):
    """What two environments draw for two episodes, for the seeds 1, 2 and 1 again."""
    options = ["--num-envs", "2", "--vectorization", vectorization]
    envs, drawn = a2c.make_envs(a2c.parse_args(options), a2c.RandomPhysics), []
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


@may_fork
@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_processes_draw_the_same_physics_however_they_were_started(method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {method} here")
    usual = multiprocessing.get_start_method(allow_none=True)
    multiprocessing.set_start_method(method, force=True)
    try:
        drawn = draw_physics("async")
    finally:
        multiprocessing.set_start_method(usual, force=True)
    assert drawn == draw_physics("sync")


# --- Processes ------------------------------------------------------------------------------------


@may_fork
@pytest.mark.parametrize("env", ["CartPole-v1", "LunarLander-v3 --randomize"])
def test_environments_in_processes_change_no_number(env, tmp_path):
    env, *options = env.split(" ", 1)
    options = " ".join([SHORT, *options])
    sync = train(tmp_path / "sync", env, options)
    check_same(sync, train(tmp_path / "async", env, f"{options} {ASYNC}"))
    for name in "episodes", "metrics", "evals":
        tables = [read(tmp_path / kind, name) for kind in ("sync", "async")]
        assert len(tables[0]) > 0
        pd.testing.assert_frame_equal(*tables, check_exact=True)


def check_nothing_is_left(group):
    """The system may need a moment to clear away who has ended."""
    for _ in range(50):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a process has been left behind")


def script_arguments(env, *options):
    return ["--env-id", f"harness:{env}-v0", *f"{SIZES} --rollout-steps 8".split(), *options]


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
@pytest.mark.parametrize("world", ["DiscreteFailsLate", "Dies"])
def test_an_environment_that_fails_in_its_process_leaves_none_behind(world, tmp_path):
    """What it raised is shown with file and line, and what was saved before is kept."""
    arguments = script_arguments(world, *ASYNC.split(), "--total-steps", 100_000)
    process = run("a2c_vector.py", *arguments, cwd=tmp_path, status=1, own_group=True)
    check_nothing_is_left(process.pid)
    (checkpoint,) = tmp_path.glob("runs/*/seed-1/checkpoint.pt")
    assert str(checkpoint.relative_to(tmp_path)) in process.out
    if world == "DiscreteFailsLate":
        source = Path(harness.__file__).read_text().splitlines()
        (line,) = (i for i, text in enumerate(source, 1) if "the pole broke" in text)
        assert f'harness.py", line {line}, in step' in process.err
        assert process.err.rstrip().endswith("RuntimeError: the pole broke")


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
def test_ctrl_c_of_a_terminal_reaches_all_processes_and_ends_in_order(tmp_path):
    """A terminal sends it to the whole group. Only the evaluation before training is left."""
    options = ASYNC.split() + ["--total-steps", 10_000_000]
    arguments = script_arguments("DiscreteThreeSteps", *options)
    process = start("a2c_vector.py", *arguments, cwd=tmp_path, own_group=True)
    deadline = time.monotonic() + 60
    while not (saved := list(tmp_path.glob("runs/*/seed-1/checkpoint.pt"))):
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.05)
    time.sleep(0.5)  # it trains now
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    check_nothing_is_left(process.pid)
    folder = run_folder(tmp_path)
    assert pd.read_csv(folder / "seed-1/evals.csv")["env_step"].tolist() == [0]
    assert torch.load(saved[0], weights_only=True)["agent"]["norm.count"] == 0
    assert str(saved[0].relative_to(tmp_path)) in out
    assert "--resume" in out
    assert "drawing" not in out  # there is nothing to draw yet
    assert {x.name for x in folder.iterdir()} == {"args.json", "seed-1"}


# --- Learning -------------------------------------------------------------------------------------


def test_it_finds_the_best_action_in_each_state(tmp_path):
    options = "--total-steps 16384 --num-envs 8 --rollout-steps 32 --learning-rate 3e-3"
    parameters = train(tmp_path, "Sign", f"{options} --eval-episodes 50")
    evals = read(tmp_path, "evals")["return_mean"]
    assert evals.iloc[0] < 0.8
    assert evals.iloc[-1] > 0.9
    _, _, _, agent = make("Sign")
    agent.load_state_dict(parameters)
    obs = np.float32([[-0.8, 0], [-0.4, 0], [0.4, 0], [0.8, 0]])
    assert agent.act(obs, deterministic=True)[1].tolist() == [1, 1, 3, 3]


def test_it_learns_to_balance_a_pole(tmp_path):
    sizes = "--total-steps 40960 --num-envs 16 --rollout-steps 16"
    train(tmp_path, "CartPole-v1", f"{sizes} --eval-episodes 20")
    assert read(tmp_path, "evals")["return_mean"].iloc[-1] > 120
    episodes = read(tmp_path, "episodes")["return"]
    assert episodes[-20:].mean() > 4 * episodes[:20].mean()
