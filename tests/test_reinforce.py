"""The maths of reinforce_mujoco.py against definitions, hand numbers and analytic gradients."""

import math

import gymnasium as gym
import harness  # registers the worlds
import numpy as np
import pandas as pd
import pytest
import torch

import reinforce_mujoco as rf

BASELINES = ["none", "mean", "value"]


if "Endless-v0" not in gym.registry:
    harness.register("Endless", length=None)


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


def parse(world, options=""):
    sizes = "--num-evals 1 --eval-episodes 1"
    return rf.parse_args(f"--env-id {world}-v0 {sizes} {options}".split())


def make(world="ThreeSteps", options=""):
    """Arguments, an environment that has been seeded, and an agent for it."""
    args = parse(world, options)
    env = rf.record_episodes(gym.make(args.env_id))
    env.reset(seed=1)
    return args, env, rf.Agent(env.observation_space, env.action_space, args)


@pytest.fixture
def watched(tmp_path, monkeypatch):
    """Trains, and gives what went into and came out of the named functions; the agent; tables."""

    def train(world, options, *names, seed=1):
        calls = {name: [] for name in (*names, "Agent")}

        def record(name, function):
            def recorded(*args):
                calls[name].append((args, function(*args)))
                return calls[name][-1][1]

            return recorded

        with monkeypatch.context() as patch:
            for name in calls:
                patch.setattr(rf, name, record(name, getattr(rf, name)))
            rf.run(parse(world, options), seed, tmp_path / f"seed-{seed}")
        ((_, agent),) = calls.pop("Agent")
        return agent, calls, tmp_path / f"seed-{seed}"

    return train


def policy_networks(agent):
    return torch.nn.ModuleList((agent.trunk, agent.mean, agent.raw_std))


def log_density(agent, obs, samples):
    """log π(u|s) of independent Gaussians, written out; (B,)."""
    features = agent.trunk(obs)
    std = (1 + agent.raw_std(features).exp()).log() + 0.1
    noise = (samples - agent.mean(features)) / std
    return (-(noise**2) / 2 - std.log() - math.log(2 * math.pi) / 2).sum(1)


# --- Returns and advantages -----------------------------------------------------------------------


@pytest.mark.parametrize("last_return", [0.0, 7.5])
@pytest.mark.parametrize("gamma", [0.0, 0.9, 1.0])
def test_returns_are_the_discounted_rewards_from_a_step_on(gamma, last_return):
    rewards = np.random.default_rng(0).normal(size=30).tolist()
    expected = [
        sum(gamma ** (k - t) * rewards[k] for k in range(t, 30)) + gamma ** (30 - t) * last_return
        for t in range(30)
    ]
    returns = rf.discounted_returns(rewards, last_return, gamma)
    np.testing.assert_allclose(returns, expected)


def test_returns_of_a_very_long_episode_do_not_take_for_ever():
    returns = rf.discounted_returns([1.0] * 100_000, 0.0, 0.99)  # T²: 10,000,000,000 steps
    assert returns[0] == pytest.approx(100, rel=1e-4)
    assert returns[-2:].tolist() == pytest.approx([1.99, 1])


def test_advantages_by_hand():
    returns, values = torch.tensor([1.0, 2.0, 6.0]), torch.tensor([0.5, 3.0, 2.0])
    assert rf.compute_advantages(returns, torch.zeros(3), "none").tolist() == [1, 2, 6]
    assert rf.compute_advantages(returns, values, "value").tolist() == [0.5, -1, 4]
    std = math.sqrt((4 + 1 + 9) / 3)
    centred = rf.compute_advantages(returns, values, "mean")
    torch.testing.assert_close(centred, torch.tensor([-2.0, -1.0, 3.0]) / std)


def test_the_mean_baseline_leaves_mean_0_and_std_1():
    returns = 50 + 20 * torch.randn(1000)
    advantages = rf.compute_advantages(returns, torch.zeros(1000), "mean")
    assert abs(advantages.mean().item()) < 1e-5
    assert advantages.std().item() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("baseline", BASELINES)
def test_advantages_carry_no_gradient(baseline):
    values = torch.randn(5, requires_grad=True)
    assert not rf.compute_advantages(torch.randn(5), values, baseline).requires_grad


