"""The maths of ppo_continuous.py against definitions, hand numbers and torch.distributions."""

import math

import gymnasium as gym
import harness  # registers the worlds
import numpy as np
import pytest
import torch
from torch.distributions import Normal, TransformedDistribution, kl_divergence
from torch.distributions.transforms import TanhTransform

import ppo_continuous as ppo

SIZES = "--num-envs 4 --rollout-steps 25 --minibatch-size 33 --total-steps 100 --target-kl 0"


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


def make(env="ThreeSteps", options=""):
    """Arguments, vector environment, its first observations, and an agent for it."""
    args = ppo.parse_args(f"--env-id harness:{env}-v0 {SIZES} {options}".split())
    envs = ppo.make_envs(args.env_id, args.num_envs)
    obs, _ = envs.reset(seed=ppo.make_seeds(1, stream=2, count=args.num_envs))
    return args, envs, obs, ppo.make_agent(args, gym.make(args.env_id))


def play(env="ThreeSteps", options="", mean=None):
    """One rollout, of a policy with μ near `mean`: arguments, agent, transitions, episodes."""
    args, envs, obs, agent = make(env, options)
    if mean is not None:
        agent["policy"].mean_net[-1].bias.data.fill_(mean)
    transitions, _, episodes = ppo.rollout(envs, agent["policy"], obs, args.rollout_steps, 0)
    return args, agent, transitions, episodes


def make_policy(options=""):
    return make(options=options)[-1]["policy"]


def log_prob(agent, states, latents):
    return ppo.gaussian_log_prob(latents, *agent["policy"](states))


def adam(agent, lr):
    return torch.optim.Adam(agent.parameters(), lr=lr)


def random_batch(T=7, N=3):
    """Rewards, values, next values (T, N) and random flags: terminated, done."""
    rewards, values, next_values = torch.randn(3, T, N, dtype=torch.float64)
    terminated, truncated = torch.rand(2, T, N) < 0.25
    return rewards, values, next_values, terminated, terminated | truncated


# --- Advantages -----------------------------------------------------------------------------------


@pytest.mark.parametrize("gae_lambda", [0.0, 0.7, 1.0])
@pytest.mark.parametrize("gamma", [0.9, 1.0])
def test_gae_is_the_discounted_sum_of_td_errors_within_an_episode(gamma, gae_lambda):
    rewards, values, next_values, terminated, done = batch = random_batch(T=40, N=5)
    assert 0 < terminated.sum() < done.sum() < done.numel()
    expected = torch.zeros_like(rewards)
    for n in range(5):
        for t in range(40):
            for k in range(40 - t):
                i = t + k, n
                bootstrap = 0 if terminated[i] else next_values[i]
                delta = rewards[i] + gamma * bootstrap - values[i]
                expected[t, n] += (gamma * gae_lambda) ** k * delta
                if done[i]:
                    break
    torch.testing.assert_close(ppo.compute_gae(*batch, gamma, gae_lambda), expected)


@pytest.mark.parametrize("ends_by", ["termination", "time limit"])
def test_nothing_after_the_end_of_an_episode_reaches_the_steps_before(ends_by):
    rewards, values, next_values, terminated, done = random_batch()
    done[3] = True
    terminated[3] = ends_by == "termination"
    before = ppo.compute_gae(rewards, values, next_values, terminated, done, 0.99, 0.95)
    for x in rewards, values, next_values:
        x[4:] = math.nan  # NaN, since 0 · NaN would still be NaN
    if ends_by == "termination":
        next_values[3] = math.nan
    after = ppo.compute_gae(rewards, values, next_values, terminated, done, 0.99, 0.95)
    assert torch.equal(before[:4], after[:4])
    assert before.isfinite().all()


def test_a_time_limit_is_bootstrapped():
    one, no, yes = torch.ones(1, 1), torch.tensor([[False]]), torch.tensor([[True]])
    advantage = ppo.compute_gae(one, 2 * one, 10 * one, no, yes, 0.9, 0.95)
    assert advantage.item() == pytest.approx(1 + 0.9 * 10 - 2)


