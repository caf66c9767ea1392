"""a2c_vector.py: its update by hand, how it trains, and what it learns."""

import copy

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS
from harness import World, register, table

import a2c_vector as a2c


class Sign(World):
    """One step; the best action is 0 where the first number shown is negative, else 2."""

    def reward(self, action):
        return float(action == (0 if self.episode < 0 else 2))


register("Sign", Sign, length=1)


def make(options="", env="DiscreteThreeSteps-v0"):
    """Arguments, environments and an agent for them."""
    sizes = "--num-envs 4 --rollout-steps 25 --total-steps 100"
    args = a2c.parse_args(["--env-id", env, *f"{sizes} {options}".split()])
    envs = a2c.make_envs(args.env_id, args.num_envs, "Disabled")
    agent = a2c.Agent(envs.single_observation_space, envs.single_action_space, args)
    # A new agent finds all actions alike and normalises nothing, which would hide mistakes.
    agent.actor[-1].weight.data *= 300
    agent.obs_stats.update(2 * torch.randn(50, *agent.obs_stats.mean.shape) + 1)
    return args, envs, agent


def train(args, envs, agent):
    """All that `train` yields."""
    return list(a2c.train(args, 1, envs, agent, a2c.make_optimizer(agent), 0))


def learn(folder, world, *options):
    """Train with `run`; returns its folder and the agent at the end."""
    folder = SCRIPTS["a2c_vector"].train(folder, *options, env_id=f"{world}-v0")
    agent = make(env=f"{world}-v0")[-1]
    agent.load_state_dict(torch.load(folder / "checkpoint.pt", weights_only=True)["agent"])
    return folder, agent


@pytest.fixture
def rollouts(monkeypatch):
    """Copies of the agents that played the rollouts and of their transitions, with new rewards."""
    copies, rollout = [], a2c.rollout

    def spy(envs, agent, *rest):
        player = copy.deepcopy(agent)
        batch, *others = rollout(envs, agent, *rest)
        batch.rewards = torch.randn_like(batch.rewards)
        copies.append((player, copy.deepcopy(batch)))
        return batch, *others

    monkeypatch.setattr(a2c, "rollout", spy)
    return copies


def check_same(some, others):
    assert some.keys() == others.keys()
    assert all(torch.equal(x, others[name]) for name, x in some.items())


# --- The update -----------------------------------------------------------------------------------


def by_hand(args, agent, batch, length, terminates):
    """Gradients and diagnostics of the loss that a2c_vector.py states, from the definitions.

    Whether an episode has ended is read off what the world shows: its steps so far.
    """
    mean, std = agent.obs_stats.mean, agent.obs_stats.var.sqrt()
    states, next_states = (batch.obs - mean) / std, (batch.next_obs - mean) / std
    values = agent.critic(states).squeeze(-1)
    V, next_V = values.tolist(), agent.critic(next_states).squeeze(-1).tolist()  # constants
    done = batch.next_obs[..., 1] == length
    T, N = batch.rewards.shape
    A = torch.zeros(T, N)
    for n in range(N):
        for t in range(T):
            for k in range(t, T):
                goes_on = not (done[k, n] and terminates)
                r = args.reward_scale * batch.rewards[k, n]
                delta = r + args.gamma * goes_on * next_V[k][n] - V[k][n]
                A[t, n] += (args.gamma * args.gae_lambda) ** (k - t) * delta
                if done[k, n]:
                    break
    targets = A + torch.tensor(V)
    explained_variance = 1 - (targets - values).var() / targets.var()
    A = (A - A.mean()) / A.std(correction=0)
    probs = agent.actor(states).softmax(-1)
    log_pi = probs.gather(-1, batch.actions.long().unsqueeze(-1)).squeeze(-1).log()
    entropy = -(probs * probs.log()).sum(-1).mean()
    loss_pi = -(A * log_pi).mean()
    loss_v = (values - targets).square().mean() / 2
    actor, critic = (
        torch.autograd.grad(loss, list(network.parameters())) for loss, network in (
            (loss_pi - args.entropy_coef * entropy, agent.actor), (loss_v, agent.critic)))
    return [*actor, *critic], {
        "policy_loss": loss_pi.item(), "value_loss": loss_v.item(), "entropy": entropy.item(),
        "explained_variance": explained_variance.item()}


