"""What a run prints and leaves: its log, its agent, its figure; evaluations, --watch, notebooks."""

import ctypes.util
import re
import shutil
import sys

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import both
from harness import ROOT, SEED, STRICT, World, read_log, register, run, spy
from matplotlib.figure import Figure
from PIL import Image

METRICS = {
    "reinforce_mujoco": {"value_loss", "explained_variance", "policy_std"},
    "a2c_vector": {"value_loss", "explained_variance", "entropy"},
    "ppo_continuous": {"value_loss", "explained_variance", "kl", "clip_fraction"},
}


def test_a_run_leaves_logs_agents_and_a_figure_in_one_new_folder(script, finished, folder):
    """The bar comes to its end, and a line for each seed is printed, without a warning."""
    cwd, process = finished(script)
    assert [path.name for path in cwd.iterdir()] == ["runs"]
    assert re.fullmatch(rf"{script.env_id}__{script.name}__\d{{8}}_\d{{6,}}", folder.name)
    files = {f"seed-{seed}.{suffix}" for seed in script.seeds for suffix in ("csv", "pt")}
    assert {path.name for path in folder.iterdir()} == {"learning_curve.png", *files}
    first, columns, _, *rows = process.out.splitlines()
    assert first == str(folder)
    for seed, row in zip(sorted(script.seeds, key=str), rows, strict=True):
        log = pd.read_csv(folder / f"seed-{seed}.csv")
        assert set(log) == {"env_step", "seconds", "return", "eval_return", *METRICS[script.name]}
        assert np.isfinite(log.drop(columns=["return", "eval_return"])).all(axis=None)
        saved = torch.load(folder / f"seed-{seed}.pt", weights_only=True)
        given = {"env_id": script.env_id, "seed": [seed]}
        assert saved["options"] == vars(script.args(*script.small.split())) | given
        printed = dict(zip(["seed", *columns.split()], row.split()))
        assert printed["seed"] == f"seed-{seed}"
        assert float(printed["env_step"]) == log["env_step"].iloc[-1]
        assert float(printed["eval_return"]) == pytest.approx(log["eval_return"].iloc[-1], rel=1e-4)
    assert not re.search("(?i)warning|nan", process.out + process.err)
    assert re.search(r"100%\S+ (\d+)/\1 ", process.err)


def test_seeds_in_parallel_equal_seeds_alone(script, folder, tmp_path):
    """Also the second, in which nothing is of the first."""
    alone = script.train(tmp_path, seed=script.seeds[1])
    first, second = (read_log(folder / f"seed-{seed}") for seed in script.seeds)
    pd.testing.assert_frame_equal(second, read_log(alone), check_exact=True)
    assert not first.equals(second)


def test_evaluations_change_nothing(script, tmp_path):
    """Neither how many there are, nor how long they take."""
    few, many = (script.train(tmp_path / n, "--num-evals", n, "--eval-episodes", n) for n in "14")
    logs = [read_log(path).drop(columns="eval_return") for path in (few, many)]
    pd.testing.assert_frame_equal(*logs, check_exact=True)


def evaluate_by_hand(script, agent, world, seed):
    """Nine episodes, one after the other, each in a new environment."""
    returns = []
    for i in range(9):
        args = script.args("--env-id", script.world(world))
        if script.name == "reinforce_mujoco":
            env = script.module.make_env(args.env_id)
            episode = script.module.play(env, agent, True, 1_000_000 + 1000 * seed + i)
            returns.append(sum(episode.rewards))
            continue
        envs = script.module.make_envs(args, 1)
        obs, _ = envs.reset(seed=1_000_000 + 1000 * seed + i)
        done, total = False, 0.0
        while not done:
            obs, rewards, terminated, truncated, _ = envs.step(agent.act(obs, deterministic=True))
            total += rewards.item()
            done = (terminated | truncated).item()
        returns.append(total)
    return np.mean(returns)


def test_an_evaluation_plays_one_deterministic_episode_of_each_seed(script):
    agent, args = script.agent("Uneven"), script.args("--env-id", script.world("Uneven"))
    agent.actor[-1].weight.data *= 100
    reinforce = script.name == "reinforce_mujoco"
    envs = script.module.make_env(args.env_id) if reinforce else script.module.make_envs(args, 9)
    for seed in SEED + 7, SEED + 8, SEED + 7:  # in environments that have been used
        found = script.module.evaluate(agent, envs, seed, *([9] if reinforce else []))
        assert found == pytest.approx(evaluate_by_hand(script, agent, "Uneven", seed), rel=1e-5)


