"""tests/benchmark: what is run and what is not run again, variants, reports, merging."""

import importlib.util
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import harness
import numpy as np
import pandas as pd
import pytest
import torch
from benchmark import ablation, common, exercises, merge, race, reports, returns, trials
from benchmark.__main__ import SHOWN, STUDIES, main
from benchmark.common import A2C, PPO, Job

VARIANTS = sorted(x.stem for x in common.VARIANTS.glob("*.patch"))


class Timed(harness.World):
    """Only a time limit ends it; rewards depend on actions and on time."""

    def reward(self, action):
        return self.steps - float(np.square(action - 0.1).sum())


harness.register("Timed", Timed, limit=8, length=None, actions=gym.spaces.Box(-1, 1, (5,)))


# --- Variants -------------------------------------------------------------------------------------


def weights_after_training(folder, variant):
    path = common.write_script(Job(PPO, variant=variant), folder)
    spec = importlib.util.spec_from_file_location("variant", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sizes = "--num-envs 4 --rollout-steps 50 --total-steps 600 --learning-rate 3e-3"
    args = module.parse_args(["--env-id", "Timed-v0", *sizes.split()])
    torch.manual_seed(0)
    envs = module.make_envs(args.env_id, args.num_envs, "Disabled")
    agent = module.Agent(envs.single_observation_space, envs.single_action_space, args)
    assert len(list(module.train(args, 1, envs, agent, module.make_optimizer(agent), 0))) == 1 + 3
    return torch.cat([x.flatten() for x in agent.parameters()])


def test_each_variant_applies_runs_and_learns_something_else(tmp_path):
    usual = weights_after_training(tmp_path, "")
    for variant in VARIANTS:
        weights = weights_after_training(tmp_path, variant)
        assert weights.isfinite().all()
        assert not torch.equal(weights, usual), variant


def test_every_variant_is_used_and_every_change_can_be_made():
    used = {ablation.changed(change)[1] for change in ablation.CHANGES.values()}
    used |= {variant for _, _, variant in exercises.CHANGES.values()}
    assert used - {""} == set(VARIANTS)


# --- What is run ----------------------------------------------------------------------------------


@pytest.fixture
def study(monkeypatch):
    """A study of two jobs that counts its measurements."""
    measured = []

    def measure(job):
        measured.append(job.seed)
        return pd.DataFrame({"env_id": "World-v0", "env_step": [0, 8], "return_mean": [0.5, 1.5]})

    fake = SimpleNamespace(jobs=lambda quick: [Job(PPO, 1), Job(PPO, 2)], measure=measure,
                           ALONE=True, measured=measured)
    monkeypatch.setitem(sys.modules, "benchmark.fake", fake)
    return fake


def test_what_has_rows_is_not_run_again_and_rows_of_an_older_text_are_dropped(
        study, tmp_path, monkeypatch):
    for _ in range(2):
        common.run("fake", False, tmp_path)
        assert study.measured == [1, 2]
    data, (machine,) = common.read_rows(tmp_path / "fake.csv")
    assert machine == common.machine()
    assert data["seed"].tolist() == [1, 1, 2, 2]
    assert data["return_mean"].tolist() == [0.5, 1.5, 0.5, 1.5]
    assert common.is_current(data).tolist() == 4 * [True]
    monkeypatch.setattr(common, "digest", lambda *_: "another text")
    assert common.is_current(data).tolist() == 4 * [False]
    common.run("fake", False, tmp_path)
    assert study.measured == [1, 2, 1, 2]
    data, _ = common.read_rows(tmp_path / "fake.csv")
    assert data["digest"].tolist() == ["another text"] * 4


def test_a_call_that_ends_early_keeps_its_rows_and_the_next_goes_on(study, tmp_path):
    measure = study.measure

    def interrupted(job):
        if job.seed == 2:
            while not (tmp_path / "fake.csv").exists():  # the rows of the first
                time.sleep(0.01)
            raise KeyboardInterrupt
        return measure(job)

    study.measure = interrupted
    with pytest.raises(KeyboardInterrupt):
        common.run("fake", False, tmp_path)
    assert common.read_rows(tmp_path / "fake.csv")[0]["seed"].tolist() == [1, 1]
    study.measure = measure
    common.run("fake", False, tmp_path)
    assert study.measured == [1, 2]


@pytest.mark.parametrize(("old", "new", "same"), [
    ("# --- The steps", "# --- Steps", True), ('"""PPO: prox', '"""The prox', True),
    ('    """Step 2: T steps', '    """T steps', True), ('help="maximum', 'help="', True),
    ("default=0.99,", "default=0.98,", False)])
def test_only_what_python_executes_is_in_the_digest(old, new, same, tmp_path, monkeypatch):
    before = common.digest.__wrapped__(PPO)
    text = (common.ROOT / f"{PPO}.py").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / f"{PPO}.py").write_text(text.replace(old, new), encoding="utf-8")
    monkeypatch.setattr(common, "ROOT", tmp_path)
    assert (common.digest.__wrapped__(PPO) == before) == same


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    """Where the rows of a quick run of each study lie; those with peers only where they are."""
    folder = tmp_path_factory.mktemp("trial")
    peers = importlib.util.find_spec("stable_baselines3")
    for name in STUDIES:
        if peers or name not in ("race", "speed"):
            main(["run", name, "--quick", "--out-dir", str(folder)])
    return folder


