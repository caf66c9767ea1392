"""PPO: its losses by hand, its updates gradient by gradient, its actions, its values."""

import copy
import math

import gymnasium as gym
import numpy as np
import pytest
import torch
from conftest import SCRIPTS
from harness import ACTIONS, spy, spy_rollouts, train
from test_gae import gae_by_hand
from torch.distributions import Normal, kl_divergence

import ppo_continuous as ppo

SIZES = ["--num-envs", 4, "--rollout-steps", 25, "--minibatch-size", 34, "--total-steps", 100,
         "--max-kl", 1e9]


def make(world="ThreeSteps"):
    """An agent with larger weights and some statistics.

    A new one acts alike in all states and does not normalise, which would hide mistakes.
    """
    agent = ppo.Agent(SCRIPTS["ppo_continuous"].envs(f"harness:{world}-v0", 1), 64)
    agent.actor[-1].weight.data *= 100
    agent.obs_stats.update(3 * torch.randn(50, 2) + 1)
    agent.sigma.fill_(0.6)
    return agent


def make_samples(agent):
    """100 rows: states, actions drawn from π, their log-probabilities, A and targets random."""
    obs, (A, targets) = 3 * torch.randn(100, 2) + 1, torch.randn(2, 100)
    policy = agent.policy(obs)
    actions = policy.sample()
    return obs, actions, policy.log_prob(actions).detach(), A, targets


def optimise(agent, samples, lr, epochs=2, size=34, clip_eps=0.2, max_kl=1e9):
    """A list of (observations, agent before the step, gradients) of each gradient step; metrics."""
    optimizer, steps, shown, policy = torch.optim.SGD(agent.parameters(), lr), [], [], agent.policy

    def look(obs):
        shown.append(obs)
        return policy(obs)

    def keep(*_):
        gradients = [p.grad.clone() for p in agent.parameters()]
        steps.append((shown[-1], copy.deepcopy(agent), gradients))

    agent.policy = look
    optimizer.register_step_pre_hook(keep)
    metrics = ppo.optimise(agent, optimizer, samples, epochs, size, clip_eps, max_kl)
    return steps, metrics


def find_rows(samples, obs):
    """Which rows these observations are: no two look alike."""
    rows = samples[0].tolist()
    return [rows.index(x) for x in obs.tolist()]


def test_the_ratio_stays_1_while_the_policy_does(monkeypatch):
    """At learning rate 0, with the environments' own bounds far narrower than σ."""
    ratios = spy(monkeypatch, ppo, "policy_loss", lambda ratio, *_: ratio.detach())
    log = train(monkeypatch, ppo, "--env-id", "harness:Uneven-v0", *SIZES, "--first-std", 7.4,
                "--epochs", 3, "--learning-rate", 0)
    assert len(torch.cat(ratios)) == 300
    assert (torch.cat(ratios) - 1).abs().max() < 1e-5
    assert log["clip_fraction"].iloc[-1] == 0
    assert log["kl"].iloc[-1] < 1e-6


def test_the_density_that_acted_is_the_one_that_learns(monkeypatch):
    """The stored actions were drawn from N(μ(s), σ²), before squashing, each with its own noise."""
    rollouts = spy_rollouts(monkeypatch, ppo)
    train(monkeypatch, ppo, "--env-id", "harness:Uneven-v0", *SIZES, "--first-std", 2.7)
    player, batch, _ = rollouts[0]
    noise = (batch.actions - player.actor(player.obs_stats.normalise(batch.obs))) / 2.7
    assert abs(noise.mean()) < 0.3
    assert abs(noise.std() - 1) < 0.2
    assert len(noise.unique()) == 200


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_tanh_takes_actions_to_the_bounds_and_never_beyond(dtype):
    space = gym.spaces.Box(ACTIONS.low.astype(dtype), ACTIONS.high.astype(dtype), dtype=dtype)
    half = math.atanh(0.5)
    actions = np.float32([[-10, -10], [10, 10], [0, 0], [half, -half]])
    squashed = ppo.squash(actions, space)
    np.testing.assert_allclose(squashed, [[-1, 0], [3, 0.5], [1, 0.25], [2, 0.125]], rtol=1e-3)
    for low, high in (-0.2, 0.4), (-0.1, 0.7), (1e-3, 3e-3), (-4e4, 4e4), (100, 101):
        space = gym.spaces.Box(low, high, (1,), dtype)
        for x in np.linspace(-20, 20, 401, dtype=np.float32):
            assert space.contains(ppo.squash(np.array([x]), space))


