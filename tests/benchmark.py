"""Every number and picture that the README shows: python tests/benchmark.py --help lists them."""

import argparse
import importlib.metadata
import json
import math
import multiprocessing
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import seaborn as sns
import torch
from matplotlib.figure import Figure
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
import a2c_vector as a2c
import ppo_continuous as ppo
import reinforce_mujoco as reinforce

PPO, A2C, REINFORCE = ppo.__name__, a2c.__name__, reinforce.__name__
SCRIPTS = {PPO: ppo, A2C: a2c, REINFORCE: reinforce}
DEFAULTS = {name: vars(script.parse_args([])) for name, script in SCRIPTS.items()}
STEPS = {name: {x["env_id"]: x["total_steps"]} for name, x in DEFAULTS.items()}
# The highest mean of several seeds that was published for PPO after a million steps, on -v1 to -v4
# of these environments. [1]: the PPO paper, [2]: Kostrikov's PPO (both read off figures, as listed
# by Tianshou), [3]: Tianshou's PPO (its data at 1.01 million steps, sampled actions), [4]: OpenAI
# Baselines' ppo2 (benchmarks_mujoco1M), [5]: CleanRL's ppo_continuous_action.
PUBLISHED = {
    "InvertedPendulum-v5": 1000,  # [1]
    "InvertedDoublePendulum-v5": 8000,  # [1]
    "Reacher-v5": -5,  # [2], [3]
    "Pusher-v5": -40,  # [5]
    "Swimmer-v5": 111,  # [4]
    "Hopper-v5": 2483,  # [3]
    "HalfCheetah-v5": 5650,  # [3]
    "Walker2d-v5": 4000,  # [2]
    "Ant-v5": 3141,  # [3]
    "Humanoid-v5": 732,  # [3]
}
STEPS[PPO] = dict.fromkeys(PUBLISHED, 1_000_000)
PACKAGES = "torch", "gymnasium", "mujoco", "Box2D", "numpy"
SEEDS = {PPO: [1, 2, 3, 4, 5], A2C: list(range(1, 11)), REINFORCE: [1, 2, 3, 5, 8]}


def run_script(path, *arguments):
    """Run a script as a user would; returns its run folder. Its bars go to stderr."""
    command = [sys.executable, path, *map(str, arguments)]
    output = subprocess.check_output(command, text=True)
    return Path(output.splitlines()[0])


def fresh(*task):
    """Call a function in a new process: it inherits neither threads nor caches nor timers."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(*task).result()


def print_table(header, rows):
    print()
    for row in (header, ["---"] * len(header), *rows):
        print("|", " | ".join(map(str, row)), "|")


def installed():
    return {name: importlib.metadata.version(name) for name in PACKAGES}


def print_machine(versions):
    cpuinfo, model = Path("/proc/cpuinfo"), platform.processor() or platform.machine()
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []  # Linux says it there
    model = next((x.split(": ")[1] for x in lines if x.startswith("model name")), model)
    print(f"\n{versions}\n{model}, {os.cpu_count()} cores, {platform.system()}")


# --- Training as a script does it -----------------------------------------------------------------


def make_envs(module, args):
    """The environments of a training."""
    if module is a2c:
        wrappers = [a2c.RandomPhysics] if args.randomize else []
        return a2c.make_envs(args.env_id, args.num_envs, "Disabled", args.vectorization, wrappers)
    return module.make_envs(args.env_id, 1 if module is reinforce else args.num_envs, "Disabled")


def begin(module, args, seed):
    """The agent and the generator of a training: what `run` makes, without its files."""
    torch.set_num_threads(1)
    torch.manual_seed(module.make_seeds(seed, stream=0, count=1)[0])
    envs = make_envs(module, args)
    agent = module.Agent(envs.single_observation_space, envs.single_action_space, args)
    if module is reinforce:
        optimizer = torch.optim.Adam(agent.parameters())
        return agent, module.train(args, seed, envs, agent, optimizer)
    return agent, module.train(args, seed, envs, agent, module.make_optimizer(agent), 0)


# --- Speed ----------------------------------------------------------------------------------------


def train(script, flags, seed):
    """Train without evaluations, in this process; returns the seconds and the steps it took."""
    _, updates = begin(SCRIPTS[script], SCRIPTS[script].parse_args(flags), seed)
    next(updates)  # all is made, nothing is trained
    start = time.perf_counter()
    env_step, *_ = list(updates)[-1]
    return time.perf_counter() - start, env_step


def our_speed(script, flags, seed):
    seconds, steps = train(script, flags, seed)
    return steps / seconds


def sb3_speed(script, flags, seed):
    """The same algorithm in stable-baselines3, with its default hyperparameters."""
    import stable_baselines3 as sb3  # optional
    from stable_baselines3.common import env_util, vec_env

    torch.set_num_threads(1)  # as ours
    args, is_ppo = SCRIPTS[script].parse_args(flags), script == PPO
    envs = env_util.make_vec_env(  # steps them in turn; by default LunarLander would draw sparks
        args.env_id, 8, seed, env_kwargs={"render_mode": None})
    envs = vec_env.VecNormalize(envs) if is_ppo else envs
    model = (sb3.PPO if is_ppo else sb3.A2C)("MlpPolicy", envs, seed=seed, device="cpu")
    start = time.perf_counter()
    model.learn(args.total_steps)  # rounds up to whole rollouts, as ours does
    return model.num_timesteps / (time.perf_counter() - start)


def random_speed(script, flags, seed):
    """Our environments without a learner: actions drawn beforehand."""
    args = SCRIPTS[script].parse_args(flags)
    envs = make_envs(SCRIPTS[script], args)
    envs.action_space.seed(seed)
    envs.reset(seed=seed)
    num_calls = math.ceil(args.total_steps / envs.num_envs)
    actions = [envs.action_space.sample() for _ in range(num_calls)]
    start = time.perf_counter()
    for action in actions:
        _, _, terminated, truncated, _ = envs.step(action)
        done = terminated | truncated
        if done.any():
            envs.reset(options={"reset_mask": done})  # as `rollout` does
    duration = time.perf_counter() - start
    envs.close()
    return num_calls * envs.num_envs / duration


def our_shares(script, flags):
    """Where the seconds of a training run go; evaluation is none of it."""
    module, seconds = SCRIPTS[script], {}

    def add_timer(owner, name, part):
        function = getattr(owner, name)

        def timed(*args, **kwargs):
            start = time.perf_counter()
            result = function(*args, **kwargs)
            seconds[part] = seconds.get(part, 0.0) + time.perf_counter() - start
            return result

        setattr(owner, name, timed)

    kind = type(make_envs(module, module.parse_args(flags)))
    add_timer(kind, "step", "environment")
    add_timer(kind, "reset", "environment")
    add_timer(module.Agent, "act", "policy")
    add_timer(module, "optimise", "update")
    total, _ = train(script, flags, 1)
    seconds["rest"] = total - sum(seconds.values())
    return {part: x / total for part, x in seconds.items()}


def speed(args):
    versions = installed()
    measures = {"ours": our_speed, "stable-baselines3": sb3_speed, "random actions": random_speed}
    try:
        versions["stable-baselines3"] = importlib.metadata.version("stable-baselines3")
    except importlib.metadata.PackageNotFoundError:
        print("stable-baselines3 goes unmeasured: pip install stable-baselines3")
        del measures["stable-baselines3"]
    if args.script == REINFORCE:
        measures.pop("stable-baselines3", None)  # it has no REINFORCE
    usual = "HalfCheetah-v5" if args.script == PPO else DEFAULTS[args.script]["env_id"]
    flags = ["--env-id", args.env_id or usual, "--total-steps", str(args.steps)]
    rows = [[fresh(measure, args.script, flags, seed) for measure in measures.values()]
            for seed in range(1, args.pairs + 1)]  # in turns: a busy machine slows all alike
    data = pd.DataFrame(rows, columns=list(measures))
    data.to_csv(args.out_dir / "speed.csv", index=False)
    print_table(["pair", *data], [[i + 1, *map(round, row)] for i, row in enumerate(rows)])
    print()
    for name in data.columns[1:]:
        ratio = data["ours"] / data[name]
        print(f"ours / {name}: median {ratio.median():.3f}, {ratio.min():.3f} to {ratio.max():.3f}")
    shares = fresh(our_shares, args.script, flags)
    print("our time:", ", ".join(f"{name} {share:.0%}" for name, share in shares.items()))
    print_machine(json.dumps(versions))


# --- Scaling --------------------------------------------------------------------------------------


def both_speeds(*task):
    return random_speed(*task), our_speed(*task)


def scaling(args):
    """Speed of stepping and of training against the number of environments, sync and async."""
    rows = []
    for seed in range(1, args.repeats + 1):  # in turns: a busy machine slows all alike
        for count in args.num_envs:
            for kind in ("sync", "async"):
                flags = ["--num-envs", str(count), "--vectorization", kind, "--rollout-steps",
                         str(max(1, 512 // count)), "--total-steps", str(args.steps)]
                speeds = fresh(both_speeds, A2C, flags, seed)
                rows += [{"measure": name, "vectorization": kind, "environments": count, "speed": x}
                         for name, x in zip(("stepping", "training"), speeds)]
    keys = ["measure", "vectorization", "environments"]
    data = pd.DataFrame(rows).groupby(keys)["speed"].median().reset_index()
    base = data[data["vectorization"].eq("sync") & data["environments"].eq(args.num_envs[0])]
    data["speed_up"] = data["speed"] / data["measure"].map(base.set_index("measure")["speed"])
    # The serial share e of Karp and Flatt (1990): p cores would be 1/(e + (1 − e)/p) times as fast.
    p = data["environments"].clip(upper=os.cpu_count()).where(data["vectorization"].eq("async"))
    data["serial_share"] = ((1 / data["speed_up"] - 1 / p) / (1 - 1 / p)).where(p > 1)
    data.to_csv(args.out_dir / "scaling.csv", index=False)
    shown = data.round({"speed": 0, "speed_up": 2, "serial_share": 2}).astype({"speed": int})
    shown = shown.astype(object).where(data.notna(), "–")
    print_table([*keys, "steps per second", f"over sync at {args.num_envs[0]}", "serial share"],
                shown.to_numpy().tolist())
    print(f"""