@pytest.mark.slow
def test_a_quick_run_of_each_study_leaves_rows_in_the_one_format(trial):
    assert len(list(trial.glob("*.csv"))) >= len(STUDIES) - 2
    for path in trial.glob("*.csv"):
        data, machines = common.read_rows(path)
        assert list(data)[:len(common.KEYS)] == common.KEYS
        assert {"env_id"} <= set(data)
        assert len(machines) == 1
    if common.DATA.exists():
        assert not any("--total-steps 256" in x.read_text() for x in common.DATA.glob("*.csv"))


# --- Reports --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_report_brings_all_up_to_date_and_says_what_is_not(trial, tmp_path, monkeypatch):
    pytest.importorskip("scipy")
    docs = tmp_path / "docs"
    docs.mkdir()
    shutil.copytree(trial, docs / "data")
    for name, value in {"ROOT": tmp_path, "DOCS": docs, "DATA": docs / "data"}.items():
        monkeypatch.setattr(common, name, value)
    monkeypatch.setattr(common, "is_current", lambda data: np.ones(len(data), bool))
    names = "returns.usual", "ablation.ablation", "scaling.scaling"
    marks = "".join(f"<!-- report: {name} - -->\n<!-- end -->\n" for name in names)
    (tmp_path / "README.md").write_text(f"Before.\n{marks}")
    main(["report"])
    main(["report", "--check"])
    text = (tmp_path / "README.md").read_text()
    assert "| `ppo_continuous.py` |" in text
    assert text.startswith("Before.\n")
    assert (docs / "ablation.png").exists()
    before = {x: x.stat().st_mtime_ns for x in tmp_path.rglob("*")}
    main(["report"])
    assert {x: x.stat().st_mtime_ns for x in tmp_path.rglob("*")} == before
    (tmp_path / "README.md").write_text(text.replace(" ± ", " + "))
    (docs / "ablation.png").unlink()
    assert reports.stale(STUDIES) == ["README.md: table returns.usual", "docs/ablation.png"]
    with pytest.raises(SystemExit, match="ablation.png"):
        main(["report", "--check"])
    rows = (docs / "data/scaling.csv").read_text()
    (docs / "data/scaling.csv").write_text(rows.replace("LunarLander", "Lander"))
    assert "docs/scaling.png" in reports.stale(STUDIES)
    main(["report"])
    main(["report", "--check"])


def test_what_is_in_docs_is_up_to_date():
    assert reports.stale(SHOWN) == []


def test_every_row_in_docs_is_of_the_text_of_its_script_that_is_here():
    for name, _, path, _ in reports.studies(STUDIES):
        data, _ = common.read_rows(path)
        assert common.is_current(data).all(), name


