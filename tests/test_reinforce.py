"""The maths of reinforce_mujoco.py against definitions, hand numbers and analytic gradients."""

import math

import gymnasium as gym
import harness  # registers the worlds
import numpy as np
import pandas as pd
import pytest
import torch
from harness import read_json

import reinforce_mujoco as rf

BASELINES = ["none", "mean", "value"]


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


def make(world="ThreeSteps", options=""):
    """Arguments, an environment that has been seeded, and an agent for it."""
    args = rf.parse_args(f"--env-id harness:{world}-v0 {options}".split())
    env = rf.CheckedEnv(gym.make(args.env_id), 0)
    env.reset(seed=1)
    return args, env, rf.make_agent(args, env)


@pytest.fixture
def watched(tmp_path, monkeypatch):
    """Trains, and gives what went into and came out of the named functions; the agent; tables."""

    def train(world, options, *names, seed=1):
        calls = {name: [] for name in (*names, "make_agent")}

        def record(name, function):
            def recorded(*args):
                calls[name].append((args, function(*args)))
                return calls[name][-1][1]

            return recorded

        args = rf.parse_args(f"--env-id harness:{world}-v0 --eval-every 0 {options}".split())
        folder = tmp_path / f"seed-{seed}"
        with monkeypatch.context() as patch:
            for name in calls:
                patch.setattr(rf, name, record(name, getattr(rf, name)))
            rf.train(args, seed, folder, tmp_path / "stop")
        ((_, agent),) = calls.pop("make_agent")
        return agent, calls, folder

    return train


def log_density(policy, states, samples):
    """log π(u|s) of independent Gaussians, written out; (T,)."""
    mean, std = policy.mean(policy.trunk(states)), policy(states).stddev
    noise = (samples - mean) / std
    return (-(noise**2) / 2 - std.log() - math.log(2 * math.pi) / 2).sum(1)


# --- Returns and advantages -----------------------------------------------------------------------


@pytest.mark.parametrize("last_return", [0.0, 7.5])
@pytest.mark.parametrize("gamma", [0.0, 0.9, 1.0])
def test_returns_are_the_discounted_rewards_from_a_step_on(gamma, last_return):
    rewards = torch.randn(30, dtype=torch.float64)
    expected = [
        sum(gamma ** (k - t) * rewards[k].item() for k in range(t, 30))
        + gamma ** (30 - t) * last_return
        for t in range(30)
    ]
    returns = rf.discounted_returns(rewards, last_return, gamma)
    np.testing.assert_allclose(returns, expected)


def test_returns_of_a_very_long_episode_do_not_take_for_ever():
    returns = rf.discounted_returns(torch.ones(100_000), 0.0, 0.99)  # T²: 10,000,000,000 steps
    assert returns[0].item() == pytest.approx(100, rel=1e-4)
    assert returns[-2:].tolist() == pytest.approx([1.99, 1])


def test_advantages_by_hand():
    returns, values = torch.tensor([1.0, 2.0, 6.0]), torch.tensor([0.5, 3.0, 2.0])
    assert rf.compute_advantages(returns, None, "none").tolist() == [1, 2, 6]
    assert rf.compute_advantages(returns, values, "value").tolist() == [0.5, -1, 4]
    centred = rf.compute_advantages(returns, None, "mean")
    torch.testing.assert_close(centred / centred[1], torch.tensor([-2.0, -1.0, 3.0]) / -1)
    assert centred[2] > 0


def test_the_mean_baseline_leaves_mean_0_and_std_1():
    advantages = rf.compute_advantages(50 + 20 * torch.randn(1000), None, "mean")
    assert abs(advantages.mean().item()) < 1e-5
    assert advantages.std().item() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("baseline", BASELINES)
def test_advantages_carry_no_gradient(baseline):
    values = torch.randn(5, requires_grad=True)
    assert not rf.compute_advantages(torch.randn(5), values, baseline).requires_grad


@pytest.mark.parametrize("returns", [[3.0], [3.0, 3.0, 3.0]])
def test_a_batch_of_equal_returns_has_finite_advantages(returns):
    """One step in all is such a batch, and the usual std of one number is NaN."""
    advantages = rf.compute_advantages(torch.tensor(returns), None, "mean")
    assert advantages.tolist() == [0.0] * len(returns)


# --- The gradient ---------------------------------------------------------------------------------


def test_policy_loss_by_hand():
    log_probs = torch.tensor([-1.0, -2.0, 0.5], requires_grad=True)
    loss = rf.policy_loss(log_probs, torch.tensor([2.0, -1.0, 4.0]))
    assert loss.item() == pytest.approx(-(-2 + 2 + 2) / 3)
    loss.backward()
    torch.testing.assert_close(log_probs.grad, -torch.tensor([2.0, -1.0, 4.0]) / 3)


