"""Every number and picture that the README shows: python tests/benchmark.py speed|returns|squash"""

import argparse
import importlib.metadata
import json
import math
import multiprocessing
import os
import platform
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pandas as pd
import seaborn as sns
import torch

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
import ppo_continuous as ppo

DEFAULTS = vars(ppo.parse_args([]))
STEPS = {DEFAULTS["env_id"]: DEFAULTS["total_steps"]}  # the table of environments
STEPS |= {f"{name}-v5": 1_000_000 for name in (
    "HalfCheetah", "Hopper", "Walker2d", "Ant", "Swimmer", "Reacher", "InvertedPendulum")}


def run_script(*arguments):
    """Run the script as a user would; returns its run folder. Its bars go to stderr."""
    command = [sys.executable, ppo.__file__, *map(str, arguments)]
    output = subprocess.check_output(command, text=True)
    return Path(output.splitlines()[-1]).parent  # it ends with the path of its learning curve


def print_table(header, rows):
    print()
    for row in (header, ["---"] * len(header), *rows):
        print("|", " | ".join(map(str, row)), "|")


def print_machine(versions):
    cpuinfo, model = Path("/proc/cpuinfo"), platform.processor() or platform.machine()
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []  # Linux says it there
    model = next((x.split(": ")[1] for x in lines if x.startswith("model name")), model)
    print(f"\n{versions}\n{model}, {os.cpu_count()} cores, {platform.system()}")


# --- Speed ----------------------------------------------------------------------------------------


def our_speed(env_id, steps, seed):
    with tempfile.TemporaryDirectory() as out_dir:
        folder = run_script("--seed", seed, "--env-id", env_id, "--total-steps", steps,
                            "--eval-every", 0, "--eval-episodes", 1, "--out-dir", out_dir)
        return json.loads((folder / f"seed-{seed}/summary.json").read_text())["steps_per_second"]


def sb3_speed(env_id, steps, seed):
    """The PPO of stable-baselines3 with its default hyperparameters."""
    from stable_baselines3 import PPO  # optional
    from stable_baselines3.common import env_util, vec_env

    torch.set_num_threads(1)  # as ours
    envs = vec_env.VecNormalize(env_util.make_vec_env(env_id, 8, seed))  # steps them in turn
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu")
    start = time.perf_counter()
    model.learn(steps)  # rounds up to whole rollouts, as ours does
    return model.num_timesteps / (time.perf_counter() - start)


def random_speed(env_id, steps, seed):
    """Our environments without a learner: actions drawn beforehand."""
    envs = ppo.make_envs(env_id, DEFAULTS["num_envs"])
    envs.action_space.seed(seed)
    envs.reset(seed=seed)
    actions = [envs.action_space.sample() for _ in range(math.ceil(steps / envs.num_envs))]
    start = time.perf_counter()
    for action in actions:
        envs.step(action)
    return len(actions) * envs.num_envs / (time.perf_counter() - start)


def our_shares(env_id, steps):
    """Where the seconds of a training run go; evaluation is none of it, as in steps_per_second."""
    seconds = dict.fromkeys(("environment", "policy", "update"), 0.0)

    def add_timer(owner, name, part):
        function = getattr(owner, name)

        def timed(*args, **kwargs):
            start = time.perf_counter()
            result = function(*args, **kwargs)
            seconds[part] += time.perf_counter() - start
            return result

        setattr(owner, name, timed)

    add_timer(type(ppo.make_envs(env_id, 1)), "step", "environment")
    add_timer(ppo.Policy, "act", "policy")
    add_timer(ppo, "optimise", "update")
    ppo.evaluate = lambda *_: {}  # it would call Policy.act, too
    args = ppo.parse_args(["--env-id", env_id, "--total-steps", str(steps), "--eval-every", "0"])
    with tempfile.TemporaryDirectory() as folder:
        ppo.train(args, 1, Path(folder), multiprocessing.Event())
        total = json.loads(Path(folder, "summary.json").read_text())["train_seconds"]
    seconds["rest"] = total - sum(seconds.values())
    return {part: x / total for part, x in seconds.items()}


