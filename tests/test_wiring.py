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
from conftest import SCRIPTS, only
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from harness import Uneven, register


class Slow(Uneven):
    """A step takes a millisecond and pays what the episode has drawn."""

    def reward(self, action):
        time.sleep(0.001)
        return self.episode


register("Slow", Slow)
ALL = ("--seed 7 --total-steps 100 --num-evals 3 --eval-episodes 6 --hidden-size 23 --gamma 0.831"
       " --learning-rate 0.00313 --out-dir odd")
SLOW = f"{ALL} --env-id test_wiring:Slow-v0"
VECTOR = "--num-envs 4 --rollout-steps 6 --gae-lambda 0.617"
ODD = {  # no two numbers are alike, and none is the default
    "reinforce_mujoco": f"{SLOW} --batch-episodes 2 --baseline mean --critic-steps 3",
    "a2c_vector": f"{ALL} {VECTOR} --env-id LunarLander-v3 --vectorization async --randomize"
                  " --reward-scale 0.37 --entropy-coef 0.019 --max-grad-norm 0.0041",
    "ppo_continuous": f"{SLOW} {VECTOR} --epochs 2 --minibatch-size 9 --clip-eps 0.0043"
                      " --max-kl 19 --first-std 1.7 --last-std 0.47"}
WATCHED = ("play", "rollout", "compute_rewards_to_go", "compute_advantages", "compute_gae",
           "policy_loss", "optimise", "evaluate")


def watch_calls(patch, module):
    """For each watched function the list of its calls: arguments by name, and `result`.

    Of what changes in training, it keeps the state at that time.
    """
    calls = {}

    def watched(name, function):
        signature, calls[name] = inspect.signature(function), []

        def wrapper(*arguments, **options):
            call = SimpleNamespace(**signature.bind(*arguments, **options).arguments)
            calls[name].append(call)
            call.lr = [group["lr"] for group in getattr(
                getattr(call, "optimizer", None), "param_groups", [])]
            call.sigma = getattr(getattr(call, "agent", None), "sigma", torch.zeros(1))[0].item()
            call.result = function(*arguments, **options)
            return call.result

        patch.setattr(module, name, wrapper)

    for name in WATCHED:
        if hasattr(module, name):
            watched(name, getattr(module, name))
    return calls


@pytest.fixture(scope="session")
def trainings(tmp_path_factory):
    @functools.cache
    def train(script):
        cwd = tmp_path_factory.mktemp(script.name)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(cwd)
            patch.setattr(sys, "path", sys.path[:])
            patch.setattr(sys, "argv", [script.name, *ODD[script.name].split()])
            calls, start = watch_calls(patch, script.module), time.perf_counter()
            script.module.main()
        (path,) = cwd.glob("odd/*/seed-7.csv")
        return SimpleNamespace(**calls, args=script.args(*ODD[script.name].split()), path=path,
                               log=pd.read_csv(path), duration=time.perf_counter() - start)

    return train


@pytest.fixture
def seen(script, trainings):
    return trainings(script)


def left(seen):
    """The share of steps that was left when each update began. (Rollouts are not cut short.)"""
    total = 100 if "batch_episodes" in seen.args else 120
    return 1 - np.array([0, *seen.log["env_step"][:-1]]) / total


def test_options_of_all_three_reach_their_places_and_the_file(script, seen):
    saved = torch.load(seen.path.with_suffix(".pt"), weights_only=True)
    assert saved["options"] == vars(seen.args)
    for name, default in vars(script.args()).items():
        assert getattr(seen.args, name) != default or name in ("watch", "env_id"), f"{name}: untried"
    agent, optimizer = seen.optimise[0].agent, seen.optimise[0].optimizer
    assert all(network[0].out_features == 23 for network in (agent.actor, agent.critic))
    assert {call.gamma for call in getattr(seen, "compute_gae", ())} <= {0.831}
    assert {call.gamma for call in getattr(seen, "compute_rewards_to_go", ())} <= {0.831}
    (group,) = optimizer.param_groups
    assert type(optimizer) is torch.optim.Adam
    assert group["weight_decay"] == 0
    assert set(group["params"]) == set(agent.parameters())
    lr = [call.lr for call in seen.optimise]
    np.testing.assert_allclose(lr, 0.00313 * left(seen)[:, None], rtol=1e-6)
    steps = seen.log["env_step"]
    assert steps.iloc[-1] >= 100 > steps.iloc[-2]
    assert seen.log["eval_return"].dropna().tolist() == [call.result for call in seen.evaluate]
    assert {call.seed for call in seen.evaluate} == {7}


