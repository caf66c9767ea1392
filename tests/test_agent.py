"""Networks as they are when training begins, and actions that are drawn from the policy."""

import numpy as np
import pytest
import torch
from torch import nn


@pytest.mark.parametrize(("network", "last_gain"), [("actor", 0.01), ("critic", 1.0)])
def test_networks_bend_twice_and_begin_orthogonal_without_biases(script, network, last_gain):
    agent = script.agent(script.world("ThreeSteps"), hidden_size=24)
    network, x = getattr(agent, network), torch.randn(9, 2)
    first, second, last = layers = [layer for layer in network if isinstance(layer, nn.Linear)]
    bend = torch.relu if script.name == "a2c_vector" else torch.tanh
    torch.testing.assert_close(network(x), last(bend(second(bend(first(x))))))
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain), strict=True):
        rows, columns = layer.weight.shape
        W = layer.weight if rows <= columns else layer.weight.T
        torch.testing.assert_close(W @ W.T, gain**2 * torch.eye(len(W)), rtol=1e-4, atol=1e-5)
        assert (layer.bias == 0).all()


@torch.no_grad()
def test_the_policy_that_learns_is_the_one_that_acts(script):
    """By chance (six standard errors are allowed: once in 10⁹ times), or at its best."""
    agent, count = script.agent(script.world("ThreeSteps")), 20_000
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
        noise = (actions - policy.mean) / policy.stddev
        assert noise.mean(0).abs().max() < 6 / count**0.5
        torch.testing.assert_close(noise.T.cov(), torch.eye(2), rtol=0, atol=6 * (2 / count)**0.5)
