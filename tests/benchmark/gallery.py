"""A GIF for each script, for the README: an agent before and after training; PPO's on two tasks."""

import os
import sys

import numpy as np
import pandas as pd
import torch
from benchmark import common
from benchmark.common import A2C, PPO, REINFORCE, SEEDS, Job
from PIL import Image

FIGURES = ()
SECONDS, FPS, SIZE = 8, 12.5, (240, 160)
ROBOT = "--env-id HalfCheetah-v5 --total-steps 1000000"


def jobs(quick):
    return [common.training_jobs(x, quick, seeds=SEEDS[x][:1])[0] for x in (PPO, A2C, REINFORCE)]


def measure(job):
    return common.fresh(film, job)


def film(job):
    """Write the GIF into docs, unless this is a trial; its row says what it shows."""
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "egl")  # which needs no display
    trial = "--total-steps" in job.flags
    left, result = clip(job)
    if job.script == PPO and not trial:
        right, _ = clip(Job(PPO, job.seed, ROBOT), camera_name="track")
    else:
        left, right = clip(job, trained=False)[0], left
    home = common.ROOT / ("runs/quick" if trial else "docs")
    home.mkdir(parents=True, exist_ok=True)
    count = max(len(left), len(right))
    frames = []
    for i in range(count):
        frame = Image.new("RGB", (2 * SIZE[0] + 4, SIZE[1]), "white")
        frame.paste(left[min(i, len(left) - 1)], (0, 0))
        frame.paste(right[min(i, len(right) - 1)], (SIZE[0] + 4, 0))
        frames.append(frame.quantize(64, dither=0))
    frames[0].save(home / f"{job.script}.gif", save_all=True, append_images=frames[1:],
                   duration=1000 / FPS, loop=0)
    return pd.DataFrame([{**result, "frames": count}])


def clip(job, trained=True, **camera_options):
    """The pictures of an episode of the agent that `job` trains, or of an untrained one."""
    module, checkpoint = common.load(job.script), common.run_folder(job) / "checkpoint.pt"
    args = module.parse_args(["--watch", str(checkpoint)])
    camera = module.make_envs(
        args.env_id, 1, "NextStep", render_mode="rgb_array_list", **camera_options)
    torch.manual_seed(job.seed)
    agent = module.Agent(camera.single_observation_space, camera.single_action_space, args)
    if trained:
        agent.load_state_dict(torch.load(checkpoint, weights_only=True)["agent"])
    result = module.evaluate(agent, camera, args.seed[0])
    pictures, every = camera.render()[0], camera.metadata["render_fps"] / FPS
    count = max(1, min(int(SECONDS * FPS), int(len(pictures) / every)))
    return crop([pictures[int(i * every)] for i in range(count)]), {"env_id": args.env_id, **result}


def crop(pictures):
    """Around what moves."""
    moves = np.ptp(pictures, axis=0).max(-1) > 30
    if not moves.any():
        moves[:] = True
    (top, left), (bottom, right) = np.argwhere(moves).min(0), np.argwhere(moves).max(0)
    height = min(1.5 * max(bottom - top, (right - left) / 1.5), len(moves), moves.shape[1] / 1.5)
    x = np.clip((left + right) / 2, 0.75 * height, moves.shape[1] - 0.75 * height)
    y = np.clip((top + bottom) / 2, height / 2, len(moves) - height / 2)
    box = x - 0.75 * height, y - height / 2, x + 0.75 * height, y + height / 2
    return [Image.fromarray(picture).resize(SIZE, box=box) for picture in pictures]


def report(data, draw):
    return {}
