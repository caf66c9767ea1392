"""Returns after training: PPO on ten tasks, A2C and REINFORCE on their own."""

import gymnasium as gym
import numpy as np
import seaborn as sns
from benchmark import common
from benchmark.common import A2C, PPO, REINFORCE, number, spread

FIGURES = PPO, A2C, REINFORCE, "ppo_returns"
# The highest mean of several seeds that was published for PPO within a million steps, on -v1 to -v4
# of these tasks, with sampled actions. [1]: the PPO paper, [2]: Kostrikov's PPO (both read off
# figures, as listed by Tianshou), [3]: Tianshou's PPO (its data at 983,040 steps), [4]: Engstrom et
# al. 2020, Table 2, [5]: CleanRL's ppo_continuous_action, [6]: Spinning Up's PPO.
PUBLISHED = {
    "HalfCheetah-v5": (5780, "[3]"),
    "Hopper-v5": (2513, "[4]"),
    "Walker2d-v5": (4000, "[2]"),
    "Ant-v5": (3258, "[3]"),
    "Humanoid-v5": (806, "[4]"),
    "Swimmer-v5": (120, "[6]"),
    "Reacher-v5": (-4.6, "[3]"),
    "Pusher-v5": (-40, "[5]"),
    "InvertedPendulum-v5": (1000, "[1]"),
    "InvertedDoublePendulum-v5": (8695, "[3]"),
}
PUBLISHED_V5 = {  # on -v5 itself, deterministic; [7]: XuanCe, [8]: a validation of -v5
    "HalfCheetah-v5": (5371, "[7]"),
    "Hopper-v5": (2453, "[8]"),
    "Walker2d-v5": (3203, "[7]"),
    "Ant-v5": (1412, "[8]"),
    "Humanoid-v5": (599, "[7]"),
    "Swimmer-v5": (84, "[7]"),
    "Reacher-v5": (-5.3, "[7]"),
    "Pusher-v5": (-36, "[7]"),
    "InvertedDoublePendulum-v5": (3355, "[7]"),
}
# The parts of this study; the last two look for rare falls of the double pendulum.
DEFAULT, MORE = "default", "more seeds"
A_MILLION = MILLION, FRESH_MILLION = "a million steps", "a million steps, fresh seeds"
LONG, MORE_LONG = "100 episodes", "more seeds, 100 episodes"
FRESH = {PPO: range(41, 51), A2C: range(41, 71), REINFORCE: range(41, 51)}  # used for no decision
IDEAS = {
    REINFORCE: "make an action more likely if the rewards after it exceed a prediction, the "
               "baseline, and less likely if they fall short, in proportion",
    A2C: "the critic's prediction stands in for rewards that have not come yet, so that learning "
         "need not wait for the end of an episode; many environments at once",
    PPO: "A2C that takes several gradient steps on the same data, but keeps the policy close to "
         "the one that collected it",
}


def jobs(quick):
    found = [x for script in (PPO, A2C, REINFORCE)
             for x in common.training_jobs(script, quick, part=DEFAULT)]
    tasks = list(PUBLISHED)[:1] if quick else PUBLISHED
    for env_id in tasks:
        flags = f"--env-id {env_id}{'' if quick else ' --total-steps 1000000'}"
        found += common.training_jobs(PPO, quick, flags, part=MILLION)
    for script, seeds in FRESH.items():
        found += common.training_jobs(script, quick, seeds=seeds, part=MORE)
    for env_id in tasks:
        size = "" if quick else " --total-steps 1000000"
        flags = f"--env-id {env_id}{size} --num-evals 1"
        found += common.training_jobs(PPO, quick, flags, seeds=FRESH[PPO][:5], part=FRESH_MILLION)
    flags = "" if quick else "--num-evals 1 --eval-episodes 100"
    found += common.training_jobs(PPO, quick, flags, part=LONG)
    return found + common.training_jobs(PPO, quick, flags, seeds=FRESH[PPO], part=MORE_LONG)


measure = common.train


def score(runs):
    """In how many tasks the mean is at least what was published, and how far one can tell."""
    from scipy.stats import t

    rows = []
    for name, published in ("older versions", PUBLISHED), ("-v5 itself", PUBLISHED_V5):
        for actions, column in ("deterministic", "return_mean"), ("sampled", "train_return"):
            signs = {-1: [], 0: [], 1: []}  # below, within, above the 95% interval of our mean
            reached = 0
            for env_id, x in runs[runs["env_id"].isin(published)].groupby("env_id")[column]:
                gap = x.mean() - published[env_id][0]
                margin = t.ppf(0.975, len(x) - 1) * x.std() / len(x) ** 0.5
                signs[int(np.sign(gap)) if abs(gap) > margin else 0].append(env_id.split("-")[0])
                reached += gap >= 0
            rows.append([name, actions, f"{reached} of {sum(map(len, signs.values()))}",
                         *(", ".join(signs[sign]) or "–" for sign in (1, 0, -1))])
    return common.table(["published on", "our actions", "our mean is at or above",
                         "clearly above (95%)", "not told apart", "clearly below"], rows)


