"""What the studies share: jobs, their rows in experiments/data, statistics, tables and figures.

A study has JOBS; measure(job), which returns the numbers of a row; and draw(rows), which returns
its tables {name: Markdown} and its figures {name: Figure}.

    python experiments/STUDY.py                measures what experiments/data/STUDY.csv lacks, draws
    python experiments/STUDY.py --only Hopper  measures only jobs whose text contains this
    python experiments/STUDY.py --again        measures rows of other commits of the script anew
    python experiments/study.py                draws all tables and figures, from the data alone
    python experiments/study.py --check        fails if a table of the pages is not that of the data
"""

import argparse
import importlib
import importlib.metadata
import multiprocessing
import os
import platform
import re
import subprocess
import sys
import tempfile
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pandas as pd
import seaborn as sns
import variants
from matplotlib.figure import Figure
from scipy import stats
from tqdm import tqdm
from variants import ROOT

DATA = ROOT / "experiments/data"
STUDIES = "returns", "peers", "ablation", "baselines", "randomize"

# --- Jobs and their rows --------------------------------------------------------------------------


class Job(NamedTuple):
    """One measurement, most often a training."""

    script: str
    options: str = ""  # as typed
    change: str = ""  # one of `variants`, or a peer's name
    seed: int = 1


KEYS = list(Job._fields)


def load(job):
    """The script of a job, with its change, as a module; and its options."""
    module = ModuleType(job.script.removesuffix(".py"))
    module.__file__ = str(ROOT / job.script)
    exec(compile(variants.changed(job.script, job.change), job.script, "exec"), vars(module))
    module.tqdm = lambda *steps, **_: tqdm(*steps, disable=True)  # no bar
    return module, module.parse_args(f"{job.options} --seed {job.seed}".split())


def run(module, args):
    """Train one agent; its log and its weights."""
    with tempfile.TemporaryDirectory() as folder:
        module.train(0, args, folder)
        path = f"{folder}/seed-{args.seed[0]}"
        saved = module.torch.load(f"{path}.pt", weights_only=True)
        return pd.read_csv(f"{path}.csv"), saved["agent"]


def train(job):
    """The numbers of a training, and the agent's weights."""
    log, weights = run(*load(job))
    curve = log.rename(columns={"env_step": "steps", "return": "sampled", "eval_return": "return"})
    return numbers(curve.dropna(subset="return")), weights


def numbers(curve):
    """Of a row: the last steps, seconds and return, and all evaluations, as text."""
    pairs = zip(curve["steps"], curve["return"])
    text = " ".join(f"{steps:.0f}:{value:.6g}" for steps, value in pairs)
    return {**curve[["steps", "seconds", "return"]].iloc[-1], "curve": text}


def curves(rows):
    """A line for each evaluation, `steps` and `return`, of runs that have more than the last."""
    rows = rows[rows["curve"].str.contains(" ", na=False)]
    lines = rows.assign(point=rows["curve"].str.split()).explode("point", ignore_index=True)
    lines[["steps", "return"]] = lines["point"].str.split(":", expand=True).astype(float)
    return lines


def read(name):
    path = DATA / f"{name}.csv"
    text = dict.fromkeys([*KEYS[:3], "commit", "curve"], str)
    if not path.exists():
        return pd.DataFrame(columns=[*KEYS, "commit"])
    return pd.read_csv(path, dtype=text).fillna(dict.fromkeys(KEYS[:3], ""))


def keys(rows):
    return list(rows[KEYS].itertuples(index=False, name=None))


def commit_of(script):
    """The last commit of a script; exits if it has been changed since."""
    def git(*command):
        return subprocess.run(["git", *command, "--", script], cwd=ROOT, text=True, check=True,
                              capture_output=True).stdout.strip()

    if git("status", "--porcelain"):
        sys.exit(f"not measured, as it is not committed yet: {script}")
    return git("log", "-1", "--format=%h")


