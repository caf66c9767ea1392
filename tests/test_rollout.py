"""What A2C and PPO store: every row is a real transition, and every environment has its seed."""

import numpy as np
import pytest
import torch
from conftest import both
from gymnasium.utils.seeding import np_random
from harness import ACTIONS, SEED, read_log, spy


def play(script, name):
    envs = script.envs(name, 4, autoreset_mode="Disabled")
    obs, _ = envs.reset(seed=SEED)
    agent = script.agent(name)
    return envs, *script.module.rollout(envs, agent, obs, 0.0, 25)


@both
@pytest.mark.parametrize("name", ["ThreeSteps", "Forever", "BothEnds", "Uneven"])
def test_every_row_is_a_real_transition(script, name):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    envs, batch, last_obs, earned, returns = play(script, name)
    obs, next_obs, done = batch.obs, batch.next_obs, batch.done
    length = torch.where(obs[..., 0] > 0, 7, 3) if name == "Uneven" else 3
    length = 8 if name == "Forever" else length
    assert (obs[0, :, 1] == 0).all()
    assert torch.equal(next_obs[..., 0], obs[..., 0])  # the same episode, also at its end
    assert torch.equal(next_obs[..., 1], obs[..., 1] + 1)
    assert torch.equal(done, next_obs[..., 1] == length)
    assert torch.equal(batch.terminated, torch.zeros_like(done) if name == "Forever" else done)
    shown = torch.cat([obs[1:], torch.tensor(last_obs)[None]])
    assert torch.equal(shown[~done], next_obs[~done])
    assert (shown[done][:, 1] == 0).all()
    assert (shown[done] != next_obs[done]).all()  # another episode
    assert (batch.rewards == 1).all() or name == "Uneven"
    for env in envs.unwrapped.envs:  # as many rows as steps, by its own count
        assert env.unwrapped.total == 25
    ends = [batch.rewards[t + 1 - int(next_obs[t, n, 1]):t + 1, n].sum().item()
            for t, n in done.nonzero().tolist()]
    assert returns == pytest.approx(ends, rel=1e-5)  # in the order in which episodes ended
    running = [batch.rewards[25 - int(last_obs[n, 1]):, n].sum().item() for n in range(4)]
    assert earned.tolist() == pytest.approx(running, rel=1e-5)


@both
def test_the_stored_actions_are_those_that_were_executed(script):
    """In this world the sum of an action is its reward; it refuses actions out of bounds."""
    _, batch, *_ = play(script, "Uneven")
    executed = batch.actions.double()
    if script.name == "ppo_continuous":
        low, high = torch.tensor(ACTIONS.low), torch.tensor(ACTIONS.high)
        executed = (low + (high - low) * (torch.tanh(batch.actions) + 1) / 2).sum(-1).double()
    torch.testing.assert_close(batch.rewards, executed, rtol=1e-5, atol=1e-6)
    assert len(batch.rewards.unique()) >= (3 if script.name == "a2c_vector" else 50)


@both
def test_every_environment_has_its_own_seed_and_every_episode_counts_once_with_its_raw_return(
        script, monkeypatch, tmp_path):
    """5 steps in 4 environments at a time: episodes of 8 span two rollouts; NaN where none ends."""
    starts = spy(monkeypatch, script.module, "rollout", lambda envs, agent, obs, *_: obs)
    log = read_log(script.train(tmp_path, "--env-id", script.world("Forever"), "--rollout-steps", 5,
                                "--total-steps", 80))
    drawn = [np_random(1000 * (SEED + 3) + i)[0].uniform(-1, 1) for i in range(4)]
    np.testing.assert_allclose(starts[0], [[x, 0] for x in drawn], rtol=1e-5)
    np.testing.assert_allclose(starts[1], [[x, 5] for x in drawn], rtol=1e-5)
    assert log["env_step"].tolist() == [20, 40, 60, 80]
    np.testing.assert_equal(log["return"].to_numpy(), [np.nan, 8, np.nan, 8])
