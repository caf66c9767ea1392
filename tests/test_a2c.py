"""a2c_vector.py: its update by hand, its schedules, its processes, and what it learns."""

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS
from harness import load, read_log, spy, spy_rollouts, train
from test_gae import gae_by_hand

import a2c_vector as a2c

SIZES = ["--num-envs", 4, "--rollout-steps", 25, "--total-steps", 100]


def rough(agent, batch):
    """A new agent finds all actions alike and normalises nothing, which would hide mistakes."""
    if agent.obs_stats.count < 1000:  # before its first rollout
        agent.actor[-1].weight.data *= 300
        agent.obs_stats.update(2 * torch.randn(1000, 2) + 1)
    return batch._replace(rewards=torch.randn(batch.rewards.shape))


def by_hand(args, agent, batch, length, terminates):
    """Gradients and diagnostics of the loss that a2c_vector.py states, from the definitions.

    Whether an episode has ended is read off what the world shows: its steps so far.
    """
    mean, std = agent.obs_stats.mean, agent.obs_stats.var.sqrt()
    states, next_states = (((x - mean) / std).float() for x in (batch.obs, batch.next_obs))
    values = agent.critic(states).squeeze(-1)
    V, next_V = values.detach(), agent.critic(next_states).squeeze(-1).detach()  # constants
    done = batch.next_obs[..., 1] == length
    A = gae_by_hand(args.reward_scale * batch.rewards, V, next_V, done & terminates, done,
                    args.gamma, args.gae_lambda)
    targets = A + V
    explained_variance = 1 - (targets - values).var() / targets.var()
    A = (A - A.mean()) / A.std(correction=0)
    probs = agent.actor(states).softmax(-1)
    log_pi = probs.gather(-1, batch.actions.unsqueeze(-1)).squeeze(-1).log()
    entropy = -(probs * probs.log()).sum(-1).mean()
    loss_pi = -(A * log_pi).mean()
    loss_v = (values - targets).square().mean() / 2
    actor, critic = (
        torch.autograd.grad(loss, list(network.parameters())) for loss, network in (
            (loss_pi - args.entropy_coef * entropy, agent.actor), (loss_v, agent.critic)))
    return [*actor, *critic], {"value_loss": loss_v.item(), "entropy": entropy.item(),
                               "explained_variance": explained_variance.item()}


@pytest.mark.parametrize("rollout_steps", [1, 25])
@pytest.mark.parametrize(("world", "length", "terminates"), [
    ("DiscreteThreeSteps", 3, True), ("DiscreteForever", 8, False), ("DiscreteBothEnds", 3, True)])
def test_an_update_follows_the_gradient_written_out(
        world, length, terminates, rollout_steps, monkeypatch):
    """In particular, none goes through a bootstrap value, a target or an advantage.

    Several updates in a row; in the last one episodes end, also if it is of a single step.
    """
    rollouts = spy_rollouts(monkeypatch, a2c, rough)
    options = ["--env-id", f"harness:{world}-v0", *SIZES, "--rollout-steps", rollout_steps,
               "--total-steps", 480, "--max-grad-norm", 1e9, "--gamma", 0.9, "--gae-lambda", 0.7,
               "--entropy-coef", 0.3, "--reward-scale", 0.5]
    last = train(monkeypatch, a2c, *options).iloc[-1]
    args = a2c.parse_args([str(x) for x in options])
    args.entropy_coef *= 1 - (last["env_step"] - 4 * rollout_steps) / args.total_steps
    assert len(rollouts) == np.ceil(120 / rollout_steps)
    player, batch, agent = rollouts[-1]
    assert player.obs_stats.count > 1000
    gradients, expected = by_hand(args, player, batch, length, terminates)
    parameters = [*agent.actor.parameters(), *agent.critic.parameters()]
    assert len(parameters) == len(gradients) == len(list(agent.parameters()))
    for parameter, gradient in zip(parameters, gradients):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-3, atol=1e-5)
        assert gradient.abs().max() > 1e-4
    assert dict(last[list(expected)]) == pytest.approx(expected, rel=1e-3, abs=1e-5)