def test_terminated_and_out_of_time_at_once_is_not_bootstrapped():
    args, agent, transitions, _ = play("BothEnds")
    _, _, rewards, _, terminated, done = transitions.values()
    assert torch.equal(terminated, done)
    values, next_values = torch.randn(2, *rewards.shape)
    advantages = ppo.compute_gae(rewards, values, next_values, terminated, done, 0.9, 0.95)
    torch.testing.assert_close((advantages + values)[done], rewards[done])


def test_the_last_row_of_a_rollout_and_a_rollout_of_one_step_learn():
    rewards, values, next_values, terminated, done = batch = random_batch(T=1, N=64)
    delta = rewards + 0.9 * next_values - values
    advantages = ppo.compute_gae(*batch, 0.9, 0.95)
    torch.testing.assert_close(advantages[~terminated], delta[~terminated])
    batch = random_batch(T=6, N=64)
    last = ppo.compute_gae(*(x[-1:] for x in batch), 0.9, 0.95)
    torch.testing.assert_close(ppo.compute_gae(*batch, 0.9, 0.95)[-1:], last)


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits(tmp_path):
    options = "--gamma 0.9 --total-steps 6400 --rollout-steps 32 --eval-every 0"
    args, _, _, agent = make("Forever", f"{options} --learning-rate 3e-3")
    ppo.train(args, 1, tmp_path / "seed-1", tmp_path / "stop")
    checkpoint = torch.load(tmp_path / "seed-1/checkpoint.pt", weights_only=True)
    agent.load_state_dict(checkpoint["agent"])
    obs = torch.tensor([[0.0, steps] for steps in range(8)])
    raw_values = agent["critic"](obs) * agent["reward_norm"].var.sqrt()
    assert (raw_values - 10).abs().max() < 1, raw_values  # blind to the limit: at most 5.7


# --- Ratio, losses --------------------------------------------------------------------------------


@pytest.mark.parametrize("squash", ["tanh", "clip"])
@pytest.mark.parametrize(("log_std", "mean"), [(-0.5, 0.0), (2.0, 30.0)], ids=["fresh", "far"])
def test_the_ratio_stays_1_while_the_policy_does(log_std, mean, squash):
    args, agent, transitions, _ = play(options=f"--squash {squash} --log-std {log_std}", mean=mean)
    agent["policy"].norm.update(torch.randn(50, 2))
    for states, latents, old_log_probs, *_ in ppo.minibatches(transitions, *rows_of(agent), args):
        ratio = (log_prob(agent, states, latents) - old_log_probs).exp()
        assert (ratio - 1).abs().max() < 1e-5
    metrics = ppo.optimise(agent, adam(agent, lr=0), transitions, args)
    assert metrics["clip_fraction"] == 0
    assert abs(metrics["approx_kl"]) < 1e-6


def rows_of(agent):
    return agent["policy"], agent["critic"]


def test_policies_acting_and_learning_see_the_same_density():
    """What rollout stores has the density that it was drawn from: N(μ(s), σ²), not clipped."""
    _, agent, transitions, _ = play(options="--log-std 1")
    states, latents, *_ = transitions.values()
    noise = (latents - agent["policy"](states)[0]) / math.exp(1.0)
    assert abs(noise.mean()) < 0.3
    assert abs(noise.std() - 1) < 0.2


def test_log_probability_and_entropy_are_those_of_torch():
    mean, u = torch.randn(2, 100, 3, dtype=torch.float64)
    log_std = torch.tensor([-3.0, 0.5, 1.0], dtype=torch.float64)
    normal = Normal(mean, log_std.exp())
    ours = ppo.gaussian_log_prob(u, mean, log_std)
    torch.testing.assert_close(ours, normal.log_prob(u).sum(-1), rtol=1e-12, atol=0)
    entropy = ppo.gaussian_entropy(log_std).expand(100)
    torch.testing.assert_close(entropy, normal.entropy().sum(-1), rtol=1e-12, atol=0)


