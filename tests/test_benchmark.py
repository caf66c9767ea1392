"""The tools of tests/benchmark: changes that apply and run, and the table of many runs."""

from importlib.util import module_from_spec, spec_from_file_location

import pandas as pd
import pytest
from benchmark import merge, variants
from conftest import SCRIPTS
from harness import train


@pytest.mark.parametrize("name", variants.CHANGES)
def test_every_change_applies_and_trains(name, tmp_path, monkeypatch):
    file, text = variants.change(name)
    (tmp_path / file).write_text(text, encoding="utf-8")
    spec = spec_from_file_location(f"changed_{name}", tmp_path / file)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    world = "Forever" if name == "time-limits-as-deaths" else "Uneven"
    log, usual = (train(monkeypatch, x, "--env-id", f"harness:{world}-v0", "--num-envs", 2,
                        "--rollout-steps", 32, "--minibatch-size", 32, "--total-steps", 128)
                  for x in (module, SCRIPTS["ppo_continuous"].module))
    assert not log.drop(columns="seconds").equals(usual.drop(columns="seconds"))


def test_a_change_whose_text_is_gone_is_refused(monkeypatch):
    monkeypatch.setitem(variants.CHANGES, "gone", ("ppo_continuous.py", [("no such text", "")]))
    with pytest.raises(ValueError, match="gone: occurs 0 times"):
        variants.change("gone")


def test_runs_are_merged_by_what_tells_them_apart(tmp_path, capsys):
    """Two seeds of 512 steps, one of 256; one that was cut off is left out."""
    script, folders = SCRIPTS["ppo_continuous"], []
    for name, seed, options in (("a", 3, ()), ("b", 4, ()), ("c", 3, ("--total-steps", 256))):
        folders.append(tmp_path / f"Pendulum__ppo_continuous__{name}")
        script.train(folders[-1], *options, seed=seed)
    cut = script.train(tmp_path / "Pendulum__ppo_continuous__d")
    pd.read_csv(f"{cut}.csv").head(2).to_csv(f"{cut}.csv", index=False)
    merge.main([*folders, cut.parent])
    out = capsys.readouterr().out
    rows = {line.split()[1]: line.split()[2] for line in out.splitlines() if "total_steps " in line}
    assert rows == {"256": "1", "512": "2"}
    assert f"has not ended: {cut}.csv" in out
    assert (tmp_path / "merged.png").exists()