@pytest.mark.parametrize("returns", [[3.0], [3.0, 3.0, 3.0]])
def test_a_batch_of_equal_returns_has_finite_advantages(returns):
    """One step in all is such a batch, and the usual std of one number is NaN."""
    returns = torch.tensor(returns)
    advantages = rf.compute_advantages(returns, torch.zeros_like(returns), "mean")
    assert advantages.tolist() == [0.0] * len(returns)


# --- The gradient ---------------------------------------------------------------------------------


def test_losses_by_hand():
    log_probs = torch.tensor([-1.0, -2.0, 0.5], requires_grad=True)
    loss = rf.policy_loss(log_probs, torch.tensor([2.0, -1.0, 4.0]))
    assert loss.item() == pytest.approx(-(-2 + 2 + 2) / 3)
    loss.backward()
    torch.testing.assert_close(log_probs.grad, -torch.tensor([2.0, -1.0, 4.0]) / 3)
    values, targets = torch.tensor([1.0, 2.0, 0.0]), torch.tensor([3.0, 1.0, 0.0])
    assert rf.value_loss(values, targets).item() == pytest.approx((4 + 1 + 0) / 3 / 2)


@pytest.mark.parametrize("baseline", BASELINES)
@pytest.mark.parametrize("episodes", [1, 2])
def test_train_descends_the_gradient_of_the_loss_written_out(episodes, baseline, watched):
    """With 3 action dimensions, also in a batch of 3 steps, where axes are easily confused.

    At learning rate 0 the agent stays what it was, so that all can be computed again afterwards.
    """
    options = f"--batch-episodes {episodes} --total-steps 3 --learning-rate 0 --gamma 0.9"
    agent, calls, folder = watched("ThreeActions", f"{options} --baseline {baseline}", "rollout")
    ((_, (batch, _)),) = calls["rollout"]
    obs, samples = batch["obs"], batch["samples"]
    assert samples.shape == (3 * episodes, 3)
    returns = torch.tensor([1 + 0.9 * (1 + 0.9), 1 + 0.9, 1.0] * episodes)
    torch.testing.assert_close(batch["returns"], returns)
    advantages, loss_v = returns, None
    if baseline == "mean":
        advantages = (returns - returns.mean()) / returns.std(correction=0)
    if baseline == "value":
        values = agent.critic(obs)[:, 0]
        advantages = returns - values.detach()
        loss_v = ((values - returns) ** 2).sum() / (2 * len(returns))
    loss_pi = -(log_density(agent, obs, samples) * advantages).sum() / len(returns)
    parameters = list(policy_networks(agent).parameters())
    gradients = list(torch.autograd.grad(loss_pi, parameters))
    if loss_v is not None:
        gradients += torch.autograd.grad(loss_v, list(agent.critic.parameters()))
        parameters += agent.critic.parameters()
    assert len(parameters) == len(list(agent.parameters()))
    for p, gradient in zip(parameters, gradients):
        torch.testing.assert_close(p.grad, gradient, rtol=1e-4, atol=1e-6)
        assert gradient.abs().max() > 1e-4
    metrics = pd.read_csv(folder / "metrics.csv").iloc[0]
    assert metrics["policy_loss"] == pytest.approx(loss_pi.item(), rel=1e-4)
    if baseline == "value":
        assert metrics["value_loss"] == pytest.approx(loss_v.item(), rel=1e-4)


def test_an_update_forgets_the_gradient_of_the_one_before():
    args, env, agent = make()
    batch, _ = rf.rollout(env, agent, 2, 0.9, 0)
    optimizer, seen = torch.optim.SGD(agent.parameters(), lr=0.0), []
    for _ in range(2):
        rf.optimise(agent, optimizer, batch, args.baseline)
        seen.append([p.grad.clone() for p in agent.parameters()])
    torch.testing.assert_close(seen[0], seen[1])


