"""Environments as the scripts make them: rows are real transitions, and untidy ones work, too."""

import random

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import only
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from harness import ACTIONS, Uneven, World, load, read_log, register, spy_rollouts, train

import ppo_continuous as ppo

SIZES = ["--num-envs", 4, "--rollout-steps", 25, "--total-steps", 100]
both = only("a2c_vector", "ppo_continuous")


def play(script, name):
    envs = script.envs(script.world(name), 4, "Disabled")
    obs, _ = envs.reset(seed=script.module.make_seeds(1, 2, 4))
    agent = script.module.Agent(envs, 64)
    return envs, *script.module.rollout(envs, agent, obs, 25)


@both
@pytest.mark.parametrize("name", ["ThreeSteps", "Forever", "BothEnds", "Uneven"])
def test_every_row_is_a_real_transition(script, name):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    envs, batch, last_obs, returns = play(script, name)
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
    assert batch.actions.shape == (25, 4, *envs.single_action_space.shape)
    ends = [batch.rewards[t + 1 - int(next_obs[t, n, 1]):t + 1, n].sum().item()
            for t, n in done.nonzero().tolist()]
    assert returns == pytest.approx(ends, rel=1e-5)  # in the order in which episodes ended


@both
def test_the_stored_actions_are_those_that_were_executed(script):
    """In this world the sum of an action is its reward; it refuses actions out of bounds."""
    _, batch, *_ = play(script, "Uneven")
    executed = batch.actions.double()
    if script.name == "ppo_continuous":
        low, high = torch.tensor(ACTIONS.low), torch.tensor(ACTIONS.high)
        executed = (low + (high - low) * (torch.tanh(batch.actions) + 1) / 2).sum(-1).double()
    torch.testing.assert_close(batch.rewards, executed, rtol=1e-5, atol=1e-6)
    assert len(batch.rewards.unique()) == (3 if script.name == "a2c_vector" else 100)


@both
def test_every_episode_counts_once_with_its_raw_return(script, monkeypatch):
    """5 steps in 4 environments at a time: some episodes span two rollouts; NaN where none ends."""
    rollouts = spy_rollouts(monkeypatch, script.module)
    log = train(monkeypatch, script.module, "--env-id", script.world("Forever"), "--num-envs", 4,
                "--rollout-steps", 5, "--total-steps", 80)
    assert torch.equal(rollouts[0][1].next_obs[-1], rollouts[1][1].obs[0])  # which goes on
    assert log["env_step"].tolist() == [20, 40, 60, 80]
    np.testing.assert_equal(log["return"].to_numpy(), [np.nan, 8, np.nan, 8])


@both
def test_the_log_has_the_mean_return_of_the_episodes_that_ended(script, monkeypatch):
    kept, rollout = [], script.module.rollout
    monkeypatch.setattr(script.module, "rollout", lambda *x: kept.append(rollout(*x)) or kept[-1])
    log = train(monkeypatch, script.module, "--env-id", script.world("Uneven"), *SIZES)
    assert log["return"].tolist() == pytest.approx([np.mean(returns) for *_, returns in kept])


class SameArray(Uneven):
    """Returns one and the same array at every step, with new numbers in it."""

    def observe(self):
        self.shown = vars(self).get("shown", np.zeros(2, np.float32))
        self.shown[:] = super().observe()
        return self.shown


register("SameArray", SameArray)


@pytest.mark.filterwarnings("ignore:.*share an object:UserWarning")
def test_environments_may_return_the_same_array_at_every_step(script, tmp_path):
    """Three updates with it end with the same weights, digit for digit, as with new arrays."""
    one, other = (
        load(script.train(tmp_path / name, "--total-steps", 384, env_id=script.world(name))
             .with_suffix(".pt"))["agent"] for name in ("SameArray", "Uneven"))
    torch.testing.assert_close(one, other, rtol=0, atol=0)


register("Endless", length=None)
register("LongLimit", length=None, limit=20_000)


@pytest.mark.parametrize(
    ("name", "steps"), [("Forever", 8), ("Endless", 10_000), ("LongLimit", 20_000)])
def test_an_episode_lasts_as_long_as_registered_and_10_000_steps_without_a_limit(name, steps):
    envs = ppo.make_envs(f"{name}-v0", 1, "Disabled")
    envs.reset(seed=1)
    action = envs.action_space.sample()
    ends = [envs.step(action)[2:4] for _ in range(steps)]
    assert not np.any(ends[:-1])
    assert ends[-1] == (False, True)


def test_seeds_are_all_different_small_enough_and_always_the_same():
    seeds = [
        x for seed in range(10) for stream in range(10) for x in ppo.make_seeds(seed, stream, 16)]
    assert len(set(seeds)) == len(seeds) == 1600
    assert min(seeds) >= 0
    assert 2**30 < max(seeds) < 2**31
    assert ppo.make_seeds(3, 1, 5) == ppo.make_seeds(3, 1, 5) == ppo.make_seeds(3, 1, 9)[:5]


