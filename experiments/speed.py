"""How many steps a second, against others and against stepping alone?

And A2C with one to 32 environments, in one process or in a process each, and PPO in two processes.
Five repetitions, in turns; CleanRL takes part if CLEANRL is the path of its file. Nothing else may
run; an hour on two cores.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd
import peers
import study
from study import A2C, PPO, Job, number

PEERS = {"defaults": ("defaults", {}), "8 environments": ("defaults", {"num_envs": 8}),
         "our sizes": ("our sizes", {}), "zoo": ("zoo", {})}  # for `peers.speed`
COUNTS, KINDS = (1, 2, 4, 8, 16, 32), {"sync": "one process", "async": "a process each"}
RACES = {task: Job(script, f"--env-id {task} --total-steps 32768") for task, script in (
    ("HalfCheetah-v5", PPO), ("Hopper-v5", PPO), ("Walker2d-v5", PPO), ("LunarLander-v3", A2C))}
CROWDS = {(kind, count): Job(A2C, f"--num-envs {count} --vectorization {kind} --rollout-steps "
                             f"{512 // count} --total-steps 20480")
          for kind in KINDS for count in COUNTS}
CLEANRL = {job.options: job._replace(change="CleanRL") for job in RACES.values()
           if job.script == PPO}
TOGETHER = "experiments/together.py"
TORCHRUN = "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"
PAIRS = {task: [Job(script, f"--env-id {task} --total-steps 40960 --num-envs {count} --num-evals 1 "
                    "--eval-episodes 1") for script, count in ((PPO, 16), (TOGETHER, 8))]
         for task in ("HalfCheetah-v5", "Humanoid-v5")}
JOBS = [job._replace(seed=repetition) for repetition in range(1, 6)
        for job in [*RACES.values(), *CLEANRL.values(), *CROWDS.values(),
                    *sum(PAIRS.values(), [])]]


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
    usual = job._replace(change="")
    speeds = {"ours": log_of(usual).eval("env_step / seconds").iloc[-1]}
    if usual._replace(seed=1) in RACES.values():
        module, args = study.load(usual)
        if job.change == "CleanRL":
            speeds["CleanRL"] = peers.cleanrl_speed(args)
        else:
            speeds["stepping alone"] = peers.stepping_speed(module, args)
            speeds |= {name: peers.speed(args, *peer) for name, peer in PEERS.items()}
    return [{"learner": learner, "speed": speed} for learner, speed in speeds.items()]


def draw(rows):
    keys = ["options", "learner", "seed"]
    speeds, beside_cleanrl = (
        rows[(rows["change"] == "CleanRL") == beside].groupby(keys)["speed"].first()
        .unstack("learner") for beside in (False, True))
    others = "stepping alone", "defaults", "our sizes", "CleanRL", "8 environments", "zoo"
    lines = []
    for task, job in RACES.items():
        of_task = speeds.loc[job.options].dropna(axis="columns")
        line = {"task": task, "script": f"`{job.script}`",
                "ours, steps a second": number(of_task["ours"].median())}
        for name in others:
            measured = of_task
            if name == "CleanRL" and job.options in beside_cleanrl.index:
                measured = beside_cleanrl.loc[job.options]
            if name in measured:
                ratio = measured["ours"] / measured[name]
                line[f"÷ {'sb3, ' * (name in PEERS)}{name}"] = (
                    f"{ratio.median():.2f} ({ratio.min():.2f} to {ratio.max():.2f})")
        lines.append(line)
    found = pd.DataFrame(lines).fillna("")
    short, more = found.iloc[:, :-2], found.iloc[:, [0, -2, -1]]
    ours = speeds.groupby("options")["ours"].median()
    crowds = [[count, *(number(ours[CROWDS[kind, count].options]) for kind in KINDS)]
              for count in COUNTS]
    together = [[task, *(number(ours[job.options]) for job in pair),
                 f"{ours[pair[1].options] / ours[pair[0].options]:.1f}"]
                for task, pair in PAIRS.items()]
    return {"speed": study.table(short, short.to_numpy()),
            "more speeds": study.table(more, more.to_numpy()),
            "scaling": study.table(["environments", *KINDS.values()], crowds),
            "together": study.table(["PPO, steps a second", "one process", "two", "ratio"],
                                    together)}


if __name__ == "__main__":
    study.main([job for job in JOBS if peers.CLEANRL or job.change != "CleanRL"], draw, measure,
               workers=1)
