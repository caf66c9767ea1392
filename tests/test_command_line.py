"""Wrong calls end in one line that names the option, with status 2, and write nothing."""

import pickle
import re
import shutil
import sys

import pytest
from conftest import only
from gymnasium.spaces import Box, Dict, MultiDiscrete
from harness import register, run_folder

for name, spaces in {
    "DictObs": {"observations": Dict(position=Box(-1, 1, (2,)))},
    "Image": {"observations": Box(0, 255, (8, 8, 3))},
    "ManyActions": {"actions": MultiDiscrete([2, 3])},
    "SquareActions": {"actions": Box(-1, 1, (2, 2))},
    "WholeActions": {"actions": Box(0, 5, (1,), int)},
    "Unbounded": {"actions": Box(-float("inf"), float("inf"), (2,))},
}.items():
    register(name, **spaces)


@pytest.fixture
def refusal(monkeypatch, tmp_path, capsys):
    """What a wrong call says, in this process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])

    def refusal(script, *arguments):
        before = set(tmp_path.rglob("*"))
        monkeypatch.setattr(sys, "argv", [script.file, *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            script.module.main()
        out, err = capsys.readouterr()
        assert end.value.code == 2
        assert out == ""
        assert err.count("\n") == 1
        assert err.startswith(f"{script.file}: error: ")
        assert set(tmp_path.rglob("*")) == before
        return err

    return refusal


ENVIRONMENTS = {  # and what the message must contain
    "InvertedPendlum-v5": "Did you mean: `InvertedPendulum`",
    "Ant-v99": "v5",
    "no_such_module:Some-v0": "no_such_module",
    "harness:NoSuchWorld-v0": "NoSuchWorld",
    "one:two:three": "too many values",
    "DictObs-v0": "flat Box observations",
    "Image-v0": "flat Box observations",
    "FrozenLake-v1": "flat Box observations",
    "ManyActions-v0": "actions",
    "SquareActions-v0": "actions",
    "WholeActions-v0": "actions",
}
ONLY = {
    "reinforce_mujoco": ["CartPole-v1"],
    "a2c_vector": ["InvertedPendulum-v5", "Unbounded-v0", "DiscreteImage-v0"],
    "ppo_continuous": ["CartPole-v1", "Unbounded-v0"],
}


def test_an_environment_that_does_not_fit_is_named(script, refusal):
    for env_id, words in {**ENVIRONMENTS, **dict.fromkeys(ONLY[script.name], "actions")}.items():
        error = refusal(script, "--env-id", env_id)
        assert "argument --env-id: " in error
        assert words in error


def test_numbers_out_of_range_and_no_numbers_are_named(script, refusal):
    """In every option that takes one; 1e6 is a whole number."""
    for name, default in vars(script.module.parse_args([])).items():
        default = default[0] if name == "seed" else default
        if type(default) in (int, float):
            flag = "--" + name.replace("_", "-")
            values = ["nan", "inf", "-11", "1e13", "1,5", ""]
            if type(default) is int:
                values += ["1.5"] if name == "seed" else ["1.5", "0"]
            for value in values:
                assert f"argument {flag}: " in refusal(script, f"{flag}={value}")
    assert "got" not in refusal(script, "--gamma", "1.01")
    args = script.module.parse_args(["--total-steps", "1e6", "--seed", "1e3", "0"])
    assert repr((args.total_steps, args.seed)) == "(1000000, [1000, 0])"


@only("a2c_vector")
def test_options_that_would_have_no_effect_or_cannot_work_are_named(script, refusal):
    assert "--randomize: " in refusal(script, "--env-id", "CartPole-v1", "--randomize")
    options = "--vectorization", "async", "--seed", 1, 2
    assert "--vectorization: " in refusal(script, *options)


def test_what_is_no_checkpoint_is_refused(script, folder, refusal, tmp_path):
    """A missing file, an empty name (a variable that is not set), a folder, damage."""
    whole = (folder / "seed-3/checkpoint.pt").read_bytes()
    checkpoint = tmp_path / "checkpoint.pt"
    for flag in ["--watch"] if script.name == "reinforce_mujoco" else ["--watch", "--resume"]:
        for path in "no/such/file", "", ".":
            assert "argument CHECKPOINT " in refusal(script, flag, path)
        for content in whole[: len(whole) // 2], b"", pickle.dumps([1, 2], 2):
            checkpoint.write_bytes(content)
            assert f"argument CHECKPOINT {checkpoint}: " in refusal(script, flag, checkpoint)


def test_a_checkpoint_of_another_script_is_refused(script, runs, refusal, tmp_path):
    name = {"a2c_vector": "ppo_continuous"}.get(script.name, "a2c_vector")
    shutil.copy(run_folder(runs[name][0]) / "seed-3/checkpoint.pt", tmp_path)
    assert "argument --env-id: takes" in refusal(script, "--watch", tmp_path / "checkpoint.pt")


def test_help_shows_every_option_in_ascii_and_says_what_it_does(script, capsys):
    with pytest.raises(SystemExit, match="0"):
        script.module.parse_args(["--help"])
    text = capsys.readouterr().out
    assert text.isascii()
    flat = " ".join(text.split())
    for name in vars(script.module.parse_args([])):
        words = re.search(rf"--{name.replace('_', '-')} (.*?)(?= --|$)", flat).group(1)
        assert re.search(r"[a-z]{3}", words.split("(default")[0]), name
