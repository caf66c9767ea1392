"""evaluate, the same in all scripts: one deterministic episode of each seed."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from harness import ACTIONS, World, register

import a2c_vector as a2c
import ppo_continuous as ppo


class Patient(World):
    """Never ends by itself, but does not wait for ever to be reset."""

    def reward(self, action):
        assert self.total < 100
        return 1.0


register("Patient", Patient, limit=8, length=None)


def make(script, env_id, options=""):
    """Six environments and an agent whose actions depend on what it sees."""
    args = script.parse_args(f"--env-id {env_id} {options}".split())
    envs = script.make_envs(env_id, 6, "NextStep")
    agent = script.Agent(envs.single_observation_space, envs.single_action_space, args)
    agent.actor[-1].weight.data *= 100
    agent.obs_stats.update(3 * torch.randn(50, *envs.single_observation_space.shape) + 1)
    return envs, agent


def squashed_mean(agent, obs):
    """tanh of μ(s), −1 at the lowest action and 1 at the highest."""
    mean = agent.actor(agent.obs_stats.normalise(obs)).numpy()
    return ACTIONS.low + (ACTIONS.high - ACTIONS.low) * (np.tanh(mean) + 1) / 2


def likeliest(agent, obs):
    return agent.actor(agent.obs_stats.normalise(obs)).argmax().item()


@torch.no_grad()
def evaluate_by_hand(script, env_id, agent, choose, seed):
    """Six episodes, one after the other, in one environment."""
    env, returns, lengths = gym.make(env_id), [], []
    for episode_seed in script.make_seeds(seed, stream=1, count=6):
        obs, _ = env.reset(seed=episode_seed)
        done, rewards = False, []
        while not done:
            obs, reward, terminated, truncated, _ = env.step(choose(agent, torch.as_tensor(obs)))
            done = terminated or truncated
            rewards.append(reward)
        returns.append(sum(rewards))
        lengths.append(len(rewards))
    assert len(set(lengths)) > 1
    return {"return_mean": np.mean(returns), "return_std": np.std(returns),
            "length_mean": np.mean(lengths)}


@pytest.mark.parametrize(
    ("script", "env_id", "choose"),
    [(ppo, "test_rollout:Uneven-v0", squashed_mean), (a2c, "CartPole-v1", likeliest)],
    ids=["ppo_continuous", "a2c_vector"])
def test_an_evaluation_plays_one_deterministic_episode_of_each_seed(script, env_id, choose):
    """Side by side, as if each were played by itself.

    Some end sooner and run on, also with reward, but only the first episode counts.
    """
    envs, agent = make(script, env_id)
    expected = {seed: evaluate_by_hand(script, env_id, agent, choose, seed) for seed in (7, 8)}
    assert expected[7]["return_mean"] != pytest.approx(expected[8]["return_mean"], rel=0.01)
    for seed in 7, 8, 7:  # with ever different noise, in environments that have been used
        assert script.evaluate(agent, envs, seed) == pytest.approx(expected[seed], rel=1e-5)


@pytest.mark.parametrize(("script", "prefix"), [(ppo, ""), (a2c, "Discrete")])
@pytest.mark.parametrize(
    ("world", "length"),
    [("harness:{}ThreeSteps", 3), ("test_evaluation:{}Patient", 8), ("harness:{}BothEnds", 3)])
def test_an_episode_ends_by_itself_or_by_its_time_limit(script, prefix, world, length):
    """Reward 1 a step."""
    envs, agent = make(script, f"{world.format(prefix)}-v0")
    expected = {"return_mean": length, "return_std": 0, "length_mean": length}
    assert script.evaluate(agent, envs, seed=1) == expected
