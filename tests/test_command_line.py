"""Wrong options and environments end in one line and write nothing."""

from pathlib import Path

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiDiscrete
from harness import World, register


@pytest.fixture
def refusal(call, capsys):
    """refusal(script, *arguments): the one line that a wrong call says, and leaves no file."""
    def refusal(script, *arguments):
        with pytest.raises(SystemExit) as end:
            call(script, *arguments)
        assert isinstance(end.value.code, str)
        assert end.value.code.count("\n") == 0 < len(end.value.code)
        assert capsys.readouterr() == ("", "")
        assert not list(Path().iterdir())
        return end.value.code

    return refusal


for name, spaces in {
        "Dict": {"observations": Dict(position=Box(-1, 1, (2,)))},
        "Matrix": {"observations": Box(-1, 1, (9, 9))}, "Whole": {"actions": Box(0, 5, (1,), int)},
        "Many": {"actions": MultiDiscrete([2, 3])}, "Square": {"actions": Box(-1, 1, (2, 2))},
        "From1": {"actions": Discrete(3, start=1)}, "Endless": {"actions": Box(-np.inf, np.inf)},
        "TooWide": {"actions": Box(-3e38, 3e38, (2,))}}.items():
    register(name, **spaces)
MISFITS = {"reinforce_mujoco": "Dict Matrix Many Square From1",
           "a2c_vector": "DiscreteDict DiscreteMatrix Many Square From1",
           "ppo_continuous": "Dict Matrix Whole Many Square From1 Endless TooWide"}


@pytest.mark.filterwarnings("error")
def test_spaces_that_do_not_fit_are_named(script, refusal):
    for name in MISFITS[script.name].split():
        env_id = f"test_command_line:{name}-v0"
        assert f"--env-id {env_id}: needs" in refusal(script, "--env-id", env_id)


@pytest.mark.parametrize(("arguments", "words"), [
    ("--env-id no_such_module:Some-v0", "no_such_module"),
    ("--env-id CartPole-v1 --randomize", "--randomize"),  # not the moon, or not A2C
    ("--env-id harness:NoSuchWorld-v0", "NoSuchWorld")])
def test_what_is_wrong_is_named_in_one_line(script, arguments, words, refusal):
    assert words in refusal(script, *arguments.split())


def test_numbers_out_of_range_and_no_numbers_are_named(script, refusal):
    """In every option that takes one; 1e6 is a whole number."""
    for name, default in vars(script.module.parse_args([])).items():
        default = default[0] if name == "seed" else default
        if type(default) in (int, float):
            flag = "--" + name.replace("_", "-")
            values = ["nan", "inf", "-11", "1e13", "1,5"] + ["1.5"] * (type(default) is int)
            for value in values + ["1.001"] * (name in ("gamma", "gae_lambda")):
                assert f"argument {flag}: " in refusal(script, f"{flag}={value}")
    args = script.args("--total-steps", "1e6", "--seed", "1e3", "0")
    assert repr((args.total_steps, args.seed)) == "(1000000, [1000, 0])"


def test_a_bug_in_the_user_s_environment_keeps_its_traceback(script, call, monkeypatch, tmp_path):
    """When it is made, and in its first steps, after which no folder is left."""
    for method in "reward", "__init__":
        monkeypatch.setattr(World, method, lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            call(script, "--env-id", script.world("ThreeSteps"))
        assert not list(tmp_path.iterdir())
