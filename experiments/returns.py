"""How high do the returns get, and how often does a run fail? Four hours on two cores.
"""

import gymnasium as gym
import study
from scipy import stats
from study import A2C, PPO, REINFORCE, Job, number

PUBLISHED = study.read("published").set_index(["task", "same_version"])  # best in 1e6 steps
TASKS = sorted(set(PUBLISHED.index.get_level_values("task")))
MILLION, HUNDRED = "--total-steps 1e6", "--num-evals 1 --eval-episodes 100"
CURVES = [Job(PPO, f"--env-id {task} {MILLION}", seed=seed)
          for seed in range(71, 81) for task in TASKS]
JOBS = [
    *(Job(script, seed=seed) for seed in range(1, 6) for script in (REINFORCE, A2C, PPO)),
    *(Job(script, HUNDRED, seed=seed) for seed in range(71, 81) for script in (REINFORCE, PPO)),
    *(Job(A2C, HUNDRED, seed=seed) for seed in range(71, 101)), *CURVES,
]


def measure(job):
    """All evaluations of what the figure shows, else the last."""
    rows, _ = study.train(job)
    return rows if job in CURVES else rows.tail(1)


def published(task, same_version, final):
    """As text, and p of Welch's test against ours, of the same kind, if the spread is known."""
    if (task, same_version) not in PUBLISHED.index:
        return "", ""
    mean, std, seeds, sampled, source = PUBLISHED.loc[task, same_version]
    ours, digits = final["sampled" if sampled else "return"], 0 if abs(mean) > 100 else 1
    if not std > 0:
        return f"{number(mean, digits)} {source}", ""
    test = stats.ttest_ind_from_stats(
        ours.mean(), ours.std(), len(ours), mean, std, seeds, equal_var=False)
    text = f"{number(mean, digits)} ± {number(std, digits)} {source}"
    return text, study.p_text(test.pvalue)


def draw_task(axis, task, rows):
    rows = rows.assign(million_steps=rows["steps"] / 1e6)
    rows.groupby("million_steps")["sampled"].mean().plot(ax=axis, color="C1", lw=3, label="_")
    study.curves(rows, "million_steps", axis, xlabel="", ylabel="",
                 title=task.removesuffix("-v5").replace("Double", "\nDouble"))
    for i, name in (0, "mean in training"), (1, "seeds in evaluation"), (-1, "their mean"):
        axis.lines[i].set_label(name)
    for same_version, line in PUBLISHED.loc[task].iterrows():
        axis.errorbar(1.1 if same_version else 1.2, line["mean"], line["std"], capsize=4,
                      fmt="s" if same_version else "^", color=f"C{line['sampled']:d}",
                      label=f"published, {'this' if same_version else 'an older'} version")


def draw(rows):
    finals, ten, three = study.final_rows(rows[rows["change"] == ""]), [], []
    picture, panels = study.figure(10, 8, 3, 4, count=len(TASKS))
    for axis, task in zip(panels, TASKS):
        draw_task(axis, task, rows[rows["options"] == f"--env-id {task} {MILLION}"])
        final = finals[finals["options"] == f"--env-id {task} {MILLION}"]
        digits = 0 if abs(final["return"].mean()) > 100 else 1
        ten.append([task, *(study.spread(final[x], digits) for x in ("return", "sampled")),
                    *published(task, True, final), *published(task, False, final),
                    number(final["seconds"].median() / 60, 1)])
    picture.suptitle("PPO on ten tasks: return against million steps")
    picture.legend(*axis.get_legend_handles_labels(), loc="lower right",
                   title="compare a marker (± std) with the line of its colour")
    study.save(picture, "ppo_returns")
    for script in REINFORCE, A2C, PPO:
        final = finals[(finals["options"] == HUNDRED) & (finals["script"] == script)]
        _, args = study.load(Job(script))
        threshold, returns = gym.spec(args.env_id).reward_threshold, final["return"]
        three.append([f"`{script}`", args.env_id, study.spread(returns), number(returns.min()),
                      f"{threshold:,g}", study.proportion(returns >= threshold),
                      f"{args.total_steps:,}", number(final["seconds"].median())])
    header = ["task", "evaluation", "in training", "published", "p", "older versions", "p",
              "minutes"]
    short = [[*line[:4], line[-1]] for line in ten]
    return {
        "ten tasks": study.table(header, ten),
        "ten tasks in short": study.table([*header[:3], "published [from]", "minutes"], short),
        "three scripts": study.table(["file", "task", "mean ± std", "lowest", "solved from",
                                      "solved (95% interval)", "steps", "seconds"], three)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