@pytest.mark.filterwarnings("error")
def test_the_figure_has_a_large_panel_of_returns_above_one_for_each_diagnostic(
        script, folder, monkeypatch, tmp_path, capsys):
    """And in each a line for each seed, as in the logs; also metrics of one's own.

    Evaluations stand out; the last one is printed, not the best.
    """
    logs = {seed: pd.read_csv(folder / f"seed-{seed}.csv") for seed in script.seeds}
    for seed, log in logs.items():
        log["mine"] = range(seed, seed + len(log))
        log["eval_return"] = [30, *[np.nan] * (len(log) - 2), 10]
        log.to_csv(tmp_path / f"seed-{seed}.csv", index=False)
    figures = spy(monkeypatch, Figure, "savefig", lambda figure, _: figure)
    script.module.plot(tmp_path)
    assert [row.split()[-1] for row in capsys.readouterr().out.splitlines()[-2:]] == ["10.0"] * 2
    drawn = {panel.get_ylabel().split()[0]: panel for panel in figures[0].axes}
    assert set(drawn) == {"return", "mine", *METRICS[script.name]}
    large, *small = (panel.get_position() for panel in drawn.values())
    assert all(large.width * large.height > 5 * x.width * x.height for x in small)
    for name, panel in drawn.items():
        lines = [line for line in panel.lines if len(line.get_xdata())]
        columns = [name, "eval_return"] if name == "return" else [name]
        expected = [(column, log[["env_step", column]].dropna().to_numpy().tolist())
                    for column in columns for log in logs.values()]
        found = [("return" if line.get_alpha() < 0.9 else "eval_return" if name == "return"
                  else name, line.get_xydata().tolist()) for line in lines]
        assert sorted(found) == sorted(expected)
    legend = [text.get_text() for text in drawn["return"].get_legend().get_texts()]
    assert sorted(legend) == sorted(f"seed-{seed}" for seed in script.seeds)


@pytest.mark.parametrize(("seeds", "rows"), [(1, 1), (40, 2)])
@pytest.mark.filterwarnings("error")
def test_a_figure_of_one_row_or_of_many_seeds_shows_them(seeds, rows, monkeypatch, tmp_path):
    log = pd.DataFrame({"env_step": range(rows), "seconds": 1, "return": 1, "eval_return": 2,
                        "explained_variance": 0})
    for seed in range(seeds):
        log.to_csv(tmp_path / f"seed-{seed}.csv", index=False)
    figures = spy(monkeypatch, Figure, "savefig", lambda figure, _: figure.canvas.draw() or figure)
    sys.modules["ppo_continuous"].plot(tmp_path)
    large = figures[0].axes[0]
    assert all(line.get_marker() != "None" for line in large.lines)
    assert large.get_position().width * large.get_position().height > 0.4


class Bar(World):
    """Draws how many steps it has taken into one picture, which it keeps; pays what it has drawn."""

    def __init__(self, render_mode=None, fps=20, **kwargs):
        super().__init__(**kwargs)
        self.render_mode, self.picture = render_mode, np.zeros((61, 401, 3), np.uint8)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": fps}

    def reward(self, action):
        return self.episode

    def render(self):
        self.picture[:] = 255
        self.picture[:, : self.steps] = 0
        return self.picture


FILMS = {"Usual": (60, 20, 1), "Fast": (100, 50, 2), "Lasting": (300, 20, 1)}
for name, (length, fps, _) in FILMS.items():
    register(name, type(name, (Bar,), {"metadata": {"render_modes": ["rgb_array"]}}),
             length=length, fps=fps)


@pytest.mark.parametrize("name", FILMS)
def test_watch_plays_the_first_episode_of_an_evaluation_and_films_it(
        script, name, tmp_path, capsys):
    """As it was, from the first state on, at true speed. Typed options win; a path may be text."""
    path = script.train(tmp_path / "new", "--env-id", script.world(name, "test_files"),
                        "--eval-episodes", 1, "--num-evals", 1, "--total-steps", 64)
    shown, (length, fps, every) = [], FILMS[name]
    for options in ["--seed", "9"], []:
        capsys.readouterr()
        script.module.watch(f"{path}.pt", options)
        found = float(capsys.readouterr().out.removeprefix("return:"))
        assert (found == read_log(path)["eval_return"].iloc[-1]) == (not options)
    with Image.open(f"{path}.gif") as gif:
        for i in range(gif.n_frames):
            gif.seek(i)
            shown.append(int((np.asarray(gif.convert("L"))[30] < 128).sum()))
            assert abs(gif.info["duration"] - 1000 * every / fps) <= 5
        assert "loop" in gif.info
    assert shown == list(range(0, min(length, 200 * every), every))


@pytest.mark.skipif(
    sys.platform != "linux" or not ctypes.util.find_library("EGL"), reason="no EGL here")
@pytest.mark.slow
@both  # which draw with MuJoCo and with pygame
def test_a_copy_of_a_script_films_a_copied_agent_without_a_display(script, folder, tmp_path):
    shutil.copy(ROOT / f"{script.name}.py", tmp_path / "mine.py")
    shutil.copy(folder / f"seed-{script.seeds[1]}.pt", tmp_path / "my.pt")
    process = run(tmp_path / "mine.py", "--watch", "my.pt", cwd=tmp_path, python=STRICT)
    assert re.fullmatch(r"return: [\d.]+\n", process.out)
    assert not re.search("Traceback|Exception|Warning", process.err)  # SDL may miss a folder
    files = {path.name for path in tmp_path.iterdir()} - {"__pycache__"}
    assert files == {"mine.py", "my.pt", "my.gif"}
    with Image.open(tmp_path / "my.gif") as gif:
        assert gif.n_frames > 1
        assert min(gif.size) >= 400
