"""Each option reaches its place, and the log says what happened: one training of odd numbers."""

import functools
import inspect
import sys
import time
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from harness import Uneven, load, read_log, register


class Slow(Uneven):
    """A step takes a millisecond and pays what the episode has drawn."""

    def reward(self, action):
        time.sleep(0.001)
        return self.episode


register("Slow", Slow)
ALL = ("--seed 7 --total-steps 100 --num-evals 3 --eval-episodes 5 --hidden-size 23 --gamma 0.831"
       " --learning-rate 0.00313 --out-dir ~/odd")
SLOW = f"{ALL} --env-id test_wiring:Slow-v0"
VECTOR = "--num-envs 4 --rollout-steps 6 --gae-lambda 0.617"
ODD = {  # no two numbers are alike, and none is the default
    "reinforce_mujoco": f"{SLOW} --batch-episodes 2 --baseline mean --critic-steps 3",
    "a2c_vector": f"{ALL} {VECTOR} --env-id LunarLander-v3 --vectorization async --randomize"
                  " --reward-scale 0.37 --entropy-coef 0.019 --max-grad-norm 0.0041",
    "ppo_continuous": f"{SLOW} {VECTOR} --epochs 2 --minibatch-size 9 --clip-eps 0.0043"
                      " --max-kl 19 --first-std 1.7 --last-std 0.47"}


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
            if name == "optimise":
                call.lr = call.optimizer.param_groups[0]["lr"]
            if name == "rollout" and hasattr(call.agent, "sigma"):
                call.sigma = call.agent.sigma[0].item()
            if name in ("rollout", "evaluate") and "Lunar" in call.envs.spec.id:
                call.gravity = call.envs.unwrapped.get_attr("gravity")
            call.result = function(*arguments, **options)
            return call.result

        return wrapper

    for name, function in list(vars(module).items()):
        if inspect.isfunction(function) and function.__module__ == module.__name__:
            patch.setattr(module, name, spied(name, function))
    return calls


@pytest.fixture(scope="session")
def trainings(tmp_path_factory):
    return functools.cache(lambda script: train_odd(script, tmp_path_factory.mktemp(script.name)))


@pytest.fixture
def seen(script, trainings):
    return trainings(script)


