"""The studies of benchmark.py: what they compute from runs, and what they change in a script."""

import importlib.util
import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import benchmark
import harness
import numpy as np
import pandas as pd
import pytest
import torch


class Timed(harness.World):
    """Only a time limit ends it; rewards depend on actions and on time."""

    def reward(self, action):
        return self.steps - float(np.square(action - [2, 0.1]).sum())


harness.register("Timed", Timed, limit=8, length=None)


def weights_after_training(path, flags):
    spec = importlib.util.spec_from_file_location("variant", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sizes = ["--num-envs", "4", "--rollout-steps", "50", "--total-steps", "600"]
    args = module.parse_args(
        ["--env-id", "Timed-v0", "--learning-rate", "0.02", *sizes, *flags])
    agent, updates = benchmark.begin(module, args, seed=1)
    assert len(list(updates)) == 1 + 3
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


def test_every_exercise_changes_what_it_says(tmp_path):
    for i, (script, change) in enumerate(benchmark.EXERCISES.values()):
        path, flags = benchmark.write_variant(change, tmp_path / str(i), script)
        assert benchmark.SCRIPTS[script].parse_args(flags)
        compile(path.read_text(encoding="utf-8"), path, "exec")


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


def test_the_race_says_when_ours_has_what_the_peer_has_in_the_end(tmp_path, monkeypatch, capsys):
    """Ours earns 10 a minute and the peer 1, for ten minutes; seed 2 is half as good in both."""
    runs = []

    def fresh(function, script, env_id, steps, seed, count):
        runs.append((function, seed))
        rate = (10 if function is benchmark.our_race else 1) / seed
        return [{"env_step": 100 * i, "minutes": float(i), "return": rate * i} for i in range(11)]

    monkeypatch.setattr(benchmark, "fresh", fresh)
    arguments = ["race", "--script", "a2c_vector", "--seed", "1", "2", "--out-dir", str(tmp_path)]
    for _ in range(2):
        benchmark.race(benchmark.parse_args(arguments))
        (row,) = re.findall(r"^.*stable-baselines3.*$", capsys.readouterr().out, re.MULTILINE)
        # 7.5 in the mean of 10 and 5, after 1 and 2 whole minutes: 10 minutes / 1.5
        assert row.split("|")[3:] == [" 10, 5 ", " 10.0 ", " 1.00, 2.00 ", " 7 ", ""]
        assert len(runs) == 4  # the second call has read what the first one has run
    assert {"race.csv", "race.png"} < {x.name for x in tmp_path.iterdir()}
    data = pd.read_csv(tmp_path / "race.csv")
    data.loc[data["learner"] == "ours", "return"] -= 100
    assert benchmark.race_rows(data)[1][4:] == ["never, never", "–"]


# --- Studies of many calls ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ten_calls(tmp_path_factory):
    """What the README's line for xargs leaves, with a tiny budget and all ten at once."""
    cwd = tmp_path_factory.mktemp("study")
    shutil.copy(harness.ROOT / "ppo_continuous.py", cwd)
    readme = (harness.ROOT / "README.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^seq .*xargs.*ppo_continuous\.py.*$", readme, re.MULTILINE)
    line = re.sub(r"-P *\d+", "-P 10", line)
    tiny = ("--env-id harness:ThreeSteps-v0 --num-envs 1 --rollout-steps 16 --total-steps 32 "
            "--num-evals 1 --eval-episodes 1")
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    subprocess.run(
        f"{line} {tiny}", shell=True, cwd=cwd, check=True, capture_output=True, timeout=170,
        env={**os.environ, "PATH": path, "PYTHONPATH": str(harness.TESTS), "OMP_NUM_THREADS": "1"})
    return sorted((cwd / "runs").iterdir())


def merge(folders, out_dir, capsys, monkeypatch):
    """`benchmark.py returns --runs FOLDER …`: what it printed, or said before it gave up."""
    capsys.readouterr()
    command = ["benchmark.py", "returns", "--out-dir", str(out_dir), "--runs", *map(str, folders)]
    monkeypatch.setattr(sys, "argv", command)
    try:
        benchmark.main()
    except SystemExit as end:
        return str(end.code)
    return capsys.readouterr().out


def rewrite(folder, **changes):
    file = folder / "args.json"
    file.write_text(json.dumps({**harness.read_json(file), **changes}))


@pytest.mark.skipif(shutil.which("xargs") is None, reason="has no xargs")
class TestMerging:
    def test_calls_in_the_same_moment_each_have_a_folder_of_their_own(self, ten_calls):
        assert len(ten_calls) == 10
        seeds = [harness.read_json(folder / "args.json")["seed"] for folder in ten_calls]
        assert sorted(seeds) == [[seed] for seed in range(1, 11)]
        for folder, (seed,) in zip(ten_calls, seeds):
            assert [x.name for x in folder.glob("seed-*")] == [f"seed-{seed}"]

    def test_ten_calls_make_the_same_table_as_one_with_ten_seeds(
            self, ten_calls, tmp_path, capsys, monkeypatch):
        one = tmp_path / "one call"
        shutil.copytree(ten_calls[0], one)
        rewrite(one, seed=list(range(1, 11)))
        for folder in ten_calls[1:]:
            shutil.copytree(next(folder.glob("seed-*")), one / next(folder.glob("seed-*")).name)
        tables = []
        for folders in (ten_calls, ten_calls[::-1], [one]):
            out = merge(folders, tmp_path, capsys, monkeypatch)
            tables.append([x for x in out.splitlines() if x.startswith("| harness:ThreeSteps")])
            data = pd.read_csv(tmp_path / "returns.csv")
            assert data["seed"].tolist() == list(range(1, 11))
            assert "different packages" not in out
        assert len(tables[0]) == 1
        assert tables[0] == tables[1] == tables[2]

    def test_all_runs_that_cannot_count_are_named(
            self, ten_calls, tmp_path, capsys, monkeypatch):
        cut, twice, empty = (tmp_path / name for name in ("cut", "twice", "empty"))
        for source, copy in zip(ten_calls[:3], (cut, twice, empty)):
            shutil.copytree(source, copy)
        (evals,) = cut.glob("*/evals.csv")
        pd.read_csv(evals).iloc[:1].to_csv(evals, index=False)  # killed after its first evaluation
        (seed,) = empty.glob("seed-*")
        shutil.rmtree(seed)
        text = merge([*ten_calls[1:2], cut, twice, empty], tmp_path, capsys, monkeypatch)
        assert text.startswith("error: these runs cannot count")
        (number,) = harness.read_json(cut / "args.json")["seed"]
        assert f"{cut}: seed {number} ended at 0 of 32" in text
        assert f"{empty}: {seed.name.replace('-', ' ')} has saved nothing" in text
        assert f"is in {ten_calls[1]}, too" in text
        assert not (tmp_path / "returns.csv").exists()

    def test_a_folder_that_is_given_twice_counts_as_a_seed_that_comes_twice(
            self, ten_calls, tmp_path, capsys, monkeypatch):
        text = merge([ten_calls[0], ten_calls[0]], tmp_path, capsys, monkeypatch)
        assert f"is in {ten_calls[0]}, too" in text

    def test_other_flags_and_lengths_get_a_row_of_their_own(
            self, ten_calls, tmp_path, capsys, monkeypatch):
        folders = [tmp_path / name for name in ("usual", "no discount", "shorter")]
        for copy in folders:
            shutil.copytree(ten_calls[0], copy)
        rewrite(folders[1], gamma=0.5)
        rewrite(folders[2], total_steps=16)
        out = merge(folders, tmp_path, capsys, monkeypatch)
        assert sum(x.startswith("| harness:ThreeSteps") for x in out.splitlines()) == 3
        assert "--gamma 0.5" in out

    def test_different_package_versions_are_named(self, ten_calls, tmp_path, capsys, monkeypatch):
        other = tmp_path / "other"
        shutil.copytree(ten_calls[1], other)
        versions = harness.read_json(other / "args.json")["versions"]
        rewrite(other, versions={**versions, "mujoco": "2.0"})
        out = merge([ten_calls[0], other], tmp_path, capsys, monkeypatch)
        (line,) = [x for x in out.splitlines() if x.startswith(f"{other}: ")]
        assert '"mujoco": "2.0"' in line


def test_a_flag_without_a_value_is_shown_as_it_is_written():
    config = {"randomize": True, "watch": False, "num_envs": 4}
    assert benchmark.written_flags(config, config) == "--randomize --num-envs 4"
