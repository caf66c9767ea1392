"""A2C in other gravity and wind than it was trained in, with and without --randomize.

Ten agents of each kind, twenty episodes in each of thirty worlds. Half an hour on two cores.
"""

import itertools

import seaborn as sns
import study
from study import A2C, Job, number

GRAVITY, WIND = (-2.0, -4.0, -6.0, -8.0, -10.0, -11.9), (0.0, 5.0, 10.0, 15.0, 20.0)
KINDS = {"": "as usual", "--randomize": "with --randomize"}
JOBS = [Job(A2C, options, seed=seed) for seed in range(71, 81) for options in KINDS]


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


def line(name, rows):
    """What the two kinds of agents have on average, and their difference."""
    from scipy import stats

    x = rows.groupby(["options", "seed"])["return"].mean()
    test = stats.ttest_ind(x["--randomize"], x[""], equal_var=False)
    gain, margin = study.interval(test)
    return [name, *(study.spread(x[kind]) for kind in KINDS), f"{number(gain)} ± {number(margin)}"]


def draw(rows):
    lines = [line("all thirty", rows),
             line("the usual one", rows[(rows["gravity"] == -10) & (rows["wind"] == 0)])]
    for gravity in reversed(GRAVITY):
        lines.append(line(f"gravity {number(gravity, 1)}, all winds",
                          rows[rows["gravity"] == gravity]))
    picture, panels = study.figure(13, 4, 1, len(WIND), sharey=True)
    for axis, wind in zip(panels, WIND):
        x = rows[rows["wind"] == wind].assign(trained=rows["options"].map(KINDS))
        sns.lineplot(x, x="gravity", y="return", hue="trained", style="trained", markers=True,
                     legend=wind == 0, ax=axis)
        axis.set_title(f"wind {wind:g}")
    picture.suptitle("Ten agents of each kind: mean and its 95% interval")
    study.save(picture, "robustness")
    header = ["moons", *(f"trained {kind}" for kind in KINDS.values()), "difference, 95%"]
    return {"robustness": study.table(header, lines)}


if __name__ == "__main__":
    study.main(JOBS, draw, measure)