Serial share: the part of the work that {os.cpu_count()} cores do not share, if nothing else slows
them (Karp and Flatt 1990). Below 0: many environments also save calls. Above 1: slower than one.
""")
    print(conclude(data))
    draw_scaling(data, args.out_dir / "scaling.png")
    print_machine(json.dumps(installed()))


def conclude(data):
    """Two sentences from the numbers: what is fastest, and what bounds it."""
    speed = data.set_index(["measure", "vectorization", "environments"])["speed"]
    training, stepping = speed["training"], speed["stepping"]
    kind, count = training.idxmax()
    other = training.drop(kind, level=0)
    share = training.max() / stepping[kind, count]
    return (f"Training is fastest with {kind} at {count} environments: {training.max():.0f} steps "
            f"per second; {other.idxmax()[0]} reaches {other.max():.0f} at most, at "
            f"{other.idxmax()[1]}.\nStepping takes {share:.0%} of that time: learning at no cost "
            f"would make it {1 / share:.1f} times as fast.")


def draw_scaling(data, path):
    """Steps per second against the number of environments: stepping alone, and training."""
    grid = sns.relplot(data, x="environments", y="speed", hue="vectorization", kind="line",
                       style="vectorization", markers=True, col="measure", height=3.2, aspect=1.3)
    grid.set_titles("{col_name}").set_axis_labels("environments", "environment steps per second")
    ticks = sorted(data["environments"].unique())
    for axis in grid.axes.flat:
        axis.set_xscale("log", base=2)
        axis.set_xticks(ticks, ticks)
        axis.set_ylim(0)
    grid.savefig(path, dpi=100)


# --- Several processes ----------------------------------------------------------------------------


def write_recipe(folder):
    """together.py as the README shows it, and the script that it imports; returns its path."""
    text = Path(ppo.__file__).with_name("README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r'```python\n("""PPO that plays in several.*?)```', text, re.DOTALL)
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(ppo.__file__, folder)
    path = folder / "together.py"
    path.write_text(code, encoding="utf-8")
    return path


def processes(args):
    """PPO in one process and in two, with the same environments in all: steps per second."""
    path, flags = write_recipe(args.out_dir / "together"), ["--num-evals", 1, "--eval-episodes", 1]
    ways = {"one process": [path.with_name(f"{PPO}.py"), "--num-envs", args.num_envs],
            "two processes": ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", 2,
                              path, "--num-envs", args.num_envs // 2]}
    rows = []
    for env_id in args.env_id:
        for pair in range(args.pairs):  # in turns: a busy machine slows all alike
            for name, way in ways.items():
                folder = run_script(*way, "--env-id", env_id, "--total-steps", args.steps, *flags,
                                    "--out-dir", args.out_dir)
                last = pd.read_csv(folder / "seed-1/evals.csv").iloc[-1]
                rows.append({"env_id": env_id, "pair": pair + 1, "way": name,
                             "speed": last["env_step"] / last["seconds"]})
    data = pd.DataFrame(rows)
    data.to_csv(args.out_dir / "processes.csv", index=False)
    for env_id, x in data.groupby("env_id", sort=False):
        table = x.pivot(index="way", columns="pair", values="speed").loc[list(ways)]
        print_table([f"{env_id}, steps per second", *table.columns],
                    [[name, *map(round, row)] for name, *row in table.itertuples()])
        ratio = table.loc["two processes"] / table.loc["one process"]
        print(f"\ntwo processes / one process: median {ratio.median():.2f}, "
              f"{ratio.min():.2f} to {ratio.max():.2f}")
    print_machine(json.dumps(installed()))


# --- Returns --------------------------------------------------------------------------------------


def written_flags(config, names):
    """Those of `names` that a run was given, as on its command line."""
    values = {f"--{name.replace('_', '-')}": config[name] for name in names}
    return " ".join(flag if value is True else f"{flag} {value}"
                    for flag, value in values.items() if value is not False)


def collect(script, folders):
    """A row per seed, one per evaluation, one per episode; `flags`: those not always at default.

    A run that is not complete or comes twice is an error, not left out; so no seed gets lost.
    """
    default = DEFAULTS[script]
    configs = [{**default, **json.loads((x / "args.json").read_text())} for x in folders]
    names = sorted(default.keys() - {"seed", "env_id", "total_steps", "out_dir"})
    names = [x for x in names if any(config[x] != default[x] for config in configs)]
    rows, curves, faults, found = [], {"evals": [], "episodes": []}, [], {}
    for folder, config in zip(folders, configs):
        if Path(config["command"][0]).stem != script:
            sys.exit(f"error: {folder} is of {config['command'][0]}, not of {script}.py")
        flags, total = written_flags(config, names), config["total_steps"]
        for seed in config["seed"]:
            keys = {"env_id": config["env_id"], "flags": flags, "total_steps": total, "seed": seed}
            run = tuple(keys.values())
            if run in found:
                faults.append(f"{folder}: seed {seed} is in {found[run]}, too")
            found[run] = folder
            files = {name: folder / f"seed-{seed}/{name}.csv" for name in curves}
            if not files["evals"].exists():
                faults.append(f"{folder}: seed {seed} has saved nothing")
                continue
            last = pd.read_csv(files["evals"]).iloc[-1]
            if last["env_step"] < total:
                faults.append(f"{folder}: seed {seed} ended at {last['env_step']:.0f} of {total}")
                continue
            tables = {name: pd.read_csv(file) for name, file in files.items()}
            for name, table in tables.items():
                curves[name].append(table.assign(**keys))
            rows.append({
                "script": script, **keys, "env_steps": last["env_step"],
                "eval_return_mean": last["return_mean"], "eval_return_std": last["return_std"],
                "eval_episodes": config["eval_episodes"],
                "last_100_returns": tables["episodes"]["return"].tail(100).mean(),
                "minutes": last["seconds"] / 60, "versions": json.dumps(config["versions"]),
                "steps_per_second": last["env_step"] / last["seconds"], "folder": str(folder)})
    if faults:
        sys.exit("\n".join(["error: these runs cannot count:", *faults]))
    data = pd.DataFrame(rows).sort_values("seed", kind="stable", ignore_index=True)
    return data, *(pd.concat(x, ignore_index=True) for x in curves.values())


def print_versions(data):
    """Which packages the runs had; with a line for each folder if not all had the same."""
    print_machine("; ".join(data["versions"].unique()))
    if data["versions"].nunique() > 1:
        print("\nThe runs had different packages:")
        for (folder, versions), _ in data.groupby(["folder", "versions"], sort=False):
            print(f"{folder}: {versions}")


def summarise(data):
    """Rows of the README's table, one per environment and flags; std with n − 1."""
    for (env_id, flags, _), seeds in data.groupby(["env_id", "flags", "total_steps"], sort=False):
        returns, trained = seeds["eval_return_mean"], seeds["last_100_returns"]
        yield (f"{env_id} {flags}", f"{seeds['env_steps'].mean():,.0f}",
               f"{returns.mean():.1f} ± {returns.std():.1f}",
               ", ".join(f"{x:.1f}" for x in returns), ", ".join(f"{x:.1f}" for x in trained),
               round(seeds["minutes"].mean(), 1), round(seeds["steps_per_second"].mean()))


def in_bins(curves, y, count=60):
    """Means of `y` in bins of steps, per seed: not all seeds have rows at the same steps."""
    width = curves.groupby("env_id")["env_step"].transform("max") / count
    curves = curves.assign(env_step=np.ceil(curves["env_step"] / width) * width)
    keys = ["env_id", "flags", "seed", "env_step"]
    return curves.groupby(keys, sort=False)[y].mean().reset_index()


def plot(evals, path, published):
    """A panel per environment: mean, lowest and highest over seeds, and what was published."""
    hue = "flags" if evals["flags"].nunique() > 1 else None
    grid = sns.relplot(in_bins(evals, "return_mean"), x="env_step", y="return_mean", hue=hue,
                       col="env_id", col_wrap=min(5, evals["env_id"].nunique()), height=2.6,
                       kind="line", errorbar=("pi", 100), aspect=0.9,
                       facet_kws={"sharex": False, "sharey": False})
    grid.set_titles("{col_name}").set_axis_labels("environment steps", "evaluation return (raw)")
    for env_id, axis in grid.axes_dict.items():
        axis.locator_params(axis="x", nbins=4)  # else the labels of small panels overlap
        axis.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:g}k")
        if env_id in published:
            axis.axhline(published[env_id], color="grey", linestyle="--", linewidth=1)
    seeds = evals["seed"].nunique()
    levels = "; dashed: the highest published mean" if published else ""
    grid.figure.suptitle(f"mean, lowest and highest of {seeds} seeds{levels}", y=1.02)
    grid.savefig(path, dpi=100)


def train_or_load(args):
    """The runs of a study, as tables (see collect); prints and saves its results."""
    env_ids, seeds = args.env_id or list(STEPS[args.script]), args.seed or SEEDS[args.script]
    usual = DEFAULTS[args.script]["total_steps"]
    totals = args.total_steps or [STEPS[args.script].get(x, usual) for x in env_ids]
    if len(totals) != len(env_ids):
        sys.exit(f"error: argument --total-steps: got {totals}, takes one for each --env-id")
    path = SCRIPTS[args.script].__file__
    folders = args.runs or [
        run_script(path, "--env-id", env_id, "--seed", *seeds, "--total-steps", steps, *flags,
                   "--out-dir", args.out_dir, *args.extra)
        for env_id, steps in zip(env_ids, totals) for flags in args.compare]
    data, evals, episodes = collect(args.script, folders)
    data.drop(columns="folder").to_csv(args.out_dir / f"{args.study}.csv", index=False)
    print_table(["environment", "steps", "mean ± std over seeds", "every seed",
                 "training, last 100 episodes", "minutes per seed", "steps/s"], summarise(data))
    print("", *folders, sep="\n")
    return data, evals, episodes


def random_return(env_id, num_episodes=20):
    """Mean return of actions that are drawn evenly from all that there are."""
    env = gym.wrappers.RecordEpisodeStatistics(gym.make(env_id))
    env.action_space.seed(1)
    for episode in range(num_episodes):
        env.reset(seed=episode)
        done = False
        while not done:
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            done = terminated or truncated
    return np.mean(env.return_queue)


def interquartile_mean(scores):
    """The mean of the middle half: no single outlier moves it far (Agarwal et al. 2021)."""
    quarter = len(scores) // 4
    return np.sort(scores)[quarter:len(scores) - quarter].mean()


def compare_with_published(data, path):
    """Scores: 0 is random actions, 1 what was published; their interquartile mean over all runs."""
    data = data[data["env_id"].isin(PUBLISHED) & data["flags"].eq("")
                & data["total_steps"].eq(1_000_000)]
    if data.empty:
        return
    seeds = data.groupby("env_id", sort=False)["eval_return_mean"]
    table = pd.DataFrame({"random": {x: random_return(x) for x in seeds.groups}})
    table["published"], table["ours"] = pd.Series(PUBLISHED), seeds.mean()
    low, high = data["env_id"].map(table["random"]), data["env_id"].map(table["published"])
    scores = data.assign(score=(data["eval_return_mean"] - low) / (high - low)).groupby("env_id")
    table["score"] = scores["score"].mean()
    table.to_csv(path, index_label="env_id")
    print_table(["environment", "random actions", "published", "ours", "score"],
                [[name, *(f"{x:.4g}" for x in row)] for name, *row in table.itertuples()])
    runs, random = [x.to_numpy() for _, x in scores["score"]], np.random.default_rng(1)
    again = [interquartile_mean(np.concatenate([random.choice(x, len(x)) for x in runs]))
             for _ in range(5000)]
    low, high = np.quantile(again, (0.025, 0.975))
    print(f"\nInterquartile mean of all scores: {interquartile_mean(np.concatenate(runs)):.2f}, "
          f"95% interval {low:.2f} to {high:.2f} (bootstrap over the seeds of each environment)")


def returns(args):
    data, evals, _ = train_or_load(args)
    if args.script == PPO:
        compare_with_published(data, args.out_dir / "scores.csv")
    if args.plot:
        plot(evals, args.out_dir / f"{args.study}.png", PUBLISHED if args.script == PPO else {})
    print_versions(data)


# --- Gallery --------------------------------------------------------------------------------------


def film(script, checkpoint, path, seconds=8, fps=12.5, size=(240, 160)):
    """A GIF of an agent's first episode, or of its beginning, around what moves in it."""
    module, saved = SCRIPTS[script], torch.load(checkpoint, weights_only=True)
    args = argparse.Namespace(**saved["args"])
    camera = module.make_envs(args.env_id, 1, "NextStep", render_mode="rgb_array_list")
    agent = module.Agent(camera.single_observation_space, camera.single_action_space, args)
    agent.load_state_dict(saved["agent"])
    module.evaluate(agent, camera, args.seed[0])
    pictures, every = camera.render()[0], camera.metadata["render_fps"] / fps
    count = min(int(seconds * fps), int(len(pictures) / every))
    pictures = [pictures[int(i * every)] for i in range(count)]
    moves = np.ptp(pictures, axis=0).max(-1) > 30
    (top, left), (bottom, right) = np.argwhere(moves).min(0), np.argwhere(moves).max(0)
    height = min(1.5 * max(bottom - top, (right - left) / 1.5), len(moves), moves.shape[1] / 1.5)
    x = np.clip((left + right) / 2, 0.75 * height, moves.shape[1] - 0.75 * height)
    y = np.clip((top + bottom) / 2, height / 2, len(moves) - height / 2)
    box = x - 0.75 * height, y - height / 2, x + 0.75 * height, y + height / 2
    frames = [Image.fromarray(picture).resize(size, box=box).quantize(64, dither=0)
              for picture in pictures]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=1000 / fps, loop=0)


def draw_curve(evals, env_id, path):
    """Evaluation returns of all seeds, small enough to stand below a GIF."""
    figure = Figure(figsize=(4, 2.8), layout="constrained")
    axis = figure.add_subplot()
    sns.lineplot(in_bins(evals, "return_mean", count=20), x="env_step", y="return_mean",
                 errorbar=("pi", 100), ax=axis)
    threshold = gym.spec(env_id).reward_threshold
    axis.axhline(threshold, color="grey", linestyle="--", linewidth=1)
    axis.text(0, threshold, f"solved: {threshold:g}", va="bottom", fontsize=8)
    axis.set(xlabel="environment steps", ylabel="evaluation return",
             title=f"mean, lowest and highest of {evals['seed'].nunique()} seeds")
    axis.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:g}k")
    figure.savefig(path, dpi=100)


def gallery(args):
    """A GIF and a learning curve for the finished run of each script."""
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "egl")  # which needs no display
    for folder in args.runs:
        config = json.loads((folder / "args.json").read_text())
        script, seeds = Path(config["command"][0]).stem, config["seed"]
        _, evals, _ = collect(script, [folder])
        film(script, folder / f"seed-{seeds[0]}/checkpoint.pt", args.out_dir / f"{script}.gif")
        draw_curve(evals, config["env_id"], args.out_dir / f"{script}.png")


# --- Baselines ------------------------------------------------------------------------------------


BASELINES = "none", "mean", "value"


def halfway_agent(threshold):
    """REINFORCE's agent when its last 20 training returns average `threshold`."""
    args, returns = reinforce.parse_args(["--baseline", "mean"]), []
    agent, updates = begin(reinforce, args, seed=1)
    for _, episodes, _ in updates:
        returns += [row["return"] for row in episodes]
        if returns and np.mean(returns[-20:]) >= threshold:
            return args, agent
    sys.exit(f"error: argument --halfway: no 20 episodes average {threshold:g}")


def fit_critic(agent, batches, steps=300):
    """The same agent with a V that is fitted to `batches`."""
    args = reinforce.parse_args(["--baseline", "value"])
    env = gym.make(args.env_id)
    fitted = reinforce.Agent(env.observation_space, env.action_space, args)
    fitted.load_state_dict(agent.state_dict(), strict=False)
    obs = torch.cat([batch.obs for batch in batches])
    returns = torch.cat([batch.returns for batch in batches])
    optimizer = torch.optim.Adam(fitted.critic.parameters(), 1e-2)
    for _ in range(steps):
        optimizer.zero_grad()
        (((fitted.value(obs) - returns) ** 2).mean() / 2).backward()
        optimizer.step()
    return fitted


def policy_gradients(agent, batch):
    """The estimates of one batch, (3, number of parameters); all three in units of a return."""
    values, returns = agent.value(batch.obs), batch.returns
    log_probs = agent.policy(batch.obs).log_prob(batch.actions)
    rows = []
    for baseline in BASELINES:
        advantages = reinforce.compute_advantages(returns, values, baseline)
        loss = reinforce.policy_loss(log_probs, advantages)
        gradient = torch.autograd.grad(loss, list(agent.actor.parameters()), retain_graph=True)
        rows.append(torch.nn.utils.parameters_to_vector(gradient))
    return torch.stack(rows)


def measure_variance(num_batches, threshold):
    """The gradient estimates of one policy, from many batches: a row for each baseline."""
    args, agent = halfway_agent(threshold)
    envs = make_envs(reinforce, args)
    envs.reset(seed=reinforce.make_seeds(1, stream=1000, count=1))  # not an episode of training
    torch.manual_seed(1)
    batches = [reinforce.rollout(envs, agent, args, 0)[0] for _ in range(num_batches + 50)]
    agent = fit_critic(agent, batches[num_batches:])  # V gets episodes of its own
    batches = batches[:num_batches]
    length = sum(len(batch.obs) for batch in batches) / num_batches / args.batch_episodes
    print(f"\nOne policy, --baseline mean, seed 1, stopped when 20 training returns averaged "
          f"{threshold:g}; its episodes have\n{length:.0f} steps. {num_batches} batches of "
          f"{args.batch_episodes}; V was fitted to 50 others of the same policy.")
    gradients = torch.stack([policy_gradients(agent, batch) for batch in batches], 1).double()
    means, variance = gradients.mean(1), gradients.var(1).sum(-1)  # the trace of the covariance
    paired = gradients - gradients[0]
    noise = (paired.var(1).sum(-1) / num_batches).sqrt()  # to expect of paired.mean(1) if E = 0
    return pd.DataFrame({
        "baseline": BASELINES, "variance": variance, "relative": variance / variance[0],
        "length": means.norm(dim=1), "apart": paired.mean(1).norm(dim=1), "noise": noise})


def baselines(args):
    data, _, episodes = train_or_load(args)
    episodes = episodes[episodes["env_step"] <= data["env_steps"].min()]  # no seed goes on alone
    table = measure_variance(args.batches, args.halfway)
    table.to_csv(args.out_dir / "variance.csv", index=False)
    print_table(["baseline", "total variance of the gradient", "relative to none",
                 "length of the mean gradient", "its distance from none's", "by chance alone"],
                [[name, *(f"{x:.3g}" for x in row)] for name, *row in table.to_numpy()])
    episodes["baseline"] = episodes["flags"].str.extract(r"--baseline (\w+)", expand=False)
    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    colours = dict(zip(BASELINES, sns.color_palette("colorblind")))
    curves = in_bins(episodes.assign(flags=episodes["baseline"].fillna("value")), "return")
    style = {"x": "env_step", "y": "return", "hue": "flags", "palette": colours, "ax": left}
    sns.lineplot(curves, **style, units="seed", estimator=None, linewidth=0.6, legend=False)
    sns.lineplot(curves, **style, hue_order=BASELINES, errorbar=None, linewidth=3)
    left.legend(title="--baseline")
    left.set(xlabel="environment steps", ylabel="training return (raw)",
             title=f"{data['seed'].nunique()} seeds, and their mean (thick)")
    sns.barplot(table, x="baseline", y="relative", hue="baseline", palette=colours, ax=right)
    for bars in right.containers:
        right.bar_label(bars, fmt="%.3g")
    right.margins(y=0.1)
    right.set(xlabel="--baseline", ylabel="total variance, relative to none",
              title=f"noise of the gradient, one policy, {args.batches} batches")
    figure.savefig(args.out_dir / "baselines.png", dpi=100)
    print_versions(data)


# --- Ablation -------------------------------------------------------------------------------------


# What each variant of PPO changes: flags, or pieces of its text: {old: new}.
ABLATIONS = {
    "defaults": [],
    "advantages anew in each epoch": {
        "    for _ in range(args.epochs):\n": """\
    for _ in range(args.epochs):
        with torch.no_grad():
            columns = (batch.rewards, agent.value(batch.obs), agent.value(batch.next_obs),
                       batch.terminated, batch.done)
            columns = [x.reshape(-1, args.num_envs) for x in columns]
            batch.advantages = compute_gae(*columns, args.gamma, args.gae_lambda).flatten()
            batch.targets = batch.advantages + agent.value(batch.obs)
"""},
    "no KL limit": ["--max-kl", "1e9"],
    "ratio not clipped": ["--clip-eps", "1e9"],
    "neither KL limit nor clip": ["--max-kl", "1e9", "--clip-eps", "1e9"],
    "gradient not clipped": ["--max-grad-norm", "1e9"],
    "advantages not standardised": {
        "            A = (A - A.mean()) / (A.std(correction=0) + 1e-8)\n": ""},
    "observations not normalised": {
        "agent.obs_stats.update(batch.obs)": "pass"},
    "rewards not scaled": {
        "return rewards / return_stats.var.sqrt(), past_return": "return rewards, past_return"},
    "learning rate constant": {"remaining = 1 - env_step / args.total_steps": "remaining = 1"},
    "last layer not small": {"output_gain=0.01)": "output_gain=1.0)"},
    "weights not orthogonal": {
        "nn.init.orthogonal_(layer.weight, gain)":
            "nn.init.normal_(layer.weight, std=gain / layer.in_features**0.5)"},
    "σ learns as fast as μ": ["--std-learning-rate", "1e-3"],
    "σ = 1 at first": ["--log-std", "0"],
    "actions clipped, no tanh": {"np.tanh(actions)": "actions.clip(-1, 1)"},
    "time limits treated as deaths": {'"terminated": terminated': '"terminated": done'},
    "value loss clipped, too": {
        "    for _ in range(args.epochs):\n": """\
    old_values = agent.value(batch.obs).detach()
    for _ in range(args.epochs):
""",
        "((agent.value(batch.obs[rows]) - batch.targets[rows]) ** 2).mean() / 2\n": """\
0.0
            new, old, R = agent.value(batch.obs[rows]), old_values[rows], batch.targets[rows]
            near = old + (new - old).clamp(-args.clip_eps, args.clip_eps)
            loss_v = torch.max((new - R) ** 2, (near - R) ** 2).mean() / 2
"""},
}


def write_variant(change, folder, script=PPO):
    """The script in a folder of its own, changed; returns its path and its flags."""
    path = folder / f"{script}.py"
    text = Path(SCRIPTS[script].__file__).read_text(encoding="utf-8")
    edits = change if isinstance(change, dict) else {}
    for old, new in edits.items():
        if text.count(old) != 1:
            sys.exit(f"error: not once in {script}.py: {old}")
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    if path.exists() and path.read_text(encoding="utf-8") != text:
        sys.exit(f"error: {folder} holds runs of another version of {script}.py")
    path.write_text(text, encoding="utf-8")
    return path, [] if edits else change


def finished_run(home, env_id, seed, steps):
    """The folder of a run of `steps` steps that an earlier call brought to its end, or None."""
    for file in home.glob(f"{env_id}__*/seed-{seed}/evals.csv"):
        config = json.loads((file.parent.parent / "args.json").read_text(encoding="utf-8"))
        if config["total_steps"] == steps <= pd.read_csv(file)["env_step"].iloc[-1]:
            return file.parent.parent
    return None


def train_variant(home, path, flags, env_id, seed, steps):
    """The last evaluation of one run."""
    folder = finished_run(home, env_id, seed, steps) or run_script(
        path, "--env-id", env_id, "--seed", seed, "--total-steps", steps, "--num-evals", 4,
        "--eval-episodes", 20, "--out-dir", home, *flags)
    return pd.read_csv(folder / f"seed-{seed}/evals.csv")["return_mean"].iloc[-1]


def difference(returns, usual):
    """Difference of two groups' means, its standard error, half its 95% interval (Welch)."""
    errors = [x.var() / len(x) for x in (returns, usual)]
    degrees = sum(errors) ** 2 / sum(e**2 / (len(x) - 1) for e, x in zip(errors, (returns, usual)))
    draws = np.abs(np.random.default_rng(1).standard_t(degrees, 200_000))
    error = math.sqrt(sum(errors))
    return returns.mean() - usual.mean(), error, np.quantile(draws, 0.95) * error


def ablation(args):
    """PPO without one of its details at a time: what it loses, or gains."""
    names = args.only or list(ABLATIONS)
    home = {name: args.out_dir / re.sub(r"\W+", "-", name) for name in ABLATIONS}
    variants = {name: write_variant(ABLATIONS[name], home[name]) for name in ABLATIONS}
    jobs = [(name, env_id, seed) for seed in args.seed for name in names for env_id in args.env_id]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # a process each
        runs = [pool.submit(train_variant, home[name], *variants[name], env_id, seed,
                            args.total_steps) for name, env_id, seed in jobs]
        data = pd.DataFrame(jobs, columns=["variant", "env_id", "seed"])
        data["return_mean"] = [run.result() for run in runs]
    data.to_csv(args.out_dir / "ablation.csv", index=False)
    table = ablation_table(data)
    for env_id, x in table.groupby("environment", sort=False):
        print_table([f"{env_id}, {args.total_steps:,} steps", "mean ± std", "difference, 95%",
                     "every seed"],
                    [[row.variant, f"{row.mean:.0f} ± {row.std:.0f}",
                      f"{row.difference:+.0f} ± {row.margin:.0f}", row.seeds]
                     for row in x.itertuples()])
    draw_ablation(table, args)
    print_machine(json.dumps(installed()))


def ablation_table(data):
    """For each environment and variant: its returns, and how they differ from the defaults."""
    rows = []
    for (env_id, name), runs in data.groupby(["env_id", "variant"], sort=False)["return_mean"]:
        usual = data[data["env_id"].eq(env_id) & data["variant"].eq("defaults")]["return_mean"]
        gap, _, margin = difference(runs, usual) if name != "defaults" else (0.0, 0.0, 0.0)
        rows.append({"environment": env_id, "variant": name, "mean": runs.mean(),
                     "std": runs.std(), "difference": gap, "margin": margin,
                     "seeds": ", ".join(f"{x:.0f}" for x in runs)})
    return pd.DataFrame(rows)


def draw_ablation(table, args):
    """A dot and a 95% interval for each variant; the dot is filled if the interval is without 0."""
    table = table[table["variant"] != "defaults"]
    names = list(dict.fromkeys(table["variant"]))
    figure = Figure(figsize=(11, 0.3 * len(names) + 1.4), layout="constrained")
    panels = figure.subplots(1, table["environment"].nunique(), sharey=True, squeeze=False)[0]
    for axis, (env_id, x) in zip(panels, table.groupby("environment", sort=False)):
        places = [-names.index(name) for name in x["variant"]]
        for place, gap, margin in zip(places, x["difference"], x["margin"]):
            axis.errorbar(gap, place, xerr=margin, fmt="o", capsize=3, color="C0",
                          markerfacecolor="C0" if abs(gap) > margin else "white")
        axis.axvline(0, color="grey", linewidth=0.8)
        axis.set(title=env_id, xlabel="return minus that of the defaults",
                 yticks=[-i for i in range(len(names))], yticklabels=names)
    figure.suptitle(f"PPO with one detail changed: {len(args.seed)} seeds, "
                    f"{args.total_steps:,} steps, 95% intervals (filled: without 0)")
    figure.savefig(args.out_dir / "ablation.png", dpi=100)


# --- Exercises ------------------------------------------------------------------------------------


# What the README's exercises change: as ABLATIONS, in a script's default task.
EXERCISES = {
    "no baseline": (REINFORCE, ["--baseline", "none"]),
    "a short sight": (REINFORCE, ["--gamma", "0.9"]),
    "one environment": (A2C, ["--num-envs", "1", "--rollout-steps", "512"]),
    "λ = 0": (A2C, ["--gae-lambda", "0"]),
    "λ = 1": (A2C, ["--gae-lambda", "1"]),
    "no entropy bonus": (A2C, ["--entropy-coef", "0"]),
    "neither clip nor KL limit": (PPO, ["--clip-eps", "1e9", "--max-kl", "1e9"]),
    "one epoch": (PPO, ["--epochs", "1"]),
    "time limits are deaths": (PPO, {'"terminated": terminated': '"terminated": done'}),
    "states not normalised": (PPO, {"agent.obs_stats.update(batch.obs)": "pass"}),
    "σ stays as it is": (PPO, {
        "args.log_std))  #": "args.log_std), requires_grad=False)  #"}),
    "another reward": (PPO, {
        "        done = terminated | truncated\n":
            "        done = terminated | truncated\n        rewards = np.ones_like(rewards)\n"}),
}


def exercises(args):
    """The answers to the README's exercises: every seed of every change."""
    home = {name: args.out_dir / re.sub(r"\W+", "-", name) for name in EXERCISES}
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # a process each
        runs = {name: [] for name in EXERCISES}
        for name, (script, change) in EXERCISES.items():
            variant = write_variant(change, home[name], script)
            task = DEFAULTS[script]["env_id"], DEFAULTS[script]["total_steps"]
            for seed in SEEDS[script][:5]:
                runs[name].append(
                    pool.submit(train_variant, home[name], *variant, task[0], seed, task[1]))
        data = pd.DataFrame({name: [run.result() for run in jobs] for name, jobs in runs.items()})
    data.to_csv(args.out_dir / "exercises.csv", index=False)
    print_table(["exercise", "script", "returns of five seeds"],
                [[name, EXERCISES[name][0], ", ".join(f"{x:.0f}" for x in data[name])]
                 for name in data])
    print_machine(json.dumps(installed()))


# --- Race -----------------------------------------------------------------------------------------


class Track:
    """Evaluations of one training at even steps, against its seconds; their own do not count."""

    def __init__(self, env_id, steps, seed):
        self.envs = ppo.make_envs(env_id, 5, "NextStep")
        self.pause, self.seed = steps / 50, seed
        self.seconds, self.start, self.rows = 0.0, time.perf_counter(), []

    def visit(self, env_step, agent):
        if env_step >= len(self.rows) * self.pause:
            self.seconds += time.perf_counter() - self.start
            result = ppo.evaluate(agent, self.envs, self.seed)
            self.rows.append({"env_step": env_step, "minutes": self.seconds / 60,
                              "return": result["return_mean"]})
            self.start = time.perf_counter()


def our_race(script, env_id, steps, seed, _):
    module = SCRIPTS[script]
    args = module.parse_args(["--env-id", env_id, "--total-steps", str(steps)])
    track = Track(env_id, steps, seed)
    agent, updates = begin(module, args, seed)
    for env_step, *_ in updates:
        track.visit(env_step, agent)
    return track.rows


def sb3_race(script, env_id, steps, seed, num_envs):
    """The peer: its defaults for PPO, its zoo's settings for A2C on LunarLander."""
    import stable_baselines3 as sb3  # optional
    from stable_baselines3.common import env_util, vec_env

    torch.set_num_threads(1)  # as ours
    envs = env_util.make_vec_env(env_id, num_envs, seed, env_kwargs={"render_mode": None})
    if script == PPO:
        envs = vec_env.VecNormalize(envs)
        model = sb3.PPO("MlpPolicy", envs, seed=seed, device="cpu")
    else:
        model = sb3.A2C("MlpPolicy", envs, gamma=0.995, n_steps=5, ent_coef=1e-5, seed=seed,
                        learning_rate=lambda left: 8.3e-4 * left, device="cpu")

    class Peer:
        """Looks like our agent."""

        def act(self, obs, deterministic):
            seen = envs.normalize_obs(obs) if script == PPO else obs
            return None, model.predict(seen, deterministic=deterministic)[0]

    def after_step(*_):
        track.visit(model.num_timesteps, Peer())
        return True

    track = Track(env_id, steps, seed)
    model.learn(steps, callback=after_step)
    track.visit(math.inf, Peer())  # after the last update
    track.rows[-1]["env_step"] = model.num_timesteps
    return track.rows


def race_in_turns(script, env_id, steps, seed, out_dir):
    """All learners after one another, a process each; what an earlier call has run is read."""
    learners = {"ours": (our_race, None)}
    for count in (1, 8) if script == PPO else (8,):
        learners[f"stable-baselines3, environments: {count}"] = sb3_race, count
    tables = []
    for name, (function, count) in learners.items():
        path = out_dir / f"race__{script}__{env_id}__{steps}__seed-{seed}__{count or 'ours'}.csv"
        if not path.exists():
            rows = fresh(function, script, env_id, steps, seed, count)
            pd.DataFrame(rows).to_csv(path, index=False)
        tables.append(pd.read_csv(path).assign(learner=name, env_id=env_id, seed=seed))
    return pd.concat(tables)


def race_rows(data):
    """For each learner: final returns, minutes, when ours had their mean, how many times sooner."""
    rows = []
    for env_id, runs in data.groupby("env_id", sort=False):
        ours = runs[runs["learner"] == "ours"]
        for learner, x in runs.groupby("learner", sort=False):
            last = x.groupby("seed")[["minutes", "return"]].last()
            goal = last["return"].mean()
            passed = ours[ours["return"] >= goal].groupby("seed")["minutes"].first()
            passed = passed.reindex(last.index, fill_value=math.inf)
            ratio = last["minutes"].mean() / passed.median()
            rows.append([env_id, learner, ", ".join(f"{x:.0f}" for x in last["return"]),
                         f"{last['minutes'].mean():.1f}", *(["–"] * 2 if learner == "ours" else [
                             ", ".join(f"{x:.2f}" if x < math.inf else "never" for x in passed),
                             f"{ratio:.0f}" if ratio else "–"])])
    return rows


def race(args):
    """Return against minutes, ours and stable-baselines3's."""
    usual = ["HalfCheetah-v5", "Hopper-v5", "Walker2d-v5"]
    env_ids = args.env_id or (usual if args.script == PPO else [DEFAULTS[A2C]["env_id"]])
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [
            pool.submit(race_in_turns, args.script, env_id, args.total_steps, seed, args.out_dir)
            for seed in args.seed for env_id in env_ids]
        data = pd.concat([job.result() for job in jobs], ignore_index=True)
    data.to_csv(args.out_dir / "race.csv", index=False)
    print_table(["environment", "learner", "final return, every seed", "minutes",
                 "minutes until ours reaches the mean of these returns", "ratio"], race_rows(data))
    grid = sns.relplot(data, x="minutes", y="return", hue="learner", col="env_id", units="seed",
                       estimator=None, kind="line", height=3.2, facet_kws={"sharey": False},
                       aspect=1 if len(env_ids) > 1 else 2)
    grid.set_titles("{col_name}").set_axis_labels("minutes of training", "evaluation return (raw)")
    if args.script == A2C:
        grid.set(ylim=(-600, 300))  # landers that have learned nothing yet may go lower
    grid.savefig(args.out_dir / "race.png", dpi=100)
    print_machine(json.dumps(installed()))


# --- Robustness -----------------------------------------------------------------------------------


GRID = pd.MultiIndex.from_product(
    [(-2.0, -4.0, -6.0, -8.0, -10.0, -11.9), (0.0, 5.0, 10.0, 15.0, 20.0)],
    names=["gravity", "wind_power"])
GRID_SEED = 10**9  # the same episodes for all agents; none was trained with it


def play_grid(checkpoint, num_episodes):
    """`num_episodes` deterministic episodes in each world of the grid: a row for each world."""
    torch.set_num_threads(1)
    saved = torch.load(checkpoint, weights_only=True)
    args = argparse.Namespace(**saved["args"])
    env = gym.make(args.env_id)
    agent = a2c.Agent(env.observation_space, env.action_space, args)
    agent.load_state_dict(saved["agent"])
    results = []
    for i, (gravity, wind) in enumerate(GRID):
        envs = a2c.make_envs(args.env_id, num_episodes, "NextStep", gravity=gravity,
                             enable_wind=wind > 0, wind_power=wind)
        results.append(a2c.evaluate(agent, envs, GRID_SEED + i))
    cells = pd.DataFrame(results)
    return GRID.to_frame(index=False).assign(
        checkpoint=str(checkpoint), trained="--randomize" if args.randomize else "default",
        seed=args.seed[0], return_mean=cells["return_mean"], return_std=cells["return_std"])


def robustness(args):
    """Trained agents in worlds that differ from the one they were trained in."""
    for path in args.checkpoints:
        if "randomize" not in torch.load(path, weights_only=True)["args"]:
            sys.exit(f"error: {path} is not a checkpoint of {A2C}.py")
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        counts = [args.episodes] * len(args.checkpoints)
        data = pd.concat(pool.map(play_grid, args.checkpoints, counts), ignore_index=True)
    data.to_csv(args.out_dir / "robustness.csv", index=False)
    maps = {trained: x.pivot_table(index="gravity", columns="wind_power", values="return_mean")
            for trained, x in data.groupby("trained", sort=False)}  # means over agents
    for trained, cells in maps.items():
        print_table([f"trained: {trained}, gravity", *(f"wind {x:g}" for x in cells)],
                    [[row, *map(round, values)] for row, values in zip(cells.index, cells.values)])
    outer = [data[x].isin((data[x].min(), data[x].max())) for x in ("gravity", "wind_power")]
    usual = data["gravity"].eq(-10) & data["wind_power"].eq(0)
    regions = {"all worlds": usual | True, "outermost worlds": outer[0] | outer[1],
               "usual world": usual}
    agents = pd.DataFrame({
        region: data[inside].groupby(["trained", "checkpoint"], sort=False)["return_mean"].mean()
        for region, inside in regions.items()})
    rows = [[trained, region, f"{x.mean():.1f} ± {x.std():.1f}", ", ".join(f"{y:.1f}" for y in x)]
            for trained, group in agents.groupby("trained", sort=False)
            for region, x in group.items()]
    print_table(["trained", "where", "mean ± std over agents", "every agent"], rows)
    if len(maps) == 2:
        print()
        for region, x in agents.items():
            gap, error, margin = difference(x["--randomize"], x["default"])
            print(f"{region}: --randomize is {gap:+.1f} ± {margin:.1f} (95%) better, "
                  f"{gap / error:+.1f} standard errors")
    draw_maps(maps, args, data.groupby("trained")["checkpoint"].nunique())
    print_machine(json.dumps(installed()))


def draw_maps(maps, args, agents):
    """A map of mean returns for each kind of training, and one of their difference."""
    figure = Figure(figsize=(16, 4.4), layout="constrained")
    axes = figure.subplots(1, len(maps) + (len(maps) == 2), squeeze=False)[0]
    scale = {"vmin": min(x.min().min() for x in maps.values()),
             "vmax": max(x.max().max() for x in maps.values())}
    for axis, (trained, cells) in zip(axes, maps.items()):
        sns.heatmap(cells, annot=True, fmt=".0f", cmap="viridis", ax=axis, **scale,
                    cbar_kws={"label": "mean return (raw)"})
        axis.set(title=f"trained: {trained} ({agents[trained]} agents)")
    if len(maps) == 2:
        sns.heatmap(maps["--randomize"] - maps["default"], annot=True, fmt="+.0f", cmap="vlag",
                    center=0, ax=axes[-1], cbar_kws={"label": "difference (raw)"})
        axes[-1].set(title="--randomize minus default")
    for axis in axes:
        axis.set(xlabel="wind power (0: no wind)", ylabel="gravity")
    figure.suptitle(f"{args.episodes} deterministic episodes of each agent in each world")
    figure.savefig(args.out_dir / "robustness.png", dpi=100)


# --- main -----------------------------------------------------------------------------------------


def make_parser():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    studies = parser.add_subparsers(dest="study", required=True)

    def add_study(name, function, text, **defaults):
        study = studies.add_parser(name, help=text, description=text)
        add = study.add_argument
        add("--out-dir", type=Path, default="runs/benchmark", help="for tables, pictures and runs")
        if name in ("speed", "returns", "race"):
            add("--script", choices=SCRIPTS, default=PPO)
        study.set_defaults(function=function, **defaults)
        return add

    add = add_study("speed", speed, "ours, that of stable-baselines3 and of random actions")
    add("--env-id", help="default: HalfCheetah-v5 for PPO, else the script's own")
    add("--steps", type=int, default=100_000, help="at least, in every measurement")
    add("--pairs", type=int, default=5, help="measurements of each, in turns")

    baseline = [["--baseline", x] for x in BASELINES]
    for add in (
        add_study("returns", returns, "after training; for PPO on its table of environments",
                  compare=[[]]),
        add_study("baselines", baselines, "REINFORCE: returns and noise of each --baseline",
                  script=REINFORCE, compare=baseline),
    ):
        add("--env-id", nargs="+")
        add("--seed", type=int, nargs="+", help="default: 1 to 5, A2C 1 to 10, REINFORCE 1 2 3 5 8")
        add("--total-steps", type=int, nargs="+", help="one for each --env-id")
        add("--runs", type=Path, nargs="+", help="finished run folders: show these, train none")
        add("--plot", action="store_true", help="draw learning curves")
        add("--extra", nargs=argparse.REMAINDER, default=[], help="all after it: to the script")
    # of baselines, the last of them
    add("--batches", type=int, default=500, help="of which the noise is measured")
    add("--halfway", type=float, default=100, help="return of the policy that it is measured for")

    add = add_study("gallery", gallery, "a GIF and a learning curve of finished runs")
    add("--runs", type=Path, nargs="+", required=True, help="one run folder for each script")

    add = add_study("ablation", ablation, "PPO with one detail changed at a time")
    add("--only", nargs="+", choices=ABLATIONS, metavar="VARIANT", help="default: all")
    add("--env-id", nargs="+", default=["HalfCheetah-v5", "Hopper-v5"])
    add("--seed", type=int, nargs="+", default=SEEDS[PPO])
    add("--total-steps", type=int, default=500_000, help="what is finished is not trained again")

    add_study("exercises", exercises, "the answers to the exercises of the README")

    add = add_study("race", race, "return against minutes, ours and that of stable-baselines3")
    add("--env-id", nargs="+", help="default: three for PPO, else the script's own")
    add("--seed", type=int, nargs="+", default=[1, 2, 3])
    add("--total-steps", type=int, default=1_000_000)

    add = add_study("processes", processes, "PPO: speed of one process and of two, together.py")
    add("--env-id", nargs="+", default=["Humanoid-v5", "HalfCheetah-v5"])
    add("--num-envs", type=int, default=16, help="in all")
    add("--steps", type=int, default=40_960, help="at least, in every measurement")
    add("--pairs", type=int, default=5, help="measurements of each, in turns")

    add = add_study("scaling", scaling, "A2C: speed against the number of environments")
    add("--num-envs", type=int, nargs="+", default=[1, 2, 4, 8, 16, 32], help="the first: its base")
    add("--steps", type=int, default=20_480, help="at least, in every measurement")
    add("--repeats", type=int, default=3, help="measurements of each, in turns; the median counts")

    add = add_study("robustness", robustness, "A2C: trained agents in other gravity and wind")
    add("checkpoints", type=Path, nargs="+", metavar="CHECKPOINT")
    add("--episodes", type=int, default=20, help="in every cell of the grid")

    return parser


def parse_args(argv=None):
    return make_parser().parse_args(argv)


def main():
    args = parse_args()
    args.out_dir.mkdir(parents=True, exist_ok=True)
    sns.set_theme(style="whitegrid", palette="colorblind", font_scale=0.8)
    args.function(args)


if __name__ == "__main__":
    main()