def bandit_gradients(baseline, batches=2000, B=8):
    """Gradients of −loss with respect to (μ, pre-activation of σ), (batches, 4), and analytic.

    One step, one state, reward 10 − |u − c|². Its mean is 10 − Σ((μ − c)² + σ²), of which the
    derivatives are −2(μ − c) and −2σ·dσ.
    """
    _, _, agent = make("ThreeSteps", f"--baseline {baseline}")
    obs, c = torch.zeros(1, 2), torch.tensor([0.8, -0.5])
    mean, std = agent.policy(obs).mean[0].detach(), agent.policy(obs).stddev[0].detach()
    slope = torch.sigmoid(agent.raw_std(agent.trunk(obs))[0]).detach()  # of softplus
    analytic = torch.cat([-2 * (mean - c), -2 * std * slope])
    if baseline == "value":
        agent.critic[-1].bias.data.fill_(10 - ((mean - c) ** 2 + std**2).sum().item())
    heads = [agent.mean.bias, agent.raw_std.bias]
    obs, gradients = obs.expand(B, 2), []
    for _ in range(batches):
        policy = agent.policy(obs)
        samples = policy.sample()
        returns = 10 - ((samples - c) ** 2).sum(-1)
        advantages = rf.compute_advantages(returns, agent.value(obs), baseline)
        if baseline == "mean":  # undo the division by the std; a return is 1/B of its own baseline
            advantages = advantages * (returns - returns.mean()).norm() / advantages.norm()
            advantages = advantages / (1 - 1 / B)
        loss = rf.policy_loss(policy.log_prob(samples).sum(-1), advantages)
        gradients.append(-torch.cat(torch.autograd.grad(loss, heads)))
    return torch.stack(gradients), analytic


@pytest.fixture(scope="module")
def bandit():
    gradients = {}
    for baseline in BASELINES:
        torch.manual_seed(0)
        gradients[baseline] = bandit_gradients(baseline)
    return gradients


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


# --- Agent ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("baseline", BASELINES)
def test_there_is_a_critic_with_baseline_value_only(baseline):
    _, _, agent = make(options=f"--baseline {baseline}")
    obs = torch.randn(4, 5, 2)
    assert agent.value(obs).shape == (4, 5)
    if baseline == "value":
        torch.testing.assert_close(agent.value(obs), agent.critic(obs)[..., 0])
        assert len(agent.value(obs).unique()) == 20
    else:
        assert agent.critic is None
        assert not agent.value(obs).any()


def test_the_mean_of_the_distribution_is_what_the_mean_head_says():
    _, _, agent = make()
    policy, features = agent.policy(torch.ones(50, 2)), agent.trunk(torch.ones(50, 2))
    assert torch.equal(policy.mean, agent.mean(features))
    std = agent.policy(torch.randn(50, 2)).stddev
    assert len(std.unique()) == 100  # σ depends on the state


@pytest.mark.parametrize("mean", [-100, 100])
@pytest.mark.parametrize("raw_std", [-100, -20, 100])
def test_extreme_pre_activations_stay_finite_and_go_on_learning(mean, raw_std):
    _, _, agent = make()
    for head, value in (agent.mean, mean), (agent.raw_std, raw_std):
        head.weight.data.zero_()
        head.bias.data.fill_(value)
    policy = agent.policy(torch.randn(20, 2))
    samples = policy.sample()
    log_probs = policy.log_prob(samples).sum(-1)
    (-log_probs.mean()).backward()
    assert samples.isfinite().all()
    assert log_probs.isfinite().all()
    assert policy.stddev.min().item() == pytest.approx(max(raw_std, 0) + 0.1)  # the floor
    assert all(p.grad.isfinite().all() for p in policy_networks(agent).parameters())
    assert (agent.mean.bias.grad != 0).all()
    if raw_std >= -20:
        assert (agent.raw_std.bias.grad != 0).all()


def test_the_environment_gets_actions_within_its_bounds_though_samples_may_be_beyond():
    _, env, agent = make()
    obs = np.float32(np.random.default_rng(0).normal(size=(200, 2)))
    samples, actions = agent.act(obs)
    assert ((samples < harness.ACTIONS.low) | (samples > harness.ACTIONS.high)).any()
    np.testing.assert_array_equal(actions, samples.clip(harness.ACTIONS.low, harness.ACTIONS.high))
    agent.mean.bias.data.fill_(30.0)
    batch, _ = rf.rollout(env, agent, 1, 0.9, 0)  # the world asserts its bounds
    assert batch["samples"].min() > 20


