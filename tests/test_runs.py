"""The scripts as a user runs them: files, seeds, Ctrl-C, resume, mistakes, figures, learning."""

import ast
import ctypes.util
import io
import itertools
import json
import math
import os
import pickle
import re
import shutil
import signal
import sys
import time
import traceback
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import torch
import tqdm.std
from harness import ROOT, STRICT, TARGET, read_json, run, run_folder, start, table
from matplotlib.figure import Figure
from PIL import Image

import a2c_vector
import ppo_continuous as ppo
import reinforce_mujoco


class Script(NamedTuple):
    module: ModuleType
    env_id: str
    sizes: str
    worlds: str = ""  # the prefix of worlds with fitting actions
    seeds: tuple = (3,)

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
        return ["--env-id", self.env_id, "--total-steps", "512", "--num-evals", "4", *self.small]

    def world(self, name):
        return f"harness:{self.worlds}{name}-v0"

    def train(self, folder, *arguments, seed=3):
        """Train one seed in this process; gives its folder."""
        args = self.module.parse_args([*self.short, *map(str, arguments)])
        folder.mkdir(parents=True)
        self.module.run(args, seed, folder / f"seed-{seed}")
        return folder / f"seed-{seed}"


REINFORCE = Script(reinforce_mujoco, "InvertedPendulum-v5", "--batch-episodes 8")
A2C = Script(a2c_vector, "CartPole-v1", "--num-envs 4 --rollout-steps 32", "Discrete")
PPO = Script(ppo, "InvertedPendulum-v5",
             "--num-envs 4 --rollout-steps 32 --minibatch-size 32 --epochs 2", seeds=(3, 4))
SCRIPTS = {script.name: script for script in (REINFORCE, A2C, PPO)}
TABLES = "episodes", "metrics", "evals"
FILES = {"checkpoint.pt", *(f"{name}.csv" for name in TABLES)}


@pytest.fixture(scope="session", params=SCRIPTS)
def script(request):
    return SCRIPTS[request.param]


def only(*scripts):
    """A test for some scripts; all others are for each of them."""
    return pytest.mark.parametrize("script", [x.name for x in scripts], indirect=True)


def at_once(function, *iterables):
    """The results of calls that wait for other processes."""
    with ThreadPoolExecutor(4) as pool:
        return list(pool.map(function, *iterables))


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """A finished run of each script, in which warnings are errors; PPO's is of two seeds."""
    places = [tmp_path_factory.mktemp(name) for name in SCRIPTS]

    def train(script, cwd):
        return run(script.file, *script.short, "--seed", *script.seeds, cwd=cwd, python=STRICT)

    processes = at_once(train, SCRIPTS.values(), places)
    return {name: row for name, *row in zip(SCRIPTS, places, processes)}


@pytest.fixture
def folder(script, runs):
    return run_folder(runs[script.name][0])


@pytest.fixture(scope="session")
def alone(script, tmp_path_factory):
    """Seed 3 on its own."""
    return script.train(tmp_path_factory.mktemp("alone") / "run")


@pytest.fixture
def figures(monkeypatch):
    """The figures that this process would have saved, which takes a second each."""
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    yield figures
    plt.close("all")


