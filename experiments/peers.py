"""Ours against CleanRL and stable-baselines3 (sb3): returns after a million steps, and speed.

sb3 (`pip install stable-baselines3==2.9.2`) with its defaults, with the settings of its zoo (its
files hyperparams/ppo.yml and a2c.yml, as of 26 November 2026), and with the sizes of ours; PPO's
observations and rewards are normalised by its `VecNormalize`. CleanRL's ppo_continuous_action.py,
whose path is the environment variable CLEANRL, gets the one more argument that Gymnasium 1.x wants.
Speeds want an idle machine: `python experiments/peers.py --only speed --workers 1`.
"""

import contextlib
import io
import os
import sys
import time
from pathlib import Path
from unittest import mock

import gymnasium as gym
import numpy as np
import pandas as pd
import returns
import study
import torch
from study import Job, number, spread
from variants import A2C, PPO

FILE, CLEANRL = "experiments/peers.py", os.environ.get("CLEANRL")
LEARNERS = {  # the change of their rows: what pages call it, colour, dashes
    "": ("ours", "C0", "-"), "CleanRL": ("CleanRL", "black", (0, (5, 1))),
    "defaults": ("sb3 with VecNormalize", "C1", "--"), "zoo": ("sb3, zoo", "C2", ":"),
    "our sizes": ("sb3, our sizes", "C4", "-.")}
SEEDS = {  # of sb3: the setting that was best after five seeds got five more; all count
    ("HalfCheetah-v5", "zoo"): 10, ("HalfCheetah-v5", "defaults"): 5,
    ("HalfCheetah-v5", "our sizes"): 5, ("Hopper-v5", "defaults"): 10, ("Hopper-v5", "zoo"): 5,
    ("Hopper-v5", "our sizes"): 5, ("Walker2d-v5", "our sizes"): 10, ("Walker2d-v5", "zoo"): 5,
    ("Walker2d-v5", "defaults"): 5, ("InvertedDoublePendulum-v5", "defaults"): 5}
TASKS = list(dict.fromkeys(task for task, _ in SEEDS))
RACES = {task: f"--env-id {task} --total-steps 32768" for task in (*TASKS, "LunarLander-v3")}
JOBS = [*(Job(FILE, returns.of(task), change, seed) for (task, change), count in SEEDS.items()
          for seed in range(1, count + 1)),
        *(Job(FILE, returns.of(task), "CleanRL", seed) for task in TASKS
          for seed in range(106, 111)),
        *(Job(FILE, race, "speed", seed) for seed in range(1, 6) for race in RACES.values())]
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
}
OUR_SIZES = {"num_envs": 16, "n_steps": 128, "batch_size": 512,
             "learning_rate": lambda left: 1e-3 * left}

# --- stable-baselines3 ----------------------------------------------------------------------------


def make_sb3(task, setting, seed):
    """A model that has not learned yet: A2C on LunarLander, else PPO."""
    import stable_baselines3 as sb3
    from stable_baselines3.common import env_util, vec_env

    torch.set_num_threads(1)  # as ours
    lands = task == "LunarLander-v3"
    settings = {"defaults": {}, "zoo": ZOO.get(task),
                "our sizes": {"num_envs": 8, "n_steps": 64} if lands else OUR_SIZES}[setting].copy()
    # LunarLander would else simulate sparks, to draw them.
    envs = env_util.make_vec_env(task, settings.pop("num_envs", 8 if lands else 1), seed,
                                 env_kwargs={"render_mode": None})
    if lands:
        return sb3.A2C("MlpPolicy", envs, seed=seed, device="cpu", **settings)
    envs = vec_env.VecNormalize(envs, gamma=settings.get("gamma", 0.99))
    return sb3.PPO("MlpPolicy", envs, seed=seed, device="cpu", **settings)


class Sb3Agent:
    """Looks like one of ours."""

    def __init__(self, model):
        self.model = model

    def act(self, obs, deterministic):
        seen = self.model.get_vec_normalize_env().normalize_obs(obs)
        return self.model.predict(seen, deterministic=deterministic)[0]


