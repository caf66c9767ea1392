"""The scripts as a user runs them: files, seeds, Ctrl-C, resume, mistakes, learning."""

import ast
import contextlib
import ctypes.util
import importlib.metadata
import json
import math
import pickle
import random
import re
import shutil
import signal
import sys
import time
from collections import defaultdict
from itertools import combinations
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from harness import ROOT, TARGET, read_json, run, run_folder, start, table
from PIL import Image

import a2c_vector
import ppo_continuous as ppo
import reinforce_mujoco


class Script(NamedTuple):
    module: ModuleType
    env_id: str
    sizes: str  # of a run that is as short as possible
    metrics: str  # columns between env_step and steps_per_second
    worlds: str = ""  # the prefix of worlds with fitting actions
    flags: tuple = ("--watch",)  # what takes a checkpoint
    first_save: int = 32  # the step of an environment at which the first update ends

    @property
    def name(self):
        return self.module.__name__

    @property
    def file(self):
        return f"{self.name}.py"

    @property
    def small(self):
        return [*self.sizes.split(), "--eval-episodes", "2"]

    @property
    def short(self):
        return ["--env-id", self.env_id, "--total-steps", "512", *self.small]

    @property
    def three_steps(self):
        return ["--env-id", f"harness:{self.worlds}ThreeSteps-v0", *self.small]


REINFORCE = Script(
    reinforce_mujoco, "InvertedPendulum-v5", "--batch-episodes 8",
    "policy_loss value_loss entropy policy_std grad_norm learning_rate", first_save=24,
)
A2C = Script(
    a2c_vector, "CartPole-v1", "--num-envs 4 --rollout-steps 32",
    "policy_loss value_loss entropy explained_variance grad_norm critic_grad_norm learning_rate",
    "Discrete",
)
PPO = Script(
    ppo, "InvertedPendulum-v5", "--num-envs 4 --rollout-steps 32 --minibatch-size 32 --epochs 2",
    "policy_loss value_loss entropy approx_kl clip_fraction explained_variance grad_norm "
    "policy_std learning_rate", flags=("--watch", "--resume"),
)
SCRIPTS = {script.name: script for script in (REINFORCE, A2C, PPO)}
SCRIPT, SMALL, SHORT, THREE_STEPS = PPO.file, PPO.small, PPO.short, PPO.three_steps
BATCH = 4 * 32


@pytest.fixture(scope="session", params=SCRIPTS)
def script(request):
    return SCRIPTS[request.param]


def only(*scripts):
    """A test for some scripts; all others are for each of them."""
    return pytest.mark.parametrize("script", [x.name for x in scripts], indirect=True)


@pytest.fixture(scope="session")
def place(script, tmp_path_factory):
    """Where two calls with one seed were made: the first without, the second with evaluations."""
    cwd = tmp_path_factory.mktemp("runs")
    for eval_every in 0, 1:
        options = "--seed", 3, "--eval-every", eval_every
        process = run(script.file, *script.short, *options, cwd=cwd, python=["-W", "error"])
        assert "Warning" not in process.err + process.out
    return cwd


@pytest.fixture(scope="session")
def folder(place):
    return min(place.glob("runs/*"))


@pytest.fixture(scope="session")
def evaluated(place):
    return max(place.glob("runs/*"))


# --- Files ----------------------------------------------------------------------------------------


def test_a_call_leaves_one_new_folder_and_nothing_else(script, place, folder, evaluated):
    assert [p.name for p in place.iterdir()] == ["runs"]
    assert len(list(place.glob("runs/*"))) == 2
    for path in folder, evaluated:
        assert re.fullmatch(rf"{script.env_id}__{script.name}__\d{{8}}_\d+", path.name)


def test_a_run_folder_holds_every_file_with_every_column(script, folder):
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    files = "episodes.csv", "metrics.csv", "evals.csv", "checkpoint.pt", "summary.json"
    assert names == {"args.json", "learning_curve.png", *(f"seed-3/{name}" for name in files)}
    columns = {
        "episodes": "env_step return length",
        "evals": "env_step return_mean return_std length_mean episodes",
        "metrics": f"env_step {script.metrics} steps_per_second",
    }
    for name, expected in columns.items():
        data = pd.read_csv(folder / f"seed-3/{name}.csv")
        assert set(data) == set(expected.split())
        assert data.columns[0] == "env_step"
        assert len(data)
        assert np.isfinite(data).all(axis=None)
        assert data["env_step"].is_monotonic_increasing
    with Image.open(folder / "learning_curve.png") as image:
        assert image.size[0] > 1000


