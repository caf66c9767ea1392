"""Environments, and the rollouts of A2C and PPO: each row is a step that was really taken."""

import math

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import only
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from harness import ACTIONS, World, register

import ppo_continuous as ppo

UNEVEN, WIDE = "test_rollout:Uneven", "test_rollout:Wide"
SIZES = "--num-envs 4 --rollout-steps 25 --total-steps 100"

both = only("a2c_vector", "ppo_continuous")
# Python 3.12 and later warn of a fork while threads run, such as that of tqdm.
may_fork = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


class Uneven(World):
    """Episodes of 3 steps, of 7 if its first number is positive; the action is the reward."""

    def reset(self, *, seed=None, options=None):
        shown = super().reset(seed=seed, options=options)
        self.length = 7 if self.episode > 0 else 3
        return shown

    def reward(self, action):
        return float(action.sum())


class SameArray(Uneven):
    """Returns one and the same array at every step, with new numbers in it."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.shown = np.zeros(2, np.float32)

    def observe(self):
        self.shown[:] = super().observe()
        return self.shown


class Wide(World):
    """Shows float64, as the worlds of MuJoCo do."""

    def observe(self):
        return super().observe().astype(np.float64)


register("Uneven", Uneven)
register("SameArray", SameArray)
register("Wide", Wide, observations=Box(-np.inf, np.inf, (2,), np.float64))
register("Endless", length=None)
register("LongLimit", length=None, limit=20_000)


def make(script, world="harness:ThreeSteps", autoreset_mode="Disabled"):
    """Arguments, environments and an agent for them; REINFORCE has one environment."""
    module, (place, name) = script.module, world.split(":")
    options = ["--env-id", f"{place}:{script.worlds}{name}-v0"]
    one = script.name == "reinforce_mujoco"
    args = module.parse_args(options if one else [*options, *SIZES.split()])
    envs = module.make_envs(args.env_id, 1 if one else args.num_envs, autoreset_mode)
    return args, envs, module.Agent(envs.single_observation_space, envs.single_action_space, args)


def play(script, args, envs, agent):
    """The first rollout; REINFORCE resets its environment itself."""
    module, start = script.module, ()
    if script.name != "reinforce_mujoco":
        start = envs.reset(seed=module.make_seeds(1, 2, args.num_envs))[:1]
    return module.rollout(envs, agent, *start, args, 0)


# --- Rollouts -------------------------------------------------------------------------------------


@both
@pytest.mark.parametrize(
    "world", ["harness:ThreeSteps", "harness:Forever", "harness:BothEnds", UNEVEN])
def test_every_row_is_a_real_transition(script, world):
    """The world shows (episode, steps since its start): what each row must look like is known."""
    args, envs, agent = make(script, world)
    batch, last_obs, _ = play(script, args, envs, agent)
    obs, next_obs, done = batch.obs, batch.next_obs, batch.done
    length = torch.where(obs[..., 0] > 0, 7, 3) if world == UNEVEN else 3
    length = 8 if world == "harness:Forever" else length
    assert (obs[0, :, 1] == 0).all()
    assert torch.equal(next_obs[..., 0], obs[..., 0])  # the same episode, also at its end
    assert torch.equal(next_obs[..., 1], obs[..., 1] + 1)
    assert torch.equal(done, (next_obs[..., 1] == length).float())
    by_itself = torch.zeros_like(done) if world == "harness:Forever" else done
    assert torch.equal(batch.terminated, by_itself)
    shown = torch.cat([obs[1:], torch.tensor(last_obs)[None]])
    assert torch.equal(shown[done == 0], next_obs[done == 0])
    assert (shown[done == 1][:, 1] == 0).all()
    assert (shown[done == 1] != next_obs[done == 1]).all()  # another episode
    assert (batch.rewards == 1).all() or world == UNEVEN
    for env in envs.unwrapped.envs:  # as many rows as steps, by its own count
        assert env.unwrapped.total == 25
    actions = 25, 4, *envs.single_action_space.shape
    shapes = {"obs": (25, 4, 2), "next_obs": (25, 4, 2), "actions": actions}
    for name, x in vars(batch).items():
        assert x.shape == shapes.get(name, (25, 4))
        assert x.dtype == torch.float32


@both
def test_the_stored_actions_are_those_that_were_executed(script):
    """In this world the sum of an action is its reward; it refuses actions out of bounds."""
    args, envs, agent = make(script, UNEVEN)
    batch, _, _ = play(script, args, envs, agent)
    executed = batch.actions
    if script.name == "ppo_continuous":
        low, high = torch.as_tensor(ACTIONS.low), torch.as_tensor(ACTIONS.high)
        executed = (low + (high - low) * (torch.tanh(batch.actions) + 1) / 2).sum(-1)
    torch.testing.assert_close(batch.rewards, executed)
    assert len(batch.rewards.unique()) == (3 if script.name == "a2c_vector" else 100)


@both
def test_environments_that_end_at_different_steps_have_their_own_returns(script):
    args, envs, agent = make(script, UNEVEN)
    batch, _, episodes = play(script, args, envs, agent)
    expected = []
    for t, n in batch.done.nonzero().tolist():
        length = int(batch.next_obs[t, n, 1])
        total = batch.rewards[t + 1 - length:t + 1, n].sum().item()
        expected.append((4 * (t + 1), pytest.approx(total, rel=1e-5), length))
    assert [tuple(row.values()) for row in episodes] == expected
    assert {row["length"] for row in episodes} == {3, 7}


@both
@pytest.mark.parametrize(("world", "length"), [("ThreeSteps", 3), ("Forever", 8)])
def test_every_finished_episode_is_logged_once_with_raw_return(script, world, length, tmp_path):
    """5 steps in 4 environments at a time: some episodes span two rollouts."""
    options = "--rollout-steps", 5, "--total-steps", 80
    folder = script.train(tmp_path, *options, env_id=script.world(world))
    episodes = pd.read_csv(folder / "episodes.csv")
    ends = [4 * step for step in range(length, 21, length) for _ in range(4)]
    assert episodes["env_step"].tolist() == ends
    assert (episodes[["return", "length"]] == length).all(axis=None)


@may_fork
@pytest.mark.filterwarnings("ignore:.*share an object:UserWarning")
@pytest.mark.parametrize(
    ("script", "options"),
    [("reinforce_mujoco", ()), ("a2c_vector", ()), ("ppo_continuous", ()),
     ("a2c_vector", ("--vectorization", "async"))],
    indirect=["script"])
def test_environments_may_return_the_same_array_at_every_step(script, options, tmp_path):
    """Three updates with it end with the same weights, digit for digit, as with new arrays."""
    agents = []
    for world in "SameArray", "Uneven":
        env_id = f"test_rollout:{script.worlds}{world}-v0"
        folder = script.train(tmp_path / world, "--total-steps", 384, *options, env_id=env_id)
        agents.append(torch.load(folder / "checkpoint.pt", weights_only=True)["agent"])
    assert all(torch.equal(x, agents[1][name]) for name, x in agents[0].items())


# --- Environments ---------------------------------------------------------------------------------


def test_seeds_are_all_different_and_always_the_same():
    seeds = [
        x for seed in range(10) for stream in range(10) for x in ppo.make_seeds(seed, stream, 16)]
    assert len(set(seeds)) == len(seeds) == 1600
    assert ppo.make_seeds(3, 1, 5) == ppo.make_seeds(3, 1, 5) == ppo.make_seeds(3, 1, 9)[:5]


@both
@pytest.mark.parametrize("env_step", [0, 40])
def test_each_environment_of_a_training_starts_with_a_seed_of_its_own(script, env_step):
    """When it is resumed at step 40, with others than at step 0."""
    args, envs, agent = make(script)
    optimizer = script.module.make_optimizer(agent)
    next(script.module.train(args, 5, envs, agent, optimizer, env_step))
    seeds = script.module.make_seeds(5, 2 + env_step, 4)
    expected = [np_random(seed)[0].uniform(-1, 1) for seed in seeds]
    assert [env.unwrapped.episode for env in envs.unwrapped.envs] == expected


@pytest.mark.parametrize(
    ("world", "steps"), [("harness:Forever", 8), ("test_rollout:Endless", 10_000),
                         ("test_rollout:LongLimit", 20_000)])
def test_an_episode_lasts_as_long_as_registered_and_10_000_steps_without_a_limit(world, steps):
    envs = ppo.make_envs(f"{world}-v0", 1, "Disabled")
    envs.reset(seed=1)
    action = envs.action_space.sample()
    ends = [envs.step(action)[2:4] for _ in range(steps)]
    assert not np.any(ends[:-1])
    assert ends[-1] == (False, True)


PLACES = {  # a method of the world, its step in all, its step in the episode
    "reward": ("reward", 2, 2), "observation": ("observe", 2, 2),
    "last of an episode": ("observe", 3, 3), "first of the next": ("observe", 3, 0),
    "first of all": ("observe", 0, 0)}
expected_warnings = pytest.mark.filterwarnings(
    "ignore:overflow encountered in cast:RuntimeWarning",
    "ignore:.*not within the observation space:UserWarning")


def break_last(envs, what, total, steps, value):
    """Add `value` to what the last world returns at its step `total`, `steps` into an episode."""
    world = envs.unwrapped.envs[-1].unwrapped
    healthy = getattr(world, what)

    def faulty(*arguments):
        result = healthy(*arguments)
        broken = (world.total, world.steps) == (total, steps)
        return result + value if broken else result

    setattr(world, what, faulty)


@expected_warnings
@pytest.mark.parametrize(("place", "value"), [
    *((place, math.nan) for place in PLACES),
    *((place, x) for place in ("reward", "observation") for x in (math.inf, -math.inf, 1e300))])
def test_what_is_not_finite_in_float32_ends_a_training(script, place, value):
    args, envs, agent = make(script, WIDE)
    break_last(envs, *PLACES[place], value)
    with pytest.raises(ValueError, match="infs or NaNs"):
        play(script, args, envs, agent)
