"""Environments as people have them: odd numbers, no limit, no end, a folder of their own."""

import os
import tempfile

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from gymnasium.spaces import Box
from harness import ACTIONS, World, read_log, register, spy


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


def kind(**attributes):
    return type("Kind", (Bits,), {name: staticmethod(x) for name, x in attributes.items()})


KINDS = {"same array": SameArray, "float16 rewards": kind(pay=np.float16),
         "backwards": kind(look=lambda bits: np.float32(bits[::-1])[::-1]),
         **{dtype: kind(look=lambda bits, dtype=dtype: np.array(bits, dtype))
            for dtype in ("uint8", "int64", "float16", "float64")}}
register("Bits", Bits)
for i, (name, world) in enumerate(KINDS.items()):
    register(f"Kind{i}", world, dtype=name if " " not in name and "back" not in name else "float32")
register("Wide", World)
gym.registry["Wide-v0"].kwargs["actions"] = Box(
    np.float64(ACTIONS.low), np.float64(ACTIONS.high), dtype=np.float64)


def test_the_same_numbers_train_the_same_agent_however_they_are_handed_over(script, tmp_path):
    """As from the same world in float32 and float."""
    def learn(name):
        path = script.train(tmp_path / name, "--total-steps", 128, "--num-evals", 1,
                            "--env-id", script.world(name, "test_faults"))
        return torch.load(f"{path}.pt", weights_only=True)["agent"], read_log(path)

    agent, log = learn("Bits")
    assert (log[["return", "eval_return"]].stack().dropna() == 999.5 + 998.5 + 997.5).all()
    for i, name in enumerate(KINDS):
        other_agent, other_log = learn(f"Kind{i}")
        torch.testing.assert_close(other_agent, agent, rtol=0, atol=0, msg=name)
        pd.testing.assert_frame_equal(other_log, log, check_exact=True, obj=name)


def test_actions_of_float64_stay_in_their_space(script, tmp_path):
    """The world refuses others; with discrete actions there is nothing to do."""
    script.train(tmp_path, "--env-id", script.world("Wide", "test_faults"))


@pytest.mark.parametrize(("method", "place"), [
    ("observe", (0, 0)), ("observe", (2, 2)), ("observe", (3, 0)), ("reward", (2, 2))])
def test_what_is_not_a_number_ends_a_training(script, method, place, monkeypatch, tmp_path):
    """PyTorch sees it, at the latest when the next action is drawn."""
    usual = getattr(World, method)

    def broken(self, *action):  # at a place: (steps in all, steps in the episode)
        return usual(self, *action) + (np.nan if (self.total, self.steps) == place else 0)

    monkeypatch.setattr(World, method, broken)
    with pytest.raises(ValueError, match="invalid values"):
        script.train(tmp_path, "--env-id", script.world("ThreeSteps"), "--num-evals", 1)


register("Long", length=1200)
register("LongLimit", limit=1100, length=None)


@pytest.mark.parametrize(("name", "steps", "evaluated"), [
    ("Long", 1200, 1000), ("LongLimit", 1100, 1100)])
def test_an_evaluation_counts_1000_steps_where_no_limit_is_registered(
        script, name, steps, evaluated, tmp_path):
    """In training an episode lasts as long as it does, except in REINFORCE, which must see an end."""
    options = "--total-steps 1300 --num-evals 1 --eval-episodes 1".split()
    if script.name == "reinforce_mujoco":
        options += ["--batch-episodes", "1"]
        steps = evaluated
    else:
        options += ["--num-envs", "1", "--rollout-steps", "1300"]
    log = read_log(script.train(
        tmp_path, "--env-id", script.world(name, "test_faults"), *options))
    assert log["return"].iloc[0] == steps
    assert log["eval_return"].iloc[0] == evaluated


def test_environments_are_closed_when_a_training_has_ended(script, monkeypatch, tmp_path):
    opened = spy(monkeypatch, World, "__init__", lambda world, **_: world)
    closed = spy(monkeypatch, World, "close", lambda world: world)
    script.train(tmp_path, "--env-id", script.world("ThreeSteps"))
    assert opened
    assert set(opened) == set(closed)


class Elsewhere(World):
    """Goes to a folder of its own when it is made, as some simulators do."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        os.chdir(tempfile.gettempdir())


register("Elsewhere", Elsewhere)


def test_a_run_is_where_the_user_stood_whatever_an_environment_does(script, call, tmp_path):
    out = call(script, "--env-id", script.world("Elsewhere", "test_faults"), *script.small.split(),
               "--out-dir", "mine")
    (folder,) = (tmp_path / "mine").iterdir()
    assert folder.name.startswith("test_faults-")  # no colon, which Windows does not allow
    assert out.splitlines()[0] == str(folder)
    assert {path.name for path in folder.iterdir()} == {
        "seed-1.csv", "seed-1.pt", "learning_curve.png"}
