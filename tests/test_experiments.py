"""experiments/: changes, rows, statistics, tables, peers, merged runs."""

import contextlib
import importlib
import re
import shlex
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import claims
import compare
import merge
import numpy as np
import pages
import pandas as pd
import peers
import published
import pytest
import race
import report
import returns
import study
import variants
from conftest import SCRIPTS
from harness import ROOT, train
from scipy import stats

SHEET = (ROOT / "docs/exercises.md").read_text(encoding="utf-8")
BLANKS = list(zip(re.findall(r"^python (\S+variants.py) (blank\S+) (\S+)", SHEET, re.MULTILINE),
                  re.findall(r"^python (-m pytest .*?) +# \d", SHEET, re.MULTILINE), strict=True))


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


@pytest.mark.parametrize(("blank", "tests"), BLANKS)
def test_a_blank_makes_the_tests_of_its_exercise_red(blank, tests, tmp_path):
    """In a copy of the project; without the blank they are green, as this suite shows."""
    for path in [*ROOT.glob("*.py"), ROOT / ".pytest.ini"]:
        shutil.copy(path, tmp_path)
    for folder in "tests", "experiments":
        shutil.copytree(ROOT / folder, tmp_path / folder)
    subprocess.run([sys.executable, *blank], check=True, cwd=tmp_path)
    out = subprocess.run([sys.executable, *shlex.split(tests)], cwd=tmp_path, text=True,
                         capture_output=True).stdout
    assert re.search(r"\d failed", out)
    assert "error" not in out.splitlines()[-1]


def test_every_blank_is_an_exercise():
    assert {blank[1] for blank, _ in BLANKS} == {x for x in variants.CHANGES if "blank" in x}


def test_a_change_whose_text_is_gone_is_refused(monkeypatch):
    monkeypatch.setitem(variants.CHANGES, "gone", ("ppo_continuous.py", [("no such text", "")]))
    with pytest.raises(ValueError, match="gone: occurs 0 times"):
        variants.changed("ppo_continuous.py", "gone")