@pytest.mark.parametrize("baseline", BASELINES)
@pytest.mark.parametrize("episodes", [1, 2])
def test_train_descends_the_gradient_of_the_loss_written_out(episodes, baseline, watched):
    """With 3 action dimensions, also in a batch of 3 steps, where axes are easily confused.

    At learning rate 0 the agent stays what it was, so that all can be computed again afterwards.
    """
    options = f"--batch-episodes {episodes} --total-steps 3 --learning-rate 0 --gamma 0.9"
    agent, calls, _ = watched("ThreeActions", f"{options} --baseline {baseline}", "sample_episode")
    played = [result for _, result in calls["sample_episode"]]
    states, samples = (torch.cat([x[i] for x in played]) for i in (0, 1))
    assert samples.shape == (3 * episodes, 3)
    returns = torch.tensor([1 + 0.9 * (1 + 0.9), 1 + 0.9, 1.0] * episodes)
    advantages, expected = returns, {}
    if baseline == "mean":
        advantages = rf.compute_advantages(returns, None, "mean")
    if baseline == "value":
        values = agent["value"](states)[:, 0]
        advantages = returns - values.detach()
        expected["value"] = ((values - returns) ** 2).sum() / (2 * len(returns))
    expected["policy"] = -(log_density(agent["policy"], states, samples) * advantages).sum()
    expected["policy"] /= len(returns)
    for name, loss in expected.items():
        parameters = list(agent[name].parameters())
        for p, gradient in zip(parameters, torch.autograd.grad(loss, parameters)):
            torch.testing.assert_close(p.grad, gradient, rtol=1e-4, atol=1e-6)
            assert gradient.abs().max() > 1e-4


def bandit_gradients(baseline, batches=2000, B=8):
    """Gradients of −loss with respect to (μ, pre-activation of σ), (batches, 4), and analytic.

    One step, one state, reward 10 − |u − c|². Its mean is 10 − Σ((μ − c)² + σ²), of which the
    derivatives are −2(μ − c) and −2σ·dσ.
    """
    _, _, agent = make("ThreeSteps", "--baseline value")
    policy, state, c = agent["policy"], torch.zeros(1, 2), torch.tensor([0.8, -0.5])
    mean, std = policy(state).mean[0].detach(), policy(state).stddev[0].detach()
    slope = torch.sigmoid(policy.raw_std(policy.trunk(state))[0]).detach()  # of softplus
    analytic = torch.cat([-2 * (mean - c), -2 * std * slope])
    agent["value"][-1].bias.data.fill_(10 - ((mean - c) ** 2 + std**2).sum().item())
    heads = [policy.mean.bias, policy.raw_std.bias]
    states, gradients = state.expand(B, 2), []
    for _ in range(batches):
        distribution = policy(states)
        samples = distribution.sample()
        returns = 10 - ((samples - c) ** 2).sum(-1)
        advantages = rf.compute_advantages(returns, agent["value"](states)[:, 0], baseline)
        if baseline == "mean":  # undo the division by the std; a return is 1/B of its own baseline
            advantages = advantages * (returns - returns.mean()).norm() / advantages.norm()
            advantages = advantages / (1 - 1 / B)
        loss = rf.policy_loss(distribution.log_prob(samples).sum(-1), advantages)
        gradients.append(-torch.cat(torch.autograd.grad(loss, heads)))
    return torch.stack(gradients), analytic


@pytest.fixture(scope="module")
def bandit():
    torch.manual_seed(0)
    return {baseline: bandit_gradients(baseline) for baseline in BASELINES}


@pytest.mark.parametrize("baseline", BASELINES)
def test_on_a_bandit_the_mean_gradient_is_the_analytic_one(bandit, baseline):
    gradients, analytic = bandit[baseline]
    standard_error = gradients.std(0) / math.sqrt(len(gradients))
    assert ((gradients.mean(0) - analytic).abs() < 3 * standard_error).all()
    if baseline != "none":  # and it is one: without a baseline the noise may hide it
        assert (analytic.abs() > 3 * standard_error).all()


@pytest.mark.parametrize("baseline", ["mean", "value"])
def test_on_a_bandit_a_baseline_takes_most_of_the_noise_away(bandit, baseline):
    noise = {name: gradients.var(0).sum() for name, (gradients, _) in bandit.items()}
    assert noise[baseline] < noise["none"] / 3


