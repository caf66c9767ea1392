"""PPO learns a one-step task whose best action is known, and to balance a pole."""

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from harness import TARGET

import ppo_continuous as ppo


def last_return(folder, options):
    args = ppo.parse_args([*options.split(), "--num-evals", "1"])
    ppo.run(0, args, folder)
    return args, pd.read_csv(folder / "seed-1/evals.csv")["return_mean"].iloc[-1]


def test_it_finds_the_best_action_in_an_asymmetric_box(tmp_path):
    args, found = last_return(
        tmp_path, "--env-id harness:Target-v0 --total-steps 8192 --num-envs 8 --rollout-steps 64 "
        "--minibatch-size 64 --learning-rate 3e-3 --first-std 0.22 --last-std 0.22")
    assert found > -0.03
    env = gym.make(args.env_id)
    agent = ppo.Agent(env.observation_space, env.action_space, args)
    checkpoint = torch.load(tmp_path / "seed-1/checkpoint.pt", weights_only=True)
    agent.load_state_dict(checkpoint["agent"])
    actions = agent.act(np.float32([[0, 0], [0.5, 0]]), deterministic=True)
    assert np.abs(ppo.squash(actions, env.action_space) - TARGET).max() < 0.2


@pytest.mark.slow
def test_it_learns_to_balance_a_pole(tmp_path):
    _, found = last_return(
        tmp_path, "--env-id InvertedPendulum-v5 --total-steps 24576 --num-envs 8 "
        "--rollout-steps 128 --minibatch-size 128")
    assert found > 300
    episodes = pd.read_csv(tmp_path / "seed-1/episodes.csv")["return"]
    assert episodes[-20:].mean() > 5 * episodes[:20].mean()