def test_longer_gradients_are_shortened_network_by_network(monkeypatch):
    kept = []
    for limit in 1e9, 1e-3:
        rollouts = spy_rollouts(monkeypatch, a2c)
        options = "--env-id", "harness:DiscreteThreeSteps-v0", *SIZES, "--max-grad-norm", limit
        train(monkeypatch, a2c, *options)
        for network in rollouts[-1][2].actor, rollouts[-1][2].critic:
            kept.append(torch.cat([p.grad.flatten() for p in network.parameters()]))
    lengths = [gradient.norm().item() for gradient in kept]
    assert min(lengths[:2]) > 2e-3
    assert lengths[2:] == pytest.approx([1e-3, 1e-3], rel=1e-2)
    for long, short in zip(kept[:2], kept[2:]):
        torch.testing.assert_close(short / short.norm(), long / long.norm())


def test_the_policy_that_learns_is_the_one_that_acts():
    """Actions are as frequent as the log-probabilities say."""
    agent = a2c.Agent(SCRIPTS["a2c_vector"].envs("harness:DiscreteThreeSteps-v0", 1), 64)
    agent.actor[-1].weight.data *= 300
    obs = np.float32([[1, 2]])
    actions = agent.act(np.repeat(obs, 20_000, axis=0))
    log_probs = agent.policy(torch.tensor(obs)).log_prob(torch.arange(3)).detach()
    probs = log_probs.exp().numpy()
    assert probs.max() - probs.min() > 0.05
    np.testing.assert_allclose(np.bincount(actions) / 20_000, probs, atol=0.015)  # 4 std. errors


def test_learning_rate_and_entropy_bonus_fall_in_a_straight_line(monkeypatch):
    def look(agent, optimizer, *rest):
        (group,) = optimizer.param_groups
        assert set(group["params"]) == set(agent.parameters())
        assert group["eps"] == 1e-5
        return group["lr"], rest[-2]

    seen = spy(monkeypatch, a2c, "optimise", look)
    train(monkeypatch, a2c, "--env-id", "harness:DiscreteThreeSteps-v0", *SIZES,
          "--learning-rate", 2e-3, "--entropy-coef", 0.5, "--total-steps", 390)
    np.testing.assert_allclose(seen, np.outer(1 - np.arange(0, 400, 100) / 390, [2e-3, 0.5]))


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
def test_environments_in_processes_change_no_number(tmp_path, monkeypatch):
    kinds = spy(monkeypatch, a2c, "rollout", lambda envs, *_: type(envs.unwrapped))
    sync, async_ = (SCRIPTS["a2c_vector"].train(tmp_path / kind, "--vectorization", kind)
                    for kind in ("sync", "async"))
    assert set(kinds) == {gym.vector.SyncVectorEnv, gym.vector.AsyncVectorEnv}
    pd.testing.assert_frame_equal(
        read_log(f"{sync}.csv"), read_log(f"{async_}.csv"), check_exact=True)
    weights = [load(f"{x}.pt")["agent"] for x in (sync, async_)]
    torch.testing.assert_close(*weights, rtol=0, atol=0)


def test_reward_1_for_ever_is_worth_1_over_1_minus_gamma_despite_time_limits(tmp_path):
    path = SCRIPTS["a2c_vector"].train(
        tmp_path, "--gamma", 0.9, "--total-steps", 6400, "--num-envs", 8, "--rollout-steps", 8,
        "--learning-rate", 1e-2, "--reward-scale", 0.5, env_id="harness:DiscreteTimeless-v0")
    obs = torch.tensor([[episode, 0.0] for episode in (-0.8, 0.0, 0.8)])
    raw_values = SCRIPTS["a2c_vector"].load_agent(path).value(obs) / 0.5
    assert (raw_values - 10).abs().max() < 1, raw_values  # blind to the limit: at most 5.7


def test_it_finds_the_best_action_in_each_state(tmp_path):
    path = SCRIPTS["a2c_vector"].train(
        tmp_path, "--total-steps", 8192, "--num-envs", 8, "--learning-rate", 3e-3,
        "--eval-episodes", 50, env_id="harness:DiscreteSign-v0")
    log = read_log(f"{path}.csv")
    assert log["return"].iloc[0] < 0.6  # a third of the random actions are right
    assert log["eval_return"].iloc[-1] > 0.9
    obs = np.float32([[-0.8, 0], [-0.4, 0], [0.4, 0], [0.8, 0]])
    agent = SCRIPTS["a2c_vector"].load_agent(path)
    assert agent.act(obs, deterministic=True).tolist() == [0, 0, 2, 2]


