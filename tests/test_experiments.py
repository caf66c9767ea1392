"""experiments/: changes, rows, statistics, tables, merged runs."""

import importlib
import re
import shlex
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import ablation
import gymnasium as gym
import merge
import numpy as np
import pandas as pd
import pytest
import report
import study
import torch
import trials
import variants
from conftest import SCRIPTS
from harness import ROOT, train
from scipy import stats

SHEET = (ROOT / "docs/exercises.md").read_text(encoding="utf-8")
BLANKS = re.findall(r"`python (\S+variants.py) (\S+) (\S+)`.*`python (-m pytest .*)`", SHEET)


@pytest.mark.parametrize("name", [x for x in variants.CHANGES if "blank" not in x])
def test_every_change_applies_and_trains(name, monkeypatch):
    world = "Forever" if name == "time-limits-as-deaths" else "Uneven"
    limit = 1e-6 if name == "critic-goes-on" else 0.03
    changed, _ = study.load(study.Job(variants.CHANGES[name][0], change=name))
    log, usual = (train(monkeypatch, module, "--env-id", f"harness:{world}-v0", "--num-envs", 2,
                        "--rollout-steps", 32, "--minibatch-size", 32, "--total-steps", 128,
                        "--max-kl", limit)
                  for module in (changed, SCRIPTS["ppo_continuous"].module))
    assert not log.drop(columns="seconds").equals(usual.drop(columns="seconds"))


def test_the_critic_goes_on_alone():
    """Below any KL the actor never learns; without a gradient Adam leaves it alone."""
    module, args = study.load(study.Job("ppo_continuous.py", change="critic-goes-on"))
    space = module.gym.spaces.Box(-1, 1, (2,))
    agent = module.Agent(space, space, args.hidden_size)
    before = {name: x.clone() for name, x in agent.named_parameters()}
    obs, actions, means = torch.randn(3, 16, 2)
    log_probs, advantages, targets = torch.randn(3, 16)
    module.optimise(agent, torch.optim.Adam(agent.parameters(), 0.1),
                    (obs, actions, means, log_probs, advantages, targets), epochs=2,
                    minibatch_size=8, clip_eps=0.2, max_kl=-1.0)
    for name, x in agent.named_parameters():
        assert torch.equal(x, before[name]) == (x.grad is None) == name.startswith("actor"), name


@pytest.mark.parametrize(("tool", "name", "file", "tests"), BLANKS)
def test_a_blank_makes_the_tests_of_its_exercise_red(tool, name, file, tests, tmp_path):
    """In a copy of the project; without the blank they are green, as this suite shows."""
    for path in [*ROOT.glob("*.py"), ROOT / ".pytest.ini"]:
        shutil.copy(path, tmp_path)
    for folder in "tests", "experiments":
        shutil.copytree(ROOT / folder, tmp_path / folder)
    subprocess.run([sys.executable, tool, name, file], check=True, cwd=tmp_path)
    out = subprocess.run([sys.executable, *shlex.split(tests)], cwd=tmp_path, text=True,
                         capture_output=True).stdout
    assert re.search(r"\d failed", out)
    assert "error" not in out.splitlines()[-1]


def test_every_blank_is_an_exercise():
    assert {x[1] for x in BLANKS} == {x for x in variants.CHANGES if "blank" in x}


def test_a_change_whose_text_is_gone_is_refused(monkeypatch):
    monkeypatch.setitem(variants.CHANGES, "gone", ("ppo_continuous.py", [("no such text", "")]))
    with pytest.raises(ValueError, match="gone: occurs 0 times"):
        variants.changed("ppo_continuous.py", "gone")


@pytest.mark.parametrize("arguments", [["no-tanh"], ["no-such", "x.py"], ["no-tanh", "x.py", "y"]])
def test_variants_that_are_called_in_a_wrong_way_say_how(arguments):
    with pytest.raises(SystemExit, match="usage: .*NAME FILE"):
        variants.main(arguments)


@pytest.mark.parametrize("file", ["ppo_continuous.py", "a2c_vector.py"])
def test_a_change_replaces_no_script(file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=f"not written: {file}"):
        variants.main(["no-tanh", file])
    assert not list(tmp_path.iterdir())


