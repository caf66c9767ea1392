"""PPO and A2C on other tasks, with settings of their own; and PPO on Humanoid without tanh.

HeldAcrobot is the guide's: save its my_module.py beside this file. Three hours on two cores.
"""

import returns
import study
from study import A2C, PPO, Job, number

SETTINGS = {  # options for other tasks: the script, the first of five seeds
    "--env-id Swimmer-v5 --total-steps 1e6 --gamma 0.999 --gae-lambda 0.98 --rollout-steps 512 "
    "--first-std 1": (PPO, 96),
    "--env-id Hopper-v5 --total-steps 3e5 --rollout-steps 32 --minibatch-size 128": (PPO, 91),
    "--env-id Humanoid-v5 --total-steps 3e6 --learning-rate 3e-4": (PPO, 91),
    "--env-id MountainCarContinuous-v0 --total-steps 1e5 --first-std 2": (PPO, 91),
    "--env-id CartPole-v1 --total-steps 3e5 --gamma 0.99": (A2C, 91),
    "--env-id my_module:HeldAcrobot-v0 --total-steps 1e5": (A2C, 91),
    "--env-id MountainCar-v0 --total-steps 5e5": (A2C, 91),
}
HUMANOID, CHANGES = returns.TASKS["Humanoid-v5"], ("no-tanh", "actions-clipped")
JOBS = [*(Job(script, options, seed=first + i)
          for i in range(5) for options, (script, first) in SETTINGS.items()),
        *(Job(PPO, HUMANOID, change, seed) for seed in range(71, 76) for change in CHANGES)]


def draw(rows):
    lines = []
    for options, runs in rows[rows["options"].isin(SETTINGS)].groupby("options"):
        lines.append([f"`python {SETTINGS[options][0]} {options}`",
                      ", ".join(map(number, runs["return"])),
                      number(runs["return"].mean()), number(runs["seconds"].median() / 60, 1)])
    finals = study.final_rows(study.read("returns"))
    kinds = {"as it is": finals[finals["options"] == HUMANOID]["return"]}
    kinds |= {f"`{change}`": rows[rows["change"] == change]["return"] for change in CHANGES}
    gains = ["", *(study.welch(values, kinds["as it is"]) for values in list(kinds.values())[1:])]
    p_texts = ["", *study.marked([gain.p for gain in gains[1:]])]
    humanoid = [[kind, f"{sum(values > 2000)} of {len(values)}", study.median(values),
                 study.spread(values), gain, p]
                for (kind, values), gain, p in zip(kinds.items(), gains, p_texts)]
    return {"settings": study.table(["command", "five seeds", "mean", "minutes"], lines),
            "humanoid": study.table(["Humanoid-v5", "above 2,000", "median (95%)", "mean ± std",
                                     "difference, 95%", "p"], humanoid)}


if __name__ == "__main__":
    study.main(JOBS, draw)
