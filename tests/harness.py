"""What the tests share: running a script as a user would, and small worlds with known answers."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
from gymnasium.spaces import Box, Dict, Discrete, MultiDiscrete

ROOT = Path(__file__).resolve().parent.parent
TESTS = Path(__file__).resolve().parent

# --- Running a script -----------------------------------------------------------------------------


# Every warning ends a run, but for deprecations: next year's packages may announce some.
LATER = "DeprecationWarning", "PendingDeprecationWarning", "FutureWarning"
STRICT = ["-W", "error", *(x for name in LATER for x in ("-W", f"ignore::{name}"))]


def start(script, *arguments, cwd, python=(), own_group=False, **environment):
    """Start `python script.py arguments` in `cwd`, on a machine without a display.

    `own_group`: it and its processes form a process group, as a shell gives them one.
    """
    hidden = "DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"
    env = {name: value for name, value in os.environ.items() if name not in hidden}
    env |= {"PYTHONPATH": str(TESTS), "PYTHONIOENCODING": "utf-8", "OMP_NUM_THREADS": "1"}
    env |= environment
    command = [sys.executable, *python, str(ROOT / script), *map(str, arguments)]
    return subprocess.Popen(
        command, cwd=cwd, env=env, text=True, encoding="utf-8", start_new_session=own_group,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )


def run(script, *arguments, cwd, status=0, **options):
    """Run a script to its end; what it printed is in `out` and `err` of the process."""
    process = start(script, *arguments, cwd=cwd, **options)
    process.out, process.err = process.communicate(timeout=170)
    assert process.returncode == status, process.err
    return process


def run_folder(cwd):
    (folder,) = Path(cwd, "runs").iterdir()
    return folder


def table(path):
    """A CSV file without the columns that no seed determines."""
    return pd.read_csv(path).drop(columns=["seconds", "steps_per_second"], errors="ignore")


def read_json(path):
    return json.loads(Path(path).read_text())


# --- Worlds ---------------------------------------------------------------------------------------

ACTIONS = Box(np.float32([-1, 0]), np.float32([3, 0.5]))  # neither symmetric nor alike
TARGET = np.float32([2, 0.1])


class World(gym.Env):
    """Reward 1 a step, episodes of `length` steps; refuses actions out of bounds.

    It shows (a number drawn for the episode, steps since its start), so that no two look alike.
    From its step `fault_at` on it fails: with an exception ("raise"), by showing a NaN ("blind"),
    or with "nan" or "inf" for a reward.
    """

    def __init__(self, length=3, fault=None, fault_at=0, observations=None, actions=ACTIONS):
        self.length, self.fault, self.fault_at, self.total = length, fault, fault_at, 0
        self.observation_space = observations or Box(-np.inf, np.inf, (2,))
        self.action_space = actions

    def observe(self):
        return np.float32([self.episode, self.steps])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.episode, self.steps = self.np_random.uniform(-1, 1), 0
        return self.observe(), {}

    def step(self, action):
        assert self.action_space.contains(action), f"{action} is out of bounds"
        self.steps += 1
        self.total += 1
        fault = self.fault if self.total >= self.fault_at else None
        if fault == "raise":
            raise RuntimeError("the pole broke")
        reward = float(fault) if fault in ("nan", "inf") else self.reward(action)
        obs = self.observe() * np.float32("nan") if fault == "blind" else self.observe()
        return obs, reward, self.steps == self.length, False, {}

    def reward(self, action):
        return 1.0


class Target(World):
    """One step; the best action is TARGET, its reward 0."""

    def reward(self, action):
        return -float(np.square(action - TARGET).sum())


class Echo(World):
    """Shows (the action that it got last, steps since its start)."""

    def observe(self):
        return np.float32([self.action if self.steps else 0, self.steps])

    def reward(self, action):
        self.action = action
        return 1.0


class Counts(World):
    """Shows whole numbers, of an integer type."""

    def observe(self):
        return np.array([self.steps, 7])


class Timeless(World):
    """Does not show when its episodes end."""

    def observe(self):
        return np.float32([self.episode, 0])


class Sign(World):
    """One step; the best action is 1 where the first number shown is negative, else 3."""

    def reward(self, action):
        return float(action == (1 if self.episode < 0 else 3))


class Stuck(World):
    """An episode that starts without a seed never ends; it takes its time and leaves a file."""

    def reset(self, *, seed=None, options=None):
        self.stuck = seed is None or not self.length
        return super().reset(seed=seed)

    def step(self, action):
        obs, reward, terminated, truncated, info = super().step(action)
        if self.stuck:
            Path("playing").touch()
            time.sleep(0.01)
        return obs, reward, terminated and not self.stuck, truncated, info


class Dies(World):
    """Takes its process along, sooner or later."""

    def reward(self, action):
        if self.total > 40 and self.episode > 0.5:
            os._exit(1)
        return 1.0


def register(name, world=World, limit=None, **kwargs):
    gym.register(f"{name}-v0", world, max_episode_steps=limit, kwargs=kwargs)


if "ThreeSteps-v0" not in gym.registry:
    for prefix, actions in ("", ACTIONS), ("Discrete", Discrete(3, start=1)):
        register(f"{prefix}ThreeSteps", actions=actions)
        # never ends, but for the time limit
        register(f"{prefix}Forever", limit=8, length=None, actions=actions)
        # terminated and truncated in the same step
        register(f"{prefix}BothEnds", limit=3, actions=actions)
        register(f"{prefix}FailsLate", fault="raise", fault_at=40, actions=actions)
        register(f"{prefix}FailsEarly", fault="raise", fault_at=2, actions=actions)
        register(f"{prefix}TurnsNaN", fault="nan", fault_at=40, actions=actions)
        register(f"{prefix}TurnsInfinite", fault="inf", fault_at=40, actions=actions)
        register(f"{prefix}TurnsBlind", fault="blind", fault_at=40, actions=actions)
        register(f"{prefix}AlwaysNaN", fault="nan", actions=actions)
        register(f"{prefix}Stuck", Stuck, length=None, actions=actions)
        register(f"{prefix}StuckInTraining", Stuck, actions=actions)
        integers = Box(0, 9, (2,), np.array(0).dtype)
        register(f"{prefix}Counts", Counts, observations=integers, actions=actions)
    register("Target", Target, length=1)
    register("DictObs", observations=Dict(position=Box(-1, 1, (2,))))
    register("Image", observations=Box(0, 255, (8, 8, 3), np.uint8))
    register("Unbounded", actions=Box(-np.inf, np.inf, (2,)))
    register("ThreeActions", actions=Box(-1, 1, (3,)))
    register("ManyActions", actions=MultiDiscrete([2, 3]))
    register("SquareActions", actions=Box(-1, 1, (2, 2)))
    register("Echo", Echo, actions=Discrete(3, start=1))
    register("Sign", Sign, length=1, actions=Discrete(3, start=1))
    register("Dies", Dies, actions=Discrete(3, start=1))
    register("Timeless", Timeless, limit=8, length=None, actions=Discrete(3, start=1))