@pytest.mark.slow
def test_it_learns_to_balance_a_pole(tmp_path):
    path = SCRIPTS["a2c_vector"].train(
        tmp_path, "--total-steps", 40960, "--num-envs", 16, "--rollout-steps", 16,
        "--num-evals", 1, "--eval-episodes", 20, env_id="CartPole-v1")
    assert read_log(f"{path}.csv")["eval_return"].iloc[-1] > 200


LANDER = "LunarLander-v3"
NAMES = "gravity", "wind_power", "turbulence_power"
PHYSICS = *NAMES, "enable_wind"


def random_lander():
    return a2c.RandomPhysics(gym.make(LANDER))


def physics_in_force(env):
    env = env.unwrapped
    assert env.world.gravity[1] == pytest.approx(env.gravity)
    return {name: getattr(env, name) for name in PHYSICS}


def draw_physics(vectorization):
    """What two environments draw for two episodes, for the seeds 1, 2 and 1 again."""
    envs = a2c.make_envs(LANDER, 2, "Disabled", True, vectorization)
    drawn = []
    for seed in 1, 2, 1:
        for env_seeds in a2c.make_seeds(seed, stream=2, count=2), None:
            envs.reset(seed=env_seeds)
            drawn.append([list(x) for x in zip(*map(envs.unwrapped.get_attr, PHYSICS))])
    envs.close()
    return drawn


def test_physics_fill_their_ranges_one_by_one_and_have_nothing_to_do_with_the_ground():
    env, drawn = random_lander(), []
    for seed in range(300):
        env.reset(seed=seed)
        ground = [corners[0][1] for corners in env.unwrapped.sky_polys]
        drawn.append({**physics_in_force(env), "ground": ground[0], "hill": ground[2]})
    drawn = pd.DataFrame(drawn).astype(float)
    for name, low, high in zip(NAMES, (-11.99, 0, 0), (-7, 20, 2)):
        margin = 0.05 * (high - low)
        assert low <= drawn[name].min() < low + margin
        assert high >= drawn[name].max() > high - margin
    assert 0.4 < drawn["enable_wind"].mean() < 0.6
    assert abs(drawn["enable_wind"].autocorr()) < 0.25  # drawn, not in turns
    correlations = drawn.corr().abs().to_numpy() - np.eye(6)
    assert np.delete(correlations, [4, 5], axis=0).max() < 0.25


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_physics_differ_between_environments_episodes_and_seeds_and_repeat_with_the_seed():
    """And several processes draw what a single one would."""
    first, second, other_first, other_second, again, again_second = draw_physics("sync")
    assert draw_physics("async")[:2] == [first, second]
    assert [first, second] == [again, again_second]
    drawn = [values for episode in (first, second, other_first, other_second) for values in episode]
    assert len(drawn) == 8
    for values in [*zip(*drawn)][:3]:  # gravity, wind power, turbulence
        assert len(set(values)) == 8


@pytest.mark.parametrize("randomize", [True, False])
def test_randomize_is_for_training_and_evaluation_which_has_always_the_same_moons(
        randomize, tmp_path, monkeypatch):
    usual = gym.make(LANDER)
    usual.reset()
    moons, evaluate = [], a2c.evaluate

    def spied(agent, envs, seed):
        result = evaluate(agent, envs, seed)
        envs.reset(seed=a2c.make_seeds(seed, stream=1, count=envs.num_envs))
        moons.append([physics_in_force(x) for x in envs.unwrapped.envs])
        return result

    monkeypatch.setattr(a2c, "evaluate", spied)
    trained = spy(monkeypatch, a2c, "rollout", lambda envs, *_: (
        [physics_in_force(x) for x in envs.unwrapped.envs]))
    SCRIPTS["a2c_vector"].train(tmp_path, *["--randomize"] * randomize, env_id=LANDER)
    assert all(x == moons[0] for x in moons)
    for physics in (*moons[0], *trained[0]):
        assert (physics == physics_in_force(usual)) != randomize
