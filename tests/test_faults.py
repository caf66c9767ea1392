"""Environments as people have them: odd numbers, odd generators, no limit, no end; their films."""

import random
from contextlib import nullcontext
from copy import deepcopy
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import only
from gymnasium.spaces import Box, Discrete
from harness import ACTIONS, SEED, World, load, read_log, register, spy, train
from PIL import Image

# --- What it shows, pays and says -----------------------------------------------------------------


class Bits(World):
    """Shows two bits, which every dtype can, and pays what float16 can, but cannot add up."""

    look, pay = np.float32, float

    def __init__(self, dtype=np.float32, **kwargs):
        super().__init__(observations=Box(0, 1, (2,), dtype), **kwargs)

    def observe(self):
        return self.look([self.steps % 2, self.episode > 0])

    def reward(self, action):
        return self.pay(1000.5 - self.steps)


class SameArray(Bits):
    """Returns one and the same array at every step, with new numbers in it."""

    def observe(self):
        vars(self).setdefault("shown", np.zeros(2, np.float32))[:] = super().observe()
        return self.shown


class Demanding(Bits):
    """Wants options None and a seed for an int32; says something else in `info` at every step."""

    def reset(self, *, seed=None, options=None):
        assert options is None
        np.int32(seed or 0)
        return super().reset(seed=seed)[0], self.info()

    def step(self, action):
        return *super().step(action)[:4], self.info()

    def info(self):
        noise = [None, "fell", 3, np.zeros(self.steps), {"x": [1] * self.total}, object()]
        keys = "goal", "episode", "return", "_return", "final_obs"
        return {key: noise[(self.total + i) % 6] for i, key in enumerate(keys)}


def kind(**attributes):
    return type("Kind", (Bits,), {name: staticmethod(x) for name, x in attributes.items()})


DTYPES = "bool", "uint8", "uint16", "uint32", "int64", "float16", "float64", "longdouble"
KINDS = {
    **{dtype: kind(look=lambda bits, dtype=dtype: np.array(bits, dtype)) for dtype in DTYPES},
    "big-endian": kind(look=lambda bits: np.array(bits, ">f4")),
    "backwards": kind(look=lambda bits: np.float32(bits[::-1])[::-1]),
    "read-only": kind(look=lambda bits: np.frombuffer(np.float32(bits).tobytes(), np.float32)),
    "same array": SameArray,
    "demanding": Demanding,
    "actions float16": Bits,
    "actions float64": Bits,
    "reward (1,)": kind(pay=lambda x: np.array([x])),
    "reward ()": kind(pay=np.array),
    "reward float16": kind(pay=np.float16),
    "reward longdouble": kind(pay=np.longdouble)}
register("Bits", Bits)
for i, (name, world) in enumerate(KINDS.items()):
    register(f"Kind{i}", world, dtype=name if name in DTYPES else "float32")
    if "actions" in name:
        dtype = name.split()[1]
        space = Box(ACTIONS.low.astype(dtype), ACTIONS.high.astype(dtype), dtype=dtype)
        gym.registry[f"Kind{i}-v0"].kwargs["actions"] = space


@pytest.mark.filterwarnings("ignore::UserWarning")  # Gymnasium's, of what it sees
def test_the_same_numbers_train_the_same_agent_however_they_are_handed_over(script, tmp_path):
    """As from the same world in float32 and float."""
    def learn(name):
        path = script.train(tmp_path, "--total-steps", 128, "--num-evals", 1,
                            env_id=script.world(name, "test_faults"))
        return load(f"{path}.pt")["agent"], read_log(f"{path}.csv")

    agent, log = learn("Bits")
    assert (log[["return", "eval_return"]].stack().dropna() == 999.5 + 998.5 + 997.5).all()
    for i, name in enumerate(KINDS):
        other_agent, other_log = learn(f"Kind{i}")
        torch.testing.assert_close(other_agent, agent, rtol=0, atol=0, msg=name)
        pd.testing.assert_frame_equal(other_log, log, check_exact=True, obj=name)


@pytest.mark.filterwarnings("ignore:overflow encountered in cast:RuntimeWarning",
                            "ignore:invalid value:RuntimeWarning", "ignore::UserWarning")
@pytest.mark.parametrize(("method", "place", "value"), [
    ("observe", (0, 0), np.nan), ("observe", (2, 2), np.nan), ("observe", (3, 3), np.nan),
    ("observe", (3, 0), np.nan), ("observe", (2, 2), -np.inf), ("reward", (2, 2), np.nan),
    ("reward", (2, 2), -np.inf)])
