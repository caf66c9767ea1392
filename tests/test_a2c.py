"""a2c_vector.py: its update by hand, its processes, and random physics."""

import multiprocessing

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS
from harness import read_log

import a2c_vector as a2c


@pytest.mark.usefixtures("float64")
def test_an_update_follows_the_gradient_written_out():
    """Two in a row, at learning rate 0, so that a sum of gradients would be seen."""
    agent = SCRIPTS["a2c_vector"].agent("harness:DiscreteThreeSteps-v0")
    obs, actions = 2 * torch.randn(25, 4, 2) + 1, torch.randint(3, (25, 4))
    advantages, targets = torch.randn(2, 25, 4) + 1
    agent.actor[-1].weight.data *= 300  # a new agent finds all actions alike
    agent.obs_stats.update(obs)
    optimizer, parameters = torch.optim.SGD(agent.parameters(), lr=0), list(agent.parameters())
    for _ in range(2):
        metrics = a2c.optimise(agent, optimizer, obs, actions, advantages, targets,
                               entropy_coef=0.3, max_grad_norm=1e9)
    states = (obs - obs.mean((0, 1))) / obs.std((0, 1), correction=0)
    A = (advantages - advantages.mean()) / advantages.std(correction=0)
    probs = agent.actor(states).softmax(-1)
    log_pi = probs.gather(-1, actions.unsqueeze(-1)).squeeze(-1).log()
    entropy = -(probs * probs.log()).sum(-1).mean()
    loss_v = (agent.critic(states).squeeze(-1) - targets).square().mean() / 2
    gradients = torch.autograd.grad(-(A * log_pi).mean() + loss_v - 0.3 * entropy, parameters)
    for parameter, gradient in zip(parameters, gradients):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-7)
    assert metrics == pytest.approx({"value_loss": loss_v.item(), "entropy": entropy.item()})


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
@pytest.mark.parametrize(("start_method", "count"), [
    (None, 4), pytest.param("spawn", 1, marks=pytest.mark.slow)])
def test_random_physics_in_processes_change_no_number(start_method, count, tmp_path, monkeypatch):
    """Started as usual here, or spawned as on other systems, which takes seconds for each."""
    context = multiprocessing.get_context(start_method)
    monkeypatch.setattr(multiprocessing, "get_context", lambda *_: context)
    sync, async_ = (SCRIPTS["a2c_vector"].train(
        tmp_path / kind, "--vectorization", kind, "--num-envs", count, "--randomize",
        env_id="LunarLander-v3") for kind in ("sync", "async"))
    pd.testing.assert_frame_equal(
        read_log(f"{sync}.csv"), read_log(f"{async_}.csv"), check_exact=True)


NAMES = "gravity", "wind_power", "turbulence_power"
PHYSICS = *NAMES, "enable_wind"


def physics_in_force(env):
    env = env.unwrapped
    assert env.world.gravity[1] == pytest.approx(env.gravity)
    return {name: getattr(env, name) for name in PHYSICS}


def test_physics_fill_their_ranges_one_by_one_and_have_nothing_to_do_with_other_draws():
    """Of an environment with any seed, of the episode before. 0.3 and 0.15: six standard errors."""
    env, drawn = a2c.RandomPhysics(gym.make("LunarLander-v3")), []
    for seed in torch.randint(2**31, (400,)).tolist():
        env.reset(seed=seed)
        first, own = physics_in_force(env), np.random.default_rng(seed).random(8)
        env.reset()
        last = {f"last {name}": x for name, x in physics_in_force(env).items()}
        drawn.append({**first, **last, **dict(enumerate(own))})
    env.reset(seed=17)
    of_others = [np.random.default_rng(n).uniform(-11.99, -7) for n in range(5000)]
    assert env.unwrapped.gravity not in of_others, "an environment may draw the same numbers"
    drawn = pd.DataFrame(drawn).astype(float)
    for name, low, high in zip(NAMES, (-11.99, 0, 0), (-7, 20, 2)):
        margin = 0.05 * (high - low)
        assert low <= drawn[name].min() < low + margin, f"{name} is never near {low}"
        assert high >= drawn[name].max() > high - margin, f"{name} is never near {high}"
    assert 0.35 < drawn["enable_wind"].mean() < 0.65, "there should be wind in half of all episodes"
    assert abs(drawn["enable_wind"].autocorr()) < 0.3, "wind is not drawn, but comes in turns"
    assert drawn.corr().notna().all(axis=None), "a number is the same in all episodes"
    for name in PHYSICS:
        others = drawn.corr()[name].drop(name).abs()
        assert others.max() < 0.3, f"{name} depends on {others.idxmax()}: how are they drawn?"
