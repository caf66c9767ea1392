"""a2c_vector.py: its update by hand, its processes, and random physics."""

import multiprocessing

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS
from harness import read_log, spy_rollouts, train
from test_gae import gae_by_hand

import a2c_vector as a2c


def rough(agent, batch):
    """A new agent finds all actions alike and normalises nothing, which would hide mistakes."""
    if agent.obs_stats.count == 0:  # in its first update
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


@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("rollout_steps", [1, 25])
@pytest.mark.parametrize(("world", "length", "terminates"), [
    ("DiscreteThreeSteps", 3, True), ("DiscreteForever", 8, False), ("DiscreteBothEnds", 3, True)])
def test_an_update_follows_the_gradient_written_out(
        world, length, terminates, rollout_steps, monkeypatch):
    """In particular, none goes through a bootstrap value, a target or an advantage.

    Several updates in a row; in the last one episodes end, also if it is of a single step.
    """
    rollouts = spy_rollouts(monkeypatch, a2c, rough)
    options = ["--env-id", f"harness:{world}-v0", "--num-envs", 4, "--rollout-steps", rollout_steps,
               "--total-steps", 480, "--max-grad-norm", 1e9, "--gamma", 0.9, "--gae-lambda", 0.7,
               "--entropy-coef", 0.3, "--reward-scale", 0.5]
    last = train(monkeypatch, a2c, *options).iloc[-1]
    args = a2c.parse_args([str(x) for x in options])
    args.entropy_coef *= 1 - (last["env_step"] - 4 * rollout_steps) / args.total_steps
    assert len(rollouts) == np.ceil(120 / rollout_steps)
    player, batch, agent = rollouts[-1]
    gradients, expected = by_hand(args, player, batch, length, terminates)
    parameters = [*agent.actor.parameters(), *agent.critic.parameters()]
    assert len(parameters) == len(gradients) == len(list(agent.parameters()))
    for parameter, gradient in zip(parameters, gradients):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-7)
    assert dict(last[list(expected)]) == pytest.approx(expected)


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
@pytest.mark.parametrize(("start_method", "count"), [
    (None, 4), pytest.param("spawn", 1, marks=pytest.mark.slow)])
def test_environments_in_processes_change_no_number(start_method, count, tmp_path, monkeypatch):
    """Started as usual here, or spawned as on other systems, which takes seconds for each."""
    context = multiprocessing.get_context(start_method)
    monkeypatch.setattr(multiprocessing, "get_context", lambda *_: context)
    sync, async_ = (
        SCRIPTS["a2c_vector"].train(tmp_path / kind, "--vectorization", kind, "--num-envs", count)
        for kind in ("sync", "async"))
    pd.testing.assert_frame_equal(
        read_log(f"{sync}.csv"), read_log(f"{async_}.csv"), check_exact=True)


NAMES = "gravity", "wind_power", "turbulence_power"
PHYSICS = *NAMES, "enable_wind"


def physics_in_force(env):
    env = env.unwrapped
    assert env.world.gravity[1] == pytest.approx(env.gravity)
    return {name: getattr(env, name) for name in PHYSICS}


def draw_physics(vectorization):
    """What two environments draw for two episodes, for the seeds 1, 2 and 1 again."""
    args = SCRIPTS["a2c_vector"].args("--randomize", "--vectorization", vectorization)
    envs = a2c.make_envs(args, 2, vectorization, autoreset_mode="Disabled")
    drawn = []
    for seed in 1, 2, 1:
        for env_seeds in a2c.make_seeds(seed, stream=2, count=2), None:
            envs.reset(seed=env_seeds)
            drawn.append([list(x) for x in zip(*map(envs.unwrapped.get_attr, PHYSICS))])
    envs.close()
    return drawn


def test_physics_fill_their_ranges_one_by_one_and_have_nothing_to_do_with_the_environment_s_draws():
    """In 400 episodes; a correlation of 0.3 is six standard errors, so are 0.15 of wind."""
    env, drawn = a2c.RandomPhysics(gym.make("LunarLander-v3")), []
    for seed in torch.randint(2**31, (400,)).tolist():
        env.reset(seed=seed)
        own = np.random.default_rng(seed).random(8)
        drawn.append({**physics_in_force(env), **dict(enumerate(own))})
    drawn = pd.DataFrame(drawn).astype(float)
    for name, low, high in zip(NAMES, (-11.99, 0, 0), (-7, 20, 2)):
        margin = 0.05 * (high - low)
        assert low <= drawn[name].min() < low + margin, f"{name} is never near {low}"
        assert high >= drawn[name].max() > high - margin, f"{name} is never near {high}"
    assert 0.35 < drawn["enable_wind"].mean() < 0.65, "there should be wind in half of all episodes"
    assert abs(drawn["enable_wind"].autocorr()) < 0.3, "wind is not drawn, but comes in turns"
    for name in PHYSICS:
        others = drawn.corr()[name].drop(name).abs()
        assert others.max() < 0.3, f"{name} depends on {others.idxmax()}: how are they drawn?"


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_physics_differ_between_environments_episodes_and_seeds_and_repeat_with_the_seed():
    """And several processes draw what a single one would."""
    first, second, other_first, other_second, again, again_second = draw_physics("sync")
    assert draw_physics("async")[:2] == [first, second]
    assert [first, second] == [again, again_second]
    drawn = first + second + other_first + other_second
    for values in [*zip(*drawn)][:3]:  # gravity, wind power, turbulence
        assert len(set(values)) == len(values) == 8
