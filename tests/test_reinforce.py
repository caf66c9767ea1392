"""reinforce_mujoco.py: its maths by hand, its policy, its episodes."""

import itertools
import math

import numpy as np
import pytest
import torch
from conftest import SCRIPTS
from gymnasium.spaces import Box
from harness import ACTIONS, World, explained_variance, read_log, register, spy

import reinforce_mujoco as rf

SCRIPT = SCRIPTS["reinforce_mujoco"]
LENGTHS = {"ThreeSteps": 3, "Forever": 8, "BothEnds": 3}
Rising = type("Rising", (World,), {"reward": lambda self, action: float(self.steps)})
register("Rising", Rising, limit=3, length=None, actions=Box(-1, 1, (3,)))


def make(world="ThreeSteps"):
    """An environment that has been seeded, and an agent for it."""
    env = rf.make_env(f"harness:{world}-v0")
    env.reset(seed=torch.randint(2**31, ()).item())
    return env, SCRIPT.agent(world)


@pytest.mark.parametrize("last_value", [0.0, 7.5])
@pytest.mark.parametrize("gamma", [0.0, 0.9, 1.0])
def test_rewards_to_go_are_the_discounted_rewards_from_a_step_on(gamma, last_value):
    rewards = torch.randn(30).tolist()
    expected = [
        sum(gamma ** (k - t) * rewards[k] for k in range(t, 30)) + gamma ** (30 - t) * last_value
        for t in range(30)]
    found = rf.compute_rewards_to_go(rewards, last_value, gamma)
    assert found.tolist() == pytest.approx(expected, abs=1e-5)


def test_the_mean_gradient_is_that_of_the_mean_return_also_if_actions_decide_how_long_one_plays():
    """One step that earns 1, or, as likely, ten that earn 1.8, of which only the first is chosen.

    All sixteen batches of four episodes. Divided by their steps the gradient would be below 0.
    """
    p, losses = torch.tensor(0.5, requires_grad=True), []
    for batch in itertools.product([1, 10], repeat=4):
        log_probs = [x for steps in batch for x in [
            (p if steps > 1 else 1 - p).log(), *[torch.tensor(0.0)] * (steps - 1)]]
        advantages = [x for steps in batch for x in [1.8 if steps > 1 else 1.0] * steps]
        losses.append(rf.policy_loss(torch.stack(log_probs), torch.tensor(advantages), 4))
    (gradient,) = torch.autograd.grad(-torch.stack(losses).mean(), p)
    assert gradient.item() == pytest.approx(1.8 - 1, rel=1e-5)


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


def test_explained_variance_is_that_of_the_critic_before_it_was_fitted(monkeypatch, tmp_path):
    """It is near 1 only where V is near G: at half of G, as an early V may be, it is far below."""
    values = spy(monkeypatch, rf, "compute_advantages", lambda G, V, _: (V.numpy(), G.numpy()))
    log = read_log(SCRIPT.train(tmp_path, "--env-id", "harness:Uneven-v0", "--total-steps", 2000))
    expected = [explained_variance(*x) for x in values]
    np.testing.assert_allclose(log["explained_variance"], expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("world", LENGTHS)
def test_an_episode_is_made_of_real_steps_and_only_a_time_limit_is_bootstrapped(world):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    (env, agent), length, starts = make(world), LENGTHS[world], set()
    for n in range(1, 4):
        obs, _, rewards, last_value = rf.play(env, agent)
        assert env.unwrapped.total == n * length
        assert obs[:, 1].tolist() == list(range(length))
        (start,) = obs[:, 0].unique().tolist()
        starts.add(start)
        assert rewards == [1.0] * length
        expected = agent.critic(torch.tensor([start, length])).item()
        assert last_value == pytest.approx(expected if world == "Forever" else 0, rel=1e-4)
    assert len(starts) == 3


def test_each_row_keeps_its_own_action_and_reward():
    """The action that is learned from, before clipping, is the one that earned the reward."""
    episodes = [rf.play(*make("Uneven")) for _ in range(20)]  # the sum of an action is its reward
    actions = torch.cat([x.actions for x in episodes]).numpy()
    env_actions = actions.clip(ACTIONS.low, ACTIONS.high)
    assert (actions != env_actions).any(1).sum() > 10
    rewards = sum([x.rewards for x in episodes], [])
    np.testing.assert_allclose(rewards, env_actions.sum(1), rtol=1e-4)
