"""Each option reaches its place, and the log says what happened: one training of odd numbers."""

import inspect
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from harness import World, read_log, register


class Slow(World):
    """A step takes a millisecond and pays what the episode has drawn."""

    def reward(self, action):
        time.sleep(0.001)
        return self.episode


register("Slow", Slow)
ODD = {  # no two are alike, and none is the default
    "seed": [7], "total_steps": 100, "num_evals": 3, "eval_episodes": 5, "hidden_size": 23,
    "learning_rate": 0.00313, "gamma": 0.831, "gae_lambda": 0.617, "num_envs": 4,
    "rollout_steps": 6, "env_id": "test_wiring:Slow-v0", "out_dir": "odd/place", "watch": None}
ODD = {
    "reinforce_mujoco": {**ODD, "batch_episodes": 8, "baseline": "mean"},
    "a2c_vector": {
        **ODD, "env_id": "LunarLander-v3", "vectorization": "async", "randomize": True,
        "reward_scale": 0.37, "entropy_coef": 0.019, "max_grad_norm": 0.0041},
    "ppo_continuous": {
        **ODD, "epochs": 2, "minibatch_size": 9, "clip_eps": 0.0043, "max_kl": 19.0,
        "first_std": 1.7, "last_std": 0.47}}


def options_of(script):
    """The odd values of all options that the script has."""
    return {name: ODD[script.name][name] for name in vars(script.args())}


def typed(options):
    for name, value in options.items():
        if value is True:
            yield f"--{name.replace('_', '-')}"
        elif value is not None:
            yield f"--{name.replace('_', '-')}"
            yield from map(str, value if isinstance(value, list) else [value])


def spy_on_all(patch, module):
    """For each function of a script the list of its calls: arguments by name, and `result`.

    Of what changes in training, it keeps the state at that time.
    """
    calls = {}

    def spied(name, function):
        signature, calls[name] = inspect.signature(function), []

        def wrapper(*arguments, **options):
            call = SimpleNamespace(**signature.bind(*arguments, **options).arguments)
            calls[name].append(call)
            if hasattr(call, "optimizer"):
                call.lr = call.optimizer.param_groups[0]["lr"]
            if hasattr(call, "agent") and hasattr(call.agent, "sigma"):
                call.sigma = call.agent.sigma[0].item()
            if hasattr(call, "envs"):
                call.kind = type(call.envs.unwrapped)
                call.gravity = [*call.envs.unwrapped.get_attr("gravity")] if (
                    "Lunar" in call.envs.spec.id) else None
            call.result = function(*arguments, **options)
            return call.result

        return wrapper

    for name, function in list(vars(module).items()):
        if inspect.isfunction(function) and function.__module__ == module.__name__:
            patch.setattr(module, name, spied(name, function))
    return calls


TRAINED = {}


@pytest.fixture
def seen(script, tmp_path_factory):
    """What all functions got in a training with the odd options, its log, and how long it took."""
    if script.name not in TRAINED:
        TRAINED[script.name] = train_odd(script, tmp_path_factory.mktemp(script.name))
    return TRAINED[script.name]


def train_odd(script, cwd):
    options = options_of(script)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(cwd)
        patch.setattr("sys.path", sys.path[:])
        patch.setattr("sys.argv", [script.file, *typed(options)])
        calls, start = spy_on_all(patch, script.module), time.perf_counter()
        script.module.main()
    (log,) = cwd.rglob("seed-7.csv")
    return SimpleNamespace(**calls, args=SimpleNamespace(**options), path=log.with_suffix(""),
                           log=pd.read_csv(log), duration=time.perf_counter() - start, cwd=cwd)


def same(values, expected):
    return list(values) == pytest.approx(list(expected), rel=1e-5)


def players(seen):
    """The calls that play: in training, and in evaluations."""
    return getattr(seen, "rollout", None) or seen.play, seen.evaluate


def env_ids(seen):
    training, evaluations = players(seen)
    return {(getattr(x, "envs", None) or x.env).spec.id for x in (*training, *evaluations)}


def before(seen):
    """The share of steps that was left when each update began."""
    return 1 - np.array([0, *seen.log["env_step"][:-1]]) / 100


def evaluated(seen):
    return seen.log.dropna(subset="eval_return")["env_step"].tolist()


def clipped(seen):
    """The last gradients of each network."""
    agent = seen.optimise[-1].agent
    return [torch.cat([p.grad.flatten() for p in network.parameters()]).norm().item()
            for network in (agent.actor, agent.critic)]


def steps_of(seen):
    return int(seen.optimise[-1].optimizer.state[seen.optimise[-1].agent.actor[0].weight]["step"])