@pytest.fixture
def call(monkeypatch, tmp_path, capsys, figures):
    """`python script.py arguments` in `tmp_path`, but in this process; gives what it printed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    capsys.readouterr()

    def call(script, *arguments, status=0):
        monkeypatch.setattr(sys, "argv", [script.file, *map(str, arguments)])
        code = 0
        try:
            script.module.main()
        except SystemExit as end:
            code = end.code
            if isinstance(code, str):  # what Python does with it
                print(code, file=sys.stderr)
                code = 1
        out, err = capsys.readouterr()
        assert code == status, err
        return out, err

    return call


def contents(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def snapshot(folder):
    return {name: Path(folder, name).read_bytes() for name in contents(folder)}


def steps(folder, name="metrics"):
    return pd.read_csv(folder / f"{name}.csv")["env_step"].tolist()


def load(folder):
    return torch.load(folder / "checkpoint.pt", weights_only=True)


def last_learning_rate(folder):
    return load(folder)["optimizer"]["param_groups"][0]["lr"]


# --- Files ----------------------------------------------------------------------------------------


def test_a_run_leaves_one_new_folder_and_nothing_else(script, runs, folder):
    assert [path.name for path in runs[script.name][0].iterdir()] == ["runs"]
    assert re.fullmatch(rf"{script.env_id}__{script.name}__\d{{8}}_\d{{6,}}", folder.name)
    seeds = {f"seed-{seed}/{name}" for seed in script.seeds for name in FILES}
    assert contents(folder) == {"args.json", "learning_curve.png", *seeds}
    with Image.open(folder / "learning_curve.png") as image:
        assert image.size[0] > 1000


DIAGNOSTICS = {
    REINFORCE: ["policy_std"],
    A2C: ["explained_variance", "critic_gradient_norm"],
    PPO: ["explained_variance", "policy_std", "approximate_kl", "clip_fraction"],
}


def test_tables_have_their_columns_and_a_number_in_each(script, folder):
    metrics = ["policy_loss", "value_loss", "entropy", "gradient_norm", "steps_per_second"]
    columns = {
        "episodes": ["env_step", "return", "length"],
        "metrics": ["env_step", *metrics, *DIAGNOSTICS[script]],
        "evals": ["env_step", "seconds", "return_mean", "return_std", "length_mean", "episodes"],
    }
    for name, expected in columns.items():
        data = pd.read_csv(folder / f"seed-3/{name}.csv")
        assert sorted(data) == sorted(expected)
        assert data.columns[0] == "env_step"
        assert len(data)
        assert np.isfinite(data).all(axis=None)
        assert data["env_step"].is_monotonic_increasing


def test_evaluations_are_before_training_at_its_end_and_in_between(script, folder):
    evals, updates = steps(folder / "seed-3", "evals"), steps(folder / "seed-3")
    assert (evals[0], evals[-1]) == (0, updates[-1])
    assert set(evals) <= {0, *updates}
    if script is REINFORCE:
        assert 3 <= len(evals) == len(set(evals)) <= 5
        assert updates[-1] >= 512
    else:
        assert updates == [128, 256, 384, 512]
        assert evals == [0, *updates]


def test_args_json_says_what_was_run(script, folder):
    args = read_json(folder / "args.json")
    seeds = list(script.seeds)
    assert (args["env_id"], args["seed"], args["total_steps"]) == (script.env_id, seeds, 512)
    assert args["command"] == [str(ROOT / script.file), *script.short, "--seed", *map(str, seeds)]
    assert args["versions"]["numpy"] == np.__version__
    assert {"torch", "gymnasium", "pytest"} < set(args["versions"])  # all that is installed
    assert set(args) == {*vars(script.module.parse_args([])), "command", "versions"}


def test_a_checkpoint_holds_all_that_training_needs(script, folder):
    checkpoint = load(folder / "seed-3")
    assert set(checkpoint) == {"args", "tables", "agent", "optimizer", "rng"}
    args = read_json(folder / "args.json")
    assert {**args, **checkpoint["args"]} == {**args, "seed": [3]}
    for name in TABLES:
        written = pd.read_csv(folder / f"seed-3/{name}.csv")
        pd.testing.assert_frame_equal(pd.DataFrame(checkpoint["tables"][name]), written)
    if script is not REINFORCE:  # every observation counts once
        assert checkpoint["agent"]["norm.count"] == 512
        assert checkpoint["agent"].get("reward_norm.count", 512) == 512


def test_a_run_prints_its_results_and_no_warning(script, runs, folder):
    process = runs[script.name][1]
    first, *lines = process.out.splitlines()
    relative = folder.relative_to(runs[script.name][0])
    assert first == f"drawing {relative / 'learning_curve.png'}"
    for line, seed in zip(lines, script.seeds):
        last = pd.read_csv(folder / f"seed-{seed}/evals.csv").iloc[-1]
        beginning = f"return {last['return_mean']:.1f} after {last['env_step']:.0f} steps, "
        assert line.startswith(beginning)
        assert line.endswith(f" minutes: {relative / f'seed-{seed}/checkpoint.pt'}")
    assert len(lines) == len(script.seeds)
    assert "Warning" not in process.out + process.err
    assert "nan" not in (process.out + process.err).lower()


def test_the_bar_is_drawn_once_a_second_and_never_shows_nan(script, tmp_path, capsys, monkeypatch):
    """More often, a log file would fill up. Here 0.4 seconds pass at each look at the clock."""
    monkeypatch.setattr(tqdm.std, "time", itertools.count(step=0.4).__next__)
    sizes = {REINFORCE: "--batch-episodes 1"}.get(script, "--num-envs 2 --rollout-steps 2")
    options = "--env-id", script.world("Forever"), *sizes.split(), "--total-steps", 160
    folder = script.train(tmp_path / "run", *options, "--num-evals", 1)
    out, err = capsys.readouterr()
    assert out == ""
    assert "\n" not in err
    assert "nan" not in err
    frames = [frame for frame in err.split("\r") if "seed 3: " in frame]
    assert 3 <= len(frames) < len(steps(folder)) / 2
    assert ("evaluation 8, training not known yet" in err) == (script is not REINFORCE)
    assert "evaluation 8, training 8" in frames[-1]


def test_observations_may_be_integers(script, tmp_path):
    folder = script.train(tmp_path / "run", "--env-id", script.world("Counts"))
    assert pd.read_csv(folder / "evals.csv")["return_mean"].tolist()[-1] == 3


# --- Seeds ----------------------------------------------------------------------------------------


def test_evaluation_does_not_touch_training(script, alone, tmp_path):
    once = script.train(tmp_path / "run", "--num-evals", 1)
    for name in "episodes.csv", "metrics.csv":
        pd.testing.assert_frame_equal(table(once / name), table(alone / name), check_exact=True)
    few, many = table(once / "evals.csv"), table(alone / "evals.csv")
    assert len(few) == 2 < len(many)
    pd.testing.assert_frame_equal(few, many.iloc[[0, -1]].reset_index(drop=True), check_exact=True)


@pytest.mark.parametrize("script", [A2C, PPO])
def test_evaluations_come_at_the_first_update_that_reaches_their_step(script, tmp_path):
    """1000 / 30 is no number that a float can hold: none may come twice or be left out."""
    sizes = "--num-envs 2 --rollout-steps 5 --eval-episodes 1 --total-steps 1000 --num-evals 30"
    folder = script.train(tmp_path / "run", *sizes.split())
    assert steps(folder, "evals") == [math.ceil(100 * k / 30) * 10 for k in range(31)]


def test_seeds_side_by_side_equal_seeds_alone(script, folder, alone):
    for name in "episodes.csv", "metrics.csv", "evals.csv":
        third, *others = (table(folder / f"seed-{seed}" / name) for seed in script.seeds)
        pd.testing.assert_frame_equal(third, table(alone / name), check_exact=True)
        assert not any(third.equals(other) for other in others)


# --- Ctrl-C ---------------------------------------------------------------------------------------

LONG = "--total-steps 1e7 --num-evals 2000 --seed"
STOPS = {  # the script, its environment and options, and the file that shows how far it has got
    "training": (PPO, "ThreeSteps", f"{LONG} 1", "runs/*/seed-1/metrics.csv"),
    "three seeds": (A2C, "ThreeSteps", f"{LONG} 1 2 3", "runs/*/seed-*/metrics.csv"),
    "workers start": (PPO, "ThreeSteps", f"{LONG} 1 2", "runs/*/args.json"),
    "evaluation": (PPO, "Stuck", f"{LONG} 1", "playing"),
    "first episode": (REINFORCE, "StuckInTraining", f"{LONG} 1", "playing"),
}
KILLED = "--rollout-steps 8 --total-steps 1920 --num-evals 12"
KILLS = {"killed": (PPO, "ThreeSteps", KILLED, "runs/*/seed-1/metrics.csv")}
has_groups = pytest.mark.skipif(sys.platform == "win32", reason="no process groups")


@pytest.fixture(scope="session")
def stopped(tmp_path_factory):
    """Runs that got Ctrl-C, as a terminal sends it: to every process; or that were killed."""
    places = {name: tmp_path_factory.mktemp("stopped") for name in STOPS | KILLS}

    def stop(name):
        script, world, options, file = (STOPS | KILLS)[name]
        arguments = "--env-id", script.world(world), *script.small, *options.split()
        process = start(script.file, *arguments, cwd=places[name], own_group=True)
        while not list(places[name].glob(file)):
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.01)
        time.sleep(1 if name in STOPS else 0)
        os.killpg(process.pid, signal.SIGINT if name in STOPS else signal.SIGKILL)
        process.out, process.err = process.communicate(timeout=100)  # of 200 s of evaluation
        return process

    return dict(zip(places, zip(places.values(), at_once(stop, places))))


@has_groups
@pytest.mark.parametrize("moment", STOPS)
def test_ctrl_c_ends_a_run_at_once_and_in_order(moment, stopped):
    script, cwd, process = STOPS[moment][0], *stopped[moment]
    assert process.returncode == 0, process.err
    for word in "Traceback", "KeyboardInterrupt", "Warning", "leaked", "nan":
        assert word not in process.err + process.out, process.err
    folder = run_folder(cwd)
    figure = folder / "learning_curve.png"
    updates = any(folder.glob("*/metrics.csv"))  # else there is nothing to draw
    lines = [f"drawing {figure.relative_to(cwd)}"] * updates
    for file in sorted(folder.glob("*/evals.csv")):
        path = file.with_name("checkpoint.pt").relative_to(cwd)
        lines += [f"return 3.0 after {steps(file.parent, 'evals')[-1]:,} steps: {path}"]
        if script is not REINFORCE:
            lines += [f"to go on: python {ROOT / script.file} --resume {path}"]
    assert re.sub(r", \d\.\d minutes", "", process.out).splitlines() == lines
    assert figure.exists() == updates
    assert len(lines) >= {"training": 3, "three seeds": 3, "first episode": 1}.get(moment, 0)


@has_groups
@pytest.mark.parametrize("moment", STOPS)
def test_ctrl_c_leaves_no_process_behind(moment, stopped):
    """The system may need a moment to clear away who has ended."""
    for _ in range(200):
        try:
            os.killpg(stopped[moment][1].pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a process has been left behind")


@has_groups
def test_what_ctrl_c_ended_goes_on_as_the_script_says(stopped, call, tmp_path):
    cwd, process = stopped["training"]
    shutil.copytree(cwd / "runs", tmp_path / "runs")
    (arguments,) = re.findall(r"(?m)^to go on: python .*\.py (--resume .*)$", process.out)
    folder = run_folder(tmp_path) / "seed-1"
    before = steps(folder)
    call(PPO, *arguments.split(), "--total-steps", before[-1] + 256)
    assert steps(folder) == [*before, before[-1] + 128, before[-1] + 256]


WRITES = (pd.DataFrame, "to_csv", 6), (torch, "save", 3), (os, "replace", 10)


@pytest.mark.parametrize(("owner", "function", "count"), WRITES)
def test_ctrl_c_while_files_are_written_loses_nothing_that_was_saved(
    owner, function, count, call, tmp_path, monkeypatch
):
    """At the third evaluation, after a file has been opened, and with that emptied."""
    write, calls = getattr(owner, function), itertools.count(1)

    def interrupted(*args, **kwargs):
        if next(calls) == count:
            if owner is not os:
                Path(args[1]).write_text("")
            raise KeyboardInterrupt
        return write(*args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(owner, function, interrupted)
        call(PPO, *PPO.short, "--seed", 3)
    folder = run_folder(tmp_path) / "seed-3"
    assert [row["env_step"] for row in load(folder)["tables"]["metrics"]] == [128]
    call(PPO, "--resume", folder / "checkpoint.pt")
    assert contents(folder) == FILES
    assert steps(folder) == [128, 256, 384, 512]
    assert steps(folder, "evals") == [0, 128, 256, 384, 512]


# --- Resume ---------------------------------------------------------------------------------------


@has_groups
def test_a_run_that_was_killed_goes_on_without_gap_or_repeat(stopped, call, tmp_path):
    cwd, process = stopped["killed"]
    assert process.returncode == -signal.SIGKILL
    folder = shutil.copytree(run_folder(cwd) / "seed-1", tmp_path / "seed-1")
    call(PPO, "--resume", folder / "checkpoint.pt")
    options = "--env-id", PPO.world("ThreeSteps"), *PPO.small, *KILLED.split()
    whole = PPO.train(tmp_path / "whole", *options)
    assert steps(folder) == steps(whole) == [32 * (i + 1) for i in range(60)]
    assert steps(folder, "evals") == steps(whole, "evals")
    assert last_learning_rate(folder) == pytest.approx(last_learning_rate(whole))
    episodes = steps(folder, "episodes")
    assert episodes == sorted(episodes)
    assert len(steps(whole, "episodes")) - 4 <= len(episodes)  # 4 were going on
    assert set(pd.read_csv(folder / "episodes.csv")["length"]) == {3}


@only(A2C, PPO)
def test_a_copied_checkpoint_goes_on_in_its_own_folder_and_touches_nothing_else(
    script, folder, call, tmp_path
):
    """The command line goes before it: twice as long, and the learning rate follows."""
    before = snapshot(folder)
    copy = tmp_path / "copy"
    copy.mkdir()
    foreign = {"notes.csv": b"mine\n1\n", "notes.txt": b"", "summary.json": b"{}", "a/b.csv": b"x"}
    (copy / "a").mkdir()
    for name, content in foreign.items():
        (copy / name).write_bytes(content)
    shutil.copy(folder / "seed-3/checkpoint.pt", copy)
    options = "--total-steps", 1024, "--learning-rate", 0.5
    out, _ = call(script, "--resume", copy / "checkpoint.pt", *options)
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]
    assert contents(copy) == {*FILES, *foreign}
    assert {name: content for name, content in snapshot(copy).items() if name in foreign} == foreign
    assert snapshot(folder) == before
    assert steps(copy) == [128 * (i + 1) for i in range(8)]
    assert steps(copy, "evals") == [0, 128, 256, 384, 512, 768, 1024]
    assert last_learning_rate(copy) == pytest.approx(0.5 / 8)
    for name in TABLES:
        old = table(folder / f"seed-3/{name}.csv")
        pd.testing.assert_frame_equal(table(copy / f"{name}.csv").head(len(old)), old)
    assert "after 1,024 steps" in out
    assert "to go on" not in out


@only(A2C, PPO)
def test_a_finished_run_that_is_resumed_stays_as_it_was(script, folder, call, tmp_path):
    copy = shutil.copytree(folder / "seed-3", tmp_path / "seed-3")
    call(script, "--resume", copy / "checkpoint.pt")
    for name in TABLES:
        assert (copy / f"{name}.csv").read_bytes() == (folder / f"seed-3/{name}.csv").read_bytes()
    both = [load(x) for x in (folder / "seed-3", copy)]
    states = ((x["agent"], x["optimizer"]["state"], x["rng"]) for x in both)
    torch.testing.assert_close(*states, rtol=0, atol=0)


# --- Checkpoints, watching ------------------------------------------------------------------------

ACT = """
import json, sys
from importlib import import_module
import gymnasium as gym, numpy as np, torch
acts = {}
for name, path in zip(sys.argv[2::2], sys.argv[3::2]):
    checkpoint = torch.load(path, weights_only=True)
    script = import_module(name)
    args = script.parse_args(["--watch", path])
    env = gym.make(args.env_id)
    agent = script.Agent(env.observation_space, env.action_space, args)
    agent.load_state_dict(checkpoint["agent"])
    torch.manual_seed(0)
    obs = np.load(sys.argv[1])
    acts[name] = [agent.act(obs, deterministic)[1].tolist() for deterministic in (True, False)]