def measured(measure, job, commit):
    """A row: the job, where the numbers come from, and the numbers."""
    cpuinfo = Path("/proc/cpuinfo")  # where Linux names the processor
    model = re.search(r"model name\s*: (.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    found = measure(job)
    packages = "torch", "gymnasium", "mujoco", *{"stable_baselines3"}.intersection(sys.modules)
    versions = {package: importlib.metadata.version(package) for package in packages}
    processor = model[1] if model else platform.processor() or platform.machine()
    return {**job._asdict(), "commit": commit, "processor": processor, **versions, **found}


def main(name, jobs, measure):
    """Measure the jobs that lack a row, each kept as soon as it is done; then draw."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", default="", metavar="TEXT", help="jobs that contain it")
    parser.add_argument("--again", action="store_true", help="rows of other commits, too")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="at a time")
    args = parser.parse_args()
    rows = read(name)
    commits = {script: commit_of(script) for script in {job.script for job in jobs}}
    if args.again:
        rows = rows[rows["commit"] == rows["script"].map(commits)]
    done = set(keys(rows))
    lacking = [job for job in jobs if job not in done and args.only in " ".join(map(str, job))]
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that measure
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(args.workers, spawn) as processes:
        futures = {processes.submit(measured, measure, job, commits[job.script]): job
                   for job in lacking}
        try:
            for future in tqdm(as_completed(futures), desc=name, total=len(futures)):
                if future.exception():  # the others go on
                    print(futures[future], *traceback.format_exception(future.exception()))
                    continue
                rows = pd.concat([read(name), pd.DataFrame([future.result()])])
                rows = rows.drop_duplicates(KEYS, keep="last").sort_values(KEYS)
                rows.to_csv(DATA / f"{name}.csv", index=False, float_format="%.10g")
        finally:  # after Ctrl-C, too
            processes.shutdown(cancel_futures=True)
    missing = set(jobs) - set(keys(read(name)))
    if missing:
        sys.exit(f"not drawn, as {len(missing)} jobs have no row yet")
    report([name])


# --- Statistics -----------------------------------------------------------------------------------


class Difference(NamedTuple):
    """Of two means, with its 95% interval and p."""

    gain: float
    low: float
    high: float
    p: float

    def __str__(self):
        return f"{number(self.gain)} ({number(self.low)} to {number(self.high)})"


def welch(changed, usual):
    """The mean of the first minus that of the second."""
    test = stats.ttest_ind(changed, usual, equal_var=False)
    return Difference(np.mean(changed) - np.mean(usual), *test.confidence_interval(), test.pvalue)


def paired(gains):
    """The mean of gains, each of a pair."""
    test = stats.ttest_1samp(gains, 0)
    return Difference(np.mean(gains), *test.confidence_interval(), test.pvalue)


def holm(p_values, level=0.05):
    """Which p-values stay below the level when corrected for their number (Holm 1979)."""
    passes = np.sort(p_values) <= level / np.arange(len(p_values), 0, -1)
    return np.logical_and.accumulate(passes)[np.argsort(np.argsort(p_values))]


def number(value, digits=0):
    return f"{round(value, digits) + 0.0:,.{digits}f}".replace("-", "−")  # + 0.0: no "−0"


def spread(values, digits=0):
    """Mean ± standard deviation (n − 1)."""
    return f"{number(np.mean(values), digits)} ± {number(np.std(values, ddof=1), digits)}"


# --- Tables and figures ---------------------------------------------------------------------------


def table(header, lines):
    """Markdown."""
    lines = [header, ["---"] * len(header), *lines]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def figure(width, height, rows=1, columns=1, **options):
    """A picture and its panels."""
    sns.set_theme("talk", "whitegrid", "colorblind", font_scale=0.85)
    picture = Figure(figsize=(width, height), layout="constrained")
    return picture, picture.subplots(rows, columns, squeeze=False, **options).ravel()


def pages():
    return [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("experiments/data/*.md")]


def report(names=STUDIES, check=False):
    """Put each table into the pages, below its `<!-- NAME -->`; save the figures."""
    tables, figures = {}, {}
    for name in names:
        for found, new in zip((tables, figures), importlib.import_module(name).draw(read(name))):
            found |= new
    for page in pages():
        old = new = page.read_text("utf-8")
        for name, lines in tables.items():
            new = re.sub(rf"(<!-- {name} -->\n\n)(\|.*\n)+", rf"\g<1>{lines}", new)
        if check and new != old:
            sys.exit(f"{page}: a table is not that of the data; run experiments/study.py")
        page.write_text(new, encoding="utf-8")
    if check:
        return
    for name, picture in figures.items():
        picture.savefig(ROOT / f"docs/{name}.png", dpi=110)


if __name__ == "__main__":
    report(check=sys.argv[1:] == ["--check"])