def test_a_curve_has_each_evaluation_where_it_was_made():
    data = pd.DataFrame({"env_id": "World", "seed": 1, "env_step": [0, 51, 99, 151, 200],
                         "return_mean": [1.0, 2, 3, 4, 5]})
    curve = common.in_bins(data, "return_mean", "env_id", count=4)
    assert curve["env_step"].tolist() == [0, 50, 100, 150, 200]
    assert curve["return_mean"].tolist() == [1, 2, 3, 4, 5]


def test_the_interval_of_a_difference_is_that_of_student_and_welch():
    pytest.importorskip("scipy")
    a, b = [1.0, 2, 3, 4, 5], [2.0, 3, 4, 5, 6]
    gap, margin = common.difference(a, b)
    assert gap == pytest.approx(-1)
    # equal variances of 2.5, so 8 degrees of freedom, of which the table says 2.306
    assert margin == pytest.approx(2.306 * math.sqrt(2.5 / 5 + 2.5 / 5), rel=1e-3)


def test_the_interval_of_a_gain_is_that_of_the_pairs():
    pytest.importorskip("scipy")
    gap, margin = common.gain([1.0, 2, 3, 4, 5], [0.0, 0, 0, 0, 0])
    assert gap == pytest.approx(3)
    assert margin == pytest.approx(2.776 * math.sqrt(2.5 / 5), rel=1e-3)  # 4 degrees of freedom


def test_holm_compares_the_smallest_p_with_the_smallest_limit():
    # limits of 0.05/4, 0.05/3, 0.05/2, 0.05: the third smallest fails, so the largest does, too
    assert ablation.passes_holm([0.04, 0.016, 0.03, 0.01]).tolist() == [False, True, False, True]


def test_the_race_says_when_ours_has_what_the_peer_has_in_the_end():
    """In ten minutes ours earns 10 a minute, the peer 1 in the first eight; seed 2 half of it."""
    data = pd.DataFrame([
        {"env_id": "World", "part": part, "seed": seed, "env_step": minute, "minutes": minute,
         "return_mean": (10 * minute if part == race.OURS else min(minute, 8)) / seed}
        for part in race.LEARNERS for seed in (1, 2) for minute in range(11)])
    ours, peer, _ = race.rows(data)
    # The goal is 6, the mean of 8 and 4. Our seeds have it after 1 and 2 minutes, their mean, with
    # 7.5, after 1; the peer's mean after 8 of its 10.
    assert peer[2:] == ["8, 4", "10.0", "8.00", "1.00", "1.00, 2.00", "8.0"]
    assert ours[2:] == ["100, 50", "10.0", "", "", "", ""]
    data.loc[data["part"] == race.OURS, "return_mean"] -= 100
    assert race.rows(data)[1][4:] == ["8.00", "never", "never, never", "–"]


def test_a_task_of_which_seeds_are_missing_is_left_out_of_the_table():
    data = pd.DataFrame({"part": returns.FRESH_MILLION, "seed": [41, 42, 41],
                         "env_id": ["Ant-v5", "Ant-v5", "Hopper-v5"]})
    assert returns.suite_of(data, returns.FRESH_MILLION)["env_id"].tolist() == ["Ant-v5"] * 2
    assert returns.suite_of(data, returns.MILLION).empty


def test_trials_show_every_seed_of_a_change_also_those_cut_off():
    data = pd.DataFrame({
        "script": [PPO, PPO, PPO, A2C], "env_id": "World-v0", "stage": [2, 1, 2, np.nan],
        "change": ["a", np.nan, "a", "b"], "seed": [301, 302, 303, 304],
        "total_steps": [500_000] * 4, "return_at_100": [7.0, 8.0, np.nan, 9.0]})
    tables = trials.report(data, draw=None)
    assert tables["ppo"].splitlines()[2:] == [
        "| 1 | – | World, 0.5M steps: 8 (302) |",
        "| 2 | a | World, 0.5M steps: 7 (301), cut off (303) |"]
    assert tables["a2c"].splitlines()[2:] == ["| b | World, 0.5M steps: 9 (304) |"]