print(json.dumps(acts))
"""


def test_a_new_process_acts_like_the_one_that_trained(tmp_path, monkeypatch):
    """And importing a script runs nothing: it prints and writes nothing."""
    obs, acts, paths = np.random.default_rng(0).normal(size=(100, 4)), {}, []
    np.save(tmp_path / "obs.npy", obs)
    for script in SCRIPTS.values():
        save = script.module.save

        def save_and_act(*args, script=script, save=save):
            save(*args)
            state = torch.get_rng_state()
            torch.manual_seed(0)
            acts[script.name] = [args[4].act(obs, x)[1].tolist() for x in (True, False)]
            torch.set_rng_state(state)

        monkeypatch.setattr(script.module, "save", save_and_act)
        folder = script.train(tmp_path / script.name)
        paths += [script.name, folder / "checkpoint.pt"]
    (tmp_path / "act.py").write_text(ACT)
    cwd = tmp_path / "empty"
    cwd.mkdir()
    process = run(tmp_path / "act.py", tmp_path / "obs.npy", *paths, cwd=cwd, PYTHONPATH=str(ROOT))
    assert json.loads(process.out) == acts
    assert process.err == ""
    assert not list(cwd.iterdir())
    for name, (deterministic, sampled) in acts.items():
        assert deterministic != sampled
        assert len(set(map(str, sampled))) > (1 if name == A2C.name else 50)  # A2C's are 0 or 1


needs_egl = pytest.mark.skipif(
    sys.platform != "linux" or not ctypes.util.find_library("EGL"), reason="no EGL here")


@pytest.fixture(scope="session")
def watched(runs, tmp_path_factory):
    """A renamed copy of each script watches a copied checkpoint; a display was there once."""
    places = [tmp_path_factory.mktemp("watched") for _ in SCRIPTS]

    def watch(script, cwd):
        mine = shutil.copy(ROOT / script.file, cwd / f"my_{script.file}")
        shutil.copy(run_folder(runs[script.name][0]) / "seed-3/checkpoint.pt", cwd)
        (cwd / "runs").touch()  # no run folder could be made here, and none is needed
        options = "--watch", "checkpoint.pt", "--eval-episodes", 5
        return run(mine, *options, cwd=cwd, DISPLAY=":77")

    return dict(zip(SCRIPTS, zip(places, at_once(watch, SCRIPTS.values(), places))))


@needs_egl
def test_watching_makes_a_gif_and_prints_the_return(script, watched, folder):
    cwd, process = watched[script.name]
    assert re.search(r"(?m)^return [\d.]+ ± [\d.]+ in 5 episodes$", process.out)
    with Image.open(cwd / "checkpoint.gif") as gif:
        assert gif.n_frames > 1
    assert contents(cwd) == {"checkpoint.pt", "checkpoint.gif", "runs", f"my_{script.file}"}
    before = folder / "seed-3/checkpoint.pt"
    assert (cwd / "checkpoint.pt").read_bytes() == before.read_bytes()
    assert "Traceback" not in process.err


# --- Mistakes -------------------------------------------------------------------------------------


@pytest.fixture
def refusal(call):
    """The one line that a wrong call ends with."""

    def refusal(script, *arguments):
        out, err = call(script, *arguments, status=2)
        assert out == ""
        assert err.count("\n") == 1
        assert err.startswith(f"{script.file}: error: ")
        return err

    return refusal


def of(script, path):
    """What an error line calls a checkpoint."""
    return f"--watch{'' if script.name == REINFORCE.name else ' or --resume'}: {path}"


WRONG = [  # for every script, and what its message must contain
    ("--env-id InvertedPendlum-v5", "Did you mean: `InvertedPendulum`"),
    ("--env-id Ant-v99", "v5"),
    ("--env-id no_such_module:Some-v0", "no_such_module"),
    ("--env-id harness:NoSuchWorld-v0", "NoSuchWorld"),
    ("--env-id harness:DictObs-v0", "FlattenObservation"),
    ("--env-id harness:Image-v0", "(8, 8, 3)"),
    ("--env-id FrozenLake-v1", "Discrete(16)"),
    ("--env-id harness:ManyActions-v0", "MultiDiscrete"),
    ("--env-id harness:SquareActions-v0", "(2, 2)"),
    ("--seed", "argument"),
    ("--seed -1", "got -1"),
    ("--seed 1 2 1", "[1, 2, 1]"),
    ("--total-steps 0", "got 0"),
    ("--device tpu", "tpu"),
    ("--out-dir a_file", "a_file"),
    ("--out-dir a_file/below", "a_file"),
    *([("--out-dir /proc/nope", "/proc/nope")] if sys.platform == "linux" else []),
    ("--learning-rate fast", "fast"),
    ("--gamma 1.01", "got 1.01"),
    ("--gamma -0.1", "got -0.1"),
    ("--num-evals 0", "got 0"),
    ("--eval-episodes 0", "got 0"),
    ("--watch no/checkpoint.pt", "No such file"),
    ("--watch .", "directory"),
    ("--watch a_file", "EOFError"),
    ("--watch", "argument"),
]
WRONG_VECTOR = [
    ("--num-envs 0", "got 0"),
    ("--vectorization threads", "threads"),
    ("--rollout-steps 0", "got 0"),
    ("--hidden-size 0", "got 0"),
    ("--gae-lambda 1.01", "got 1.01"),
    ("--gae-lambda -0.1", "got -0.1"),
    ("--entropy-coef -1", "got -1"),
    ("--max-grad-norm -1", "got -1"),
    ("--resume no/checkpoint.pt", "No such file"),
    ("--resume .", "directory"),
]
WRONG_ONLY = {
    REINFORCE: [
        ("--env-id CartPole-v1", "a2c_vector.py: Discrete"),
        ("--batch-episodes 0", "got 0"),
        ("--baseline median", "median"),
    ],
    A2C: [
        *WRONG_VECTOR,
        ("--env-id InvertedPendulum-v5", "ppo_continuous.py: bounded Box"),
        ("--env-id harness:Unbounded-v0", "reinforce_mujoco.py: Box"),
        ("--env-id CartPole-v1 --randomize", "--randomize takes LunarLander"),
        ("--reward-scale -1", "got -1"),
        ("--critic-learning-rate -1", "got -1"),
    ],
    PPO: [
        *WRONG_VECTOR,
        ("--env-id CartPole-v1", "a2c_vector.py: Discrete"),
        ("--env-id harness:Unbounded-v0", "reinforce_mujoco.py: unbounded"),
        ("--epochs 0", "got 0"),
        ("--minibatch-size 0", "got 0"),
        ("--clip-eps -0.1", "got -0.1"),
        ("--max-kl -0.1", "got -0.1"),
        ("--log-std 2.1", "got 2.1"),
        ("--log-std -10.1", "got -10.1"),
        ("--std-learning-rate -1", "got -1"),
    ],
}


@pytest.mark.parametrize(
    ("name", "arguments", "mentions"),
    [(script.name, *row) for script, rows in WRONG_ONLY.items() for row in WRONG + rows],
)
def test_a_wrong_argument_is_named_in_one_line(name, arguments, mentions, refusal, tmp_path):
    (tmp_path / "a_file").touch()
    flag, *values = arguments.split()
    path = values and flag in ("--watch", "--resume")
    error = refusal(SCRIPTS[name], *arguments.split())
    assert f"error: argument {of(SCRIPTS[name], values[0]) if path else flag}: " in error
    assert mentions in error
    assert [path.name for path in tmp_path.iterdir()] == ["a_file"]


def test_no_number_may_be_nan_infinite_or_something_else(script, refusal):
    defaults = {**vars(script.module.parse_args([])), "seed": 1}
    for name, default in defaults.items():
        if type(default) in (int, float):
            flag = "--" + name.replace("_", "-")
            for value in "nan", "inf", "-11", "1e13", "1,5", "", *["1.5"][type(default) is float :]:
                assert f"argument {flag}: " in refusal(script, f"{flag}={value}")


def test_whole_numbers_may_be_written_with_an_exponent(script):
    args = script.module.parse_args(["--total-steps", "1e6", "--seed", "1e3", "0"])
    assert repr((args.total_steps, args.seed)) == "(1000000, [1000, 0])"


def test_flags_that_a_script_does_not_have_are_named(script, refusal):
    assert "--no-such-flag" in refusal(script, "--no-such-flag")
    if script is REINFORCE:
        assert "--resume" in refusal(script, "--resume", "checkpoint.pt")


@only(A2C, PPO)
def test_only_one_seed_can_be_resumed(script, folder, refusal):
    options = "--resume", folder / "seed-3/checkpoint.pt", "--seed", 3, 4
    assert "argument --seed: " in refusal(script, *options)


def flags_for_checkpoints(script):
    return ["--watch"] if script is REINFORCE else ["--watch", "--resume"]


def test_an_empty_path_is_no_checkpoint(script, refusal):
    """As from a shell's variable that is not set: no run must start."""
    for flag in flags_for_checkpoints(script):
        refusal(script, flag, "", "--total-steps", 1)


