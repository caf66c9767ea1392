"""Ours against CleanRL and stable-baselines3 (sb3): returns after a million steps, and speed.

sb3 (`pip install stable-baselines3==2.9.2`) with its defaults, with the settings of its zoo (its
file hyperparams/ppo.yml, as of 26 November 2026), and with the sizes of ours; observations and
rewards are normalised by its `VecNormalize`. CleanRL's returns, data/cleanrl.csv, are measured by
commit e64b293. Its speed wants `pip install tyro tensorboard`, its ppo_continuous_action.py's path
in CLEANRL, and an idle machine: `python experiments/peers.py --only speed --workers 1`.
"""

import importlib.metadata
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gymnasium as gym
import pandas as pd
import returns
import seaborn as sns
import study
import torch
from study import Job, number, spread
from variants import PPO

FILE = "experiments/peers.py"
LEARNERS = {  # the change of their rows: what pages call it
    "": "ours", "CleanRL": "CleanRL", "defaults": "sb3 with VecNormalize", "zoo": "sb3, zoo",
    "our sizes": "sb3, our sizes"}
SEEDS = {  # of sb3: on three tasks the best after five seeds got five more; all count
    ("HalfCheetah-v5", "zoo"): 10, ("HalfCheetah-v5", "defaults"): 5,
    ("HalfCheetah-v5", "our sizes"): 5, ("Hopper-v5", "defaults"): 10, ("Hopper-v5", "zoo"): 5,
    ("Hopper-v5", "our sizes"): 5, ("Walker2d-v5", "our sizes"): 10, ("Walker2d-v5", "zoo"): 5,
    ("Walker2d-v5", "defaults"): 5, ("InvertedDoublePendulum-v5", "defaults"): 5,
    ("InvertedDoublePendulum-v5", "zoo"): 5}
TASKS = list(dict.fromkeys(task for task, _ in SEEDS))
JOBS = [Job(FILE, returns.of(task), change, seed)
        for (task, change), count in SEEDS.items() for seed in range(1, count + 1)]
RACES = {task: f"--env-id {task} --total-steps 32768" for task in TASKS}
JOBS += [Job(PPO, race, "speed", seed) for seed in range(1, 6) for race in RACES.values()]
LEFT_OUT = "Hopper-v5", "zoo"  # ends near 1,000 in all five runs: not what the zoo publishes
RELU = {"log_std_init": -2, "ortho_init": False, "activation_fn": torch.nn.ReLU,
        "net_arch": {"pi": [256, 256], "vf": [256, 256]}}
ZOO = {
    "HalfCheetah-v5": {
        "n_steps": 512, "batch_size": 64, "n_epochs": 20, "gamma": 0.98, "gae_lambda": 0.92,
        "learning_rate": 2.0633e-05, "clip_range": 0.1, "ent_coef": 0.000401762,
        "vf_coef": 0.58096, "max_grad_norm": 0.8, "policy_kwargs": RELU},
    "Hopper-v5": {
        "n_steps": 512, "batch_size": 32, "n_epochs": 5, "gamma": 0.999, "gae_lambda": 0.99,
        "learning_rate": 9.80828e-05, "clip_range": 0.2, "ent_coef": 0.00229519,
        "vf_coef": 0.835671, "max_grad_norm": 0.7, "policy_kwargs": RELU},
    "Walker2d-v5": {
        "n_steps": 512, "batch_size": 32, "n_epochs": 20, "gamma": 0.99, "gae_lambda": 0.95,
        "learning_rate": 5.05041e-05, "clip_range": 0.1, "ent_coef": 0.000585045,
        "vf_coef": 0.871923, "max_grad_norm": 1},
    "InvertedDoublePendulum-v5": {
        "n_steps": 128, "batch_size": 512, "n_epochs": 10, "gamma": 0.98, "gae_lambda": 0.8,
        "learning_rate": 0.000155454, "clip_range": 0.4, "ent_coef": 1.05057e-06,
        "vf_coef": 0.695929, "max_grad_norm": 0.5},
}
OUR_SIZES = {"n_steps": 128, "batch_size": 512, "learning_rate": lambda left: 1e-3 * left}


class Agent:
    """An agent of sb3 that looks like one of ours."""

    def __init__(self, model):
        self.model = model

    def act(self, obs, deterministic):
        seen = self.model.get_vec_normalize_env().normalize_obs(obs)
        return self.model.predict(seen, deterministic=deterministic)[0]


def make_sb3(task, setting, seed):
    """A model that has not learned yet."""
    import stable_baselines3 as sb3
    from stable_baselines3.common import env_util, vec_env

    torch.set_num_threads(1)  # as ours
    settings = {"defaults": {}, "zoo": ZOO.get(task), "our sizes": OUR_SIZES}[setting]
    envs = env_util.make_vec_env(task, 16 if setting == "our sizes" else 1, seed)
    envs = vec_env.VecNormalize(envs, gamma=settings.get("gamma", 0.99))
    return sb3.PPO("MlpPolicy", envs, seed=seed, device="cpu", **settings)


