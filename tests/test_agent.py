"""Networks as they are when training begins, and what falls in its course."""

import numpy as np
import pytest
import torch
from harness import spy, train
from torch import nn


@pytest.mark.parametrize(("network", "last_gain"), [("actor", 0.01), ("critic", 1.0)])
def test_weights_are_orthogonal_with_their_gains_and_biases_zero(script, network, last_gain):
    agent = script.agent(script.world("ThreeSteps"), hidden_size=24)
    layers = [layer for layer in getattr(agent, network) if isinstance(layer, nn.Linear)]
    assert [layer.out_features for layer in layers[:2]] == [24, 24]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain), strict=True):
        rows, columns = layer.weight.shape
        W = layer.weight if rows <= columns else layer.weight.T
        torch.testing.assert_close(W @ W.T, gain**2 * torch.eye(len(W)), rtol=1e-4, atol=1e-5)
        assert (layer.bias == 0).all()


SIZES = "--num-envs 4 --rollout-steps 3"


@pytest.mark.parametrize(("script", "options", "other", "first", "last"), [
    ("reinforce_mujoco", "--batch-episodes 4", lambda agent, **_: 0, 0, 0),
    ("a2c_vector", f"{SIZES} --entropy-coef 0.5",
     lambda agent, entropy_coef, **_: entropy_coef, 0.5, 0),
    ("ppo_continuous", f"{SIZES} --first-std 0.9 --last-std 0.2",
     lambda agent, **_: agent.policy(torch.zeros(2)).stddev[0].item(), 0.9, 0.2)],
    indirect=["script"])
def test_the_learning_rate_the_entropy_bonus_and_sigma_fall_in_a_straight_line(
        script, options, other, first, last, monkeypatch):
    """In updates of 12 steps, until 30 are reached."""
    def look(agent, optimizer, *_, **options):
        (group,) = optimizer.param_groups
        assert set(group["params"]) == set(agent.parameters())
        assert group["eps"] == (1e-5 if script.name == "a2c_vector" else 1e-8)
        return group["lr"], other(agent, **options)

    seen = spy(monkeypatch, script.module, "optimise", look)
    log = train(monkeypatch, script.module, "--env-id", script.world("ThreeSteps"),
                *options.split(), "--learning-rate", 0.02, "--total-steps", 30)
    assert log["env_step"].tolist() == [12, 24, 36]
    remaining = np.array([1, 0.6, 0.2])
    expected = 0.02 * remaining, last + (first - last) * remaining
    np.testing.assert_allclose(seen, np.transpose(expected), rtol=1e-5)
