"""Agents: networks as training begins, actions as drawn from the policy, what is learned."""

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from harness import World, read_log, register
from torch import nn


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


def act(script, agent, deterministic=False):
    """Observations, and what was done."""
    if script.name == "reinforce_mujoco":
        return script.module.play(script.envs("ThreeSteps"), agent, deterministic)[:2]
    obs = np.float32([[1, 2]]).repeat(3, axis=0)
    return torch.tensor(obs), torch.tensor(agent.act(obs, deterministic))


@torch.no_grad()
def test_the_policy_that_learns_is_the_one_that_acts(script):
    """By chance (six standard errors are allowed: once in 10⁹ times), or at its best."""
    agent, count = script.agent("ThreeSteps"), 3000
    agent.actor[-1].bias.data = torch.linspace(-1.5, 0.5, len(agent.actor[-1].bias))
    obs, actions = (torch.cat(x) for x in zip(*[act(script, agent) for _ in range(count // 3)]))
    policy, (best_obs, best) = agent.policy(obs), act(script, agent, deterministic=True)
    if script.name == "a2c_vector":
        probs = policy.probs[0]
        assert (best == probs.argmax()).all()
        chance = 6 * (probs * (1 - probs) / count).sqrt()
        assert ((actions.bincount() / count - probs).abs() < chance).all()
    else:
        torch.testing.assert_close(best, agent.policy(best_obs).mean)
        noise = (actions - policy.mean) / policy.stddev
        assert noise.mean(0).abs().max() < 6 / count**0.5
        chance = 6 * (2 / count) ** 0.5
        torch.testing.assert_close(noise.T.cov(), torch.eye(2), rtol=0, atol=chance)


class Target(World):
    """One step; the best action is (2, 0.1), its reward 0."""

    def reward(self, action):
        return -float(np.square(action - np.float32([2, 0.1])).sum())


class Sign(World):
    """One step; the best action is 0 where the first number shown is negative, else 2."""

    def reward(self, action):
        return float(action == (0 if self.episode < 0 else 2))


# Wide, as REINFORCE's actions are clipped, and beyond the bounds of a box nothing leads back.
register("Target", Target, length=1)
register("Wide", Target, length=1, actions=Box(-9, 9, (2,)))
register("Sign", Sign, length=1)


@pytest.mark.parametrize(("script", "env_id", "options", "least"), [
    # At the end of a line: what the worst of 24 seeds has earned.
    ("reinforce_mujoco", "Wide-v0", "--total-steps 2048 --learning-rate 5e-3", -0.05),  # −0.001
    ("a2c_vector", "DiscreteSign-v0", "--num-envs 8", 0.8),  # 0.94
    ("ppo_continuous", "Target-v0", "--num-envs 8 --rollout-steps 64 --minibatch-size 64 "
     "--epochs 10 --first-std 0.22 --last-std 0.22", -0.1),  # −0.024
    pytest.param("ppo_continuous", "InvertedPendulum-v5", "--total-steps 24576 --num-envs 8 "
                 "--rollout-steps 128 --minibatch-size 128 --epochs 10 --learning-rate 1e-3 "
                 "--num-evals 1 --eval-episodes 2", 500, marks=pytest.mark.slow)],  # 1000 (new: 50)
    indirect=["script"])
def test_it_finds_the_best_action(script, env_id, options, least, tmp_path):
    """At best 0 (a new agent: −4, in the narrow box −0.8), in Sign 1 (at random: a third)."""
    usual = "--total-steps 8192 --learning-rate 3e-3 --eval-episodes 50"
    path = script.train(tmp_path, "--env-id", env_id, *usual.split(), *options.split())
    assert read_log(path)["eval_return"].iloc[-1] > least
