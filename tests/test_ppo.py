"""PPO: its losses by hand, its updates gradient by gradient, its actions, its training."""

import copy
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from harness import ACTIONS
from test_gae import gae_by_hand
from torch.distributions import Normal, kl_divergence

import ppo_continuous as ppo

SIZES = "--num-envs 4 --rollout-steps 25 --minibatch-size 34 --total-steps 100 --max-kl 1e9"
UNEVEN = "test_rollout:Uneven"


def make(options="", world="harness:ThreeSteps", new=False):
    """Arguments, environments, and an agent with larger weights and some statistics.

    A new one acts alike in all states and does not normalise, which would hide mistakes.
    """
    args = ppo.parse_args(f"--env-id {world}-v0 {SIZES} {options}".split())
    envs = ppo.make_envs(args.env_id, args.num_envs, "Disabled")
    agent = ppo.Agent(envs.single_observation_space, envs.single_action_space, args)
    if not new:
        agent.actor[-1].weight.data *= 100
        agent.obs_stats.update(3 * torch.randn(50, 2) + 1)
    return args, envs, agent


def play(options=""):
    """Arguments, agent, and 100 rows of a rollout, A and R random."""
    args, envs, agent = make(options)
    obs, _ = envs.reset(seed=[1, 2, 3, 4])
    batch, _, _ = ppo.rollout(envs, agent, obs, args, 0)
    batch = SimpleNamespace(**{name: x.flatten(0, 1) for name, x in vars(batch).items()})
    batch.advantages, batch.targets = torch.randn(2, 100)
    batch.log_probs = agent.policy(batch.obs).log_prob(batch.actions).detach()
    return args, agent, batch


def train(options="", world=UNEVEN):
    """A whole training with a new agent, which is returned with all that was yielded."""
    args, envs, agent = make(options, world, new=True)
    return agent, list(ppo.train(args, 1, envs, agent, ppo.make_optimizer(agent), 0))


def spy(monkeypatch, name, keep):
    """A list of what keep(*arguments) returns whenever the function `name` of ppo is called."""
    kept, function = [], getattr(ppo, name)

    def spied(*arguments):
        kept.append(keep(*arguments))
        return function(*arguments)

    monkeypatch.setattr(ppo, name, spied)
    return kept


def watch_steps(agent, optimizer):
    """A list that grows with each step: its observations, the agent before it, its gradients."""
    steps, shown, policy = [], [], agent.policy

    def spied(obs):
        shown.append(obs)
        return policy(obs)

    def keep(*_):
        gradients = [p.grad.clone() for p in agent.parameters()]
        steps.append((shown[-1], copy.deepcopy(agent), gradients))

    agent.policy = spied
    optimizer.register_step_pre_hook(keep)
    return steps


def update(args, agent, batch, lr, finishes=True):
    """The steps of an update."""
    optimizer = torch.optim.Adam(agent.parameters(), lr)
    steps = watch_steps(agent, optimizer)
    assert ppo.optimise(agent, optimizer, batch, args) is finishes
    return steps


# --- Policy and losses ----------------------------------------------------------------------------


def test_the_ratio_stays_1_while_the_policy_does(monkeypatch):
    """At learning rate 0, with the environments' own bounds far narrower than σ."""
    ratios = spy(monkeypatch, "policy_loss", lambda ratio, *_: ratio.detach())
    _, (_, (*_, (metrics,))) = train("--first-std 7.4 --epochs 3 --learning-rate 0")
    assert len(ratios) == 3 * 3 + 1
    assert (torch.cat(ratios) - 1).abs().max() < 1e-5
    assert metrics["clip_fraction"] == 0
    assert metrics["approximate_kl"] < 1e-6


def test_the_density_that_acted_is_the_one_that_learns():
    """The stored actions were drawn from N(μ(s), σ²), before squashing, each with its own noise."""
    _, agent, batch = play("--first-std 2.7")
    policy = agent.policy(batch.obs)
    torch.testing.assert_close(policy.stddev.data, torch.full((100, 2), 2.7))
    noise = (batch.actions - policy.mean) / 2.7
    assert abs(noise.mean()) < 0.3
    assert abs(noise.std() - 1) < 0.2
    assert len(noise.unique()) == 200


