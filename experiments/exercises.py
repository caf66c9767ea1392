"""What the exercises 5 to 8, 10 to 12 give, with the seeds of their sheet. Half an hour."""

import itertools

import pandas as pd
import study
from study import A2C, PPO, Job, number

CHEETAH = "--env-id HalfCheetah-v5 --total-steps 3e5"
RUN = {  # number: what the answers call it; script and options; typed besides, changed
    5: ("`--gae-lambda 0`", (A2C, ""), ("--gae-lambda 0", "")),
    6: ("`--gae-lambda 1`", (A2C, ""), ("--gae-lambda 1", "")),
    7: ("`--epochs 1`", (PPO, CHEETAH), ("--epochs 1", "")),
    8: ("σ = 0.03", (PPO, CHEETAH), ("--first-std 0.03 --last-std 0.03", ""))}
FIND = {"right": "", "10": "fault-1", "11": "fault-2", "12": "fault-3"}
DIGITS = {"eval_return": 0, "return": 0, "value_loss": 2, "explained_variance": 2, "kl": 3,
          "clip_fraction": 2}
STATISTICS = "first", "median", "last"  # of the rows of a log
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
    run, find = [], []
    for exercise, (name, usual, change) in RUN.items():
        settings = (*usual, ""), with_change(*usual, *change)
        without, changed = (rows.loc[(*setting, "last"), "return"] for setting in settings)
        gain = study.welch(changed, without)
        verdict = "none that five seeds show"
        if gain.p < 0.01:
            verdict = f"an effect, for the {'better' if gain.gain > 0 else 'worse'}"
        medians = [rows.loc[(*setting, "median")].mean(numeric_only=True) for setting in settings]
        texts = [" → ".join(number(x[column], DIGITS[column]) for x in medians)
                 for column in ("explained_variance", "kl")]
        run.append([exercise, name, study.spread(without), study.spread(changed), str(gain),
                    study.p_text(gain.p), verdict, texts[0], "" if usual[0] == A2C else texts[1]])
    for (column, digits), statistic in itertools.product(DIGITS.items(), STATISTICS):
        cells = []
        for change in FIND.values():
            values = rows.loc[(PPO, "--total-steps 32768", change, statistic)]
            values = values[NAMES.get(column, column)].round(digits)
            cells.append(", ".join(number(x, digits) if x else "0" for x in values))
        find.append([f"{statistic} `{column}`", *cells])
    return {
        "run": study.table(["", "change", "without (± std)", "with (± std)", "difference, 95%",
                            "p", "verdict", "median `explained_variance`", "median `kl`"], run),
        "find": study.table(["seeds 1, 2", *FIND], find)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
