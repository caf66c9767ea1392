"""experiments/together.py: PPO that plays in several processes, started by torchrun."""

import re
import shutil

import harness
import pytest
import torch
from harness import read_log, run, spy_rollouts, train

import ppo_continuous as ppo

# Runs together.py; writes down what this process plays with, what it plays, and what all play.
PROBE = """
import runpy, torch
from torch import distributed
import ppo_continuous as ppo
seen, rollout, scale_rewards = [], ppo.rollout, ppo.scale_rewards

def play(envs, agent, *rest):
    weights = {name: x.clone() for name, x in agent.state_dict().items()}
    result = rollout(envs, agent, *rest)
    seen.append({"weights": weights, "batch": result[0]._asdict()})
    return result

def scale(rewards, *rest):
    seen[-1]["rewards"] = rewards.clone()
    rank = distributed.get_rank()
    if len(seen) <= 3:
        torch.save(seen, f"seen-{rank}.pt")
    return scale_rewards(rewards, *rest)

ppo.rollout, ppo.scale_rewards = play, scale
runpy.run_path("experiments/together.py", run_name="__main__")
"""
SMALL = ["--env-id", "harness:Target-v0", "--num-envs", "2", "--rollout-steps", "16",
         "--minibatch-size", "16", "--epochs", "2", "--eval-episodes", "2", "--num-evals", "2"]
TORCHRUN = "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"


@pytest.fixture(scope="module")
def together(tmp_path_factory):
    """A run of three updates in two processes, and what both of them saw."""
    cwd = tmp_path_factory.mktemp("together")
    (cwd / "experiments").mkdir()
    for file in "ppo_continuous.py", "experiments/together.py":
        shutil.copy(harness.ROOT / file, cwd / file)
    (cwd / "probe.py").write_text(PROBE)
    process = run(cwd / "probe.py", *SMALL, "--total-steps", 192, cwd=cwd, python=TORCHRUN)
    assert not re.search(r"(ppo_continuous|together)\.py:\d+: \w*Warning", process.err)
    seen = [torch.load(cwd / f"seen-{rank}.pt", weights_only=True) for rank in (0, 1)]
    return cwd, process.out, *seen


def test_processes_share_weights_and_transitions_but_neither_noise_nor_episodes(together):
    *_, first, second = together
    for mine, theirs in zip(first, second, strict=True):
        torch.testing.assert_close(mine["weights"], theirs["weights"], rtol=0, atol=0)
        for name in ("obs", "actions"):
            both = torch.cat([mine["batch"][name], theirs["batch"][name]], 1).flatten(0, 1)
            assert len(both.unique(dim=0)) == len(both)
        rewards = torch.cat([mine["batch"]["rewards"], theirs["batch"]["rewards"]], 1)
        assert torch.equal(mine["rewards"], rewards)
        assert torch.equal(theirs["rewards"], rewards)


def test_the_first_update_is_that_of_one_process_with_all_environments(together, monkeypatch):
    *_, first, second = together
    shares = iter(second)

    def with_the_others(batch):
        other = next(shares)["batch"]
        return batch._make(torch.cat([x, other[name]], 1) for name, x in batch._asdict().items())

    rollouts = spy_rollouts(monkeypatch, ppo, with_the_others)
    train(monkeypatch, ppo, *SMALL, "--total-steps", 192)
    for name, x in rollouts[1][0].state_dict().items():
        if name != "sigma":  # annealed by the time
            assert torch.equal(x, first[1]["weights"][name]), name


def test_steps_are_those_of_all_processes_and_one_folder_holds_the_run(together):
    cwd, out, *_ = together
    (folder,) = cwd.glob("runs/*")
    assert out.count("seed-1") == 1
    assert {x.name for x in folder.iterdir()} == {"seed-1.csv", "seed-1.pt", "learning_curve.png"}
    log = read_log(folder / "seed-1.csv")
    assert log["env_step"].tolist() == [64, 128, 192]
    assert log["eval_return"].notna().iloc[[0, -1]].all()


def test_it_needs_no_path_and_takes_one_seed(tmp_path):
    """Both processes would train the same two agents: a line, and nothing starts."""
    process = run("experiments/together.py", "--seed", 1, 2, cwd=tmp_path, python=TORCHRUN)
    assert process.out.count("\n") == 1
    assert process.out.startswith("--seed: only one")
    assert not list(tmp_path.iterdir())
