"""experiments/: changes, blanks, statistics, merged runs, an agent trained in two processes."""

import importlib
import re
import shlex
import shutil
import subprocess
import sys

import merge
import pandas as pd
import pytest
import study
import variants
from conftest import SCRIPTS
from harness import ROOT, read_log, run

SHEET = (ROOT / "docs/exercises.md").read_text(encoding="utf-8")
TESTS = {number: tests for tests, number in
         re.findall(r"^python (-m pytest .*?) +# (\d)", SHEET, re.MULTILINE)}
BLANKS = [(line.split(), TESTS[number]) for line, number in
          re.findall(r"^python (\S+variants.py blank.*?) +# (\d)", SHEET, re.MULTILINE)]


@pytest.mark.parametrize("name", [x for x in variants.CHANGES if "blank" not in x])
def test_every_change_applies_and_trains(name, tmp_path):
    changed, _ = study.load(study.Job(variants.CHANGES[name][0], change=name))
    world = "Forever" if name == "time-limits-as-deaths" else "Uneven"
    options = "--env-id", f"harness:{world}-v0", "--total-steps", 256
    usual = SCRIPTS["ppo_continuous"]
    logs = [read_log(script.train(tmp_path, *options))
            for script in (usual, usual._replace(module=changed))]
    assert not logs[0].equals(logs[1])


@pytest.mark.parametrize(("blank", "tests"), BLANKS)
def test_a_blank_makes_the_tests_of_its_exercise_red(blank, tests, tmp_path):
    """In a copy of the project; without the blank they are green, as this suite shows."""
    for path in [*ROOT.glob("*.py"), ROOT / ".pytest.ini"]:
        shutil.copy(path, tmp_path)
    for folder in "tests", "experiments":
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("*.csv"))
    subprocess.run([sys.executable, *blank], check=True, cwd=tmp_path)
    out = subprocess.run([sys.executable, *shlex.split(tests)], cwd=tmp_path, text=True,
                         capture_output=True).stdout
    assert re.search(r"\d failed", out)
    assert "error" not in out.splitlines()[-1]


def test_holm_stops_at_the_first_p_that_is_too_large():
    """In order: 0.005 < 0.05/4, 0.01 < 0.05/3, 0.03 > 0.05/2, so 0.04 < 0.05/1 is too late."""
    assert study.holm(pd.Series([0.01, 0.04, 0.03, 0.005])).tolist() == [True, False, False, True]


@pytest.mark.parametrize("name", [x for x in study.STUDIES if x != "peers"])
def test_a_job_of_each_study_is_measured(name, monkeypatch):
    """A short run, in which REINFORCE's variance is that of two batches."""
    module = importlib.import_module(name)
    job = module.JOBS[0]
    short = job._replace(options=f"{job.options} --total-steps 256 --num-evals 1".strip())
    monkeypatch.setattr(module, "BATCHES", 2, raising=False)
    monkeypatch.setattr(module, "NOISE", short.options, raising=False)
    row = module.measure(short)
    assert row["steps"] >= 256
    assert row["curve"].endswith(f"{row['return']:.6g}")


def test_runs_are_merged_by_what_tells_them_apart(tmp_path, capsys):
    """Two seeds of 512 steps, two of 256, of which one ran twice, with other steps."""
    folders, runs = [], [(4, 512, 12), (4, 256, 99), (3, 512, 10), (3, 256, 2), (4, 256, 6)]
    for seed, steps, final in runs:
        folders.append(tmp_path / f"Pendulum__ppo_continuous__{len(folders)}")
        path = SCRIPTS["ppo_continuous"].train(folders[-1], "--total-steps", steps, seed=seed)
        log = pd.read_csv(f"{path}.csv")
        log["env_step"] += int(final == 99)  # the run that another replaces
        log.loc[log.index[-1], "eval_return"] = final
        log.to_csv(f"{path}.csv", index=False)
    merge.main(folders)
    out = capsys.readouterr().out
    assert all(merge.read(folders)["env_step"] % 2 == 0)
    assert re.search(r"^total_steps 256 +2 +4\.0 ", out, re.MULTILINE)
    assert "total_steps 256 − total_steps 512: -7, 95%: -20.837 to" in out  # df 25/17
    assert (tmp_path / "merged.png").exists()


@pytest.mark.slow
def test_together_two_processes_train_one_agent(tmp_path):
    """Steps, episodes and files are those of one process; only the noise is another."""
    script, torchrun = SCRIPTS["ppo_continuous"], "-m torch.distributed.run --standalone"
    options = f"--env-id harness:Forever-v0 --seed 1 {script.small}".split()
    run("experiments/together.py", *options, cwd=tmp_path,
        python=[*torchrun.split(), "--nproc-per-node", "2"])
    (folder,) = (tmp_path / "runs").iterdir()
    assert len(list(folder.iterdir())) == 3
    log = read_log(folder / "seed-1")
    alone = read_log(script.train(tmp_path, "--env-id", "harness:Forever-v0", seed=1))
    same = ["env_step", "return", "eval_return"]
    pd.testing.assert_frame_equal(log[same], alone[same])
    assert not log["value_loss"].equals(alone["value_loss"])