@pytest.mark.parametrize("rollout_steps", [1, 25])
@pytest.mark.parametrize(("world", "length", "terminates"), [
    ("DiscreteThreeSteps", 3, True), ("DiscreteForever", 8, False), ("DiscreteBothEnds", 3, True)])
def test_an_update_follows_the_gradient_written_out(
        world, length, terminates, rollout_steps, rollouts):
    """In particular, none goes through a bootstrap value, a target or an advantage.

    Several updates in a row; in the last one episodes end, also if it is of a single step.
    """
    args, envs, agent = make(
        f"--rollout-steps {rollout_steps} --total-steps {4 * 120} --max-grad-norm 1e9 "
        "--gamma 0.9 --gae-lambda 0.7 --entropy-coef 0.3 --reward-scale 0.5", f"{world}-v0")
    *_, (env_step, _, (metrics,)) = train(args, envs, agent)
    args.entropy_coef *= 1 - (env_step - 4 * rollout_steps) / args.total_steps  # of the last one
    assert metrics.pop("env_step") == env_step
    assert len(rollouts) == np.ceil(120 / rollout_steps)
    gradients, expected = by_hand(args, *rollouts[-1], length, terminates)
    parameters = [*agent.actor.parameters(), *agent.critic.parameters()]
    assert len(parameters) == len(gradients) == len(list(agent.parameters()))
    for parameter, gradient in zip(parameters, gradients):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-6)
        assert gradient.abs().max() > 1e-4
    expected = {name: pytest.approx(x, rel=1e-3, abs=1e-5) for name, x in expected.items()}
    assert metrics == expected


def test_longer_gradients_are_shortened_network_by_network():
    kept = []
    for limit in 1e9, 1e-3:
        torch.manual_seed(0)
        args, envs, agent = make(f"--max-grad-norm {limit}")
        optimizer = a2c.make_optimizer(agent)

        def keep(*_, agent=agent):
            for network in agent.actor, agent.critic:
                kept.append(torch.cat([p.grad.flatten() for p in network.parameters()]))

        optimizer.register_step_pre_hook(keep)
        list(a2c.train(args, 1, envs, agent, optimizer, 0))
    lengths = [gradient.norm().item() for gradient in kept]
    assert min(lengths[:2]) > 2e-3
    assert lengths[2:] == pytest.approx([1e-3, 1e-3], rel=1e-2)
    for long, short in zip(kept[:2], kept[2:]):
        torch.testing.assert_close(short / short.norm(), long / long.norm())


# --- Agent ----------------------------------------------------------------------------------------


def test_the_policy_that_learns_is_the_one_that_acts():
    """Actions are as frequent as the log-probabilities say."""
    _, _, agent = make()
    obs = np.float32([[1, 2]])
    actions = agent.act(np.repeat(obs, 20_000, axis=0))
    log_probs = agent.policy(torch.as_tensor(obs)).log_prob(torch.arange(3)).detach()
    probs = log_probs.exp().numpy()
    assert probs.max() - probs.min() > 0.05
    np.testing.assert_allclose(np.bincount(actions) / 20_000, probs, atol=0.015)  # 4 std. errors


# --- Training -------------------------------------------------------------------------------------


@pytest.mark.parametrize("first_step", [0, 200])
def test_learning_rates_and_entropy_bonus_fall_in_a_straight_line(first_step, monkeypatch):
    """From the start, and when a training is resumed after 200 steps."""
    args, envs, agent = make(
        "--learning-rate 2e-3 --critic-learning-rate 4e-3 --entropy-coef 0.5 --total-steps 390")
    seen, optimise = [], a2c.optimise

    def spy(agent, optimizer, batch, args, entropy_coef):
        seen.append((*(group["lr"] for group in optimizer.param_groups), entropy_coef))
        return optimise(agent, optimizer, batch, args, entropy_coef)

    monkeypatch.setattr(a2c, "optimise", spy)
    optimizer = a2c.make_optimizer(agent)
    for group, network in zip(optimizer.param_groups, (agent.actor, agent.critic)):
        assert set(group["params"]) == set(network.parameters())
    start, *updates = a2c.train(args, 1, envs, agent, optimizer, first_step)
    assert start == (first_step, [], [])
    begins = np.arange(first_step, 400, 100)
    np.testing.assert_array_equal([env_step for env_step, *_ in updates], begins + 100)
    np.testing.assert_allclose(seen, np.outer(1 - begins / 390, [2e-3, 4e-3, 0.5]))