def test_a_damaged_or_foreign_checkpoint_is_refused(script, runs, refusal, tmp_path):
    paths = {name: run_folder(cwd) / "seed-3/checkpoint.pt" for name, (cwd, _) in runs.items()}
    checkpoint = tmp_path / "checkpoint.pt"
    whole = paths.pop(script.name).read_bytes()
    foreign = [path.read_bytes() for path in paths.values()]
    for flag in flags_for_checkpoints(script):
        for content in whole[: len(whole) // 2], b"", pickle.dumps([1, 2], 2), *foreign:
            checkpoint.write_bytes(content)
            assert f"argument {of(script, checkpoint)}: " in refusal(script, flag, checkpoint)
            assert checkpoint.read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_a_checkpoint_does_not_fit_another_environment(script, folder, refusal):
    other = "Acrobot-v1" if script is A2C else "Hopper-v5"
    checkpoint = folder / "seed-3/checkpoint.pt"
    for flag in flags_for_checkpoints(script):
        error = refusal(script, flag, checkpoint, "--env-id", other)
        assert f"argument {of(script, checkpoint)}: " in error
        assert "size mismatch" in error


class Malicious:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_checkpoint_cannot_run_code(script, folder, refusal, tmp_path):
    checkpoint, victim = tmp_path / "checkpoint.pt", tmp_path / "victim"
    content = load(folder / "seed-3")
    content["tables"] = Malicious(victim)
    for save in torch.save, lambda x, path: path.write_bytes(pickle.dumps(x, 2)):
        save(content, checkpoint)
        for flag in flags_for_checkpoints(script):
            assert f"argument {of(script, checkpoint)}: " in refusal(script, flag, checkpoint)
        assert not victim.exists()
    pickle.loads(checkpoint.read_bytes())
    assert victim.exists()  # it would have


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "ascii"])
def test_help_shows_every_flag_whatever_can_be_printed(script, encoding, call, monkeypatch):
    printed = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(printed, encoding))
    call(script, "--help")
    sys.stdout.flush()
    text = printed.getvalue().decode(encoding)
    groups = re.findall(r"(?m)^(\w+):$", text)
    assert groups[-4:] == ["run", "environment", "algorithm", "evaluation"]
    for name in vars(script.module.parse_args([])):
        assert f"--{name.replace('_', '-')} " in text
    assert ("γ" in text) == (encoding == "utf-8")


