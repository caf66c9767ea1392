"""A2C in other gravity and wind than it was trained in, with and without --randomize.

Ten agents of each kind, twenty episodes in each of thirty worlds; ten more of each kind, a hundred
episodes on the usual moon and on random moons. An hour on two cores.
"""

import itertools

import compare
import pages
import study
from study import Job
from variants import A2C

GRAVITY, WIND = (-2.0, -4.0, -6.0, -8.0, -10.0, -11.9), (0.0, 5.0, 10.0, 15.0, 20.0)
KINDS, MOONS = ("", "--randomize"), ("usual", "random")
JOBS = [Job(A2C, options, seed=seed) for seed in (*range(71, 81), *range(1, 11))
        for options in KINDS]
WORLDS = {  # queries of the rows
    "the usual one": "gravity == -10 and wind == 0",
    "gravity as in training: −8 to −11.9, all winds": "gravity < -7",
    "weaker: −2 to −6, all winds": "gravity > -7",
    "ten other agents: the usual one": "moon == 'usual'",
    "ten other agents: random moons": "moon == 'random'"}


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
        20, 10**6, gravity=gravity, enable_wind=wind > 0, wind_power=wind)}
        for gravity, wind in itertools.product(GRAVITY, WIND)]


def draw(rows):
    lines, p_values = [], []
    for world, query in WORLDS.items():
        agents = rows.query(query).groupby(["options", "seed"])["return"].mean()
        usual, randomized = (agents[kind] for kind in KINDS)
        gain = compare.paired(randomized - usual)  # of pairs of a seed
        p_values.append(gain.p)
        lines.append([world, compare.spread(usual), compare.spread(randomized), str(gain),
                      f"{sum(randomized < usual)} of {len(usual)}"])
    return {"robustness": pages.table(
        ["moons", "trained as usual", "with --randomize", "difference, 95%", "lower", "p"],
        [[*line, p] for line, p in zip(lines, compare.marked(p_values))])}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
