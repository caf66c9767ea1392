"""experiments/together.py: PPO whose environments run in several processes, started by torchrun."""

import pandas as pd
import pytest
from conftest import SCRIPTS
from harness import read_log, run

TORCHRUN = "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"


@pytest.mark.slow
def test_two_processes_train_one_agent(tmp_path):
    """Steps, episodes and files are those of one process; only the noise is another."""
    script = SCRIPTS["ppo_continuous"]
    options = f"--env-id harness:Forever-v0 --seed 1 {script.small}".split()
    run("experiments/together.py", *options, cwd=tmp_path, python=TORCHRUN)
    (folder,) = (tmp_path / "runs").iterdir()
    assert {path.name for path in folder.iterdir()} == {"seed-1.csv", "seed-1.pt",
                                                        "learning_curve.png"}
    log = read_log(folder / "seed-1")
    alone = read_log(script.train(tmp_path, "--env-id", "harness:Forever-v0", seed=1))
    same = ["env_step", "return", "eval_return"]
    pd.testing.assert_frame_equal(log[same], alone[same])
    assert not log["value_loss"].equals(alone["value_loss"])