# --- Environments that fail -----------------------------------------------------------------------

BUG = """
import gymnasium as gym
from harness import World

class Buggy(World):
    def reward(self, action):
        return 1 / (self.total < 40 or self.np_random_seed != SEED)

gym.register("Buggy-v0", Buggy)
"""
BUGGY_LINE = 1 + BUG[: BUG.index("1 /")].count("\n")


def write_bug(path):
    """An environment that fails where the first one of seed 2 comes to its step 40."""
    path.write_text(BUG.replace("SEED", str(ppo.make_seeds(2, stream=2, count=1)[0])))


def test_a_bug_in_the_user_s_environment_is_shown_with_file_and_line(call, figures, tmp_path):
    """The environment is in the current folder."""
    write_bug(tmp_path / "here.py")
    options = "--total-steps", 512, "--num-evals", 4, "--seed", 2
    with pytest.raises(ZeroDivisionError) as error:
        call(PPO, "--env-id", "here:Buggy-v0", *PPO.small, *options)
    frame = traceback.extract_tb(error.tb)[-1]
    assert (frame.filename, frame.lineno) == (str(tmp_path / "here.py"), BUGGY_LINE)
    assert len(figures) == 1


def test_a_seed_that_fails_is_shown_after_the_others_are_done(tmp_path):
    """The environment is beside the script, which is a copy."""
    scripts, cwd = tmp_path / "scripts", tmp_path / "cwd"
    scripts.mkdir()
    cwd.mkdir()
    write_bug(scripts / "beside.py")
    mine = shutil.copy(ROOT / REINFORCE.file, scripts / "my_script.py")
    options = *REINFORCE.small, "--total-steps", 512, "--num-evals", 4, "--seed", 2, 1
    process = run(mine, "--env-id", "beside:Buggy-v0", *options, cwd=cwd, status=1)
    assert f'beside.py", line {BUGGY_LINE}, in reward' in process.err
    assert process.err.rstrip().endswith("ZeroDivisionError: division by zero")
    assert re.search("__my_script__", run_folder(cwd).name)
    assert steps(run_folder(cwd) / "seed-1")[-1] >= 512
    assert steps(run_folder(cwd) / "seed-2", "evals") == [0]
    first, second = re.findall("(?m)^return 3.0 after ([0-9]+) steps.*seed-.*$", process.out)
    assert int(first) >= 512
    assert int(second) == 0


