"""What A2C and PPO make of a rollout before they learn from it, against definitions."""

import numpy as np
import pytest
import torch

from ppo_continuous import RunningStatistics, compute_gae, scale_rewards


def random_batch(T=7, N=3):
    """Rewards, values, next values (T, N) and random flags: terminated, done."""
    rewards, values, next_values = torch.randn(3, T, N, dtype=torch.float64)
    terminated, truncated = torch.rand(2, T, N) < 0.25
    return rewards, values, next_values, terminated, terminated | truncated


def gae_by_hand(rewards, values, next_values, terminated, done, gamma, gae_lambda):
    """A_t = Σ_k (γλ)^k·δ_{t+k}, up to the end of the episode or of the rollout."""
    advantages = torch.zeros_like(rewards)
    T, N = rewards.shape
    for n in range(N):
        for t in range(T):
            for k in range(T - t):
                i = t + k, n
                bootstrap = 0 if terminated[i] else next_values[i]
                delta = rewards[i] + gamma * bootstrap - values[i]
                advantages[t, n] += (gamma * gae_lambda) ** k * delta
                if done[i]:
                    break
    return advantages


@pytest.mark.parametrize("gae_lambda", [0.0, 0.7, 1.0])
@pytest.mark.parametrize("gamma", [0.9, 1.0])
def test_gae_is_the_discounted_sum_of_td_errors_within_an_episode(gamma, gae_lambda):
    _, _, _, terminated, done = batch = random_batch(T=40, N=5)
    assert 0 < terminated.sum() < done.sum() < done.numel()
    expected = gae_by_hand(*batch, gamma, gae_lambda)
    torch.testing.assert_close(compute_gae(*batch, gamma, gae_lambda), expected)


@pytest.mark.parametrize(
    ("terminated", "expected"), [(False, 1 + 0.9 * 10 - 2), (True, 1 - 2)])
def test_a_time_limit_is_bootstrapped_unless_the_episode_terminates_there(terminated, expected):
    one = torch.ones(1, 1)
    flags = torch.tensor([[terminated]]), torch.tensor([[True]])
    advantage = compute_gae(one, 2 * one, 10 * one, *flags, 0.9, 0.95)
    assert advantage.item() == pytest.approx(expected)


def test_the_last_row_of_a_rollout_and_a_rollout_of_one_step_learn():
    rewards, values, next_values, terminated, done = batch = random_batch(T=6, N=64)
    delta = rewards + 0.9 * next_values * ~terminated - values
    torch.testing.assert_close(compute_gae(*batch, 0.9, 0.95)[-1], delta[-1])
    torch.testing.assert_close(compute_gae(*(x[-1:] for x in batch), 0.9, 0.95), delta[-1:])


def test_running_statistics_equal_those_of_numpy_over_unequal_chunks():
    stats, rows = RunningStatistics(3), torch.randn(500, 3) * torch.tensor([1.0, 20.0, 0.1]) + 5
    seen = 0
    for chunk in rows.split([1, 7, 192, 300]):
        stats.update(chunk)
        seen += len(chunk)
        assert stats.count == seen
        np.testing.assert_allclose(stats.mean, rows[:seen].numpy().mean(0), rtol=1e-5)
        np.testing.assert_allclose(stats.var, rows[:seen].numpy().var(0), rtol=1e-4, atol=1e-8)
    x = torch.randn(10, 3) * 50
    expected = ((x - rows.mean(0)) / rows.std(0, correction=0)).clamp(-10, 10)
    torch.testing.assert_close(stats.normalise(x), expected, rtol=1e-4, atol=1e-4)


def test_before_the_first_update_numbers_are_only_clipped():
    x = torch.tensor([[3.0, -4.0], [11.0, -1e9]])
    assert RunningStatistics(2).normalise(x).tolist() == [[3, -4], [10, -10]]


@pytest.mark.parametrize("constant", [0.0, 0.1, 3.0, 1e10])
def test_a_dimension_that_has_never_changed_is_0_and_may_jump(constant):
    stats = RunningStatistics(1)
    for _ in range(3):
        stats.update(torch.full((7, 1), constant))
    assert stats.normalise(torch.tensor([[constant]])).abs() < 0.1
    jumps = torch.tensor([[constant - 1e6], [constant + 1e6]])
    assert stats.normalise(jumps).flatten().tolist() == [-10, 10]


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e19, 1e30])
def test_very_small_and_very_large_numbers_are_normalised_alike(scale):
    rows, stats = torch.randn(500, 2), RunningStatistics(2)
    for chunk in (scale * rows).split(100):
        stats.update(chunk)
    expected = (rows - rows.mean(0)) / rows.std(0, correction=0)
    torch.testing.assert_close(stats.normalise(scale * rows), expected, rtol=1e-4, atol=1e-4)


def test_rewards_are_divided_by_the_std_of_the_discounted_sums_so_far():
    stats, past_rewards, seen = RunningStatistics(), torch.zeros(1), []
    F = np.zeros(3)
    for _ in range(4):  # several rollouts, over which F and the statistics go on
        rewards, done = torch.randn(10, 3) + 1, torch.rand(10, 3) < 0.2
        scaled, past_rewards = scale_rewards(rewards, done, past_rewards, stats, 0.9)
        for t in range(10):
            F = rewards[t].numpy() + 0.9 * F
            seen.append(F)
            F = np.where(done[t], 0, F)
        np.testing.assert_allclose(scaled, rewards / np.std(seen), rtol=1e-4)
        np.testing.assert_allclose(past_rewards, F, rtol=1e-4, atol=1e-6)
    assert stats.mean.item() == pytest.approx(np.mean(seen), abs=1e-4)


@pytest.mark.parametrize("reward", [0.0, 0.1, 5.0])
def test_rewards_whose_sums_do_not_vary_stay_as_they_are(reward):
    """A constant reward in episodes of one step."""
    stats, past_rewards = RunningStatistics(), torch.zeros(1)
    rewards, done = torch.full((50, 3), reward).double(), torch.ones(50, 3, dtype=bool)
    for _ in range(3):
        scaled, past_rewards = scale_rewards(rewards, done, past_rewards, stats, 0.9)
        torch.testing.assert_close(scaled, rewards.float())


@pytest.mark.parametrize("scale", [1e-6, 1e19, 1e30])
def test_the_size_of_rewards_does_not_matter(scale):
    rewards, done = torch.randn(50, 3).double(), torch.rand(50, 3) < 0.2
    one, other = (
        scale_rewards(x * rewards, done, torch.zeros(1), RunningStatistics(), 0.9)[0]
        for x in (1, scale))
    torch.testing.assert_close(one, other)
