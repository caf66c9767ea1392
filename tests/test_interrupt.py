"""Ctrl-C and kill -9: a run ends at once, keeps what was saved, and leaves no process behind."""

import os
import re
import signal
import sys
import time

import pandas as pd
import pytest
from harness import start

pytestmark = [pytest.mark.slow,
              pytest.mark.skipif(sys.platform == "win32", reason="no process groups")]
LONG = "--total-steps 1e7 --num-evals 2000 --eval-episodes 2"
SMALL = f"{LONG} --num-envs 4 --rollout-steps 32"
A2C = f"a2c_vector.py --env-id harness:DiscreteBothEnds-v0 {SMALL}"
CASES = {  # script and options, and the files that show how far it has come
    "training": (f"reinforce_mujoco.py --env-id harness:ThreeSteps-v0 {LONG}", "seed-*.csv", 1),
    "seeds": (f"ppo_continuous.py --env-id harness:BothEnds-v0 {SMALL} --seed 1 2",
              "seed-*.csv", 2),
    "seeds start": (f"{A2C} --seed 1 2", "*__*", 1),
    "processes": (f"{A2C} --vectorization async", "seed-*.csv", 1),
}


def stop(case, cwd, send, sent):
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
    send(process.pid, sent)
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


TO_ALL = [(case, os.killpg, signal.SIGINT) for case in CASES]
TO_MAIN = [("seeds", os.kill, signal.SIGINT), ("processes", os.kill, signal.SIGINT),
           ("seeds", os.kill, signal.SIGKILL)]


@pytest.mark.parametrize(("case", "send", "sent"), TO_ALL + TO_MAIN)
def test_a_signal_ends_a_run_at_once_and_in_order(case, send, sent, tmp_path):
    """A terminal's Ctrl-C goes to all processes, an editor's stop button to the main one."""
    if sent == signal.SIGKILL and sys.platform != "linux":
        pytest.skip("PyTorch sees to it on Linux")
    process = stop(case, tmp_path, send, sent)
    check_nothing_is_left(process.pid)
    assert process.returncode != 0
    saved, drawn = (list(tmp_path.rglob(name)) for name in ("seed-*.csv", "learning_curve.png"))
    assert len(saved) >= CASES[case][2] or case == "seeds start"
    if sent == signal.SIGINT:
        assert "interrupted" in process.out + process.err or case == "processes"  # or EOFError
        assert "leaked" not in process.err
        assert len(drawn) == len(list(tmp_path.glob("runs/*"))) == bool(saved)
        for path in saved:
            env_step = pd.read_csv(path)["env_step"].iloc[-1]
            assert re.search(rf"^{path.stem} +{env_step} ", process.out, re.MULTILINE)
    if send == os.killpg and case in ("training", "seeds"):
        assert "Traceback" not in process.err  # else it may be Gymnasium's, or from an import
