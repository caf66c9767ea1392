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


@pytest.mark.parametrize("limit", [1e9, 0.01])
def test_an_update_follows_the_gradient_written_out(limit):
    """Two in a row, so that a sum of gradients would be seen, as each network has it at its step.

    A network whose gradient is longer than the limit keeps its direction only.
    """
    agent = SCRIPTS["a2c_vector"].agent("ThreeSteps")
    obs, actions = 2 * torch.randn(25, 4, 2) + 1, torch.randint(3, (25, 4))
    advantages, targets = torch.randn(2, 25, 4) + 1
    agent.actor[-1].weight.data *= 300  # a new agent finds all actions alike
    agent.obs_stats.update(obs)
    optimizer, seen = torch.optim.SGD(agent.parameters(), lr=0), []
    optimizer.register_step_pre_hook(
        lambda *_: seen.append([p.grad.clone() for p in agent.parameters()]))
    for _ in range(2):
        metrics = a2c.optimise(agent, optimizer, obs, actions, advantages, targets,
                               entropy_coef=0.3, max_grad_norm=limit)
    states = (obs - obs.mean((0, 1))) / obs.std((0, 1), correction=0)
    A = (advantages - advantages.mean()) / advantages.std(correction=0)
    probs = agent.actor(states).softmax(-1)
    log_pi = probs.gather(-1, actions.unsqueeze(-1)).squeeze(-1).log()
    entropy = -(probs * probs.log()).sum(-1).mean()
    loss_v = (agent.critic(states).squeeze(-1) - targets).square().mean() / 2
    loss, found = -(A * log_pi).mean() + loss_v - 0.3 * entropy, iter(seen[1])
    for network in agent.actor, agent.critic:
        gradients = torch.autograd.grad(loss, list(network.parameters()), retain_graph=True)
        norm = torch.cat([x.flatten() for x in gradients]).norm()
        for gradient in gradients:
            expected = gradient * min(1, limit / norm)
            torch.testing.assert_close(next(found), expected, rtol=1e-3, atol=1e-6)
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
        "--env-id", "LunarLander-v3") for kind in ("sync", "async"))
    pd.testing.assert_frame_equal(read_log(sync), read_log(async_), check_exact=True)


NAMES = "gravity", "wind_power", "turbulence_power"
PHYSICS = *NAMES, "enable_wind"


def physics_in_force(env):
    env = env.unwrapped
    assert env.world.gravity[1] == pytest.approx(env.gravity)
    return {name: getattr(env, name) for name in PHYSICS}


def test_physics_fill_their_ranges_one_by_one_and_have_nothing_to_do_with_other_draws():
    """Of an environment with any seed, of the episode before. 0.3 and 0.15: six standard errors."""
    env, drawn = a2c.RandomPhysics(gym.make("LunarLander-v3")), []
    env.reset()  # without a seed, too
    for seed in torch.randint(2**31, (400,)).tolist():
        env.reset(seed=seed)
        first, own = physics_in_force(env), np.random.default_rng(seed).random(8)
        env.reset()
        last = {f"last {name}": x for name, x in physics_in_force(env).items()}
        drawn.append({**first, **last, **dict(enumerate(own))})
    drawn = pd.DataFrame(drawn).astype(float)
    for name, low, high in zip(NAMES, (-11.99, 0, 0), (-7, 20, 2)):
        margin = 0.05 * (high - low)
        assert low <= drawn[name].min() < low + margin, f"{name} is never near {low}"
        assert high >= drawn[name].max() > high - margin, f"{name} is never near {high}"
    assert 0.35 < drawn["enable_wind"].mean() < 0.65, "there should be wind in half of all episodes"
    assert drawn.corr().notna().all(axis=None), "a number is the same in all episodes"
    for name in PHYSICS:
        others = drawn.corr()[name].drop(name).abs()
        assert others.max() < 0.3, f"{name} depends on {others.idxmax()}: how are they drawn?"