def train_odd(script, cwd):
    """What all functions got in a training with the odd options, its log, and how long it took."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(cwd)
        patch.setenv("HOME", str(cwd))
        patch.setattr("sys.path", sys.path[:])
        patch.setattr("sys.argv", [script.file, *ODD[script.name].split()])
        args = script.args(*ODD[script.name].split())
        calls, start = spy_on_all(patch, script.module), time.perf_counter()
        torch.set_num_threads(2)
        script.module.main()
    (path,) = cwd.rglob("seed-7.csv")
    return SimpleNamespace(**calls, args=args, path=path.with_suffix(""), log=pd.read_csv(path),
                           duration=time.perf_counter() - start, cwd=cwd,
                           threads=torch.get_num_threads())


def same(values, expected):
    return list(values) == pytest.approx(list(expected), rel=1e-5)


def before(seen):
    """The share of steps that was left when each update began."""
    return 1 - np.array([0, *seen.log["env_step"][:-1]]) / 100


def due(seen):
    """After the first update, and after the one in which each third of all steps is over."""
    steps = seen.log["env_step"]
    return [steps.iloc[0], *(steps[steps >= share].iloc[0] for share in (100 / 3, 200 / 3, 100))]


def follows_the_schedule(seen):
    agent, optimizer = seen.optimise[0].agent, seen.optimise[0].optimizer
    (group,) = optimizer.param_groups
    return (same([call.lr for call in seen.optimise], 0.00313 * before(seen))
            and set(group["params"]) == set(agent.parameters())
            and group["eps"] == (1e-5 if "entropy_coef" in seen.args else 1e-8))


def clipped(seen):
    """The last gradients of each network."""
    agent = seen.optimise[-1].agent
    return [torch.cat([p.grad.flatten() for p in network.parameters()]).norm().item()
            for network in (agent.actor, agent.critic)]


CHECKS = {
    "seed": lambda x: (
        x.threads == 1 and {call.seed for name in ("make_repeatable", "evaluate", "make_seeds")
                            for call in getattr(x, name)} == {7}
        and {call.path.name for call in x.save} == {"seed-7"}
        and {(call.stream, call.count) for call in x.make_seeds} == {
            (0, 1), (1, 5), (2, 1 if hasattr(x, "play") else 4)}),
    "total_steps": lambda x: x.log["env_step"].iloc[-1] >= 100 > x.log["env_step"].iloc[-2],
    "env_id": lambda x: {call.result.spec.id for call in x.make_envs} == {
        x.args.env_id.removeprefix("test_wiring:")},
    "watch": lambda x: not x.watch,  # and see below
    "out_dir": lambda x: x.path.parents[1] == x.cwd / "odd" and ":" not in x.path.parent.name,
    "num_evals": lambda x: len(x.save) == len(x.evaluate) == 4 and due(x) == (
        x.log.dropna(subset="eval_return")["env_step"].tolist()),
    "eval_episodes": lambda x: {call.envs.num_envs for call in x.evaluate} == {5},
    "hidden_size": lambda x: {
        network[i].out_features for i in (0, 2) for agent in [x.save[0].agent]
        for network in (agent.actor, agent.critic)} == {23},
    "learning_rate": follows_the_schedule,
    "gamma": lambda x: {call.gamma for name in (
        "compute_rewards_to_go", "compute_gae", "scale_rewards")
        for call in vars(x).get(name, [])} == {0.831},
    "gae_lambda": lambda x: {call.gae_lambda for call in x.compute_gae} == {0.617},
    "num_envs": lambda x: {call.rewards.shape[1] for call in x.compute_gae} == {4},
    "rollout_steps": lambda x: {call.rewards.shape[0] for call in x.compute_gae} == {6},
    "batch_episodes": lambda x: len(x.play) == 2 * len(x.optimise),
    "critic_steps": lambda x: {call.critic_steps for call in x.optimise} == {3},
    "baseline": lambda x: {call.baseline for call in x.compute_advantages} == {"mean"},
    "vectorization": lambda x: (
        {type(call.envs.unwrapped) for call in x.rollout} == {AsyncVectorEnv}
        and {type(call.envs.unwrapped) for call in x.evaluate} == {SyncVectorEnv}),
    "randomize": lambda x: all(
        len({*call.gravity}) == len(call.gravity) for call in (*x.rollout, *x.evaluate[1:])),
    "reward_scale": lambda x: all(
        torch.allclose(gae.rewards, 0.37 * rollout.result[0].rewards.float())
        for gae, rollout in zip(x.compute_gae, x.rollout, strict=True)),
    "entropy_coef": lambda x: same([c.entropy_coef for c in x.optimise], 0.019 * before(x)),
    "max_grad_norm": lambda x: same(clipped(x), [0.0041] * 2),
    "epochs": lambda x: len(x.policy_loss) == 2 * 3 * len(x.log),  # 24 samples are 9 + 9 + 6
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
def test_an_option_reaches_its_place_and_the_file(script, option, seen):
    assert CHECKS[option](seen)
    value = getattr(seen.args, option)
    assert load(f"{seen.path}.pt")["options"][option] == value
    assert value != getattr(script.args(), option) or value in (None, "LunarLander-v3")


def test_the_log_says_what_happened(script, seen):
    """Steps, seconds and evaluations; in REINFORCE the mean of the batch, else of what ended."""
    log = read_log(f"{seen.path}.csv")
    assert log["eval_return"].dropna().tolist() == [call.result for call in seen.evaluate]
    if script.name == "reinforce_mujoco":
        rewards = [call.result[2] for call in seen.play]
        batches = [rewards[i:i + 2] for i in range(0, len(rewards), 2)]
        steps = [sum(map(len, batch)) for batch in batches]
        returns = [np.mean([sum(episode) for episode in batch]) for batch in batches]
    else:
        ended = [call.result[2] for call in seen.rollout]
        steps = [24] * len(ended)
        returns = [np.mean(x) if x else np.nan for x in ended]
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
    """Return and film are of the same world and seed."""
    if script.name == "a2c_vector" and options:
        options = [*options, "--no-randomize"]
    calls = spy_on_all(monkeypatch, script.module)
    result, _ = watch(script, seen.path, *options)
    evaluation = calls["evaluate"][0]
    assert evaluation.envs.num_envs == (6 if options else 5)
    assert {call.seed for call in calls["evaluate"]} == {9 if options else 7}
    assert {call.seed for call in calls["make_seeds"]} == {9 if options else 7}
    assert {call.stream for call in calls["make_seeds"]} == {0, 1}
    assert (result == seen.log["eval_return"].iloc[-1]) == (not options)
    for call in calls["make_envs"]:
        assert call.args.env_id == seen.args.env_id
        if "randomize" in call.args:
            assert call.args.randomize == (not options)
