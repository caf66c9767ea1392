"""learning_curve.png: what it shows of the tables, and of which runs."""

import sys
import warnings

import numpy as np
import pandas as pd
import pytest
from conftest import SCRIPTS
from matplotlib.figure import Figure
from PIL import Image


@pytest.fixture
def draw(monkeypatch):
    """Draws a figure without a warning, and gives its panels by their y-axes."""
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))

    def draw(script, folder, env_id):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for category in DeprecationWarning, PendingDeprecationWarning, FutureWarning:
                warnings.simplefilter("ignore", category)
            script.module.report(folder, env_id)
        return {panel.get_ylabel(): panel for panel in figures.pop().axes}

    return draw


def curves(panel):
    """Its lines by their labels, without the threshold; seaborn adds empty ones."""
    lines = [line for line in panel.lines if len(line.get_xdata()) > 2]
    return {line.get_label(): line.get_xydata().T for line in lines}


def write_tables(folder, metrics, at, values):
    """Tables with rows at the steps `at`, and the same `values` in each column."""
    folder.mkdir()
    columns = {"evals": ["seconds", "return_mean", "return_std", "length_mean"],
               "episodes": ["return", "length"], "metrics": metrics}
    for name, column in columns.items():
        rows = pd.DataFrame({"env_step": at, **dict.fromkeys(column, values)})
        rows.to_csv(folder / f"{name}.csv", index=False)


def metrics_of(script, folder):
    return list(pd.read_csv(folder / "seed-3/metrics.csv").drop(columns="env_step"))


def test_it_is_a_large_panel_of_returns_above_one_for_each_diagnostic(script, folder, draw, capsys):
    panels = draw(script, folder, script.env_id)
    assert set(panels) == {"return", *metrics_of(script, folder)}
    large, *small = (panel.get_position() for panel in panels.values())
    assert all(large.width * large.height > 5 * x.width * x.height for x in small)
    assert {"training", "evaluation: deterministic actions"} <= set(curves(panels["return"]))
    threshold = {"InvertedPendulum-v5": 950, "CartPole-v1": 475}[script.env_id]
    assert any(list(line.get_ydata()) == [threshold] * 2 for line in panels["return"].lines)
    with Image.open(folder / "learning_curve.png") as image:
        assert image.size[0] >= 1000


def test_a_curve_is_the_mean_over_seeds_with_a_band_from_lowest_to_highest(
        script, folder, draw, tmp_path):
    """The steps of all seeds are sorted into fiftieths of the run; here they are twentieths."""
    at = np.arange(0, 1001, 50)
    seeds = np.random.default_rng(0).normal(size=(3, len(at)))
    for i, values in enumerate(seeds):
        write_tables(tmp_path / f"seed-{i}", metrics_of(script, folder), at, values)
    panels = draw(script, tmp_path, script.world("ThreeSteps"))
    for name, panel in panels.items():
        lines = curves(panel)
        assert len(lines) == (2 if name == "return" else 1)
        for x, y in lines.values():
            np.testing.assert_allclose(x, at, atol=20)
            np.testing.assert_allclose(y, seeds.mean(0))
        assert len(panel.collections) == len(lines)
        for band in panel.collections:
            y = band.get_paths()[0].vertices[:, 1]
            assert (y.min(), y.max()) == (pytest.approx(seeds.min()), pytest.approx(seeds.max()))


def test_a_seed_with_many_short_episodes_counts_as_much_as_one_with_few_long_ones(
        script, folder, draw, tmp_path):
    for seed, count, value in (1, 1000, 20.0), (2, 50, 1000.0):
        at = np.linspace(1, 1000, count, dtype=int)
        write_tables(tmp_path / f"seed-{seed}", metrics_of(script, folder), at, [value] * count)
    panels = draw(script, tmp_path, script.world("ThreeSteps"))
    for panel in panels.values():
        for _, y in curves(panel).values():
            np.testing.assert_allclose(y[1:-1], 510)


def test_seeds_whose_rows_are_at_different_steps_all_count_at_each_point(draw, tmp_path):
    script = SCRIPTS["reinforce_mujoco"]  # the others' seeds make their updates at the same steps
    for seed, at, value in (1, [0, 100, 400, 700, 1000], 1.0), (2, [0, 200, 500, 800, 1000], 3.0):
        values = np.full(len(at), value)
        write_tables(tmp_path / f"seed-{seed}", ["policy_loss"], at, values)
    panels = draw(script, tmp_path, script.world("ThreeSteps"))
    assert len(curves(panels["return"])) == 2
    for panel in panels["return"], panels["policy_loss"]:
        for _, y in curves(panel).values():
            np.testing.assert_allclose(y, 2)


def test_a_run_without_a_finished_episode_is_drawn_as_far_as_it_went(script, draw, tmp_path):
    write_tables(tmp_path / "seed-1", ["policy_loss"], [0, 100, 200], [1, 2, 3])
    (tmp_path / "seed-1/episodes.csv").unlink()
    (tmp_path / "seed-1/metrics.csv").unlink()
    panels = draw(script, tmp_path, script.world("ThreeSteps"))
    assert set(curves(panels["return_mean"])) == {"evaluation: deterministic actions"}


def test_nothing_is_drawn_before_anything_is_saved(script, tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(script.module, "run", interrupted)
    monkeypatch.setattr(sys, "argv", [script.file, "--out-dir", str(tmp_path)])
    with pytest.raises(SystemExit, match="130"):
        script.module.main()
    assert capsys.readouterr().out == ""
    assert [path.name for path in tmp_path.glob("*/*")] == ["args.json"]
