"""PPO in one process and in two, by docs/together.py, with as many environments in all."""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd
from benchmark import common
from benchmark.common import PPO, Job

FIGURES = ()
ALONE = True  # nothing else may run beside a measurement of speed
WAYS = {"one process": 16, "two processes": 8}  # environments in each
TASKS = "Humanoid-v5", "HalfCheetah-v5"


def jobs(quick):
    steps, pairs = (2048, 1) if quick else (40_960, 5)
    return [Job(PPO, pair, f"--env-id {env_id} --total-steps {steps} --num-envs {count} "
                           "--num-evals 1 --eval-episodes 1", part=way)
            for env_id in TASKS[:1 if quick else None] for pair in range(1, pairs + 1)
            for way, count in WAYS.items()]


def measure(job):
    with tempfile.TemporaryDirectory() as home:
        script = Path(shutil.copy(common.ROOT / f"{PPO}.py", home))
        together = shutil.copy(common.ROOT / "docs/together.py", home)
        way = [script] if job.part == "one process" else [
            "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", together]
        command = [sys.executable, *way, *job.flags.split(), "--seed", job.seed, "--out-dir", home]
        subprocess.run([*map(str, command)], check=True, capture_output=True)
        (evals,) = Path(home).glob("*/seed-*/evals.csv")
        last = pd.read_csv(evals).iloc[-1]
        args = json.loads((evals.parent.parent / "args.json").read_text())
        speed = last["env_step"] / last["seconds"]
        return pd.DataFrame([{"env_id": args["env_id"], "speed": speed}])


def report(data, draw):
    rows = []
    for env_id, x in data.groupby("env_id", sort=False):
        speeds = x.pivot(index="seed", columns="part", values="speed")
        ratio = speeds["two processes"] / speeds["one process"]
        rows.append([env_id, *(f"{speeds[way].median():,.0f}" for way in WAYS),
                     f"{ratio.median():.2f} ({ratio.min():.2f} to {ratio.max():.2f})"])
    return {"speeds": common.table(
        ["task", *(f"{way}, steps per second" for way in WAYS), "ratio"], rows)}