def test_what_is_not_finite_ends_a_training_and_is_named(script, method, place, value, monkeypatch):
    """Also in the last observation of an episode, the first of the next, the first of all."""
    usual = getattr(World, method)

    def broken(self, *action):  # at a place: (steps in all, steps in the episode)
        return usual(self, *action) + (value if (self.total, self.steps) == place else 0)

    monkeypatch.setattr(World, method, broken)
    name = {"observe": "an observation", "reward": "a reward"}[method]
    with pytest.raises(ValueError, match=f"{name} of .*ThreeSteps-v0 is NaN or infinite"):
        train(monkeypatch, script.module, "--env-id", script.world("ThreeSteps"),
              "--total-steps", 30)


def test_a_weight_that_is_not_finite_ends_a_training_and_the_learning_rate_is_named(
        script, monkeypatch):
    optimise = script.module.optimise

    def explode(agent, *rest, **options):
        metrics = optimise(agent, *rest, **options)
        agent.critic[2].weight.data[0, 0] = np.inf
        return metrics

    monkeypatch.setattr(script.module, "optimise", explode)
    with pytest.raises(ValueError, match="weight .*--learning-rate"):
        train(monkeypatch, script.module, "--env-id", script.world("ThreeSteps"))


# --- Where it draws from --------------------------------------------------------------------------

SHARED = {Box: Box(-9, 9, (2,)), "Box": ACTIONS, "Discrete": Discrete(3)}


class Drawing(World):
    """Draws from generators other than its own, also when it is made.

    Its spaces are those of all its kind.
    """

    def __init__(self, actions):
        super().__init__(observations=SHARED[Box], actions=SHARED[type(actions).__name__])
        self.level = np.random.uniform()

    def observe(self):
        drawn = [np.random.uniform(), random.uniform(0, 1), torch.rand(()).item(),
                 self.observation_space.sample()[0] / 9, np.sum(self.action_space.sample())]
        return super().observe() + np.float32([sum(drawn), 0])

    def reward(self, action):
        return float(np.sum(action) + np.random.uniform() + self.level)


class Seeding(Drawing):
    """Seeds the generators of the process, as ports of old environments do."""

    def reset(self, *, seed=None, options=None):
        for set_seed in (np.random.seed, random.seed, torch.manual_seed):
            if seed is not None:
                set_seed(seed)
        return super().reset(seed=seed)


class Hiding(Drawing):
    """Its space is a property, which hands out its own."""

    observation_space = property(
        lambda self: self.hidden, lambda self, space: vars(self).update(hidden=deepcopy(space)))


DRAWING = Drawing, Seeding, Hiding
for world in DRAWING:
    register(world.__name__, world)


@pytest.mark.parametrize("name", [world.__name__ for world in DRAWING])
def test_a_seed_repeats_all_and_an_evaluation_touches_nothing(
        script, name, watch, tmp_path, monkeypatch):
    """Nor does the number of its environments, which draw when they are made."""
    def start(folder, seed, *options):
        env_id = script.world(name, "test_faults")
        path = script.train(tmp_path / folder, *options, env_id=env_id, seed=seed)
        return path, read_log(f"{path}.csv")

    (path, first), (_, again), (_, other) = (
        start(*x) for x in (("first", SEED), ("again", SEED), ("other", SEED + 1)))
    pd.testing.assert_frame_equal(first, again, check_exact=True)
    assert not first.equals(other)
    assert first["eval_return"].count() >= 3
    for options in (), ("--eval-episodes", 2, "--seed", SEED):
        assert watch(script, path, *options)[0] == first["eval_return"].iloc[-1]
    monkeypatch.setattr(script.module, "evaluate", lambda *_: 0.0)
    _, undisturbed = start("undisturbed", SEED, "--eval-episodes", 3)
    first, undisturbed = (x.drop(columns="eval_return") for x in (first, undisturbed))
    pd.testing.assert_frame_equal(first, undisturbed, check_exact=True)


