"""What the exercises 5 to 12 give, with the seeds of their sheet. Half an hour on two cores."""

import pandas as pd
import study
from study import A2C, PPO, Job, number

CHEETAH = "--env-id HalfCheetah-v5 --total-steps 3e5"
RUN = {  # number: what the answers call it; script and options; typed besides, changed
    5: ("`--gae-lambda 0`", (A2C, ""), ("--gae-lambda 0", "")),
    6: ("`--gae-lambda 1`", (A2C, ""), ("--gae-lambda 1", "")),
    7: ("`--epochs 1`", (PPO, CHEETAH), ("--epochs 1", "")),
    8: ("σ = 0.03", (PPO, CHEETAH), ("--first-std 0.03 --last-std 0.03", "")),
    9: ("observations not normalised", (PPO, CHEETAH), ("", "observations-not-normalised"))}
FIND = {"right": "", "10": "fault-1", "11": "fault-2", "12": "fault-3"}
SHOWN = [  # statistic, column, digits
    ("last", "eval_return", 0), ("first", "return", 0), ("median", "value_loss", 2),
    ("first", "explained_variance", 2), ("median", "explained_variance", 2), ("median", "kl", 3),
    ("last", "kl", 3), ("median", "clip_fraction", 2)]
NAMES = {"eval_return": "return", "return": "sampled"}  # of columns: in a log, in the rows


def with_change(script, options, typed, changed):
    return script, f"{options} {typed}".strip(), changed


SETTINGS = dict.fromkeys([(*usual, "") for _, usual, _ in RUN.values()])
SETTINGS |= dict.fromkeys(with_change(*usual, *change) for _, usual, change in RUN.values())
JOBS = [*(Job(*setting, seed) for seed in range(1, 6) for setting in SETTINGS),
        *(Job(PPO, "--total-steps 32768", change, seed)
          for seed in (1, 2) for change in FIND.values())]


def measure(job):
    """Three rows: the first, the median and the last of each column of the log."""
    log, _ = study.run(*study.load(job))
    rows = pd.DataFrame({"first": log.iloc[0], "median": log.median(), "last": log.iloc[-1]}).T
    rows = rows.rename(columns=NAMES | {"env_step": "steps"}).rename_axis("statistic")
    return rows.reset_index()


def draw(rows):
    rows = rows.set_index(["script", "options", "change", "statistic"])
    run, medians, find = [], [], []
    for exercise, (name, usual, change) in RUN.items():
        settings = (*usual, ""), with_change(*usual, *change)
        without, changed = (rows.loc[(*setting, "last"), "return"] for setting in settings)
        gain = study.welch(changed, without)
        verdict = "none that five seeds show"
        if gain.p < 0.01:
            verdict = f"an effect, for the {'better' if gain.gain > 0 else 'worse'}"
        run.append([exercise, name, study.spread(without), study.spread(changed), str(gain),
                    study.p_text(gain.p), verdict])
        of_seeds = [rows.loc[(*setting, "median")].mean(numeric_only=True) for setting in settings]
        medians.append([exercise, *(number(x['explained_variance'], 2) for x in of_seeds),
                        *("" if usual[0] == A2C else number(x['kl'], 3) for x in of_seeds)])
    for statistic, column, digits in SHOWN:
        cells = []
        for change in FIND.values():
            values = rows.loc[(PPO, "--total-steps 32768", change, statistic)]
            values = values[NAMES.get(column, column)].round(digits)
            cells.append(", ".join(number(x, digits) if x else "0" for x in values))
        find.append([f"{statistic} `{column}`".removeprefix("median "), *cells])
    return {
        "run": study.table(["", "change", "without (± std)", "with (± std)", "difference, 95%",
                            "p", "verdict"], run),
        "medians": study.table(["", "`explained_variance` without", "with", "`kl` without",
                                "with"], medians),
        "find": study.table(["seeds 1, 2; medians if not said", *FIND], find)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
