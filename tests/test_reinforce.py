"""reinforce_mujoco.py: its maths by hand, its policy, its episodes, and what it learns."""

import math

import numpy as np
import pytest
import torch
from conftest import SCRIPTS
from gymnasium.spaces import Box
from harness import ACTIONS, TARGET, World, read_log, register, spy, train

import reinforce_mujoco as rf

every_baseline = pytest.mark.parametrize("baseline", ["none", "mean", "value"])
LENGTHS = {"ThreeSteps": 3, "Forever": 8, "BothEnds": 3}


class Rising(World):
    """The reward of a step is its number, from 1 on."""

    def reward(self, action):
        return float(self.steps)


register("Rising", Rising, actions=Box(-1, 1, (3,)))


def make(world="ThreeSteps"):
    """An environment that has been seeded, and an agent for it."""
    env = rf.make_env(f"{world}-v0")
    env.reset(seed=1)
    return env, rf.Agent(SCRIPTS["reinforce_mujoco"].envs(f"{world}-v0", 1), 64)


def spy_episodes(monkeypatch):
    """A list of (agent, episode)."""
    kept, play = [], rf.play

    def spied(env, agent):
        episode = play(env, agent)
        kept.append((agent, episode))
        return episode

    monkeypatch.setattr(rf, "play", spied)
    return kept


@pytest.mark.parametrize("last_value", [0.0, 7.5])
@pytest.mark.parametrize("gamma", [0.0, 0.9, 1.0])
def test_rewards_to_go_are_the_discounted_rewards_from_a_step_on(gamma, last_value):
    rewards = np.random.default_rng(0).normal(size=30).tolist()
    expected = [
        sum(gamma ** (k - t) * rewards[k] for k in range(t, 30)) + gamma ** (30 - t) * last_value
        for t in range(30)]
    assert rf.sum_rewards(rewards, last_value, gamma).tolist() == pytest.approx(expected, rel=1e-5)


@every_baseline
@pytest.mark.parametrize("episodes", [1, 2])
def test_train_descends_the_gradient_of_the_loss_written_out(episodes, baseline, monkeypatch):
    """With 3 action dimensions, also in a batch of 3 steps, where axes are easily confused.

    At learning rate 0 the agent stays what it was, so that all can be computed again afterwards.
    """
    played = spy_episodes(monkeypatch)
    log = train(monkeypatch, rf, "--env-id", "Rising-v0", "--batch-episodes", episodes,
                "--total-steps", 3 * episodes + 1, "--learning-rate", 0, "--gamma", 0.9,
                "--baseline", baseline)
    assert len(log) == 2  # of two updates, so that a gradient that adds up would be seen
    agent = played[0][0]
    obs, actions = (torch.cat([x[i] for _, x in played[-episodes:]]) for i in (0, 1))
    assert actions.shape == (3 * episodes, 3)
    G = torch.tensor([1 + 0.9 * (2 + 0.9 * 3), 2 + 0.9 * 3, 3.0] * episodes)
    values = agent.critic(obs)[:, 0]
    loss_v = ((values - G) ** 2).sum() / (2 * len(G))
    advantages = {"none": G, "value": G - values.detach(), "mean": G - G.mean()}[baseline]
    outputs = agent.actor(obs)
    std = (1 + outputs[:, 3:].exp()).log() + 0.1
    noise = (actions - outputs[:, :3]) / std
    log_density = (-(noise**2) / 2 - std.log() - math.log(2 * math.pi) / 2).sum(1)
    loss_pi = -(log_density * advantages).sum() / len(G)
    parameters = list(agent.parameters())
    gradients = torch.autograd.grad(loss_pi + loss_v, parameters)
    for p, gradient in zip(parameters, gradients):
        torch.testing.assert_close(p.grad, gradient, rtol=1e-4, atol=1e-6)
        assert gradient.abs().max() > 1e-4
    expected = {"value_loss": loss_v.item(), "policy_std": std.mean().item()}
    assert dict(log.iloc[-1][list(expected)]) == pytest.approx(expected, rel=1e-4)


def bandit_gradients(baseline, batches=1000, B=8):
    """Gradients of −loss with respect to (μ, pre-activation of σ), (batches, 4), and analytic.

    One step, one state, reward 10 − |a − c|². Its mean is 10 − Σ((μ − c)² + σ²), of which the
    derivatives are −2(μ − c) and −2σ·dσ.
    """
    _, agent = make()
    obs, c = torch.zeros(B, 2), torch.tensor([0.8, -0.5])
    mean, std = agent.policy(obs[0]).mean.detach(), agent.policy(obs[0]).stddev.detach()
    slope = agent.actor(obs[0])[2:].sigmoid().detach()  # of softplus
    analytic = torch.cat([-2 * (mean - c), -2 * std * slope])
    if baseline == "value":
        agent.critic[-1].bias.data.fill_(10 - ((mean - c) ** 2 + std**2).sum().item())
    gradients = []
    for _ in range(batches):
        policy = agent.policy(obs)
        actions = policy.sample()
        G = 10 - ((actions - c) ** 2).sum(-1)
        advantages = rf.compute_advantages(G, agent.value(obs).detach(), baseline)
        if baseline == "mean":  # G is 1/B of its own baseline
            advantages = advantages / (1 - 1 / B)
        loss = rf.policy_loss(policy.log_prob(actions), advantages)
        gradients.append(-torch.autograd.grad(loss, agent.actor[-1].bias)[0])
    return torch.stack(gradients), analytic


