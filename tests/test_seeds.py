"""Seeds: the same run again, several in parallel, and what may not touch the random numbers."""

import os

import pandas as pd
import pytest
import torch
from harness import TESTS, results, run, run_folder, table

import ppo_continuous as ppo

TABLES = "episodes.csv", "metrics.csv", "evals.csv"


@pytest.fixture(scope="session")
def alone(script, tmp_path_factory):
    """Seed 3 by itself, in this process."""
    return script.train(tmp_path_factory.mktemp("alone"))


def test_seeds_in_parallel_equal_seeds_alone(script, folder, alone):
    for name in TABLES:
        third, *others = (table(folder / f"seed-{seed}" / name) for seed in script.seeds)
        pd.testing.assert_frame_equal(third, table(alone / name), check_exact=True)
        assert not any(third.equals(other) for other in others)


def test_another_seed_is_another_run(script, alone, tmp_path):
    other = script.train(tmp_path, seed=4)
    for name in TABLES:
        assert not table(other / name).equals(table(alone / name))


def test_evaluations_do_not_touch_training(script, alone, tmp_path):
    once = script.train(tmp_path, "--num-evals", 1, "--eval-episodes", 5)
    for name in "episodes.csv", "metrics.csv":
        pd.testing.assert_frame_equal(table(once / name), table(alone / name), check_exact=True)
    weights = [torch.load(x / "checkpoint.pt", weights_only=True)["agent"] for x in (once, alone)]
    torch.testing.assert_close(*weights, rtol=0, atol=0)


BUG = """
import gymnasium as gym
from harness import World

class Buggy(World):
    def reward(self, action):
        return 1 / (self.total < 40 or self.np_random_seed != {seed})

gym.register("Buggy-v0", Buggy)
"""


@pytest.mark.parametrize("seeds", [[2], [1, 2]])
def test_a_bug_in_the_user_s_environment_keeps_its_traceback(seeds, tmp_path):
    """It strikes in seed 2, after the first evaluation."""
    (bad,) = ppo.make_seeds(2, stream=2, count=1)
    (tmp_path / "here.py").write_text(BUG.format(seed=bad))
    options = "--num-envs 4 --rollout-steps 32 --total-steps 1024 --eval-episodes 1 --num-evals 8"
    arguments = "--env-id", "here:Buggy-v0", *options.split(), "--seed", *seeds
    process = run("ppo_continuous.py", *arguments, cwd=tmp_path, status=1,
                  PYTHONPATH=os.pathsep.join((str(tmp_path), str(TESTS))))
    assert 'here.py", line 7, in reward' in process.err
    assert process.err.rstrip().endswith("ZeroDivisionError: division by zero")
    assert (run_folder(tmp_path) / "learning_curve.png").exists()
    last = results(process).loc["seed-2"]
    assert (last["env_step"], last["return_mean"]) == (128, 3)