def test_policy_loss_by_hand_and_no_gradient_where_it_is_clipped():
    ratio = torch.tensor([0.5, 1.5, 0.5, 1.5, 1.1], requires_grad=True)
    advantages = torch.tensor([1.0, 1.0, -1.0, -1.0, 2.0])
    loss = ppo.policy_loss(ratio, advantages, 0.2)
    assert loss.item() == pytest.approx(-(0.5 + 1.2 - 0.8 - 1.5 + 2.2) / 5)
    loss.backward()
    torch.testing.assert_close(ratio.grad, -torch.tensor([1.0, 0.0, 0.0, -1.0, 2.0]) / 5)


def test_approximate_kl_is_never_negative_and_estimates_the_kl_divergence():
    assert all(ppo.approximate_kl(x) >= -1e-7 for x in torch.linspace(-20, 20, 4001))  # rounding
    old, new = Normal(torch.zeros(2), torch.ones(2)), Normal(torch.tensor([0.1, 0.2]), 0.9)
    u = old.sample((100_000,))
    log_ratio = (new.log_prob(u) - old.log_prob(u)).sum(-1)
    estimate, exact = ppo.approximate_kl(log_ratio), kl_divergence(old, new).sum()
    standard_error = (log_ratio.exp() - 1 - log_ratio).std() / math.sqrt(len(log_ratio))
    assert abs(estimate - exact) < 4 * standard_error
    assert ppo.approximate_kl(torch.tensor(1e-4)).item() == pytest.approx(5e-9, rel=0.01)


@pytest.mark.parametrize("size", [34, 100])
def test_each_step_of_an_update_follows_the_gradient_written_out(size):
    """Its first step, at ratio 1, and later ones, of a policy and a critic that have moved."""
    agent = make()
    samples, old = make_samples(agent), copy.deepcopy(agent)
    steps, metrics = optimise(agent, samples, lr=0.02, size=size, clip_eps=0.1)
    assert len(steps) == math.ceil(200 / size)
    for obs, before, gradients in steps:
        rows = find_rows(samples, obs)
        _, actions, _, A, targets = (x[rows] for x in samples)
        A = (A - A.mean()) / (A - A.mean()).square().mean().sqrt()
        pi, pi_old = (Normal(x.actor(x.obs_stats.normalise(obs)), 0.6) for x in (before, old))
        ratio = (pi.log_prob(actions) - pi_old.log_prob(actions).detach()).sum(-1).exp()
        surrogate = [min(x * a, min(max(x, 0.9), 1.1) * a) for x, a in zip(ratio, A)]
        loss = -sum(surrogate) / len(rows)
        for value, target in zip(before.critic(before.obs_stats.normalise(obs))[:, 0], targets):
            loss += (value - target) ** 2 / 2 / len(rows)
        expected = torch.autograd.grad(loss, list(before.parameters()))
        for gradient, by_hand in zip(gradients, expected):
            torch.testing.assert_close(gradient, by_hand, rtol=1e-3, atol=1e-5)
    clipped = ((ratio < 0.9) | (ratio > 1.1)).float().mean().item()
    assert 0.1 < clipped < 0.9
    assert metrics["clip_fraction"] == pytest.approx(clipped)
    assert metrics["kl"] == pytest.approx((ratio - 1 - ratio.log()).mean().item(), rel=1e-3)


