"""One table and one figure of the folders of many runs.

    python experiments/merge.py runs/HalfCheetah*

A setting is a script with the options in which it differs from the other runs, the steps among
them. For each, in the order of the folders: its seeds, mean and standard deviation of their last
evaluations; for each pair the difference, and p of Welch's t-test. Of a seed that ran twice the
last folder counts. The figure, merged.png, lies beside the folders.
"""

import itertools
import sys
from pathlib import Path

import pandas as pd
import seaborn as sns
import study
import torch


def read(folders):
    """All logs, with a column for the setting; runs that have not ended are named and left out."""
    logs, options = [], []
    for file in (file for folder in folders for file in Path(folder).glob("seed-*.csv")):
        log, saved = pd.read_csv(file), torch.load(file.with_suffix(".pt"), weights_only=True)
        if log["env_step"].iloc[-1] < saved["options"]["total_steps"]:
            print("left out, as it has not ended:", file)
            continue
        logs.append(log.assign(seed=file.stem))
        options.append({"script": file.parent.name.split("__")[-2], **saved["options"]})
    if not logs:
        sys.exit("usage: python experiments/merge.py FOLDER ..., with folders of runs that ended")
    options = pd.DataFrame(options).drop(columns=["seed", "watch", "out_dir"]).astype(str)
    differ = [name for name in options if options[name].nunique() > 1] or ["script"]
    settings = [", ".join(f"{name} {value}" for name, value in row.items())
                for row in options[differ].to_dict("records")]
    last = {(setting, log["seed"][0]): log.assign(setting=setting)
            for setting, log in zip(settings, logs)}
    return pd.concat(last.values(), ignore_index=True).dropna(subset="eval_return")


def main(folders):
    logs = read(folders)
    finals = logs.groupby(["setting", "seed"], sort=False)["eval_return"].last()
    finals = finals.groupby("setting", sort=False)  # in the order of the folders
    print(finals.agg(["count", "mean", "std", "min", "max"]).round(1).to_string())
    for (one, x), (other, y) in itertools.combinations(finals, 2):
        gain, low, high, p = study.welch(y, x)
        print(f"{other} − {one}: {gain:.5g}, 95%: {low:.5g} to {high:.5g}, p = {p:.3g}")
    picture, (axis,) = study.figure(11, 7)
    logs["evaluation"] = logs.groupby(["setting", "seed"]).cumcount()  # REINFORCE's steps differ
    means = logs.groupby(["setting", "evaluation"])[["env_step", "eval_return"]].mean()
    look = {"x": "env_step", "y": "eval_return", "hue": "setting",
            "hue_order": list(logs["setting"].unique()), "ax": axis}
    sns.lineplot(logs, **look, units="seed", estimator=None, lw=1, alpha=0.5, legend=False)
    sns.lineplot(means, **look, lw=3)
    path = Path(folders[0]).parent / "merged.png"
    picture.savefig(path)
    print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
