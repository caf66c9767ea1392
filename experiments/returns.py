"""How high do the returns get, and how often does a run fail? Five hours on two cores."""

import gymnasium as gym
import study
from study import A2C, PPO, REINFORCE, Job, number

PUBLISHED = study.read("published").set_index(["task", "same_version"])  # best in 1e6 steps
TASKS = sorted(set(PUBLISHED.index.get_level_values("task")))
MILLION, HUNDRED = "--total-steps 1e6", "--num-evals 1 --eval-episodes 100"
SETTINGS = {  # options for other tasks: the script, the first of five seeds
    "--env-id Swimmer-v5 --total-steps 1e6 --gamma 0.999 --gae-lambda 0.98 --rollout-steps 512 "
    "--first-std 1": (PPO, 96),
    "--env-id Hopper-v5 --total-steps 3e5 --rollout-steps 32 --minibatch-size 128": (PPO, 91),
    "--env-id Humanoid-v5 --total-steps 3e6 --learning-rate 3e-4": (PPO, 91),
    "--env-id MountainCarContinuous-v0 --total-steps 1e5 --first-std 2": (PPO, 91),
    "--env-id CartPole-v1 --total-steps 3e5 --gamma 0.99": (A2C, 91),
    "--env-id my_module:HeldAcrobot-v0 --total-steps 1e5": (A2C, 91),  # the guide's module
    "--env-id MountainCar-v0 --total-steps 5e5": (A2C, 91),
}
JOBS = [
    *(Job(script, HUNDRED, seed=seed) for seed in range(71, 81) for script in (REINFORCE, PPO)),
    *(Job(A2C, HUNDRED, seed=seed) for seed in range(71, 101)),
    *(Job(PPO, f"--env-id {x} {MILLION}", seed=seed) for seed in range(71, 81) for x in TASKS),
    *(Job(script, options, seed=first + i)
      for i in range(5) for options, (script, first) in SETTINGS.items()),
]


def published(key, runs):
    """As text, and p of Welch's test against ours, of the same kind, if the spread is known."""
    from scipy import stats
    if key not in PUBLISHED.index:
        return "", ""
    mean, std, seeds, sampled, source = PUBLISHED.loc[key]
    ours, digits = runs["sampled" if sampled else "return"], 0 if abs(mean) > 100 else 1
    if not std > 0:
        return f"{number(mean, digits)} {source}", ""
    test = stats.ttest_ind_from_stats(
        ours.mean(), ours.std(), len(ours), mean, std, seeds, equal_var=False)
    return f"{number(mean, digits)} ± {number(std, digits)} {source}", study.p_value(test)


def draw(rows):
    ten, three, others, final = [], [], [], study.last(rows)
    picture, panels = study.figure(10, 8, 3, 4, count=len(TASKS))
    for axis, task in zip(panels, TASKS):
        x = rows[rows["options"] == f"--env-id {task} {MILLION}"]
        x = x.assign(million_steps=x["steps"] / 1e6)
        x.groupby("million_steps")["sampled"].mean().plot(ax=axis, color="C1", lw=3, label="_")
        study.curves(x, "million_steps", axis, xlabel="", ylabel="",
                     title=task.removesuffix("-v5").replace("Double", "\nDouble"))
        for i, name in (0, "mean in training"), (1, "seeds in evaluation"), (-1, "their mean"):
            axis.lines[i].set_label(name)
        for same_version, line in PUBLISHED.loc[task].iterrows():
            axis.errorbar(1.1 if same_version else 1.2, line["mean"], line["std"], capsize=4,
                          fmt="s" if same_version else "^", color=f"C{line['sampled']:d}",
                          label=f"published, {'this' if same_version else 'an older'} version")
        x = study.last(x)
        digits = 0 if abs(x["return"].mean()) > 100 else 1
        ten.append([task, study.spread(x["return"], digits), study.spread(x["sampled"], digits),
                    *published((task, True), x), *published((task, False), x),
                    number(x["seconds"].median() / 60, 1)])
    picture.suptitle("PPO on ten tasks: return against million steps")
    picture.legend(*axis.get_legend_handles_labels(), loc="lower right",
                   title="compare a marker (± std) with the line of its colour")
    study.save(picture, "ppo_returns")
    for script in REINFORCE, A2C, PPO:
        x = final[(final["options"] == HUNDRED) & (final["script"] == script)]
        _, args = study.load(Job(script))
        threshold, returns = gym.spec(args.env_id).reward_threshold, x["return"]
        three.append([f"`{script}`", args.env_id, study.spread(returns), number(returns.min()),
                      f"{threshold:,g}", study.share(returns >= threshold),
                      f"{args.total_steps:,}", number(x["seconds"].median())])
    for options, x in final[final["options"].isin(SETTINGS)].groupby("options"):
        others.append([f"`python {SETTINGS[options][0]} {options}`", study.every(x["return"]),
                       number(x["return"].mean()), number(x["seconds"].median() / 60, 1)])
    short = [[*line[:4], line[-1]] for line in ten]
    return {
        "ten tasks": study.table(["task", "evaluation", "in training", "published", "p",
                                  "older versions", "p", "minutes"], ten),
        "ten tasks in short": study.table(
            ["task", "evaluation", "in training", "published [from]", "minutes"], short),
        "three scripts": study.table(["file", "task", "mean ± std", "lowest", "solved from",
                                      "solved (95% interval)", "steps", "seconds"], three),
        "settings": study.table(["command", "five seeds", "mean", "minutes"], others)}


if __name__ == "__main__":
    study.main(JOBS, draw)