@only("reinforce_mujoco")
def test_options_of_reinforce(script, seen):
    batches = [call.batch for call in seen.optimise]
    assert {len(batch) for batch in batches} == {2}
    assert {call.critic_steps for call in seen.optimise} == {3}
    assert {call.baseline for call in seen.compute_advantages} == {"mean"}
    assert {call.num_episodes for call in seen.evaluate} == {6}
    steps = [sum(len(x.rewards) for x in batch) for batch in batches]
    assert seen.log["env_step"].tolist() == np.cumsum(steps).tolist()
    returns = [np.mean([sum(x.rewards) for x in batch]) for batch in batches]
    np.testing.assert_allclose(seen.log["return"], returns)
    steps = seen.log["env_step"]  # evaluations: after the first update, then as soon as one is due
    due = {steps[0], *(steps[steps >= share].iloc[0] for share in (100 / 3, 200 / 3, 100))}
    assert set(steps[seen.log["eval_return"].notna()]) == due


@only("a2c_vector", "ppo_continuous")
def test_options_of_vectors(script, seen):
    assert {tuple(call.rewards.shape) for call in seen.compute_gae} == {(6, 4)}
    assert {call.gae_lambda for call in seen.compute_gae} == {0.617}
    assert {call.envs.num_envs for call in seen.evaluate} == {6}
    ended = [call.result[3] for call in seen.rollout]
    assert seen.log["env_step"].tolist() == [24, 48, 72, 96, 120]
    assert np.flatnonzero(seen.log["eval_return"].notna()).tolist() == [0, 1, 3, 4]
    np.testing.assert_allclose(seen.log["return"], [np.mean(x) if x else np.nan for x in ended])


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
@only("a2c_vector")
def test_options_of_a2c(script, seen):
    assert {type(call.envs.unwrapped) for call in seen.rollout} == {AsyncVectorEnv}
    assert {type(call.envs.unwrapped) for call in seen.evaluate} == {SyncVectorEnv}
    assert len(set(seen.evaluate[-1].envs.get_attr("gravity"))) == 6
    for gae, rollout in zip(seen.compute_gae, seen.rollout, strict=True):
        torch.testing.assert_close(gae.rewards, 0.37 * rollout.result[0].rewards.float())
    entropy_coefs = [call.entropy_coef for call in seen.optimise]
    np.testing.assert_allclose(entropy_coefs, 0.019 * left(seen))
    assert {call.max_grad_norm for call in seen.optimise} == {0.0041}


@only("ppo_continuous")
def test_options_of_ppo(script, seen):
    sizes = [len(call.ratio) for call in seen.policy_loss]
    assert sizes == [9, 9, 6] * 2 * len(seen.log)
    assert {call.clip_eps for call in (*seen.policy_loss, *seen.optimise)} == {0.0043}
    assert {call.max_kl for call in seen.optimise} == {19.0}
    sigmas = [call.sigma for call in seen.rollout]
    np.testing.assert_allclose(sigmas, 0.47 + (1.7 - 0.47) * left(seen), rtol=1e-5)
    saved = torch.load(seen.path.with_suffix(".pt"), weights_only=True)["agent"]
    assert saved["sigma"][0].item() == sigmas[-1]


def test_seconds_are_those_since_the_start(script, seen):
    seconds = seen.log["seconds"]
    assert seconds.is_monotonic_increasing
    assert seconds.iloc[-1] < seen.duration
    if script.name != "a2c_vector":
        assert (seconds > 0.001 * seen.log["env_step"]).all()


def test_no_two_environments_of_neighbouring_seeds_start_alike(monkeypatch, tmp_path):
    """Neither in training nor in evaluation, of any seed."""
    started = []
    monkeypatch.setattr(Uneven, "reset", lambda world, seed=None, options=None: (
        started.append(seed), super(Uneven, world).reset(seed=seed))[1])
    for script in SCRIPTS.values():
        started.clear()
        for seed in range(50):
            script.train(tmp_path, "--env-id", script.world("Uneven"), "--total-steps", 1,
                         "--num-evals", 1, seed=seed)
        seeds = [seed for seed in started if seed is not None]
        assert len(seeds) >= 150
        assert len(set(seeds)) == len(seeds)
