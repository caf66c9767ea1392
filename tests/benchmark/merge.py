"""One table and one figure of the folders of many runs.

    python tests/benchmark/merge.py runs/HalfCheetah*

A setting is a script with the options in which it differs from the other runs, the steps among
them. For each: its seeds, mean and standard deviation of their last evaluations; with just two
settings also p, of Welch's t-test (needs scipy). The figure, merged.png, lies beside the folders.
"""

import sys
from pathlib import Path

import pandas as pd
import seaborn as sns
import torch
from matplotlib.figure import Figure


def read(folders):
    """All logs, with a column for the setting; and the names of runs that have not ended."""
    logs, options, unfinished = [], [], []
    for file in sorted(file for folder in folders for file in Path(folder).glob("seed-*.csv")):
        log, saved = pd.read_csv(file), torch.load(file.with_suffix(".pt"), weights_only=True)
        if log["env_step"].iloc[-1] < saved["total_steps"]:
            unfinished.append(str(file))
            continue
        logs.append(log.assign(seed=file.stem, run=len(logs)))
        script = file.parent.name.split("__")[1]
        options.append({"script": script, **saved})
    if not logs:
        sys.exit("merge.py: no finished run in these folders")
    options = pd.DataFrame(options).drop(columns=["seed", "watch", "out_dir", "agent"])
    differ = [name for name in options if options[name].astype(str).nunique() > 1]
    settings = options[differ or ["script"]].astype(str).apply(
        lambda row: ", ".join(f"{name} {value}" for name, value in row.items()), axis=1)
    logs = [log.assign(setting=setting) for log, setting in zip(logs, settings)]
    return pd.concat(logs, ignore_index=True), unfinished


def main(folders):
    logs, unfinished = read(folders)
    evals = logs.dropna(subset="eval_return")
    last = evals.groupby(["setting", "run"])["eval_return"].last()
    print(last.groupby("setting").agg(["count", "mean", "std", "min", "max"]).round(1).to_string())
    for name in unfinished:
        print("left out, as it has not ended:", name)
    settings = [values for _, values in last.groupby("setting")]
    if len(settings) == 2:
        try:
            from scipy import stats
            print(f"p = {stats.ttest_ind(*settings, equal_var=False).pvalue:.3g} (Welch's t-test)")
        except ImportError:
            print("p: needs scipy (pip install scipy)")
    figure = Figure(figsize=(11, 7), layout="constrained")
    axes = figure.subplots()
    sns.lineplot(evals, x="env_step", y="eval_return", hue="setting", units="run", estimator=None,
                 alpha=0.3, legend=False, ax=axes)
    step = evals["env_step"].max() / 20  # seeds of REINFORCE are evaluated at different steps
    evals = evals.assign(env_step=(evals["env_step"] / step).round() * step)
    sns.lineplot(evals, x="env_step", y="eval_return", hue="setting", errorbar=None, linewidth=3,
                 ax=axes)
    axes.set(ylabel="return in evaluation (thin: each seed, bold: mean)")
    path = Path(folders[0]).parent / "merged.png"
    figure.savefig(path)
    print(path)


if __name__ == "__main__":
    if not sys.argv[1:]:
        sys.exit(__doc__)
    main(sys.argv[1:])