def test_the_jacobian_of_tanh_cancels_in_the_ratio():
    old, new = (make_policy(f"--log-std {x}").double() for x in (-0.5, 0.2))
    new.mean_net[-1].bias.data += 0.7
    obs = torch.randn(1000, 2, dtype=torch.float64)
    latents = torch.randn(1000, 2, dtype=torch.float64)
    action = torch.tanh(latents)
    squashed, gaussian = [], []
    for policy in old, new:
        mean, log_std = policy(obs)
        tanh_normal = TransformedDistribution(Normal(mean, log_std.exp()), [TanhTransform()])
        squashed.append(tanh_normal.log_prob(action).sum(-1))
        gaussian.append(ppo.gaussian_log_prob(latents, mean, log_std))
    assert (squashed[0] - gaussian[0]).abs().max() > 0.1  # the densities themselves do differ
    torch.testing.assert_close((squashed[1] - squashed[0]).exp(), (gaussian[1] - gaussian[0]).exp())


def test_policy_loss_by_hand_and_no_gradient_where_it_is_clipped():
    ratio = torch.tensor([0.5, 1.5, 0.5, 1.5, 1.1], requires_grad=True)
    advantages = torch.tensor([1.0, 1.0, -1.0, -1.0, 2.0])
    loss = ppo.policy_loss(ratio, advantages, 0.2)
    assert loss.item() == pytest.approx(-(0.5 + 1.2 - 0.8 - 1.5 + 2.2) / 5)
    loss.backward()
    torch.testing.assert_close(ratio.grad, -torch.tensor([1.0, 0.0, 0.0, -1.0, 2.0]) / 5)


def test_policy_loss_starts_as_the_policy_gradient():
    _, agent, transitions, _ = play()
    states, latents, *_ = transitions.values()
    log_probs = log_prob(agent, states, latents).flatten()
    advantages = torch.randn(len(log_probs))
    parameters = list(agent["policy"].parameters())
    ratio = (log_probs - log_probs.detach()).exp()
    loss = ppo.policy_loss(ratio, advantages, 0.2)
    ours = torch.autograd.grad(loss, parameters, retain_graph=True)
    for a, b in zip(ours, torch.autograd.grad(-(advantages * log_probs).mean(), parameters)):
        torch.testing.assert_close(a, b)


def test_value_loss_by_hand_with_and_without_clipping():
    values, old_values = torch.tensor([1.0, 2.0, 0.2]), torch.tensor([0.0, 2.0, 0.0])
    returns = torch.tensor([3.0, 0.0, 0.0])
    plain = ppo.value_loss(values, old_values, returns, 0)
    assert plain.item() == pytest.approx((4 + 4 + 0.04) / 3)
    clipped = ppo.value_loss(values, old_values, returns, 0.5)  # 1 -> 0.5: further off, the larger
    assert clipped.item() == pytest.approx((6.25 + 4 + 0.04) / 3)


def test_each_loss_reaches_its_own_network_and_targets_carry_no_gradient():
    args, agent, transitions, _ = play()
    rows = next(iter(ppo.minibatches(transitions, *rows_of(agent), args)))
    assert not any(x.requires_grad for x in rows)
    states, latents, old_log_probs, old_values, advantages, returns = rows
    ratio = (log_prob(agent, states, latents) - old_log_probs).exp()
    losses = {
        "policy": ppo.policy_loss(ratio, advantages, 0.2),
        "critic": ppo.value_loss(agent["critic"](states), old_values, returns, 0.2),
    }
    for name, loss in losses.items():
        agent.zero_grad(set_to_none=True)
        loss.backward()
        reached = {key.split(".")[0] for key, p in agent.named_parameters() if p.grad is not None}
        assert reached == {name}


