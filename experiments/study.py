"""What the studies share: jobs and their rows in experiments/data; tables, statistics, figures.

A study has JOBS, what is to be measured, and `draw(rows)`, which returns {name: table}. A table
goes into each page that has the line `<!-- NAME -->`, in place of the table that stands below it.

    python experiments/STUDY.py                measures the jobs that have no rows yet, and draws
    python experiments/STUDY.py --only Hopper  measures only jobs with this word in their options
    python experiments/STUDY.py --quick        tries one tiny job, keeps nothing
"""

import argparse
import importlib.metadata
import multiprocessing
import os
import platform
import re
import subprocess
import sys
import tempfile
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd
import seaborn as sns
import variants
from matplotlib.figure import Figure
from scipy import optimize, stats
from tqdm import tqdm
from variants import A2C, PPO, REINFORCE, ROOT  # noqa: F401 (for the studies)

DATA = ROOT / "experiments/data"


class Job(NamedTuple):
    """One measurement, most often a training."""

    script: str
    options: str = ""  # as typed
    change: str = ""  # one of `variants`, or a peer's setting
    seed: int = 1


KEYS = list(Job._fields)


def load(job):
    """The script of a job, with its change, as a module; and its options."""
    module = ModuleType(job.script.removesuffix(".py"))
    module.__file__ = str(ROOT / job.script)
    exec(compile(variants.changed(job.script, job.change), job.script, "exec"), vars(module))
    module.tqdm = lambda **_: tqdm(disable=True)  # no bar
    return module, module.parse_args(f"{job.options} --seed {job.seed}".split())


def run(module, args):
    """Train one agent; returns its log and its weights."""
    with tempfile.TemporaryDirectory() as folder:
        module.train(0, args, Path(folder))
        path = f"{folder}/seed-{args.seed[0]}"
        saved = module.torch.load(f"{path}.pt", weights_only=True)
        return pd.read_csv(f"{path}.csv"), saved["agent"]


def train(job):
    """A row for each evaluation, and the weights; `sampled`: in training since the one before."""
    log, weights = run(*load(job))
    log = log.rename(columns={"env_step": "steps", "return": "sampled", "eval_return": "return"})
    period = log.groupby(log["return"].notna().shift(fill_value=False).cumsum())
    rows = period[["steps", "seconds", "return"]].last()
    return rows.join(period["sampled"].mean()), weights


def last_evaluation(job):
    return train(job)[0].tail(1)


def git(*command):
    return subprocess.run(["git", *command], cwd=ROOT, text=True, capture_output=True).stdout


def commit_of(*files):
    """The last commit of files; exits if one of them has been changed since."""
    if git("status", "--porcelain", "--", *files):
        sys.exit(f"not measured, as this is not committed yet: {', '.join(files)}")
    return git("log", "-1", "--format=%h", "--", *files).strip() or "unknown"


