"""a2c_vector.py: its update by hand, its processes, and random physics."""

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS
from harness import read_log, spy

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
def test_random_physics_in_processes_change_no_number(tmp_path, monkeypatch):
    kinds = spy(monkeypatch, a2c, "rollout", lambda envs, *_: type(envs.unwrapped).__name__)
    sync, async_ = (SCRIPTS["a2c_vector"].train(
        tmp_path / kind, "--vectorization", kind, "--randomize", "--env-id", "LunarLander-v3")
        for kind in ("sync", "async"))
    pd.testing.assert_frame_equal(read_log(sync), read_log(async_), check_exact=True)
    assert set(kinds) == {"SyncVectorEnv", "AsyncVectorEnv"}


def test_every_episode_has_physics_of_its_own():
    """They fill their ranges, one by one, are in force, and have nothing to do with each other."""
    env, drawn = a2c.RandomPhysics(gym.make("LunarLander-v3")), []
    env.reset()  # without a seed, too
    for seed in torch.randint(2**31, (200,)).tolist():
        for options in {"seed": seed}, {}:
            env.reset(**options)
            lander = env.unwrapped
            assert lander.world.gravity[1] == pytest.approx(lander.gravity)
            drawn.append([(lander.gravity + 11.99) / 4.99, lander.wind_power / 20,
                          lander.turbulence_power / 2, lander.enable_wind])
    drawn = np.array(drawn, dtype=float)
    np.testing.assert_allclose(drawn.min(0), 0, atol=0.05)
    np.testing.assert_allclose(drawn.max(0), 1, atol=0.05)
    np.testing.assert_allclose(drawn.mean(0), 0.5, atol=0.15)  # six standard errors
    pairs = np.corrcoef(np.hstack([drawn[::2], drawn[1::2]]).T)  # also first and second episodes
    assert np.abs(pairs - np.eye(8)).max() < 0.43