def test_approximate_kl_is_never_negative_and_estimates_the_kl_divergence():
    assert all(ppo.approximate_kl(x) >= -1e-7 for x in torch.linspace(-20, 20, 4001))  # rounding
    old, new = Normal(torch.zeros(2), torch.ones(2)), Normal(torch.tensor([0.1, 0.2]), 0.9)
    u = old.sample((100_000,))
    log_ratio = (new.log_prob(u) - old.log_prob(u)).sum(-1)
    estimate, exact = ppo.approximate_kl(log_ratio), kl_divergence(old, new).sum()
    standard_error = (log_ratio.exp() - 1 - log_ratio).std() / math.sqrt(len(log_ratio))
    assert abs(estimate - exact) < 4 * standard_error


def test_logged_entropy_and_std_are_those_of_the_latents():
    args, agent, transitions, _ = play(options="--log-std 0.3")
    mean, log_std = agent["policy"](transitions["states"][0, :1])
    u = Normal(mean, log_std.exp()).sample((200_000,))
    entropy = -ppo.gaussian_log_prob(u, mean, log_std).mean().item()
    metrics = ppo.optimise(agent, adam(agent, lr=0), transitions, args)
    assert metrics["entropy"] == pytest.approx(entropy, abs=0.01)
    assert metrics["policy_std"] == pytest.approx(math.exp(0.3))


@pytest.mark.parametrize("log_std", [-1e3, 1e3])
def test_a_runaway_log_std_stays_finite(log_std):
    args, envs, obs, agent = make()
    (parameter,) = (p for p in agent["policy"].parameters() if p.shape == harness.ACTIONS.shape
                    and p is not agent["policy"].mean_net[-1].bias)
    parameter.data.fill_(log_std)
    transitions, _, _ = ppo.rollout(envs, agent["policy"], obs, args.rollout_steps, 0)
    metrics = ppo.optimise(agent, adam(agent, lr=1e-3), transitions, args)
    assert all(map(math.isfinite, metrics.values()))


def test_target_kl_ends_the_update_before_the_policy_has_gone_too_far():
    moved = []
    for target_kl in 0, 0.01:
        torch.manual_seed(0)
        args, agent, transitions, _ = play("Target", f"--epochs 20 --target-kl {target_kl}")
        states, latents = transitions["states"].flatten(0, 1), transitions["samples"].flatten(0, 1)
        old = log_prob(agent, states, latents).detach()
        ppo.optimise(agent, adam(agent, lr=3e-3), transitions, args)
        log_ratio = log_prob(agent, states, latents) - old
        moved.append(ppo.approximate_kl(log_ratio).item())
    assert moved[1] < 0.03 < moved[0]


# --- Minibatches ----------------------------------------------------------------------------------


def test_each_epoch_uses_each_row_once_in_no_minibatch_smaller_than_asked():
    args, agent, transitions, _ = play(options="--epochs 3")
    rows = torch.arange(100.0).reshape(25, 4, 1)
    transitions["samples"] = rows.expand(25, 4, 2)  # each latent names its row
    parts = list(ppo.minibatches(transitions, *rows_of(agent), args))
    assert [len(latents) for _, latents, *_ in parts] == [34, 33, 33] * 3
    orders = [torch.cat([p[1][:, 0] for p in parts[i : i + 3]]) for i in (0, 3, 6)]
    for order in orders:
        assert order.sort().values.tolist() == list(range(100))
    assert not torch.equal(orders[0], orders[1])


def test_rows_of_a_minibatch_belong_together():
    args, agent, transitions, _ = play()
    states, latents, rewards, *_ = transitions.values()
    ends = torch.ones(25, 4, dtype=torch.bool)
    transitions["terminated"] = transitions["done"] = ends  # so that R = r
    transitions["rewards"] = states.sum(-1) + latents.sum(-1)
    for states, latents, old_log_probs, old_values, advantages, returns in ppo.minibatches(
        transitions, *rows_of(agent), args
    ):
        torch.testing.assert_close(returns, states.sum(-1) + latents.sum(-1))
        torch.testing.assert_close(old_values, agent["critic"](states))
        torch.testing.assert_close(advantages, returns - old_values)
        torch.testing.assert_close(old_log_probs, log_prob(agent, states, latents))


