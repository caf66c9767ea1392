"""What all studies share: jobs and their rows in docs/data, tables, figures, statistics.

A study is a module with `jobs(quick)`, what is to be measured; `measure(job)`, the rows of one job;
and `report(data, draw)`, its tables as {name: Markdown}, its figures by `draw(figure, name)`.
"""

import ast
import hashlib
import importlib
import importlib.metadata
import json
import multiprocessing
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib.figure import Figure
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
DOCS, DATA, RUNS = ROOT / "docs", ROOT / "docs/data", ROOT / "runs/benchmark"
VARIANTS = Path(__file__).parent / "variants"
PPO, A2C, REINFORCE = "ppo_continuous", "a2c_vector", "reinforce_mujoco"
SEEDS = {PPO: [1, 2, 3, 4, 5], A2C: list(range(1, 11)), REINFORCE: [1, 2, 3, 4, 5]}
QUICK = {  # flags of the smallest training of each script
    PPO: "--num-envs 2 --rollout-steps 64 --total-steps 256 --num-evals 2 --eval-episodes 2",
    A2C: "--num-envs 2 --rollout-steps 64 --total-steps 256 --num-evals 2 --eval-episodes 2",
    REINFORCE: "--total-steps 128 --num-evals 2 --eval-episodes 2"}


@dataclass(frozen=True)
class Job:
    """One measurement: a script with a seed and flags, as typed, perhaps changed by a patch.

    `part` tells measurements apart that differ in something else.
    """

    script: str
    seed: int = 1
    flags: str = ""
    variant: str = ""
    part: str = ""


KEYS = [*Job.__dataclass_fields__, "digest"]


def training_jobs(script, quick, flags="", seeds=None, **others):
    """A job for each seed."""
    flags = f"{flags} {QUICK[script]}" if quick else flags
    seeds = [1, 2] if quick else seeds or SEEDS[script]
    return [Job(script, seed, flags.strip(), **others) for seed in seeds]


# --- Scripts --------------------------------------------------------------------------------------


@cache
def load(script):
    """The module of a script."""
    return importlib.import_module(script)


def defaults(script):
    return vars(load(script).parse_args([]))


def write_script(job, folder):
    """The script in a folder, with the patch of its variant; returns its path."""
    path = folder / f"{job.script}.py"
    shutil.copy(ROOT / path.name, path)
    if job.variant:
        # Git must not look for a repository above: in one it would leave out untracked files.
        subprocess.run(["git", "apply", VARIANTS / f"{job.variant}.patch"], cwd=folder, check=True,
                       env={**os.environ, "GIT_CEILING_DIRECTORIES": str(folder.resolve().parent)})
    return path


@cache
def digest(script, variant=""):
    """Of what Python executes: other comments, docstrings or help texts make no other digest."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_script(Job(script, variant=variant), Path(folder))
        tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        kinds = ast.Module, ast.ClassDef, ast.FunctionDef
        if isinstance(node, kinds) and ast.get_docstring(node) is not None:
            node.body = node.body[1:] or [ast.Pass()]
        if isinstance(node, ast.Call):
            node.keywords = [x for x in node.keywords if x.arg != "help"]
    # Only some versions of Python list empty fields.
    text = re.sub(r"\w+=(\[\]|Load\(\))|, ", "", ast.dump(tree))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def run_folder(job):
    """The finished run of a job, trained as a user would, if it has not been before."""
    name = "__".join((job.script, job.variant, job.flags, str(job.seed)))
    home = RUNS / digest(job.script, job.variant) / re.sub(r"[^\w.=-]+", "_", name)
    if done := list(home.glob("*/done")):
        return done[0].parent / f"seed-{job.seed}"
    shutil.rmtree(home, ignore_errors=True)  # one that was cut off
    home.mkdir(parents=True)
    command = [sys.executable, write_script(job, home), *job.flags.split(), "--seed", job.seed,
               "--out-dir", home]
    subprocess.run([*map(str, command)], check=True, capture_output=True, text=True,
                   env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)})
    (folder,) = home.glob("*/seed-*")
    (folder.parent / "done").touch()
    return folder


def train(job):
    """A row for each evaluation; `train_return` is the mean of the last 100 episodes."""
    folder = run_folder(job)
    rows = pd.read_csv(folder / "evals.csv")
    rows["train_return"] = np.nan
    if (folder / "episodes.csv").exists():
        episodes = pd.read_csv(folder / "episodes.csv")
        for i, step in enumerate(rows["env_step"]):
            last = episodes["return"][episodes["env_step"] <= step].tail(100)
            rows.loc[i, "train_return"] = last.mean()
    rows.insert(0, "env_id", json.loads((folder.parent / "args.json").read_text())["env_id"])
    return rows


def begin(script, args, seed):
    """Environments, the agent and the generator of a training: what `run` makes, without files."""
    import torch

    module = load(script)
    torch.set_num_threads(1)
    torch.manual_seed(module.make_seeds(seed, stream=0, count=1)[0])
    extra = ()
    if script == A2C:
        extra = args.vectorization, args.randomize
    envs = module.make_envs(args.env_id, getattr(args, "num_envs", 1), "Disabled", *extra)
    agent = module.Agent(envs.single_observation_space, envs.single_action_space, args)
    if script == REINFORCE:
        optimizer = torch.optim.Adam(agent.parameters(), fused=True)
        return envs, agent, module.train(args, seed, envs, agent, optimizer)
    return envs, agent, module.train(args, seed, envs, agent, module.make_optimizer(agent), 0)


# --- Rows -----------------------------------------------------------------------------------------


def machine():
    """What is the same for all rows that are measured now."""
    names = "torch", "gymnasium", "mujoco", "Box2D", "numpy", "stable-baselines3"
    found = {x.metadata["Name"].lower() for x in importlib.metadata.distributions()}
    versions = [f"{x} {importlib.metadata.version(x)}" for x in names if x.lower() in found]
    cpuinfo, model = Path("/proc/cpuinfo"), platform.processor() or platform.machine()
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []  # Linux says it there
    model = next((x.split(": ")[1] for x in lines if x.startswith("model name")), model)
    return f"{', '.join(versions)}; {model}, {os.cpu_count()} cores"


def read_rows(path):
    """The rows of a study, and the machines that they come from: the comments on top."""
    if not path.exists():
        return pd.DataFrame(columns=KEYS), []
    data = pd.read_csv(path, comment="#", keep_default_na=False, na_values=[""])
    text = data.columns.intersection(["flags", "variant", "part", "digest"])
    data[text] = data[text].astype(object).where(data[text].notna(), "")
    lines = path.read_text("utf-8").splitlines()
    return data, [line[2:] for line in lines if line.startswith("# ")]


def write_rows(path, data, machines):
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    comments = "".join(f"# {x}\n" for x in machines)
    new.write_text(comments + data.to_csv(index=False, float_format="%.8g"), encoding="utf-8")
    new.replace(path)


def key(job):
    return {**asdict(job), "digest": digest(job.script, job.variant)}


def is_row_of(data, job):
    """Of each row, whether it is of this job."""
    return np.logical_and.reduce([data[name] == x for name, x in asdict(job).items()])


def fresh(function, *args):
    """Call a function in a new process: it inherits neither threads nor caches nor timers."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *args).result()