def fresh(*task):
    """Call a function in a new process: it inherits neither threads nor caches nor timers."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(*task).result()


def speed(args):
    versions = ppo.versions()
    measures = {"ours": our_speed, "stable-baselines3": sb3_speed, "random actions": random_speed}
    try:
        versions["stable-baselines3"] = importlib.metadata.version("stable-baselines3")
    except importlib.metadata.PackageNotFoundError:
        print("stable-baselines3 goes unmeasured: pip install stable-baselines3")
        del measures["stable-baselines3"]
    rows = [[fresh(measure, args.env_id, args.steps, seed) for measure in measures.values()]
            for seed in range(1, args.pairs + 1)]  # in turns: a busy machine slows all alike
    data = pd.DataFrame(rows, columns=list(measures))
    data.to_csv(args.out_dir / "speed.csv", index=False)
    print_table(["pair", *data], [[i + 1, *map(round, row)] for i, row in enumerate(rows)])
    print()
    for name in data.columns[1:]:
        ratio = data["ours"] / data[name]
        print(f"ours / {name}: median {ratio.median():.3f}, {ratio.min():.3f} to {ratio.max():.3f}")
    shares = fresh(our_shares, args.env_id, args.steps)
    print("our time:", ", ".join(f"{name} {share:.0%}" for name, share in shares.items()))
    print_machine(json.dumps(versions))


# --- Returns --------------------------------------------------------------------------------------


def collect(folders):
    """Tables with a row per seed and a row per evaluation; `flags`: those not always at default."""
    configs = [{**DEFAULTS, **json.loads((x / "args.json").read_text())} for x in folders]
    names = sorted(DEFAULTS.keys() - {"seed", "env_id", "total_steps", "out_dir"})
    names = [x for x in names if any(config[x] != DEFAULTS[x] for config in configs)]
    rows, curves = [], []
    for folder, config in zip(folders, configs):
        flags = " ".join(f"--{name.replace('_', '-')} {config[name]}" for name in names)
        for seed in config["seed"]:  # one without a result is an error, not left out
            result = json.loads((folder / f"seed-{seed}/summary.json").read_text())
            if result["env_steps"] < config["total_steps"]:
                sys.exit(f"error: {folder}: seed {seed} was stopped before its end")
            result |= {"minutes": result["train_seconds"] / 60, "flags": flags,
                       "versions": json.dumps(result["versions"])}
            rows.append({x: result[x] for x in (
                "script", "env_id", "flags", "seed", "env_steps", "eval_return_mean",
                "eval_return_std", "eval_episodes", "minutes", "steps_per_second", "versions")})
            evals = pd.read_csv(folder / f"seed-{seed}/evals.csv")
            curves.append(evals.assign(env_id=result["env_id"], flags=flags))
    return pd.DataFrame(rows), pd.concat(curves, ignore_index=True)


def summarise(data):
    """Rows of the README's table, one per environment and flags; std with n − 1."""
    for (env_id, flags, steps), seeds in data.groupby(["env_id", "flags", "env_steps"], sort=False):
        returns = seeds["eval_return_mean"]
        yield (f"{env_id} {flags}", f"{steps:,}", f"{returns.mean():.1f} ± {returns.std():.1f}",
               ", ".join(f"{x:.1f}" for x in returns), round(seeds["minutes"].mean(), 1),
               round(seeds["steps_per_second"].mean()))


def plot(curves, path):
    """A panel per environment: mean ± one std over seeds."""
    hue = "flags" if curves["flags"].nunique() > 1 else None
    grid = sns.relplot(curves, x="env_step", y="return_mean", hue=hue, kind="line", errorbar="sd",
                       col="env_id", col_wrap=min(4, curves["env_id"].nunique()), height=2.6,
                       aspect=1.3, facet_kws={"sharex": False, "sharey": False})
    grid.set_titles("{col_name}").set_axis_labels("environment steps", "evaluation return (raw)")
    for axis in grid.axes.flat:
        axis.locator_params(axis="x", nbins=4)  # else the labels of small panels overlap
    grid.savefig(path, dpi=100)


def returns(args):
    totals = args.total_steps or [STEPS.get(x, DEFAULTS["total_steps"]) for x in args.env_id]
    if len(totals) != len(args.env_id):
        sys.exit(f"error: argument --total-steps: got {totals}, takes one for each --env-id")
    folders = args.runs or [
        run_script("--env-id", env_id, "--seed", *args.seed, "--total-steps", steps, *flags,
                   "--out-dir", args.out_dir, *args.extra)
        for env_id, steps in zip(args.env_id, totals) for flags in args.compare]
    data, curves = collect(folders)
    if data.duplicated(["env_id", "flags", "env_steps", "seed"]).any():
        sys.exit("error: argument --runs: a seed comes twice with the same flags")
    data.to_csv(args.out_dir / f"{args.study}.csv", index=False)
    print_table(["environment", "steps", "mean ± std over seeds", "every seed", "minutes per seed",
                 "steps/s"], summarise(data))
    if args.plot:
        plot(curves, args.out_dir / f"{args.study}.png")
    print("", *folders, sep="\n")
    print_machine("; ".join(data["versions"].unique()))


# --- main -----------------------------------------------------------------------------------------


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    studies = parser.add_subparsers(dest="study", required=True)
    squash = {"env_id": ["HalfCheetah-v5", "Hopper-v5"], "plot": True,
              "compare": [["--squash", "tanh"], ["--squash", "clip"]]}
    for name, text, defaults in (
        ("speed", "ours, that of stable-baselines3 and of random actions", {"function": speed}),
        ("returns", "on the table of environments", {"env_id": list(STEPS), "compare": [[]]}),
        ("squash", "returns of --squash tanh against clip", squash),
    ):
        study = studies.add_parser(name, help=text, description=text)
        add = study.add_argument
        if name == "speed":
            add("--env-id", default="HalfCheetah-v5")
            add("--steps", type=int, default=100_000, help="at least, in every measurement")
            add("--pairs", type=int, default=5, help="measurements of each, in turns")
        else:
            add("--env-id", nargs="+")
            add("--seed", type=int, nargs="+", default=[1, 2, 3, 4, 5])
            add("--total-steps", type=int, nargs="+", help="one for each --env-id")
            add("--runs", type=Path, nargs="+", help="finished run folders: show these, train none")
            add("--plot", action="store_true", help="draw learning curves")
            add("--extra", nargs=argparse.REMAINDER, default=[], help="all after it: to the script")
        add("--out-dir", type=Path, default="runs/benchmark", help="for tables, pictures and runs")
        study.set_defaults(**{"function": returns, **defaults})
    args = parser.parse_args()
    args.out_dir.mkdir(parents=True, exist_ok=True)
    args.function(args)


if __name__ == "__main__":
    main()
