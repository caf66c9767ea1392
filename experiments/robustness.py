"""A2C in other gravity and wind than it was trained in, with and without --randomize.

Ten agents of each kind, twenty episodes in each of thirty worlds. Half an hour on two cores.
"""

import itertools

import study
from study import A2C, Job, number

GRAVITY, WIND = (-2.0, -4.0, -6.0, -8.0, -10.0, -11.9), (0.0, 5.0, 10.0, 15.0, 20.0)
JOBS = [Job(A2C, options, seed=seed) for seed in range(71, 81) for options in ("", "--randomize")]


def measure(job):
    """A row for each world, with episodes that no training saw, alike for all agents."""
    module, args = study.load(job)
    _, weights = study.train(job)
    rows = []
    for gravity, wind in itertools.product(GRAVITY, WIND):
        envs = module.make_envs(args.env_id, 20, "NextStep", False, gravity=gravity,
                                enable_wind=wind > 0, wind_power=wind)
        agent = module.Agent(envs, args.hidden_size)
        agent.load_state_dict(weights)
        result = module.evaluate(agent, envs, 10**9)
        rows.append({"gravity": gravity, "wind": wind, "return": result})
    return rows


def draw(rows):
    from scipy import stats

    usual_moon = rows[(rows["gravity"] == -10) & (rows["wind"] == 0)]
    lines, worlds = [], {"the usual one": usual_moon}
    trained = rows["gravity"] < -7  # with --randomize
    worlds |= {"gravity as in training: −8 to −11.9, all winds": rows[trained],
               "weaker: −2 to −6, all winds": rows[~trained]}
    for name, x in worlds.items():
        agents = x.groupby(["options", "seed"])["return"].mean()
        usual, randomized = agents[""], agents["--randomize"]
        test = stats.ttest_ind(randomized, usual, equal_var=False)
        gain, margin = study.interval(test)
        lines.append([name, study.spread(usual), study.spread(randomized),
                      f"{number(gain)} ± {number(margin)}", study.p_value(test)])
    header = ["moons", "trained as usual", "trained with --randomize", "difference, 95%", "p"]
    return {"robustness": study.table(header, lines)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