def test_an_unbounded_box_works():
    _, env, agent = make("Unbounded")
    agent.mean.bias.data.fill_(1e4)
    samples, actions = agent.act(np.zeros((5, 2)))
    np.testing.assert_array_equal(samples, actions)
    assert actions.min() > 9000
    rf.rollout(env, agent, 1, 0.9, 0)


def test_samples_are_as_the_distribution_says():
    _, _, agent = make()
    obs = np.float32([[1, 2]])
    samples, _ = agent.act(np.repeat(obs, 20_000, axis=0))
    policy = agent.policy(torch.as_tensor(obs[0]))
    mean, std = policy.mean.detach().numpy(), policy.stddev.detach().numpy()
    np.testing.assert_allclose(samples.mean(0), mean, atol=4 * std.max() / math.sqrt(20_000))
    np.testing.assert_allclose(samples.std(0), std, rtol=0.02)
    assert abs(np.corrcoef(samples.T)[0, 1]) < 0.03


def test_deterministic_actions_are_those_of_the_mean():
    _, _, agent = make()
    obs = np.float32(np.random.default_rng(0).normal(size=(20, 2)))
    samples, actions = agent.act(obs, deterministic=True)
    mean = agent.policy(torch.as_tensor(obs)).mean.detach().numpy()
    np.testing.assert_allclose(samples, mean, rtol=1e-6)
    np.testing.assert_array_equal(actions, samples.clip(harness.ACTIONS.low, harness.ACTIONS.high))
    sampled, _ = agent.act(obs)
    assert len(np.unique(sampled - samples)) == samples.size  # each has its own noise


# --- Rollout --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("world", "length"), [("ThreeSteps", 3), ("Forever", 8), ("BothEnds", 3)])
def test_every_row_is_of_a_real_step(world, length):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    _, env, agent = make(world, "--baseline none")
    batch, episodes = rf.rollout(env, agent, 3, 0.0, 100)
    assert env.unwrapped.total == 3 * length
    assert batch["obs"][:, 1].tolist() == list(range(length)) * 3
    assert all(len(rows.unique()) == 1 for rows in batch["obs"][:, 0].split(length))
    assert batch["returns"].tolist() == [1.0] * 3 * length  # γ = 0
    assert batch["samples"].shape == (3 * length, 2)
    assert all(x.dtype == torch.float32 for x in batch.values())
    assert episodes == [{"env_step": 100 + length * i, "return": length, "length": length}
                        for i in (1, 2, 3)]


def test_each_row_keeps_its_own_sample_and_reward(watched):
    """The sample that is learned from, unclipped, is the one whose action earned the reward."""
    options = "--batch-episodes 50 --total-steps 50 --learning-rate 0 --baseline none"
    agent, calls, folder = watched("Target", options, "policy_loss", "rollout")
    (((log_probs, advantages), _),) = calls["policy_loss"]
    ((_, (batch, _)),) = calls["rollout"]
    samples = batch["samples"]
    torch.testing.assert_close(log_probs, log_density(agent, batch["obs"], samples))
    actions = samples.numpy().clip(harness.ACTIONS.low, harness.ACTIONS.high)
    assert (actions != samples.numpy()).any(1).sum() > 10
    rewards = -np.square(actions - harness.TARGET).sum(1)
    np.testing.assert_allclose(advantages, rewards, rtol=1e-5)
    np.testing.assert_allclose(pd.read_csv(folder / "episodes.csv")["return"], rewards, rtol=1e-5)


@pytest.mark.parametrize("baseline", BASELINES)
@pytest.mark.parametrize(("world", "length"), [("ThreeSteps", 3), ("Forever", 8), ("BothEnds", 3)])
def test_only_a_time_limit_is_bootstrapped_and_only_with_a_critic(world, length, baseline):
    _, env, agent = make(world, f"--baseline {baseline}")
    batch, _ = rf.rollout(env, agent, 4, 0.9, 0)
    for obs, returns in zip(batch["obs"].split(length), batch["returns"].split(length)):
        last = 0.0
        if world == "Forever" and baseline == "value":
            last = agent.critic(torch.tensor([obs[0, 0], length])).item()
            assert abs(last) > 1e-3
        expected = [sum(0.9**k for k in range(n)) + 0.9**n * last for n in range(length, 0, -1)]
        torch.testing.assert_close(returns, torch.tensor(expected))