def test_a_batch_that_teaches_nothing_changes_nothing(watched):
    """γ = 0 and equal rewards leave no advantage; a weight decay would still shrink the weights."""
    options = "--gamma 0 --total-steps 30 --baseline mean --learning-rate"
    still, _, _ = watched("ThreeSteps", f"{options} 0")
    trained, _, _ = watched("ThreeSteps", f"{options} 1")
    for p, q in zip(still.parameters(), trained.parameters()):
        assert torch.equal(p, q)


# --- Policy ---------------------------------------------------------------------------------------


def test_the_mean_of_the_distribution_is_what_the_mean_head_says():
    _, _, agent = make()
    policy, states = agent["policy"], torch.randn(50, 2)
    assert torch.equal(policy(states).mean, policy.mean(policy.trunk(states)))
    assert len(policy(states).stddev.unique()) == 100  # σ depends on the state


@pytest.mark.parametrize("mean", [-100, 100])
@pytest.mark.parametrize("raw_std", [-100, -20, 100])
def test_extreme_pre_activations_stay_finite_and_go_on_learning(mean, raw_std):
    _, _, agent = make()
    policy, states = agent["policy"], torch.randn(20, 2)
    for head, value in (policy.mean, mean), (policy.raw_std, raw_std):
        head.weight.data.zero_()
        head.bias.data.fill_(value)
    distribution = policy(states)
    samples = distribution.sample()
    log_probs = distribution.log_prob(samples).sum(-1)
    (-log_probs.mean()).backward()
    assert samples.isfinite().all()
    assert log_probs.isfinite().all()
    assert (distribution.stddev > 0).all()
    assert all(p.grad.isfinite().all() for p in policy.parameters())
    assert (policy.mean.bias.grad != 0).all()
    if raw_std >= -20:
        assert (policy.raw_std.bias.grad != 0).all()


def test_the_environment_gets_actions_within_its_bounds_though_samples_may_be_beyond():
    _, env, agent = make()
    obs = np.float32(np.random.default_rng(0).normal(size=(200, 2)))
    samples, actions = agent["policy"].act(obs)
    assert ((samples < harness.ACTIONS.low) | (samples > harness.ACTIONS.high)).any()
    np.testing.assert_array_equal(actions, samples.clip(harness.ACTIONS.low, harness.ACTIONS.high))
    agent["policy"].mean.bias.data.fill_(30.0)
    _, samples, *_ = rf.sample_episode(env, agent["policy"])  # the world asserts its bounds
    assert samples.min() > 20


def test_an_unbounded_box_works():
    _, env, agent = make("Unbounded")
    agent["policy"].mean.bias.data.fill_(1e4)
    samples, actions = agent["policy"].act(np.zeros((5, 2)))
    np.testing.assert_array_equal(samples, actions)
    assert actions.min() > 9000
    rf.sample_episode(env, agent["policy"])


def test_deterministic_actions_are_those_of_the_mean():
    _, _, agent = make()
    obs = np.float32(np.random.default_rng(0).normal(size=(20, 2)))
    samples, _ = agent["policy"].act(obs, deterministic=True)
    np.testing.assert_array_equal(samples, agent["policy"](torch.as_tensor(obs)).mean.detach())
    sampled, _ = agent["policy"].act(obs)
    assert len(np.unique(sampled - samples)) == samples.size  # each has its own noise


# --- Episodes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("world", "length", "ends"), [("ThreeSteps", 3, True), ("Forever", 8, False),
                                  ("BothEnds", 3, True)]
)
def test_every_row_is_a_real_transition(world, length, ends):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    _, env, agent = make(world)
    for _ in range(3):
        states, samples, rewards, last, terminated, row = rf.sample_episode(env, agent["policy"])
        assert states[:, 1].tolist() == list(range(length))
        assert (states[:, 0] == last[0]).all()
        assert last[1] == length
        assert rewards.tolist() == [1.0] * length
        assert (samples.shape, terminated, row) == ((length, 2), ends, (length, length))
        assert all(x.dtype == torch.float32 for x in (states, samples, rewards, last))


def test_each_row_keeps_its_own_sample_and_reward(watched):
    """The sample that is learned from, unclipped, is the one whose action earned the reward."""
    options = "--batch-episodes 50 --total-steps 50 --learning-rate 0 --baseline none"
    agent, calls, folder = watched("Target", options, "policy_loss", "sample_episode")
    (((log_probs, advantages), _),) = calls["policy_loss"]
    played = [result for _, result in calls["sample_episode"]]
    states, samples = (torch.cat([x[i] for x in played]) for i in (0, 1))
    torch.testing.assert_close(log_probs, log_density(agent["policy"], states, samples))
    actions = samples.numpy().clip(harness.ACTIONS.low, harness.ACTIONS.high)
    assert (actions != samples.numpy()).any(1).sum() > 10
    rewards = -np.square(actions - harness.TARGET).sum(1)
    np.testing.assert_allclose(advantages, rewards, rtol=1e-5)
    np.testing.assert_allclose(pd.read_csv(folder / "episodes.csv")["return"], rewards, rtol=1e-5)


