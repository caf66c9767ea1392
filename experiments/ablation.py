"""What is each detail of PPO worth? One change at a time, nothing retuned for it."""

import pandas as pd
import study
from study import Job, number
from variants import PPO

TASKS = {"HalfCheetah": Job(PPO, "--env-id HalfCheetah-v5 --total-steps 3e5"),
         "double pendulum": Job(PPO)}
NAMES = {  # an option, to be typed, or one of `variants`
    "--clip-eps 1e9": "no clip, KL limit kept",
    "--max-kl 1e9": "no KL limit, clip kept",
    "--clip-eps 1e9 --max-kl 1e9": "neither clip nor KL limit",
    "--last-std 0.6": "σ stays 0.6",
    "sigma-learned": "σ learned",
    "learning-rate-constant": "learning rate constant",
    "advantages-not-standardised": "advantages not standardised",
    "no-tanh": "actions clipped, no tanh",
    "observations-not-normalised": "observations not normalised",
    "rewards-not-scaled": "rewards not scaled",
    "last-layer-not-small": "last layer not small",
    "time-limits-as-deaths": "time limits as deaths",
    "--num-envs 1 --rollout-steps 2048 --minibatch-size 64 --learning-rate 3e-4":
        "CleanRL's sizes and rate"}


def with_change(job, change, seed):
    if change.startswith("--"):
        return job._replace(options=f"{job.options} {change}".strip(), seed=seed)
    return job._replace(change=change, seed=seed)


JOBS = [with_change(job, change, seed) for seed in range(101, 109)
        for change in ("", *NAMES) for job in TASKS.values()]


def measure(job):
    return study.train(job)[0]


def effects(rows):
    """What each change gains, in percent of the mean without it; pairs of a seed."""
    returns = rows.set_index(study.KEYS)["return"].unstack()
    lines = []
    for task, job in TASKS.items():
        usual = returns.loc[job[:3]]
        for change, name in NAMES.items():
            changed = with_change(job, change, 1)[:3]
            gains = 100 * (returns.loc[changed] - usual) / usual.mean()
            lines.append([task, name, *study.paired(gains)])
    found = pd.DataFrame(lines, columns=["task", "change", *study.Difference._fields])
    return found.assign(holds=study.holm(found["p"]))


def draw(rows):
    found = effects(rows)
    picture, panels = study.figure(12, 7, 1, 2, sharex=True, sharey=True)
    for axis, (task, job) in zip(panels, TASKS.items()):
        for change, gain, low, high, _, holds in found[found["task"] == task].values[:, 1:]:
            axis.plot([low, high], [change, change], color="C0", lw=2)
            axis.plot(gain, change, "o", color="C0", ms=9, mfc="C0" if holds else "white")
            axis.text(1.02, change, number(gain), va="center", transform=axis.get_yaxis_transform())
        axis.axvline(0, color="grey")
        axis.grid(visible=False, axis="y")
        _, args = study.load(job)
        axis.set(title=f"{task}, {args.total_steps:,} steps", xlabel="change in return, %")
    panels[0].invert_yaxis()
    picture.suptitle("What each change costs or gains (filled: significant)")
    return {}, {"ablation": picture}


if __name__ == "__main__":
    study.main("ablation", JOBS, measure)
