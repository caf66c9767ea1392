"""What a run prints and leaves: its log, its agent, its figure; evaluations, seeds, --watch."""

import ctypes.util
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import both
from harness import ROOT, STRICT, Uneven, World, load, read_log, register, run, spy
from matplotlib.figure import Figure
from PIL import Image

METRICS = {
    "reinforce_mujoco": {"value_loss", "explained_variance", "policy_std"},
    "a2c_vector": {"value_loss", "explained_variance", "entropy"},
    "ppo_continuous": {"value_loss", "explained_variance", "kl", "clip_fraction"},
}


def test_a_run_leaves_logs_agents_and_a_figure_in_one_new_folder(script, finished, folder):
    """The log's diagnostics are numbers; an agent's file has all options, its own seed, its script.

    A line for each seed is printed, and no warning.
    """
    cwd, process = finished(script)
    assert [path.name for path in cwd.iterdir()] == ["runs"]
    assert re.fullmatch(rf"{script.env_id}__{script.name}__\d{{8}}_\d{{6,}}", folder.name)
    files = {f"seed-{seed}.{suffix}" for seed in script.seeds for suffix in ("csv", "pt")}
    assert {path.name for path in folder.iterdir()} == {"learning_curve.png", *files}
    first, columns, _, *rows = process.out.splitlines()
    assert first == str(folder.relative_to(cwd))
    for seed, row in zip(script.seeds, rows, strict=True):
        log, saved = pd.read_csv(folder / f"seed-{seed}.csv"), load(folder / f"seed-{seed}.pt")
        assert set(log) == {"env_step", "seconds", "return", "eval_return", *METRICS[script.name]}
        assert np.isfinite(log.drop(columns=["return", "eval_return"])).all(axis=None)
        assert saved.keys() == {"agent", "options", "script"}
        assert saved["script"] == script.file
        given = {"env_id": script.env_id, "seed": [seed]}
        assert saved["options"] == vars(script.args(*script.small)) | given
        printed, last = dict(zip(["seed", *columns.split()], row.split())), log.iloc[-1]
        assert printed["seed"] == f"seed-{seed}"
        assert float(printed["env_step"]) == last["env_step"]
        assert float(printed["eval_return"]) == pytest.approx(last["eval_return"], rel=1e-4)
    assert not re.search("(?i)warning|nan", process.out + process.err)


def test_one_that_crashes_while_it_saves_keeps_what_was_saved_before(script, tmp_path, monkeypatch):
    def crash(_, path, **__):
        Path(path).write_text("half of i")
        raise KeyboardInterrupt

    path = script.train(tmp_path)
    before = {file: Path(f"{path}.{file}").read_bytes() for file in ("csv", "pt")}
    for owner, name in (pd.DataFrame, "to_csv"), (torch, "save"):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, crash)
            with pytest.raises(KeyboardInterrupt):
                script.train(tmp_path, "--total-steps", 1000)
        assert before == {file: Path(f"{path}.{file}").read_bytes() for file in before}


def test_seeds_in_parallel_equal_seeds_alone(script, folder, tmp_path):
    """Also the second, in which nothing is of the first."""
    alone = script.train(tmp_path, seed=script.seeds[1])
    first, second = (read_log(folder / f"seed-{seed}.csv") for seed in script.seeds)
    pd.testing.assert_frame_equal(second, read_log(f"{alone}.csv"), check_exact=True)
    assert not first.equals(second)


@pytest.mark.slow
def test_a_bug_in_the_user_s_environment_keeps_its_traceback(tmp_path):
    """It strikes after the first evaluation; the module lies where the user stands."""
    (tmp_path / "here.py").write_text(
        "import harness\nharness.World.reward = lambda world, _: 1 / (world.total < 40)\n")
    options = "--num-envs 4 --rollout-steps 32 --total-steps 1024 --eval-episodes 1 --num-evals 8"
    arguments = "--env-id", "here:ThreeSteps-v0", *options.split(), "--seed", 1, 2
    process = run("ppo_continuous.py", *arguments, cwd=tmp_path, status=1)
    assert 'here.py", line 2, in <lambda>' in process.err
    assert "ZeroDivisionError: division by zero" in process.err
    assert len(list(tmp_path.glob("runs/*/learning_curve.png"))) == 1


