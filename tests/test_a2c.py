"""a2c_vector.py: its update by hand, its processes, and random physics."""

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS
from harness import read_log, spy, spy_rollouts, train
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
    rollouts = spy_rollouts(monkeypatch, a2c)
    train(monkeypatch, a2c, "--env-id", "harness:DiscreteThreeSteps-v0", *SIZES,
          "--max-grad-norm", 1e-3)
    for network in rollouts[-1][2].actor, rollouts[-1][2].critic:
        gradient = torch.cat([p.grad.flatten() for p in network.parameters()])
        assert gradient.norm().item() == pytest.approx(1e-3, rel=1e-2)


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


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
def test_environments_in_processes_change_no_number(tmp_path, monkeypatch):
    kinds = spy(monkeypatch, a2c, "rollout", lambda envs, *_: type(envs.unwrapped))
    sync, async_ = (SCRIPTS["a2c_vector"].train(tmp_path / kind, "--vectorization", kind)
                    for kind in ("sync", "async"))
    assert set(kinds) == {gym.vector.SyncVectorEnv, gym.vector.AsyncVectorEnv}
    pd.testing.assert_frame_equal(
        read_log(f"{sync}.csv"), read_log(f"{async_}.csv"), check_exact=True)


LANDER = "LunarLander-v3"
NAMES = "gravity", "wind_power", "turbulence_power"
PHYSICS = *NAMES, "enable_wind"


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
    env, drawn = a2c.RandomPhysics(gym.make(LANDER)), []
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
def test_randomize_is_for_training_and_evaluation(randomize, tmp_path, monkeypatch):
    def look(envs):
        return [physics_in_force(env) for env in envs.unwrapped.envs]

    trained = spy(monkeypatch, a2c, "rollout", lambda envs, *_: look(envs))
    evaluated = spy(monkeypatch, a2c, "evaluate", lambda agent, envs, _: look(envs))
    SCRIPTS["a2c_vector"].train(tmp_path, *["--randomize"] * randomize, env_id=LANDER)
    usual = physics_in_force(gym.make(LANDER))
    for physics in (*trained[0], *evaluated[-1]):  # each after a reset
        assert (physics == usual) != randomize
