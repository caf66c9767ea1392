"""Each option has its effect; schedules, evaluations and seeds are as the files say."""

import numpy as np
import pytest
import torch
from conftest import SCRIPTS
from harness import SEED, Uneven, read_log, register, spy

COMMON = {"num_envs": 2, "rollout_steps": 16, "gae_lambda": 0.5, "hidden_size": 8, "gamma": 0.5,
           "learning_rate": 1e-4, "total_steps": 256, "num_evals": 2, "eval_episodes": 3,
           "seed": SEED + 4, "env_id": "harness:Forever-v0"}
OTHERS = {
    "reinforce_mujoco": {"batch_episodes": 4, "baseline": "mean", "critic_steps": 5},
    "a2c_vector": {"reward_scale": 0.5, "entropy_coef": 0.5, "max_grad_norm": 1e-3,
                   "env_id": "harness:DiscreteForever-v0"},
    "ppo_continuous": {"epochs": 3, "minibatch_size": 64, "clip_eps": 1e-3, "max_kl": 1e-5,
                       "first_std": 1.0, "last_std": 1.0}}
ELSEWHERE = {"watch", "out_dir", "vectorization", "randomize"}  # tested with what they are for


class Drawn(Uneven):
    """Pays what the episode has drawn, so that no two evaluations are alike."""

    def reward(self, action):
        return self.episode


register("Drawn", Drawn)


def test_every_option_has_an_effect(script, tmp_path):
    options, env = {**COMMON, **OTHERS[script.name]}, script.world("Drawn", "test_wiring")
    usual = read_log(script.train(tmp_path, "--env-id", env))
    for name in set(vars(script.args())) - ELSEWHERE:
        flag, value = f"--{name.replace('_', '-')}", options[name]
        seed = {"seed": value} if name == "seed" else {}
        log = read_log(script.train(tmp_path, "--env-id", env, flag, value, **seed))
        assert not log.equals(usual), f"{flag} has no effect"


def test_rates_fall_linearly_and_the_last_agent_is_evaluated(script, monkeypatch, tmp_path):
    """Rollouts are not cut short, so A2C and PPO take 120 steps for 100."""
    def keep(agent, optimizer, *_, **options):
        (group,) = optimizer.param_groups
        assert {id(x) for x in group["params"]} == {id(x) for x in agent.parameters()}
        sigma = agent.sigma.tolist() if script.name == "ppo_continuous" else None
        return group["lr"], options.get("entropy_coef"), sigma

    updates = spy(monkeypatch, script.module, "optimise", keep)
    whole = script.name == "reinforce_mujoco"  # episodes
    sizes = ["--batch-episodes", 2] if whole else ["--num-envs", 4, "--rollout-steps", 6]
    path = script.train(tmp_path, "--env-id", script.world("Uneven"), "--total-steps", 100,
                        "--num-evals", 3, "--learning-rate", 0.003, *sizes)
    log, (rates, entropy_coefs, sigmas) = read_log(path), zip(*updates)
    steps, evaluated = log["env_step"], np.flatnonzero(log["eval_return"].notna()).tolist()
    left = 1 - np.array([0, *steps[:-1]]) / (100 if whole else 120)
    np.testing.assert_allclose(rates, 0.003 * left, rtol=1e-6)
    if script.name == "a2c_vector":
        np.testing.assert_allclose(entropy_coefs, 0.01 * left, rtol=1e-6)
    if script.name == "ppo_continuous":
        np.testing.assert_allclose(sigmas, np.repeat(0.2 + 0.4 * left[:, None], 2, 1), rtol=1e-5)
        saved = torch.load(f"{path}.pt", weights_only=True)["agent"]["sigma"]
        assert saved.tolist() == sigmas[-1]
    if whole:  # after the first update, then as soon as one is due
        assert evaluated == [0, *(np.argmax(steps >= x) for x in (100 / 3, 200 / 3, 100))]
    else:
        assert steps.tolist() == [24, 48, 72, 96, 120]
        assert evaluated == [0, 1, 3, 4]
    assert steps.iloc[-1] >= 100 > steps.iloc[-2]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # Gymnasium's, of the spy's signature
def test_no_two_environments_of_neighbouring_seeds_start_alike(monkeypatch, tmp_path):
    """Neither in training nor in evaluation."""
    seeds = spy(monkeypatch, Uneven, "reset", lambda world, seed=None, options=None: seed)
    for script in SCRIPTS.values():
        seeds.clear()
        for seed in range(50):
            script.train(tmp_path, "--env-id", script.world("Uneven"), "--total-steps", 1,
                         "--num-evals", 1, seed=seed)
        given = [seed for seed in seeds if seed is not None]
        assert len(given) == len(set(given)) >= 150