def run_study(monkeypatch, jobs, measure, *arguments):
    monkeypatch.setattr(study, "ProcessPoolExecutor", lambda *_: ThreadPoolExecutor(1))
    monkeypatch.setattr(sys, "argv", ["study.py", *arguments])
    monkeypatch.setattr(sys.modules["__main__"], "__file__", "small.py")
    study.main(jobs, lambda rows: {}, measure)


def test_a_study_measures_only_what_has_no_rows(tmp_path, monkeypatch):
    """Of three jobs one is known, one is not asked for; the rows say where they come from."""
    measured = []
    monkeypatch.setattr(study, "DATA", tmp_path)
    monkeypatch.setattr(study, "git", lambda verb, *_: "" if verb == "status" else "1234567\n")
    jobs = [study.Job("ppo_continuous.py", f"--epochs {seed}", seed=seed) for seed in (1, 2, 3)]
    for known, arguments in (jobs[:1], ()), (jobs, ("--only", "epochs 2")):
        run_study(monkeypatch, known, lambda job: measured.append(job) or [{"x": job.seed}],
                  *arguments)
    assert measured == jobs[:2]
    rows = study.read("small")
    assert rows["x"].to_list() == [1, 2]
    assert set(rows["commit"]) == {"1234567"}
    assert rows[["processor", "torch", "gymnasium", "mujoco"]].notna().all(axis=None)


def test_a_row_is_an_evaluation_with_the_mean_return_in_training_since_the_last(monkeypatch):
    log = pd.DataFrame({"env_step": [1, 2, 3, 4, 5], "seconds": 1.0, "return": [1, 2, 3, 4, 5],
                        "eval_return": [10, np.nan, 30, np.nan, 50]})
    monkeypatch.setattr(study, "run", lambda *_: (log, "weights"))
    rows, _ = study.train(study.Job("ppo_continuous.py"))
    assert rows[["steps", "return", "sampled"]].to_numpy().tolist() == [
        [1, 10, 1], [3, 30, 2.5], [5, 50, 4.5]]
    assert study.last_evaluation(study.Job("ppo_continuous.py"))["return"].tolist() == [50]


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """With one commit of the file x.py; study.ROOT."""
    monkeypatch.setattr(study, "ROOT", tmp_path)
    (tmp_path / "x.py").write_text("")
    study.git("init")
    study.git("add", "x.py")
    study.git("-c", "user.name=x", "-c", "user.email=x", "commit", "-m", "x")
    return tmp_path


def test_what_is_not_committed_is_not_measured(repository):
    assert len(study.commit_of("x.py")) >= 7
    (repository / "x.py").write_text("changed")
    with pytest.raises(SystemExit, match=r"^not measured, .*: x\.py$"):
        study.commit_of("x.py")


def test_rows_of_an_older_commit_are_named(repository, capsys):
    today = study.commit_of("x.py")
    keys = {"script": "x.py", "options": "", "change": "", "seed": [1, 1, 2, 3]}
    study.name_older_commits(pd.DataFrame(keys | {"commit": ["old", "old", "old", today]}))
    line = f"2 jobs were measured with x.py of commit old, not {today}\n"
    assert capsys.readouterr().out == line


def test_a_difference_is_welchs():
    """x: mean 2, variance 1, n 3; y: 5, 20/3, 4. So the standard error is √(1/3 + 5/3) = √2."""
    freedom = 2**2 / ((1 / 3) ** 2 / 2 + (5 / 3) ** 2 / 3)
    gain, margin, p = study.welch([1, 2, 3], [2, 4, 6, 8])
    assert gain == pytest.approx(-3)
    assert margin == pytest.approx(stats.t.ppf(0.975, freedom) * 2**0.5)
    assert p == pytest.approx(2 * stats.t.cdf(-3 / 2**0.5, freedom))
    assert study.spread([2, 4, 6, 8], 2) == "5.00 ± 2.58"


def test_holms_correction():
    """In order: 0.005 < 0.05/4, 0.01 < 0.05/3, but 0.03 > 0.05/2, so 0.04 < 0.05/1 is too late."""
    assert ablation.holm([0.01, 0.04, 0.03, 0.005]).tolist() == [True, False, False, True]


