"""reinforce_mujoco.py: its maths by hand, its policy, its episodes, and what it learns."""

import math

import numpy as np
import pytest
import torch
from conftest import SCRIPTS
from gymnasium.spaces import Box
from harness import ACTIONS, TARGET, World, register, table

import reinforce_mujoco as rf

every_baseline = pytest.mark.parametrize("baseline", ["none", "mean", "value"])
LENGTHS = {"ThreeSteps": 3, "Forever": 8, "BothEnds": 3}


class Rising(World):
    """The reward of a step is its number, from 1 on."""

    def reward(self, action):
        return float(self.steps)


register("Rising", Rising, actions=Box(-1, 1, (3,)))


def make(options="", env="ThreeSteps-v0"):
    """Arguments, an environment that has been seeded, and an agent for it."""
    args = rf.parse_args(["--env-id", env, *options.split()])
    envs = rf.make_envs(args.env_id, 1, "Disabled")
    envs.reset(seed=1)
    return args, envs, rf.Agent(envs.single_observation_space, envs.single_action_space, args)


def train(args, envs, agent, seed=1):
    """All that `train` yields."""
    return list(rf.train(args, seed, envs, agent, torch.optim.Adam(agent.parameters())))


@pytest.fixture
def batches(monkeypatch):
    """Those that `train` plays."""
    batches, rollout = [], rf.rollout

    def spy(*args):
        batch, episodes = rollout(*args)
        batches.append(batch)
        return batch, episodes

    monkeypatch.setattr(rf, "rollout", spy)
    return batches


# --- Returns and advantages -----------------------------------------------------------------------


@pytest.mark.parametrize("last_value", [0.0, 7.5])
@pytest.mark.parametrize("gamma", [0.0, 0.9, 1.0])
def test_returns_are_the_discounted_rewards_from_a_step_on(gamma, last_value):
    rewards = np.random.default_rng(0).normal(size=30).tolist()
    expected = [
        sum(gamma ** (k - t) * rewards[k] for k in range(t, 30)) + gamma ** (30 - t) * last_value
        for t in range(30)]
    assert rf.discounted_returns(rewards, last_value, gamma) == pytest.approx(expected)


# --- The gradient ---------------------------------------------------------------------------------


@every_baseline
@pytest.mark.parametrize("episodes", [1, 2])
def test_train_descends_the_gradient_of_the_loss_written_out(episodes, baseline, batches):
    """With 3 action dimensions, also in a batch of 3 steps, where axes are easily confused.

    At learning rate 0 the agent stays what it was, so that all can be computed again afterwards.
    """
    args, envs, agent = make(
        f"--batch-episodes {episodes} --total-steps 3 --learning-rate 0 --gamma 0.9 "
        f"--baseline {baseline}", "Rising-v0")
    parameters = list(agent.parameters())
    for p in parameters:
        p.grad = torch.ones_like(p)  # of an update before, say
    _, (_, _, (metrics,)) = train(args, envs, agent)
    (batch,) = batches
    assert batch.actions.shape == (3 * episodes, 3)
    returns = torch.tensor([1 + 0.9 * (2 + 0.9 * 3), 2 + 0.9 * 3, 3.0] * episodes)
    values = agent.critic(batch.obs)[:, 0]
    expected = {"value_loss": ((values - returns) ** 2).sum() / (2 * len(returns))}
    advantages = {"none": returns, "value": returns - values.detach(),
                  "mean": returns - returns.mean()}[baseline]
    outputs = agent.actor(batch.obs)
    std = (1 + outputs[:, 3:].exp()).log() + 0.1
    noise = (batch.actions - outputs[:, :3]) / std
    log_density = (-(noise**2) / 2 - std.log() - math.log(2 * math.pi) / 2).sum(1)
    expected["policy_loss"] = -(log_density * advantages).sum() / len(returns)
    gradients = torch.autograd.grad(sum(expected.values()), parameters, retain_graph=True)
    for p, gradient in zip(parameters, gradients):
        torch.testing.assert_close(p.grad, gradient, rtol=1e-4, atol=1e-6)
        assert gradient.abs().max() > 1e-4
    expected |= {"policy_std": std.mean(), "env_step": torch.tensor(3 * episodes)}
    assert metrics == {name: pytest.approx(x.item(), rel=1e-4) for name, x in expected.items()}


