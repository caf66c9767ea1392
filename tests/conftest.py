"""Fixtures that several test files share: the three scripts, and a finished run of each."""

import functools
import sys
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest
import torch
from harness import SEED, STRICT, run

import a2c_vector
import ppo_continuous
import reinforce_mujoco


class Script(NamedTuple):
    module: ModuleType
    env_id: str
    sizes: str  # a short training: 512 steps
    worlds: str = ""  # prefix of the worlds whose actions fit
    seeds: tuple = (SEED + 3, SEED + 11)

    @property
    def name(self):
        return self.module.__name__

    @property
    def file(self):
        return f"{self.name}.py"

    @property
    def small(self):
        return f"{self.sizes} --total-steps 512 --num-evals 4 --eval-episodes 2".split()

    def world(self, name, place="harness"):
        return f"{place}:{self.worlds}{name}-v0"

    def args(self, *options):
        return self.module.parse_args([str(x) for x in options])

    def envs(self, env_id, count, **options):
        """Environments; by default they reset themselves."""
        seed = torch.randint(2**31, ()).item()  # another one at each call
        return self.module.make_envs(self.args("--env-id", env_id), seed, count, **options)

    def agent(self, env_id, hidden_size=64):
        envs = self.envs(env_id, 1)
        return self.module.Agent(
            envs.single_observation_space, envs.single_action_space, hidden_size)

    def train(self, folder, *arguments, seed=SEED + 3, env_id=None):
        """Train a seed in this process; returns the path of its files, without a suffix."""
        args = self.args(
            "--env-id", env_id or self.env_id, *self.small, *arguments, "--seed", seed)
        folder.mkdir(parents=True, exist_ok=True)
        self.module.train(0, args, folder)
        return folder / f"seed-{seed}"


SCRIPTS = {
    "reinforce_mujoco": Script(reinforce_mujoco, "InvertedPendulum-v5", "--batch-episodes 8"),
    "a2c_vector": Script(a2c_vector, "CartPole-v1", "--num-envs 4 --rollout-steps 32", "Discrete"),
    "ppo_continuous": Script(
        ppo_continuous, "InvertedPendulum-v5",
        "--num-envs 4 --rollout-steps 32 --minibatch-size 32 --epochs 2"),
}


@pytest.fixture(scope="session", params=SCRIPTS)
def script(request):
    """Each of the three; @only(…) chooses some."""
    return SCRIPTS[request.param]


def only(*names):
    return pytest.mark.parametrize("script", names, indirect=True)


both = only("a2c_vector", "ppo_continuous")


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(SEED)
    np.random.seed(SEED)


@pytest.fixture
def float64(monkeypatch):
    """The scripts compute in float64, so that rounding decides nothing."""
    monkeypatch.setattr(torch.Tensor, "float", torch.Tensor.double)
    usual = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(usual)


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """finished(script): a run of two seeds: where it was started, and its process."""
    @functools.cache  # a run for each script, however the tests are ordered
    def finished(script):
        cwd = tmp_path_factory.mktemp(script.name)
        arguments = ["--env-id", script.env_id, *script.small, "--seed", *script.seeds]
        return cwd, run(script.file, *arguments, cwd=cwd, python=STRICT)  # warnings end it

    return finished


@pytest.fixture
def folder(script, finished):
    """The folder of the finished run."""
    (folder,) = (finished(script)[0] / "runs").iterdir()
    return folder


@pytest.fixture
def call(monkeypatch, tmp_path, capsys):
    """call(script, *arguments): its main, in this process and an empty folder; what it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])

    def call(script, *arguments):
        monkeypatch.setattr(sys, "argv", [script.file, *map(str, arguments)])
        capsys.readouterr()
        script.module.main()
        return "".join(capsys.readouterr())

    return call


@pytest.fixture
def refusal(call, capsys):
    """refusal(script, *arguments): the one line that a wrong call says, and leaves no file."""
    def refusal(script, *arguments):
        before = set(Path().rglob("*"))
        with pytest.raises(SystemExit) as end:
            call(script, *arguments)
        assert isinstance(end.value.code, str)
        assert end.value.code.strip()
        assert "\n" not in end.value.code
        assert capsys.readouterr() == ("", "")
        assert set(Path().rglob("*")) == before
        return end.value.code

    return refusal


@pytest.fixture
def watch(call, capsys):
    """watch(script, path, *options): the return that --watch prints, and how it ends."""
    def watch(script, path, *options):
        end = None
        try:
            out = call(script, "--watch", f"{path}.pt", *options)
        except SystemExit as error:
            out, end = capsys.readouterr().out, error.code
        return float(out.removeprefix("return:").split()[0]), end

    return watch