def report(data, draw):
    last, usual = common.last_rows(data), []
    for script, idea in IDEAS.items():
        curve(data[data["part"].eq(DEFAULT) & data["script"].eq(script)], draw, script)
        x = last[last["part"].eq(DEFAULT) & last["script"].eq(script)]
        mean, every = spread(x["return_mean"], 0)
        usual.append([f"`{script}.py`", idea, x["env_id"].iloc[0], mean, every,
                      f"{common.defaults(script)['total_steps']:,}",
                      number(x["seconds"].mean() / 60)])
    suite, fresh = suite_of(last, MILLION), suite_of(last, FRESH_MILLION)
    shown = data["part"].eq(MILLION) & data["env_id"].isin(suite["env_id"])
    if shown.any():
        draw(panels(data[shown]), "ppo_returns")
    return {
        "ppo": suite_table(suite),
        "score": score(suite),
        "fresh": suite_table(fresh),
        "fresh_score": score(fresh),
        "reinforce": successes(last[last["script"] == REINFORCE]),
        "a2c": successes(last[last["script"] == A2C]),
        "pendulum": successes(last[last["script"].eq(PPO) & ~last["part"].isin(A_MILLION)]),
        "usual": common.table(["file", "its idea", "task", "final return, mean ± std", "every seed",
                                "steps", "minutes of training, two at a time"], usual),
    }


def suite_of(last, part):
    """The tasks of which all seeds are there; the rest is on its way."""
    runs = last[last["part"] == part]
    seeds = runs.groupby("env_id")["seed"].nunique()
    return runs[runs["env_id"].isin(seeds[seeds == seeds.max()].index)]


def suite_table(runs):
    if runs.empty:
        return "Not measured yet with the current files."
    seeds = f"seeds {runs['seed'].min()} to {runs['seed'].max()}"
    rows = [task_row(env_id, x) for env_id, x in runs.groupby("env_id")]
    return common.table(["task", "mean ± std", seeds, "sampled actions", "published",
                         "published on -v5"], rows)


def task_row(env_id, runs):
    digits = int(abs(PUBLISHED[env_id][0]) < 100)
    published = [f"{x[env_id][0]:,} {x[env_id][1]}".replace("-", "−") if env_id in x else ""
                 for x in (PUBLISHED, PUBLISHED_V5)]
    sampled = number(runs["train_return"].mean(), digits)
    return [env_id, *spread(runs["return_mean"], digits), sampled, *published]


def successes(runs):
    """How many runs end at or above the return from which Gymnasium counts the task as solved."""
    rows, threshold = [], gym.spec(runs["env_id"].iloc[0]).reward_threshold
    script = common.load(runs["script"].iloc[0])
    for part in DEFAULT, MORE, LONG, MORE_LONG:
        x = runs[runs["part"] == part]
        if len(x):
            solved = f"{(x['return_mean'] >= threshold).sum()} of {len(x)}"
            seeds = f"{x['seed'].min()} to {x['seed'].max()}"
            episodes = script.parse_args(x["flags"].iloc[0].split()).eval_episodes
            rows.append([seeds, episodes, *spread(x["return_mean"], 0), solved])
    header = ["seeds", "episodes", "mean ± std", "every seed", f"at least {threshold:,g}"]
    return common.table(header, rows)


def curve(data, draw, script):
    """Evaluation returns of all seeds, small enough to stand below a GIF."""
    figure = common.figure(4, 2.8)
    axis = figure.add_subplot()
    sns.lineplot(common.in_bins(data, "return_mean", "env_id"), x="env_step", y="return_mean",
                 errorbar=("pi", 100), ax=axis)
    threshold = gym.spec(data["env_id"].iloc[0]).reward_threshold
    label = f"solved: {threshold:g}"
    axis.axhline(threshold, color="grey", linestyle="--", linewidth=1, label=label)
    axis.legend(loc="lower right")
    axis.set(ylabel="return in evaluation", title=f"{data['seed'].nunique()} seeds: mean, range")
    if script == A2C:
        axis.set_ylim(-600, 350)
        axis.set_title("10 seeds: mean, range (cut at −600)")
    common.steps_axis(axis)
    draw(figure, script)


def panels(data):
    """A panel per task: every seed, their mean in bold, and what was published."""
    courses = common.in_bins(data, "return_mean", "env_id")
    grid = sns.relplot(courses, x="env_step", y="return_mean", units="seed", estimator=None,
                       col="env_id", col_wrap=min(5, data["env_id"].nunique()), kind="line",
                       linewidth=1, alpha=0.4, height=2.6, aspect=0.9,
                       facet_kws={"sharex": False, "sharey": False})
    grid.set_titles("{col_name}").set_ylabels("return in evaluation")
    for env_id, axis in grid.axes_dict.items():
        mean = courses[courses["env_id"] == env_id].groupby("env_step")["return_mean"].mean()
        axis.plot(mean, color="C0", linewidth=2.5)
        axis.axhline(PUBLISHED[env_id][0], color="grey", linestyle="--", linewidth=1.2)
        if env_id in PUBLISHED_V5:
            axis.axhline(PUBLISHED_V5[env_id][0], color="grey", linestyle=":", linewidth=1.5)
        common.steps_axis(axis)
    title = ("Seeds {} to {}, deterministic actions, and their mean (bold). "
             "Published, mostly with sampled actions: older versions dashed, -v5 dotted")
    grid.figure.suptitle(title.format(data["seed"].min(), data["seed"].max()), y=1.02)
    return grid
