"""What a run leaves: its folder, tables, args.json, checkpoint, and the lines it prints."""

import itertools
import json
import math
import re
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS, only
from harness import ROOT, World, read_json, register, results, run, table


class Counts(World):
    def observe(self):
        return np.array([self.steps, 7])


register("Counts", Counts, observations=gym.spaces.Box(0, 9, (2,), np.int64))
TABLES = "episodes", "metrics", "evals"
METRICS = {
    "reinforce_mujoco": ["policy_loss", "value_loss", "policy_std"],
    "a2c_vector": ["policy_loss", "value_loss", "explained_variance", "entropy"],
    "ppo_continuous": ["learning_rate", "policy_loss", "value_loss", "explained_variance",
                       "approximate_kl", "clip_fraction"],
}


def steps(folder, name="metrics"):
    return pd.read_csv(folder / f"{name}.csv")["env_step"].tolist()


def load(folder):
    return torch.load(folder / "checkpoint.pt", weights_only=True)


def test_a_run_leaves_one_new_folder_and_nothing_else(script, runs, folder):
    assert [path.name for path in runs[script.name][0].iterdir()] == ["runs"]
    assert re.fullmatch(rf"{script.env_id}__{script.name}__\d{{8}}_\d{{6,}}", folder.name)
    files = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    seeds = {f"seed-{seed}/{name}.csv" for seed in script.seeds for name in TABLES}
    checkpoints = {f"seed-{seed}/checkpoint.pt" for seed in script.seeds}
    assert files == {"args.json", "learning_curve.png"} | seeds | checkpoints


def test_tables_have_their_columns_and_a_number_in_each(script, folder):
    columns = {
        "episodes": ["env_step", "return", "length"],
        "metrics": ["env_step", *METRICS[script.name]],
        "evals": ["env_step", "seconds", "return_mean", "return_std", "length_mean"],
    }
    for name, expected in columns.items():
        data = pd.read_csv(folder / f"seed-3/{name}.csv")
        assert sorted(data) == sorted(expected)
        assert data.columns[0] == "env_step"
        assert len(data) > 1
        assert np.isfinite(data).all(axis=None)
        assert data["env_step"].is_monotonic_increasing


def test_evaluations_come_before_training_at_its_end_and_in_between(script, folder):
    evals, updates = steps(folder / "seed-3", "evals"), steps(folder / "seed-3")
    assert evals[0] == 0
    assert evals[-1] == updates[-1] >= 512
    assert set(evals) <= {0, *updates}
    if script.name == "reinforce_mujoco":
        assert 3 <= len(evals) <= 5
    else:
        assert evals == [0, 128, 256, 384, 512]