def test_parameters_stay_finite_when_the_batch_is_no_multiple_of_the_minibatch():
    args, agent, transitions, _ = play("Target", "--minibatch-size 33")
    ppo.optimise(agent, adam(agent, lr=1e-3), transitions, args)
    assert all(p.isfinite().all() for p in agent.parameters())


@torch.no_grad()
def test_advantages_are_taken_anew_from_the_critic_of_each_epoch():
    args, agent, transitions, _ = play(options="--epochs 2 --minibatch-size 100")
    critic = agent["critic"]
    for rows in ppo.minibatches(transitions, *rows_of(agent), args):
        _, _, _, old_values, advantages, returns = rows
        values, next_values = critic(transitions["states"]), critic(transitions["next_states"])
        expected = ppo.compute_gae(
            transitions["rewards"], values, next_values, transitions["terminated"],
            transitions["done"], args.gamma, args.gae_lambda,
        )
        order = torch.argsort(advantages), torch.argsort(expected.flatten())
        torch.testing.assert_close(advantages[order[0]], expected.flatten()[order[1]])
        torch.testing.assert_close(returns, advantages + old_values)
        critic.value[-1].bias.data += 5.0


# --- Normalisation --------------------------------------------------------------------------------


def test_running_norm_equals_numpy_over_unequal_chunks():
    norm, rows = ppo.RunningNorm((3,)), torch.randn(500, 3) * torch.tensor([1.0, 20.0, 0.1]) + 5
    for chunk in rows.split([1, 7, 192, 300]):
        norm.update(chunk)
    np.testing.assert_allclose(norm.mean, rows.numpy().mean(0), rtol=1e-5)
    np.testing.assert_allclose(norm.var, rows.numpy().var(0), rtol=1e-4)
    assert norm.count == 500


def test_a_dimension_that_never_moved_may_jump():
    norm = ppo.RunningNorm((2,))
    norm.update(torch.tensor([[3.0, 0.0], [3.0, 1.0]]))
    assert norm(torch.tensor([[3.0, 0.0]]))[0, 0] == 0
    assert norm(torch.tensor([[-1e6, 0.0], [1e6, 0.0]]))[:, 0].tolist() == [-10, 10]


def test_only_update_changes_the_statistics():
    args, envs, obs, agent = make()
    agent["policy"].norm.update(torch.randn(50, 2))
    before = {name: x.clone() for name, x in agent.state_dict().items()}
    ppo.rollout(envs, agent["policy"], obs, 5, 0)
    ppo.evaluate(agent["policy"], gym.make(args.env_id), [1, 2])
    agent["critic"](torch.randn(5, 2))
    assert all(torch.equal(x, before[name]) for name, x in agent.state_dict().items())


def test_all_environments_share_one_set_of_statistics():
    _, _, _, agent = make()
    norm = agent["policy"].norm
    norm.update(torch.randn(50, 2))
    assert norm is agent["critic"].norm
    assert norm.mean.shape == (2,)
    assert (norm(torch.ones(4, 2)) == norm(torch.ones(2))).all()


def test_rewards_are_divided_by_the_std_of_the_discounted_return_so_far():
    norm, carry, seen = ppo.RunningNorm(()), 0.0, []
    G = np.zeros(3)
    for _ in range(4):  # several rollouts, over which G and the statistics go on
        rewards, done = torch.randn(10, 3), torch.rand(10, 3) < 0.2
        scaled, carry = ppo.scale_rewards(rewards, done, carry, norm, 0.9)
        for t in range(10):
            G = rewards[t].numpy() + 0.9 * G
            seen.append(G)
            G = np.where(done[t], 0, G)
        np.testing.assert_allclose(scaled, rewards / np.std(seen), rtol=1e-4)
        np.testing.assert_allclose(carry, 0.9 * G, rtol=1e-4, atol=1e-6)
    assert norm.mean.item() == pytest.approx(np.mean(seen), abs=1e-4)


