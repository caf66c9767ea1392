"""What A2C and PPO make of a rollout before they learn from it, against definitions."""

import copy

import numpy as np
import pytest
import torch
from conftest import both
from harness import explained_variance, length, read_log, spy

from ppo_continuous import RunningStatistics, compute_gae


def gae_by_hand(rewards, values, next_values, terminated, done, gamma, gae_lambda):
    """A_t = Σ_k (γλ)^k·δ_{t+k}, up to the end of the episode or of the rollout, in float64."""
    bootstrap = torch.where(terminated, 0, next_values.double())
    delta = rewards.double() + gamma * bootstrap - values.double()
    advantages = torch.zeros_like(delta)
    for t, n in np.ndindex(*delta.shape):
        for k in range(len(delta) - t):
            advantages[t, n] += (gamma * gae_lambda) ** k * delta[t + k, n]
            if done[t + k, n]:
                break
    return advantages


@pytest.mark.parametrize("T", [1, 40])
@pytest.mark.parametrize("gae_lambda", [0.0, 0.7, 1.0])
@pytest.mark.parametrize("gamma", [0.9, 1.0])
def test_gae_is_the_discounted_sum_of_td_errors_within_an_episode(gamma, gae_lambda, T):
    rewards, values, next_values = torch.randn(3, T, 64)
    terminated, truncated = torch.rand(2, T, 64) < 0.25
    batch = rewards, values, next_values, terminated, terminated | truncated
    found = compute_gae(*batch, gamma, gae_lambda).double()
    torch.testing.assert_close(found, gae_by_hand(*batch, gamma, gae_lambda), rtol=0, atol=1e-4)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e19, 1e30])
def test_running_statistics_are_those_of_all_rows_of_any_size(scale):
    """Before the first update numbers are only clipped. Rows may lie in a grid."""
    rows = scale * (torch.randn(500, 3) * torch.tensor([1.0, 20.0, 0.1]) + 5)
    x = scale * 50 * torch.randn(10, 3)
    stats, exact = RunningStatistics(3), rows.double()
    assert torch.equal(stats.normalise(x), x.clamp(-10, 10))
    for seen, chunk in zip((1, 8, 200, 500), rows.split([1, 7, 192, 300])):
        stats.update(chunk.reshape(-1, 4, 3) if len(chunk) % 4 == 0 else chunk)
        assert stats.count == seen
        np.testing.assert_allclose(stats.mean, exact[:seen].numpy().mean(0), rtol=1e-5)
        np.testing.assert_allclose(stats.var, exact[:seen].numpy().var(0), rtol=1e-4)
    expected = ((x - exact.mean(0)) / exact.std(0, correction=0)).clamp(-10, 10).float()
    torch.testing.assert_close(stats.normalise(x), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("constant", [0.0, 0.1, 3.0, 1e10])
def test_what_never_changed_is_0_and_may_jump_and_small_changes_of_large_numbers_are_seen(constant):
    stats, times = RunningStatistics(1), RunningStatistics(1)
    for _ in range(3):
        stats.update(torch.full((7, 1), constant))
    assert stats.normalise(torch.tensor([[constant]])).abs() < 0.1
    jumps = torch.tensor([[constant - 1e6], [constant + 1e6]])
    assert stats.normalise(jumps).flatten().tolist() == [-10, 10]
    seconds = torch.tensor([[1.7e9], [1.7e9 + 60]], dtype=torch.float64)  # alike in float32
    times.update(seconds)
    assert times.normalise(seconds).flatten().tolist() == [-1, 1]


@both
@pytest.mark.parametrize("rollout_steps", [1, 25])
@pytest.mark.parametrize(("world", "gamma"), [
    ("Uneven", 0.9), ("Forever", 0.9), ("BothEnds", 0.9), ("Forever", 0)])
def test_an_update_gets_the_estimates_of_the_agent_that_played(
        script, world, gamma, rollout_steps, monkeypatch, tmp_path):
    """Advantages and targets, in PPO also μ_old and log π_old, from definitions, as constants.

    The log says how well the agent that played predicted targets; if γ is 0, they are all alike.
    """
    ppo = script.name == "ppo_continuous"

    def keep(agent, optimizer, *samples, **_):
        flat = samples[0] if ppo else [x.flatten(0, 1) for x in samples]
        return copy.deepcopy(agent), *flat

    updates = spy(monkeypatch, script.module, "optimise", keep)
    players = spy(monkeypatch, script.module, "rollout", lambda _, agent, *__: copy.deepcopy(agent))
    rewarded = spy(monkeypatch, script.module, "compute_gae", lambda rewards, *_, **__: rewards)
    path = script.train(tmp_path, "--env-id", script.world(world), "--rollout-steps", rollout_steps,
                        "--total-steps", 12 * rollout_steps, "--gamma", gamma, "--gae-lambda", 0.7)
    rows = torch.cat([obs for _, obs, *_ in updates[:2]]).double()
    torch.testing.assert_close(players[2].obs_stats.mean, rows.mean(0))  # all before this one
    torch.testing.assert_close(players[2].obs_stats.var, rows.var(0, correction=0))
    for player, rewards, (learner, obs, actions, *found), explained in zip(
            players, rewarded, updates, read_log(path)["explained_variance"], strict=True):
        torch.testing.assert_close(player.state_dict(), learner.state_dict(), rtol=0, atol=0)
        with torch.no_grad():  # the world shows the steps so far
            V, next_V = player.value(obs), player.value(obs + torch.tensor([0, 1]))
            policy = player.policy(obs)
        done = obs[:, 1] + 1 == length(world, obs[:, 0])
        batch = [x.reshape(-1, 4) for x in (rewards, V, next_V, done & (world != "Forever"), done)]
        A = gae_by_hand(*batch, gamma, 0.7).flatten()
        expected = [A, A + V]
        if ppo:  # how it scales rewards is tested in test_ppo.py
            expected = [policy.mean, policy.log_prob(actions).sum(-1), A, A + V]
        else:
            paid = actions if world == "Uneven" else torch.ones(len(actions))
            torch.testing.assert_close(rewards.flatten(), 0.1 * paid)
        for x, y in zip(found, expected, strict=True):
            assert not x.requires_grad
            torch.testing.assert_close(x.double(), y.double(), rtol=0, atol=1e-4)
        known = explained_variance(V.numpy(), (A + V).numpy())
        assert explained == pytest.approx(known, rel=1e-3, abs=1e-3, nan_ok=True)
        assert gamma > 0 or np.isnan(explained)