def test_tanh_takes_actions_to_the_range_of_the_environment_and_never_beyond():
    half = math.atanh(0.5)
    actions = np.float32([[-10, -10], [10, 10], [0, 0], [half, -half]])
    squashed = ppo.squash(actions, ACTIONS)
    np.testing.assert_allclose(squashed, [[-1, 0], [3, 0.5], [1, 0.25], [2, 0.125]], rtol=1e-6)
    assert all(ACTIONS.contains(x) for x in squashed)


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


# --- Update ---------------------------------------------------------------------------------------


def find_rows(batch, obs):
    """Of which rows of the batch these observations are: no two rows look alike."""
    rows = batch.obs.tolist()
    return [rows.index(x) for x in obs.tolist()]


def estimates_by_hand(old, batch, args):
    """A and R (100,), if `old` has played the rollout of 25 steps in 4 environments."""
    grid = {name: x.reshape(25, 4, -1) for name, x in vars(batch).items()}
    rewards, terminated, done = (grid[x].squeeze(-1) for x in ("rewards", "terminated", "done"))
    with torch.no_grad():
        values, next_values = (
            old.critic(old.obs_stats.normalise(grid[x])).squeeze(-1) for x in ("obs", "next_obs"))
    ends = terminated, done
    A = gae_by_hand(rewards, values, next_values, *ends, args.gamma, args.gae_lambda)
    return A.flatten(), (A + values).flatten()


def ratio_by_hand(agent, old, batch, rows):
    pi, pi_old = (
        Normal(x.actor(x.obs_stats.normalise(batch.obs[rows])), x.std)
        for x in (agent, old))
    actions = batch.actions[rows]
    return (pi.log_prob(actions) - pi_old.log_prob(actions).detach()).sum(-1).exp()


def surrogate_by_hand(ratio, A, clip_eps):
    low, high = 1 - clip_eps, 1 + clip_eps
    return sum(min(x * a, min(max(x, low), high) * a) for x, a in zip(ratio, A)) / len(A)


def gradients_by_hand(agent, old, batch, obs, args):
    """Of the loss in step 5."""
    rows = find_rows(batch, obs)
    A, R = (x[rows] for x in estimates_by_hand(old, batch, args))
    A = (A - A.mean()) / (A - A.mean()).square().mean().sqrt()
    loss = -surrogate_by_hand(ratio_by_hand(agent, old, batch, rows), A, args.clip_eps)
    for i, value in enumerate(agent.critic(agent.obs_stats.normalise(obs)).squeeze(-1)):
        loss += (value - R[i]) ** 2 / 2 / len(rows)
    return torch.autograd.grad(loss, list(agent.parameters()))


@torch.no_grad()
def diagnostics_by_hand(agent, old, batch, args):
    A, R = estimates_by_hand(old, batch, args)
    ratio = ratio_by_hand(agent, old, batch, slice(None))
    log = {"policy_loss": -surrogate_by_hand(ratio, A, args.clip_eps),
           "value_loss": A.square().mean() / 2, "explained_variance": 1 - A.var() / R.var(),
           "approximate_kl": (ratio - 1 - ratio.log()).mean(),
           "clip_fraction": ((ratio - 1).abs() > args.clip_eps).double().mean()}
    return {name: x.item() for name, x in log.items()}