def bandit_gradients(baseline, batches=1000, B=8):
    """Gradients of −loss with respect to (μ, pre-activation of σ), (batches, 4), and analytic.

    One step, one state, reward 10 − |a − c|². Its mean is 10 − Σ((μ − c)² + σ²), of which the
    derivatives are −2(μ − c) and −2σ·dσ.
    """
    _, _, agent = make(f"--baseline {baseline}")
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
        returns = 10 - ((actions - c) ** 2).sum(-1)
        advantages = rf.compute_advantages(returns, agent.value(obs), baseline)
        if baseline == "mean":  # a return is 1/B of its own baseline
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


# --- Agent ----------------------------------------------------------------------------------------


def test_mean_and_std_of_actions_are_the_two_halves_of_what_the_actor_says():
    _, _, agent = make()
    agent.actor[-1].weight.data *= 30
    obs = torch.randn(50, 2)
    policy, outputs = agent.policy(obs), agent.actor(obs).detach()
    mean, std = outputs[:, :2], (1 + outputs[:, 2:].exp()).log() + 0.1
    torch.testing.assert_close(policy.mean, mean)
    torch.testing.assert_close(policy.stddev, std)
    assert len(std.unique()) == 100  # σ depends on the state
    actions = agent.act(obs.repeat(2000, 1).numpy())
    noise = (torch.as_tensor(actions).view(2000, 50, 2) - mean) / std
    assert noise.mean(0).abs().max() < 5 / math.sqrt(2000)
    torch.testing.assert_close(noise.flatten(0, 1).T.cov(), torch.eye(2), rtol=0, atol=0.02)


@pytest.mark.parametrize("mean", [-100, 100])
@pytest.mark.parametrize("raw_std", [-100, -20, 100])
def test_extreme_pre_activations_stay_finite_and_go_on_learning(mean, raw_std):
    _, _, agent = make()
    agent.actor[-1].weight.data.zero_()
    agent.actor[-1].bias.data = torch.tensor([mean, mean, raw_std, raw_std], dtype=torch.float32)
    policy = agent.policy(torch.randn(20, 2))
    actions = policy.sample()
    log_probs = policy.log_prob(actions)
    (-log_probs.mean()).backward()
    assert actions.isfinite().all()
    assert log_probs.isfinite().all()
    assert policy.stddev.min().item() == pytest.approx(max(raw_std, 0) + 0.1)  # the floor
    assert all(p.grad.isfinite().all() for p in agent.actor.parameters())
    learning = agent.actor[-1].bias.grad != 0
    assert learning[:2].all()
    if raw_std >= -20:
        assert learning[2:].all()


# --- Episodes -------------------------------------------------------------------------------------


@pytest.mark.parametrize("world", LENGTHS)
def test_every_row_is_of_a_real_step_of_whole_episodes(world):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    args, envs, agent = make("--batch-episodes 3 --gamma 0 --baseline none", f"{world}-v0")
    batch, episodes = rf.rollout(envs, agent, args, 100)
    length = LENGTHS[world]
    assert envs.unwrapped.envs[0].unwrapped.total == 3 * length
    assert batch.obs[:, 1].tolist() == list(range(length)) * 3
    shown = [rows.unique().tolist() for rows in batch.obs[:, 0].split(length)]
    assert [len(episode) for episode in shown] == [1, 1, 1]
    assert len({number for (number,) in shown}) == 3
    assert batch.returns.tolist() == [1.0] * 3 * length  # γ = 0
    assert batch.actions.shape == (3 * length, 2)
    assert all(x.dtype == torch.float32 for x in vars(batch).values())
    assert episodes == [{"env_step": 100 + length * i, "return": length, "length": length}
                        for i in (1, 2, 3)]


def test_each_row_keeps_its_own_action_and_reward():
    """The action that is learned from, before clipping, is the one that earned the reward."""
    args, envs, agent = make("--batch-episodes 50 --baseline none", "Target-v0")
    batch, episodes = rf.rollout(envs, agent, args, 0)
    actions = batch.actions.numpy()
    env_actions = actions.clip(ACTIONS.low, ACTIONS.high)
    assert (actions != env_actions).any(1).sum() > 10
    rewards = -np.square(env_actions - TARGET).sum(1)
    np.testing.assert_allclose(batch.returns, rewards, rtol=1e-5)
    np.testing.assert_allclose([row["return"] for row in episodes], rewards, rtol=1e-5)