@every_baseline
def test_on_a_bandit_the_mean_gradient_is_the_analytic_one(baseline):
    gradients, analytic = bandit_gradients(baseline)
    standard_error = gradients.std(0) / math.sqrt(len(gradients))
    assert ((gradients.mean(0) - analytic).abs() < 3 * standard_error).all()
    if baseline != "none":  # and it is one: without a baseline the noise may hide it
        assert (analytic.abs() > 3 * standard_error).all()


def test_mean_and_std_of_actions_are_the_two_halves_of_what_the_actor_says():
    _, agent = make()
    agent.actor[-1].weight.data *= 30
    obs = torch.randn(50, 2)
    policy, outputs = agent.policy(obs), agent.actor(obs).detach()
    mean, std = outputs[:, :2], (1 + outputs[:, 2:].exp()).log() + 0.1
    torch.testing.assert_close(policy.mean, mean)
    torch.testing.assert_close(policy.stddev, std)
    assert len(std.unique()) == 100  # σ depends on the state
    actions = agent.act(obs.repeat(2000, 1).numpy())
    noise = (torch.tensor(actions).view(2000, 50, 2) - mean) / std
    assert noise.mean(0).abs().max() < 5 / math.sqrt(2000)
    torch.testing.assert_close(noise.flatten(0, 1).T.cov(), torch.eye(2), rtol=0, atol=0.02)


@pytest.mark.parametrize("world", LENGTHS)
def test_an_episode_is_made_of_real_steps_and_only_a_time_limit_is_bootstrapped(world):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    (env, agent), length = make(world), LENGTHS[world]
    starts = []
    for n in range(1, 4):
        obs, actions, rewards, last_value = rf.play(env, agent)
        assert env.unwrapped.total == n * length
        assert obs[:, 1].tolist() == list(range(length))
        (start,) = obs[:, 0].unique().tolist()
        starts.append(start)
        assert rewards == [1.0] * length
        assert actions.shape == (length, 2)
        expected = agent.critic(torch.tensor([start, length])).item()
        assert abs(expected) > 1e-3
        assert last_value == pytest.approx(expected if world == "Forever" else 0, rel=1e-5)
    assert len(set(starts)) == 3


def test_each_row_keeps_its_own_action_and_reward():
    """The action that is learned from, before clipping, is the one that earned the reward."""
    env, agent = make("Target")
    episodes = [rf.play(env, agent) for _ in range(50)]
    actions = torch.cat([x[1] for x in episodes]).numpy()
    env_actions = actions.clip(ACTIONS.low, ACTIONS.high)
    assert (actions != env_actions).any(1).sum() > 10
    expected = -np.square(env_actions - TARGET).sum(1)
    np.testing.assert_allclose([rewards[0] for _, _, rewards, _ in episodes], expected, rtol=1e-5)


def test_every_episode_starts_differently_also_those_of_other_seeds(monkeypatch):
    played = spy_episodes(monkeypatch)
    for seed in 1, 2:
        train(monkeypatch, rf, "--env-id", "ThreeSteps-v0", "--total-steps", 30, "--seed", seed)
    starts = {obs[0, 0].item() for _, (obs, *_) in played}
    assert len(starts) == len(played) == 2 * 12


def test_the_learning_rate_falls_in_a_straight_line(monkeypatch):
    rates = spy(monkeypatch, rf, "optimise", lambda _, optimizer, *__: (
        optimizer.param_groups[0]["lr"]))
    log = train(monkeypatch, rf, "--env-id", "ThreeSteps-v0", "--total-steps", 30,
                "--learning-rate", 0.02)
    assert rates == pytest.approx([0.02, 0.02 * (1 - 12 / 30), 0.02 * (1 - 24 / 30)])
    assert log["env_step"].tolist() == [12, 24, 36]  # 4 episodes an update, until 30 are reached


@every_baseline
def test_every_baseline_finds_a_good_action_in_an_asymmetric_box(baseline, tmp_path):
    path = SCRIPTS["reinforce_mujoco"].train(
        tmp_path, "--total-steps", 2048, "--learning-rate", 5e-3, "--baseline", baseline,
        env_id="Target-v0")
    log = read_log(f"{path}.csv")
    assert log["eval_return"].iloc[0] < -3
    assert log["eval_return"].iloc[-1] > -0.05
    assert log["return"].iloc[-12:].mean() > -0.15


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits(tmp_path):
    script = SCRIPTS["reinforce_mujoco"]
    path = script.train(
        tmp_path, "--gamma", 0.8, "--total-steps", 6400, "--batch-episodes", 4,
        "--learning-rate", 3e-3, env_id="Forever-v0")
    values = script.load_agent(path).value(torch.tensor([[0.0, t] for t in range(8)]))
    assert (values - 5).abs().max() < 0.5  # blind to the limit: from 4.2 down to 1


@pytest.mark.slow
def test_it_learns_to_balance_a_pole(tmp_path):
    path = SCRIPTS["reinforce_mujoco"].train(
        tmp_path, "--total-steps", 100_000, "--batch-episodes", 4, "--num-evals", 1)
    assert read_log(f"{path}.csv")["eval_return"].iloc[-1] > 500
