"""What a run prints and leaves: its log, its agent, its figure; evaluations, --watch, notebooks."""

import ctypes.util
import re
import shutil

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SCRIPTS, both
from gymnasium.utils.seeding import np_random
from harness import ROOT, SEED, STRICT, World, read_log, register, run, spy
from matplotlib.figure import Figure
from PIL import Image

METRICS = {"reinforce_mujoco": ["value_loss", "policy_std"],
           "a2c_vector": ["value_loss", "entropy"],
           "ppo_continuous": ["value_loss", "kl", "clip_fraction"]}
SEEDS = SEED + 3, SEED + 11


@pytest.fixture(scope="session")
def finished(script, tmp_path_factory):
    """A run of two seeds in a shell, where a warning is an error: its output, and its folder."""
    cwd = tmp_path_factory.mktemp(script.name)
    printed = run(f"{script.name}.py", "--env-id", script.env_id, *script.small.split(), "--seed",
                  *SEEDS, cwd=cwd, python=STRICT)
    assert [path.name for path in cwd.iterdir()] == ["runs"]
    (folder,) = (cwd / "runs").iterdir()
    return printed, folder


def test_a_run_leaves_logs_agents_and_a_figure_in_one_new_folder(script, finished):
    """The bar comes to its end, and a line for each seed is printed, with its last evaluation."""
    (out, err), folder = finished
    assert re.fullmatch(rf"{script.env_id}__{script.name}__\d{{8}}_\d{{6,}}", folder.name)
    files = {f"seed-{seed}.{suffix}" for seed in SEEDS for suffix in ("csv", "pt")}
    assert {path.name for path in folder.iterdir()} == {"learning_curve.png", *files}
    first, columns, _, *rows = out.splitlines()
    assert first == str(folder)
    for seed, row in zip(sorted(SEEDS, key=str), rows, strict=True):
        log = pd.read_csv(folder / f"seed-{seed}.csv")
        assert set(log) == {"env_step", "seconds", "return", "eval_return", "explained_variance",
                            *METRICS[script.name]}
        assert np.isfinite(log[["env_step", "seconds", *METRICS[script.name]]]).all(axis=None)
        assert log["seconds"].is_monotonic_increasing
        saved = torch.load(folder / f"seed-{seed}.pt", weights_only=True)
        given = {"env_id": script.env_id, "seed": [seed]}
        assert saved["options"] == vars(script.args(*script.small.split())) | given
        name, env_step, eval_return = row.split()
        assert (name, int(env_step)) == (f"seed-{seed}", log["env_step"].iloc[-1])
        assert float(eval_return) == pytest.approx(log["eval_return"].iloc[-1], rel=1e-4)
    assert not re.search("(?i)warning|nan", out + err)
    assert re.search(r"100%\S+ (\d+)/\1 ", err)


def test_seeds_in_parallel_equal_seeds_alone(script, finished, tmp_path):
    """Also the second, in which nothing is of the first."""
    alone = script.train(tmp_path, seed=SEEDS[1])
    first, second = (read_log(finished[1] / f"seed-{seed}") for seed in SEEDS)
    pd.testing.assert_frame_equal(second, read_log(alone), check_exact=True)
    assert not first.equals(second)


def test_evaluations_have_no_noise_and_change_nothing(script, tmp_path):
    """Neither how many there are, nor how long they take; noise would change what follows."""
    few, many = (script.train(tmp_path / n, "--num-evals", n, "--eval-episodes", n) for n in "14")
    logs = [read_log(path).drop(columns="eval_return") for path in (few, many)]
    pd.testing.assert_frame_equal(*logs, check_exact=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("seeds", "rows"), [(1, 1), (2, 9), (40, 2)])
