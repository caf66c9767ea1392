"""The films and learning curves of the README, from runs with the seeds 1 to 5. Ten minutes."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from study import A2C, PPO, REINFORCE, ROOT

FILMS = {  # in docs: script, options
    "reinforce_mujoco": (REINFORCE, ""),
    "a2c_vector": (A2C, ""),
    "ppo_continuous": (PPO, ""),
    "cheetah": (PPO, "--env-id HalfCheetah-v5 --total-steps 1e6"),
}


def main():
    for name, (script, options) in FILMS.items():
        with tempfile.TemporaryDirectory() as home:
            command = [sys.executable, str(ROOT / script)]
            call = f"{options} --seed 1 2 3 4 5 --out-dir {home}".split()
            subprocess.run([*command, *call], check=True)
            (folder,) = Path(home).iterdir()
            subprocess.run([*command, "--watch", str(folder / "seed-1.pt")], check=True)
            shutil.copy(folder / "seed-1.gif", ROOT / f"docs/{name}.gif")
            shutil.copy(folder / "learning_curve.png", ROOT / f"docs/{name}.png")


if __name__ == "__main__":
    sys.exit(__doc__) if sys.argv[1:] else main()