def run(name, quick, folder):
    """Do the jobs that have no rows yet; rows of older texts of their scripts are dropped."""
    study, path = importlib.import_module(f"benchmark.{name}"), folder / f"{name}.csv"
    data, machines = read_rows(path)
    data = data[is_current(data)]
    machines = machines if len(data) else []
    jobs = [x for x in study.jobs(quick) if not is_row_of(data, x).any()]
    workers = 1 if getattr(study, "ALONE", False) else os.cpu_count()
    pool = ThreadPoolExecutor(workers)
    try:
        futures = {pool.submit(study.measure, job): job for job in jobs}
        steps = {job: load(job.script).parse_args(job.flags.split()).total_steps for job in jobs}
        bar = tqdm(desc=name, total=sum(steps.values()), unit=" steps", unit_scale=True)
        for future in as_completed(futures):
            job, rows = futures[future], pd.DataFrame(future.result())
            rows = rows.assign(**key(job))[[*KEYS, *rows]]
            data = pd.concat([data, rows] if len(data) else [rows])
            data = data.sort_values(KEYS, kind="stable", ignore_index=True)
            machines = sorted({*machines, machine()})
            write_rows(path, data, machines)
            bar.update(steps[job])
    finally:
        pool.shutdown(cancel_futures=True)


def is_current(data):
    """Of each row, whether it is of the text of its script that is here."""
    pairs = data[["script", "variant"]].drop_duplicates().itertuples(index=False)
    now = {tuple(x): digest(*x) for x in pairs if variant_exists(x.variant)}
    found = [now.get((x.script, x.variant)) == x.digest for x in data.itertuples()]
    return np.array(found, dtype=bool)


def variant_exists(variant):
    return not variant or (VARIANTS / f"{variant}.patch").exists()


# --- Tables, figures, statistics ------------------------------------------------------------------


def last_rows(data):
    """The last evaluation of each run."""
    return data.groupby([*KEYS, "env_id"], sort=False).last().reset_index()


def table(header, rows):
    """Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def number(x, digits=1):
    return f"{round(x, digits) + 0.0:,.{digits}f}".replace("-", "−")  # + 0.0: no "−0"


def spread(values, digits=1):
    """Mean ± standard deviation (n − 1), and every value."""
    every = ", ".join(number(x, digits) for x in values)
    return f"{number(np.mean(values), digits)} ± {number(np.std(values, ddof=1), digits)}", every


def difference(returns, usual):
    """Difference of two groups' means, and half its 95% interval (Welch)."""
    from scipy.stats import ttest_ind

    low, high = ttest_ind(returns, usual, equal_var=False).confidence_interval(0.95)
    return (low + high) / 2, (high - low) / 2


def gain(returns, usual):
    """Mean of what each seed gains, and half its 95% interval (paired t)."""
    from scipy.stats import ttest_rel

    low, high = ttest_rel(returns, usual).confidence_interval(0.95)
    return (low + high) / 2, (high - low) / 2


def style():
    sns.set_theme(style="whitegrid", palette="colorblind", font_scale=0.9,
                  rc={"savefig.dpi": 200, "axes.formatter.limits": (-6, 6)})


def steps_axis(axis):
    """1M, 500k."""
    axis.locator_params(axis="x", nbins=4)
    axis.xaxis.set_major_formatter(
        lambda x, _: f"{x / 1e6:g}M" if x >= 1e6 else f"{x / 1e3:g}k" if x else "0")
    axis.set_xlabel("environment steps")


def in_bins(data, y, by, count=20):
    """Means of `y` per seed at `count` even steps: each row counts for the nearest of these."""
    width = data.groupby(by)["env_step"].transform("max") / count
    data = data.assign(env_step=np.round(data["env_step"] / width) * width)
    by = [*np.atleast_1d(by), "seed", "env_step"]
    return data.groupby(by, sort=False)[y].mean().reset_index()


def figure(width, height):
    return Figure(figsize=(width, height), layout="constrained")
