"""The films and learning curves of the README, from runs with the seeds 1 to 5. Ten minutes."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from study import A2C, PPO, REINFORCE, ROOT


def film(script, name, options=""):
    with tempfile.TemporaryDirectory() as home:
        command, seeds = [sys.executable, str(ROOT / script)], "--seed 1 2 3 4 5 --out-dir"
        subprocess.run([*command, *options.split(), *seeds.split(), home], check=True)
        (folder,) = Path(home).iterdir()
        subprocess.run([*command, "--watch", str(folder / "seed-1.pt")], check=True)
        shutil.copy(folder / "seed-1.gif", ROOT / f"docs/{name}.gif")
        shutil.copy(folder / "learning_curve.png", ROOT / f"docs/{name}.png")


if __name__ == "__main__":
    for script in REINFORCE, A2C, PPO:
        film(script, Path(script).stem)
    film(PPO, "cheetah", "--env-id HalfCheetah-v5 --total-steps 1e6")