@pytest.mark.filterwarnings("ignore:.*The reward is a NaN value")
@pytest.mark.parametrize("world", ["TurnsNaN", "TurnsInfinite", "TurnsBlind", "AlwaysNaN"])
def test_nan_and_infinity_are_named_in_one_line(script, world, call):
    options = "--env-id", script.world(world), *script.small, "--total-steps", 512, "--num-evals", 1
    out, err = call(script, *options, status=1)
    step = 1 if world == "AlwaysNaN" else 40
    message = f"error: environment 0 returned NaN or infinity at its step {step}\n"
    assert re.search(rf"(\A|[\r\n]){message}\Z", err)  # on a line of its own, not behind the bar
    assert "Traceback" not in err
    assert not re.search(r"(?i)\bnan\b", out + err.replace(message, ""))


def test_nan_and_infinity_are_noticed_wherever_they_are(script):
    fine = np.zeros((3, 2))
    script.module.check_finite(4, 7, fine, np.zeros(3))
    for wrong in np.nan, np.inf, -np.inf:
        for row in range(3):
            spoilt = fine.copy()
            spoilt[row, 1] = wrong
            for arrays in (spoilt, fine), (fine[:, 0], spoilt), (spoilt[:, 1], fine):
                with pytest.raises(SystemExit, match=f"environment {4 + row} .* step 7"):
                    script.module.check_finite(4, 7, *arrays)