def learn_sb3(job, args, evaluate):
    """51 evaluations of five episodes; the return is the mean of the last three."""
    model, rows = make_sb3(args.env_id, job.change, job.seed), []
    envs, agent, start = gym.make_vec(args.env_id, 5), Sb3Agent(model), time.perf_counter()

    def evaluation(*_, last=False):
        if last or model.num_timesteps >= len(rows) * args.total_steps / 50:
            rows.append({"steps": model.num_timesteps, "seconds": time.perf_counter() - start,
                         "return": evaluate(agent, envs, job.seed)})
        return True

    model.learn(args.total_steps, callback=evaluation)
    evaluation(last=True)
    curve = pd.DataFrame(rows)
    return study.numbers(curve) | {"return": curve["return"].tail(3).mean()}


def speed_of_sb3(args, setting):
    model, start = make_sb3(args.env_id, setting, args.seed[0]), time.perf_counter()
    model.learn(args.total_steps)
    return model.num_timesteps / (time.perf_counter() - start)


# --- CleanRL --------------------------------------------------------------------------------------


def run_cleanrl(args, after_update=lambda script, step: None):
    """Run its script, without tyro and TensorBoard; returns the steps a second that it logs last.

    `after_update(script, step)` is called after each of its updates, with its global names.
    """
    torch.set_num_threads(1)
    text, old = Path(CLEANRL).read_text("utf-8"), "lambda obs: np.clip(obs, -10, 10)"
    if text.count(old) != 1:
        raise ValueError(f"{CLEANRL}: {old!r} occurs {text.count(old)} times")
    options = {"env_id": args.env_id, "total_timesteps": args.total_steps, "seed": args.seed[0],
               "cuda": False}
    script, speeds = {"__name__": "__main__", "__file__": CLEANRL}, []

    def add_scalar(tag, value, step):
        if tag == "charts/SPS":  # the last of an update
            speeds.append(value)
            after_update(script, step)

    theirs = {"tyro": mock.Mock(cli=lambda Args: Args(**options)),
              "torch.utils.tensorboard": mock.Mock(
                  SummaryWriter=lambda _: mock.Mock(add_scalar=add_scalar))}
    with mock.patch.dict(sys.modules, theirs), contextlib.redirect_stdout(io.StringIO()):
        exec(compile(text.replace(old, f"{old}, env.observation_space"), CLEANRL, "exec"), script)
    return speeds[-1]


class CleanRLAgent:
    """Looks like one of ours. Observations are normalised with the statistics of its training."""

    def __init__(self, script):
        self.actor_mean = script["agent"].actor_mean
        (self.stats,) = script["envs"].get_attr("obs_rms")

    @torch.no_grad()
    def act(self, obs, deterministic):
        seen = (obs - self.stats.mean) / np.sqrt(self.stats.var + 1e-8)
        return self.actor_mean(torch.Tensor(seen.clip(-10, 10))).numpy()