# --- Actions --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("squash", "edge"), [("clip", 1.0), ("clip", 50.0), ("tanh", 50.0)])
def test_the_edges_of_the_latents_are_exactly_the_bounds_of_the_actions(squash, edge):
    policy = make_policy(f"--squash {squash}")
    assert policy.bound(torch.tensor([-edge, -edge])).tolist() == [-1, 0]
    assert policy.bound(torch.tensor([edge, edge])).tolist() == [3, 0.5]
    assert policy.bound(torch.zeros(2)).tolist() == [1, 0.25]
    unit = torch.tensor([0.5, -0.5])
    latents = torch.atanh(unit) if squash == "tanh" else unit
    torch.testing.assert_close(policy.bound(latents), torch.tensor([2.0, 0.125]))


@pytest.mark.parametrize("squash", ["tanh", "clip"])
def test_no_environment_gets_an_action_out_of_bounds_though_latents_may_be(squash):
    _, _, transitions, _ = play(options=f"--squash {squash} --log-std 2", mean=30.0)
    assert transitions["samples"].abs().max() > 30  # the latents; the world asserts its bounds


def test_deterministic_actions_are_those_of_the_mean():
    _, _, obs, agent = make()
    latents, actions = agent["policy"].act(obs, deterministic=True)
    np.testing.assert_array_equal(latents, agent["policy"](torch.as_tensor(obs))[0].detach())
    np.testing.assert_array_equal(actions, agent["policy"].bound(torch.as_tensor(latents)))
    sampled, _ = agent["policy"].act(obs)
    assert len(np.unique(sampled - latents)) == latents.size  # each has its own noise


# --- Rollout and seeds ----------------------------------------------------------------------------


@pytest.mark.parametrize("env", ["ThreeSteps", "Forever"])
def test_every_row_is_a_real_transition(env):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    _, _, transitions, _ = play(env)
    states, _, rewards, next_states, terminated, done = transitions.values()
    length = {"ThreeSteps": 3, "Forever": 8}[env]
    assert (states[0, :, 1] == 0).all()
    assert torch.equal(next_states[..., 0], states[..., 0])  # the same episode, also at its end
    assert torch.equal(next_states[..., 1], states[..., 1] + 1)
    assert torch.equal(done, next_states[..., 1] == length)
    assert torch.equal(terminated, done if env == "ThreeSteps" else torch.zeros_like(done))
    goes_on = ~done[:-1]
    assert torch.equal(states[1:][goes_on], next_states[:-1][goes_on])
    assert (states[1:][done[:-1]][:, 1] == 0).all()
    assert (rewards == 1).all()
    assert all(x.dtype in (torch.float32, torch.bool) for x in (states, rewards, next_states, done))


def test_every_finished_episode_is_logged_once_with_its_raw_return_and_length():
    args, envs, obs, agent = make()
    episodes = []
    for start in range(0, 60, 20):  # 5 steps in 4 environments at a time: some span two rollouts
        _, obs, ended = ppo.rollout(envs, agent["policy"], obs, 5, start)
        episodes += ended
    assert episodes == [(4 * step, 3.0, 3) for step in (3, 6, 9, 12, 15) for _ in range(4)]


def test_environments_of_a_run_start_differently_and_seeds_are_all_different():
    _, _, obs, _ = make()
    assert len(np.unique(obs[:, 0])) == len(obs)
    seeds = [
        x for seed in range(10) for stream in range(10) for x in ppo.make_seeds(seed, stream, 16)
    ]
    assert len(set(seeds)) == len(seeds) == 1600
    assert ppo.make_seeds(3, 1, 5) == ppo.make_seeds(3, 1, 5) == ppo.make_seeds(3, 1, 9)[:5]
