"""What tests share: running a script as a user would, looking into it, worlds to train in."""

import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import torch
from gymnasium.spaces import Box, Discrete

ROOT = Path(__file__).resolve().parent.parent
SEED = 0  # of everything drawn; a test holds for any
# Warnings end a run, but for what next year's packages give up.
STRICT = ["-W", "error", "-W", "ignore::DeprecationWarning",
          "-W", "ignore::PendingDeprecationWarning", "-W", "ignore::FutureWarning"]


def start(script, *arguments, cwd, python=()):
    """Start `python script.py arguments` in `cwd`, as a group of processes, without a display."""
    env = {**os.environ, "PYTHONPATH": str(ROOT / "tests"), "OMP_NUM_THREADS": "1"}
    for name in "DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL":
        env.pop(name, None)
    return subprocess.Popen(
        [sys.executable, *python, str(ROOT / script), *map(str, arguments)],
        cwd=cwd, env=env, encoding="utf-8", start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def run(script, *arguments, **options):
    """Run a script to its end; returns what it printed."""
    process = start(script, *arguments, **options)
    out, err = process.communicate(timeout=170)
    assert process.returncode == 0, err
    return out, err


def read_log(path):
    """The log of a seed, without the column that no seed determines."""
    return pd.read_csv(f"{path}.csv").drop(columns="seconds")


def explained_variance(V, targets):
    """Of arrays, by definition."""
    if targets.std() < abs(targets.mean()) / 10:
        return np.nan
    return 1 - ((targets - V) ** 2).mean() / targets.var()


def spy(monkeypatch, module, name, keep):
    """A list of what keep(…) returns whenever the function `name` is called, of its arguments."""
    kept, function = [], getattr(module, name)

    def spied(*arguments, **options):
        kept.append(keep(*arguments, **options))
        return function(*arguments, **options)

    monkeypatch.setattr(module, name, spied)
    return kept


ACTIONS = Box(np.float32([-1, 0]), np.float32([3, 0.5]))  # neither symmetric nor alike


class World(gym.Env):
    """Reward 1 a step, episodes of `length` steps; refuses actions out of bounds.

    It shows (a number drawn for the episode, steps since its start), so that no two look alike.
    """

    def __init__(self, length=3, observations=None, actions=ACTIONS):
        self.length, self.total = length, 0
        self.observation_space = observations or Box(-np.inf, np.inf, (2,))
        self.action_space = actions

    def observe(self):
        return np.float32([self.episode, self.steps])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.episode, self.steps = self.np_random.uniform(-1, 1), 0
        return self.observe(), {}

    def step(self, action):
        assert self.action_space.contains(action), f"{action!r} is out of bounds"
        self.steps, self.total = self.steps + 1, self.total + 1
        return self.observe(), self.reward(action), self.steps == self.length, False, {}

    def reward(self, action):
        return 1.0


class Uneven(World):
    """Episodes of 3 steps, of 7 if its first number is positive; the action is the reward."""

    def reset(self, *, seed=None, options=None):
        shown = super().reset(seed=seed, options=options)
        self.length = 7 if self.episode > 0 else 3
        return shown

    def reward(self, action):
        return float(action.sum())


def length(world, drawn):
    """How many steps an episode has, by its world and the numbers drawn for it."""
    return {"Forever": 8, "Uneven": torch.where(drawn > 0, 7, 3)}.get(world, 3)


def register(name, world=World, limit=None, **kwargs):
    """Register a world twice: name-v0, and Discretename-v0 with the actions 0, 1 and 2."""
    for prefix, actions in ("", ACTIONS), ("Discrete", Discrete(3)):
        gym.register(f"{prefix}{name}-v0", world, max_episode_steps=limit,
                     kwargs={"actions": actions, **kwargs})


register("ThreeSteps")
register("Forever", limit=8, length=None)  # never ends, but for the time limit
register("BothEnds", limit=3)  # terminated and truncated in the same step
register("Uneven", Uneven)
register("Cut", Uneven, limit=5)  # terminated after 3 steps, or truncated after 5
