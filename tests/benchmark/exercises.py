"""The answers to the exercises of docs/exercises.md: every seed of every change."""

import pandas as pd
from benchmark import common
from benchmark.common import A2C, PPO, REINFORCE, number

FIGURES = ()
METRICS = {"approximate_kl": 3, "explained_variance": 2}  # digits that are shown
CHEETAH = "--env-id HalfCheetah-v5 --total-steps 300000"
CHANGES = {  # its number in the sheet: script, flags, patch
    "REINFORCE as it is": (REINFORCE, "", ""),
    "1": (REINFORCE, "--baseline none", ""),
    "2": (REINFORCE, "--gamma 0.9", ""),
    "A2C as it is": (A2C, "", ""),
    "3": (A2C, "--gae-lambda 0", ""),
    "4": (A2C, "--gae-lambda 1", ""),
    "5": (A2C, "--num-envs 1 --rollout-steps 512", ""),
    "PPO as it is": (PPO, CHEETAH, ""),
    "6": (PPO, f"{CHEETAH} --clip-eps 1e9 --max-kl 1e9", ""),
    "7": (PPO, f"{CHEETAH} --epochs 1", ""),
    "7, minibatches of 52": (PPO, f"{CHEETAH} --epochs 1 --minibatch-size 52", ""),
    "8": (PPO, f"{CHEETAH} --first-std 0.03 --last-std 0.03", ""),
    "9": (PPO, CHEETAH, "observations-not-normalised"),
    "10": (PPO, CHEETAH, "time-limits-as-deaths"),
    "11": (PPO, CHEETAH, "another-reward"),
    "12, file 1": (PPO, CHEETAH, "fault-1"),
    "12, file 2": (PPO, CHEETAH, "fault-2"),
    "12, file 3": (PPO, CHEETAH, "fault-3"),
}


def jobs(quick):
    found = []
    for name, (script, flags, variant) in list(CHANGES.items())[:2 if quick else None]:
        found += common.training_jobs(script, quick, flags, common.SEEDS[script][:5],
                                      variant=variant, part=name)
    return found


def measure(job):
    """Also the median over all updates of each metric that the script has."""
    rows = common.train(job)
    metrics = pd.read_csv(common.run_folder(job) / "metrics.csv").reindex(columns=list(METRICS))
    return rows.assign(**metrics.median())


def report(data, draw):
    from scipy.stats import ttest_ind

    last = common.last_rows(data)
    rows, unchanged = [], None
    for name in CHANGES:
        x = last[last["part"] == name]
        gain = p = "–"
        if "as it is" in name:
            unchanged = x["return_mean"]
        elif unchanged.std() > 0:  # else Welch's test does not apply
            test = ttest_ind(x["return_mean"], unchanged, equal_var=False)
            p = number(test.pvalue, 3) if test.pvalue >= 0.001 else "< 0.001"
            mean, margin = common.difference(x["return_mean"], unchanged)
            gain = f"{number(mean, 0)} ± {number(margin, 0)}"
        returns = ", ".join(number(y, 0) for y in x["return_mean"])
        metrics = ["–" if x[column].isna().all() else ", ".join(number(y, n) for y in x[column])
                   for column, n in METRICS.items()]
        rows.append([name, returns, gain, p, *metrics, number(x["seconds"].median() / 60)])
    header = ["exercise", "return in evaluation, each seed", "difference, 95%", "p",
              *(f"`{column}`, each seed" for column in METRICS), "minutes"]
    return {"answers": common.table(header, rows)}