def test_args_json_and_summary_json_say_what_was_run(script, folder):
    args, summary = read_json(folder / "args.json"), read_json(folder / "seed-3/summary.json")
    assert args["env_id"] == summary["env_id"] == script.env_id
    assert (args["seed"], summary["seed"], summary["script"]) == ([3], 3, script.name)
    assert set(vars(script.module.parse_args(script.short))) < set(args)
    assert "--total-steps" in args["command"]
    assert {"torch", "gymnasium", "mujoco", "box2d", "numpy"} <= set(args["versions"])
    assert args["versions"] == summary["versions"]
    steps = pd.read_csv(folder / "seed-3/metrics.csv")["env_step"].iloc[-1]
    assert summary["env_steps"] == steps
    assert steps == 512 if script is not REINFORCE else steps >= 512
    assert summary["steps_per_second"] == pytest.approx(steps / summary["train_seconds"])
    last = pd.read_csv(folder / "seed-3/evals.csv").iloc[-1]
    for name in "return_mean", "return_std", "episodes":
        assert summary[f"eval_{name}"] == pytest.approx(last[name])


def test_the_learning_rate_falls_with_every_update_but_not_to_0(script, folder):
    """An update's is 1 − steps before it / steps in all, times that of the first."""
    metrics = pd.read_csv(folder / "seed-3/metrics.csv")
    share = metrics["env_step"].shift(fill_value=0) / 512
    first = metrics["learning_rate"][0]
    assert first in vars(script.module.parse_args(script.short)).values()
    np.testing.assert_allclose(metrics["learning_rate"], first * (1 - share))
    assert metrics["learning_rate"].iloc[-1] > 0
    if script is not REINFORCE:
        assert metrics["env_step"].tolist() == [128, 256, 384, 512]


@only(A2C, PPO)
def test_statistics_count_every_real_observation_once(folder):
    agent = torch.load(folder / "seed-3/checkpoint.pt", weights_only=True)["agent"]
    assert agent["policy.norm.count"] == 512
    assert agent.get("reward_norm.count", 512) == 512  # PPO's