CHECKS = {
    "seed": lambda x: (
        {call.seed for name in ("make_repeatable", "evaluate", "make_seeds")
         for call in getattr(x, name)} == {7}
        and {call.path.name for call in x.save} == {"seed-7"}
        and {(call.stream, call.count) for call in x.make_seeds} == {
            (0, 1), (1, 5), (2, 1 if hasattr(x, "play") else 4)}),
    "total_steps": lambda x: x.log["env_step"].iloc[-1] >= 100 > x.log["env_step"].iloc[-2],
    "env_id": lambda x: env_ids(x) == {x.args.env_id.removeprefix("test_wiring:")},
    "watch": lambda x: "watch" in vars(x) and not x.watch,  # and see below
    "out_dir": lambda x: x.path.parents[1] == x.cwd / "odd" / "place",
    "num_evals": lambda x: len(x.save) == len(x.evaluate) == 4 and evaluated(x) == [
        x.log["env_step"].iloc[0], *(next(step for step in x.log["env_step"] if step >= share)
                                     for share in (100 / 3, 200 / 3, 100))],
    "eval_episodes": lambda x: {call.envs.num_envs for call in x.evaluate} == {5},
    "hidden_size": lambda x: {
        network[i].out_features for i in (0, 2) for agent in [x.save[0].agent]
        for network in (agent.actor, agent.critic)} == {23},
    "learning_rate": lambda x: same([call.lr for call in x.optimise], 0.00313 * before(x)),
    "gamma": lambda x: {call.gamma for name in (
        "compute_rewards_to_go", "compute_gae", "scale_rewards")
        for call in vars(x).get(name, [])} == {0.831},
    "gae_lambda": lambda x: {call.gae_lambda for call in x.compute_gae} == {0.617},
    "num_envs": lambda x: {call.rewards.shape[1] for call in x.compute_gae} == {4},
    "rollout_steps": lambda x: {call.rewards.shape[0] for call in x.compute_gae} == {6},
    "batch_episodes": lambda x: len(x.play) == 8 * len(x.optimise),
    "baseline": lambda x: {call.baseline for call in x.compute_advantages} == {"mean"},
    "vectorization": lambda x: (
        {call.kind for call in x.rollout} == {AsyncVectorEnv}
        and {call.kind for call in x.evaluate} == {SyncVectorEnv}),
    "randomize": lambda x: all(
        len({*call.gravity}) == len(call.gravity) for call in (*x.rollout, *x.evaluate[1:])),
    "reward_scale": lambda x: all(
        torch.allclose(gae.rewards, 0.37 * rollout.result[0].rewards.float())
        for gae, rollout in zip(x.compute_gae, x.rollout, strict=True)),
    "entropy_coef": lambda x: same([c.entropy_coef for c in x.optimise], 0.019 * before(x)),
    "max_grad_norm": lambda x: same(clipped(x), [0.0041] * 2),
    "epochs": lambda x: steps_of(x) == 2 * 3 * len(x.log),  # 24 samples are 9 + 9 + 6
    "minibatch_size": lambda x: same(
        [len(call.ratio) for call in x.policy_loss], [9, 9, 6] * 2 * len(x.log)),
    "clip_eps": lambda x: {call.clip_eps for call in (*x.policy_loss, *x.optimise)} == {0.0043},
    "max_kl": lambda x: {call.max_kl for call in x.optimise} == {19.0},
    "first_std": lambda x: x.rollout[0].sigma == pytest.approx(1.7),
    "last_std": lambda x: same(
        [call.sigma for call in x.rollout], 0.47 + (1.7 - 0.47) * before(x)),
}
CASES = [(name, option) for name, script in SCRIPTS.items() for option in vars(script.args())]


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
@pytest.mark.parametrize(("script", "option"), CASES, indirect=["script"])
def test_an_option_reaches_its_place(script, option, seen):
    assert CHECKS[option](seen)
    saved = torch.load(f"{seen.path}.pt", weights_only=True)
    assert saved["options"][option] == getattr(seen.args, option)
    odd = getattr(script.args(), option) != getattr(seen.args, option)
    assert odd or option == "watch" or getattr(seen.args, option) == "LunarLander-v3"


def test_the_log_says_what_happened(script, seen):
    """Steps, seconds and evaluations; in REINFORCE the mean of the batch, else of what ended."""
    log = read_log(f"{seen.path}.csv")
    assert log["eval_return"].dropna().tolist() == [call.result for call in seen.evaluate]
    assert log["eval_return"].notna().iloc[[0, -1]].all()
    training, _ = players(seen)
    if script.name == "reinforce_mujoco":
        rewards = [call.result[2] for call in training]
        batches = [rewards[i:i + 8] for i in range(0, len(rewards), 8)]
        steps = [sum(map(len, batch)) for batch in batches]
        returns = [np.mean([sum(episode) for episode in batch]) for batch in batches]
    else:
        steps = [24] * len(training)
        returns = [np.mean(x.result[2]) if x.result[2] else np.nan for x in training]
    assert log["env_step"].tolist() == np.cumsum(steps).tolist()
    np.testing.assert_allclose(log["return"], returns)
    seconds = seen.log["seconds"]
    assert seconds.is_monotonic_increasing
    assert seconds.iloc[-1] < seen.duration
    if "Slow" in seen.args.env_id:
        assert (seconds > 0.001 * log["env_step"]).all()


@pytest.mark.parametrize("options", [[], ["--eval-episodes", 6, "--seed", 9]])
def test_watch_takes_the_options_of_the_file_except_for_those_typed(
        script, seen, options, monkeypatch, watch):
    if script.name == "a2c_vector":
        options = [*options, *["--no-randomize"] * bool(options)]
    calls = spy_on_all(monkeypatch, script.module)
    result, _ = watch(script, seen.path, *options)
    evaluation, *_ = calls["evaluate"]
    assert calls["watch"][0].path == Path(f"{seen.path}.pt")
    assert (evaluation.envs.num_envs, evaluation.seed) == ((6, 9) if options else (5, 7))
    assert {call.seed for call in calls["make_seeds"]} == {evaluation.seed}
    assert {call.stream for call in calls["make_seeds"]} == {0, 1}  # of the film, too
    assert evaluation.envs.spec.id == seen.args.env_id.removeprefix("test_wiring:")
    assert (result == seen.log["eval_return"].iloc[-1]) == (not options)
    if evaluation.gravity:
        gravities = set(evaluation.envs.unwrapped.get_attr("gravity"))
        assert (gravities == {-10}) == bool(options)
