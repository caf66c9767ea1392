"""Ctrl-C and kill -9: a run ends at once, keeps what was saved, and leaves no process behind."""

import os
import re
import signal
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from harness import run_folder, start

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
LONG = "--total-steps 1e7 --num-evals 2000 --eval-episodes 2"
SMALL = f"{LONG} --num-envs 4 --rollout-steps 32"
PPO = f"ppo_continuous.py --env-id harness:BothEnds-v0 {SMALL}"
A2C = f"a2c_vector.py --env-id harness:DiscreteBothEnds-v0 {SMALL}"
CASES = {  # script and options, and the files that show how far it has come
    "training": (f"reinforce_mujoco.py --env-id harness:ThreeSteps-v0 {LONG}", "seed-*.csv", 1),
    "several seeds": (f"{PPO} --seed 1 2 3", "seed-*.csv", 3),
    "seeds start": (f"{A2C} --seed 1 2", "*__*", 1),
    "processes": (f"{A2C} --vectorization async", "seed-*.csv", 1),
}


def stop(case, cwd, send):
    """Start a run in `cwd`, stop it once it has left its files; returns the finished process."""
    command, file, count = CASES[case]
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored after a shell's `&`
    process = start(*command.split(), cwd=cwd, own_group=True)
    signal.signal(signal.SIGINT, usual)
    deadline = time.monotonic() + 100
    while len(list(cwd.rglob(file))) < count:
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.5)
    send(process.pid)
    process.out, process.err = process.communicate(timeout=60)
    return process


def check_nothing_is_left(group):
    """The system may need a moment to clear away what has ended."""
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a process has been left behind")


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_ctrl_c_ends_a_run_at_once_and_in_order(case, tmp_path):
    """A terminal sends it to the whole group."""
    process = stop(case, tmp_path, lambda group: os.killpg(group, signal.SIGINT))
    check_nothing_is_left(process.pid)
    assert process.returncode == 1
    assert "leaked" not in process.err
    if case in ("training", "several seeds"):  # else it may be Gymnasium's, or from an import
        assert "Traceback" not in process.err
    assert process.err.splitlines()[-1] == "interrupted"
    folder = next(Path(tmp_path, "runs").iterdir(), tmp_path)  # none, if nothing was saved
    saved = {file.stem: pd.read_csv(file)["env_step"].iloc[-1] for file in folder.glob("*.csv")}
    assert (folder == tmp_path) == (not saved)
    assert len(saved) >= {"several seeds": 3, "seeds start": 0}.get(case, 1)
    assert (folder / "learning_curve.png").exists() == bool(saved)
    for seed, env_step in saved.items():
        assert re.search(rf"^{seed} +{env_step} ", process.out, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize(("case", "name"), [
    ("several seeds", "SIGINT"), ("processes", "SIGINT"), ("several seeds", "SIGKILL")])
def test_a_signal_to_the_main_process_alone_ends_the_others(case, name, tmp_path):
    """The stop button of an editor sends SIGINT."""
    if name == "SIGKILL" and sys.platform != "linux":
        pytest.skip("PyTorch sees to it on Linux")
    process = stop(case, tmp_path, lambda pid: os.kill(pid, getattr(signal, name)))
    check_nothing_is_left(process.pid)
    assert (run_folder(tmp_path) / "learning_curve.png").exists() == (name == "SIGINT")
