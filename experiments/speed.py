"""How many steps a second, against stable-baselines3 and against stepping alone?

And A2C with one to 32 environments, in one process or in a process each. Five repetitions, in
turns. Nothing else may run; some fifty minutes.
"""

import time

import peers
import study
from study import A2C, PPO, REINFORCE, Job, number

TASKS = {"HalfCheetah-v5": PPO, "Hopper-v5": PPO, "Walker2d-v5": PPO, "LunarLander-v3": A2C,
         "InvertedPendulum-v5": REINFORCE}
PEERS = {"stable-baselines3": ("defaults", {}), "eight environments": ("defaults", {"num_envs": 8}),
         "our sizes": ("our sizes", {}), "its zoo's settings": ("zoo", {})}  # for `peers.make`
COUNTS, KINDS = (1, 2, 4, 8, 16, 32), {"sync": "one process", "async": "a process each"}
RACES = [(script, f"--env-id {task} --total-steps 32768") for task, script in TASKS.items()]
CROWDS = {(kind, count): f"--num-envs {count} --vectorization {kind} --rollout-steps "
          f"{512 // count} --total-steps 20480" for kind in KINDS for count in COUNTS}
JOBS = [Job(script, options, seed=repetition) for repetition in range(1, 6)
        for script, options in [*RACES, *((A2C, options) for options in CROWDS.values())]]


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


def peer_speed(args, setting, options):
    model = peers.make(args.env_id, setting, args.seed[0], **options)
    start = time.perf_counter()
    model.learn(args.total_steps)
    return model.num_timesteps / (time.perf_counter() - start)


def measure(job):
    module, args = study.load(job)
    speeds = {"ours": our_speed(module, args)}
    if job.script != REINFORCE and job[:2] in RACES:
        speeds["stepping alone"] = stepping_speed(module, args, args.total_steps // args.num_envs)
        speeds |= {name: peer_speed(args, *peer) for name, peer in PEERS.items()}
    return [{"learner": name, "speed": speed} for name, speed in speeds.items()]


def draw(rows):
    speeds = rows.groupby(["options", "learner", "seed"])["speed"].first().unstack("learner")
    lines = []
    for script, options in RACES:
        of_task = speeds.loc[options]
        ratios = of_task["ours"] / of_task[["stepping alone", *PEERS]].T
        lines.append([f"`{script}`", options.split()[1], number(of_task["ours"].median()), *(
            f"{ratio.median():.2f} ({ratio.min():.2f} to {ratio.max():.2f})" if ratio.any() else ""
            for _, ratio in ratios.iterrows())])
    header = ["script", "task", "steps a second", "÷ stepping alone", "÷ sb3, defaults",
              "÷ sb3, 8 environments", "÷ sb3, our sizes", "÷ sb3, zoo"]
    ours = speeds.groupby("options")["ours"].median()
    crowds = [[name, *(number(ours[CROWDS[kind, count]]) for count in COUNTS)]
              for kind, name in KINDS.items()]
    return {"speed": study.table(header, lines),
            "scaling": study.table(["steps a second with environments", *COUNTS], crowds)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure, workers=1)
