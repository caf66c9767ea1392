"""What the studies share: jobs, their rows in experiments/data, statistics, tables and figures.

A study has JOBS; measure(job), which returns the numbers of a row; and draw(rows), which returns
its tables {name: Markdown} and its figures {name: what has savefig}.

    python experiments/STUDY.py                measures what experiments/data/STUDY.csv lacks, draws
    python experiments/STUDY.py --only Hopper  measures only jobs whose text contains this
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
from functools import partial
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
sns.set_theme("talk", "whitegrid", "colorblind", font_scale=0.85)

# --- Jobs and their rows --------------------------------------------------------------------------


class Job(NamedTuple):
    """One measurement, most often a training."""

    script: str
    options: str = ""  # as typed
    change: str = ""  # one of `variants`, or a study's own
    seed: int = 1


KEYS = list(Job._fields)


def load(job):
    """The script of a job, with its change, as a module; and its options."""
    module = ModuleType(job.script.removesuffix(".py"))
    module.__file__ = str(ROOT / job.script)
    exec(compile(variants.changed(job.script, job.change), job.script, "exec"), vars(module))
    module.tqdm = lambda *steps, **_: tqdm(*steps, disable=True)  # no bar
    return module, module.parse_args(f"{job.options} --seed {job.seed}".split())


def train(job):
    """The numbers of a training, and the agent's weights."""
    module, args = load(job)
    with tempfile.TemporaryDirectory() as folder:
        module.train(0, args, folder)
        log = pd.read_csv(f"{folder}/seed-{job.seed}.csv")
        saved = module.torch.load(f"{folder}/seed-{job.seed}.pt", weights_only=True)
    curve = log.rename(columns={"env_step": "steps", "return": "sampled", "eval_return": "return"})
    return outcome(curve.dropna(subset="return")), saved["agent"]


def outcome(curve):
    """Of a row: the last steps, seconds and return, and all evaluations, as text."""
    pairs = zip(curve["steps"], curve["return"])
    text = " ".join(f"{steps:.0f}:{value:.6g}" for steps, value in pairs)
    return {**curve[["steps", "seconds", "return"]].iloc[-1], "curve": text}


def curves(rows, steps):
    """Of each run the return at each of `steps`, interpolated between evaluations."""
    lines = []
    for row in rows.to_dict("records"):
        points = np.array([point.split(":") for point in row["curve"].split()], float)
        returns = np.interp(steps, *points.T)
        lines.append(pd.DataFrame({**row, "thousand steps": steps / 1000, "return": returns}))
    return pd.concat(lines)


def read(name):
    path = DATA / f"{name}.csv"
    text = dict.fromkeys([*KEYS[:3], "commit", "curve"], str)
    if not path.exists():
        return pd.DataFrame(columns=[*KEYS, "commit"])
    return pd.read_csv(path, dtype=text).fillna(dict.fromkeys(KEYS[:3], ""))


def keys(rows):
    return list(rows[KEYS].itertuples(index=False, name=None))


def commit_of(script):
    """The last commit of a script and its changes, which must not have been edited since."""
    def git(*command):
        files = script, "experiments/variants.py"
        return subprocess.run(["git", *command, "--", *files], cwd=ROOT, text=True, check=True,
                              capture_output=True).stdout.strip()

    edited = git("status", "--porcelain")
    if edited:
        raise ValueError(f"not measured, as it is not committed yet: {edited}")
    return git("log", "-1", "--format=%h")


def attempt(measure, job):
    """A row: the job, where the numbers come from, the numbers. After an error, printed, None."""
    try:
        commit = commit_of(job.script)  # before each job: a study may run for days
        found = measure(job)
    except Exception:
        tqdm.write(f"failed: {job}\n{traceback.format_exc()}", sys.stderr)
        return None
    cpuinfo = Path("/proc/cpuinfo")  # where Linux names the processor
    model = re.search(r"model name\s*: (.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    processor = model[1] if model else platform.processor() or platform.machine()
    versions = {name: importlib.metadata.version(name) for name in ("torch", "gymnasium", "mujoco")}
    return {**job._asdict(), "commit": commit, "processor": processor, **versions, **found}


def keep(name, row):
    """Put a row into a file, instead of one of the same job; never leave half a file."""
    rows = pd.concat([read(name), pd.DataFrame([row])])
    rows = rows.drop_duplicates(KEYS, keep="last").sort_values(KEYS)
    unfinished = DATA / f"{name}.unfinished"
    rows.to_csv(unfinished, index=False, float_format="%.10g")
    unfinished.replace(DATA / f"{name}.csv")


def main(name, jobs, measure):
    """Measure the jobs that lack a row, each kept as soon as it is done; then draw."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", default="", metavar="TEXT", help="jobs that contain it")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="at a time")
    args = parser.parse_args()
    done = keys(read(name))
    lacking = [job for job in jobs if job not in done and args.only in " ".join(map(str, job))]
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that measure
    with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
        new = pool.imap_unordered(partial(attempt, measure), lacking)
        for row in tqdm(new, name, len(lacking)):
            if row is not None:
                keep(name, row)
    if set(jobs) <= set(keys(read(name))):
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


def holm(p_values):
    """Which p-values, a Series, stay below 0.05 when corrected for their number (Holm)."""
    p = p_values.sort_values()
    corrected = (p * np.arange(len(p), 0, -1)).cummax()
    return corrected.reindex(p_values.index) <= 0.05


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
    picture = Figure(figsize=(width, height), layout="constrained")
    return picture, picture.subplots(rows, columns, squeeze=False, **options).ravel()


def seeds_and_mean(lines, panel, **options):
    """A panel for each value of a column of `curves`: thin a line a seed, thick their mean."""
    grid = sns.FacetGrid(lines, col=panel, height=4, **options)
    look = {"x": "thousand steps", "y": "return", "color": "C0"}
    grid.map_dataframe(sns.lineplot, **look, units="seed", estimator=None, lw=0.8, alpha=0.5)
    grid.map_dataframe(sns.lineplot, **look, errorbar=None, lw=4)
    return grid.set_titles("{col_name}")


def report(names=STUDIES, check=False):
    """Put each table into the pages, below its `<!-- NAME -->`; save the figures."""
    tables, figures = {}, {}
    for name in names:
        module, rows = importlib.import_module(name), read(name)
        if set(keys(rows)) != set(module.JOBS):
            sys.exit(f"{name}.csv does not have the jobs of {name}.py; run experiments/{name}.py")
        new_tables, new_figures = module.draw(rows)
        tables |= new_tables
        figures |= new_figures
    unused = set(tables)
    for page in [ROOT / "README.md", *ROOT.glob("docs/*.md")]:
        old = new = page.read_text("utf-8")
        for name, lines in tables.items():
            new, count = re.subn(rf"(<!-- {name} -->\n\n)(\|.*\n)+", rf"\g<1>{lines}", new)
            if count:
                unused.discard(name)
        if check and new != old:
            sys.exit(f"{page}: a table is not that of the data; run experiments/study.py")
        if new != old:
            page.write_text(new, encoding="utf-8")
    if unused:
        sys.exit(f"no page has a place for {unused}")
    if check:
        return
    for name, picture in figures.items():
        picture.savefig(ROOT / f"docs/{name}.png", dpi=110)


if __name__ == "__main__":
    report(check=sys.argv[1:] == ["--check"])
