"""The three scripts, as fixtures."""

import sys
from types import ModuleType
from typing import NamedTuple

import pytest
import torch
from harness import SEED

import a2c_vector
import ppo_continuous
import reinforce_mujoco


class Script(NamedTuple):
    module: ModuleType
    env_id: str
    small: str  # a training of some 512 steps
    worlds: str = ""  # prefix of the worlds whose actions fit

    @property
    def name(self):
        return self.module.__name__

    def world(self, name, place="harness"):
        return f"{place}:{self.worlds}{name}-v0"

    def args(self, *options):
        return self.module.parse_args([str(x) for x in options])

    def envs(self, world, count=1, **options):
        """A vector of environments; of REINFORCE the one that it knows."""
        if self.name == "reinforce_mujoco":
            return self.module.make_env(self.world(world))
        return self.module.make_envs(self.args("--env-id", self.world(world)), count, **options)

    def agent(self, world, hidden_size=64):
        envs = self.envs(world)
        (env,) = getattr(envs.unwrapped, "envs", [envs])
        return self.module.Agent(env.observation_space, env.action_space, hidden_size)

    def train(self, folder, *options, seed=SEED + 3):
        """Train a seed in this process; the path of its files, without a suffix."""
        usual = f"--env-id {self.env_id} {self.small}".split()
        self.module.train(0, self.args(*usual, *options, "--seed", seed), folder)
        return folder / f"seed-{seed}"


USUAL = "--total-steps 512 --num-evals 4 --eval-episodes 2"
VECTOR = f"{USUAL} --num-envs 4 --rollout-steps 32"
SCRIPTS = {script.name: script for script in (
    Script(reinforce_mujoco, "InvertedPendulum-v5", f"{USUAL} --batch-episodes 8"),
    Script(a2c_vector, "CartPole-v1", VECTOR, "Discrete"),
    Script(ppo_continuous, "InvertedPendulum-v5", f"{VECTOR} --minibatch-size 32 --epochs 2"))}


@pytest.fixture(scope="session", params=SCRIPTS)
def script(request):
    """Each of the three; @both: A2C and PPO."""
    return SCRIPTS[request.param]


both = pytest.mark.parametrize("script", ["a2c_vector", "ppo_continuous"], indirect=True)


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(SEED)


@pytest.fixture
def call(monkeypatch, tmp_path, capsys):
    """call(script, *arguments): its main, in this process and an empty folder; what it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])

    def call(script, *arguments):
        monkeypatch.setattr(sys, "argv", [f"{script.name}.py", *map(str, arguments)])
        capsys.readouterr()
        script.module.main()
        return capsys.readouterr().out

    return call
