"""The films of the README: an agent before and after its training.

    python experiments/films.py reinforce_mujoco.py runs/…/seed-1.pt
    python experiments/films.py a2c_vector.py runs/…/seed-1.pt
    python experiments/films.py ppo_continuous.py runs/…/seed-1.pt      of HalfCheetah-v5
"""

import os
import sys

import gymnasium as gym
import matplotlib.font_manager
import numpy as np
import study
import torch
from PIL import Image, ImageDraw, ImageFont
from study import A2C, PPO, REINFORCE

os.environ.setdefault("MUJOCO_GL", "egl" if sys.platform == "linux" else "glfw")
WIDTH, HEIGHT, BAR, SKY = 480, 320, 40, (222, 235, 247)
FONT = ImageFont.truetype(matplotlib.font_manager.findfont("DejaVu Sans"), 26)
VIEWS = {  # options, steps for a frame, milliseconds, camera
    REINFORCE: ("", 2, 80, {"default_camera_config": {
        "distance": 2.2, "lookat": np.array([0, 0, 0.15]), "elevation": -5}}),
    A2C: ("", 4, 80, {}),
    PPO: ("--env-id HalfCheetah-v5", 1, 50, {"camera_name": "track"}),
}
SCENES = {  # steps and words, before and after
    REINFORCE: [(60, "before: the pole falls"), (120, "after: pushed, the pole stands")],
    A2C: [(130, "before: it crashes"), (290, "after a million steps: it lands")],
    PPO: [(30, "before"), (70, "after a million steps")],
}


def frame(image, words):
    """With a sky in place of the dark, and a line of text below."""
    image = np.array(image)
    image[(image < 12).all(-1)] = SKY
    page = Image.new("RGB", (WIDTH, HEIGHT + BAR), "white")
    page.paste(Image.fromarray(image).resize((WIDTH, HEIGHT)))
    ImageDraw.Draw(page).text((10, HEIGHT + 2), words, fill="black", font=FONT)
    return page


def play(script, weights, steps, words):
    """The frames of one scene; an agent without weights is new, and draws its actions."""
    options, steps_a_frame, _, camera = VIEWS[script]
    module, args = study.load(study.Job(script, options))
    size = {} if script == A2C else {"width": WIDTH, "height": HEIGHT}
    env = gym.make(args.env_id, render_mode="rgb_array", **size, **camera).unwrapped  # no end
    torch.manual_seed(1)
    agent = module.Agent(env.observation_space, env.action_space, args.hidden_size)
    frames = []
    if weights:
        agent.load_state_dict(weights)
    obs, _ = env.reset(seed=3)
    for step in range(steps):
        if step % steps_a_frame == 0:
            speed = f", {env.data.qvel[0]:.1f} m/s" if script == PPO else ""
            frames.append(frame(env.render(), words + speed))
        action = agent.act(np.array(obs, float)[None], deterministic=bool(weights))[0]
        if script == REINFORCE:
            action = action.clip(env.action_space.low, env.action_space.high)
        if script == PPO:
            action = module.squash(action, env.action_space)
        if script == REINFORCE and weights and step % 40 == 5:
            env.data.qvel[1] += 1.5 * (-1) ** (step // 40)  # a push, radians a second
        obs, *_ = env.step(action)
    env.close()
    return frames


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python experiments/films.py SCRIPT AGENT.pt")
    script, path = sys.argv[1:]
    trained = torch.load(path, weights_only=True)["agent"]
    before, after = (play(script, weights, *scene)
                     for weights, scene in zip((None, trained), SCENES[script]))
    palette = after[-1].quantize(32)
    frames = [x.quantize(palette=palette, dither=Image.Dither.NONE) for x in before + after]
    durations = [VIEWS[script][2]] * len(frames)
    durations[len(before) - 1] = durations[-1] = 1000  # the end is the point
    frames[0].save(study.ROOT / "docs" / script.replace(".py", ".gif"), save_all=True, loop=0,
                   append_images=frames[1:], duration=durations, optimize=True)
