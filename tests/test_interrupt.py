"""Ctrl-C and kill -9: a run ends at once, keeps what was saved, and leaves no process behind."""

import os
import re
import signal
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from harness import World, register, run_folder, start

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no process groups")


class Stuck(World):
    """An episode that starts without a seed, so not the first one, never ends; it leaves a file."""

    def reset(self, *, seed=None, options=None):
        self.stuck = seed is None
        return super().reset(seed=seed)

    def step(self, action):
        obs, reward, terminated, truncated, info = super().step(action)
        if self.stuck:
            Path("stuck").touch()
            time.sleep(0.01)
        return obs, reward, terminated and not self.stuck, truncated, info


register("Stuck", Stuck)
LONG = "--total-steps 1e7 --num-evals 2000 --eval-episodes 2"
SMALL = "--num-envs 4 --rollout-steps 32"
PPO, A2C, REINFORCE = "ppo_continuous.py", "a2c_vector.py", "reinforce_mujoco.py"
CASES = {  # script, options, and the files that show how far it has come
    "training": (PPO, f"--env-id harness:ThreeSteps-v0 {SMALL} --seed 1", "seed-*.csv", 1),
    "several seeds": (
        PPO, f"--env-id harness:ThreeSteps-v0 {SMALL} --seed 1 2 3", "seed-*.csv", 3),
    "seeds start": (
        A2C, f"--env-id harness:DiscreteThreeSteps-v0 {SMALL} --seed 1 2", "*__*", 1),
    "processes": (A2C, f"--env-id harness:DiscreteThreeSteps-v0 {SMALL} --vectorization async",
                  "seed-*.csv", 1),
    "an endless step": (REINFORCE, "--env-id test_interrupt:Stuck-v0", "stuck", 1),
}


def stop(case, cwd, send):
    """Start a run in `cwd`, stop it once it has left its files; returns the finished process."""
    script, options, file, count = CASES[case]
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored after a shell's `&`
    process = start(script, *options.split(), *LONG.split(), cwd=cwd, own_group=True)
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
    assert process.returncode in (130, -signal.SIGINT), process.err  # so that a shell's loop ends
    assert "leaked" not in process.err
    folder = run_folder(tmp_path)
    saved = {file.stem: pd.read_csv(file)["env_step"].iloc[-1] for file in folder.glob("*.csv")}
    assert len(saved) >= {"several seeds": 3, "seeds start": 0, "an endless step": 0}.get(case, 1)
    assert (folder / "learning_curve.png").exists() == bool(process.out) == bool(saved)
    for seed, env_step in saved.items():
        assert re.search(rf"^{seed} +{env_step} ", process.out, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["several seeds", "processes"])
def test_an_interrupt_of_the_main_process_alone_ends_the_others(case, tmp_path):
    """As the stop button of an editor sends it."""
    process = stop(case, tmp_path, lambda pid: os.kill(pid, signal.SIGINT))
    check_nothing_is_left(process.pid)
    assert (run_folder(tmp_path) / "learning_curve.png").exists()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="PyTorch sees to it on Linux")
def test_killing_the_main_process_ends_the_others(tmp_path):
    process = stop("several seeds", tmp_path, lambda pid: os.kill(pid, signal.SIGKILL))
    check_nothing_is_left(process.pid)