@pytest.mark.filterwarnings("ignore:.*The reward is a NaN value")
def test_an_evaluation_names_the_environment_that_returned_nan(script):
    module = script.module
    worlds = "ThreeSteps", "ThreeSteps", "AlwaysNaN", "ThreeSteps"
    envs = [module.record_episodes(gym.make(script.world(world))) for world in worlds]
    args = module.parse_args(["--env-id", script.env_id])
    agent = module.Agent(envs[0].observation_space, envs[0].action_space, args)
    with pytest.raises(SystemExit, match="environment 2 returned NaN or infinity at its step 1"):
        module.evaluate(agent, envs, seed=1)


# --- Figure ---------------------------------------------------------------------------------------


@pytest.fixture
def draw(figures):
    """Draws a figure without a warning; gives its panels by their titles."""

    def draw(script, folder, env_id="harness:ThreeSteps-v0"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for category in DeprecationWarning, PendingDeprecationWarning, FutureWarning:
                warnings.simplefilter("ignore", category)
            script.module.plot(folder, env_id)
        figure = figures.pop()
        return {panel.get_title(): panel for panel in figure.axes}

    return draw


def curves(panel):
    """The lines that show something; seaborn adds empty ones for the legend."""
    lines = [line.get_xydata() for line in panel.lines]
    return [xy[~np.isnan(xy).any(1)].T for xy in lines if not np.isnan(xy).all()]


def write_tables(folder, at, values):
    """Tables with rows at the steps `at`, and the same `values` in each column."""
    folder.mkdir()
    columns = {"evals": ["seconds", "return_mean", "return_std", "length_mean", "episodes"],
               "episodes": ["return", "length"], "metrics": ["some_loss", "speed"]}
    for name, column in columns.items():
        rows = pd.DataFrame({"env_step": at, **dict.fromkeys(column, values)})
        rows.to_csv(folder / f"{name}.csv", index=False)


def test_the_figure_has_a_panel_for_each_quantity(script, alone, draw):
    panels = draw(script, alone.parent, script.env_id)
    metrics = pd.read_csv(alone / "metrics.csv").drop(columns="env_step")
    assert list(panels) == ["return", "length", *(x.replace("_", " ") for x in metrics)]
    figure = panels["return"].figure
    assert figure.get_suptitle().startswith(f"{script.env_id}, seeds: 1 ")
    assert {panel.get_xlabel() for panel in panels.values()} <= {"environment steps", ""}
    evals, episodes = (pd.read_csv(alone / f"{x}.csv") for x in ("evals", "episodes"))
    colours = dict(zip((x.get_text() for x in figure.legends[0].get_texts()),
                       (x.get_color() for x in figure.legends[0].get_lines())))
    assert set(colours) == {"sampled: training", "deterministic: evaluation"}
    for name in "return", "length":
        lines = {line.get_color(): line for line in panels[name].lines if len(line.get_xdata())}
        evaluation, training = (lines[colours[x]].get_xydata() for x in sorted(colours))
        last = evals[["env_step", f"{name}_mean"]].iloc[-1]
        np.testing.assert_allclose(evaluation[~np.isnan(evaluation[:, 1])][-1], last)
        shown = training[:, 1][~np.isnan(training[:, 1])]
        assert episodes[name].min() <= shown.min() <= shown.max() <= episodes[name].max()
    for name, last in metrics.iloc[-1].items():
        (curve,) = curves(panels[name.replace("_", " ")])
        np.testing.assert_allclose(curve[1][-1], last)


def test_a_curve_is_the_mean_over_seeds_interpolated_where_one_has_no_row(draw, tmp_path):
    """The band is from lowest to highest. A seed that ended earlier keeps its last value."""
    seeds = [([0, 100, 700], [0, 5, 8]), ([0, 300, 1000], [6, 3, 0]), ([0, 550, 1000], [1, 1, 9])]
    for i, (at, values) in enumerate(seeds):
        write_tables(tmp_path / f"seed-{i}", at, values)
    panels = draw(PPO, tmp_path)
    assert list(panels) == ["return", "length", "some loss", "speed"]
    assert "seeds: 3 " in panels["return"].figure.get_suptitle()
    x = [0, 100, 300, 550, 700, 1000]
    each = [np.interp(x, *seed) for seed in seeds]
    for name, panel in panels.items():
        assert len(curves(panel)) == (2 if name in ("return", "length") else 1)
        for curve in curves(panel):
            np.testing.assert_allclose(curve, [x, np.mean(each, axis=0)])
        for band in panel.collections:
            edges = pd.DataFrame(band.get_paths()[0].vertices.round(6)).groupby(0)[1]
            np.testing.assert_allclose(edges.min(), np.min(each, axis=0), atol=1e-5)
            np.testing.assert_allclose(edges.max(), np.max(each, axis=0), atol=1e-5)


@pytest.mark.parametrize("length", [1000, 1004])
def test_a_curve_is_of_means_over_hundredths_of_the_run_the_last_one_whole(length, draw, tmp_path):
    at = np.arange(1, length + 1)
    write_tables(tmp_path / "seed-1", at, at)
    hundredth = -(-100 * at // length)
    means = pd.Series(at).groupby(hundredth).mean()
    for panel in draw(PPO, tmp_path).values():
        for curve in curves(panel):
            np.testing.assert_allclose(curve, [means.index * length / 100, means])


def test_one_update_in_which_no_episode_ended_is_drawn(draw, tmp_path):
    options = "--env-id", PPO.world("Forever"), "--rollout-steps", 2, "--total-steps", 8
    folder = PPO.train(tmp_path / "run", *options)
    assert contents(folder) == FILES - {"episodes.csv"}
    assert len(steps(folder)) == 1
    assert all(len(curves(panel)) == 1 for panel in draw(PPO, folder.parent).values())


# --- Learning -------------------------------------------------------------------------------------


def test_it_finds_the_best_action_in_an_asymmetric_box(tmp_path):
    options = "--env-id harness:Target-v0 --total-steps 8192 --num-envs 8"
    options += " --rollout-steps 64 --minibatch-size 64 --learning-rate 3e-3 --log-std -1.5"
    args = ppo.parse_args([*options.split(), "--num-evals", "1"])
    ppo.run(args, 1, tmp_path)
    assert pd.read_csv(tmp_path / "evals.csv")["return_mean"].iloc[-1] > -0.03
    env = gym.make(args.env_id)
    agent = ppo.Agent(env.observation_space, env.action_space, args)
    agent.load_state_dict(load(tmp_path)["agent"])
    _, actions = agent.act(np.float32([[0, 0], [0.5, 0]]), deterministic=True)
    assert np.abs(actions - TARGET).max() < 0.2


def test_it_learns_to_balance_a_pole(tmp_path):
    options = "--env-id InvertedPendulum-v5 --total-steps 24576 --num-envs 8 --rollout-steps 128"
    options += " --minibatch-size 128 --num-evals 1"
    ppo.run(ppo.parse_args(options.split()), 1, tmp_path)
    assert pd.read_csv(tmp_path / "evals.csv")["return_mean"].iloc[-1] > 300
    episodes = pd.read_csv(tmp_path / "episodes.csv")["return"]
    assert episodes[-20:].mean() > 5 * episodes[:20].mean()


# --- Repository -----------------------------------------------------------------------------------


def test_requirements_txt_is_what_the_scripts_ask_for_and_pytest():
    listed = (ROOT / "requirements.txt").read_text().splitlines()
    listed = {line for line in listed if line and not line.startswith("#")}
    asked = set()
    for script in SCRIPTS.values():
        text = (ROOT / script.file).read_text()
        block = re.match(r"(?s)# /// script\n(.*?)\n# ///\n", text).group(1)
        assert '# requires-python = ">=3.10,<3.14"\n' in block
        packages = re.findall(r'(?m)^#     "(.*)",$', block)
        assert any(package.startswith("pillow") for package in packages)
        extra = "box2d" if script is A2C else "mujoco"
        (gymnasium,) = (package for package in packages if package.startswith("gymnasium"))
        assert gymnasium.startswith(f"gymnasium[{extra}]")
        assert any(x.startswith("mujoco") for x in packages) == (script is not A2C)
        asked |= {x.replace(f"[{extra}]", "[mujoco,box2d]") for x in packages}
    (pytest_line,) = listed - asked
    assert pytest_line.startswith("pytest>=")
    assert asked < listed


# Where the scripts differ on purpose: this is the algorithm, or its options. Where one script is
# named, the other two are alike.
DIFFERENT = {
    "Agent": None, "check": None, "optimise": None, "parse_args": None, "train": None,
    "main": REINFORCE, "rollout": REINFORCE, "run": REINFORCE, "policy_loss": PPO,
}


def test_functions_of_the_same_name_have_the_same_source():
    sources = {}
    for script in SCRIPTS.values():
        text = (ROOT / script.file).read_text()
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                source = ast.get_source_segment(text, node)
                sources.setdefault(node.name, {})[script.name] = source
    assert {"evaluate", "run", "save", "plot", "make_folder", "train_seeds"} <= set(sources)
    for name, versions in sources.items():
        odd = DIFFERENT.get(name)
        expected = 1 if name not in DIFFERENT else len(versions) if odd is None else 2
        assert len(set(versions.values())) == expected, name
        if odd:
            others = [source for x, source in versions.items() if x != odd.name]
            assert versions[odd.name] not in others, name


def test_only_warnings_about_our_own_code_are_errors():
    """A deprecation in a package of next year must turn no test red."""
    for module in *SCRIPTS, "harness", "test_ppo":
        with pytest.raises(UserWarning):
            warnings.warn_explicit("x", UserWarning, "x.py", 1, module=module)
    with warnings.catch_warnings(record=True) as caught:
        for category in UserWarning, FutureWarning, DeprecationWarning:
            warnings.warn_explicit("x", category, "x.py", 1, module="pandas.core.frame")
    assert len(caught) == 3