def test_the_agent_that_learns_from_a_rollout_is_the_one_that_played_it(rollouts, monkeypatch):
    """Also its statistics: they change after the update, or π(a|s) would not be what acted."""
    args, envs, agent = make("--total-steps 300")
    agent.obs_stats = a2c.RunningStatistics(2)
    compute_gae, optimise, learners = a2c.compute_gae, a2c.optimise, []

    def check(function):
        def checked(*rest):
            learners.append(agent)
            check_same(agent.state_dict(), rollouts[-1][0].state_dict())
            return function(*rest)
        return checked

    monkeypatch.setattr(a2c, "compute_gae", check(compute_gae))
    monkeypatch.setattr(a2c, "optimise", check(optimise))
    train(args, envs, agent)
    assert len(learners) == 2 * 3
    assert [player.obs_stats.count for player, _ in rollouts] == [0, 100, 200]
    rows = torch.cat([batch.obs.flatten(0, 1) for _, batch in rollouts])
    assert agent.obs_stats.count == 300
    torch.testing.assert_close(agent.obs_stats.mean, rows.mean(0))
    torch.testing.assert_close(agent.obs_stats.var, rows.var(0, correction=0))
    for (_, batch), (_, then) in zip(rollouts, rollouts[1:]):  # each goes on where the last ended
        goes_on = batch.done[-1] == 0
        assert goes_on.any()
        assert torch.equal(then.obs[0][goes_on], batch.next_obs[-1][goes_on])


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
def test_environments_in_processes_change_no_number(tmp_path, monkeypatch):
    folders, kinds, rollout = [], set(), a2c.rollout

    def spy(envs, *rest):
        kinds.add(type(envs.unwrapped))
        return rollout(envs, *rest)

    monkeypatch.setattr(a2c, "rollout", spy)
    for kind in "sync", "async":
        folders.append(SCRIPTS["a2c_vector"].train(
            tmp_path / kind, "--vectorization", kind))
    assert kinds == {gym.vector.SyncVectorEnv, gym.vector.AsyncVectorEnv}
    check_same(*(torch.load(folder / "checkpoint.pt", weights_only=True)["agent"]
                 for folder in folders))
    for name in "episodes", "metrics", "evals":
        tables = [table(folder / f"{name}.csv") for folder in folders]
        assert len(tables[0]) > 0
        pd.testing.assert_frame_equal(*tables, check_exact=True)


# --- Learning -------------------------------------------------------------------------------------


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits(tmp_path):
    _, agent = learn(
        tmp_path, "DiscreteTimeless", "--gamma", 0.9, "--total-steps", 6400, "--num-envs", 8,
        "--rollout-steps", 8, "--critic-learning-rate", 1e-2, "--reward-scale", 0.5)
    obs = torch.tensor([[episode, 0.0] for episode in (-0.8, 0.0, 0.8)])
    raw_values = agent.value(obs) / 0.5
    assert (raw_values - 10).abs().max() < 1, raw_values  # blind to the limit: at most 5.7


def test_it_finds_the_best_action_in_each_state(tmp_path):
    folder, agent = learn(
        tmp_path, "DiscreteSign", "--total-steps", 8192, "--num-envs", 8,
        "--learning-rate", 3e-3, "--eval-episodes", 50)
    evals = table(folder / "evals.csv")["return_mean"]
    assert evals.iloc[0] < 0.8
    assert evals.iloc[-1] > 0.9
    obs = np.float32([[-0.8, 0], [-0.4, 0], [0.4, 0], [0.8, 0]])
    assert agent.act(obs, deterministic=True).tolist() == [0, 0, 2, 2]


@pytest.mark.slow
def test_it_learns_to_balance_a_pole(tmp_path):
    folder = SCRIPTS["a2c_vector"].train(
        tmp_path, "--total-steps", 40960, "--num-envs", 16, "--rollout-steps", 16,
        "--num-evals", 1, "--eval-episodes", 20, env_id="CartPole-v1")
    assert table(folder / "evals.csv")["return_mean"].iloc[-1] > 100
    episodes = table(folder / "episodes.csv")["return"]
    assert episodes[-20:].mean() > 4 * episodes[:20].mean()
