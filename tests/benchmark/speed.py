"""How many steps a second, against stable-baselines3 and against stepping alone?

And A2C with one to 32 environments, in one process or in a process each. Five repetitions, in
turns. Nothing else may run; some fifty minutes.
"""

import tempfile
import time
from pathlib import Path

import pandas as pd
import peers
import seaborn as sns
import study
from study import A2C, PPO, REINFORCE, Job, number

TASKS = {"HalfCheetah-v5": PPO, "Hopper-v5": PPO, "Walker2d-v5": PPO, "LunarLander-v3": A2C,
         "InvertedPendulum-v5": REINFORCE}
PEERS = {"stable-baselines3": ("defaults", {}), "eight environments": ("defaults", {"num_envs": 8}),
         "our sizes": ("our sizes", {}), "its zoo's settings": ("zoo", {})}  # for `peers.make`
COUNTS, KINDS = (1, 2, 4, 8, 16, 32), {"sync": "one process", "async": "a process each"}
JOBS = []
for repetition in range(1, 6):
    JOBS += [Job(script, f"--env-id {task} --total-steps 32768", seed=repetition)
             for task, script in TASKS.items()]
    JOBS += [Job(A2C, f"--num-envs {count} --vectorization {kind} --rollout-steps {512 // count} "
                      "--total-steps 20480", seed=repetition)
             for count in COUNTS for kind in KINDS]


def our_speed(job):
    """Of a training without evaluations."""
    module, args = study.load(job)
    module.evaluate = lambda *_: 0.0
    with tempfile.TemporaryDirectory() as folder:
        module.train(0, args, Path(folder))
        log = pd.read_csv(f"{folder}/seed-{job.seed}.csv")
    return log["env_step"].iloc[-1] / log["seconds"].iloc[-1]


def stepping_speed(job):
    """Of our environments without a learner, with actions drawn beforehand."""
    module, args = study.load(job)
    others = [False, args.vectorization] if job.script == A2C else []
    envs = module.make_envs(args.env_id, args.num_envs, "Disabled", *others)
    envs.reset(seed=job.seed)
    actions = [envs.action_space.sample() for _ in range(args.total_steps // args.num_envs)]
    start = time.perf_counter()
    for action in actions:
        _, _, terminated, truncated, _ = envs.step(action)
        done = terminated | truncated
        if done.any():
            envs.reset(options={"reset_mask": done})  # as `rollout` does
    seconds = time.perf_counter() - start
    envs.close()
    return len(actions) * args.num_envs / seconds


def measure(job):
    speeds = {"ours": our_speed(job)}
    if job.script != REINFORCE:
        speeds["stepping alone"] = stepping_speed(job)
    if job.script != REINFORCE and "--env-id" in job.options:
        _, args = study.load(job)
        for name, (setting, options) in PEERS.items():
            model = peers.make(args.env_id, setting, job.seed, **options)
            start = time.perf_counter()
            model.learn(args.total_steps)
            speeds[name] = model.num_timesteps / (time.perf_counter() - start)
    return [{"learner": name, "speed": speed} for name, speed in speeds.items()]


def draw(rows):
    speeds = rows.pivot_table("speed", ["options", "seed"], "learner", sort=False)
    lines, others = [], ["stepping alone", *PEERS]
    for job in JOBS[:len(TASKS)]:
        x = speeds.loc[job.options]
        ratios = [(x["ours"] / x[name]).dropna() for name in others]
        lines.append([f"`{job.script}`", job.options.split()[1], number(x["ours"].median()), *(
            f"{ratio.median():.2f} ({ratio.min():.2f} to {ratio.max():.2f})" if len(ratio) else ""
            for ratio in ratios)])
    header = ["script", "task", "steps a second", *(f"ratio to {name}" for name in others)]
    x = rows[rows["options"].str.contains("--vectorization")]
    words = x["options"].str.split()
    x = x.assign(environments=words.str[1].astype(int), processes=words.str[3].map(KINDS))
    x = x.groupby(["learner", "processes", "environments"])["speed"].median()
    picture, panels = study.figure(11, 4, 1, 2)
    for axis, learner in zip(panels, ("stepping alone", "ours")):
        sns.lineplot(x[learner].reset_index(), x="environments", y="speed", hue="processes",
                     style="processes", markers=True, ax=axis)
        axis.set_xscale("log", base=2)
        axis.set(title=learner, ylabel="steps a second", ylim=0, xticks=COUNTS, xticklabels=COUNTS)
    study.save(picture, "scaling")
    scaling = [[*names, *map(number, line)] for names, line in x.unstack().iterrows()]
    return {"speed": study.table(header, lines),
            "scaling": study.table(["steps a second", "environments in", *COUNTS], scaling)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure, workers=1)
