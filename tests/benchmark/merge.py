"""One table and one figure of run folders from anywhere."""

import json
from pathlib import Path

import pandas as pd
import seaborn as sns
from benchmark import common
from benchmark.common import spread


def flags_of(config, usual):
    """The options that differ from the defaults, as on the command line."""
    kept = {"seed", "env_id", "total_steps", "out_dir", "command", "versions", "resume", "watch"}
    found = []
    for name in sorted(config.keys() - kept):
        if config[name] != usual.get(name):
            value = "" if config[name] is True else f" {config[name]}"
            found.append(f"--{name.replace('_', '-')}{value}")
    return " ".join(found)


def collect(folders):
    """A row per evaluation of each seed, of the last folder that has it; others are named."""
    usual = {name: common.defaults(name) for name in (common.PPO, common.A2C, common.REINFORCE)}
    tables, found = [], {}
    for folder in reversed(folders):
        if not (folder / "args.json").exists():
            print(f"left out: {folder} is no run folder")
            continue
        config = json.loads((folder / "args.json").read_text(encoding="utf-8"))
        script = Path(config["command"][0]).stem
        # A copy under another name is compared with the file whose options it shares.
        closest = max(usual.values(), key=lambda options: len(options.keys() & config.keys()))
        flags = flags_of(config, usual.get(script, closest))
        for seed in config["seed"]:
            file = folder / f"seed-{seed}/evals.csv"
            row = {"script": script, "env_id": config["env_id"], "flags": flags,
                   "total_steps": config["total_steps"], "seed": seed}
            key = tuple(row.values())
            if not file.exists():
                print(f"left out: {folder}, seed {seed}, has saved nothing")
            elif pd.read_csv(file)["env_step"].iloc[-1] < config["total_steps"]:
                print(f"left out: {folder}, seed {seed}, was cut off")
            elif key in found:
                print(f"left out: {folder}, seed {seed}, which is in {found[key]}, too")
            else:
                found[key] = folder
                versions = json.dumps(config["versions"])
                tables.append(pd.read_csv(file).assign(**row, versions=versions))
    return pd.concat(tables[::-1], ignore_index=True) if tables else None


def merge(folders, out_dir):
    data = collect(folders)
    if data is None:
        raise SystemExit("error: no run that could count")
    out_dir.mkdir(parents=True, exist_ok=True)
    data.to_csv(out_dir / "merged.csv", index=False)
    groups = ["script", "env_id", "flags", "total_steps"]
    rows = []
    for names, x in data.groupby(groups, sort=False):
        last = x.groupby("seed").last()
        mean, every = spread(last["return_mean"])
        rows.append([*names[:3], f"{names[3]:,}", len(last), mean, every])
    print(common.table(["script", "task", "flags", "steps", "seeds", "mean ± std", "every seed"],
                       rows))
    for versions, x in data.groupby("versions"):
        if data["versions"].nunique() > 1:
            print(f"{len(x.groupby([*groups, 'seed']))} runs have {versions}")
    common.style()
    data["run"] = data[["script", "flags"]].agg(" ".join, axis=1)
    grid = sns.relplot(common.in_bins(data, "return_mean", ["env_id", "run"]), x="env_step",
                       y="return_mean", hue="run", col="env_id", col_wrap=3, kind="line",
                       errorbar=("pi", 100), height=3, facet_kws={"sharex": False, "sharey": False})
    for axis in grid.axes.flat:
        common.steps_axis(axis)
    grid.savefig(out_dir / "merged.png")
    print(f"\n{out_dir / 'merged.csv'}, {out_dir / 'merged.png'}")