def test_a_run_that_fails_at_once_leaves_no_folder(script, call, monkeypatch, tmp_path):
    monkeypatch.setattr(World, "reward", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        call(script, "--env-id", script.world("ThreeSteps"))
    assert not list(tmp_path.glob("runs/*"))


class Jackpot(Uneven):
    """Pays what no sum survives in all but the first episode after a seed."""

    def reset(self, *, seed=None, options=None):
        self.first = seed is not None
        return super().reset(seed=seed)

    def reward(self, action):
        return super().reward(action) if self.first else np.inf


register("Jackpot", Jackpot)


def evaluate_by_hand(script, agent, env_id, seed):
    """Nine episodes, one after the other, in one environment."""
    envs, returns = script.envs(env_id, 1), []
    for episode_seed in script.module.make_seeds(seed, stream=1, count=9):
        obs, _ = envs.reset(seed=[episode_seed])
        done, total = False, 0.0
        while not done:
            obs, rewards, terminated, truncated, _ = envs.step(agent.act(obs, deterministic=True))
            total += rewards.item()
            done = (terminated | truncated).item()
        returns.append(total)
    return np.mean(returns)


def test_an_evaluation_plays_one_deterministic_episode_of_each_seed(script, monkeypatch):
    """As if by itself. Those that are done run on, also with infinite reward, but count no more."""
    env_id = script.world("Uneven" if script.name == "reinforce_mujoco" else "Jackpot")
    envs, agent = script.envs(env_id, 9), script.agent(env_id)
    agent.actor[-1].weight.data *= 100
    if script.name != "reinforce_mujoco":
        agent.obs_stats.update(3 * torch.randn(50, 2) + 1)
    expected = {seed: evaluate_by_hand(script, agent, env_id, seed) for seed in (7, 8)}
    for seed in 7, 8, 7:  # with ever different noise, in environments that have been used
        assert script.module.evaluate(agent, envs, seed) == pytest.approx(expected[seed], rel=1e-5)
        np.random.uniform(), torch.rand(())
    monkeypatch.setattr(Uneven, "reward", lambda *_: np.nan)
    with pytest.raises(ValueError, match="a re.* is NaN or infinite"):
        script.module.evaluate(agent, envs, 7)


@pytest.mark.filterwarnings("error")
def test_the_figure_has_a_large_panel_of_returns_above_one_for_each_diagnostic(
        script, folder, monkeypatch, tmp_path):
    """And in each a line for each seed, as it stands in the logs; also metrics of one's own."""
    logs = {seed: pd.read_csv(folder / f"seed-{seed}.csv") for seed in script.seeds}
    for seed, log in logs.items():
        log["mine"] = range(seed, seed + len(log))
        log.loc[1:3, "explained_variance"] = -1e14, -np.inf, np.nan  # targets that do not vary
        log.to_csv(tmp_path / f"seed-{seed}.csv", index=False)
    figures = spy(monkeypatch, Figure, "savefig", lambda figure, _: figure)
    script.module.plot(tmp_path)
    drawn = {panel.get_ylabel().split()[0]: panel for panel in figures[0].axes}
    assert set(drawn) == {"return", "mine", *METRICS[script.name]}
    large, *small = (panel.get_position() for panel in drawn.values())
    assert all(large.width * large.height > 5 * x.width * x.height for x in small)
    for name, panel in drawn.items():
        lines = [line.get_xydata() for line in panel.lines if len(line.get_xdata())]
        expected = [log[["env_step", column]].dropna()
                    for column in ([name, "eval_return"] if name == "return" else [name])
                    for log in logs.values()]
        for line, values in zip(lines, expected, strict=True):
            np.testing.assert_allclose(line[np.isfinite(line).all(1)],
                                       values[np.isfinite(values).all(axis=1)])
    assert drawn["explained_variance"].get_ylim() == (-1, 1)
    legend = [text.get_text() for text in drawn["return"].get_legend().get_texts()]
    assert legend == [f"seed-{seed}" for seed in script.seeds]  # 3 before 11


@pytest.mark.skipif(
    sys.platform != "linux" or not ctypes.util.find_library("EGL"), reason="no EGL here")
@pytest.mark.slow
@both  # which draw with MuJoCo and with pygame
def test_a_copy_of_a_script_watches_a_copied_agent(script, folder, tmp_path):
    """Of the second seed. No display; the last evaluation again, to the digit, and one GIF."""
    seed = script.seeds[1]
    shutil.copy(ROOT / script.file, tmp_path / "mine.py")
    shutil.copy(folder / f"seed-{seed}.pt", tmp_path / "my.pt")
    process = run(tmp_path / "mine.py", "--watch", "my.pt", cwd=tmp_path, python=STRICT)
    last = pd.read_csv(folder / f"seed-{seed}.csv")["eval_return"].iloc[-1]
    assert process.out == f"return: {last}\n"
    assert not re.search("Traceback|Exception|Warning", process.err)  # SDL may miss a folder
    files = {"mine.py", "my.pt", "my.gif"}
    assert {path.name for path in tmp_path.iterdir()} - {"__pycache__"} == files
    with Image.open(tmp_path / "my.gif") as gif:
        assert gif.n_frames > 1
        assert min(gif.size) >= 400
