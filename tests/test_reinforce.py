"""reinforce_mujoco.py: its maths by hand, its policy, its episodes."""

import math

import numpy as np
import pytest
import torch
from conftest import SCRIPTS
from gymnasium.spaces import Box
from harness import ACTIONS, World, explained_variance, length, read_log, register, spy

import reinforce_mujoco as rf

SCRIPT = SCRIPTS["reinforce_mujoco"]
Rising = type("Rising", (World,), {"reward": lambda self, action: float(self.steps)})
register("Rising", Rising, limit=3, length=None, actions=Box(-1, 1, (3,)))


def make(world="ThreeSteps"):
    """An environment that has been seeded, and an agent for it."""
    env = rf.make_env(f"harness:{world}-v0")
    env.reset(seed=torch.randint(2**31, ()).item())
    return env, SCRIPT.agent(world)


@pytest.mark.parametrize("baseline", ["none", "mean", "value"])
@pytest.mark.parametrize("episodes", [1, 2])
def test_train_descends_the_gradient_of_the_loss_written_out(
        episodes, baseline, monkeypatch, tmp_path):
    """With 3 action dimensions, also in a batch of 3 steps, where axes are easily confused.

    At learning rate 0 the agent stays what it was, so that all can be computed again afterwards.
    Time is up after 3 steps, so V(s_3) stands for what would have followed.
    """
    steps = []  # gradients, of each

    def look(agent, optimizer, batch, *_, **__):
        if not steps:
            optimizer.register_step_pre_hook(lambda *_: steps.append(
                [None if p.grad is None else p.grad.clone() for p in agent.parameters()]))
        return agent, batch

    seen = spy(monkeypatch, rf, "optimise", look)
    path = SCRIPT.train(
        tmp_path, "--env-id", "Rising-v0", "--batch-episodes", episodes, "--total-steps",
        3 * episodes + 1, "--learning-rate", 0, "--gamma", 0.9, "--baseline", baseline,
        "--critic-steps", 2)
    log = read_log(path)
    assert log["return"].tolist() == [6, 6]  # two updates, so that a sum of gradients would be seen
    assert len(steps) == 2 * (1 + 2)
    agent, batch = seen[-1]
    obs, actions = (torch.cat([episode[i] for episode in batch]) for i in (0, 1))
    assert actions.shape == (3 * episodes, 3)
    last_value = agent.critic(obs[2::3] + torch.tensor([0, 1])).detach()  # it shows its steps
    G = torch.tensor([1 + 0.9 * (2 + 0.9 * 3), 2 + 0.9 * 3, 3.0])
    G = (G + torch.tensor([0.9**3, 0.9**2, 0.9]) * last_value).flatten()
    values = agent.critic(obs)[:, 0]
    loss_v = ((values - G) ** 2).sum() / (2 * len(G))
    advantages = {"none": G, "value": G - values.detach(), "mean": G - G.mean()}[baseline]
    outputs = agent.actor(obs)
    std = (1 + outputs[:, 3:].exp()).log() + 0.1
    noise = (actions - outputs[:, :3]) / std
    log_density = (-(noise**2) / 2 - std.log() - math.log(2 * math.pi) / 2).sum(1)
    loss_pi = -(log_density * advantages).sum() / episodes
    actor, critic = list(agent.actor.parameters()), list(agent.critic.parameters())
    of_actor = [*torch.autograd.grad(loss_pi, actor), *[None] * len(critic)]
    of_critic = [*[None] * len(actor), *torch.autograd.grad(loss_v, critic)]
    for found, expected in zip(steps[3:], (of_actor, of_critic, of_critic), strict=True):
        for x, y in zip(found, expected, strict=True):
            if y is None:  # no gradient at all, so that Adam's momentum does not move it, either
                assert x is None
            else:
                torch.testing.assert_close(x, y, rtol=1e-3, atol=1e-5)
                assert y.abs().max() > 1e-4
    expected = {"value_loss": loss_v.item(), "policy_std": std.mean().item()}
    assert dict(log.iloc[-1][list(expected)]) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("world", "gamma"), [("Uneven", 0.98), ("ThreeSteps", 0)])
def test_explained_variance_is_that_of_the_critic_before_it_was_fitted(
        world, gamma, monkeypatch, tmp_path):
    """Near 1 only where V is near G, far below at half of G; blank where all G are 1."""
    values = spy(monkeypatch, rf, "compute_advantages", lambda G, V, _: (V.numpy(), G.numpy()))
    path = SCRIPT.train(tmp_path, "--env-id", f"harness:{world}-v0", "--gamma", gamma)
    expected = [explained_variance(*x) for x in values]
    found = read_log(path)["explained_variance"]
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)
    assert found.isna().all() == (gamma == 0)


@pytest.mark.parametrize("world", ["ThreeSteps", "Forever", "BothEnds", "Uneven"])
def test_an_episode_is_made_of_real_steps_and_only_a_time_limit_is_bootstrapped(world):
    """The world shows (episode, steps since its start): what each row must look like is known.

    In Uneven the sum of an action, as clipped, is its reward; it refuses actions out of bounds.
    """
    (env, agent), starts, total, clipped = make(world), set(), 0, 0
    for _ in range(20):
        obs, actions, rewards, last_value = rf.play(env, agent)
        (start,) = obs[:, 0].unique().tolist()
        starts.add(start)
        steps = int(length(world, torch.tensor(start)))
        total += steps
        assert env.unwrapped.total == total
        assert obs[:, 1].tolist() == list(range(steps))
        executed = actions.numpy().clip(ACTIONS.low, ACTIONS.high)
        clipped += (actions.numpy() != executed).sum()
        expected = executed.sum(1) if world == "Uneven" else np.ones(steps)
        np.testing.assert_allclose(rewards, expected, rtol=1e-4)
        value = agent.critic(torch.tensor([start, steps])).item()
        assert last_value == pytest.approx(value if world == "Forever" else 0, rel=1e-4)
    assert len(starts) == 20
    assert clipped > 10  # what is learned from is what was drawn
