"""--watch: prints the return, and makes a GIF where the environment can draw itself."""

import ctypes.util
import shutil
import sys
from pathlib import Path

import pandas as pd
import pytest
from harness import ROOT, run
from PIL import Image

needs_egl = pytest.mark.skipif(
    sys.platform != "linux" or not ctypes.util.find_library("EGL"), reason="no EGL here")


def printed(process):
    return {name: float(x) for name, x in map(str.split, process.out.splitlines())}


@needs_egl
@pytest.mark.slow
def test_a_copy_of_a_script_watches_a_copied_checkpoint(script, folder, tmp_path):
    """There is no display, and nothing but the GIF is written."""
    shutil.copy(ROOT / script.file, tmp_path / "mine.py")
    checkpoint = Path(shutil.copy(folder / "seed-3/checkpoint.pt", tmp_path))
    before = checkpoint.read_bytes()
    process = run(tmp_path / "mine.py", "--watch", "checkpoint.pt", cwd=tmp_path)
    last = pd.read_csv(folder / "seed-3/evals.csv").iloc[-1]  # the same starts, so the same return
    assert printed(process) == last[["return_mean", "return_std", "length_mean"]].round(1).to_dict()
    assert checkpoint.read_bytes() == before
    files = {"mine.py", "checkpoint.pt", "checkpoint.gif"}
    assert {path.name for path in tmp_path.iterdir()} - {"__pycache__"} == files
    with Image.open(tmp_path / "checkpoint.gif") as gif:
        assert 1 < gif.n_frames <= 200
        assert gif.n_frames * gif.info["duration"] <= 10_000
        assert gif.info["loop"] == 0  # for ever
        assert min(gif.size) >= 400


def test_an_environment_that_cannot_draw_itself_still_gets_its_return(script, tmp_path):
    folder = script.train(tmp_path, env_id=script.world("ThreeSteps"))
    process = run(script.file, "--watch", folder / "checkpoint.pt", cwd=tmp_path)
    assert printed(process) == {"return_mean": 3, "return_std": 0, "length_mean": 3}
    assert not list(tmp_path.rglob("*.gif"))