@only("a2c_vector", "ppo_continuous")
def test_an_evaluation_comes_at_the_first_update_that_reaches_its_step(script, tmp_path):
    """Of 1000 steps and 30 evaluations, each is due after 33 or 34 more; an update is 10 steps."""
    options = "--num-envs 2 --rollout-steps 5 --eval-episodes 1 --total-steps 1000 --num-evals 30"
    folder = script.train(tmp_path, *options.split())
    assert steps(folder, "evals") == [10 * math.ceil((1000 * k // 30) / 10) for k in range(31)]


def test_seconds_are_those_of_training_alone(script, tmp_path, monkeypatch):
    """Here each look at the clock takes a second, and an evaluation an hour."""
    clock = itertools.count()
    own_time = SimpleNamespace(perf_counter=lambda: float(next(clock)))
    monkeypatch.setattr(script.module, "time", own_time)

    def evaluate(*_):
        for _ in range(3600):
            next(clock)
        return {"return_mean": 0.0}

    monkeypatch.setattr(script.module, "evaluate", evaluate)
    folder = script.train(tmp_path)
    evals = pd.read_csv(folder / "evals.csv")
    updates = [0, *steps(folder)]
    assert evals["seconds"].tolist() == [1 + updates.index(step) for step in evals["env_step"]]


def test_args_json_says_what_was_run(script, folder):
    args = read_json(folder / "args.json")
    assert (args["env_id"], args["seed"]) == (script.env_id, list(script.seeds))
    options = ["--env-id", script.env_id, *script.small, "--seed", *map(str, script.seeds)]
    assert args["command"] == [str(ROOT / script.file), *options]
    engine = "Box2D" if script.name == "a2c_vector" else "mujoco"
    assert list(args["versions"]) == ["torch", "gymnasium", engine, "numpy"]
    assert args["versions"]["numpy"] == np.__version__
    assert set(args) == {*vars(script.module.parse_args([])), "command", "versions"}


def test_a_checkpoint_holds_the_options_the_tables_and_the_agent(script, folder):
    checkpoint = load(folder / "seed-3")
    optimizer = set() if script.name == "reinforce_mujoco" else {"optimizer"}
    assert set(checkpoint) == {"args", "tables", "agent"} | optimizer
    args = read_json(folder / "args.json")
    assert {**args, **checkpoint["args"]} == {**args, "seed": [3]}
    for name in TABLES:
        written = pd.read_csv(folder / f"seed-3/{name}.csv")
        pd.testing.assert_frame_equal(pd.DataFrame(checkpoint["tables"][name]), written)


def test_a_run_prints_a_line_for_each_seed_and_no_warning(script, runs, folder):
    cwd, process = runs[script.name]
    assert process.out.splitlines()[0] == str(folder.relative_to(cwd))
    printed = results(process)
    for seed, (name, row) in zip(script.seeds, printed.iterrows(), strict=True):
        assert name == f"seed-{seed}"
        last = pd.read_csv(folder / f"{name}/evals.csv").iloc[-1][list(row.index)]
        pd.testing.assert_series_equal(row, last.round(1), check_names=False)
    assert "Warning" not in process.out + process.err
    assert "nan" not in (process.out + process.err).lower()


def test_one_that_ends_early_keeps_what_was_saved_and_each_file_is_whole(
        script, tmp_path, monkeypatch):
    """A crash at each call that writes: afterwards all files are those of one evaluation."""
    class CrashError(Exception):
        pass

    def crash_at(count, function):
        calls = itertools.count(1)

        def crashing(*args, **kwargs):
            if next(calls) == count:
                raise CrashError
            return function(*args, **kwargs)

        return crashing

    for owner, name, count in (pd.DataFrame, "to_csv", 6), (torch, "save", 3):
        folder = tmp_path / name
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, crash_at(count, getattr(owner, name)))
            with pytest.raises(CrashError):
                script.train(folder)
        seed = folder / "seed-3"
        saved = load(seed)["tables"]["evals"]
        assert len(saved) == 2
        assert steps(seed, "evals") == [row["env_step"] for row in saved]


ACT = """
import json, sys
from importlib import import_module
import gymnasium as gym, numpy as np, torch
name, path, obs = sys.argv[1:]
script = import_module(name)
args = script.parse_args(["--watch", path])
env = gym.make(args.env_id)
agent = script.Agent(env.observation_space, env.action_space, args)
agent.load_state_dict(torch.load(path, weights_only=True)["agent"])
torch.manual_seed(0)
print(json.dumps([agent.act(np.load(obs), x).tolist() for x in (True, False)]))
"""


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_new_process_acts_like_the_one_that_trained(name, tmp_path, monkeypatch):
    """And importing a script runs nothing: it prints and writes nothing."""
    script, agents = SCRIPTS[name], []

    def remember(agent, envs, seed):
        agents[:] = [agent]
        return {"return_mean": 0.0}

    monkeypatch.setattr(script.module, "evaluate", remember)
    folder = script.train(tmp_path / "run")
    obs = np.random.default_rng(0).normal(size=(100, 4))
    torch.manual_seed(0)
    deterministic, sampled = (agents[0].act(obs, x).tolist() for x in (True, False))
    assert deterministic != sampled
    np.save(tmp_path / "obs.npy", obs)
    (tmp_path / "act.py").write_text(ACT)
    (tmp_path / "empty").mkdir()
    arguments = name, folder / "checkpoint.pt", tmp_path / "obs.npy"
    process = run(tmp_path / "act.py", *arguments, cwd=tmp_path / "empty", PYTHONPATH=str(ROOT))
    assert json.loads(process.out) == [deterministic, sampled]
    assert process.err == ""
    assert not list((tmp_path / "empty").iterdir())


def test_observations_may_be_whole_numbers(script, tmp_path):
    folder = script.train(tmp_path, env_id=f"{script.worlds}Counts-v0")
    assert table(folder / "evals.csv")["return_mean"].tolist()[-1] == 3