class MadeByChance(World):
    """Like World, but what it is made of is drawn."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        torch.rand(3)


register("MadeByChance", MadeByChance)


def test_what_an_environment_draws_when_it_is_made_does_not_change_the_first_weights(
        script, tmp_path):
    def first_weights(name):
        env_id = script.world(name, "test_faults")
        path = script.train(tmp_path / name, "--learning-rate", 0, env_id=env_id)
        return load(f"{path}.pt")["agent"]

    usual, drawn = first_weights("Bits"), first_weights("MadeByChance")
    for name, weights in usual.items():
        if "actor" in name or "critic" in name:
            torch.testing.assert_close(drawn[name], weights, rtol=0, atol=0)


# --- When it ends ---------------------------------------------------------------------------------

register("Long", length=1200)
register("LongLimit", limit=1100, length=None)


@pytest.mark.parametrize("name", ["Long", "LongLimit"])
def test_only_an_episode_without_registered_limit_is_cut_and_a_line_says_so(
        script, name, call):
    """By an evaluation and by REINFORCE, which needs whole episodes, after 1,000 steps."""
    options = ["--total-steps", "1300", "--num-evals", "1", "--eval-episodes", "1"]
    if script.name == "reinforce_mujoco":
        options += ["--batch-episodes", "1"]
    else:
        options += ["--num-envs", "1", "--rollout-steps", "1300"]
    out = call(script, "--env-id", script.world(name, "test_faults"), *options)
    (path,) = Path("runs").rglob("seed-1.csv")
    log = read_log(path)
    cut = 1000 if script.name == "reinforce_mujoco" else 1200
    assert log["return"].iloc[0] == {"Long": cut, "LongLimit": 1100}[name]
    assert log["eval_return"].iloc[0] == {"Long": 1000, "LongLimit": 1100}[name]
    told = [line for line in out.splitlines() if "1,000 steps" in line]
    assert len(told) == (name == "Long")
    assert all("Long-v0" in line and "max_episode_steps" in line for line in told)


@pytest.mark.parametrize("failure", [None, RuntimeError("lost"), KeyboardInterrupt()])
def test_environments_are_closed_however_training_ends(script, failure, monkeypatch, tmp_path):
    def reward(world, action):
        if world.total > 50 and failure:
            raise failure
        return 1.0

    monkeypatch.setattr(World, "reward", reward)
    opened = spy(monkeypatch, World, "__init__", lambda world, **_: world)
    closed = spy(monkeypatch, World, "close", lambda world: world)
    with pytest.raises(type(failure)) if failure else nullcontext():
        script.train(tmp_path, env_id=script.world("ThreeSteps"))
    assert opened
    assert set(opened) == set(closed)


# --- How it is filmed -----------------------------------------------------------------------------


class Bar(World):
    """Draws how many steps it has taken into one picture, which it keeps."""

    shape = (61, 401, 3)

    def __init__(self, render_mode=None, **kwargs):
        super().__init__(**kwargs)
        self.render_mode, self.picture = render_mode, np.zeros(self.shape, np.uint8)

    def render(self):
        self.picture[:] = 255
        self.picture[:, : self.steps] = 0
        return self.picture


USUAL = Bar.shape
FILMS = {  # steps of an episode, frames a second if it says so, steps for a frame, a picture
    "Usual": (60, 20, 1, USUAL), "Fast": (100, 50, 2, USUAL), "Faster": (120, 125, 5, USUAL),
    "Calm": (12, 4, 1, USUAL), "Lasting": (999, 20, 1, USUAL), "Silent": (30, None, 1, USUAL),
    "Gray": (60, 20, 1, (64, 401)), "Clear": (60, 20, 1, (63, 401, 4))}
for name, (length, fps, _, shape) in FILMS.items():
    metadata = {"render_modes": ["rgb_array"], **({"render_fps": fps} if fps else {})}
    register(name, type(name, (Bar,), {"shape": shape, "metadata": metadata}), length=length)
gym.register("Old-v0", type("Old", (World,), {"metadata": {"render.modes": ["human"]}}))


@pytest.mark.parametrize("name", FILMS)
@only("a2c_vector")
def test_a_film_shows_an_episode_as_it_was_at_its_own_speed(script, name, watch, tmp_path):
    """From the first state on; a GIF counts time in hundredths of a second."""
    path = script.train(tmp_path, "--total-steps", 9, "--eval-episodes", 1,
                        env_id=script.world(name, "test_faults"))
    assert watch(script, path)[1] is None
    shown, (length, fps, every, _) = [], FILMS[name]
    with Image.open(f"{path}.gif") as gif:
        for i in range(gif.n_frames):
            gif.seek(i)
            shown.append(int((np.asarray(gif.convert("L"))[30] < 128).sum()))
            assert abs(gif.info["duration"] - 1000 * every / (fps or 20)) <= 5
        assert "loop" in gif.info
    assert shown == list(range(0, min(length, 200 * every), every))


@pytest.mark.parametrize("name", ["harness:Uneven", "test_faults:Old", "test_faults:Usual"])
@only("ppo_continuous")
def test_what_cannot_be_filmed_is_named_after_the_return(script, name, watch, tmp_path):
    """It draws nothing, knows no such keyword, or there is a folder where the film should be."""
    path = script.train(tmp_path, env_id=f"{name}-v0")
    path.with_suffix(".gif").mkdir()
    result, end = watch(script, path)
    assert result == read_log(f"{path}.csv")["eval_return"].iloc[-1]
    assert str(path) in end
    assert "\n" not in end
