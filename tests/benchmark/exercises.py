"""The answers to docs/exercises.md: every seed of every change. An hour and a half on two cores."""

import study
from study import A2C, PPO, REINFORCE, Job, number

CHEETAH = "--env-id HalfCheetah-v5 --total-steps 3e5"
EXERCISES = {  # its number in the sheet: script, options, change
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
}
JOBS = [Job(*exercise, seed) for seed in range(71, 76) for exercise in EXERCISES.values()]


def draw(rows):
    from scipy import stats

    lines, runs = [], rows.groupby(["script", "options", "change"])
    for name, exercise in EXERCISES.items():
        seeds = runs.get_group(exercise).groupby("seed")
        returns, means = seeds["return"].last(), seeds.mean(numeric_only=True)
        if "as it is" in name:
            usual, effect = returns, ["", ""]
        elif usual.std() > 0:  # else Welch's test does not apply
            test = stats.ttest_ind(returns, usual, equal_var=False)
            effect = ["{:.0f} ± {:.0f}".format(*study.interval(test)), f"{test.pvalue:.2g}"]
        lines.append([name, study.every(returns), *effect, study.every(means["kl"], 3),
                      study.every(means["explained_variance"], 2),
                      number(seeds["seconds"].last().median() / 60, 1)])
    return {"answers": study.table(
        ["exercise", "return in evaluation, every seed", "difference, 95%", "p", "KL",
         "explained variance", "minutes"], lines)}


if __name__ == "__main__":
    study.main(JOBS, draw)
