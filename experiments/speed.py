"""How many steps a second, against others and against stepping alone?

And A2C with one to 32 environments, in one process or in a process each. Five repetitions, in
turns; CleanRL takes part if CLEANRL is the path of its file. Nothing else may run; fifty minutes.
"""

import time

import pandas as pd
import peers
import study
from study import A2C, PPO, REINFORCE, Job, number

PEERS = {"defaults": ("defaults", {}), "8 environments": ("defaults", {"num_envs": 8}),
         "our sizes": ("our sizes", {}), "zoo": ("zoo", {})}  # for `peers.speed`
COUNTS, KINDS = (1, 2, 4, 8, 16, 32), {"sync": "one process", "async": "a process each"}
RACES = {task: Job(script, f"--env-id {task} --total-steps 32768") for task, script in (
    ("HalfCheetah-v5", PPO), ("Hopper-v5", PPO), ("Walker2d-v5", PPO), ("LunarLander-v3", A2C),
    ("InvertedPendulum-v5", REINFORCE))}
CROWDS = {(kind, count): Job(A2C, f"--num-envs {count} --vectorization {kind} --rollout-steps "
                             f"{512 // count} --total-steps 20480")
          for kind in KINDS for count in COUNTS}
JOBS = [job._replace(seed=repetition) for repetition in range(1, 6)
        for job in [*RACES.values(), *CROWDS.values()]]


def our_speed(module, args):
    """Of a training without evaluations."""
    module.evaluate = lambda *_: 0.0
    log, _ = study.run(module, args)
    return log["env_step"].iloc[-1] / log["seconds"].iloc[-1]


def stepping_speed(module, args, count):
    """Of our environments without a learner, with actions drawn beforehand."""
    envs = module.make_envs(args, args.num_envs, autoreset_mode="Disabled")
    envs.reset(seed=1)
    actions = [envs.action_space.sample() for _ in range(count)]
    start = time.perf_counter()
    for action in actions:
        _, _, terminated, truncated, _ = envs.step(action)
        done = terminated | truncated
        if done.any():
            envs.reset(options={"reset_mask": done})  # as `rollout` does
    seconds = time.perf_counter() - start
    envs.close()
    return count * args.num_envs / seconds


def measure(job):
    module, args = study.load(job)
    speeds = {"ours": our_speed(module, args)}
    if job.script != REINFORCE and args.env_id in job.options:
        speeds["stepping alone"] = stepping_speed(module, args, args.total_steps // args.num_envs)
        speeds |= {name: peers.speed(args, *peer) for name, peer in PEERS.items()}
        if peers.CLEANRL and job.script == PPO:
            speeds["CleanRL"] = peers.cleanrl_speed(args)
    return [{"learner": learner, "speed": speed} for learner, speed in speeds.items()]


def draw(rows):
    speeds = rows.groupby(["options", "learner", "seed"])["speed"].first().unstack("learner")
    titles = {"stepping alone": "÷ stepping alone", "defaults": "÷ sb3, defaults",
              "our sizes": "÷ sb3, our sizes", "CleanRL": "÷ CleanRL",
              "8 environments": "÷ sb3, 8 environments", "zoo": "÷ sb3, zoo"}
    lines = []
    for task, job in RACES.items():
        of_task = speeds.loc[job.options].dropna(axis="columns")
        line = {"task": task, "ours, steps a second": number(of_task["ours"].median())}
        for name, title in titles.items():
            if name in of_task:
                ratio = of_task["ours"] / of_task[name]
                line[title] = f"{ratio.median():.2f} ({ratio.min():.2f} to {ratio.max():.2f})"
        lines.append(line)
    found = pd.DataFrame(lines).fillna("")
    short, more = found.iloc[:, :-2], found.iloc[:, [0, -2, -1]]
    ours = speeds.groupby("options")["ours"].median()
    crowds = [[count, *(number(ours[CROWDS[kind, count].options]) for kind in KINDS)]
              for count in COUNTS]
    return {"speed": study.table(short, short.to_numpy()),
            "more speeds": study.table(more, more.to_numpy()),
            "scaling": study.table(["environments", *KINDS.values()], crowds)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure, workers=1)
