"""What the studies share: jobs, and the rows in experiments/data that measure them.

A study has JOBS, what is to be measured, and `draw(rows)`, which draws its figures and returns
{name: table} for the pages.

    python experiments/STUDY.py                measures the jobs that have no rows yet, and draws
    python experiments/STUDY.py --only Hopper  measures only jobs whose fields contain this
    python experiments/STUDY.py --again        measures all anew, but those of the present commit
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
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pages
import pandas as pd
import variants
from tqdm import tqdm
from variants import ROOT

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
    module.tqdm = lambda *steps, **_: tqdm(*steps, disable=True)  # no bar
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
    return subprocess.run(
        ["git", *command], cwd=ROOT, text=True, capture_output=True, check=True).stdout


def commit_of(*files):
    """The last commit of files; exits if one of them has been changed since."""
    if git("status", "--porcelain", "--", *files):
        sys.exit(f"not measured, as this is not committed yet: {', '.join(files)}")
    return git("log", "-1", "--format=%h", "--", *files).strip() or "unknown"


def measured(measure, job, keep=True):
    """The rows of a job, which say where they come from."""
    commit = commit_of(job.script, "experiments/*.py") if keep else "not kept"
    origin = {**job._asdict(), "commit": commit}
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
        return pd.DataFrame(columns=[*KEYS, "commit"])
    rows = pd.read_csv(path, dtype=dict.fromkeys(["options", "change", "commit", "cleanrl"], str))
    return rows.fillna({"options": "", "change": ""})


def keys(rows):
    """The jobs of rows, as tuples."""
    return list(rows[KEYS].itertuples(index=False, name=None))


def final_rows(rows):
    """The last row of each job."""
    return rows.groupby(KEYS, sort=False).tail(1).reset_index(drop=True)


def main(jobs, draw, measure=last_evaluation, workers=None):
    """Measure the jobs that have no rows yet, each kept as soon as it is done; then draw."""
    study = sys.modules["__main__"]
    parser = argparse.ArgumentParser(description=study.__doc__)
    parser.add_argument("--quick", action="store_true", help="try one tiny job, keep nothing")
    parser.add_argument("--again", action="store_true", help="jobs of other commits, too")
    parser.add_argument("--only", default="", metavar="TEXT", help="jobs that contain it")
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that measure
    if args.quick:
        return print(measured(measure, tiny(jobs[0]), keep=False).to_string())
    name = Path(study.__file__).stem
    rows = read(name)
    if args.again:
        today = {script: commit_of(script, "experiments/*.py") for script in set(rows["script"])}
        rows = rows[rows["commit"] == rows["script"].map(today)]
    done = set(keys(rows))
    lacking = [job for job in jobs if job not in done and args.only in " ".join(map(str, job))]
    if lacking:
        commit_of(*{job.script for job in lacking}, "experiments/*.py")
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as processes:
        futures = {processes.submit(measured, measure, job): job for job in lacking}
        try:
            for future in tqdm(as_completed(futures), desc=name, total=len(futures)):
                if future.exception():  # the others go on
                    print(futures[future], *traceback.format_exception(future.exception()))
                    continue
                rows = replaced(read(name), future.result())
                rows.to_csv(DATA / f"{name}.new", index=False, float_format="%.10g")
                (DATA / f"{name}.new").replace(DATA / f"{name}.csv")
        finally:  # after Ctrl-C, too
            processes.shutdown(cancel_futures=True)
    rows = read(name)
    missing = set(jobs) - set(keys(rows))
    if missing:
        sys.exit(f"not drawn, as {len(missing)} jobs have no rows yet")
    tables = draw(rows)
    print(*tables.values(), sep="\n")
    pages.write_tables(tables)
    print("Other studies may use these rows: python experiments/report.py")


def tiny(job):
    return job._replace(options=f"{job.options} --total-steps 256 --num-evals 1")


def replaced(rows, new):
    """Rows, with the new ones in place of older ones of the same jobs, in order."""
    jobs = set(keys(new))
    others = rows[[job not in jobs for job in keys(rows)]]
    rows = pd.concat([others, new]) if len(others) else new
    return rows.sort_values(KEYS, kind="stable")
