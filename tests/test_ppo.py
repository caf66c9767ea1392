"""PPO: its losses by hand, its updates gradient by gradient, its actions, its rewards."""

import copy
import math

import gymnasium as gym
import numpy as np
import pytest
import torch
from conftest import SCRIPTS
from harness import ACTIONS, spy
from torch.distributions import Normal, kl_divergence

import ppo_continuous as ppo

SIGMA = torch.tensor([0.6, 0.3])


def make(shift=0.0, count=100):
    """An agent with larger weights and some statistics, and samples: states, actions, A, targets.

    (A new agent acts alike in all states and does not normalise, which would hide mistakes.) The
    actions are drawn from a π_old, which is π with its μ moved.
    """
    agent = SCRIPTS["ppo_continuous"].agent("ThreeSteps")
    agent.actor[-1].weight.data *= 100
    agent.obs_stats.update(3 * torch.randn(50, 2) + 1)
    agent.sigma.copy_(SIGMA)
    obs, (A, targets) = 3 * torch.randn(count, 2) + 1, torch.randn(2, count)
    old = Normal(agent.policy(obs).mean.detach() + shift * SIGMA, SIGMA)
    actions = old.sample()
    return agent, (obs, actions, old.mean, old.log_prob(actions).sum(-1), A, targets)


def optimise(agent, samples, lr, epochs=2, size=34, clip_eps=0.2, max_kl=1e9):
    """What `optimise` did: (rows, agent) of each minibatch, gradients of each step; metrics.

    Which rows a minibatch has is found by its observations, as no two are alike.
    """
    optimizer, policy = torch.optim.SGD(agent.parameters(), lr), agent.policy
    minibatches, gradients, all_obs = [], [], samples[0].tolist()

    def look(obs):
        minibatches.append(([all_obs.index(x) for x in obs.tolist()], copy.deepcopy(agent)))
        return policy(obs)

    agent.policy = look
    optimizer.register_step_pre_hook(
        lambda *_: gradients.append([p.grad.clone() for p in agent.parameters()]))
    metrics = ppo.optimise(agent, optimizer, samples, epochs=epochs, minibatch_size=size,
                           clip_eps=clip_eps, max_kl=max_kl)
    return minibatches, gradients, metrics


def by_hand(agent, samples, rows, clip_eps):
    """The loss of a minibatch, and its metrics, from their definitions."""
    obs, actions, old_means, _, A, targets = (x[rows] for x in samples)
    obs = agent.obs_stats.normalise(obs)
    A = (A - A.mean()) / ((A - A.mean()).square().mean().sqrt() + 1e-8)
    pi, pi_old = Normal(agent.actor(obs), SIGMA), Normal(old_means, SIGMA)
    ratio = (pi.log_prob(actions) - pi_old.log_prob(actions)).sum(-1).exp()
    low, high = 1 - clip_eps, 1 + clip_eps
    surrogate = [min(x * a, min(max(x, low), high) * a) for x, a in zip(ratio, A)]
    loss_v = sum((agent.critic(obs)[:, 0] - targets) ** 2) / 2 / len(rows)
    clipped = (ratio < low) | (ratio > high)
    return loss_v - sum(surrogate) / len(rows), {
        "value_loss": loss_v.item(), "clip_fraction": clipped.double().mean().item(),
        "kl": kl_divergence(pi_old, pi).sum(-1).mean().item()}


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_tanh_takes_actions_to_the_bounds_and_never_beyond(dtype):
    space = gym.spaces.Box(ACTIONS.low.astype(dtype), ACTIONS.high.astype(dtype), dtype=dtype)
    half = math.atanh(0.5)
    squashed = ppo.squash(np.float32([[-10, -10], [10, 10], [0, 0], [half, -half]]), space)
    np.testing.assert_allclose(squashed, [[-1, 0], [3, 0.5], [1, 0.25], [2, 0.125]], rtol=1e-3)
    for low, high in (-0.2, 0.4), (-0.1, 0.7), (1e-3, 3e-3), (100, 101):
        space = gym.spaces.Box(low, high, (1,), dtype)
        for x in np.linspace(-20, 20, 401, dtype=np.float32):
            assert space.contains(ppo.squash(np.array([x]), space))


@pytest.mark.parametrize(("size", "steps"), [(33, 4), (99, 2), (512, 1)])
def test_an_epoch_uses_each_sample_once_and_each_step_follows_the_gradient_written_out(size, steps):
    """π starts half a σ from π_old in each number of an action, so about half are clipped.

    In a minibatch of a single row, the last of 99 + 1, A becomes 0.
    """
    agent, samples = make(shift=0.5)
    minibatches, gradients, metrics = optimise(agent, samples, lr=0.02, size=size, clip_eps=0.5)
    order = np.reshape(np.concatenate([rows for rows, _ in minibatches]), (2, 100))
    assert (np.sort(order) == np.arange(100)).all()
    assert (order[0] != order[1]).any()
    assert len(minibatches) == len(gradients) == 2 * steps
    for (rows, before), found in zip(minibatches, gradients):
        loss, expected_metrics = by_hand(before, samples, rows, clip_eps=0.5)
        for x, y in zip(found, torch.autograd.grad(loss, list(before.parameters()))):
            torch.testing.assert_close(x, y, rtol=1e-3, atol=1e-5)
    assert metrics == pytest.approx(expected_metrics, rel=1e-4)  # of the last one


def test_a_kl_above_max_kl_ends_all_epochs_before_the_next_step():
    """The bar lies below a KL that is above all before it, so it is known where an update ends."""
    agent, samples = make()
    again, state = copy.deepcopy(agent), torch.get_rng_state()
    minibatches, *_ = optimise(agent, samples, lr=0.003, epochs=9)
    kls = [by_hand(before, samples, rows, 0.2)[1]["kl"] for rows, before in minibatches]
    records = [i for i in range(1, len(kls)) if kls[i] > max(kls[:i])]
    end = records[len(records) // 2]
    torch.set_rng_state(state)
    minibatches, gradients, metrics = optimise(
        again, samples, lr=0.003, epochs=9, max_kl=(kls[end] + max(kls[:end])) / 2)
    assert len(minibatches) == len(gradients) + 1 == end + 1
    assert metrics["kl"] == pytest.approx(kls[end], rel=1e-4)


def test_rewards_are_divided_by_the_std_of_the_discounted_sums_so_far(monkeypatch, tmp_path):
    """Sums end with episodes, of 3 steps or cut off after 5, and span rollouts, of 10 steps."""
    raw = spy(monkeypatch, ppo, "scale_rewards", lambda rewards, *_: rewards)
    scaled = spy(monkeypatch, ppo, "compute_gae", lambda *batch, **_: (batch[0], batch[4]))
    SCRIPTS["ppo_continuous"].train(
        tmp_path, "--env-id", "harness:Cut-v0", "--rollout-steps", 10, "--gamma", 0.8)
    F, seen = np.zeros(4), []
    for rewards, (found, done) in zip(raw, scaled, strict=True):
        for reward, end in zip(rewards.numpy(), done.numpy()):
            seen.append(reward + 0.8 * F)
            F = np.where(end, 0, seen[-1])
        np.testing.assert_allclose(found, rewards / np.std(seen), rtol=1e-4)