@pytest.fixture(scope="module")
def tables():
    """Of the data; no figure is written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "save", lambda *_: None)
        return report.tables()


def test_all_tables_of_the_pages_are_those_of_the_data(tables):
    text = "".join(page.read_text("utf-8") for page in study.pages())
    shown = re.findall(r"<!-- (.+) -->\n\n((?:\|.*\n)+)", text)
    assert {name for name, _ in shown} == set(tables)
    for name, table in shown:
        assert table == tables[name], name


@pytest.mark.parametrize("name", report.STUDIES)
def test_every_row_is_of_a_job_of_its_study(name):
    rows = study.read(name)
    jobs = importlib.import_module(name).JOBS
    assert len(set(jobs)) == len(jobs)
    assert set(rows[study.KEYS].itertuples(index=False, name=None)) <= set(jobs)


def test_of_every_file_of_data_is_said_who_wrote_it():
    named = re.findall(r"^\| `(\S+\.csv)` \| ", (study.DATA / "README.md").read_text("utf-8"), re.M)
    assert {path.name for path in study.DATA.glob("*.csv")} <= set(named)


@pytest.mark.parametrize(("factors", "lost", "taken"), [
    ([1.3, 1, 1, 1, 1], 10, "yes"), ([1.3, 1.3, 1, 1, 0.9], 10, "no"),
    ([1.2, 1, 1, 1, 1], 10, "no"), ([1, 1, 1, 1, 1], 5, "yes"), ([1, 1, 1, 1, 1], 6, "no"),
    ([0.9, 0.9, 1, 1, 1], 0, "no"), ([1.3], 10, "yes"), ([], 0, "no")])
def test_the_rule_of_trials(factors, lost, taken):
    """Two seeds of the default, which earn 100 and 300 and lose 10; of the candidate three."""
    rows = []
    for seed in 1, 2, 3:
        for typed, tried in (("", [1] * 5), (" --gae-lambda 0.92", factors))[seed == 3 :]:
            rows += [(options + typed, seed, x * 100 * (2 * seed - 1), 0)
                     for options, x in zip(trials.TASKS, tried)]
            fallen = [lost, 0, 7][seed - 1] if typed else 5
            rows.append((trials.PENDULUM + typed, seed, 9000, fallen))
    rows = pd.DataFrame(rows, columns=["options", "seed", "return", "lost"]).assign(change="")
    other = rows.assign(change="critic-goes-on", **{"return": 1, "lost": 100})
    rows = pd.concat([rows, other])
    line = trials.draw(rows)["trials"].splitlines()[-1].split("|")[1:-1]
    name, *ratios, mean, _, _, usual, answer = (x.strip() for x in line)
    assert name == "`--gae-lambda 0.92`"
    assert ratios == [f"{x:.2f} (2)" for x in factors] + [""] * (5 - len(factors))
    assert usual == "10"
    assert mean == (f"{np.exp(np.log(factors).mean()):.2f}" if factors else "nan")
    assert answer == taken


def test_runs_are_merged_by_what_tells_them_apart(tmp_path, capsys):
    """Two seeds of 512 steps, one of 256, twice; one that was cut off is left out."""
    script, folders = SCRIPTS["ppo_continuous"], []
    shorter = "--total-steps", 256
    for name, seed, options in ("a", 3, ()), ("b", 4, ()), ("c", 3, shorter), ("d", 3, shorter):
        folders.append(tmp_path / f"Pendulum__ppo_continuous__{name}")
        script.train(folders[-1], *options, seed=seed)
    cut = script.train(tmp_path / "Pendulum__ppo_continuous__e")
    pd.read_csv(f"{cut}.csv").head(2).to_csv(f"{cut}.csv", index=False)
    merge.main([*folders, cut.parent])
    out = capsys.readouterr().out
    for setting in "256 +1", "512 +2":
        assert re.search(f"^total_steps {setting} ", out, re.MULTILINE)
    assert f"has not ended: {cut}.csv" in out
    assert (tmp_path / "merged.png").exists()


def test_a_pendulum_is_lost_if_its_first_episode_ends_before_the_time_limit():
    """Episodes of 3 steps: the limit is met in each, missed by one, or far."""
    for limit, lost in (2, 0), (3, 0), (4, 2):
        envs = gym.make_vec("harness:ThreeSteps-v0", 2, "sync", max_episode_steps=limit)
        counting = trials.CountLost(envs)
        counting.reset(seed=1)
        for _ in range(9):
            counting.step(envs.action_space.sample())
        assert counting.lost == lost


def test_folders_without_a_run_get_the_usage(tmp_path):
    for folders in [], [tmp_path / "no-such"]:
        with pytest.raises(SystemExit, match="usage: .*FOLDER"):
            merge.main(folders)
