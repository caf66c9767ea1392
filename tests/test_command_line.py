"""Options: their defaults in one table; wrong calls end in one line and write nothing."""

import re

import numpy as np
import pytest
from conftest import SCRIPTS
from gymnasium.spaces import Box, Dict, Discrete, MultiDiscrete
from harness import World, register, spy

EVERYWHERE = {"seed": [1], "watch": None, "out_dir": "runs", "num_evals": 20, "hidden_size": 64}
DEFAULTS = {
    "reinforce_mujoco": {
        "env_id": "InvertedPendulum-v5", "total_steps": 100_000, "eval_episodes": 20,
        "batch_episodes": 4, "baseline": "value", "critic_steps": 10, "learning_rate": 3e-3,
        "gamma": 0.98},
    "a2c_vector": {
        "env_id": "LunarLander-v3", "total_steps": 1_000_000, "eval_episodes": 20, "num_envs": 8,
        "vectorization": "sync", "randomize": False, "rollout_steps": 64, "reward_scale": 0.1,
        "learning_rate": 2e-3, "gamma": 0.999, "gae_lambda": 0.98, "entropy_coef": 0.01,
        "max_grad_norm": 0.5},
    "ppo_continuous": {
        "env_id": "InvertedDoublePendulum-v5", "total_steps": 150_000, "eval_episodes": 10,
        "num_envs": 16, "rollout_steps": 128, "epochs": 10, "minibatch_size": 512,
        "learning_rate": 1e-3, "gamma": 0.99, "gae_lambda": 0.95, "clip_eps": 0.2, "max_kl": 0.03,
        "first_std": 0.6, "last_std": 0.2},
}


def test_defaults_are_what_the_numbers_were_measured_with(script):
    assert vars(script.args()) == {**EVERYWHERE, **DEFAULTS[script.name]}


M = 3e38
WRONG = {  # world: its spaces, the word that says what is wrong
    "DictObs": ({"observations": Dict(position=Box(-1, 1, (2,)))}, "guide.*Dict"),
    "Scalar": ({"observations": Box(-1, 1, ())}, r"flat .*Box\(-1.0, 1.0, \(\)"),
    "Matrix": ({"observations": Box(np.zeros((9, 9)), np.arange(1, 82.0).reshape(9, 9))}, "81"),
    "ManyActions": ({"actions": MultiDiscrete([2, 3])}, "MultiDiscrete"),
    "SquareActions": ({"actions": Box(-1, 1, (2, 2))}, r"\(2, 2\)"),
    "WholeActions": ({"actions": Box(0, 5, (1,), int)}, "int64"),
    "From1": ({"actions": Discrete(3, start=1)}, "start=1|Discrete"),
    "Unbounded": ({"actions": Box(-float("inf"), float("inf"), (2,))}, "inf"),
    "TooWide": ({"actions": Box(-M, M, (2,))}, r"3e\+38"),
}
for name, (spaces, _) in WRONG.items():
    register(name, **spaces)
FITS = {"reinforce_mujoco": {"Unbounded", "TooWide"}}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", WRONG)
def test_spaces_that_do_not_fit_are_named_and_the_environment_is_closed(
        script, name, refusal, monkeypatch):
    if name in FITS.get(script.name, ()):
        assert script.envs(f"{name}-v0", 1).num_envs == 1
        return
    closed = spy(monkeypatch, World, "close", lambda *_: True)
    discrete = "Discrete" if script.worlds and "actions" not in WRONG[name][0] else ""
    error = refusal(script, "--env-id", f"{discrete}{name}-v0")
    assert re.search(WRONG[name][1], error)
    assert closed


@pytest.mark.parametrize(("arguments", "words"), [
    ("--env-id InvertedPendlum-v5", "InvertedPendulum"), ("--env-id Ant-v99", "v5"),
    ("--env-id no_such_module:Some-v0", "no_such_module"),
    ("--env-id harness:NoSuchWorld-v0", "NoSuchWorld"), ("--seed 1 2 1", "--seed"),
    ("--no-such-option 1", "--no-such-option"), ("--lr 1", "--lr"),
    ("--env-id CartPole-v1 --randomize", "--randomize"),  # not the moon, or not A2C
    ("--env-id {env_id} --out-dir file", "--out-dir file: "),
    ("--watch no/such/file", "--watch no/such/file: "), ("--watch .", "--watch .: "),
    ("--watch empty.csv", "--watch empty.csv: ")])
def test_what_is_wrong_is_named_in_one_line(script, arguments, words, refusal, tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "empty.csv").touch()
    assert words in refusal(script, *arguments.format(env_id=script.env_id).split())


def test_a_constructor_that_lacks_an_argument_is_named_and_its_own_error_is_the_user_s(
        script, refusal, call, monkeypatch):
    env_id = script.world("ThreeSteps")
    monkeypatch.setattr(World, "__init__", lambda self, track, **_: None)
    error = refusal(script, "--env-id", env_id)
    assert "track" in error
    assert env_id in error
    monkeypatch.setattr(World, "__init__", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        call(script, "--env-id", env_id)


def test_numbers_out_of_range_and_no_numbers_are_named(script, refusal):
    """In every option that takes one; 1e6 is a whole number."""
    for name, default in vars(script.args()).items():
        default = default[0] if name == "seed" else default
        if type(default) in (int, float):
            flag = "--" + name.replace("_", "-")
            values = ["nan", "inf", "-11", "1e13", "1,5", ""]
            if type(default) is int:
                values += ["1.5"] if name == "seed" else ["1.5", "0"]
            if name in ("gamma", "gae_lambda"):
                values += ["1.001"]
            for value in values:
                assert f"argument {flag}: " in refusal(script, f"{flag}={value}")
    args = script.args("--total-steps", "1e6", "--seed", "1e3", "0")
    assert repr((args.total_steps, args.seed)) == "(1000000, [1000, 0])"


def test_what_is_no_agent_is_refused(script, refusal, tmp_path):
    """Damage, a file that runs code, an agent of another world or script, which is named."""
    def save(name, script):
        script.module.save(tmp_path / name, [{"env_step": 1}], script.agent(script.env_id),
                           vars(script.args()))

    save("mine", script)
    whole = (tmp_path / "mine.pt").read_bytes()
    trap = b"cos\nmkdir\n(S'trap'\ntR."  # a pickle that makes a folder when it is read
    for content in whole[: len(whole) // 2], b"", b"text", trap:
        (tmp_path / "agent.pt").write_bytes(content)
        assert "--watch agent.pt: " in refusal(script, "--watch", "agent.pt")
    world = script.world("ThreeSteps")
    assert "--watch mine.pt: " in refusal(script, "--watch", "mine.pt", "--env-id", world)
    for other in set(SCRIPTS.values()) - {script}:
        save("other", other)
        error = refusal(script, "--watch", "other.pt")
        assert "--watch other.pt" in error
        assert other.file in error
