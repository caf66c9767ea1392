"""A2C: what does `--randomize` cost on the usual moon, what does it gain on random ones?"""

import returns
import study
from study import Job, spread
from variants import A2C

MOONS = {"usual": "", "random": "--randomize"}
JOBS = [Job(A2C, options, seed=seed) for seed in range(101, 111) for options in MOONS.values()]


def measure(job):
    """Each agent plays a hundred episodes on moons of both kinds."""
    row, weights = study.train(job)
    return row | {f"return on {moon} moons": returns.hundred_episodes(job, weights, options)
                  for moon, options in MOONS.items()}


def draw(rows):
    rows, lines = rows.set_index(["options", "seed"]), []
    for moon in MOONS:
        usual, randomized = (rows.loc[kind, f"return on {moon} moons"] for kind in MOONS.values())
        gains = randomized - usual  # of pairs of a seed
        lines.append([f"{moon} moons", spread(usual), spread(randomized), study.paired(gains),
                      f"{sum(gains > 0)} of {len(gains)}"])
    return {"randomize": study.table(
        ["a hundred episodes on", "trained as usual", "trained with `--randomize`",
         "difference, 95%", "higher"], lines)}, {}


if __name__ == "__main__":
    study.main("randomize", JOBS, measure)
