"""How many steps a second, against others and against stepping alone?

Five repetitions, in turns; CleanRL takes part if CLEANRL is the path of its file. Nothing else may
run; 40 minutes.
"""

import pages
import pandas as pd
import peers
import study
from compare import number
from study import Job
from variants import A2C, PPO

PEERS = {"defaults": ("defaults", {}), "8 environments": ("defaults", {"num_envs": 8}),
         "our sizes": ("our sizes", {}), "zoo": ("zoo", {})}  # for `peers.speed`
RACES = {task: Job(script, f"--env-id {task} --total-steps 32768") for task, script in (
    ("HalfCheetah-v5", PPO), ("Hopper-v5", PPO), ("Walker2d-v5", PPO), ("LunarLander-v3", A2C))}
CLEANRL = {task: Job(PPO, f"--env-id {task} --total-steps 32768", "CleanRL") for task in (
    "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "InvertedDoublePendulum-v5")}
JOBS = [job._replace(seed=repetition) for repetition in range(1, 6)
        for job in [*RACES.values(), *CLEANRL.values()]]


def measure(job):
    """A row for each learner. Ours trains without evaluations."""
    module, args = study.load(job._replace(change=""))
    module.evaluate = lambda *_: 0.0
    log, _ = study.run(module, args)
    speeds = {"ours": log.eval("env_step / seconds").iloc[-1]}
    if job.change == "CleanRL":
        speeds["CleanRL"] = peers.cleanrl_speed(args)
    else:
        speeds["stepping alone"] = peers.stepping_speed(module, args)
        speeds |= {name: peers.speed(args, *peer) for name, peer in PEERS.items()}
    return [{"learner": learner, "speed": speed} for learner, speed in speeds.items()]


def lines(rows):
    """A row for each task: our speed, and it divided by each other's that ran beside."""
    speeds = rows.pivot(index=["change", "options", "seed"], columns="learner", values="speed")
    ratios = speeds.rdiv(speeds["ours"], axis="index").groupby("options")
    low, middle, high = ratios.min(), ratios.median(), ratios.max()
    for task, job in {**CLEANRL, **RACES}.items():
        usual = speeds.xs(job.options, level="options")["ours"].get(job.change)
        line = {"task": f"{task}{', A2C' * (job.script == A2C)}",
                "ours, steps a second": number(usual.median())}
        for name in ("CleanRL", *PEERS, "stepping alone"):
            if middle.loc[job.options, name] > 0:
                line[f"÷ {'sb3, ' * (name in PEERS)}{name}"] = "{:.2f} ({:.2f} to {:.2f})".format(
                    *(x.loc[job.options, name] for x in (middle, low, high)))
        yield line


def draw(rows):
    found = pd.DataFrame(lines(rows)).fillna("")
    more = found[["task", "÷ sb3, 8 environments", "÷ sb3, zoo", "÷ stepping alone"]]
    more, short = more[found["÷ sb3, zoo"] > ""], found.drop(columns=more.columns[1:])
    return {"speed": pages.table(short, short.to_numpy()),
            "more speeds": pages.table(more, more.to_numpy())}


if __name__ == "__main__":
    study.main([job for job in JOBS if peers.CLEANRL or job.change != "CleanRL"], draw, measure,
               workers=1)