@pytest.mark.parametrize("world", ["Uneven", "Forever"])
def test_an_update_gets_the_estimates_of_the_agent_that_played(world, monkeypatch):
    """Advantages, targets and log π_old, from the definitions, as constants, in each update."""
    rollouts = spy_rollouts(monkeypatch, ppo, lambda _, batch: (
        batch._replace(rewards=torch.randn(batch.rewards.shape))))
    monkeypatch.setattr(ppo, "scale_rewards", lambda rewards, done, *_: (3 * rewards, None))
    seen = spy(monkeypatch, ppo, "optimise", lambda *x: (copy.deepcopy(x[0]), *x[2]))
    train(monkeypatch, ppo, "--env-id", f"harness:{world}-v0", *SIZES, "--total-steps", 300,
          "--gamma", 0.9, "--gae-lambda", 0.7)
    assert [player.obs_stats.count for player, *_ in rollouts] == [0, 100, 200]
    for (player, batch, _), (learner, *samples) in zip(rollouts, seen, strict=True):
        torch.testing.assert_close(player.state_dict(), learner.state_dict(), rtol=0, atol=0)
        with torch.no_grad():
            V, next_V = player.value(batch.obs), player.value(batch.next_obs)
            log_probs = player.policy(batch.obs).log_prob(batch.actions)
        ends = batch.terminated, batch.done
        A = gae_by_hand(3 * batch.rewards, V, next_V, *ends, 0.9, 0.7)
        expected = batch.obs, batch.actions, log_probs, A, A + V
        for x, y in zip(samples, expected):
            assert not x.requires_grad
            torch.testing.assert_close(x, y.flatten(0, 1), rtol=1e-4, atol=1e-4)
    agent = rollouts[-1][2]
    rows = torch.cat([batch.obs.flatten(0, 1) for _, batch, _ in rollouts]).double()
    torch.testing.assert_close(agent.obs_stats.mean, rows.mean(0))
    torch.testing.assert_close(agent.obs_stats.var, rows.var(0, correction=0))
    for (_, batch, _), (_, then, _) in zip(rollouts, rollouts[1:]):  # goes on where it ended
        goes_on = ~batch.done[-1]
        assert goes_on.any()
        assert torch.equal(then.obs[0][goes_on], batch.next_obs[-1][goes_on])


@pytest.mark.parametrize(("size", "steps"), [(2, 150), (33, 10), (51, 6), (1000, 1)])
def test_each_sample_is_used_once_an_epoch_and_parameters_stay_finite(size, steps):
    """Also where a minibatch is of a single row, in which A becomes 0."""
    agent = make()
    samples = make_samples(agent)
    seen, _ = optimise(agent, samples, lr=1e-3, epochs=3, size=size)
    assert len(seen) == steps
    order = np.reshape(find_rows(samples, torch.cat([obs for obs, *_ in seen])), (3, 100))
    assert (np.sort(order) == np.arange(100)).all()
    assert len(np.unique(order, axis=0)) == 3
    assert all(p.isfinite().all() for p in agent.parameters())


def test_a_kl_above_max_kl_ends_all_epochs_before_the_next_step(monkeypatch):
    agent = make()
    kls = spy(monkeypatch, ppo, "approximate_kl", lambda x: (x.exp() - 1 - x).mean().item())
    steps, metrics = optimise(agent, make_samples(agent), lr=0.003, epochs=20, max_kl=0.01)
    assert 3 < len(kls) < 57  # not even in the last epoch
    assert kls[-1] > 0.01 >= max(kls[:-1])
    assert len(steps) == len(kls) - 1
    assert metrics["kl"] == pytest.approx(kls[-1], rel=1e-3)


def test_training_learns_from_scaled_rewards_and_episodes_span_rollouts(monkeypatch):
    """Reward 1: F is 1, 1 + γ, 1 + γ + γ², …, and 1 again after the time limit of 8 steps."""
    seen = spy(monkeypatch, ppo, "compute_gae", lambda rewards, *_: rewards)
    train(monkeypatch, ppo, "--env-id", "harness:Forever-v0", *SIZES, "--gamma", 0.8,
          "--total-steps", 300)
    assert len(seen) == 3
    for i, rewards in enumerate(seen):
        F = [sum(0.8**k for k in range(t % 8 + 1)) for t in range(25 * (i + 1))]
        np.testing.assert_allclose(rewards, 1 / np.std(F), rtol=1e-5)


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits(monkeypatch):
    scales = spy(monkeypatch, ppo, "compute_gae", lambda rewards, *_: rewards[0, 0].item())
    rollouts = spy_rollouts(monkeypatch, ppo)
    train(monkeypatch, ppo, "--env-id", "harness:Timeless-v0", *SIZES, "--gamma", 0.9,
          "--learning-rate", 1e-2, "--rollout-steps", 16, "--minibatch-size", 64,
          "--total-steps", 1920)
    obs = torch.tensor([[-0.8, 0.0], [0.0, 0.0], [0.8, 0.0]])
    raw_values = rollouts[-1][2].value(obs) / scales[-1]
    assert (raw_values - 10).abs().max() < 0.5, raw_values  # blind to the limit: at most 5.7
