"""Fixtures that several test files share: the three scripts, and a finished run of each."""

from types import ModuleType
from typing import NamedTuple

import pytest
import torch
from harness import STRICT, run, run_folder

import a2c_vector
import ppo_continuous
import reinforce_mujoco


class Script(NamedTuple):
    module: ModuleType
    env_id: str
    sizes: str  # a short training: 512 steps
    worlds: str = ""  # prefix of the worlds whose actions fit
    seeds: tuple = (3, 11)

    @property
    def name(self):
        return self.module.__name__

    @property
    def file(self):
        return f"{self.name}.py"

    @property
    def small(self):
        return [*self.sizes.split(), "--total-steps", "512", "--num-evals", "4",
                "--eval-episodes", "2"]

    def world(self, name, place="harness"):
        return f"{place}:{self.worlds}{name}-v0"

    def args(self, *options):
        return self.module.parse_args([str(x) for x in options])

    def envs(self, env_id, count, *mode):
        """Environments; by default they reset themselves."""
        return self.module.make_envs(self.args("--env-id", env_id), count, *mode)

    def agent(self, env_id, hidden_size=64):
        envs = self.envs(env_id, 1)
        return self.module.Agent(
            envs.single_observation_space, envs.single_action_space, hidden_size)

    def train(self, folder, *arguments, seed=3, env_id=None):
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


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """Of each script: where it was started, and the process of a run of two seeds.

    In it, warnings are errors.
    """
    finished = {}
    for name, script in SCRIPTS.items():
        cwd = tmp_path_factory.mktemp(name)
        arguments = ["--env-id", script.env_id, *script.small, "--seed", *script.seeds]
        finished[name] = cwd, run(script.file, *arguments, cwd=cwd, python=STRICT)
    return finished


@pytest.fixture
def folder(script, runs):
    """The folder of the finished run."""
    return run_folder(runs[script.name][0])