def test_every_episode_starts_differently_also_those_of_other_seeds(watched):
    starts = []
    for seed in 1, 2:
        _, calls, _ = watched("ThreeSteps", "--total-steps 30", "rollout", seed=seed)
        for _, (batch, _) in calls["rollout"]:
            starts += batch["obs"][batch["obs"][:, 1] == 0, 0].tolist()
    assert len(set(starts)) == len(starts) == 2 * 12


@pytest.mark.parametrize("fault", ["nan", "inf", "blind"])
@pytest.mark.parametrize("step", [5, 6])
def test_nan_and_infinity_end_a_rollout_and_name_the_step(fault, step):
    """In a reward or an observation (blind), also in the last ones of an episode, at step 6."""
    _, env, agent = make()
    rf.rollout(env, agent, 1, 0.9, 0)
    env.unwrapped.fault, env.unwrapped.fault_at = fault, step
    with pytest.raises(SystemExit) as end:
        rf.rollout(env, agent, 4, 0.9, 3)
    assert end.value.code == f"error: environment 0 returned NaN or infinity at its step {step}"


def test_an_episode_without_a_time_limit_is_cut_off_after_10_000_steps():
    args, env, agent = make("Endless")
    batch, episodes = rf.rollout(env, agent, 1, 0.9, 0)
    assert episodes == [{"env_step": 10_000, "return": 10_000, "length": 10_000}]
    last = agent.value(torch.tensor([batch["obs"][0, 0], 10_000.0])).item()
    assert batch["returns"][-1].item() == pytest.approx(1 + 0.9 * last, rel=1e-5)
    assert rf.evaluate(agent, [env], 1)["length_mean"] == 10_000


# --- Training and evaluation ----------------------------------------------------------------------


def test_every_episode_is_logged_once_with_its_raw_return_and_length(watched):
    """Asked for 30 steps, 4 episodes an update: ends after the third update, at 36."""
    _, _, folder = watched("ThreeSteps", "--total-steps 30 --gamma 0.5")
    episodes, metrics = (pd.read_csv(folder / f"{x}.csv") for x in ("episodes", "metrics"))
    assert episodes["env_step"].tolist() == list(range(3, 37, 3))
    assert (episodes[["return", "length"]] == 3).all(axis=None)
    assert metrics["env_step"].tolist() == [12, 24, 36]


def test_train_yields_the_start_and_then_every_update_once():
    env_steps, agents, optimizers, episodes, diagnostics = zip(
        *rf.train(parse("ThreeSteps", "--total-steps 30"), 1))
    assert env_steps == (0, 12, 24, 36)
    assert len(set(agents)) == len(set(optimizers)) == 1
    assert [[row["env_step"] for row in rows] for rows in episodes] == [
        [], [3, 6, 9, 12], [15, 18, 21, 24], [27, 30, 33, 36]]
    assert diagnostics[0] == {}
    assert len({x["gradient_norm"] for x in diagnostics[1:]}) == 3


def test_the_learning_rate_falls_in_a_straight_line():
    rates = {}
    args = parse("ThreeSteps", "--total-steps 30 --learning-rate 0.02")
    for env_step, agent, optimizer, _, diagnostics in rf.train(args, 1):
        (group,) = optimizer.param_groups
        assert {id(p) for p in group["params"]} == {id(p) for p in agent.parameters()}
        if diagnostics:  # an update was made, with this rate
            rates[env_step] = group["lr"]
    expected = {12: 0.02, 24: 0.02 * (1 - 12 / 30), 36: 0.02 * (1 - 24 / 30)}
    assert rates == pytest.approx(expected)