def measure(job):
    """Evaluations of five episodes, the first at once; the return is the mean of the last three."""
    ours, args = study.load(Job(PPO, job.options, seed=job.seed))
    version = {"stable_baselines3": importlib.metadata.version("stable_baselines3")}
    if job.change == "speed":
        return {**version, **speeds(ours, args)}
    model, rows = make_sb3(args.env_id, job.change, job.seed), []
    envs, start = gym.make_vec(args.env_id, 5), time.perf_counter()

    def evaluate(*_):
        if model.num_timesteps >= len(rows) * args.total_steps / 50:
            rows.append({"steps": model.num_timesteps, "seconds": time.perf_counter() - start,
                         "return": ours.evaluate(Agent(model), envs, job.seed)})
        return True

    model.learn(args.total_steps, callback=evaluate)
    curve = pd.DataFrame(rows)
    return {**version, **study.outcome(curve), "return": curve["return"].tail(3).mean()}


def speeds(ours, args):
    """Steps a second of each learner, one after the other; none is evaluated."""
    ours.evaluate = lambda *_: 0.0
    with tempfile.TemporaryDirectory() as folder:
        ours.train(0, args, folder)
        log = pd.read_csv(f"{folder}/seed-{args.seed[0]}.csv")
        script = Path(os.environ["CLEANRL"]).resolve(strict=True)
        command = (f"{sys.executable} {script} --env-id {args.env_id} --no-cuda "
                   f"--total-timesteps {args.total_steps} --seed {args.seed[0]}")
        out = subprocess.run(command.split(), cwd=folder, check=True, text=True,
                             capture_output=True).stdout
    found = {"": (log["env_step"] / log["seconds"]).iloc[-1],
             "CleanRL": int(re.findall(r"SPS: (\d+)", out)[-1])}
    for setting in "defaults", "our sizes":
        model, start = make_sb3(args.env_id, setting, args.seed[0]), time.perf_counter()
        model.learn(args.total_steps)
        found[setting] = model.num_timesteps / (time.perf_counter() - start)
    return {f"speed of {LEARNERS[change]}": speed for change, speed in found.items()}


def returns_table(finals):
    """A line for each task; bold: significantly unlike ours, all comparisons corrected together."""
    tested = [x for x in finals if x[1] and x != LEFT_OUT]
    gains = {x: study.welch(finals[x[0], ""], finals[x]) for x in tested}
    bold = study.holm(pd.Series({x: gain.p for x, gain in gains.items()}))
    lines = []
    for task in TASKS:
        cells = []
        for change in LEARNERS:
            runs = finals.get((task, change), [])
            text = f"{spread(runs)} ({len(runs)})" if len(runs) else "–"
            cells.append(f"**{text}**" if bold.get((task, change)) else text)
        best = max((x for x in tested if x[0] == task), key=lambda x: finals[x].mean())
        lines.append([task, *cells, gains[best]])
    return study.table(["task", *LEARNERS.values(), "ours − best peer, 95% uncorrected"], lines)


def speed_table(rows):
    """Our steps a second, and ratios: medians of five turns, the lowest and the highest."""
    lines = []
    for task, race in RACES.items():
        turns = rows[(rows["options"] == race) & (rows["change"] == "speed")]
        ours, cells = turns["speed of ours"], []
        for change in "CleanRL", "defaults", "our sizes":
            ratios = ours / turns[f"speed of {LEARNERS[change]}"]
            low, middle, high = (number(x, 1) for x in ratios.quantile([0, 0.5, 1]))
            cells.append(f"{middle} ({low} to {high})")
        lines.append([task, number(ours.median()), *cells])
    return study.table(["task", "ours, steps a second", "÷ CleanRL", "÷ sb3 with VecNormalize",
                        "÷ sb3, our sizes"], lines)


def draw_race(runs):
    """Means of seeds, and their standard errors."""
    lines = study.curves(runs, returns.STEPS[1:])  # CleanRL's evaluations start at 50,000
    lines["learner"] = lines["change"].map(LEARNERS)
    names = list(LEARNERS.values())
    grid = sns.relplot(lines, x="thousand steps", y="return", hue="learner", style="learner",
                       hue_order=names, style_order=names, col="task", col_order=TASKS,
                       col_wrap=2, kind="line", errorbar="se", err_kws={"alpha": 0.12},
                       markers=True, ms=9, lw=2, height=4.5, aspect=1.3,
                       facet_kws={"sharey": False})
    return grid.set_titles("{col_name}")


def draw(rows):
    runs = pd.concat([study.read("returns"), study.read("cleanrl"), rows])
    runs["task"] = runs["options"].map({returns.of(task): task for task in TASKS})
    runs = runs.dropna(subset="task")
    finals = dict(list(runs.groupby(["task", "change"])["return"]))
    left_out = (runs["task"] == LEFT_OUT[0]) & (runs["change"] == LEFT_OUT[1])
    tables = {"peers": returns_table(finals), "speed": speed_table(rows)}
    return tables, {"ppo_race": draw_race(runs[~left_out])}


if __name__ == "__main__":
    study.main("peers", JOBS, measure)
