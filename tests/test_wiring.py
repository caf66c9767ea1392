"""Each option reaches its place: one training with odd numbers for each script."""

import inspect
import sys
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS, only
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from harness import Uneven, spy

ALL = ("--seed 7 --total-steps 100 --num-evals 3 --eval-episodes 6 --hidden-size 23 --gamma 0.831"
       " --learning-rate 0.00313 --out-dir odd --env-id")
VECTOR = "--num-envs 4 --rollout-steps 6 --gae-lambda 0.617"
ODD = {  # no two numbers are alike, and none is the default
    "reinforce_mujoco": f"{ALL} harness:Uneven-v0 --batch-episodes 2 --baseline mean"
                        " --critic-steps 3",
    "a2c_vector": f"{ALL} LunarLander-v3 {VECTOR} --vectorization async --randomize"
                  " --reward-scale 0.37 --entropy-coef 0.019 --max-grad-norm 0.0041",
    "ppo_continuous": f"{ALL} harness:Uneven-v0 {VECTOR} --epochs 2 --minibatch-size 9"
                      " --clip-eps 0.0043 --max-kl 19 --first-std 1.7 --last-std 0.47"}
WATCHED = ("rollout", "compute_rewards_to_go", "compute_advantages", "compute_gae", "policy_loss",
           "optimise", "evaluate")


@pytest.fixture(scope="session")
def seen(script, tmp_path_factory):
    """For each watched function its calls, arguments by name; what was saved, and the log.

    Of what changes in training, a call keeps the state at that time.
    """
    def keep(signature):
        def keep(*arguments, **options):
            call = SimpleNamespace(**signature.bind(*arguments, **options).arguments)
            if hasattr(call, "optimizer"):
                call.lr = [group["lr"] for group in call.optimizer.param_groups]
            if hasattr(call, "agent") and hasattr(call.agent, "sigma"):
                call.sigma = call.agent.sigma[0].item()
            return call
        return keep

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp(script.name))
        patch.setattr(sys, "path", sys.path[:])
        patch.setattr(sys, "argv", [script.name, *ODD[script.name].split()])
        calls = {name: spy(patch, script.module, name, keep(inspect.signature(function)))
                 for name in WATCHED if (function := getattr(script.module, name, None))}
        script.module.main()
        (path,) = script.module.Path("odd").glob("*/seed-7.csv")
        return SimpleNamespace(
            **calls, args=script.args(*ODD[script.name].split()), log=pd.read_csv(path),
            saved=torch.load(path.with_suffix(".pt"), weights_only=True))


def left(seen):
    """The share of steps that was left when each update began. (Rollouts are not cut short.)"""
    total = 100 if "batch_episodes" in seen.args else 120
    return 1 - np.array([0, *seen.log["env_step"][:-1]]) / total


def test_options_of_all_three(script, seen):
    assert seen.saved["options"] == vars(seen.args)
    for name, default in vars(script.args()).items():
        assert getattr(seen.args, name) != default or name in ("watch", "env_id"), f"add {name}"
    agent, optimizer = seen.optimise[0].agent, seen.optimise[0].optimizer
    assert all(network[0].out_features == 23 for network in (agent.actor, agent.critic))
    (group,) = optimizer.param_groups
    assert type(optimizer) is torch.optim.Adam
    assert group["weight_decay"] == 0
    assert set(group["params"]) == set(agent.parameters())
    lr = [call.lr for call in seen.optimise]
    np.testing.assert_allclose(lr, 0.00313 * left(seen)[:, None], rtol=1e-6)
    assert seen.log["env_step"].iloc[-1] >= 100 > seen.log["env_step"].iloc[-2]
    assert {call.seed for call in seen.evaluate} == {7}


@only("reinforce_mujoco")
def test_options_of_reinforce(script, seen):
    batches = [call.batch for call in seen.optimise]
    assert {len(batch) for batch in batches} == {2}
    assert {call.critic_steps for call in seen.optimise} == {3}
    assert {call.baseline for call in seen.compute_advantages} == {"mean"}
    assert {call.num_episodes for call in seen.evaluate} == {6}
    assert {call.gamma for call in seen.compute_rewards_to_go} == {0.831}
    steps = seen.log["env_step"]
    batches = [sum(len(x.rewards) for x in batch) for batch in batches]
    assert steps.tolist() == np.cumsum(batches).tolist()
    # Evaluations come after the first update, then as soon as one is due.
    due = {steps[0], *(steps[steps >= share].iloc[0] for share in (100 / 3, 200 / 3, 100))}
    assert set(steps[seen.log["eval_return"].notna()]) == due


@only("a2c_vector", "ppo_continuous")
def test_options_of_vectors(script, seen):
    assert {(*call.rewards.shape, call.gamma, call.gae_lambda) for call in seen.compute_gae} == {
        (6, 4, 0.831, 0.617)}
    assert {call.envs.num_envs for call in seen.evaluate} == {6}
    assert seen.log["env_step"].tolist() == [24, 48, 72, 96, 120]
    assert np.flatnonzero(seen.log["eval_return"].notna()).tolist() == [0, 1, 3, 4]


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # of Python 3.12
@only("a2c_vector")
def test_options_of_a2c(script, seen):
    assert {type(call.envs.unwrapped) for call in seen.rollout} == {AsyncVectorEnv}
    assert {type(call.envs.unwrapped) for call in seen.evaluate} == {SyncVectorEnv}
    assert len(set(seen.evaluate[-1].envs.get_attr("gravity"))) == 6
    np.testing.assert_allclose([x.entropy_coef for x in seen.optimise], 0.019 * left(seen))
    assert {call.max_grad_norm for call in seen.optimise} == {0.0041}


@only("ppo_continuous")
def test_options_of_ppo(script, seen):
    sizes = [len(call.ratio) for call in seen.policy_loss]
    assert sizes == [9, 9, 6] * 2 * len(seen.log)
    assert {call.clip_eps for call in (*seen.policy_loss, *seen.optimise)} == {0.0043}
    assert {call.max_kl for call in seen.optimise} == {19.0}
    sigmas = [call.sigma for call in seen.rollout]
    np.testing.assert_allclose(sigmas, 0.47 + (1.7 - 0.47) * left(seen), rtol=1e-5)
    assert seen.saved["agent"]["sigma"][0].item() == sigmas[-1]


def test_no_two_environments_of_neighbouring_seeds_start_alike(monkeypatch, tmp_path):
    """Neither in training nor in evaluation."""
    seeds = spy(monkeypatch, Uneven, "reset", lambda world, seed=None, options=None: seed)
    for script in SCRIPTS.values():
        seeds.clear()
        for seed in range(50):
            script.train(tmp_path, "--env-id", script.world("Uneven"), "--total-steps", 1,
                         "--num-evals", 1, seed=seed)
        given = [seed for seed in seeds if seed is not None]
        assert len(given) >= 150
        assert len(set(given)) == len(given)
