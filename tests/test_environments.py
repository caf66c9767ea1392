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

    def __init__(self, look=np.copy, pay=float, dtype=np.float32, **kwargs):
        super().__init__(observations=Box(0, 1, (2,), dtype), **kwargs)
        self.look, self.pay, self.shown = look, pay, np.zeros(2, dtype)

    def observe(self):
        self.shown[:] = self.steps % 2, self.episode > 0
        return self.look(self.shown)

    def reward(self, action):
        return self.pay(1000.5 - self.steps)


register("Bits", Bits)
register("SameArray", Bits, look=np.asarray)  # with new numbers in it at every step
register("Float16Rewards", Bits, pay=np.float16)
register("Backwards", Bits, look=lambda bits: bits[::-1].copy()[::-1])
register("Bytes", Bits, dtype=np.uint8)
register("Doubles", Bits, dtype=np.float64)
gym.registry["Doubles-v0"].kwargs["actions"] = Box(
    np.float64(ACTIONS.low), np.float64(ACTIONS.high), dtype=np.float64)


@pytest.mark.filterwarnings("ignore:.*share an object:UserWarning")
def test_the_same_numbers_train_the_same_agent_however_they_are_handed_over(script, tmp_path):
    """As from the same world in float32 and float. Actions are in the dtype of their space."""
    def learn(name):
        path = script.train(tmp_path / name, "--env-id", script.world(name, "test_environments"))
        return torch.load(f"{path}.pt", weights_only=True)["agent"], read_log(path)

    agent, log = learn("Bits")
    assert (log[["return", "eval_return"]].stack().dropna() == 999.5 + 998.5 + 997.5).all()
    for name in "SameArray", "Float16Rewards", "Backwards", "Bytes", "Doubles":
        other_agent, other_log = learn(name)
        torch.testing.assert_close(other_agent, agent, rtol=0, atol=0, msg=name)
        pd.testing.assert_frame_equal(other_log, log, check_exact=True, obj=name)


register("Long", length=1200)
register("LongLimit", limit=1100, length=None)


@pytest.mark.parametrize(("name", "steps", "evaluated"), [
    ("Long", 1200, 1000), ("LongLimit", 1100, 1100)])
def test_an_evaluation_counts_1000_steps_where_no_limit_is_registered(
        script, name, steps, evaluated, tmp_path):
    """In training an episode lasts as long as it does, but in REINFORCE, which must see an end."""
    options = ["--num-envs", 1, "--rollout-steps", 1300]
    if script.name == "reinforce_mujoco":
        options, steps = ["--batch-episodes", 1], evaluated
    log = read_log(script.train(
        tmp_path, "--env-id", script.world(name, "test_environments"), "--total-steps", 1300,
        "--num-evals", 1, "--eval-episodes", 1, *options))
    assert log.loc[0, ["return", "eval_return"]].tolist() == [steps, evaluated]


class Elsewhere(World):
    """Goes to a folder of its own when it is made, as some simulators do."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        os.chdir(tempfile.gettempdir())


register("Elsewhere", Elsewhere)


def test_a_run_is_where_the_user_stood_and_closes_what_it_opened(
        script, call, tmp_path, monkeypatch):
    opened = spy(monkeypatch, World, "__init__", lambda world, **_: world)
    closed = spy(monkeypatch, World, "close", lambda world: world)
    call(script, "--env-id", script.world("Elsewhere", "test_environments"), *script.small.split(),
         "--out-dir", "mine")
    (folder,) = (tmp_path / "mine").iterdir()
    assert folder.name.startswith("test_environments-")  # no colon, which Windows does not allow
    assert len(opened) >= 3
    assert set(opened) == set(closed)
