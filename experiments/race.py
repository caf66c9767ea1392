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
        return "", ""
    test = stats.ttest_ind(returns["ours"], returns[learner], equal_var=False)
    gain, margin = study.interval(test)
    return f"{number(gain)} ± {number(margin)}", study.p_value(test)


def draw(rows):
    ours, speeds = study.read("returns"), study.read("speed")
    ours = ours[(ours["script"] == PPO) & (ours["change"] == "")].assign(change="ours")
    speeds = speeds.groupby(["options", "learner"])["speed"].median()
    picture, panels = study.figure(11, 7, 2, len(TASKS), sharey="col")
    lines = []
    for column, task in enumerate(TASKS):
        courses, last = {}, {}
        styles = ("C0", "-"), ("C1", "--"), ("C2", ":"), ("C4", "-.")
        for (color, style), (learner, name) in zip(styles, LEARNERS.items()):
            x = ours if learner == "ours" else rows
            x = x[(x["options"] == f"--env-id {task} --total-steps 1e6") & (x["change"] == learner)]
            last[learner] = x.groupby("seed")["return"].last()
            millions = (x["steps"] / 50_000).round() / 20  # means over 50,000 steps
            speed = speeds[f"--env-id {task} --total-steps 32768", name]
            x = x.assign(**{"million steps": millions, "minutes": 1e6 * millions / speed / 60})
            x = x[millions > 0].groupby(["seed", "million steps", "minutes"], as_index=False)
            x = x["return"].mean().groupby(["million steps", "minutes"], as_index=False)
            courses[learner] = x["return"].mean()
            label = learner if learner == "ours" else f"stable-baselines3, {learner}"
            for unit, axis in zip(("million steps", "minutes"), panels[column :: len(TASKS)]):
                axis.plot(unit, "return", style, data=courses[learner], color=color, lw=3,
                          label=label)
                axis.set(title=task if unit != "minutes" else "", xlabel=unit, ylabel="return")
            strip = [1 + 0.03 * len(last)] * len(last[learner])
            panels[column].plot(strip, last[learner], ".", color=color)
        axis.set(xscale="log", xlim=(0.05, 30), xlabel="minutes (log scale)")
        axis.xaxis.set_major_formatter("{x:g}")
        for learner, course in courses.items():
            passages = (reach(courses["ours"], last[learner].mean()),
                        reach(course, last["ours"].mean()))
            label = learner if learner == "ours" else f"sb3, {learner}"
            lines.append([task, label, study.spread(last[learner]), *lead(last, learner),
                          number(course["minutes"].iloc[-1], 1),
                          *(passages if learner != "ours" else ("", ""))])
    picture.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=4,
                   handlelength=4, title="lines: means of ten seeds (ours), five (the others); "
                   "dots, in this order: each seed in the last evaluation")
    study.save(picture, "ppo_race")
    return {"race": study.table(["task", "learner", "return", "ours − theirs, 95%", "p", "minutes",
                                 "ours reaches theirs", "theirs reaches ours"], lines)}


if __name__ == "__main__":
    study.main(JOBS, draw, peers.learn)
