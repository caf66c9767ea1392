"""The answers to the exercises: every seed of every change."""

from benchmark import common
from benchmark.ablation import changed
from benchmark.common import A2C, PPO, REINFORCE, number

FIGURES = ()
CHANGES = {
    "no baseline": (REINFORCE, "--baseline none"),
    "a short sight": (REINFORCE, "--gamma 0.9"),
    "one environment": (A2C, "--num-envs 1 --rollout-steps 512"),
    "λ = 0": (A2C, "--gae-lambda 0"),
    "λ = 1": (A2C, "--gae-lambda 1"),
    "no entropy bonus": (A2C, "--entropy-coef 0"),
    "neither clip nor KL limit": (PPO, "--clip-eps 1e9 --max-kl 1e9"),
    "one epoch": (PPO, "--epochs 1"),
    "time limits are deaths": (PPO, "time-limits-as-deaths.patch"),
    "observations not normalised": (PPO, "observations-not-normalised.patch"),
    "σ stays as it is": (PPO, "sigma-fixed.patch"),
    "another reward": (PPO, "another-reward.patch"),
}


def jobs(quick):
    found = []
    for name, (script, change) in list(CHANGES.items())[:1 if quick else None]:
        flags, variant = changed(change)
        found += common.training_jobs(script, quick, flags, common.SEEDS[script][:5],
                                      variant=variant, part=name)
    return found


measure = common.train


def report(data, draw):
    last = common.last_rows(data)
    rows = []
    for i, (name, (script, _)) in enumerate(CHANGES.items(), start=1):
        x = last[last["part"] == name]["return_mean"]
        rows.append([i, name, f"`{script}.py`", ", ".join(number(y, 0) for y in x)])
    return {"answers": common.table(["", "change", "script", "return of each seed"], rows)}
