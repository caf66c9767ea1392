"""What A2C and PPO make of a rollout before they learn from it, against definitions."""

import copy

import numpy as np
import pytest
import torch
from conftest import both
from harness import explained_variance, read_log

from ppo_continuous import RunningStatistics, compute_gae, scale_rewards


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
    terminated[0, :4] = torch.tensor([True, True, False, False])
    truncated[0, :4] = torch.tensor([True, False, True, False])
    batch = rewards, values, next_values, terminated, terminated | truncated
    found = compute_gae(*batch, gamma, gae_lambda).double()
    torch.testing.assert_close(found, gae_by_hand(*batch, gamma, gae_lambda), rtol=0, atol=1e-4)


def test_a_value_of_a_terminal_state_does_not_count_even_if_it_is_nan():
    nan, end = torch.full((3, 1), torch.nan), torch.ones(3, 1, dtype=torch.bool)
    found = compute_gae(torch.ones(3, 1), torch.zeros(3, 1), nan, end, end, 0.9, 0.5)
    assert found.flatten().tolist() == [1, 1, 1]


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


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e30])
def test_rewards_are_divided_by_the_std_of_the_discounted_sums_so_far(scale):
    stats, going_on, seen = RunningStatistics(), 0.0, []
    F = np.zeros(3)
    for _ in range(4):  # several rollouts, over which F and the statistics go on
        rewards, done = scale * (torch.randn(10, 3).double() + 1), torch.rand(10, 3) < 0.2
        scaled, going_on = scale_rewards(rewards, done, going_on, stats, 0.9)
        for t in range(10):
            F = rewards[t].numpy() + 0.9 * F
            seen.append(F)
            F = np.where(done[t], 0, F)
        np.testing.assert_allclose(scaled, rewards / np.std(seen), rtol=1e-4)
        np.testing.assert_allclose(going_on, F, rtol=1e-4)


def spy_rollouts(monkeypatch, module, change):
    """A list of (the agent as it played, its transitions), which `change` replaces."""
    kept, rollout = [], module.rollout

    def spied(envs, agent, *rest):
        player = copy.deepcopy(agent)
        batch, *others = rollout(envs, agent, *rest)
        kept.append((player, change(batch)))
        return kept[-1][1], *others

    monkeypatch.setattr(module, "rollout", spied)
    return kept


@both
@pytest.mark.parametrize("rollout_steps", [1, 25])
@pytest.mark.parametrize("world", ["Uneven", "Forever", "BothEnds"])
def test_an_update_gets_the_estimates_of_the_agent_that_played(
        script, world, rollout_steps, monkeypatch, tmp_path):
    """Advantages and targets, in PPO also μ_old and log π_old, from definitions, as constants.

    The log has what `optimise` returned, and how well the agent that played predicted targets.
    """
    options, updates, optimise = ["--reward-scale", 3], [], script.module.optimise
    if script.name == "ppo_continuous":
        options = []
        monkeypatch.setattr(script.module, "scale_rewards", lambda r, *_: (3 * r.float(), None))

    def watched(agent, optimizer, *samples, **options):
        learner = copy.deepcopy(agent)
        metrics = optimise(agent, optimizer, *samples, **options)
        updates.append((learner, samples, dict(metrics)))
        return metrics

    monkeypatch.setattr(script.module, "optimise", watched)
    rollouts = spy_rollouts(monkeypatch, script.module, lambda batch: (
        batch._replace(rewards=torch.randn(batch.rewards.shape) + 1)))
    path = script.train(tmp_path, "--env-id", script.world(world), "--rollout-steps", rollout_steps,
                        "--total-steps", 12 * rollout_steps, "--gamma", 0.9, "--gae-lambda", 0.7,
                        *options)
    assert len(rollouts) == 3
    rows = torch.cat([batch.obs.flatten(0, 1) for _, batch in rollouts[:2]]).double()
    torch.testing.assert_close(rollouts[2][0].obs_stats.mean, rows.mean(0))  # all before this one
    torch.testing.assert_close(rollouts[2][0].obs_stats.var, rows.var(0, correction=0))
    assert [player.obs_stats.count / rollout_steps for player, _ in rollouts] == [0, 4, 8]
    for (player, batch), (learner, samples, metrics), (_, row) in zip(
            rollouts, updates, read_log(path).iterrows(), strict=True):
        torch.testing.assert_close(player.state_dict(), learner.state_dict(), rtol=0, atol=0)
        with torch.no_grad():
            V, next_V = player.value(batch.obs), player.value(batch.next_obs)
            policy = player.policy(batch.obs)
        A = gae_by_hand(3 * batch.rewards, V, next_V, batch.terminated, batch.done, 0.9, 0.7)
        targets = A + V
        expected = batch.obs, batch.actions, A, targets
        if script.name == "ppo_continuous":
            samples, log_probs = samples[0], policy.log_prob(batch.actions).sum(-1)
            expected = batch.obs, batch.actions, policy.mean, log_probs, A, targets
        for x, y in zip(samples, expected, strict=True):
            assert not x.requires_grad
            torch.testing.assert_close(x.double(), y.reshape(x.shape).double(), rtol=0, atol=1e-4)
        metrics["explained_variance"] = explained_variance(V.numpy(), targets.numpy())
        assert dict(row[list(metrics)]) == pytest.approx(metrics, rel=1e-3, abs=1e-3, nan_ok=True)