@pytest.mark.parametrize("world", LENGTHS)
def test_only_a_time_limit_is_bootstrapped(world):
    args, envs, agent = make("--gamma 0.9", f"{world}-v0")
    batch, _ = rf.rollout(envs, agent, args, 0)
    length = LENGTHS[world]
    for obs, returns in zip(batch.obs.split(length), batch.returns.split(length)):
        last_value = 0.0
        if world == "Forever":
            last_value = agent.critic(torch.tensor([obs[0, 0], length])).item()
            assert abs(last_value) > 1e-3
        expected = [
            sum(0.9**k for k in range(n)) + 0.9**n * last_value for n in range(length, 0, -1)]
        torch.testing.assert_close(returns, torch.tensor(expected))


def test_every_episode_starts_differently_also_those_of_other_seeds(batches):
    for seed in 1, 2:
        train(*make("--total-steps 30"), seed)
    starts = [number for batch in batches for number in batch.obs[::3, 0].tolist()]
    assert len(set(starts)) == len(starts) == 2 * 12


# --- Training -------------------------------------------------------------------------------------


def test_train_yields_before_the_first_update_and_after_each():
    """Every episode is in it once, with its raw return, its length and when it ended.

    Asked for 30 steps, 4 episodes an update: ends after the third update, at 36.
    """
    env_steps, episodes, metrics = zip(*train(*make("--total-steps 30 --gamma 0.5")))
    assert env_steps == (0, 12, 24, 36)
    assert episodes == ([], *(
        [{"env_step": env_step, "return": 3, "length": 3} for env_step in range(begin, end, 3)]
        for begin, end in ((3, 15), (15, 27), (27, 39))))
    assert metrics[0] == []
    assert [row["env_step"] for (row,) in metrics[1:]] == [12, 24, 36]
    assert len({row["policy_loss"] for (row,) in metrics[1:]}) == 3


def test_the_learning_rate_falls_in_a_straight_line():
    args, envs, agent = make("--total-steps 30 --learning-rate 0.02")
    optimizer, rates = torch.optim.Adam(agent.parameters()), []
    for _ in rf.train(args, 1, envs, agent, optimizer):
        rates.append(optimizer.param_groups[0]["lr"])
    assert rates[1:] == pytest.approx([0.02, 0.02 * (1 - 12 / 30), 0.02 * (1 - 24 / 30)])


# --- Learning -------------------------------------------------------------------------------------


@every_baseline
def test_every_baseline_finds_a_good_action_in_an_asymmetric_box(baseline, tmp_path):
    folder = SCRIPTS["reinforce_mujoco"].train(
        tmp_path, "--total-steps", 2048, "--learning-rate", 5e-3, "--baseline", baseline,
        env_id="Target-v0")
    evals = table(folder / "evals.csv")["return_mean"]
    assert evals.iloc[0] < -3
    assert evals.iloc[-1] > -0.05
    assert table(folder / "episodes.csv")["return"][-100:].mean() > -0.15


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits(tmp_path):
    folder = SCRIPTS["reinforce_mujoco"].train(
        tmp_path, "--gamma", 0.8, "--total-steps", 6400, "--batch-episodes", 4,
        "--learning-rate", 3e-3, env_id="Forever-v0")
    _, _, agent = make()
    agent.load_state_dict(torch.load(folder / "checkpoint.pt", weights_only=True)["agent"])
    obs = torch.tensor([[0.0, t] for t in range(8)])
    assert (agent.value(obs) - 5).abs().max() < 0.5  # blind to the limit: from 4.2 down to 1


@pytest.mark.slow
def test_it_learns_to_balance_a_pole(tmp_path):
    folder = SCRIPTS["reinforce_mujoco"].train(
        tmp_path, "--total-steps", 15000, "--batch-episodes", 4, "--num-evals", 1,
        "--eval-episodes", 20)
    assert table(folder / "evals.csv")["return_mean"].iloc[-1] > 30
    episodes = table(folder / "episodes.csv")["return"]
    assert episodes[-20:].mean() > 2.5 * episodes[:20].mean()
