"""Ctrl-C: a run ends at once, keeps what was saved, draws it, and leaves no process behind."""

import os
import signal
import sys
import time

import pytest
from harness import start

LONG = "--total-steps 1e6 --num-evals 2000 --eval-episodes 2 --num-envs 4 --rollout-steps 32"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
@pytest.mark.parametrize(("send", "command", "count"), [
    (os.killpg, f"a2c_vector.py --env-id harness:DiscreteBothEnds-v0 {LONG} "
                "--vectorization async", 1),
    (os.kill, f"ppo_continuous.py --env-id harness:BothEnds-v0 {LONG} --seed 1 2", 2)])
def test_ctrl_c_ends_a_run_at_once_and_in_order(send, command, count, tmp_path):
    """A terminal sends it to all processes, an editor's stop button to the main one."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored after a shell's `&`
    process = start(*command.split(), cwd=tmp_path)
    signal.signal(signal.SIGINT, usual)
    while len(list(tmp_path.rglob("seed-*.pt"))) < count:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.02)
    send(process.pid, signal.SIGINT)
    out, _ = process.communicate(timeout=30)
    assert process.returncode != 0
    assert list(tmp_path.rglob("learning_curve.png"))
    assert out.count("seed-") >= count
    for _ in range(100):  # the system may need a moment to clear away what has ended
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a process has been left behind")
