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
STYLES = ("C0", "-"), ("C1", "--"), ("C2", ":"), ("C4", "-.")
JOBS = [Job(peers.FILE, f"--env-id {task} --total-steps 1e6", setting, seed)
        for task in TASKS for setting in ("defaults", "zoo", "our sizes") for seed in range(1, 6)]


def mean_curve(runs, steps_a_second):
    """The mean over seeds, and over 50,000 steps at a time."""
    millions = (runs["steps"] / 50_000).round() / 20
    runs = runs.assign(millions=millions, minutes=1e6 * millions / steps_a_second / 60)
    of_seeds = runs[millions > 0].groupby(["seed", "millions", "minutes"])["return"].mean()
    return of_seeds.groupby(["millions", "minutes"]).mean().reset_index()


def first_at(curve, goal):
    """When a mean curve first reaches a return."""
    for _, point in curve[curve["return"] >= goal].iterrows():
        return f"{point['millions']:.2f} M, {point['minutes']:.1f} min"
    return "never"


def line(task, learner, curves, finals):
    """Of the table."""
    minutes = number(curves[learner]["minutes"].iloc[-1], 1)
    if learner == "ours":
        return [task, "ours", study.spread(finals["ours"]), "", "", minutes, "", ""]
    gain = study.welch(finals["ours"], finals[learner])
    return [task, f"sb3, {learner}", study.spread(finals[learner]), str(gain), study.p_text(gain.p),
            minutes, first_at(curves["ours"], finals[learner].mean()),
            first_at(curves[learner], finals["ours"].mean())]


def draw(rows):
    ours, speeds = study.read("returns"), study.read("speed")
    ours = ours[(ours["script"] == PPO) & (ours["change"] == "")].assign(change="ours")
    speeds = speeds.groupby(["options", "learner"])["speed"].median()
    picture, panels = study.figure(11, 7, 2, len(TASKS), sharey="col")
    lines = []
    for task, by_steps, by_minutes in zip(TASKS, panels, panels[len(TASKS) :]):
        curves, finals = {}, {}
        for (color, style), (learner, name) in zip(STYLES, LEARNERS.items()):
            runs = ours if learner == "ours" else rows
            runs = runs[runs["options"] == f"--env-id {task} --total-steps 1e6"]
            runs = runs[runs["change"] == learner]
            finals[learner] = runs.groupby("seed")["return"].last()
            speed = speeds[f"--env-id {task} --total-steps 32768", name]
            curves[learner] = mean_curve(runs, speed)
            label = learner if learner == "ours" else f"stable-baselines3, {learner}"
            for axis, unit in (by_steps, "millions"), (by_minutes, "minutes"):
                axis.plot(unit, "return", style, data=curves[learner], color=color, lw=3,
                          label=label)
            beside = [1 + 0.03 * len(finals)] * len(finals[learner])
            by_steps.plot(beside, finals[learner], ".", color=color)
        by_steps.set(title=task, xlabel="million steps", ylabel="return")
        by_minutes.set(xscale="log", xlim=(0.05, 30), xlabel="minutes (log scale)", ylabel="return")
        by_minutes.xaxis.set_major_formatter("{x:g}")
        lines += [line(task, learner, curves, finals) for learner in LEARNERS]
    picture.legend(*by_minutes.get_legend_handles_labels(), loc="outside lower center", ncols=4,
                   handlelength=4, title="lines: means of ten seeds (ours), five (the others); "
                   "dots, in this order: each seed in the last evaluation")
    study.save(picture, "ppo_race")
    return {"race": study.table(["task", "learner", "return", "ours − theirs, 95%", "p", "minutes",
                                 "ours reaches theirs", "theirs reaches ours"], lines)}


if __name__ == "__main__":
    study.main(JOBS, draw, peers.learn)
