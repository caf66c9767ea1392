"""Networks as they are when training begins."""

import pytest
import torch
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