@pytest.mark.parametrize("baseline", BASELINES)
@pytest.mark.parametrize("world", ["ThreeSteps", "Forever", "BothEnds"])
def test_only_a_time_limit_is_bootstrapped_and_only_with_values(world, baseline, watched):
    options = f"--baseline {baseline} --total-steps 1 --learning-rate 0 --gamma 0.9"
    agent, calls, _ = watched(world, options, "sample_episode", "discounted_returns")
    assert len(calls["discounted_returns"]) == 4
    for (_, played), (given, _) in zip(calls["sample_episode"], calls["discounted_returns"]):
        _, _, rewards, last, *_ = played
        assert given[0] is rewards
        assert given[2] == 0.9
        if world == "Forever" and baseline == "value":
            assert given[1] == pytest.approx(agent["value"](last).item())
            assert abs(given[1]) > 1e-4
        else:
            assert given[1] == 0


def test_every_episode_starts_differently_also_those_of_other_seeds(watched):
    starts = []
    for seed in 1, 2:
        _, calls, _ = watched("ThreeSteps", "--total-steps 30", "sample_episode", seed=seed)
        starts += [states[0, 0].item() for _, (states, *_) in calls["sample_episode"]]
    assert len(set(starts)) == len(starts) == 2 * 12


def test_every_episode_is_logged_once_with_its_raw_return_and_length(watched):
    """Asked for 30 steps, 4 episodes an update: ends after the third update, at 36."""
    _, _, folder = watched("ThreeSteps", "--total-steps 30 --gamma 0.5")
    episodes, metrics = (pd.read_csv(folder / f"{x}.csv") for x in ("episodes", "metrics"))
    assert episodes["env_step"].tolist() == list(range(3, 37, 3))
    assert (episodes[["return", "length"]] == 3).all(axis=None)
    assert metrics["env_step"].tolist() == [12, 24, 36]
    np.testing.assert_allclose(metrics["learning_rate"], 1e-2 * np.array([1, 0.6, 0.2]))
    assert read_json(folder / "summary.json")["env_steps"] == 36


def test_the_log_shows_the_policy_that_acted(watched):
    options = "--total-steps 1 --batch-episodes 2 --baseline value"
    agent, calls, folder = watched("ThreeSteps", f"{options} --learning-rate 0", "sample_episode")
    metrics = pd.read_csv(folder / "metrics.csv").iloc[0]
    distribution = agent["policy"](torch.cat([x[0] for _, x in calls["sample_episode"]]))
    entropy = (distribution.stddev.log() + 0.5 * math.log(2 * math.pi * math.e)).sum(1).mean()
    assert metrics["entropy"] == pytest.approx(entropy.item(), rel=1e-4)
    assert metrics["policy_std"] == pytest.approx(distribution.stddev.mean().item(), rel=1e-4)
    squares = sum((p.grad**2).sum().item() for p in agent["policy"].parameters())
    assert metrics["grad_norm"] == pytest.approx(math.sqrt(squares), rel=1e-4)


# --- Learning -------------------------------------------------------------------------------------


@pytest.mark.parametrize("baseline", BASELINES)
def test_every_baseline_finds_a_good_action_in_an_asymmetric_box(baseline, watched):
    options = f"--batch-episodes 16 --total-steps 4096 --baseline {baseline}"
    _, _, folder = watched("Target", options)  # at first about -4
    assert read_json(folder / "summary.json")["eval_return_mean"] > -0.05
    assert pd.read_csv(folder / "episodes.csv")["return"][-100:].mean() > -0.05


def test_the_value_network_learns_what_a_state_is_worth(watched):
    """Reward 1 for ever is worth 1 / (1 − γ), despite time limits; without bootstrap it is less."""
    options = "--baseline value --gamma 0.8 --total-steps 6400 --learning-rate 3e-3"
    agent, _, _ = watched("Forever", options)
    states = torch.tensor([[0.0, t] for t in range(8)])
    assert (agent["value"](states) - 5).abs().max() < 0.5


def test_it_learns_to_balance_a_pole(tmp_path):
    args = rf.parse_args(["--total-steps", "15000", "--eval-every", "0"])
    rf.train(args, 1, tmp_path / "seed-1", tmp_path / "stop")
    assert read_json(tmp_path / "seed-1/summary.json")["eval_return_mean"] > 30
    episodes = pd.read_csv(tmp_path / "seed-1/episodes.csv")["return"]
    assert episodes[-20:].mean() > 2.5 * episodes[:20].mean()