def test_the_log_shows_the_policy_that_acted(watched):
    options = "--total-steps 1 --batch-episodes 2 --baseline value"
    agent, calls, folder = watched("ThreeSteps", f"{options} --learning-rate 0", "rollout")
    metrics = pd.read_csv(folder / "metrics.csv").iloc[0]
    ((_, (batch, _)),) = calls["rollout"]
    std = agent.policy(batch["obs"]).stddev
    entropy = (std.log() + 0.5 * math.log(2 * math.pi * math.e)).sum(1).mean()
    assert metrics["entropy"] == pytest.approx(entropy.item(), rel=1e-4)
    assert metrics["policy_std"] == pytest.approx(std.mean().item(), rel=1e-4)
    squares = sum((p.grad**2).sum().item() for p in policy_networks(agent).parameters())
    assert metrics["gradient_norm"] == pytest.approx(math.sqrt(squares), rel=1e-4)


def test_the_first_evaluation_comes_before_training_the_others_evenly(watched):
    options = "--total-steps 72 --num-evals 3 --eval-episodes 2 --batch-episodes 4"
    _, _, folder = watched("ThreeSteps", options)
    evals = pd.read_csv(folder / "evals.csv").drop(columns="seconds")
    assert evals["env_step"].tolist() == [0, 24, 48, 72]
    assert evals.columns[1:].tolist() == ["return_mean", "return_std", "length_mean", "episodes"]
    assert (evals.iloc[:, 1:] == [3, 0, 3, 2]).all(axis=None)


def test_an_evaluation_plays_the_means_whatever_the_noise():
    """The same as one episode after the other by hand; each seed is another episode."""
    args = rf.parse_args([])
    envs = [rf.record_episodes(gym.make(args.env_id)) for _ in range(5)]
    agent = rf.Agent(envs[0].observation_space, envs[0].action_space, args)
    agent.mean.weight.data *= 30
    results = []
    for seed in 1, 0, 0:  # so the environments have been used before
        torch.manual_seed(len(results))
        results.append(rf.evaluate(agent, envs, seed))
    returns, lengths = [], []
    env = gym.make(args.env_id)
    for seed in rf.make_seeds(0, stream=1, count=5):
        obs, _ = env.reset(seed=seed)
        ended, total, length = False, 0, 0
        while not ended:
            mean = agent.policy(torch.as_tensor(obs, dtype=torch.float32)).mean
            action = mean.detach().numpy().clip(env.action_space.low, env.action_space.high)
            obs, reward, terminated, truncated, _ = env.step(action)
            ended, total, length = terminated or truncated, total + reward, length + 1
        returns.append(total)
        lengths.append(length)
    assert len(set(returns)) > 1
    expected = {"return_mean": np.mean(returns), "return_std": np.std(returns),
                "length_mean": np.mean(lengths), "episodes": 5}
    assert results[1] == results[2] == pytest.approx(expected)
    assert results[0] != results[1]


# --- Learning -------------------------------------------------------------------------------------


@pytest.mark.parametrize("baseline", BASELINES)
def test_every_baseline_finds_a_good_action_in_an_asymmetric_box(baseline, watched):
    options = f"--batch-episodes 16 --total-steps 4096 --baseline {baseline}"
    _, _, folder = watched("Target", options)  # at first about -4
    evals = pd.read_csv(folder / "evals.csv")["return_mean"]
    assert evals.iloc[0] < -1
    assert evals.iloc[-1] > -0.05
    assert pd.read_csv(folder / "episodes.csv")["return"][-100:].mean() > -0.05


def test_the_value_network_learns_what_a_state_is_worth(watched):
    """Reward 1 for ever is worth 1 / (1 − γ), despite time limits; without bootstrap it is less."""
    options = "--baseline value --gamma 0.8 --total-steps 6400 --learning-rate 3e-3"
    agent, _, _ = watched("Forever", options)
    obs = torch.tensor([[0.0, t] for t in range(8)])
    assert (agent.value(obs) - 5).abs().max() < 0.5


def test_it_learns_to_balance_a_pole(tmp_path):
    args = rf.parse_args(["--total-steps", "15000", "--num-evals", "1"])
    rf.run(args, 1, tmp_path / "seed-1")
    assert pd.read_csv(tmp_path / "seed-1/evals.csv")["return_mean"].iloc[-1] > 30
    episodes = pd.read_csv(tmp_path / "seed-1/episodes.csv")["return"]
    assert episodes[-20:].mean() > 2.5 * episodes[:20].mean()
