"""The answers to the exercises of docs/exercises.md: every seed of every change."""

from benchmark import common
from benchmark.common import A2C, PPO, REINFORCE, number

FIGURES = ()
CHEETAH = "--env-id HalfCheetah-v5 --total-steps 300000"
CHANGES = {  # its number in the sheet: script, flags, patch
    "REINFORCE as it is": (REINFORCE, "", ""),
    "1": (REINFORCE, "--baseline none", ""),
    "2": (REINFORCE, "--gamma 0.9", ""),
    "A2C as it is": (A2C, "", ""),
    "3": (A2C, "--gae-lambda 0", ""),
    "4": (A2C, "--gae-lambda 1", ""),
    "5": (A2C, "--num-envs 1 --rollout-steps 512", ""),
    "PPO as it is": (PPO, CHEETAH, ""),
    "6": (PPO, f"{CHEETAH} --clip-eps 1e9 --max-kl 1e9", ""),
    "7": (PPO, f"{CHEETAH} --epochs 1", ""),
    "8": (PPO, f"{CHEETAH} --first-std 0.03 --last-std 0.03", ""),
    "9": (PPO, CHEETAH, "observations-not-normalised"),
    "10": (PPO, CHEETAH, "time-limits-as-deaths"),
    "11": (PPO, CHEETAH, "another-reward"),
    "12, file 1": (PPO, CHEETAH, "fault-1"),
    "12, file 2": (PPO, CHEETAH, "fault-2"),
    "12, file 3": (PPO, CHEETAH, "fault-3"),
}


def jobs(quick):
    found = []
    for name, (script, flags, variant) in list(CHANGES.items())[:2 if quick else None]:
        found += common.training_jobs(script, quick, flags, common.SEEDS[script][:5],
                                      variant=variant, part=name)
    return found


measure = common.train


def report(data, draw):
    last = common.last_rows(data)
    rows = []
    for name in CHANGES:
        x = last[last["part"] == name]
        rows.append([name, *(", ".join(number(y, 0) for y in x[column])
                             for column in ("return_mean", "train_return"))])
    return {"answers": common.table(
        ["exercise", "return in evaluation, each seed", "in training, last 100 episodes"], rows)}
