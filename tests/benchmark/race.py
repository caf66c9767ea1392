"""Ours against stable-baselines3: return against steps and against minutes, in both directions.

Ours are the ten runs of `returns`. Minutes are steps divided by the steps a second that `speed`
measured side by side, as machines differ. The peers take some three hours on two cores.
"""

import peers
import study
from study import PPO, Job, number

TASKS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5"
LEARNERS = {"ours": "ours", "defaults": "stable-baselines3", "zoo": "its zoo's settings",
            "our sizes": "our sizes"}  # and their names in `speed`
JOBS = [Job("peers.py", f"--env-id {task} --total-steps 1e6", setting, seed)
        for task in TASKS for setting in ("defaults", "zoo", "our sizes") for seed in range(1, 6)]


def reach(course, goal):
    """When a mean over seeds first reaches a goal: million steps, minutes."""
    for _, x in course[course["return"] >= goal].iterrows():
        return f"{x['million steps']:.2f} M, {x['minutes']:.1f} min"
    return "never"


def lead(returns, learner):
    """What ours has more, and p of Welch's test."""
    from scipy import stats
    if learner == "ours":
        return ""
    test = stats.ttest_ind(returns["ours"], returns[learner], equal_var=False)
    gain, margin = study.interval(test)
    return f"{number(gain)} ± {number(margin)}, p = {test.pvalue:.2g}"


def draw(rows):
    ours, speeds = study.read("returns"), study.read("speed")
    ours = ours[(ours["script"] == PPO) & (ours["change"] == "")].assign(change="ours")
    speeds = speeds.groupby(["options", "learner"])["speed"].median()
    picture, panels = study.figure(14, 8, 2, len(TASKS), sharey="col")
    panels, lines = list(panels), []
    for column, task in enumerate(TASKS):
        courses, last, tenth = {}, {}, {}
        styles = ("C0", "-"), ("C1", "--"), ("C2", ":"), ("C4", "-.")
        for (color, style), (learner, name) in zip(styles, LEARNERS.items()):
            x = ours if learner == "ours" else rows
            x = x[(x["options"] == f"--env-id {task} --total-steps 1e6") & (x["change"] == learner)]
            last[learner] = x.groupby("seed")["return"].last()
            tenth[learner] = x[x["steps"] > 890_000].groupby("seed")["return"].mean()
            millions = (x["steps"] / 50_000).round() / 20  # means over 50,000 steps
            speed = speeds[f"--env-id {task} --total-steps 32768", name]
            x = x.assign(**{"million steps": millions, "minutes": 1e6 * millions / speed / 60})
            x = x[millions > 0].groupby(["seed", "million steps", "minutes"], as_index=False)
            x = x["return"].mean()
            label = learner if learner == "ours" else f"stable-baselines3, {learner}"
            courses[learner] = x.groupby(["million steps", "minutes"], as_index=False)[
                "return"].mean()
            for unit, axis in zip(("million steps", "minutes"), panels[column :: len(TASKS)]):
                study.curves(x, unit, axis, label=label, color=color, title=task)
                axis.lines[-1].set_linestyle(style)
                axis.get_legend().remove()
        axis.set(xscale="log", xlim=(0.05, 30))
        axis.xaxis.set_major_formatter("{x:g}")
        for learner, course in courses.items():
            passages = (reach(courses["ours"], tenth[learner].mean()),
                        reach(course, tenth["ours"].mean()))
            lines.append([task, learner, study.spread(last[learner]), lead(last, learner),
                          study.spread(tenth[learner]), lead(tenth, learner),
                          number(course["minutes"].iloc[-1], 1),
                          *(passages if learner != "ours" else ("", ""))])
    picture.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=4,
                   title="thick: mean; thin: each seed")
    study.save(picture, "ppo_race")
    return {"race": study.table(["task", "learner", "last evaluation", "ours − it", "last tenth",
                                 "ours − it", "minutes", "ours passes it at",
                                 "it passes ours at"], lines)}


if __name__ == "__main__":
    study.main(JOBS, draw, peers.learn)
