"""The tools of experiments: changes, rows, tables."""

import re
import shlex
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import ablation
import merge
import pandas as pd
import pytest
import report
import study
import variants
from conftest import SCRIPTS
from harness import ROOT, train

SHEET = (ROOT / "docs/exercises.md").read_text(encoding="utf-8")
BLANKS = re.findall(r"`python (\S+variants.py) (\S+) (\S+)`.*`python (-m pytest .*)`", SHEET)


@pytest.mark.parametrize("name", [x for x in variants.CHANGES if "blank" not in x])
def test_every_change_applies_and_trains(name, monkeypatch):
    world = "Forever" if name == "time-limits-as-deaths" else "Uneven"
    changed, _ = study.load(study.Job(variants.CHANGES[name][0], change=name))
    log, usual = (train(monkeypatch, module, "--env-id", f"harness:{world}-v0", "--num-envs", 2,
                        "--rollout-steps", 32, "--minibatch-size", 32, "--total-steps", 128)
                  for module in (changed, SCRIPTS["ppo_continuous"].module))
    assert not log.drop(columns="seconds").equals(usual.drop(columns="seconds"))


@pytest.mark.parametrize(("tool", "name", "file", "tests"), BLANKS)
def test_a_blank_makes_the_tests_of_its_exercise_red(tool, name, file, tests, tmp_path):
    """In a copy of the project; without the blank they are green, as this suite shows."""
    for path in [*ROOT.glob("*.py"), ROOT / ".pytest.ini"]:
        shutil.copy(path, tmp_path)
    shutil.copytree(ROOT / "tests", tmp_path / "tests")
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


def test_a_study_measures_only_what_has_no_rows(tmp_path, monkeypatch):
    """A job of two is known; the other is measured, and its rows say where they come from."""
    measured = []
    monkeypatch.setattr(study, "DATA", tmp_path)
    monkeypatch.setattr(study, "ProcessPoolExecutor", lambda *_: ThreadPoolExecutor(1))
    monkeypatch.setattr(sys, "argv", ["study.py"])
    monkeypatch.setattr(sys.modules["__main__"], "__file__", "small.py")
    jobs = [study.Job("ppo_continuous.py", "--epochs 1", seed=seed) for seed in (1, 2)]
    for known in jobs[:1], jobs:
        study.main(known, lambda rows: {}, lambda job: measured.append(job) or [{"x": job.seed}])
    assert measured == jobs
    rows = study.read("small")
    assert rows["x"].to_list() == [1, 2]
    assert rows["commit"].str.len().min() > 6
    assert rows["processor"].notna().all()


def test_holms_correction():
    """In order: 0.005 < 0.05/4, 0.01 < 0.05/3, but 0.03 > 0.05/2, so 0.04 < 0.05/1 is too late."""
    assert ablation.holm([0.01, 0.04, 0.03, 0.005]).tolist() == [True, False, False, True]


def test_all_tables_are_those_of_docs_data(monkeypatch):
    pytest.importorskip("scipy")
    monkeypatch.setattr(study, "save", lambda *_: None)
    text = "".join(page.read_text("utf-8") for page in study.pages())
    shown = re.findall(r"<!-- (.+) -->\n\n((?:\|.*\n)+)", text)
    assert shown
    tables = report.tables()
    for name, table in shown:
        assert table == tables[name]


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
