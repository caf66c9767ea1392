"""When do several processes pay? A2C's environments, by the time a step takes; PPO with `together`.

Nothing else may run; some five minutes on two cores.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import speed
import study
from study import A2C, PPO, Job, number

TOGETHER = "experiments/together.py"
TORCHRUN = "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"
TIMES, TASKS = (0.03, 0.1, 0.2, 0.3, 0.5, 1.0), ("HalfCheetah-v5", "Humanoid-v5")
STEPS = {(ms, kind): f"--env-id Busy{ms}-v0 --vectorization {kind}"
         for ms in TIMES for kind in speed.KINDS}
RUNS = {(task, script): f"--env-id {task} --total-steps 40960 --num-envs {count} --num-evals 1 "
        "--eval-episodes 1" for task in TASKS for script, count in ((PPO, 16), (TOGETHER, 8))}
JOBS = [*(Job(A2C, options) for options in STEPS.values()),
        *(Job(script, options, seed=repetition) for repetition in range(1, 6)
          for (_, script), options in RUNS.items())]


class Busy(gym.Env):
    """Each step computes for `ms` milliseconds."""

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
    if job.script == A2C:
        speeds = [speed.stepping_speed(*study.load(job), 300) for _ in range(3)]
        return [{"speed": np.median(speeds)}]
    command = TORCHRUN if job.script == TOGETHER else ()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, *command, study.ROOT / job.script, *job.options.split(),
                        "--seed", str(job.seed)], check=True, cwd=folder, capture_output=True)
        (path,) = Path(folder).glob("runs/*/seed-*.csv")
        log = pd.read_csv(path)
    return [{"speed": log["env_step"].iloc[-1] / log["seconds"].iloc[-1]}]


def draw(rows):
    speeds = rows.groupby("options")["speed"].median()
    steps = [[ms, *(f"{8000 / speeds[STEPS[ms, kind]]:.2f}" for kind in speed.KINDS)]
             for ms in TIMES]
    runs = {task: [speeds[RUNS[task, script]] for script in (PPO, TOGETHER)] for task in TASKS}
    return {"processes": study.table(["ms a step", *speed.KINDS.values()], steps),
            "together": study.table(["PPO, steps a second", "one process", "two", "ratio"], [
                [task, number(one), number(two), f"{two / one:.1f}"]
                for task, (one, two) in runs.items()])}


if __name__ == "__main__":
    study.main(JOBS, draw, measure, workers=1)
