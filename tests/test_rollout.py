"""What A2C and PPO store: every row is a real transition, every episode counts once."""

import numpy as np
import pytest
import torch
from conftest import SCRIPTS, both
from harness import ACTIONS, SEED, length, read_log, spy


@pytest.mark.parametrize("name", ["ThreeSteps", "Forever", "BothEnds", "Uneven"])
def test_every_row_is_a_real_transition(name):
    """The world shows (episode, steps since its start): what each row must look like is known.

    In Uneven the sum of an action, as executed, is its reward; it refuses actions out of bounds.
    """
    script = SCRIPTS["ppo_continuous"]  # whose rollout is also that of A2C
    envs = script.envs(name, 4, autoreset_mode="Disabled")
    obs, _ = envs.reset(seed=SEED)
    batch, last_obs, earned, returns = script.module.rollout(
        envs, script.agent(name), obs, 0.0, 25)
    obs, next_obs, done = batch.obs, batch.next_obs, batch.done
    assert (obs[0, :, 1] == 0).all()
    assert torch.equal(next_obs[..., 0], obs[..., 0])  # the same episode, also at its end
    assert torch.equal(next_obs[..., 1], obs[..., 1] + 1)
    assert torch.equal(done, next_obs[..., 1] == length(name, obs[..., 0]))
    assert torch.equal(batch.terminated, torch.zeros_like(done) if name == "Forever" else done)
    shown = torch.cat([obs[1:], torch.tensor(last_obs)[None]])
    assert torch.equal(shown[~done], next_obs[~done])
    assert (shown[done][:, 1] == 0).all()
    assert (shown[done] != next_obs[done]).all()  # another episode
    low, high = torch.tensor(ACTIONS.low), torch.tensor(ACTIONS.high)
    executed = low + (high - low) * (torch.tanh(batch.actions) + 1) / 2
    rewards = executed.sum(-1) if name == "Uneven" else torch.ones(25, 4)
    torch.testing.assert_close(batch.rewards, rewards.double(), rtol=1e-5, atol=1e-6)
    for env in envs.unwrapped.envs:  # as many rows as steps, by its own count
        assert env.unwrapped.total == 25
    ends = [batch.rewards[t + 1 - int(next_obs[t, n, 1]):t + 1, n].sum().item()
            for t, n in done.nonzero().tolist()]
    assert returns == pytest.approx(ends, rel=1e-5)  # in the order in which episodes ended
    running = [batch.rewards[25 - int(last_obs[n, 1]):, n].sum().item() for n in range(4)]
    assert earned.tolist() == pytest.approx(running, rel=1e-5)


@both
def test_training_goes_on_where_a_rollout_stopped_and_logs_raw_returns(
        script, monkeypatch, tmp_path):
    """5 steps in 4 environments at a time: episodes of 8 span two rollouts; NaN where none ends."""
    starts = spy(monkeypatch, script.module, "rollout", lambda envs, agent, obs, *_: obs)
    log = read_log(script.train(tmp_path, "--env-id", script.world("Forever"), "--rollout-steps", 5,
                                "--total-steps", 80))
    np.testing.assert_equal(starts[1], starts[0] + [0, 5])
    assert log["env_step"].tolist() == [20, 40, 60, 80]
    np.testing.assert_equal(log["return"].to_numpy(), [np.nan, 8, np.nan, 8])