@pytest.mark.parametrize("minibatches", [1, 3])
@pytest.mark.parametrize("world", [UNEVEN, "harness:Forever"])
def test_each_step_of_an_update_follows_the_gradient_written_out(world, minibatches, monkeypatch):
    """Its first step, at ratio 1, and later ones, of a policy and a critic that have moved.

    Advantages and targets are those of the critic before the update, in each epoch; and no
    gradient goes through them. The diagnostics are of the whole rollout, after the update.
    """
    options = f"--minibatch-size {math.ceil(100 / minibatches)} --epochs 2 --clip-eps 0.1"
    options += " --gamma 0.9 --gae-lambda 0.7 --learning-rate 0.06"
    args, envs, agent = make(options, world)
    rollout = ppo.rollout

    def rollout_in_double(*arguments):
        batch, obs, episodes = rollout(*arguments)
        agent.double()
        batch = SimpleNamespace(**{name: x.double() for name, x in vars(batch).items()})
        batch.rewards = torch.randn_like(batch.rewards)
        return batch, obs, episodes

    monkeypatch.setattr(ppo, "rollout", rollout_in_double)
    start = spy(monkeypatch, "optimise", lambda agent, _, batch, *__: (copy.deepcopy(agent), batch))
    optimizer = torch.optim.SGD(agent.parameters())
    steps = watch_steps(agent, optimizer)
    _, (_, _, (metrics,)) = ppo.train(args, 1, envs, agent, optimizer, 0)
    ((old, batch),) = start
    assert len(steps) == 2 * minibatches
    for obs, before, gradients in steps:
        expected = gradients_by_hand(before, old, batch, obs, args)
        torch.testing.assert_close(gradients, list(expected), rtol=1e-6, atol=1e-9)
    statistics = copy.deepcopy(agent)  # those of observations have changed since
    statistics.obs_stats = old.obs_stats
    expected = diagnostics_by_hand(statistics, old, batch, args)
    assert 0.1 < expected["clip_fraction"] < 0.9
    expected |= {"env_step": 100, "learning_rate": 0.06}
    assert metrics == pytest.approx(expected, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize(
    ("size", "lengths"), [(2, 50 * [2]), (33, [33, 33, 33, 1]), (51, [51, 49]), (1000, [100])])
def test_each_epoch_uses_each_row_once_in_minibatches_as_large_as_asked(size, lengths):
    """Parameters stay finite even when a minibatch is of a single row, where A becomes 0."""
    args, agent, batch = play(f"--epochs 3 --minibatch-size {size}")
    steps = update(args, agent, batch, lr=1e-3)
    assert [len(obs) for obs, *_ in steps] == 3 * lengths
    orders = np.reshape(find_rows(batch, torch.cat([obs for obs, *_ in steps])), (3, 100))
    assert (np.sort(orders) == np.arange(100)).all()
    assert len(np.unique(orders, axis=0)) == 3
    assert all(p.isfinite().all() for p in agent.parameters())


def test_a_kl_above_max_kl_ends_all_epochs_before_the_next_step(monkeypatch):
    args, agent, batch = play("--epochs 20 --max-kl 0.01")
    log_ratios = spy(monkeypatch, "approximate_kl", lambda log_ratio: log_ratio.detach())
    steps = update(args, agent, batch, lr=3e-4, finishes=False)
    kls = [(x.exp() - 1 - x).mean().item() for x in log_ratios]
    assert 6 < len(kls) < 57  # not even in the last epoch
    assert kls[-1] > 0.01 >= max(kls[:-1])
    assert len(steps) == len(kls) - 1


# --- Training -------------------------------------------------------------------------------------


def test_training_yields_what_it_knows_at_the_start_and_after_each_update():
    """All 4 environments end an episode every 3 steps; an update is 25 steps of each."""
    _, (start, *updates) = train("--total-steps 250", "harness:ThreeSteps")
    assert start == (0, [], [])
    assert [env_step for env_step, *_ in updates] == [100, 200, 300]
    for env_step, episodes, (metrics,) in updates:
        ends = [x for x in range(env_step - 96, env_step + 4, 4) if x % 12 == 0]
        assert [row["env_step"] for row in episodes] == sorted(4 * ends)
        assert metrics.pop("env_step") == env_step
        assert all(type(x) is float and math.isfinite(x) for x in metrics.values())


def test_the_agent_that_learns_from_a_rollout_is_the_one_that_played_it(monkeypatch):
    """Also its statistics: they change after the update, or ρ would not start at 1."""
    played = spy(monkeypatch, "rollout", lambda _, agent, *rest: copy.deepcopy(agent.state_dict()))
    learned = spy(monkeypatch, "optimise", lambda agent, *_: copy.deepcopy(agent.state_dict()))
    batches = spy(monkeypatch, "optimise", lambda agent, optimizer, batch, args: batch)
    end = train("--total-steps 300")[0].state_dict()
    assert [x["obs_stats.count"].item() for x in [*played, end]] == [0, 100, 200, 300]
    for before, then in zip(played, learned):
        same = {name for name, x in then.items() if torch.equal(x, before[name])}
        assert then.keys() - same == {f"return_stats.{x}" for x in ("mean", "var", "count")}
    obs = torch.cat([batch.obs for batch in batches])
    torch.testing.assert_close(end["obs_stats.mean"], obs.mean(0))
    torch.testing.assert_close(end["obs_stats.var"], obs.var(0, correction=0))
    for batch, then in zip(batches, batches[1:]):  # each rollout goes on where the last one ended
        goes_on = batch.done[-4:] == 0
        assert goes_on.any()
        assert torch.equal(then.obs[:4][goes_on], batch.next_obs[-4:][goes_on])


@pytest.mark.parametrize(("world", "length"), [("ThreeSteps", 3), ("Forever", 8)])
def test_training_learns_from_scaled_rewards_and_episodes_span_rollouts(world, length, monkeypatch):
    """Reward 1: F is 1, 1 + γ, 1 + γ + γ², …, and 1 again after the end or the time limit."""
    batches = spy(monkeypatch, "optimise", lambda agent, optimizer, batch, args: batch)
    train("--gamma 0.8 --total-steps 300", f"harness:{world}")
    assert len(batches) == 3
    for i, batch in enumerate(batches):
        F = [sum(0.8**k for k in range(t % length + 1)) for t in range(25 * (i + 1))]
        np.testing.assert_allclose(batch.rewards, 1 / np.std(F), rtol=1e-5)


@pytest.mark.parametrize("first_step", [0, 100])
def test_learning_rate_and_sigma_fall_in_a_straight_line(first_step, monkeypatch):
    """3.5 rollouts; a training that is resumed after the first goes on with its values."""

    def look(agent, optimizer, *_):
        return optimizer.param_groups[0]["lr"], agent.policy(torch.zeros(2)).stddev[0].item()

    found = spy(monkeypatch, "optimise", look)
    args, envs, agent = make(
        "--learning-rate 7e-3 --first-std 0.9 --last-std 0.2 --total-steps 350")
    *_, last = ppo.train(args, 1, envs, agent, ppo.make_optimizer(agent), first_step)
    expected = [(7e-3, 0.9), (5e-3, 0.7), (3e-3, 0.5), (1e-3, 0.3)]
    np.testing.assert_allclose(found, expected[first_step // 100:], rtol=1e-5)
    assert last[2][0]["learning_rate"] == pytest.approx(1e-3)


def test_updates_that_are_cut_short_slow_learning_until_updates_are_finished(monkeypatch):
    rates, finished = [], iter([True, False, False, True, True, True, True, True, True, True, True])

    def optimise(agent, optimizer, *_):
        rates.append(optimizer.param_groups[0]["lr"])
        return next(finished)

    monkeypatch.setattr(ppo, "optimise", optimise)
    train("--total-steps 1100 --learning-rate 1e-3")
    paces = np.minimum([1, 1, 0.8, 0.64, *(0.64 * 1.05**i for i in range(1, 8))], 1)
    np.testing.assert_allclose(rates, 1e-3 * paces * np.linspace(1, 0, 11, endpoint=False))


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits():
    options = "--gamma 0.9 --learning-rate 1e-2 --rollout-steps 16 --minibatch-size 64"
    agent, _ = train(f"{options} --total-steps 1920", "harness:Timeless")
    obs = torch.tensor([[-0.8, 0.0], [0.0, 0.0], [0.8, 0.0]])
    raw_values = agent.value(obs) * agent.return_stats.var.sqrt()
    assert (raw_values - 10).abs().max() < 0.5, raw_values  # blind to the limit: at most 5.7
