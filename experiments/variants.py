"""Changes to a script, one at a time, for studies and for exercises.

    python experiments/variants.py                       lists their names
    python experiments/variants.py NAME FILE             writes the changed script

A change is a list of pairs (old text, new text); each old text occurs exactly once in the script.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REINFORCE, A2C, PPO = "reinforce_mujoco.py", "a2c_vector.py", "ppo_continuous.py"

CHANGES = {
    "advantages-not-standardised": (PPO, [
        ("A = (A - A.mean()) / (A.std(correction=0) + 1e-8)", "A = A")]),
    "rewards-not-scaled": (PPO, [(
        "return (rewards / stats.std).float(), F", "return rewards.float(), F")]),
    "observations-not-normalised": (PPO, [(
        "        agent.obs_stats.update(batch.obs)\n", "")]),
    "no-tanh": (PPO, [("(np.tanh(actions) + 1) / 2", "(actions + 1) / 2")]),
    "last-layer-not-small": (PPO, [("last_gain=0.01", "last_gain=1.0")]),
    "learning-rate-constant": (PPO, [('["lr"] = remaining * args', '["lr"] = args')]),
    "sigma-learned": (PPO, [
        ('self.register_buffer("sigma", torch.ones(outputs))',
         'self.log_sigma = nn.Parameter(torch.full((outputs,), 0.6).log())'),
        ("Normal(mean, self.sigma)", "Normal(mean, self.log_sigma.exp())"),
        ("    for _ in range(epochs):\n",
         "    old_sigma = agent.log_sigma.exp().detach()\n    for _ in range(epochs):\n"),
        ("kl = (((policy.mean - old_means) / agent.sigma) ** 2).sum(-1).mean() / 2",
         "old_policy = torch.distributions.Normal(old_means, old_sigma)\n            "
         "kl = torch.distributions.kl_divergence(old_policy, policy).sum(-1).mean()"),
        ("        agent.sigma.fill_(remaining * args.first_std + "
         "(1 - remaining) * args.last_std)\n", "")]),
    "time-limits-as-deaths": (PPO, [(
        "next_values, batch.terminated, batch.done,", "next_values, batch.done, batch.done,")]),
    "fault-1": (PPO, [(
        "(policy.mean if deterministic else policy.sample()).numpy()", "policy.mean.numpy()")]),
    "fault-2": (PPO, [("targets = advantages + values", "targets = advantages")]),
    "fault-3": (PPO, [("return -torch.min(", "return torch.min(")]),
    "blank-rewards-to-go": (REINFORCE, [
        ("0.0 if terminated else agent.value(torch.tensor(np.array(obs))).item()", "..."),
        ("        G = reward + gamma * G\n", "        G = ...\n"),
        ('"none": 0.0, "mean": rewards_to_go.mean(), "value": values',
         '"none": ..., "mean": ..., "value": ...')]),
    "blank-gae": (PPO, [
        ("    next_values = next_values.masked_fill(terminated, 0)\n", ""),
        ("rewards + gamma * next_values - values  # at first only δ", "..."),
        ("gamma * gae_lambda * advantages[t + 1] * ~done[t]", "...")]),
    "blank-ratio": (PPO, [
        ("(policy.log_prob(actions).sum(-1) - old_log_probs).exp()", "..."),
        ("(((policy.mean - old_means) / agent.sigma) ** 2).sum(-1).mean() / 2", "...")]),
}
CHANGES["blank-gae-a2c"] = A2C, CHANGES["blank-gae"][1]


def changed(file, name=""):
    """The text of a script with a change. ValueError: an old text does not occur just once."""
    text = (ROOT / file).read_text(encoding="utf-8")
    for old, new in CHANGES[name][1] if name else []:
        if text.count(old) != 1:
            raise ValueError(f"{name}: occurs {text.count(old)} times in {file}: {old!r}")
        text = text.replace(old, new)
    return text


def main(arguments):
    if not arguments:
        return print(*CHANGES, sep="\n")
    if len(arguments) != 2 or arguments[0] not in CHANGES:
        sys.exit("usage: python experiments/variants.py NAME FILE (without both it lists names)")
    name, file = arguments
    script = CHANGES[name][0]
    in_place = name.startswith("blank") and Path(file).name == script  # an exercise
    if Path(file).name in (REINFORCE, A2C, PPO) and not in_place:
        sys.exit(f"not written: {file} has the name of a script; take another, such as my_ppo.py")
    try:
        Path(file).write_text(changed(script, name), encoding="utf-8")
    except ValueError:  # whose message would show solutions
        sys.exit(f"{script} has been changed: {name} needs a fresh copy of it")


if __name__ == "__main__":
    main(sys.argv[1:])