@only(A2C, PPO)
def test_no_episode_has_to_end_in_a_run(script, tmp_path):
    env_id, steps = {A2C: ("CartPole-v1", 16), PPO: ("HalfCheetah-v5", 128)}[script]
    options = [*script.small, "--rollout-steps", str(steps // 4), "--total-steps", str(steps)]
    args = script.module.parse_args(["--env-id", env_id, *options, "--eval-episodes", "1"])
    script.module.train(args, 1, tmp_path / "seed-1", tmp_path / "stop")
    script.module.plot(tmp_path)
    assert len(pd.read_csv(tmp_path / "seed-1/episodes.csv")) == 0
    assert (tmp_path / "learning_curve.png").exists()


def test_observations_may_be_integers(script, tmp_path):
    world = f"harness:{script.worlds}Counts-v0"
    args = script.module.parse_args([*script.small, "--env-id", world, "--total-steps", "256"])
    script.module.train(args, 1, tmp_path / "seed-1", tmp_path / "stop")
    assert read_json(tmp_path / "seed-1/summary.json")["eval_return_mean"] == 3


def test_a_package_that_is_not_installed_is_left_out_of_the_versions(script, monkeypatch):
    version = importlib.metadata.version

    def without_box2d(name):
        if name == "box2d":
            raise importlib.metadata.PackageNotFoundError(name)
        return version(name)

    everything = script.module.versions()
    monkeypatch.setattr(importlib.metadata, "version", without_box2d)
    assert script.module.versions() == {k: x for k, x in everything.items() if k != "box2d"}
    assert "box2d" in everything


# --- Seeds ----------------------------------------------------------------------------------------


def test_evaluation_does_not_touch_training(folder, evaluated):
    for name in "episodes.csv", "metrics.csv":
        pd.testing.assert_frame_equal(
            table(folder / "seed-3" / name), table(evaluated / "seed-3" / name), check_exact=True
        )
    once, often = (pd.read_csv(x / "seed-3/evals.csv") for x in (folder, evaluated))
    updates = len(pd.read_csv(folder / "seed-3/metrics.csv"))
    assert (len(once), len(often)) == (1, updates)
    assert updates > 1
    assert once.iloc[-1].equals(often.iloc[-1])


def test_seeds_side_by_side_equal_seeds_alone(script, folder, tmp_path):
    options = "--seed", 3, 4, "--eval-every", 0, "--out-dir", "my runs"
    run(script.file, *script.short, *options, cwd=tmp_path, python=["-W", "error"])
    assert [p.name for p in tmp_path.iterdir()] == ["my runs"]
    (both,) = tmp_path.glob("my runs/*")
    assert sorted(p.name for p in both.glob("seed-*")) == ["seed-3", "seed-4"]
    assert (both / "learning_curve.png").exists()
    for name in "episodes.csv", "metrics.csv", "evals.csv":
        alone, third = table(folder / "seed-3" / name), table(both / "seed-3" / name)
        pd.testing.assert_frame_equal(alone, third, check_exact=True)
        assert not third.equals(table(both / "seed-4" / name))


# --- Ctrl-C, kill, resume -------------------------------------------------------------------------


def wait_for_rows(process, cwd, more):
    """Wait until metrics.csv has grown by `more` rows; gives its number of rows."""

    def rows():
        with contextlib.suppress(ValueError, OSError):
            return (run_folder(cwd) / "seed-1/metrics.csv").read_text().count("\n")
        return 0

    first = rows()
    while rows() < first + more:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.01)
    return rows()


def check_tables(seed_folder, batch=BATCH):
    """Every update is there once, and the other tables are sorted and go no further."""
    steps = pd.read_csv(seed_folder / "metrics.csv")["env_step"]
    assert steps.tolist() == [batch * (i + 1) for i in range(len(steps))]
    evals = pd.read_csv(seed_folder / "evals.csv")["env_step"]
    episodes = pd.read_csv(seed_folder / "episodes.csv")["env_step"]
    assert evals.is_monotonic_increasing
    assert evals.is_unique
    assert episodes.is_monotonic_increasing
    assert evals.iloc[-1] == steps.iloc[-1] >= episodes.iloc[-1]
    assert read_json(seed_folder / "summary.json")["env_steps"] == steps.iloc[-1]
    return steps.iloc[-1]


@pytest.fixture(scope="session")
def interrupted(script, tmp_path_factory):
    """A run that got Ctrl-C, and its working directory."""
    cwd = tmp_path_factory.mktemp("interrupted")
    options = "--total-steps", 10**6, "--eval-every", 5
    process = start(script.file, *script.three_steps, *options, cwd=cwd)
    wait_for_rows(process, cwd, more=4)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    return run_folder(cwd)


def test_ctrl_c_ends_after_the_current_update_with_every_file(script, interrupted):
    batch = 8 * 3 if script is REINFORCE else BATCH
    assert 4 * batch <= check_tables(interrupted / "seed-1", batch) < 10**6
    assert (interrupted / "learning_curve.png").exists()
    assert (interrupted / "seed-1/checkpoint.pt").exists()


def test_ctrl_c_before_its_turn_leaves_a_seed_out(script, tmp_path):
    stop, args = tmp_path / "stop", script.module.parse_args(script.three_steps)
    stop.touch()
    script.module.train(args, 1, tmp_path / "seed-1", stop)
    assert list(tmp_path.iterdir()) == [stop]


@pytest.mark.parametrize("during", ["evaluate", "save_checkpoint"])
def test_ctrl_c_at_any_moment_of_an_update_is_followed_by_an_evaluation(
    script, during, tmp_path, monkeypatch
):
    """After it was decided whether this update is the last, it is too late for this update."""
    args = script.module.parse_args([*script.three_steps, "--total-steps", "2048"])
    args.eval_every = 2
    stop, function = tmp_path / "stop", getattr(script.module, during)

    def stop_and_go_on(*args, **kwargs):
        stop.touch()
        return function(*args, **kwargs)

    monkeypatch.setattr(script.module, during, stop_and_go_on)
    script.module.train(args, 1, tmp_path / "seed-1", stop)
    batch = 8 * 3 if script is REINFORCE else BATCH
    assert check_tables(tmp_path / "seed-1", batch) <= 3 * batch


def test_a_run_killed_at_any_three_moments_is_resumed_without_gap_or_repeat(tmp_path):
    options = "--total-steps", 150 * BATCH, "--eval-every", 5
    process = start(SCRIPT, *THREE_STEPS, *options, cwd=tmp_path)
    for _ in range(3):
        wait_for_rows(process, tmp_path, more=random.randint(6, 20))  # it saves each 5th time
        time.sleep(random.uniform(0, 0.05))
        process.kill()
        assert process.wait() == -signal.SIGKILL
        process.communicate()
        checkpoint = run_folder(tmp_path) / "seed-1/checkpoint.pt"
        process = start(SCRIPT, "--resume", checkpoint, cwd=tmp_path)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert check_tables(run_folder(tmp_path) / "seed-1") == 150 * BATCH
    metrics = pd.read_csv(run_folder(tmp_path) / "seed-1/metrics.csv")
    np.testing.assert_allclose(metrics["learning_rate"], 1e-3 * (1 - np.arange(150) / 150))


def test_rows_written_after_the_last_checkpoint_do_not_come_twice(tmp_path, monkeypatch):
    """Random kills hardly ever hit the moment between the rows of an update and its checkpoint."""
    args = ppo.parse_args([*THREE_STEPS, "--total-steps", str(8 * BATCH), "--eval-every", "1"])
    folder, stop, save = tmp_path / "seed-1", tmp_path / "stop", ppo.save_checkpoint

    def die_at_update_4(*whose, **state):
        if state["progress"][0] == 4:
            raise KeyboardInterrupt
        save(*whose, **state)

    with monkeypatch.context() as patch:
        patch.setattr(ppo, "save_checkpoint", die_at_update_4)
        with pytest.raises(KeyboardInterrupt):
            ppo.train(args, 1, folder, stop)
    assert len(pd.read_csv(folder / "metrics.csv")) == 4
    checkpoint = torch.load(folder / "checkpoint.pt", weights_only=True)
    assert checkpoint["progress"][0] == 3
    args.resume = folder / "checkpoint.pt"
    ppo.train(args, 1, folder, stop)
    assert check_tables(folder) == 8 * BATCH


@only(PPO)
def test_resuming_a_finished_run_adds_no_row_and_brings_back_its_summary(folder, tmp_path):
    """A run can be killed between its last checkpoint and its summary."""
    copy = shutil.copytree(folder, tmp_path / "run")
    (copy / "seed-3/summary.json").unlink()
    run(SCRIPT, "--resume", copy / "seed-3/checkpoint.pt", cwd=tmp_path)
    for name in "episodes.csv", "metrics.csv", "evals.csv":
        assert (copy / "seed-3" / name).read_bytes() == (folder / "seed-3" / name).read_bytes()
    assert read_json(copy / "seed-3/summary.json") == read_json(folder / "seed-3/summary.json")


# --- Checkpoints, watching ------------------------------------------------------------------------

ACT = """
import argparse, json, sys
import gymnasium as gym, numpy as np, torch
import SCRIPT as script
checkpoint = torch.load(sys.argv[1], weights_only=True)
args = argparse.Namespace(**checkpoint["args"], device="cpu")
agent = script.make_agent(args, gym.make(args.env_id))
agent.load_state_dict(checkpoint["agent"])
obs = np.load(sys.argv[2])
torch.manual_seed(0)
print(json.dumps([agent["policy"].act(obs, x)[1].tolist() for x in (True, False)]))
"""


def test_a_new_process_acts_like_the_one_that_trained(script, tmp_path, monkeypatch):
    obs, last = np.random.default_rng(0).normal(size=(100, 4)), []
    module, save = script.module, script.module.save_checkpoint

    def save_and_act(folder, args, seed, **state):
        save(folder, args, seed, **state)
        agent = module.make_agent(args, gym.make(args.env_id))
        agent.load_state_dict(state["agent"])
        torch.manual_seed(0)
        last[:] = [agent["policy"].act(obs, x)[1].tolist() for x in (True, False)]

    monkeypatch.setattr(module, "save_checkpoint", save_and_act)
    module.train(module.parse_args(script.short), 1, tmp_path / "seed-1", tmp_path / "stop")
    np.save(tmp_path / "obs.npy", obs)
    Path(tmp_path, "act.py").write_text(ACT.replace("SCRIPT", script.name))
    paths = tmp_path / "seed-1/checkpoint.pt", tmp_path / "obs.npy"
    process = run(tmp_path / "act.py", *paths, cwd=tmp_path, PYTHONPATH=str(ROOT))
    assert json.loads(process.out) == last
    deterministic, sampled = last
    assert deterministic != sampled
    assert len(set(map(str, sampled))) > (1 if script is A2C else 50)  # A2C's are 0 or 1


@pytest.fixture
def checkpoint(folder, tmp_path):
    return Path(shutil.copy(folder / "seed-3/checkpoint.pt", tmp_path))


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window opens")
def test_watching_without_a_display_makes_a_gif(script, checkpoint, tmp_path):
    if script is not A2C and not ctypes.util.find_library("EGL"):
        pytest.skip("no EGL here")
    before = checkpoint.read_bytes()
    (tmp_path / "runs").touch()  # no run folder could be made here, and none is needed
    process = run(script.file, "--watch", checkpoint, cwd=tmp_path)
    assert re.search(r"return [\d.]+ in \d+ steps", process.out)
    with Image.open(checkpoint.with_suffix(".gif")) as gif:
        assert gif.n_frames > 1
    assert {p.name for p in tmp_path.iterdir()} == {"checkpoint.pt", "checkpoint.gif", "runs"}
    assert checkpoint.read_bytes() == before


@only(REINFORCE, PPO)
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window opens")
def test_watching_without_graphics_ends_in_one_clear_line(script, checkpoint, tmp_path):
    process = start(script.file, "--watch", checkpoint, cwd=tmp_path, MUJOCO_GL="invalid")
    out, err = process.communicate(timeout=60)
    assert process.returncode > 0
    assert err.count("\n") == 1
    assert "MUJOCO_GL" in err
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.pt"]


# --- Mistakes -------------------------------------------------------------------------------------


def check_refusal(error, *mentions):
    assert error.count("\n") == 1
    assert "Traceback" not in error
    for text in mentions:
        assert text in error


def refusal(capsys, script, *arguments):
    """The one line that a wrong call ends with."""
    with pytest.raises(SystemExit) as end:
        script.module.parse_args([str(x) for x in arguments])
    out, err = capsys.readouterr()
    assert (end.value.code, out) == (2, "")
    return err


WRONG = [  # for every script, and what its message must contain
    ("--env-id InvertedPendlum-v5", "Did you mean: `InvertedPendulum`"),
    ("--env-id no_such_module:Some-v0", "no_such_module"),
    ("--env-id harness:DictObs-v0", "Dict"),
    ("--env-id harness:Image-v0", "Box"),
    ("--total-steps 0", "got 0"),
    ("--eval-episodes 0", "got 0"),
    ("--eval-every -1", "got -1"),
    ("--gamma 1.01", "got 1.01"),
    ("--gamma -0.1", "got -0.1"),
    ("--learning-rate nan", "got nan"),
    ("--learning-rate inf", "got inf"),
    ("--learning-rate fast", "fast"),
    ("--seed -1", "got -1"),
    ("--seed 1 2 1", "[1, 2, 1]"),
    ("--seed", "argument"),
    ("--out-dir a_file/below", "a_file"),
    ("--device tpu", "tpu"),
    ("--device cuda:99", "cuda:99"),
    ("--watch no/checkpoint.pt", "no/checkpoint.pt"),
    ("--watch .", "checkpoint"),
    ("--watch a_file", "checkpoint"),
    ("--no-such-flag 1", "--no-such-flag"),
]
WRONG_VECTOR = [
    ("--num-envs 0", "got 0"),
    ("--num-envs 2.5", "2.5"),
    ("--rollout-steps -1", "got -1"),
    ("--gae-lambda 2", "got 2"),
    ("--hidden-size 0", "got 0"),
]
WRONG_ONLY = {
    REINFORCE.name: [
        ("--env-id CartPole-v1", "a2c_vector.py"),
        ("--batch-episodes 0", "got 0"),
        ("--batch-episodes 1.5", "1.5"),
        ("--baseline median", "median"),
        ("--resume no/checkpoint.pt", "unrecognized"),
    ],
    A2C.name: [
        *WRONG_VECTOR,
        ("--env-id InvertedPendulum-v5", "ppo_continuous.py"),
        ("--total-steps 511", "512"),
        ("--vectorization threads", "threads"),
        ("--randomize --env-id CartPole-v1", "LunarLander"),
        ("--resume no/checkpoint.pt", "unrecognized"),
    ],
    PPO.name: [
        *WRONG_VECTOR,
        ("--env-id CartPole-v1", "a2c_vector.py"),
        ("--env-id harness:Unbounded-v0", "bounded"),
        ("--total-steps 2047", "2048"),
        ("--minibatch-size 2049", "2048"),
        ("--minibatch-size 1", "got 1"),
        ("--epochs 0", "got 0"),
        ("--log-std 9", "got 9"),
        ("--squash sigmoid", "sigmoid"),
        ("--resume no/checkpoint.pt", "no/checkpoint.pt"),
    ],
}


@pytest.mark.parametrize(
    ("name", "arguments", "mentions"),
    [(name, *row) for name, rows in WRONG_ONLY.items() for row in WRONG + rows],
)
def test_a_wrong_argument_is_named_in_one_line(
    name, arguments, mentions, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("a_file").touch()
    flag, *_ = arguments.split()
    check_refusal(refusal(capsys, SCRIPTS[name], *arguments.split()), flag, mentions)
    assert [p.name for p in tmp_path.iterdir()] == ["a_file"]


def test_a_wrong_call_as_the_user_sees_it(script, tmp_path):
    process = run(script.file, "--env-id", "Ant-v99", cwd=tmp_path, status=2)
    check_refusal(process.err, f"{script.file}: error: argument --env-id: got Ant-v99", "v5")
    assert process.out == ""
    assert not list(tmp_path.iterdir())


def test_a_damaged_or_foreign_checkpoint_is_refused(script, checkpoint, capsys):
    whole, content = checkpoint.read_bytes(), torch.load(checkpoint, weights_only=True)
    for flag in script.flags:
        checkpoint.write_bytes(whole[: len(whole) // 2])
        error = refusal(capsys, script, flag, checkpoint)
        check_refusal(error, f"argument {flag}: ", str(checkpoint))
        torch.save({**content, "script": "another"}, checkpoint)
        check_refusal(refusal(capsys, script, flag, checkpoint), f"argument {flag}: ", script.file)
        torch.save([1, 2], checkpoint)
        check_refusal(refusal(capsys, script, flag, checkpoint), f"argument {flag}: ")


@pytest.mark.parametrize("other", ["--env-id", "--gamma 0.5", "--seed 4"])
def test_a_checkpoint_keeps_its_arguments(script, other, checkpoint, capsys):
    before = checkpoint.read_bytes()
    if other == "--env-id":
        other += " Acrobot-v1" if script is A2C else " Hopper-v5"
    for flag in script.flags:
        error = refusal(capsys, script, flag, checkpoint, *other.split())
        check_refusal(error, f"argument {other.split()[0]}: ", "as in the checkpoint")
    assert checkpoint.read_bytes() == before


class Malicious:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_checkpoint_cannot_run_code(script, tmp_path, capsys):
    checkpoint, victim = tmp_path / "checkpoint.pt", tmp_path / "victim"
    content = {"script": script.name, "args": {}, "agent": Malicious(victim)}
    for save in torch.save, lambda x, path: path.write_bytes(pickle.dumps(x)):
        save(content, checkpoint)
        for flag in script.flags:
            check_refusal(refusal(capsys, script, flag, checkpoint), f"argument {flag}: ")
        assert not victim.exists()
    pickle.loads(checkpoint.read_bytes())
    assert victim.exists()  # it would have


def test_nan_and_infinity_are_noticed_wherever_they_are(script):
    for wrong in math.nan, math.inf, -math.inf:
        for observation, reward in (((0, wrong), 1.0), ((wrong, -wrong), 1.0), ((0, 0), wrong)):
            env = script.module.CheckedEnv(gym.make(f"harness:{script.worlds}ThreeSteps-v0"), 0)
            env.reset()
            action, obs = env.action_space.sample(), np.float32(observation)
            env.env = SimpleNamespace(step=lambda _, x=(obs, reward): (*x, False, False, {}))
            with pytest.raises(gym.error.Error, match="NaN or infinity"):
                env.step(action)
        env.env = SimpleNamespace(reset=lambda x=wrong: (np.float32([0, x]), {}))
        with pytest.raises(gym.error.Error, match="NaN or infinity"):
            env.reset()


def check_report(script, error, step, reason, out, cwd):
    assert re.search(rf"error: environment 0\b.* step {step}\b.*{reason}", error)
    saved = list(cwd.glob("runs/*/seed-1/checkpoint.pt"))
    assert len(saved) == (step > script.first_save)
    assert all(str(path.relative_to(cwd)) in out for path in saved)


@pytest.mark.parametrize(
    ("world", "step", "reason"),
    [("FailsLate", 40, "pole broke"), ("TurnsNaN", 40, "NaN"), ("FailsEarly", 2, "pole broke")],
)
def test_a_failing_environment_is_reported(
    script, world, step, reason, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # Ctrl-C remains that of pytest
    world = f"harness:{script.worlds}{world}-v0"
    options = "--env-id", world, "--total-steps", "512", "--eval-every", "1"  # saves each time
    args = script.module.parse_args([*script.small, *options])
    with pytest.raises(SystemExit) as end:
        script.module.train_seeds(args, script.module.make_folder(args))
    check_report(script, end.value.code, step, reason, capsys.readouterr().out, tmp_path)


def test_a_failing_environment_as_the_user_sees_it(script, tmp_path):
    options = "--env-id", f"harness:{script.worlds}FailsLate-v0", "--total-steps", 512
    small = *script.small, "--eval-every", 1
    process = run(script.file, *small, *options, cwd=tmp_path, status=1)
    assert "Traceback" not in process.err
    check_report(script, process.err.splitlines()[-1], 40, "pole", process.out, tmp_path)


# --- Learning -------------------------------------------------------------------------------------


@pytest.mark.parametrize("squash", ["tanh", "clip"])
def test_it_finds_the_best_action_in_an_asymmetric_box(squash, tmp_path):
    options = f"--env-id harness:Target-v0 --total-steps 8192 --num-envs 8 --squash {squash}"
    options += " --rollout-steps 64 --minibatch-size 64 --learning-rate 3e-3 --log-std -1.5"
    args = ppo.parse_args(options.split())
    ppo.train(args, 1, tmp_path / "seed-1", tmp_path / "stop")
    assert read_json(tmp_path / "seed-1/summary.json")["eval_return_mean"] > -0.03
    checkpoint = torch.load(tmp_path / "seed-1/checkpoint.pt", weights_only=True)
    agent = ppo.make_agent(args, gym.make(args.env_id))
    agent.load_state_dict(checkpoint["agent"])
    _, actions = agent["policy"].act(np.float32([[0, 0], [0.5, 0]]), deterministic=True)
    assert np.abs(actions - TARGET).max() < 0.2


def test_it_learns_to_balance_a_pole(tmp_path):
    options = "--env-id InvertedPendulum-v5 --total-steps 24576 --num-envs 8 --rollout-steps 128"
    options += " --minibatch-size 128 --eval-every 0"
    args = ppo.parse_args(options.split())
    ppo.train(args, 1, tmp_path / "seed-1", tmp_path / "stop")
    assert read_json(tmp_path / "seed-1/summary.json")["eval_return_mean"] > 300
    episodes = pd.read_csv(tmp_path / "seed-1/episodes.csv")["return"]
    assert episodes[-20:].mean() > 5 * episodes[:20].mean()


# --- Repository -----------------------------------------------------------------------------------


def test_each_script_and_requirements_txt_ask_for_the_same_packages():
    lines = (ROOT / "requirements.txt").read_text().splitlines()
    listed = [line for line in lines if line and not line.startswith(("#", "pytest"))]
    for script in SCRIPTS.values():
        text = (ROOT / script.file).read_text()
        block = re.search(r"(?ms)^# /// script\n(.*?)^# ///$", text).group(1)
        inline = re.findall(r'(?m)^#     "(.*)",$', block)
        assert len(inline) > 5
        assert sorted(inline) == sorted(listed), script.file


# Where the scripts differ on purpose: this is the algorithm, or its options.
DIFFERENT = {
    "Policy", "main", "make_agent", "make_envs", "optimise", "parse_args", "policy_loss", "train",
    "value_loss",
}


def test_functions_of_the_same_name_have_the_same_source():
    versions = defaultdict(dict)
    for script in SCRIPTS.values():
        text = (ROOT / script.file).read_text()
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                versions[node.name][script.file] = ast.get_source_segment(text, node)
    differ = defaultdict(list)
    for name, sources in versions.items():
        for one, other in combinations(sources, 2):
            if sources[one] != sources[other]:
                differ[name].append((one, other))
    assert {name: pairs for name, pairs in differ.items() if name not in DIFFERENT} == {}
    assert DIFFERENT - differ.keys() == set()  # equal by now: strike them off the list above