@both
def test_each_environment_of_a_training_starts_with_a_seed_of_its_own(script, monkeypatch):
    rollouts = spy_rollouts(monkeypatch, script.module)
    train(monkeypatch, script.module, "--env-id", script.world("ThreeSteps"), *SIZES, "--seed", 5)
    expected = [np_random(seed)[0].uniform(-1, 1) for seed in script.module.make_seeds(5, 2, 4)]
    assert rollouts[0][1].obs[0, :, 0].tolist() == pytest.approx(expected)


class Drawing(World):
    """Adds to its observations what generators other than its own give."""

    def observe(self):
        drawn = [np.random.uniform(), random.uniform(0, 1), torch.rand(()).item(),
                 self.observation_space.sample()[0] / 9, np.sum(self.action_space.sample())]
        return super().observe() + np.float32([sum(drawn), 0])


register("Drawing", Drawing, observations=Box(-9, 9, (2,)))


def test_a_seed_gives_the_same_files_whatever_an_environment_draws_from(script, tmp_path):
    def start(folder, seed):
        path = script.train(tmp_path / folder, env_id=script.world("Drawing"), seed=seed)
        return read_log(f"{path}.csv")

    first, again, other = start("first", 3), start("again", 3), start("other", 4)
    pd.testing.assert_frame_equal(first, again, check_exact=True)
    assert not first.equals(other)


class Untidy(World):
    """Wants options to be None, and a seed that fits into an int32; shows whole numbers.

    It says something else in `info` at every step.
    """

    def observe(self):
        return np.array([self.steps, 7])

    def reset(self, *, seed=None, options=None):
        assert options is None
        np.int32(seed or 0)
        return super().reset(seed=seed)[0], self.info()

    def info(self):
        noise = [None, "fell", 3, np.zeros(self.steps), {"x": [1] * self.total}, object()]
        keys = "goal", "episode", "return", "_return", "final_obs"
        return {key: noise[(self.total + i) % 6] for i, key in enumerate(keys)}


half = type("Half", (World,), {"reward": lambda self, action: np.float16(1)})
register("Half", half, length=3000)
register("Untidy", Untidy, observations=Box(0, 9, (2,), np.int64))
for dtype in np.float16, np.float64:
    actions = Box(ACTIONS.low.astype(dtype), ACTIONS.high.astype(dtype), dtype=dtype)
    gym.register(f"Actions{np.dtype(dtype)}-v0", World, kwargs={"actions": actions})


def test_untidy_environments_train_like_tidy_ones(script, tmp_path):
    log = read_log(f"{script.train(tmp_path, env_id=script.world('Untidy'))}.csv")
    assert (log[["return", "eval_return"]].dropna() == 3).all(axis=None)
    assert len(log) >= 4


@pytest.mark.parametrize("script", ["reinforce_mujoco", "ppo_continuous"], indirect=True)
@pytest.mark.parametrize("dtype", ["float16", "float64"])
def test_actions_come_in_the_dtype_of_their_space_and_within_its_bounds(script, dtype, tmp_path):
    """The world checks that."""
    script.train(tmp_path, env_id=f"Actions{dtype}-v0")


def test_rewards_of_float16_add_up_exactly(script, tmp_path):
    options = "--total-steps", 13_000, "--num-evals", 1, "--eval-episodes", 1
    options += ("--batch-episodes", 1) if script.name == "reinforce_mujoco" else ()
    log = read_log(f"{script.train(tmp_path, *options, env_id=script.world('Half'))}.csv")
    assert (log[["return", "eval_return"]].stack().dropna() == 3000).all()


@pytest.mark.filterwarnings("ignore:overflow encountered in cast:RuntimeWarning",
                            "ignore:invalid value:RuntimeWarning",
                            "ignore:.*not within the observation space:UserWarning")
@pytest.mark.parametrize(("method", "place", "value"), [
    ("observe", (0, 0), np.nan), ("observe", (2, 2), np.nan), ("observe", (3, 3), np.nan),
    ("observe", (3, 0), np.nan), ("observe", (2, 2), -np.inf), ("reward", (2, 2), np.nan),
    ("reward", (2, 2), -np.inf), ("reward", (2, 2), 1e300)])
def test_what_is_not_finite_ends_a_training(script, method, place, value, monkeypatch):
    """Also in the last observation of an episode, the first of the next, the first of all."""
    usual = getattr(World, method)

    def broken(self, *action):  # at a place: (steps in all, steps in the episode)
        return usual(self, *action) + (value if (self.total, self.steps) == place else 0)

    monkeypatch.setattr(World, method, broken)
    with pytest.raises(ValueError, match="infs or NaNs|not finite"):
        train(monkeypatch, script.module, "--env-id", script.world("ThreeSteps"),
              "--total-steps", 30)