def learn_cleanrl(args, evaluate):
    """Twenty evaluations of ten episodes, with mean actions, clipped to their bounds."""
    envs, rows = gym.make_vec(args.env_id, 10, wrappers=[gym.wrappers.ClipAction]), []
    start = time.perf_counter()

    def after_update(script, step):
        size = script["args"].batch_size
        if 20 * (step // size) // (args.total_steps // size) > len(rows):
            rows.append({"steps": step, "seconds": time.perf_counter() - start,
                         "return": evaluate(CleanRLAgent(script), envs, args.seed[0])})

    run_cleanrl(args, after_update)
    return study.numbers(pd.DataFrame(rows))


# --- Measured, and drawn --------------------------------------------------------------------------


def measure(job):
    script = A2C if "LunarLander" in job.options else PPO
    ours, args = study.load(Job(script, job.options, seed=job.seed))
    if job.change == "speed":
        return speeds(ours, args)
    if job.change == "CleanRL":
        return learn_cleanrl(args, ours.evaluate)
    return learn_sb3(job, args, ours.evaluate)


def speeds(ours, args):
    """Steps a second of each learner, one after the other; ours without evaluations."""
    ours.evaluate = lambda *_: 0.0
    log, _ = study.run(ours, args)
    found = {"": (log["env_step"] / log["seconds"]).iloc[-1]}
    if args.env_id != "LunarLander-v3":
        found["CleanRL"] = run_cleanrl(args)
    for setting in "defaults", "our sizes":
        found[setting] = speed_of_sb3(args, setting)
    return {f"speed of {LEARNERS[change][0]}": speed for change, speed in found.items()}


def finals_of(rows):
    """{(task, change): returns}, of ours, too."""
    ours = study.read("returns")
    runs = pd.concat([ours, rows]).groupby(["options", "change"])["return"]
    return {(task, change): runs.get_group((returns.of(task), change)) for task in TASKS
            for change in LEARNERS if (returns.of(task), change) in runs.groups}


def returns_table(finals):
    """A line for each task; bold: significantly unlike ours, all comparisons corrected together."""
    tested = [x for x in finals if x[1] and x != LEFT_OUT]
    gains = {x: study.welch(finals[x[0], ""], finals[x]) for x in tested}
    bold = dict(zip(tested, study.holm([gains[x].p for x in tested])))
    lines = []
    for task in TASKS:
        cells = []
        for change in LEARNERS:
            runs = finals.get((task, change), [])
            text = f"{spread(runs)} ({len(runs)})" if len(runs) else "–"
            cells.append(f"**{text}**" if bold.get((task, change)) else text)
        best = max((x for x in tested if x[0] == task), key=lambda x: finals[x].mean())
        lines.append([task, *cells, f"{gains[best]}"])
    names = [name for name, *_ in LEARNERS.values()]
    return study.table(["task", *names, "ours − best peer, 95%"], lines)


def speed_table(rows):
    """Our steps a second, and ratios: medians of five turns, the lowest and the highest."""
    lines = []
    for task, race in RACES.items():
        turns = rows[(rows["options"] == race) & (rows["change"] == "speed")]
        ours = turns["speed of ours"]
        cells = []
        for change in "CleanRL", "defaults", "our sizes":
            ratios = ours / turns[f"speed of {LEARNERS[change][0]}"]
            low, middle, high = (number(x, 1) for x in ratios.quantile([0, 0.5, 1]))
            cells.append(f"{middle} ({low} to {high})" if ratios.notna().any() else "–")
        lines.append([task, number(ours.median()), *cells])
    return study.table(["task", "ours, steps a second", "÷ CleanRL", "÷ sb3 with VecNormalize",
                        "÷ sb3, our sizes"], lines)


def draw_race(rows):
    """Means of seeds, and bands of a standard deviation, in steps of 50,000."""
    picture, panels = study.figure(13, 9, 2, 2)
    lines = study.curves(pd.concat([study.read("returns"), rows[rows["change"] != "speed"]]))
    lines["million"] = (lines["steps"] / 50_000).round() / 20
    for i, (axis, task) in enumerate(zip(panels, TASKS)):
        for change, (name, color, dashes) in LEARNERS.items():
            runs = lines[(lines["options"] == returns.of(task)) & (lines["change"] == change)]
            if (task, change) == LEFT_OUT or runs.empty:
                continue
            seeds = runs.groupby(["million", "seed"])["return"].mean().unstack()
            mean, std = seeds.mean(axis="columns"), seeds.std(axis="columns")
            axis.plot(mean, color=color, ls=dashes, lw=3, label=name)
            axis.fill_between(mean.index, mean - std, mean + std, color=color, alpha=0.12, lw=0)
        axis.set(title=task.removesuffix("-v5"), xlabel="million steps" * (i > 1),
                 ylabel="return" * (i % 2 == 0))
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    picture.suptitle("Our PPO and peers': mean and standard deviation of seeds")
    return picture


def draw(rows):
    return ({"peers": returns_table(finals_of(rows)), "speed": speed_table(rows)},
            {"ppo_race": draw_race(rows)})


if __name__ == "__main__":
    study.main("peers", JOBS, measure)
