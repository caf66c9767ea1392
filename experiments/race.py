"""Ours against stable-baselines3 and CleanRL: returns against steps and against minutes.

Ours are the ten runs of `returns`. Minutes are steps divided by the steps a second that `speed`
measured side by side, as machines differ. stable-baselines3 takes some three hours on two cores;
CleanRL, which logs its returns in training, is measured if CLEANRL is the path of its file.
"""

import pandas as pd
import peers
import returns
import seaborn as sns
import study
from study import Job

TASKS = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5"
STYLES = {"ours": ("C0", "-"), "defaults": ("C1", "--"), "zoo": ("C2", ":"),
          "our sizes": ("C4", "-."), "CleanRL": ("C3", (0, (5, 1, 1, 1, 1, 1)))}
COLUMNS = dict.fromkeys(STYLES, "return") | {"CleanRL": "sampled"}
BROKEN = "Hopper-v5", "zoo"  # all seeds stop near 1,000: not what the zoo publishes
JOBS = [*(Job(peers.FILE, returns.TASKS[task], setting, seed) for task in TASKS
          for setting in ("defaults", "zoo", "our sizes") for seed in range(1, 6)),
        *(Job(peers.FILE, returns.TASKS[task], "CleanRL", seed)
          for seed in range(101, 111) for task in (*TASKS, returns.PENDULUM))]


def draw_task(panels, task, learners, speeds):
    """The means over seeds, of 50,000 steps at a time; bands: 95% of the mean."""
    for learner, runs in learners.items():
        millions = (runs["steps"] / 50_000).round() / 20
        curve = runs[millions > 0].groupby(["seed", millions])[COLUMNS[learner]].mean()
        curve = curve.rename("return").reset_index()
        curve["minutes"] = 1e6 * curve["steps"] / speeds.get(learner, float("nan")) / 60
        color, dashes = STYLES[learner] if (task, learner) != BROKEN else ("darkgrey", ":")
        for axis, unit in zip(panels, ("steps", "minutes")):
            sns.lineplot(curve, x=unit, y="return", errorbar=("se", 1.96), ls=dashes, lw=3,
                         color=color, err_kws={"alpha": 0.15}, ax=axis,
                         label=learner.replace("CleanRL", "CleanRL,\nin training"))
    by_steps, by_minutes = panels
    by_steps.set(title=task, xlabel="million steps", xticks=[0, 0.5, 1])
    study.name_ends(by_steps)
    by_minutes.set(xscale="log", xlabel="minutes (log scale)")
    by_minutes.xaxis.set_major_formatter("{x:g}")
    by_minutes.get_legend().remove()


def lines_of(task, learners):
    """Of the table."""
    finals = {learner: study.final_rows(runs) for learner, runs in learners.items()}
    for learner, runs in finals.items():
        ours, theirs = finals["ours"][COLUMNS[learner]], runs[COLUMNS[learner]]
        name = {"ours": "ours", "CleanRL": "CleanRL, in training"}.get(learner, f"sb3, {learner}")
        result = ["", None, "set aside" if (task, learner) == BROKEN else ""]
        if learner == "CleanRL":
            yield [task, f"ours, in training ({len(ours)})", study.spread(ours), *result]
        if learner != "ours" and (task, learner) != BROKEN:
            gain = study.welch(ours, theirs)
            result = [str(gain), gain.p, "ours above" if gain.gain > 0 else "ours below"]
        yield [task, f"{name} ({len(theirs)})", study.spread(theirs), *result]


def draw(rows):
    rows = pd.concat([study.read("returns").replace({"change": {"": "ours"}}), rows])
    speeds = study.read("speed").groupby(["options", "learner"])["speed"].median()
    picture, panels = study.figure(13, 9, 2, len(TASKS), sharey="col")
    lines = []
    for task in *TASKS, returns.PENDULUM:
        runs = rows[rows["options"] == returns.TASKS[task]]
        learners = {learner: runs[runs["change"] == learner] for learner in STYLES
                    if learner in set(runs["change"])}
        if len(learners) > 1:  # the pendulum has CleanRL only
            lines += lines_of(task, learners)
        if task in TASKS:
            draw_task(panels[TASKS.index(task) :: len(TASKS)], task, learners,
                      speeds[f"--env-id {task} --total-steps 32768"])
    table = pd.DataFrame(lines, columns=["task", "learner (seeds)", "return",
                                         "ours − theirs, 95%", "p", "verdict"])
    p_texts = pd.Series(study.marked(table["p"].astype(float)))
    unclear = (p_texts != "") & ~p_texts.str.contains("*", regex=False)
    table = table.assign(p=p_texts, verdict=table["verdict"].mask(unclear, "cannot tell"))
    above, below = (sum(table["verdict"] == f"ours {where}") for where in ("above", "below"))
    picture.suptitle(f"Our PPO is significantly above others' in {above} of "
                     f"{above + below + sum(unclear)} comparisons, below in {below}\n"
                     "(stable-baselines3: defaults, zoo, our sizes; bands: 95% of the mean)")
    study.save(picture, "ppo_race")
    return {"race": study.table(table, table.to_numpy())}


if __name__ == "__main__":
    study.main([job for job in JOBS if peers.CLEANRL or job.change != "CleanRL"], draw, peers.learn)
