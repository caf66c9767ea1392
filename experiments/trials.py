"""Which defaults should PPO have? Candidates against today's, on seeds used for nothing else.

The rule, fixed before the first run: a candidate is taken if the geometric mean over the five tasks
of its mean return, divided by the default's on the same seeds, is at least 1.05 and none of the
five ratios is below 0.92; or if it at least halves the lost pendulums and that mean is at least
0.98. A pendulum is lost if its episode ends before the time limit.

REINFORCE keeps its defaults if twenty of twenty agents hold the pole in all of a hundred episodes.

With --only TASK a part is measured; `report` makes a table of what is there.
"""

import ablation
import numpy as np
import study
from scipy import stats
from study import PPO, REINFORCE, Job

PENDULUM = Job(PPO, "--env-id InvertedDoublePendulum-v5 --num-evals 1 --eval-episodes 150")
CANDIDATES = ["--last-std 0.15", "--last-std 0.2", "--last-std 0.3", "critic-goes-on",
              "--learning-rate 7e-4", "--learning-rate 5e-4", "--gae-lambda 0.92"]
TABLES = {task: (Job(PPO, f"--env-id {task}-v5 --total-steps 1e6 --num-evals 1 --eval-episodes 50"),
                 CANDIDATES) for task in ("HalfCheetah", "Hopper", "Walker2d", "Ant", "Humanoid")}
OF_CANDIDATE = {
    candidate: [ablation.with_change(usual, candidate, seed) for seed in range(701, 717)
                for usual in (PENDULUM, *(usual for usual, _ in TABLES.values() if seed <= 706))]
    for candidate in ("", *CANDIDATES)}
POLES = [Job(REINFORCE, "--num-evals 1 --eval-episodes 100", seed=seed) for seed in range(701, 721)]
JOBS = sorted(sum(OF_CANDIDATE.values(), POLES), key=lambda job: job.seed)


def count_lost(steps):
    """Of all that `step` returned: how many first episodes ended before the time limit."""
    terminated, truncated = (np.array([step[i] for step in steps]) for i in (2, 3))
    ends = (terminated | truncated).argmax(0)
    return (terminated & ~truncated)[ends, range(ends.size)].sum()


def measure(job):
    """The last evaluation."""
    module, args = study.load(job)
    evaluate, steps = module.evaluate, []

    def evaluate_and_record(agent, envs, seed):
        step = envs.step
        envs.step = lambda actions: steps.append(step(actions)) or steps[-1]
        steps.clear()
        returned = evaluate(agent, envs, seed)
        envs.step = step
        return returned

    module.evaluate = evaluate_and_record
    final = study.run(module, args)[0].iloc[-1]
    return [{"steps": final["env_step"], "seconds": final["seconds"],
             "return": final["eval_return"], "lost": count_lost(steps)}]


def taken(ratios, lost, usually_lost):
    """The rule."""
    mean = stats.gmean(ratios) if len(ratios) else 0
    return (mean >= 1.05 and min(ratios) >= 0.92) or (2 * lost <= usually_lost > 0 and mean >= 0.98)


def draw(rows):
    found, lines = ablation.effects(rows, TABLES).set_index(["change", "table"])["gain"], []
    lost = rows.set_index(study.KEYS).reindex(columns=["lost"])["lost"].unstack()
    done = set(rows[study.KEYS].itertuples(index=False, name=None))
    for candidate in CANDIDATES if len(rows) else ():
        ratios = {task: 1 + found[candidate, task] / 100 for task in TABLES
                  if (candidate, task) in found.index}
        jobs = [job[:3] for job in (PENDULUM, ablation.with_change(PENDULUM, candidate))]
        pairs = lost.reindex(jobs).T.dropna()
        usual, tried = pairs.sum().astype(int)
        verdict = "yes" if taken([*ratios.values()], tried, usual) else "no"
        if not done.issuperset(OF_CANDIDATE[candidate]):
            verdict = "runs are missing"
        lines.append([f"`{candidate}`", *(f"{ratios[task]:.2f}" if task in ratios else ""
                                          for task in TABLES),
                      f"{stats.gmean([*ratios.values()]):.2f}" if ratios else "",
                      f"{tried} of {150 * len(pairs)}", usual,
                      verdict])
    poles = rows[rows["script"] == REINFORCE]
    return {"trials": study.table(["candidate ÷ default", *TABLES, "geometric mean", "lost",
                                   "default: lost", "taken"], lines),
            "poles": study.table(["REINFORCE: agents", "lost"], [
                [len(poles), f"{poles['lost'].sum():.0f} of {100 * len(poles)}"]])}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
