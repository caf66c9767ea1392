"""A2C: what does `--randomize` cost on the usual moon, what does it gain on random ones?"""

import study
from study import Job, spread
from variants import A2C

MOONS = {"usual": "", "random": "--randomize"}
JOBS = [Job(A2C, options, seed=seed) for seed in range(101, 111) for options in MOONS.values()]


def measure(job):
    """Each agent plays a hundred episodes on moons of both kinds."""
    row, weights = study.train(job)
    for moon, options in MOONS.items():
        module, args = study.load(job._replace(options=options))
        envs = module.make_envs(args, 100)
        agent = module.Agent(envs.single_observation_space, envs.single_action_space,
                             args.hidden_size)
        agent.load_state_dict(weights)
        row[f"return on {moon} moons"] = module.evaluate(agent, envs, job.seed)
    return row


def draw(rows):
    rows, lines = rows.set_index(["options", "seed"]), []
    for moon in MOONS:
        usual, randomized = (rows.loc[kind, f"return on {moon} moons"] for kind in MOONS.values())
        lines.append([f"{moon} moons", spread(usual), spread(randomized),
                      study.paired(randomized - usual)])  # of a seed
    return {"randomize": study.table(["a hundred episodes on", "trained as usual",
                                      "trained with `--randomize`", "difference, 95%"], lines)}, {}


if __name__ == "__main__":
    study.main("randomize", JOBS, measure)
