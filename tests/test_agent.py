"""Networks as they are when training begins, and actions that are drawn from the policy."""

import numpy as np
import pytest
import torch
from conftest import both, only
from torch import nn

import reinforce_mujoco as rf


@pytest.mark.parametrize(("network", "last_gain"), [("actor", 0.01), ("critic", 1.0)])
def test_networks_bend_twice_and_begin_orthogonal_without_biases(script, network, last_gain):
    agent = script.agent("ThreeSteps", hidden_size=24)
    network, x = getattr(agent, network), torch.randn(9, 2)
    first, second, last = layers = [layer for layer in network if isinstance(layer, nn.Linear)]
    bend = torch.relu if script.name == "a2c_vector" else torch.tanh
    torch.testing.assert_close(network(x), last(bend(second(bend(first(x))))))
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain), strict=True):
        rows, columns = layer.weight.shape
        W = layer.weight if rows <= columns else layer.weight.T
        torch.testing.assert_close(W @ W.T, gain**2 * torch.eye(len(W)), rtol=1e-4, atol=1e-5)
        assert (layer.bias == 0).all()


def check_noise(actions, policy):
    """Six standard errors are allowed: once in 10⁹ times."""
    noise, count = (actions - policy.mean) / policy.stddev, len(actions)
    assert noise.mean(0).abs().max() < 6 / count**0.5
    torch.testing.assert_close(noise.T.cov(), torch.eye(2), rtol=0, atol=6 * (2 / count) ** 0.5)


@torch.no_grad()
@both
def test_the_policy_that_learns_is_the_one_that_acts(script):
    """By chance, or at its best."""
    agent, count = script.agent("ThreeSteps"), 20_000
    agent.actor[-1].bias.data = torch.linspace(-1.5, 0.5, len(agent.actor[-1].bias))
    obs = np.float32([[1, 2]]).repeat(count, axis=0)
    actions, policy = torch.tensor(agent.act(obs)), agent.policy(torch.tensor(obs[:1]))
    best = torch.tensor(agent.act(obs[:1], deterministic=True))
    if script.name == "a2c_vector":
        probs = policy.log_prob(torch.arange(3)).exp()
        assert best == probs.argmax()
        chance = 6 * (probs * (1 - probs) / count).sqrt()
        assert ((actions.bincount() / count - probs).abs() < chance).all()
    else:
        assert torch.equal(best, policy.mean)
        check_noise(actions, policy)


@torch.no_grad()
@only("reinforce_mujoco")
def test_reinforce_plays_the_policy_that_learns(script):
    agent, env = script.agent("ThreeSteps"), rf.make_env("harness:ThreeSteps-v0")
    agent.actor[-1].bias.data = torch.tensor([-0.5, 0.2, -1.0, 0.5])
    episodes = [rf.play(env, agent) for _ in range(1000)]
    obs, actions = (torch.cat([x[i] for x in episodes]) for i in (0, 1))
    check_noise(actions, agent.policy(obs))
    best = rf.play(env, agent, deterministic=True)
    torch.testing.assert_close(best.actions, agent.policy(best.obs).mean)
