"""When does a process for each of A2C's environments pay? By the time that a step takes.

Nothing else may run; a minute on two cores.
"""

import time

import gymnasium as gym
import numpy as np
import peers
import study
from speed import KINDS
from study import A2C, Job

TIMES = 0.03, 0.1, 0.2, 0.3, 0.5, 1.0  # milliseconds
STEPS = {(ms, kind): Job(A2C, f"--env-id Busy{ms}-v0 --vectorization {kind}")
         for ms in TIMES for kind in KINDS}
JOBS = [*STEPS.values()]


class Busy(gym.Env):
    """Each step computes for a given time."""

    observation_space = gym.spaces.Box(-1.0, 1.0, (8,))
    action_space = gym.spaces.Discrete(4)

    def __init__(self, ms):
        self.seconds = ms / 1000

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(8, np.float32), {}

    def step(self, action):
        end = time.perf_counter() + self.seconds
        while time.perf_counter() < end:
            pass
        return np.zeros(8, np.float32), 0.0, False, False, {}


for ms in TIMES:
    gym.register(f"Busy{ms}-v0", Busy, kwargs={"ms": ms})


def measure(job):
    module, args = study.load(job._replace(options=f"{job.options} --total-steps 2400"))
    return [{"speed": np.median([peers.stepping_speed(module, args) for _ in range(3)])}]


def draw(rows):
    speeds = rows.set_index("options")["speed"]
    return {"processes": study.table(["ms a step", *KINDS.values()], [
        [ms, *(f"{8000 / speeds[STEPS[ms, kind].options]:.2f}" for kind in KINDS)]
        for ms in TIMES])}


if __name__ == "__main__":
    study.main(JOBS, draw, measure, workers=1)
