"""Steps per second: ours, stable-baselines3's, and stepping alone; and where our time goes."""

import math
import time

import pandas as pd
from benchmark import common, peers
from benchmark.common import A2C, PPO, REINFORCE, Job

FIGURES = ()
ALONE = True  # nothing else may run beside a measurement of speed
TASKS = {PPO: "HalfCheetah-v5", A2C: "LunarLander-v3", REINFORCE: "InvertedPendulum-v5"}
PEER, ALIKE = "stable-baselines3", "stable-baselines3, sizes as ours"


def jobs(quick):
    steps, pairs = (512, 1) if quick else (100_000, 5)
    return [Job(script, pair, f"--env-id {env_id} --total-steps {steps}")
            for pair in range(1, pairs + 1) for script, env_id in TASKS.items()]


def parse(job):
    return common.load(job.script).parse_args(job.flags.split())


def our_speed(job):
    """Of a training without evaluations."""
    _, _, updates = common.begin(job.script, parse(job), job.seed)
    next(updates)  # all is made, nothing is trained
    start = time.perf_counter()
    env_step, *_ = list(updates)[-1]
    return env_step / (time.perf_counter() - start)


def peer_speed(job, sizes_as_ours):
    """With its defaults, but as many environments as it likes best: eight; or with our sizes."""
    args, count, settings = parse(job), 8, {}
    if sizes_as_ours:
        count, settings["n_steps"] = args.num_envs, args.rollout_steps
        if job.script == PPO:
            settings["batch_size"] = args.minibatch_size
    model = peers.make(job.script, args.env_id, count, job.seed, **settings)
    start = time.perf_counter()
    model.learn(args.total_steps)  # rounds up to whole rollouts, as ours does
    return model.num_timesteps / (time.perf_counter() - start)


def random_speed(job):
    """Our environments without a learner: actions drawn beforehand."""
    args = parse(job)
    envs, _, _ = common.begin(job.script, args, job.seed)
    envs.action_space.seed(job.seed)
    envs.reset(seed=job.seed)
    count = math.ceil(args.total_steps / envs.num_envs)
    actions = [envs.action_space.sample() for _ in range(count)]
    start = time.perf_counter()
    for action in actions:
        _, _, terminated, truncated, _ = envs.step(action)
        done = terminated | truncated
        if done.any():
            envs.reset(options={"reset_mask": done})  # as `rollout` does
    seconds = time.perf_counter() - start
    envs.close()
    return count * envs.num_envs / seconds


def shares(job):
    """The fractions of our time that environments, actions and updates take."""
    module, seconds = common.load(job.script), {}

    def add_timer(owner, name, part):
        function = getattr(owner, name)

        def timed(*args, **kwargs):
            start = time.perf_counter()
            result = function(*args, **kwargs)
            seconds[part] = seconds.get(part, 0.0) + time.perf_counter() - start
            return result

        setattr(owner, name, timed)

    envs, _, _ = common.begin(job.script, parse(job), job.seed)
    add_timer(type(envs), "step", "environments")
    add_timer(type(envs), "reset", "environments")
    add_timer(module.Agent, "act", "actions")
    add_timer(module, "optimise", "updates")
    start = time.perf_counter()
    our_speed(job)
    total = time.perf_counter() - start
    return {part: x / total for part, x in seconds.items()}


def measure(job):
    return common.fresh(speeds, job)


def speeds(job):
    row = {"env_id": parse(job).env_id, "ours": our_speed(job), "stepping": random_speed(job)}
    if job.script != REINFORCE:  # which stable-baselines3 does not have
        row[PEER] = peer_speed(job, sizes_as_ours=False)
        row[ALIKE] = peer_speed(job, sizes_as_ours=True)
    return pd.DataFrame([{**row, **shares(job)}])  # last: its timers stay


def report(data, draw):
    rows = []
    for script, env_id in TASKS.items():
        x = data[data["script"] == script]
        cells = []
        for other in PEER, ALIKE, "stepping":
            ratio = (x["ours"] / x[other]).dropna()
            cells.append(f"{ratio.median():.2f} ({ratio.min():.2f} to {ratio.max():.2f})"
                         if len(ratio) else "–")
        parts = ", ".join(f"{part} {x[part].median():.0%}"
                          for part in ("environments", "actions", "updates"))
        rows.append([f"`{script}.py`", env_id, f"{x['ours'].median():,.0f}", *cells, parts])
    return {"ratios": common.table(
        ["script", "task", "steps per second", f"ratio to {PEER}'s", "ratio, same sizes",
         "ratio to stepping alone", "where our time goes"], rows)}