@pytest.mark.parametrize("arguments", [["no-tanh", "ppo_continuous.py"], ["no-tanh"], ["no", "x"]])
def test_a_change_replaces_no_script_and_needs_a_name_and_a_file(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        variants.main(arguments)
    assert not list(tmp_path.iterdir())


def test_a_study_measures_only_what_has_no_rows(tmp_path, monkeypatch, capsys):
    """Not what is not asked for, and again what is old; the rows say where they come from."""
    measured = []
    monkeypatch.setattr(study, "DATA", tmp_path)
    monkeypatch.setattr(study, "git", lambda verb, *_: "" if verb == "status" else "1234567\n")
    monkeypatch.setattr(study, "ProcessPoolExecutor", lambda *_: ThreadPoolExecutor(1))
    monkeypatch.setattr(sys.modules["__main__"], "__file__", "small.py")
    jobs = [study.Job("ppo_continuous.py", f"--epochs {seed}", seed=seed) for seed in (1, 2, 3, 4)]

    def measure(job):
        measured.append(job)
        return [{"x": 10 * len(measured), "y": 1 / (job.seed - 4)}]

    for known, arguments in (jobs[:1], []), (jobs, ["--only", "epochs 2"]), (jobs[2:], []):
        monkeypatch.setattr(sys, "argv", ["small.py", *arguments])
        with contextlib.suppress(SystemExit):  # as some have no rows yet
            study.main(known, lambda rows: {}, measure)
    assert measured == jobs
    assert "ZeroDivisionError" in capsys.readouterr().out  # of the last; the others are kept
    with pytest.raises(SystemExit, match="not drawn, as 1 jobs have no rows yet"):
        study.main(jobs, lambda rows: {}, measure)
    measured.pop()
    rows = study.read("small").assign(commit=["1234567", "7654321", "1234567"])
    rows.to_csv(tmp_path / "small.csv", index=False)
    monkeypatch.setattr(sys, "argv", ["small.py", "--again"])
    study.main(jobs[:3], lambda rows: {}, measure)
    rows = study.read("small")
    assert rows["x"].to_list() == [10, 50, 30]
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


def test_rows_are_of_what_is_committed(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "ROOT", tmp_path)
    (tmp_path / "x.py").write_text("")
    study.git("init")
    study.git("add", "x.py")
    commit = "-c", "user.name=x", "-c", "user.email=x", "commit"
    study.git(*commit, "-m", "x")
    first = study.git("log", "-1", "--format=%h").strip()
    study.git(*commit, "--allow-empty", "-m", "another file")
    assert study.commit_of("x.py") == first
    (tmp_path / "x.py").write_text("changed")
    with pytest.raises(SystemExit, match=r"^not measured, .*: x\.py$"):
        study.commit_of("x.py")


def test_a_difference_is_welchs():
    """x: mean 2, variance 1, n 3; y: 5, 20/3, 4. So the standard error is √(1/3 + 5/3) = √2."""
    freedom = 2**2 / ((1 / 3) ** 2 / 2 + (5 / 3) ** 2 / 3)
    gain, margin, p = compare.welch([1, 2, 3], [2, 4, 6, 8])
    assert gain == pytest.approx(-3)
    assert margin == pytest.approx(stats.t.ppf(0.975, freedom) * 2**0.5)
    assert p == pytest.approx(2 * stats.t.cdf(-3 / 2**0.5, freedom))
    assert compare.spread([2, 4, 6, 8], 2) == "5.00 ± 2.58"


def test_holms_correction():
    """In order: 0.005 < 0.05/4, 0.01 < 0.05/3, but 0.03 > 0.05/2, so 0.04 < 0.05/1 is too late."""
    assert compare.marked([0.01, 0.04, np.nan, 0.03, 0.005]) == [
        "**0.01**", "0.04", "", "0.03", "**0.005**"]


def test_the_race_says_who_leads_after_holms_correction():
    """Of planted returns: bold, and in the title, is what differs; a mark in the right cell."""
    p_values = [0.01, 1e-4, 0.04, 0.06]
    pairs = [("HalfCheetah", "CleanRL", 5), ("HalfCheetah", "sb3, zoo", -5),
             ("Hopper", "CleanRL", 5), ("Walker2d", "CleanRL", 5)]
    lines = [(task, peer, pd.Series([7, 9]), pd.Series([7 - gain, 9 - gain]),
              compare.Difference(gain, 1, p)) for (task, peer, gain), p in zip(pairs, p_values)]
    holds = compare.holm(p_values)
    assert race.title_of(lines, holds) == "HalfCheetah: ours above CleanRL; " \
        "HalfCheetah: ours below sb3 zoo"
    table = race.returns_table(lines, holds, "left out").splitlines()[2:]
    cells = [line.split("|")[1:-1] for line in table]
    assert [[x.strip() for x in line] for line in cells] == [
        ["HalfCheetah", "8 ± 1 (2)", "**3 ± 1 (2)**", "not run", "**13 ± 1 (2)**", "not run"],
        ["Hopper", "8 ± 1 (2)", "3 ± 1 (2)", "not run", "left out", "not run"],
        ["Walker2d", "8 ± 1 (2)", "3 ± 1 (2)", "not run", "not run", "not run"],
        ["InvertedDoublePendulum", *(5 * ["not run"])]]


def test_at_a_threshold_is_a_run_whose_last_return_reaches_it():
    keys = {"script": "x", "options": "", "change": "", "seed": [1, 1, 2, 2]}
    rows = pd.DataFrame(keys | {"return": [9000, 4800, 4800, 4799]})
    assert returns.at_threshold("HalfCheetah-v5", rows) == "1 of 2 ≥ 4,800"
    assert returns.at_threshold("Humanoid-v5", rows) == "no threshold"


@pytest.mark.parametrize("claim", list(claims.claims()))
def test_what_the_pages_say_in_words_is_what_the_data_say(claim):
    text = " ".join((ROOT / page).read_text("utf-8") for page in ("README.md", "docs/results.md"))
    assert claim in " ".join(re.sub(r"\]\([^)]*\)|\[", "", text).split())  # without links


def test_a_point_of_the_race_is_the_mean_of_evaluations_within_50000_steps():
    rows = pd.DataFrame({"options": "--env-id Hopper-v5 --total-steps 1e6", "change": "zoo",
                         "seed": 1, "steps": [1, 40_000, 60_000, 960_000, 980_000, 1_001_472],
                         "return": [0, 1, 3, 5, 7, 9]})
    curve = race.curves_of("Hopper-v5", rows)["sb3, zoo"]
    assert curve[["steps", "return"]].to_numpy().tolist() == [[0.05, 2], [0.95, 5], [1, 8]]


def test_the_interval_of_a_median_is_of_the_median():
    """Of three values the median of a sample is either extreme in 7 of 27 cases."""
    assert compare.median([1, 2, 9]) == "2 (1 to 9)"


@pytest.fixture(scope="module")
def tables():
    """Of the data; no figure is written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "save", lambda *_: None)
        return report.tables()


def test_all_tables_of_the_pages_are_those_of_the_data(tables):
    text = "".join(page.read_text("utf-8") for page in pages.files())
    shown = re.findall(r"<!-- (.+) -->\n\n((?:\|.*\n)+)", text)
    of_answers = {"run", "find", "value"}
    answers = of_answers if (ROOT / "docs/answers.md").read_text("utf-8") else set()
    assert {name for name, _ in shown} == set(tables) - of_answers | answers
    for name, table in shown:
        assert table == tables[name], name
        assert not re.search(r"\bnan\b", table), name


@pytest.mark.parametrize("name", [x for x in report.STUDIES if x != "published"])
def test_every_row_is_of_a_job_of_its_study(name):
    jobs = importlib.import_module(name).JOBS
    assert len(set(jobs)) == len(jobs)
    assert set(study.read(name)[study.KEYS].itertuples(index=False, name=None)) <= set(jobs)


@pytest.mark.parametrize("name", ["baselines", "exercises", "processes", "returns", "robustness"])
def test_a_study_measures_what_its_rows_hold(name, monkeypatch):
    module = importlib.import_module(name)
    for constant, few in ("GRAVITY", (-2.0, -10.0)), ("WIND", (0.0, 20.0)), ("BATCHES", 3):
        monkeypatch.setattr(module, constant, few, raising=False)
    rows = study.measured(module.measure, study.tiny(module.JOBS[0]), keep=False)
    assert set(rows) <= set(study.read(name))
    if name == "robustness":  # gravity and wind make a difference
        assert rows["return"].nunique() == 4


def test_of_every_file_of_data_is_said_who_wrote_it():
    named = re.findall(r"^\| `(\S+\.csv)` \| ", (study.DATA / "README.md").read_text("utf-8"), re.M)
    assert {path.name for path in study.DATA.glob("*.csv")} <= set(named)


CLEANRL = """
from dataclasses import dataclass
import gymnasium as gym, numpy as np, torch, tyro
from torch.utils.tensorboard import SummaryWriter
@dataclass
class Args:
    env_id: str; total_timesteps: int; seed: int; cuda: bool
class Agent:
    def actor_mean(self, obs):
        return torch.stack([obs[:, 1], 5 + obs[:, 1]], 1)
def make_env():
    env = gym.wrappers.NormalizeObservation(gym.make(args.env_id))
    return gym.wrappers.TransformObservation(env, lambda obs: np.clip(obs, -10, 10))
if __name__ == "__main__":
    args, writer = tyro.cli(Args), SummaryWriter("runs/x")
    agent, envs = Agent(), gym.vector.SyncVectorEnv([make_env])
    envs.reset(seed=args.seed)
    envs.envs[0].get_wrapper_attr("obs_rms").mean[1] = 1.0  # of steps, which are 0 at first
    envs.envs[0].get_wrapper_attr("obs_rms").var[1] = 4.0
    args.batch_size = 2
    for update in range(1, args.total_timesteps // 2 + 1):
        print("update", update)
        for step in 2 * update - 1, 2 * update:
            writer.add_scalar("charts/episodic_return", step, step)
        writer.add_scalar("charts/SPS", 1000 + update, 2 * update)
"""


def test_cleanrls_own_file_is_run_and_what_it_logs_is_kept(tmp_path, monkeypatch, capsys):
    """A stand-in with forty updates of two steps, in each of which an episode ends.

    Its mean action is (x, 5 + x) if it sees x in place of the steps so far. In an evaluation these
    are 0, so x = (0 − 1)/√4 = −0.5, and the second number is clipped to 0.5.
    """
    monkeypatch.setattr(peers, "CLEANRL", str(tmp_path / "ppo.py"))
    (tmp_path / "ppo.py").write_text(CLEANRL)
    job = study.Job(peers.FILE, "--env-id harness:Target-v0 --total-steps 80", "CleanRL", seed=3)
    rows = peers.learn(job)
    assert rows["steps"].to_list() == list(range(4, 81, 4))
    assert rows["sampled"].to_list() == [x - 1.5 for x in rows["steps"]]  # of steps x − 3 to x
    assert rows["return"].to_numpy() == pytest.approx(-(2.5**2) - 0.4**2)
    assert rows["seconds"].iloc[-1] == 80 / 1040
    assert peers.cleanrl_speed(study.load(job._replace(script="ppo_continuous.py", change=""))[1]) \
        == 1040
    assert not capsys.readouterr().out
    (tmp_path / "ppo.py").write_text(CLEANRL.replace("10)", "9)"))
    with pytest.raises(ValueError, match="occurs 0 times"):
        peers.learn(job)


def test_cleanrl_is_compared_without_noise_and_in_training(monkeypatch):
    """Planted: ours have 1,000 more than theirs, which is the seed; with noise 1 less than that."""
    monkeypatch.setattr(pages, "save", lambda *_: None)
    measured = study.read("race")
    ours = pd.DataFrame(returns.CURVES).assign(lead=1000.0)
    jobs = pd.DataFrame([job for job in race.JOBS if job.change == "CleanRL"]).assign(lead=0.0)
    ours, theirs = (x.assign(steps=1_000_000, sampled=x["seed"] + x["lead"] - 1,
                             **{"return": x["seed"] + x["lead"]}) for x in (ours, jobs))
    read = study.read
    monkeypatch.setattr(study, "read", lambda name: ours if name == "returns" else read(name))
    tables = race.draw(pd.concat([measured[measured["change"] != "CleanRL"], theirs]))
    lines = {name: [[x.strip() for x in line.split("|")[1:-1]] for line in table.splitlines()[2:]]
             for name, table in tables.items()}
    assert [line[1:3] for line in lines["race"]] == 4 * [["1,106 ± 3 (10)", "**106 ± 3 (10)**"]]
    without = [line[2:4] for line in lines["differences"] if line[1] == "CleanRL (10)"]
    assert without == 4 * [["106 ± 3 (106)", "1,106 ± 3 (10)"]]
    assert [line[1:] for line in lines["in training"]] == 4 * [
        ["CleanRL (10)", "104 ± 3 (104)", "1,104 ± 3 (10)", "1,000 (997 to 1,003)", "**< 0.001**"]]


def test_a_trial_is_compared_with_the_default_on_seeds_that_both_have(monkeypatch):
    """Of the pendulum only falls count."""
    task = "--env-id {}-v5 --num-evals 1 --eval-episodes 50{}".format
    rows = [(task("Hopper", ""), 1, 100, 0), (task("Hopper", ""), 2, 300, 0),
            (task("Hopper", ""), 3, 900, 0), (task("Hopper", " --x 1"), 1, 100, 0),
            (task("Hopper", " --x 1"), 2, 500, 0), (task("Ant", ""), 1, 10, 0),
            (task("Ant", " --x 1"), 1, 6, 0), (task("InvertedDoublePendulum", ""), 1, 1, 5),
            (task("InvertedDoublePendulum", ""), 2, 1, 4),
            (task("InvertedDoublePendulum", " --x 1"), 1, 2, 3),
            (task("Ant", " --last-std 0.2"), 1, 5, 0),
            (task("Ant", " --last-std 0.2 --y"), 1, 4, 0)]
    rows = pd.DataFrame(rows, columns=["options", "seed", "return", "lost"])
    monkeypatch.setattr(study, "read", lambda _: rows.assign(script=variants.PPO, change=""))
    assert list(published.trial_lines()) == [
        ["`--last-std 0.2`", "as it was", "", "", "", "0.50", "", "", "", ""],
        ["`--last-std 0.2 --y`", "as it was", "", "", "", "0.40", "", "", "", ""],
        ["`--x 1`", "as it was", "", "1.50", "", "0.60", "", "", "3", "5"],
        ["`--last-std 0.2 --y`", "`--last-std 0.2`", "", "", "", "0.80", "", "", "", ""]]


def test_runs_are_merged_by_what_tells_them_apart(tmp_path, capsys):
    """Two seeds of 512 steps, two of 256, one of them twice; one that was cut off is left out."""
    script, folders = SCRIPTS["ppo_continuous"], []
    shorter = "--total-steps", 256
    for name, seed, options, final in [("a", 3, (), 10), ("b", 4, (), 12), ("c", 3, shorter, 1),
                                       ("d", 3, shorter, 3), ("f", 4, shorter, 5)]:
        folders.append(tmp_path / f"Pendulum__ppo_continuous__{name}")
        path = script.train(folders[-1], *options, seed=seed)
        log = pd.read_csv(f"{path}.csv")
        log.loc[log.index[-1], "eval_return"] = final
        log.to_csv(f"{path}.csv", index=False)
    cut = script.train(tmp_path / "Pendulum__ppo_continuous__e")
    pd.read_csv(f"{cut}.csv").head(2).to_csv(f"{cut}.csv", index=False)
    merge.main([*folders, cut.parent])
    out = capsys.readouterr().out
    for setting in "256 +2 +4.0", "512 +2 +11.0":  # the later of two runs of a seed counts
        assert re.search(f"^total_steps {setting} ", out, re.MULTILINE)
    assert "total_steps 256 − total_steps 512: -7, 95%: -" in out
    assert f"has not ended: {cut}.csv" in out
    assert (tmp_path / "merged.png").exists()
    with pytest.raises(SystemExit, match="usage: .*FOLDER"):
        merge.main([tmp_path / "no-such"])
