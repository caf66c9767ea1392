"""What the studies share: jobs and their rows in experiments/data; tables, statistics, figures.

A study has JOBS, what is to be measured, and `draw(rows)`, which returns {name: table}. A table
goes into each page that has the line `<!-- NAME -->`, in place of the table that stands below it.
"""

import argparse
import multiprocessing
import os
import platform
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pandas as pd
import seaborn as sns
import variants
from matplotlib.figure import Figure
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "experiments/data"
PPO, A2C, REINFORCE = "ppo_continuous.py", "a2c_vector.py", "reinforce_mujoco.py"


class Job(NamedTuple):
    """One measurement, most often a training."""

    script: str
    options: str = ""  # as typed
    change: str = ""  # one of `variants`
    seed: int = 1


KEYS = list(Job._fields)


def load(job):
    """The script of a job, with its change, as a module; and its options."""
    module = ModuleType(job.script.removesuffix(".py"))
    code = compile(variants.changed(job.script, job.change), job.script, "exec")
    exec(code, vars(module))
    module.tqdm = lambda **_: tqdm(disable=True)  # no bar
    return module, module.parse_args(f"{job.options} --seed {job.seed}".split())


def train(job):
    """A row for each evaluation (all but `return`: means since the one before); the weights."""
    module, args = load(job)
    with tempfile.TemporaryDirectory() as folder:
        module.train(0, args, Path(folder))
        log = pd.read_csv(f"{folder}/seed-{job.seed}.csv")
        agent = module.torch.load(f"{folder}/seed-{job.seed}.pt", weights_only=True)["agent"]
    log = log.rename(columns={"env_step": "steps", "return": "sampled", "eval_return": "return"})
    period = log["return"].notna().shift(fill_value=False).cumsum()
    means = ["sampled", *log.columns.intersection(["kl", "explained_variance"])]
    rows = log.groupby(period)[["steps", "seconds", "return"]].last()
    return rows.join(log.groupby(period)[means].mean()), agent


def label(measure, job):
    """The rows of a job, which say where they come from."""
    folder = Path(__file__).parent if job.script == "peers.py" else ROOT
    command = "git", "log", "-1", "--format=%h", "--", job.script
    commit = subprocess.run(command, cwd=folder, text=True, capture_output=True).stdout.strip()
    cpuinfo, processor = Path("/proc/cpuinfo"), platform.processor()
    if cpuinfo.exists():  # Linux says it there
        processor = re.search(r"model name\s*: (.*)", cpuinfo.read_text())[1]
    rows = pd.DataFrame(measure(job) if measure else train(job)[0])
    origin = {**job._asdict(), "commit": commit or "unknown", "processor": processor}
    return pd.DataFrame(origin, rows.index).join(rows)


def read(name):
    path = DATA / f"{name}.csv"
    if not path.exists():
        return pd.DataFrame(columns=KEYS)
    rows = pd.read_csv(path, dtype={"options": str, "change": str})
    return rows.fillna({"options": "", "change": ""})


def main(jobs, draw, measure=None, workers=None):
    """Measure the jobs that have no rows yet, each kept as soon as it is done; then draw."""
    study = sys.modules["__main__"]
    parser = argparse.ArgumentParser(description=study.__doc__)
    parser.add_argument("--quick", action="store_true", help="try one tiny job, keep nothing")
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that measure
    if parser.parse_args().quick:
        job = jobs[0]._replace(options=f"{jobs[0].options} --total-steps 256 --num-evals 1")
        return print(label(measure, job).to_string())
    name = Path(study.__file__).stem
    rows = read(name)
    done = set(rows[KEYS].itertuples(index=False, name=None))
    lacking = [job for job in jobs if job not in done]
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as processes:
        futures = [processes.submit(label, measure, job) for job in lacking]
        try:
            for future in tqdm(as_completed(futures), desc=name, total=len(futures)):
                rows = pd.concat([rows, future.result()] if len(rows) else [future.result()])
                rows = rows.sort_values(KEYS, kind="stable")
                rows.to_csv(DATA / f"{name}.csv", index=False, float_format="%.6g")
        finally:  # after Ctrl-C, too
            processes.shutdown(cancel_futures=True)
    put(draw(read(name)))


# --- Tables, statistics, figures ------------------------------------------------------------------


def pages():
    return [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]


def put(tables):
    """Write tables into the pages."""
    for page in pages():
        parts = re.split(r"(?<=<!-- )(.+)( -->\n\n)((?:\|.*\n)+)", page.read_text("utf-8"))
        for i in range(1, len(parts), 4):
            parts[i + 2] = tables.get(parts[i], parts[i + 2])
        page.write_text("".join(parts), encoding="utf-8")


def table(header, lines):
    """Markdown."""
    lines = [header, ["---"] * len(header), *lines]
    return "".join("| " + " | ".join(map(str, line)) + " |\n" for line in lines)


def number(x, digits=0):
    return f"{round(x, digits) + 0.0:,.{digits}f}".replace("-", "−")  # + 0.0: no "−0"


def spread(values, digits=0):
    """Mean ± standard deviation (n − 1)."""
    return f"{number(np.mean(values), digits)} ± {number(np.std(values, ddof=1), digits)}"


def every(values, digits=0):
    return ", ".join(number(x, digits) for x in values)


def p_value(test):
    return "< 0.001" if test.pvalue < 0.001 else f"{test.pvalue:.2g}"


def share(passed):
    """How many of how many, and the exact 95% interval of the probability."""
    from scipy import stats
    low, high = stats.binomtest(passed.sum(), len(passed)).proportion_ci()
    return f"{passed.sum()} of {len(passed)} ({low:.0%} to {high:.0%})"


def interval(test):
    """Middle and half the width of the 95% interval of one of scipy's t-tests."""
    low, high = test.confidence_interval()
    return (low + high) / 2, (high - low) / 2


def last(rows):
    """The last row of each job."""
    return rows.groupby(KEYS, sort=False).last().reset_index()


def figure(width, height, rows=1, columns=1, count=None, **options):
    """A picture with `count` panels, at most rows·columns."""
    sns.set_theme(style="whitegrid", palette="colorblind")
    picture = Figure(figsize=(width, height), layout="constrained")
    panels = picture.subplots(rows, columns, squeeze=False, **options).flat
    for panel in panels[count or len(panels) :]:
        panel.remove()
    return picture, panels[:count]


def curves(rows, x, axis, y="return", label=None, color="C0", **labels):
    """Every seed, and the mean in bold."""
    sns.lineplot(rows, x=x, y=y, units="seed", estimator=None, alpha=0.3, color=color, ax=axis)
    sns.lineplot(rows, x=x, y=y, errorbar=None, linewidth=3, label=label, color=color, ax=axis)
    axis.set(**{"xlabel": x.replace("_", " "), "ylabel": "return", **labels})


def save(picture, name):
    picture.savefig(ROOT / f"docs/{name}.png", dpi=120)
