"""What others' PPO and A2C do on the same tasks: functions that train and measure them.

stable-baselines3 with its defaults, with the settings of its zoo (its files hyperparams/ppo.yml and
a2c.yml, as of 26 November 2026), with our sizes; PPO's observations and rewards are normalised.
CleanRL's own ppo_continuous_action.py, whose path is the environment variable CLEANRL; it is given
the one more argument that Gymnasium 1.x wants, and nothing else in it is changed.
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
import study
import torch
from study import Job
from variants import PPO

FILE, CLEANRL = "experiments/peers.py", os.environ.get("CLEANRL")

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
    "LunarLander-v3": {"num_envs": 8, "n_steps": 5, "gamma": 0.995, "ent_coef": 1e-5,
                       "learning_rate": lambda left: 8.3e-4 * left},
}
OUR_SIZES = {"num_envs": 16, "n_steps": 128, "batch_size": 512,
             "learning_rate": lambda left: 1e-3 * left}


def make(task, setting, seed, **settings):
    """A model of stable-baselines3 that has not learned yet: A2C on LunarLander, else PPO."""
    import stable_baselines3 as sb3
    from stable_baselines3.common import env_util, vec_env

    torch.set_num_threads(1)  # as ours
    lands = task == "LunarLander-v3"
    our_sizes = {"num_envs": 8, "n_steps": 64} if lands else OUR_SIZES
    settings |= {"defaults": {}, "zoo": ZOO.get(task), "our sizes": our_sizes}[setting]
    # LunarLander would else simulate sparks, to draw them.
    envs = env_util.make_vec_env(task, settings.pop("num_envs", 8 if lands else 1), seed,
                                 env_kwargs={"render_mode": None})
    if lands:
        return sb3.A2C("MlpPolicy", envs, seed=seed, device="cpu", **settings)
    envs = vec_env.VecNormalize(envs, gamma=settings.get("gamma", 0.99))
    return sb3.PPO("MlpPolicy", envs, seed=seed, device="cpu", **settings)


def speed(args, setting, options):
    """Steps a second of stable-baselines3."""
    model = make(args.env_id, setting, args.seed[0], **options)
    start = time.perf_counter()
    model.learn(args.total_steps)
    return model.num_timesteps / (time.perf_counter() - start)


def stepping_speed(module, args):
    """Of our environments without a learner, with actions drawn beforehand."""
    envs = module.make_envs(args, args.num_envs, autoreset_mode="Disabled")
    envs.reset(seed=1)
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


class Agent:
    """Looks like one of ours."""

    def __init__(self, model):
        self.model = model

    def act(self, obs, deterministic):
        envs = self.model.get_vec_normalize_env()
        seen = envs.normalize_obs(obs) if envs else obs
        return self.model.predict(seen, deterministic=deterministic)[0]


def learn(job):
    """A row for each of 51 evaluations of five episodes; of CleanRL see `learn_cleanrl`."""
    ours, args = study.load(Job(PPO, job.options, seed=job.seed))
    if job.change == "CleanRL":
        return learn_cleanrl(args, ours.evaluate)
    model, rows = make(args.env_id, job.change, job.seed), []
    envs, agent = gym.make_vec(args.env_id, 5), Agent(model)

    def evaluate(*_, last=False):
        if last or model.num_timesteps >= len(rows) * args.total_steps / 50:
            rows.append({"steps": model.num_timesteps,
                         "return": ours.evaluate(agent, envs, job.seed)})
        return True

    model.learn(args.total_steps, callback=evaluate)
    evaluate(last=True)
    return rows


def run_cleanrl(args, after_update=lambda script, step: None):
    """Run CleanRL's script; returns what it logs, a row for each value, with its tag and the step.

    It gets its options without tyro, and tells its log to us instead of TensorBoard.
    `after_update(script, step)` is called after each of its updates, with its global names.
    """
    torch.set_num_threads(1)
    text, old = Path(CLEANRL).read_text("utf-8"), "lambda obs: np.clip(obs, -10, 10)"
    if text.count(old) != 1:
        raise ValueError(f"{CLEANRL}: {old!r} occurs {text.count(old)} times")
    options = {"env_id": args.env_id, "total_timesteps": args.total_steps, "seed": args.seed[0],
               "cuda": False}
    script, log = {"__name__": "__main__", "__file__": CLEANRL}, []

    def add_scalar(tag, value, step):
        log.append({"tag": tag, "value": value, "steps": step})
        if tag == "charts/SPS":  # the last of an update
            after_update(script, step)

    theirs = {"tyro": mock.Mock(cli=lambda Args: Args(**options)),
              "torch.utils.tensorboard": mock.Mock(
                  SummaryWriter=lambda _: mock.Mock(add_scalar=add_scalar))}
    with mock.patch.dict(sys.modules, theirs), contextlib.redirect_stdout(io.StringIO()):
        exec(compile(text.replace(old, f"{old}, env.observation_space"), CLEANRL, "exec"), script)
    return pd.DataFrame(log)


def cleanrl_speed(args):
    """Steps a second, as it says itself at the end."""
    log = run_cleanrl(args)
    return log.loc[log["tag"] == "charts/SPS", "value"].iloc[-1]


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
    """A row for each twentieth of the updates: returns in training, averaged as ours are, and

    `return`, an evaluation of the mean actions, clipped to their bounds, of ten episodes.
    """
    envs, evaluations = gym.make_vec(args.env_id, 10, wrappers=[gym.wrappers.ClipAction]), []

    def after_update(script, step):
        batch_size = script["args"].batch_size
        if 20 * (step // batch_size) // (args.total_steps // batch_size) > len(evaluations):
            evaluations.append(evaluate(CleanRLAgent(script), envs, args.seed[0]))

    log = run_cleanrl(args, after_update)
    returns, updates = (log[log["tag"] == f"charts/{x}"] for x in ("episodic_return", "SPS"))
    of_updates = returns["value"].groupby(np.searchsorted(updates["steps"], returns["steps"]))
    of_updates = of_updates.mean()
    sampled = of_updates.groupby(np.ceil(20 * (of_updates.index + 1) / len(updates))).mean()
    steps = np.arange(1, 21) * updates["steps"].max() / 20
    version = study.git("hash-object", Path(CLEANRL).resolve())[:7]  # git's name of this very text
    return pd.DataFrame({"steps": steps, "seconds": steps / updates["value"].iloc[-1],
                         "return": evaluations, "sampled": sampled.reindex(range(1, 21)).values,
                         "cleanrl": version})
