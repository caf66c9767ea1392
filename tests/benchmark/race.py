"""Ours against stable-baselines3: return against steps and against minutes, in both directions.

Ours are the runs of `returns`, seeds 71 to 75. Minutes are steps divided by the steps a second that
`speed` measured side by side, as machines differ. The peers take nine hours on two cores, of which
those with our sizes take a quarter of an hour.
"""

import peers
import study
from study import PPO, Job, number

TASKS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5"
SPEEDS = {"ours": "ours", "defaults": "stable-baselines3", "zoo": "its zoo's settings",
          "our sizes": "our sizes"}  # the learners, and their names in `speed`
JOBS = [Job("peers.py", f"--env-id {task} --total-steps 1e6", setting, seed)
        for task in (*TASKS, "LunarLander-v3") for setting in ("defaults", "zoo", "our sizes")
        for seed in range(1, 6)]


def reach(course, goal):
    """When a mean over seeds first reaches a goal: steps, minutes."""
    x = course[course["return"] >= goal]
    return f"{x['steps'].iloc[0] / 1000:,.0f}k, {x['minutes'].iloc[0]:.1f}" if len(x) else "never"


def draw(rows):
    ours, speeds = study.read("returns"), study.read("speed")
    ours = ours[(ours["script"] == PPO) & (ours["seed"] <= 75)].assign(change="ours")
    speeds = speeds.groupby(["options", "learner"])["speed"].median()
    picture, panels = study.figure(14, 8, 2, len(TASKS))
    panels, lines = list(panels), []
    for column, task in enumerate(TASKS):
        courses, runs = {}, {}
        for color, style, (learner, name) in zip(range(4), ("-", "--", ":", "-."), SPEEDS.items()):
            x = ours if learner == "ours" else rows
            x = x[(x["options"] == f"--env-id {task} --total-steps 1e6") & (x["change"] == learner)]
            speed = speeds[f"--env-id {task} --total-steps 32768", name]
            x = x.assign(minutes=x["steps"] / speed / 60)
            for unit, row in ("steps", 0), ("minutes", 1):
                study.curves(x, unit, panels[column + row * len(TASKS)], label=learner,
                             color=f"C{color}", style=style, title=task)
            courses[learner] = x.groupby("steps")[["return", "minutes"]].mean().reset_index()
            runs[learner] = x.groupby("seed")["return"].last()
        panels[column + len(TASKS)].set(xscale="log", xlim=(0.1, 50))
        panels[column + len(TASKS)].xaxis.set_major_formatter("{x:g}")
        for learner, course in courses.items():
            passages = (learner, learner), ("ours", learner), (learner, "ours")
            lines.append([task, learner, study.spread(runs[learner]),
                          number(course["minutes"].iloc[-1], 1), *(
                              reach(courses[x], runs[y].mean()) for x, y in (
                                  passages if learner != "ours" else passages[:1]))])
            lines[-1] += [""] * (7 - len(lines[-1]))
    for panel in panels:
        panel.get_legend().remove()
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    study.save(picture, "ppo_race")
    header = ["task", "learner", "mean ± std", "minutes", "reaches its mean at",
              "ours reaches that at", "it reaches ours at"]
    lander = study.last(rows[rows["options"].str.contains("Lunar")]).groupby("change")["return"]
    return {"race": study.table(header, lines), "A2C race": study.table(
        ["stable-baselines3's A2C", "mean ± std", "every seed"],
        [[setting, study.spread(x), study.every(x)] for setting, x in lander])}


if __name__ == "__main__":
    study.main(JOBS, draw, peers.learn)
