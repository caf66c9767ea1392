"""A2C in other gravity and wind than it was trained in, with and without --randomize.

Ten agents of each kind, twenty episodes in each of thirty worlds; ten more of each kind, a hundred
episodes on the usual moon and on random moons. An hour on two cores.
"""

import itertools

import study
from scipy import stats
from study import A2C, Job

GRAVITY, WIND = (-2.0, -4.0, -6.0, -8.0, -10.0, -11.9), (0.0, 5.0, 10.0, 15.0, 20.0)
KINDS, MOONS = {"": "as usual", "--randomize": "with --randomize"}, ("usual", "random")
JOBS = [Job(A2C, options, seed=seed) for seed in (*range(71, 81), *range(1, 11))
        for options in KINDS]


def measure(job):
    """A row for each world, with episodes that no training saw, alike for all agents."""
    module, args = study.load(job)
    _, weights = study.run(module, args)

    def play(count, seed, randomize=False, **physics):
        args.randomize = randomize
        envs = module.make_envs(args, count, **physics)
        agent = module.Agent(
            envs.single_observation_space, envs.single_action_space, args.hidden_size)
        agent.load_state_dict(weights)
        return module.evaluate(agent, envs, seed)

    if job.seed <= 10:  # as `--watch AGENT.pt --seed 99 --eval-episodes 100` does
        return [{"moon": moon, "return": play(100, 99, moon == "random")} for moon in MOONS]
    return [{"gravity": gravity, "wind": wind, "return": play(
        20, 10**9, gravity=gravity, enable_wind=wind > 0, wind_power=wind)}
        for gravity, wind in itertools.product(GRAVITY, WIND)]


def means(rows):
    """Of each agent: a column for each kind, a row for each seed."""
    return rows.groupby(["seed", "options"])["return"].mean().unstack()


def draw(rows):
    usual_moon = means(rows[(rows["gravity"] == -10) & (rows["wind"] == 0)])
    worlds, lines = {"the usual one": usual_moon}, []
    worlds["gravity as in training: −8 to −11.9, all winds"] = means(rows[rows["gravity"] < -7])
    worlds["weaker: −2 to −6, all winds"] = means(rows[rows["gravity"] > -7])
    for name, agents in worlds.items():
        gain = study.welch(agents["--randomize"], agents[""])
        lines.append([name, *(study.spread(agents[kind]) for kind in KINDS), str(gain),
                      study.p_text(gain.p)])
    header = ["moons", "trained as usual", "trained with --randomize", "difference, 95%", "p"]
    moons = {moon: means(rows[rows["moon"] == moon]) for moon in MOONS}
    watched = [[name, *(study.spread(moons[moon][kind]) for moon in MOONS)]
               for kind, name in KINDS.items()]
    lower = [sum(x["--randomize"] < x[""]) for x in (usual_moon, moons["usual"])]
    count, pairs = sum(lower), len(usual_moon) + len(moons["usual"])
    signs = [[*lower, f"{count} of {pairs}", study.p_text(stats.binomtest(count, pairs).pvalue)]]
    return {
        "robustness": study.table(header, lines),
        "moons": study.table(["trained", "usual moon", "random moons"], watched),
        "sign test": study.table(["lower with --randomize: seeds 71 to 80", "seeds 1 to 10",
                                  "in all", "p"], signs)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
