"""The studies of benchmark.py: what they compute from runs, and what they change in a script."""

import importlib.util
import json
import math

import benchmark
import gymnasium as gym
import harness
import numpy as np
import pandas as pd
import pytest
import torch


class Timed(harness.World):
    """Only a time limit ends it; rewards depend on actions and on time."""

    def reward(self, action):
        return self.steps - float(np.square(action - harness.TARGET).sum())


if "Timed-v0" not in gym.registry:
    harness.register("Timed", Timed, limit=8, length=None)


def weights_after_training(path, flags):
    spec = importlib.util.spec_from_file_location("variant", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sizes = ["--num-envs", "4", "--rollout-steps", "50", "--total-steps", "600"]
    args = module.parse_args(
        ["--env-id", "Timed-v0", "--learning-rate", "0.02", *sizes, *flags])
    *_, (_, agent, *_) = module.train(args, seed=1)
    return torch.cat([x.flatten() for x in agent.parameters()])


@pytest.fixture(scope="module")
def usual_weights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("usual")
    return weights_after_training(*benchmark.write_variant([], folder))


@pytest.mark.parametrize("name", [x for x in benchmark.ABLATIONS if x != "defaults"])
def test_each_variant_of_the_ablation_runs_and_learns_something_else(
        name, usual_weights, tmp_path):
    path, flags = benchmark.write_variant(benchmark.ABLATIONS[name], tmp_path)
    weights = weights_after_training(path, flags)
    assert weights.isfinite().all()
    assert not torch.equal(weights, usual_weights)


def test_a_variant_whose_text_is_not_there_is_an_error(tmp_path):
    with pytest.raises(SystemExit, match="no such line"):
        benchmark.write_variant({"no such line": ""}, tmp_path)


def test_the_interval_of_a_difference_is_that_of_student_and_welch():
    a, b = pd.Series([1.0, 2, 3, 4, 5]), pd.Series([2.0, 3, 4, 5, 6])
    gap, error, margin = benchmark.difference(a, b)
    assert gap == -1
    assert error == 1
    # equal variances of 2.5, so 8 degrees of freedom, of which the table says 2.306
    assert margin == pytest.approx(2.306 * math.sqrt(2.5 / 5 + 2.5 / 5), rel=0.02)
    _, _, margin = benchmark.difference(a, pd.Series([7.0] * 5))  # 4 degrees: 2.776
    assert margin == pytest.approx(2.776 * math.sqrt(2.5 / 5), rel=0.02)


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end():
    assert benchmark.interquartile_mean(np.array([100.0, 3, 1, -50, 2, 4, 5, 6])) == 3.5


def test_only_a_run_that_came_to_its_end_counts_as_finished(tmp_path):
    folder = tmp_path / "MyEnv-v0__ppo_continuous__1"
    (folder / "seed-3").mkdir(parents=True)
    (folder / "args.json").write_text(json.dumps({"total_steps": 100}))
    for steps, expected in ((50, None), (104, folder)):
        pd.DataFrame({"env_step": [0, steps]}).to_csv(folder / "seed-3/evals.csv", index=False)
        assert benchmark.finished_run(tmp_path, "MyEnv-v0", 3, 100) == expected
    assert benchmark.finished_run(tmp_path, "MyEnv-v0", 3, 50) is None  # a study of other length
    assert benchmark.finished_run(tmp_path, "MyEnv-v0", 4, 100) is None


def test_runs_of_another_version_of_the_script_are_not_mixed_in(tmp_path):
    path, _ = benchmark.write_variant([], tmp_path)
    benchmark.write_variant([], tmp_path)
    path.write_text("# an older version")
    with pytest.raises(SystemExit, match="another version"):
        benchmark.write_variant([], tmp_path)
