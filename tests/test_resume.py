"""--resume: goes on in a new folder, where the first run ended."""

import shutil

import pandas as pd
import pytest
import torch
from conftest import only
from harness import read_json, results, run, run_folder, table

pytestmark = only("a2c_vector", "ppo_continuous")


def load(folder):
    return torch.load(folder / "checkpoint.pt", weights_only=True)


def contents(folder):
    return {str(x.relative_to(folder)): x.read_bytes() for x in folder.rglob("*") if x.is_file()}


def steps(folder, name):
    return pd.read_csv(folder / f"{name}.csv")["env_step"].tolist()


def test_a_copied_checkpoint_goes_on_in_a_new_folder_and_nothing_else_changes(
        script, folder, tmp_path):
    """Other runs that lie beside or below the copy are neither drawn nor reported."""
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy / "seed-9")
    shutil.copy(folder / "seed-3/checkpoint.pt", copy)
    before = contents(copy)
    options = "--total-steps", 1024, "--learning-rate", 8e-5
    process = run(script.file, "--resume", copy / "checkpoint.pt", *options, cwd=tmp_path)
    assert contents(copy) == before
    new = run_folder(tmp_path)
    assert set(contents(new)) == {"args.json", "learning_curve.png"} | {
        f"seed-3/{name}" for name in ("checkpoint.pt", "episodes.csv", "metrics.csv", "evals.csv")}
    args = read_json(new / "args.json")
    assert (args["total_steps"], args["learning_rate"], args["seed"]) == (1024, 8e-5, [3])
    assert args["resume"] == str(copy / "checkpoint.pt")
    assert results(process)["env_step"].to_dict() == {"seed-3": 1024}

    seed = new / "seed-3"
    assert steps(seed, "metrics") == [128 * (i + 1) for i in range(8)]
    assert steps(seed, "evals") == [0, 128, 256, 384, 512, 640, 768, 896, 1024]
    for name in "episodes", "metrics", "evals":
        old = table(folder / f"seed-3/{name}.csv")
        pd.testing.assert_frame_equal(table(seed / f"{name}.csv").head(len(old)), old)
    assert pd.read_csv(seed / "evals.csv")["seconds"].is_monotonic_increasing
    assert load(seed)["optimizer"]["param_groups"][0]["lr"] == pytest.approx(1e-5)
    count = load(seed)["agent"]["obs_stats.count"]
    assert count == 1024


def test_a_finished_run_that_is_resumed_is_the_same_in_a_new_folder(script, folder, tmp_path):
    run(script.file, "--resume", folder / "seed-3/checkpoint.pt", cwd=tmp_path)
    new = run_folder(tmp_path) / "seed-3"
    for name in "episodes", "metrics", "evals":
        old, again = (table(x / f"{name}.csv") for x in (folder / "seed-3", new))
        pd.testing.assert_frame_equal(old, again)
    states = ([load(x)["agent"], load(x)["optimizer"]["state"]] for x in (folder / "seed-3", new))
    torch.testing.assert_close(*states, rtol=0, atol=0)


def test_a_checkpoint_of_a_gpu_is_resumed_on_the_cpu(script, folder, tmp_path):
    checkpoint = load(folder / "seed-3")
    checkpoint["args"]["device"] = "cuda"
    torch.save(checkpoint, tmp_path / "checkpoint.pt")
    args = script.module.parse_args(["--resume", str(tmp_path / "checkpoint.pt")])
    assert args.device == "cpu"


def test_the_noise_of_the_first_part_does_not_come_again(script, folder, tmp_path, monkeypatch):
    """Also with another seed. Each part begins with another number of the generator."""
    resume, noise = ("--resume", folder / "seed-3/checkpoint.pt"), []

    def look(args, seed, envs, agent, optimizer, env_step):
        noise.append(torch.rand(1).item())
        yield env_step, [], []

    monkeypatch.setattr(script.module, "train", look)
    script.train(tmp_path / "first")
    for seed in 3, 4:
        script.train(tmp_path / "resumed", *resume, seed=seed)
    assert len(set(noise)) == len(noise) == 3
