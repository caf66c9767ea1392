"""A clip of an agent that has learned, for each script: the GIFs of the README."""

import os
import sys

import numpy as np
import pandas as pd
import torch
from benchmark import common
from benchmark.common import A2C, PPO, REINFORCE, SEEDS
from PIL import Image

FIGURES = ()
SECONDS, FPS, SIZE = 8, 12.5, (240, 160)


def jobs(quick):
    return [common.training_jobs(x, quick, seeds=SEEDS[x][:1])[0] for x in (PPO, A2C, REINFORCE)]


def measure(job):
    return common.fresh(film, job)


def film(job):
    """Write the GIF into docs, unless this is a trial; its row says what it shows."""
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "egl")  # which needs no display
    module, checkpoint = common.load(job.script), common.run_folder(job) / "checkpoint.pt"
    args = module.parse_args(["--watch", str(checkpoint)])
    camera = module.make_envs(args.env_id, 1, "NextStep", render_mode="rgb_array_list")
    agent = module.Agent(camera.single_observation_space, camera.single_action_space, args)
    agent.load_state_dict(torch.load(checkpoint, weights_only=True)["agent"])
    result = module.evaluate(agent, camera, args.seed[0])
    pictures, every = camera.render()[0], camera.metadata["render_fps"] / FPS
    count = min(int(SECONDS * FPS), int(len(pictures) / every))
    frames = crop([pictures[int(i * every)] for i in range(count)])
    trial = args.total_steps < common.defaults(job.script)["total_steps"]
    home = common.ROOT / ("runs/quick" if trial else "docs")
    home.mkdir(parents=True, exist_ok=True)
    frames[0].save(home / f"{job.script}.gif", save_all=True, append_images=frames[1:],
                   duration=1000 / FPS, loop=0)
    return pd.DataFrame([{"env_id": args.env_id, "frames": count, **result}])


def crop(pictures):
    """Around what moves."""
    moves = np.ptp(pictures, axis=0).max(-1) > 30
    (top, left), (bottom, right) = np.argwhere(moves).min(0), np.argwhere(moves).max(0)
    height = min(1.5 * max(bottom - top, (right - left) / 1.5), len(moves), moves.shape[1] / 1.5)
    x = np.clip((left + right) / 2, 0.75 * height, moves.shape[1] - 0.75 * height)
    y = np.clip((top + bottom) / 2, height / 2, len(moves) - height / 2)
    box = x - 0.75 * height, y - height / 2, x + 0.75 * height, y + height / 2
    return [Image.fromarray(picture).resize(SIZE, box=box).quantize(64, dither=0)
            for picture in pictures]


def report(data, draw):
    return {}
