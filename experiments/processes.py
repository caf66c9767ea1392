"""When do several processes pay? Steps a second of A2C and PPO, two cores, medians of five.

A2C with one to 32 environments, in one process or a process each; the same with environments whose
steps take a given time; PPO in one and in two processes. Nothing else may run; half an hour.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pages
import pandas as pd
import peers
import study
from compare import number
from study import Job
from variants import A2C, PPO

KINDS = {"sync": "one process", "async": "a process each"}
COUNTS, TIMES = (1, 2, 4, 8, 16, 32), (0.03, 0.1, 0.2, 0.3, 0.5, 1.0)  # environments, milliseconds
CROWDS = {(kind, count): Job(A2C, f"--num-envs {count} --vectorization {kind} --rollout-steps "
                             f"{512 // count} --total-steps 20480")
          for kind in KINDS for count in COUNTS}
BUSY = {(kind, ms): Job(A2C, f"--env-id Busy{ms}-v0 --vectorization {kind}")
        for kind in KINDS for ms in TIMES}
TOGETHER = "experiments/together.py"
TORCHRUN = "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"
PAIRS = {task: [Job(script, f"--env-id {task} --total-steps 40960 --num-envs {count} --num-evals 1 "
                    "--eval-episodes 1") for script, count in ((PPO, 16), (TOGETHER, 8))]
         for task in ("HalfCheetah-v5", "Humanoid-v5")}
JOBS = [*BUSY.values(), *(job._replace(seed=repetition) for repetition in range(1, 6)
                          for job in [*CROWDS.values(), *sum(PAIRS.values(), [])])]


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


def log_of(job):
    """Of a training without evaluations; of `together` in two processes."""
    if job.script != TOGETHER:
        module, args = study.load(job)
        module.evaluate = lambda *_: 0.0
        return study.run(module, args)[0]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, *TORCHRUN, study.ROOT / job.script, *job.options.split(),
                        "--seed", str(job.seed)], check=True, cwd=folder, capture_output=True)
        (path,) = Path(folder).glob("runs/*/seed-*.csv")
        return pd.read_csv(path)


def measure(job):
    if "Busy" not in job.options:
        return [{"speed": log_of(job).eval("env_step / seconds").iloc[-1]}]
    module, args = study.load(job._replace(options=f"{job.options} --total-steps 2400"))
    return [{"speed": np.median([peers.stepping_speed(module, args) for _ in range(3)])}]


def draw(rows):
    speeds = rows.groupby(["script", "options"])["speed"].median()

    def speed(job):
        return speeds[job.script, job.options]

    pairs = [[task, *map(speed, pair)] for task, pair in PAIRS.items()]
    return {"scaling": pages.table(["environments", *KINDS.values()], [
                [count, *(number(speed(CROWDS[kind, count])) for kind in KINDS)]
                for count in COUNTS]),
            "processes": pages.table(["ms a step", *KINDS.values()], [
                [ms, *(f"{8000 / speed(BUSY[kind, ms]):.2f}" for kind in KINDS)]
                for ms in TIMES]),
            "together": pages.table(["PPO, steps a second", "one process", "two", "ratio"], [
                [task, number(one), number(two), f"{two / one:.1f}"] for task, one, two in pairs])}


if __name__ == "__main__":
    study.main(JOBS, draw, measure, workers=1)