# --- Merging --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ten_calls(tmp_path_factory):
    """What the guide's line for xargs leaves, with a tiny budget and all ten at once."""
    cwd = tmp_path_factory.mktemp("study")
    shutil.copy(harness.ROOT / "ppo_continuous.py", cwd)
    guide = (harness.ROOT / "docs/guide.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^seq .*xargs.*ppo_continuous\.py.*$", guide, re.MULTILINE)
    line = re.sub(r"-P *\d+", "-P 10", line)
    tiny = ("--env-id harness:ThreeSteps-v0 --num-envs 1 --rollout-steps 16 --total-steps 32 "
            "--num-evals 1 --eval-episodes 1")
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    subprocess.run(
        f"{line} {tiny}", shell=True, cwd=cwd, check=True, capture_output=True, timeout=170,
        env={**os.environ, "PATH": path, "PYTHONPATH": str(harness.TESTS), "OMP_NUM_THREADS": "1"})
    return sorted((cwd / "runs").iterdir())


def copy(folder, path, **changes):
    shutil.copytree(folder, path)
    config = {**harness.read_json(path / "args.json"), **changes}
    (path / "args.json").write_text(json.dumps(config))
    return path


@pytest.mark.skipif(shutil.which("xargs") is None, reason="has no xargs")
class TestMerging:
    def test_calls_in_the_same_moment_each_have_a_folder_and_make_one_table_and_figure(
            self, ten_calls, tmp_path, capsys):
        seeds = [harness.read_json(folder / "args.json")["seed"] for folder in ten_calls]
        assert sorted(seeds) == [[seed] for seed in range(1, 11)]
        main(["merge", *map(str, ten_calls), "--out-dir", str(tmp_path)])
        (row,) = [x for x in capsys.readouterr().out.splitlines() if "ThreeSteps" in x]
        assert "| 10 | 3.0 ± 0.0 |" in row
        assert (tmp_path / "merged.png").exists()
        assert sorted(set(pd.read_csv(tmp_path / "merged.csv")["seed"])) == list(range(1, 11))

    def test_what_cannot_count_is_named_and_left_out(self, ten_calls, tmp_path, capsys):
        cut, empty = copy(ten_calls[0], tmp_path / "cut"), copy(ten_calls[2], tmp_path / "empty")
        (evals,) = cut.glob("*/evals.csv")
        pd.read_csv(evals).iloc[:1].to_csv(evals, index=False)  # killed after its first evaluation
        (seed,) = empty.glob("seed-*")
        shutil.rmtree(seed)
        data = merge.collect([ten_calls[1], ten_calls[1], cut, empty, tmp_path])
        assert data["seed"].nunique() == 1
        out = capsys.readouterr().out
        for words in "was cut off", "saved nothing", f"is in {ten_calls[1]}, too", "no run folder":
            assert words in out

    def test_of_runs_that_agree_in_all_the_last_counts(self, ten_calls, tmp_path):
        newer = copy(ten_calls[0], tmp_path / "newer")
        (evals,) = newer.glob("*/evals.csv")
        pd.read_csv(evals).assign(return_mean=7.0).to_csv(evals, index=False)
        data = merge.collect([ten_calls[0], newer])
        assert set(data["return_mean"]) == {7.0}

    def test_other_flags_lengths_and_changed_copies_get_rows_of_their_own(
            self, ten_calls, tmp_path, capsys):
        folders = [copy(ten_calls[0], tmp_path / "usual"),
                   copy(ten_calls[0], tmp_path / "no discount", gamma=0.5),
                   copy(ten_calls[0], tmp_path / "shorter", total_steps=16),
                   copy(ten_calls[0], tmp_path / "mine", command=["my_ppo.py"]),
                   copy(ten_calls[0], tmp_path / "mine, too", command=["my_ppo.py"], gamma=0.5)]
        merge.merge(folders, tmp_path / "out")
        rows = [x for x in capsys.readouterr().out.splitlines() if "ThreeSteps" in x]
        assert len(rows) == 5
        for row in rows[1], rows[4]:
            assert "--gamma 0.5" in row
        for row in rows[3:]:
            assert row.startswith("| my_ppo |")
