"""What agents learn: the best action, and to balance a pole; bars that any seed meets."""

import pytest
from gymnasium.spaces import Box
from harness import Target, World, read_log, register


class Sign(World):
    """One step; the best action is 0 where the first number shown is negative, else 2."""

    def reward(self, action):
        return float(action == (0 if self.episode < 0 else 2))


# Wide, as REINFORCE's actions are clipped, and beyond the bounds of a box nothing leads back.
register("Wide", Target, length=1, actions=Box(-9, 9, (2,)))
register("Sign", Sign, length=1)


@pytest.mark.parametrize(("script", "env_id", "options", "least"), [
    # At the end of a line: what the worst of 24 seeds has earned.
    ("reinforce_mujoco", "Wide-v0", "--total-steps 2048 --learning-rate 5e-3", -0.05),  # −0.001
    ("a2c_vector", "DiscreteSign-v0", "--num-envs 8", 0.8),  # 0.94
    ("ppo_continuous", "Target-v0", "--num-envs 8 --rollout-steps 64 --minibatch-size 64 "
     "--epochs 10 --first-std 0.22 --last-std 0.22", -0.1),  # −0.024
    pytest.param("ppo_continuous", "InvertedPendulum-v5", "--total-steps 24576 --num-envs 8 "
                 "--rollout-steps 128 --minibatch-size 128 --epochs 10 --learning-rate 1e-3 "
                 "--num-evals 1 --eval-episodes 2", 500, marks=pytest.mark.slow)],  # 1000 (new: 50)
    indirect=["script"])
def test_it_finds_the_best_action(script, env_id, options, least, tmp_path):
    """At best 0 (a new agent: −4, in the narrow box −0.8), in Sign 1 (at random: a third)."""
    usual = "--total-steps 8192 --learning-rate 3e-3 --eval-episodes 50"
    path = script.train(tmp_path, "--env-id", env_id, *usual.split(), *options.split())
    assert read_log(path)["eval_return"].iloc[-1] > least
