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


@pytest.mark.parametrize(("script", "world", "options", "least"), [
    # At the end of a line: what the worst of 24 seeds has earned.
    ("reinforce_mujoco", "Wide", "--total-steps 2048 --learning-rate 5e-3", -0.05),  # −0.001
    ("a2c_vector", "Sign", "", 0.8),  # 0.94
    ("ppo_continuous", "Target", "--rollout-steps 64 --minibatch-size 64 --epochs 10"
     " --first-std 0.22 --last-std 0.22", -0.1)], indirect=["script"])  # −0.024
def test_it_finds_the_best_action(script, world, options, least, tmp_path):
    """At best 0 (a new agent: −4, in the narrow box −0.8), in Sign 1 (at random: a third)."""
    usual = "--total-steps 8192 --learning-rate 3e-3 --eval-episodes 50"
    if script.name != "reinforce_mujoco":
        usual += " --num-envs 8"
    path = script.train(tmp_path, *usual.split(), *options.split(), env_id=script.world(world))
    assert read_log(f"{path}.csv")["eval_return"].iloc[-1] > least


@pytest.mark.slow
@pytest.mark.parametrize("script", ["ppo_continuous"], indirect=True)
def test_ppo_learns_to_balance_a_pole(script, tmp_path):
    """At best 1000, which every seed has reached; a new agent: below 50."""
    options = ("--total-steps 24576 --num-envs 8 --rollout-steps 128 --minibatch-size 128"
               " --epochs 10 --num-evals 1")
    path = script.train(tmp_path, *options.split(), env_id="InvertedPendulum-v5")
    assert read_log(f"{path}.csv")["eval_return"].iloc[-1] > 500
