"""PPO and A2C on other tasks, with settings of their own.

HeldAcrobot is the guide's: save its my_module.py beside this file. Over an hour on two cores.
"""

import pages
import study
from compare import number
from study import Job
from variants import A2C, PPO

SETTINGS = {  # options for other tasks: the script, the first of five seeds
    "--env-id Swimmer-v5 --total-steps 1e6 --gamma 0.999 --gae-lambda 0.98 --rollout-steps 512 "
    "--first-std 1": (PPO, 96),
    "--env-id Humanoid-v5 --total-steps 2e6 --learning-rate 3e-4": (PPO, 91),
    "--env-id MountainCarContinuous-v0 --total-steps 1e5 --first-std 2": (PPO, 91),
    "--env-id CartPole-v1 --total-steps 3e5 --gamma 0.99": (A2C, 91),
    "--env-id my_module:HeldAcrobot-v0 --total-steps 1e5": (A2C, 91),
}
JOBS = [Job(script, options, seed=first + i)
        for i in range(5) for options, (script, first) in SETTINGS.items()]


def draw(rows):
    lines = []
    for options, runs in rows.groupby("options"):
        lines.append([f"`python {SETTINGS[options][0]} {options}`",
                      ", ".join(map(number, runs["return"])),
                      number(runs["return"].mean()), number(runs["seconds"].median() / 60, 1)])
    return {"settings": pages.table(["command", "five seeds", "mean", "minutes"], lines)}


if __name__ == "__main__":
    study.main(JOBS, draw)