def test_the_figure_shows_all_seeds_and_evaluations_stand_out(
        seeds, rows, monkeypatch, tmp_path, capsys):
    """A large panel of returns above one for each metric, also of one's own, here with a blank.

    The last evaluation is printed, not the best. Many seeds take no room, one row shows a point.
    """
    log = pd.DataFrame({"env_step": range(rows), "seconds": 1.0, "return": 5, "mine": 6,
                        "explained_variance": np.nan, "eval_return": 30.0})
    log.loc[1:, "eval_return"] = [*[np.nan] * (rows - 2), 10.0][: rows - 1]
    for seed in range(seeds):
        log.to_csv(tmp_path / f"seed-{seed}.csv", index=False)
    figures = spy(monkeypatch, Figure, "savefig", lambda figure, _: figure.canvas.draw() or figure)
    SCRIPTS["ppo_continuous"].module.plot(str(tmp_path))  # as text, too; all files share it
    assert float(capsys.readouterr().out.split()[-1]) == (30 if rows == 1 else 10)
    drawn = {panel.get_ylabel().split()[0]: panel for panel in figures[0].axes}
    assert set(drawn) == {"return", "mine", "explained_variance"}
    large, *small = (panel.get_position() for panel in drawn.values())
    assert large.width * large.height > 0.4
    assert all(large.width * large.height > 3 * x.width * x.height for x in small)
    lines = [(line.get_alpha() < 0.9, line.get_marker() != "None", line.get_xydata().tolist())
             for line in drawn["return"].lines if len(line.get_xdata())]
    evaluations = log[["env_step", "eval_return"]].dropna().to_numpy().tolist()
    pale = (True, True, log[["env_step", "return"]].to_numpy().tolist())
    assert lines == [pale] * seeds + [(False, True, evaluations)] * seeds


class Shown(World):
    """Pays what the episode has drawn; draws its steps into one picture, which it keeps."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(self, render_mode=None, **kwargs):
        super().__init__(**kwargs)
        self.render_mode, self.picture = render_mode, np.zeros((61, 401, 3), np.uint8)

    def reset(self, *, seed=None, options=None):
        shown = super().reset(seed=seed)
        self.length = shown_length(self.episode)
        return shown

    def reward(self, action):
        return self.episode

    def render(self):
        self.picture[:] = 255
        self.picture[:, : self.steps] = 0
        return self.picture


def shown_length(drawn):
    return 450 if drawn > 0 else 300


register("Shown", Shown)


def test_an_evaluation_plays_an_episode_of_each_seed_and_watch_films_the_start_of_the_first(
        script, tmp_path, capsys):
    """As it was, at true speed: 25 frames a second, 200 at most. Typed options win."""
    path = script.train(tmp_path / "new", "--env-id", script.world("Shown", "test_files"),
                        "--eval-episodes", 3, "--num-evals", 1)
    first = {seed: 1_000_000 + 1000 * seed for seed in (SEED + 3, SEED + 9)}
    drawn = [np_random(first[SEED + 3] + i)[0].uniform(-1, 1) for i in range(3)]
    expected = np.mean([x * shown_length(x) for x in drawn])
    np.testing.assert_allclose(read_log(path)["eval_return"].dropna(), expected, rtol=1e-5)
    for seed, options in (SEED + 9, ["--seed", str(SEED + 9)]), (SEED + 3, []):
        capsys.readouterr()
        script.module.watch(f"{path}.pt", options)
        x = np_random(first[seed])[0].uniform(-1, 1)
        printed = float(capsys.readouterr().out.removeprefix("return:"))
        assert printed == pytest.approx(x * shown_length(x), rel=1e-5)
    shown = []
    with Image.open(f"{path}.gif") as gif:
        for i in range(gif.n_frames):
            gif.seek(i)
            shown.append(int((np.asarray(gif.convert("L"))[30] < 128).sum()))
            assert gif.info["duration"] == 40
    assert shown == list(range(0, min(shown_length(x), 400), 2))


@pytest.mark.skipif(not ctypes.util.find_library("EGL"), reason="no EGL here")
@pytest.mark.slow
@both  # which draw with MuJoCo and with pygame
def test_a_copy_of_a_script_films_a_copied_agent_without_a_display(script, finished, tmp_path):
    shutil.copy(ROOT / f"{script.name}.py", tmp_path / "mine.py")
    shutil.copy(finished[1] / f"seed-{SEEDS[1]}.pt", tmp_path / "my.pt")
    out, err = run(tmp_path / "mine.py", "--watch", "my.pt", cwd=tmp_path, python=STRICT)
    assert re.fullmatch(r"return: [\d.]+\n", out)
    assert not re.search("Traceback|Exception|Warning", err)  # SDL may miss a folder
    assert {path.name for path in tmp_path.iterdir()} == {"mine.py", "my.pt", "my.gif"}
    with Image.open(tmp_path / "my.gif") as gif:
        assert gif.n_frames > 1
        assert min(gif.size) >= 400