def measured(measure, job, keep=True):
    """The rows of a job, which say where they come from."""
    origin = {**job._asdict(), "commit": commit_of(job.script) if keep else "not kept"}
    cpuinfo = Path("/proc/cpuinfo")  # where Linux says it, but not on every processor
    model = re.search(r"model name\s*: (.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    origin["processor"] = model[1] if model else platform.processor() or platform.machine()
    rows = pd.DataFrame(measure(job))
    packages = "torch", "gymnasium", "mujoco", *{"stable_baselines3"}.intersection(sys.modules)
    origin |= {package: importlib.metadata.version(package) for package in packages}
    return pd.DataFrame(origin, rows.index).join(rows)


def read(name):
    path = DATA / f"{name}.csv"
    if not path.exists():
        return pd.DataFrame(columns=KEYS)
    rows = pd.read_csv(path, dtype={"options": str, "change": str, "commit": str})
    return rows.fillna({"options": "", "change": ""})


def name_older_commits(rows):
    """A line for each commit but the last of a script by which rows were measured."""
    for (script, commit), group in rows.groupby(["script", "commit"]):
        today = git("log", "-1", "--format=%h", "--", script).strip()
        if commit != today:
            count = len(group[KEYS].drop_duplicates())
            print(f"{count} jobs were measured with {script} of commit {commit}, not {today}")


def main(jobs, draw, measure=last_evaluation, workers=None):
    """Measure the jobs that have no rows yet, each kept as soon as it is done; then draw."""
    study = sys.modules["__main__"]
    parser = argparse.ArgumentParser(description=study.__doc__)
    parser.add_argument("--quick", action="store_true", help="try one tiny job, keep nothing")
    parser.add_argument("--only", default="", metavar="TEXT", help="jobs whose options contain it")
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that measure
    if args.quick:
        job = jobs[0]._replace(options=f"{jobs[0].options} --total-steps 256 --num-evals 1")
        return print(measured(measure, job, keep=False).to_string())
    name = Path(study.__file__).stem
    rows = read(name)
    done = set(rows[KEYS].itertuples(index=False, name=None))
    lacking = [job for job in jobs if job not in done and args.only in job.options]
    if lacking:
        commit_of(*{job.script for job in lacking}, "experiments/*.py")
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as processes:
        futures = [processes.submit(measured, measure, job) for job in lacking]
        try:
            for future in tqdm(as_completed(futures), desc=name, total=len(futures)):
                rows = pd.concat([rows, future.result()] if len(rows) else [future.result()])
                rows = rows.sort_values(KEYS, kind="stable")
                rows.to_csv(DATA / f"{name}.csv", index=False, float_format="%.6g")
        finally:  # after Ctrl-C, too
            processes.shutdown(cancel_futures=True)
    name_older_commits(rows)
    missing = set(jobs) - set(rows[KEYS].itertuples(index=False, name=None))
    if missing:
        return print(f"not drawn, as {len(missing)} jobs have no rows yet")
    tables = draw(read(name))
    print(*tables.values(), sep="\n")
    write_tables(tables)


# --- Statistics -----------------------------------------------------------------------------------


class Difference(NamedTuple):
    """Of means: its estimate, half the width of its 95% interval, and p."""

    gain: float
    margin: float
    p: float

    def __str__(self):
        return f"{number(self.gain)} ± {number(self.margin)}"


def difference(test):
    """The result of one of scipy's t-tests."""
    low, high = test.confidence_interval()
    return Difference((low + high) / 2, (high - low) / 2, test.pvalue)


def welch(changed, usual):
    """The mean of the first minus that of the second."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # where all of one are equal
        return difference(stats.ttest_ind(changed, usual, equal_var=False))


def gain(gains):
    """Their mean."""
    return difference(stats.ttest_1samp(gains, 0))


def holm(p_values, level=0.05):
    """Which p-values stay below the level when corrected for their number (Holm 1979)."""
    passes = np.sort(p_values) <= level / np.arange(len(p_values), 0, -1)
    return np.logical_and.accumulate(passes)[np.argsort(np.argsort(p_values))]


def final_rows(rows):
    """The last row of each job."""
    return rows.groupby(KEYS, sort=False).last().reset_index()


# --- Tables and figures ---------------------------------------------------------------------------


def number(value, digits=0):
    return f"{round(value, digits) + 0.0:,.{digits}f}".replace("-", "−")  # + 0.0: no "−0"


def spread(values, digits=0):
    """Mean ± standard deviation (n − 1)."""
    return f"{number(np.mean(values), digits)} ± {number(np.std(values, ddof=1), digits)}"


def median(values, digits=0):
    """With its 95% interval, of the bootstrap."""
    resampled = stats.bootstrap((values,), np.median, method="percentile", random_state=0)
    low, high = (number(end, digits) for end in resampled.confidence_interval)
    return f"{number(np.median(values), digits)} ({low} to {high})"


def p_text(p):
    return "< 0.001" if p < 0.001 else f"{p:.2g}"


def marked(p_values):
    """Bold where it holds after Holm's correction; empty where it is unknown."""
    known = [p for p in p_values if p == p]
    holds = dict(zip(known, holm(known)))
    return ["" if p != p else f"**{p_text(p)}**" if holds[p] else p_text(p) for p in p_values]


def verdicts(gains):
    """Of each difference, empty where there is none; who leads after Holm's correction is bold."""
    holds, texts = iter(holm([gain.p for gain in gains if gain])), []
    for gain in gains:
        side = f"**ours {'above' if gain.gain > 0 else 'below'}**" if gain and next(holds) else ""
        texts.append(f"{side or 'cannot tell'} (p {p_text(gain.p)})" if gain else "")
    return texts


def proportion(passed):
    """How many of how many, and the exact 95% interval of the probability."""
    low, high = stats.binomtest(int(sum(passed)), len(passed)).proportion_ci()
    return f"{sum(passed)} of {len(passed)} ({100 * low:.3g}% to {100 * high:.3g}%)"


def at_threshold(task, rows):
    """How many of how many reach Gymnasium's threshold, if the task has one."""
    goal = gym.spec(task).reward_threshold
    if goal is None:
        return "no threshold"
    returns = final_rows(rows)["return"]
    return f"{sum(returns >= goal)} of {len(returns)} ≥ {goal:,g}".replace("-", "−")


def compared(changed, usual):
    """Four cells: without, with, the difference, p."""
    gain = welch(changed, usual)
    return [spread(usual), spread(changed), str(gain), p_text(gain.p)]


def table(header, lines):
    """Markdown."""
    frame = pd.DataFrame([list(line) for line in lines], columns=[str(name) for name in header])
    return frame.to_markdown(index=False, disable_numparse=True) + "\n"


def pages():
    return [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("experiments/data/*.md")]


def write_tables(tables):
    """Into the pages."""
    for page in pages():
        parts = re.split(r"(?<=<!-- )(.+)( -->\n\n)((?:\|.*\n)+)", page.read_text("utf-8"))
        for i in range(1, len(parts), 4):
            parts[i + 2] = tables.get(parts[i], parts[i + 2])
        page.write_text("".join(parts), encoding="utf-8")


def figure(width, height, rows=1, columns=1, **options):
    """A picture and its panels."""
    sns.set_theme("talk", "whitegrid", "colorblind", font_scale=0.85)
    picture = Figure(figsize=(width, height), layout="constrained")
    return picture, picture.subplots(rows, columns, squeeze=False, **options).ravel()


def curves(rows, x, axis, y="return", label=None, color="C0", **labels):
    """Every seed, and the mean in bold."""
    sns.lineplot(rows, x=x, y=y, units="seed", estimator=None, alpha=0.3, lw=1, color=color,
                 ax=axis)
    sns.lineplot(rows, x=x, y=y, errorbar=None, linewidth=3, label=label, color=color, ax=axis)
    axis.set(**{"xlabel": x.replace("_", " "), "ylabel": "return", **labels})


def name_ends(axis, gap=0.07):
    """In place of a legend: each line's label beside its end, none over another."""
    named = [line for line in axis.lines if not line.get_label().startswith("_")]
    named.sort(key=lambda line: line.get_ydata()[-1])
    shifts = gap * np.ptp(axis.get_ylim()) * np.arange(len(named))
    ends = [line.get_ydata()[-1] for line in named]  # moved as little as the gaps allow:
    for line, place in zip(named, optimize.isotonic_regression(ends - shifts).x + shifts):
        axis.annotate(line.get_label(), (line.get_xdata()[-1], place), (6, 0), va="center",
                      textcoords="offset points", size="small", color=line.get_color(),
                      annotation_clip=False)
    axis.get_legend().remove()


def save(picture, name):
    picture.savefig(ROOT / f"docs/{name}.png", dpi=120)
